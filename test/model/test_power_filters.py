"""Filters of what path losses are off, against a Kalman filter written down plainly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.power_filters import Anchor, PowerFilters, SLOTS

PRIOR = np.diag([36.0, 0.25])
ANCHOR_VARIANCE, SIGMA = 4.0, 3.0
ONE = np.ones((1, 1), np.float32)
# Anchors, log10 of their distances [m], and how much louder [dB] they are than supposed.
ROWS = [(7, 1.0, 4.0), (8, 1.5, 2.5), (7, 1.2, 5.0), (9, 0.7, -1.0)]


def filters() -> PowerFilters:
    """Return those of one vehicle with one particle."""
    return PowerFilters(1, 1, np.zeros(2), PRIOR, ANCHOR_VARIANCE)


def anchor(sender: int, decade: float, is_used: bool = True) -> Anchor:
    return Anchor(np.array([is_used]), np.array([sender]), decade * ONE, -70 * ONE, SIGMA * ONE)


def measured(found: PowerFilters, *rows: tuple[int, float, float]) -> list[float]:
    """Return log-likelihoods of rssi."""
    return [found.measure(anchor(sender, decade), np.array([-70 + off]), -np.inf, 0.0, ONE)[0]
            .item() for sender, decade, off in rows]


def plain() -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return what a Kalman filter of P_0, n and the anchors 7, 8, 9 makes of the same rows."""
    mean, covariance, likely = np.zeros(5), np.diag([36.0, 0.25, 4.0, 4.0, 4.0]), []
    for sender, decade, off in ROWS:
        h = np.array([1, -10 * decade, *(np.arange(7, 10) == sender)])
        variance = h @ covariance @ h + SIGMA ** 2
        # Relative to its own peak and noise, as all likelihoods are.
        likely.append(stats.norm.logpdf(off, h @ mean, np.sqrt(variance))
                      - stats.norm.logpdf(0, 0, SIGMA))
        gain = covariance @ h / variance
        mean = mean + gain * (off - h @ mean)
        covariance = covariance - np.outer(gain, h @ covariance)
    return mean, covariance, likely


def test_what_is_off_is_what_a_kalman_filter_finds() -> None:
    found = filters()
    measured(found, *ROWS)
    mean, covariance = found.moments(ONE)
    np.testing.assert_allclose(mean[0, :5], plain()[0], rtol=1e-4)
    np.testing.assert_allclose(covariance[0, :5, :5], plain()[1], rtol=1e-4, atol=1e-4)


def test_a_particle_is_as_likely_as_what_is_left_of_its_rssi() -> None:
    np.testing.assert_allclose(measured(filters(), *ROWS), plain()[2], rtol=1e-4)


def test_an_anchor_that_is_silent_is_as_likely_as_an_rssi_below_the_sensitivity() -> None:
    found = filters()
    likely = found.miss(anchor(7, 1.0), -68.0, np.array([0.1]), ONE).item()
    slope = np.array([1.0, -10.0])
    std = np.sqrt(slope @ PRIOR @ slope + ANCHOR_VARIANCE + SIGMA ** 2)
    assert likely == pytest.approx(np.log(0.9 * stats.norm.cdf(2.0 / std) + 0.1), rel=1e-5)
    # Else it would be heard: P_0 is less than it was taken to be.
    assert found.moments(ONE)[0][0, 0] < 0


def test_what_does_not_count_tells_nothing() -> None:
    found = filters()
    before = found.moments(ONE)
    idle = anchor(7, 1.0, is_used=False)
    assert found.measure(idle, np.array([np.nan]), -np.inf, 0.0, ONE)[0] == 0
    assert found.miss(idle, -68.0, np.array([0.1]), ONE) == 0
    for now, then in zip(found.moments(ONE), before, strict=True):
        np.testing.assert_array_equal(now, then)
    assert not found.find(np.array([[7]]))[0].any()


def test_the_anchor_that_was_heard_longest_ago_makes_room() -> None:
    found = filters()
    measured(found, *[(sender, 1.0, 0.0) for sender in [*range(SLOTS), 0, SLOTS]])
    known, _ = found.find(np.arange(SLOTS + 1)[None])
    np.testing.assert_array_equal(known[0], np.arange(SLOTS + 1) != 1)


def test_copies_take_what_is_off_along() -> None:
    found = PowerFilters(1, 2, np.zeros(2), PRIOR, ANCHOR_VARIANCE)
    found.measure(Anchor(np.array([True]), np.array([7]), np.array([[1.0, 1.5]]), np.array(
        [[-70.0, -80.0]]), SIGMA * ONE), np.array([-70.0]), -np.inf, 0.0, np.full((1, 2), 0.5))
    second = found.moments(np.array([[0.0, 1.0]], np.float32))[0]
    found.resample(np.array([0]), np.array([[1, 1]]))
    np.testing.assert_array_equal(found.moments(np.array([[1.0, 0.0]], np.float32))[0], second)
