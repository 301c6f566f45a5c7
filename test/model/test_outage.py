"""Predictions of vehicles that hear nothing, against ways whose statistics are known."""

from __future__ import annotations

from copy import deepcopy
import math

import numpy as np
import pytest
from scipy.stats import chi2
from tsmcl_ros.model.history import BRIDGED
from tsmcl_ros.model.outage import OutagePredictor, SLOTS
from tsmcl_ros.types import Estimate, Observation


def estimate(stamp, mean, variance=1.0):
    """Return an estimate of vehicles at positions (V, D) [m]."""
    mean = np.atleast_2d(np.asarray(mean, float))
    vehicles, dimension = mean.shape
    unknown = np.full(vehicles, np.nan)
    return Estimate(
        stamp, mean, np.tile(variance * np.eye(dimension), (vehicles, 1, 1)), unknown, unknown,
        unknown, 0, unknown, np.ones(vehicles, int), np.zeros(vehicles, bool))


def heard(vehicles=1, dimension=2, which=None):
    """Return an observation in which vehicles, or some of them, hear a reference at the origin."""
    observation = Observation.empty(vehicles, 1, dimension, 0.0)
    observation.sender[slice(None) if which is None else which] = 1
    return observation


def learned(way, period=1.0, variance=1.0):
    """Return a predictor that was told a way (T, V, D) [m], and the time of its end."""
    predictor = OutagePredictor(way.shape[1], way.shape[2])
    for step, position in enumerate(way):
        predictor.learn(estimate(step * period, position, variance), heard(*position.shape))
    return predictor, (len(way) - 1) * period


def ahead(predictor, stamp, vehicles=1, dimension=2):
    """Return what is predicted, of vehicles of which the method says 0."""
    return predictor.replace(
        estimate(stamp, np.zeros((vehicles, dimension))), np.ones(vehicles, bool))


def straight(seconds, velocity=(3.0, -4.0)):
    return np.arange(float(seconds))[:, None, None] * np.array(velocity)


def test_who_always_went_straight_is_led_on_straight_for_a_while():
    predictor, end = learned(straight(100))

    predicted = ahead(predictor, end + 5.0)

    # Shrunk by one part in the number of examples.
    np.testing.assert_allclose(
        predicted.mean[0], straight(105)[-1, 0], atol=0.15 * 5 * 5)


def test_but_is_not_trusted_to_do_so_for_as_long_as_that_again():
    predictor, end = learned(straight(100))

    spread = np.sqrt(ahead(predictor, end + 100.0).covariance[0, 0, 0])

    # An Ornstein-Uhlenbeck velocity of 5 m/s that lasts 100 s strays 205 m in that time per axis.
    assert 100 < spread < 400


def test_who_goes_to_and_fro_is_expected_where_he_always_is():
    time = np.arange(300.0)
    lane = 20 * np.abs((time / 20) % 2 - 1)  # lanes of 20 m at 1 m/s
    predictor, end = learned(np.stack([lane, 0 * lane], axis=1)[:, None])

    predicted = ahead(predictor, end + 90.0)

    assert -10 < predicted.mean[0, 0] < 30
    assert np.sqrt(predicted.covariance[0, 0, 0]) < 30


def test_who_stands_is_expected_to_stand():
    predictor, end = learned(np.full((60, 1, 2), 7.0), variance=0.01)

    predicted = ahead(predictor, end + 10.0)

    np.testing.assert_allclose(predicted.mean[0], [7.0, 7.0], atol=1e-6)


def walks(vehicles, seconds, decay=8.0):
    """Return ways (T, V, 2) [m] of Ornstein-Uhlenbeck velocities of 1 m/s per axis."""
    rng = np.random.default_rng(1)
    keep = np.exp(-1 / decay)
    velocity = rng.standard_normal((vehicles, 2))
    way = [np.zeros((vehicles, 2))]
    for _ in range(seconds - 1):
        way.append(way[-1] + velocity)
        velocity = keep * velocity + np.sqrt(1 - keep**2) * rng.standard_normal(velocity.shape)
    return np.array(way)


@pytest.fixture(scope='module')
def walked():
    """Return a predictor of 100 noisy walks of 490 s, told 400 s of them, and the walks."""
    way = walks(100, 490)
    noisy = way + 0.5 * np.random.default_rng(2).standard_normal(way.shape)
    return learned(noisy[:400], variance=0.25)[0], way


@pytest.mark.parametrize('horizon', [2, 10, 40, 90])
def test_the_uncertainty_is_honest_where_velocities_are_forgotten_at_random(walked, horizon):
    predictor, way = walked

    predicted = ahead(deepcopy(predictor), 399.0 + horizon, 100)

    off = predicted.mean - way[399 + horizon]
    nees = np.einsum('vi,vij,vj->v', off, np.linalg.inv(predicted.covariance), off)
    # The mean of 100 has a standard error of 0.2. What few examples teach is told a little wider.
    assert 0.6 * 2 < nees.mean() < 1.3 * 2
    assert np.mean(nees < chi2.ppf(0.95, 2)) > 0.9


def test_predictions_beat_constant_velocity_where_velocities_are_forgotten(walked):
    predictor, way = walked

    predicted = ahead(deepcopy(predictor), 459.0, 100)

    constant = way[399] + 60 * (way[399] - way[398])
    assert np.linalg.norm(predicted.mean - way[459], axis=1).mean() < (
        0.6 * np.linalg.norm(constant - way[459], axis=1).mean())


def test_the_uncertainty_never_shrinks_while_nothing_is_heard():
    time = np.arange(300.0)
    circle = 30 * np.stack([np.cos(time / 10), np.sin(time / 10)], axis=1)
    predictor, end = learned(circle[:, None])

    spread = [np.trace(ahead(predictor, end + step).covariance[0]) for step in range(2, 100, 2)]

    assert (np.diff(spread) >= 0).all()
    assert spread[0] > 2.0


def test_a_short_past_tells_nothing():
    predictor, end = learned(straight(8))

    assert not predictor.ready().any()
    assert ahead(predictor, end + 5.0).mean[0].tolist() == [0.0, 0.0]


def test_epochs_of_any_period_are_brought_to_even_times():
    even, end = learned(straight(60))
    uneven = OutagePredictor(1, 2)
    stamps = [*np.sort(np.random.default_rng(3).uniform(0, end, 200)).tolist(), end]
    for stamp in stamps:
        uneven.learn(estimate(stamp, [3 * stamp, -4 * stamp]), heard())

    np.testing.assert_allclose(
        ahead(uneven, end + 8.0).mean, ahead(even, end + 8.0).mean, atol=1.0)


def test_a_pause_too_long_to_bridge_is_no_part_of_the_past():
    predictor = OutagePredictor(1, 2)
    for stamp in range(40):
        predictor.learn(estimate(float(stamp), [stamp, 0.0]), heard())
    predictor.learn(estimate(39 + BRIDGED + 1, [1e4, 0.0]), heard())

    # One position after the pause gives no velocity, and so it stays where it was seen.
    assert ahead(predictor, 75.0).mean[0, 0] == 1e4


def test_the_forgotten_are_learned_anew():
    predictor, end = learned(straight(60))

    predictor.forget(np.ones(1, bool))

    assert not predictor.ready().any()
    assert ahead(predictor, end + 5.0).mean[0].tolist() == [0.0, 0.0]


def test_vehicles_of_a_fleet_are_predicted_as_each_alone():
    way = walks(5, 200)
    fleet, end = learned(way)

    together = ahead(fleet, end + 30.0, 5)

    for vehicle in range(5):
        alone = ahead(learned(way[:, [vehicle]])[0], end + 30.0)
        np.testing.assert_allclose(together.mean[vehicle], alone.mean[0])
        np.testing.assert_allclose(together.covariance[vehicle], alone.covariance[0])


def test_those_who_are_heard_are_left_alone():
    predictor, end = learned(walks(3, 100))
    told = estimate(end + 4.0, np.ones((3, 2)))

    answer = predictor.replace(told, np.array([False, True, False]))

    assert (answer.mean[[0, 2]] == 1).all()
    assert (answer.mean[1] != 1).all()
    assert (told.mean == 1).all()


def test_the_past_is_as_long_as_it_may_be_and_no_longer():
    way = np.concatenate([straight(300, (50.0, 0.0)), np.zeros((SLOTS, 1, 2))])
    predictor, end = learned(way, variance=0.01)

    assert np.sqrt(ahead(predictor, end + 50.0).covariance[0, 0, 0]) < 5


@pytest.mark.parametrize('horizon', [0.0, 1e-3, 1e4, 1e9])
def test_no_horizon_gives_anything_but_finite_numbers(horizon):
    predictor, end = learned(walks(4, 60))

    predicted = ahead(predictor, end + horizon, 4)

    assert np.isfinite(predicted.mean).all()
    assert np.isfinite(predicted.covariance).all()


def test_heights_are_predicted_as_well():
    predictor, end = learned(straight(60, (1.0, 2.0, 0.5)))

    assert ahead(predictor, end + 4.0, dimension=3).mean[0, 2] == pytest.approx(31.5, abs=0.5)


def test_an_outage_does_not_use_up_the_past():
    predictor, end = learned(walks(1, 100))
    spread = [np.trace(ahead(predictor, end + step).covariance[0]) for step in (50, 1000, 5000)]

    assert spread[0] < spread[1] < spread[2]


def test_a_method_that_is_much_less_certain_is_told_where_the_vehicle_is_when_heard_again():
    lanes = 20 * np.abs((np.arange(300.0) / 20) % 2 - 1)
    predictor, end = learned(np.stack([lanes, 0 * lanes], axis=1)[:, None])
    everybody = np.ones(1, bool)
    lost = estimate(end + 60, [500.0, 0.0], variance=1e6)
    predicted = predictor.replace(lost, everybody)

    prior, = predictor.resume(end + 60.5, everybody)

    np.testing.assert_allclose(prior.mean, predicted.mean[0], atol=1.0)
    np.testing.assert_allclose(prior.covariance, predicted.covariance[0], rtol=0.1, atol=1e-9)
    # It goes at 1 m/s along one of two axes.
    assert prior.velocity_std == pytest.approx(math.sqrt(1 / 2), rel=0.1)


@pytest.mark.parametrize(('variance', 'after', 'lanes'), [
    (1.0, 60, True),  # the method knows as much
    (1e6, 3, True),  # its velocity still counts
    (1e6, 20, False)])  # and is kept on a straight way
def test_other_methods_go_on_by_themselves(variance, after, lanes):
    way = 20 * np.abs((np.arange(300.0) / 20) % 2 - 1) if lanes else np.arange(300.0)
    predictor, end = learned(np.stack([way, 0 * way], axis=1)[:, None])
    everybody = np.ones(1, bool)
    predictor.replace(estimate(end + after, [0.0, 0.0], variance), everybody)

    assert predictor.resume(end + after + 0.5, everybody) == []
    assert predictor.resume(end + after + 0.5, ~everybody) == []


def test_a_grey_azimuth_leads_around_a_bend():
    angle = 0.02 * np.arange(200.0)
    way = 300 * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    truth = 300 * np.array([math.cos(0.02 * 205), math.sin(0.02 * 205)])
    off = {}
    for grey in (False, True):
        predictor = OutagePredictor(1, 2, grey)
        for stamp, position in enumerate(way):
            predictor.learn(estimate(float(stamp), position), heard())
        predicted = ahead(predictor, 205.0)
        off[grey] = np.linalg.norm(predicted.mean[0] - truth)
        spread = np.trace(predicted.covariance[0])

    assert off[True] < off[False]
    predictor.grey = False
    assert np.trace(ahead(predictor, 205.0).covariance[0]) == pytest.approx(spread)
