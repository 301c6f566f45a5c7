"""Places by the rssi of one epoch."""

from __future__ import annotations

import numpy as np
from scipy import stats
from tsmcl_ros.model.power_places import draw_places

# Not on one circle, inside and outside of which rssi could agree alike.
ANCHORS = np.array([[0, 0], [60, 0], [60, 45], [0, 45], [30, 20]], float)
TRUE = np.array([15.0, 30.0])
P_0, N, SIGMA = -60.0, 2.0, 2.0
LOUDER = 5.0  # dB, than P_0 says
PRIOR = np.diag([36.0, 0.01])


def mean_rssi(places: np.ndarray) -> np.ndarray:
    away = np.linalg.norm(ANCHORS - places[..., None, :], axis=-1)
    return P_0 - 10 * N * np.log10(away)


def drawn() -> tuple[np.ndarray, np.ndarray]:
    """Return places and log-weights of a vehicle that hears all anchors without noise."""
    loss = tuple(np.full((1, len(ANCHORS)), part) for part in (P_0, N, SIGMA))
    places, log_weights = draw_places(
        ANCHORS[None], mean_rssi(TRUE)[None] + LOUDER, np.ones((1, len(ANCHORS)), bool), loss,
        PRIOR, 0.0, 4000, np.random.default_rng(1))
    return places[0], log_weights[0]


def test_places_are_around_that_of_which_rssi_agree_though_p_0_is_off() -> None:
    places, _ = drawn()
    np.testing.assert_allclose(np.median(places, axis=0), TRUE, atol=2.0)


def test_weights_make_up_for_half_of_the_likelihood_that_places_were_drawn_by() -> None:
    places, log_weights = (found[::20] for found in drawn())
    off = mean_rssi(TRUE) + LOUDER - mean_rssi(places)
    expected = []
    for place, row in zip(places, off, strict=True):
        away = np.linalg.norm(ANCHORS - place, axis=1)
        slope = np.stack([np.ones(len(ANCHORS)), -10 * np.log10(away)], axis=1)
        covariance = slope @ PRIOR @ slope.T + SIGMA ** 2 * np.eye(len(ANCHORS))
        expected.append(-0.5 * stats.multivariate_normal.logpdf(row, cov=covariance))
    # Noise has moved each a little from where it was scored.
    off_by = log_weights - expected
    assert off_by.std() < 0.1 * log_weights.std()
