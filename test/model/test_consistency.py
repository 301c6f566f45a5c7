"""How far beacons contradict a prediction, against what simulation says of their distribution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.consistency import deviations
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Observation, Silence

RANGING = Channel(RadioConfig(radio_range=1000.0, range_std=3.0))
PRESENCE = Channel(RadioConfig(radio_range=1000.0, edge_softness=10.0))
SHADOWED = Channel(RadioConfig(radio_model='lognormal', path_loss_exponent=2.5, sigma_db=4.0,
                               sensitivity=-110.0))


def observe(position, vehicles=1, **measured):
    """Return an observation of senders at positions (K, 2) [m], the same for all vehicles."""
    position = np.asarray(position, np.float32)
    observation = Observation.empty(vehicles, len(position), 2, 0.0)
    observation.sender[:] = np.arange(len(position))
    observation.position[:] = position
    return replace(observation, **measured)


def silence(position, vehicles=1):
    shape = (vehicles, len(position))
    return Silence(
        np.ones(shape, bool), np.tile(np.arange(len(position)) + 100, (vehicles, 1)),
        np.broadcast_to(np.asarray(position, np.float32), (*shape, 2)),
        np.full(shape, np.nan, np.float32))


def belief(mean, std, vehicles=1):
    return np.tile(np.asarray(mean, float), (vehicles, 1)), np.tile(
        std ** 2 * np.eye(2), (vehicles, 1, 1))


def only(found):
    """Return the deviations of what is said."""
    return found.deviation[found.said]


@pytest.mark.parametrize(('std', 'known'), [(5.0, 0.0), (40.0, 0.0), (5.0, 30.0)])
def test_ranges_deviate_from_a_right_prediction_as_a_normal_error_does(std, known):
    rng = np.random.default_rng(1)
    count = 4000
    truth = 100 + std * rng.standard_normal((count, 2))
    claimed = np.array([[300.0, 250.0]])
    place = claimed + known * rng.standard_normal((count, 2))
    ranges = np.linalg.norm(truth - place, axis=1) + 3 * rng.standard_normal(count)
    observation = observe(claimed, count, range=ranges[:, None].astype(np.float32))
    observation.covariance[:] = known ** 2 * np.eye(2, dtype=np.float32)
    found = only(deviations(RANGING, observation, *belief([100, 100], std, count)))
    assert stats.kstest(found, stats.halfnorm.cdf).pvalue > 1e-3


def test_rssi_deviates_from_a_right_prediction_as_a_normal_error_does():
    rng = np.random.default_rng(2)
    count = 4000
    truth = 100 + 10 * rng.standard_normal((count, 2))
    loss = SHADOWED.path_loss(np.array(-1))
    rssi = loss.mean(np.linalg.norm(truth - [300, 250], axis=1)) + 4 * rng.standard_normal(count)
    observation = observe([[300.0, 250.0]], count, rssi=rssi[:, None].astype(np.float32))
    found = only(deviations(SHADOWED, observation, *belief([100, 100], 10.0, count)))
    assert stats.kstest(found, stats.halfnorm.cdf).pvalue > 1e-3


@pytest.mark.parametrize(('distance', 'expected'), [(500.0, 0.0), (1000.0, 0.0), (1100.0, 100.0)])
def test_a_beacon_heard_contradicts_by_what_its_sender_is_out_of_range(distance, expected):
    found = deviations(PRESENCE, observe([[distance, 0.0]]), *belief([0, 0], 20.0))
    # The soft edge of 10 m is about as wide as a Gaussian of 17 m.
    assert only(found) == pytest.approx(expected / np.hypot(20, 17.02), abs=0.02)


def test_a_relayed_beacon_contradicts_where_its_sender_would_have_been_heard():
    observation = observe([[200.0, 0.0]])
    observation.hops[:] = 2
    found = deviations(PRESENCE, observation, *belief([0, 0], 20.0))
    assert only(found).max() > 20


@pytest.mark.parametrize(('distance', 'contradicts'), [(300.0, True), (990.0, False),
                                                       (1500.0, False)])
def test_the_silence_of_an_anchor_contradicts_where_it_would_be_heard(distance, contradicts):
    observation = observe([[0.0, 500.0]], silent=silence([[distance, 0.0]]))
    found = deviations(PRESENCE, observation, *belief([0, 0], 20.0))
    assert (found.deviation[found.silent & found.said] > 3) == [contradicts]


def test_under_shadowing_silence_near_the_edge_is_no_contradiction():
    edge = float(SHADOWED.radio_range)
    for distance, contradicts in ((edge, False), (0.7 * edge, False), (0.05 * edge, True)):
        observation = observe([[0.0, 1.0]], silent=silence([[distance, 0.0]]))
        found = deviations(SHADOWED, observation, *belief([0, 0], 0.01))
        assert (found.deviation[found.silent & found.said] > 3) == [contradicts]


def test_whose_belief_is_unknown_is_not_contradicted():
    mean, covariance = belief([np.nan, np.nan], np.nan)
    assert not deviations(PRESENCE, observe([[1e4, 0.0]]), mean, covariance).said.any()


def test_an_epoch_in_which_nothing_is_heard_says_nothing():
    nothing = observe(np.zeros((0, 2)), silent=silence([[1.0, 0.0]]))
    assert not deviations(PRESENCE, nothing, *belief([0, 0], 1.0)).said.any()


def test_what_is_switched_off_does_not_contradict():
    channel = Channel(RadioConfig(radio_range=1000.0), EvidenceConfig(
        use_heard=False, use_range=False, silence='none'))
    observation = observe([[5000.0, 0.0]], range=np.full((1, 1), 3.0, np.float32),
                          silent=silence([[1.0, 0.0]]))
    assert not deviations(channel, observation, *belief([0, 0], 1.0)).said.any()
