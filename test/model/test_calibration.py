"""What is learnt of a ranging radio's scale and offset, against what the ranges are made with."""

import numpy as np
import pytest
from tsmcl_ros.model.calibration import RangeCalibration
from tsmcl_ros.types import Estimate, Observation

ANCHORS = np.array([[0, 0], [60, 0], [60, 45], [0, 45]], float)


def estimate(mean, variance=0.01):
    """Return an estimate of V vehicles at mean (V, 2) [m]."""
    vehicles = len(mean)
    unknown = np.full(vehicles, np.nan)
    return Estimate(
        0.0, np.asarray(mean, float), variance * np.broadcast_to(np.eye(2), (vehicles, 2, 2)),
        unknown, unknown, unknown, 0, unknown, np.full(vehicles, 4), np.zeros(vehicles, bool))


def ranges(mean, scale=1.07, bias=0.3, std=0.0, rng=None):
    """Return what radios at mean (V, 2) measure of the anchors."""
    mean = np.asarray(mean, float)
    observation = Observation.empty(len(mean), 4, 2, 0.0)
    observation.sender[:] = range(4)
    observation.position[:] = ANCHORS
    distance = np.linalg.norm(ANCHORS - mean[:, None], axis=2)
    noise = 0 if rng is None else std * rng.standard_normal(distance.shape)
    observation.range[:] = scale * distance + bias + noise
    return observation


def learn(calibration, epochs, vehicles=1, variance=0.01, shift=0.0, seed=0, **truth):
    rng = np.random.default_rng(seed)
    for _ in range(epochs):
        place = rng.uniform([0, 0], [60, 45], (vehicles, 2))
        calibration.learn(
            ranges(place, std=0.5, rng=rng, **truth),
            estimate(place + shift, variance), np.full((vehicles, 4), 0.5))
    return calibration


def test_it_starts_from_what_is_configured():
    calibration = RangeCalibration(1.02, -0.4)
    assert (calibration.scale, calibration.bias) == (1.02, -0.4)


def test_scale_and_offset_are_recovered_from_ranges_and_right_positions():
    calibration = learn(RangeCalibration(1.0, 0.0), 500, scale=1.07, bias=0.3)
    # Three standard errors: 0.5 m over sqrt(2000) ranges, of distances that spread by 15 m.
    assert calibration.scale == pytest.approx(1.07, abs=0.0025)
    assert calibration.bias == pytest.approx(0.3, abs=0.11)


def test_it_is_least_squares_with_a_prior():
    rng = np.random.default_rng(1)
    place = rng.uniform([0, 0], [60, 45], (3, 2))
    observation = ranges(place, std=0.5, rng=rng)
    calibration = RangeCalibration(1.0, 0.0)
    calibration.learn(observation, estimate(place, 0.0), np.full((3, 4), 0.5))
    distance = np.linalg.norm(ANCHORS - place[:, None], axis=2).ravel()
    # The prior as two more rows of an ordinary least-squares problem.
    design = np.vstack([np.column_stack([distance, np.ones(12)]) / 0.5,
                        np.diag([1 / 0.05, 1 / 0.3])])
    wanted = np.concatenate([observation.range.ravel() / 0.5, [1 / 0.05, 0]])
    expected, *_ = np.linalg.lstsq(design, wanted, rcond=None)
    np.testing.assert_allclose([calibration.scale, calibration.bias], expected, rtol=1e-5)


def test_a_fleet_teaches_as_much_as_its_vehicles_one_after_the_other():
    rng = np.random.default_rng(2)
    place = rng.uniform([0, 0], [60, 45], (20, 2))
    observation = ranges(place, std=0.5, rng=rng)
    together, apart = RangeCalibration(1.0, 0.0), RangeCalibration(1.0, 0.0)
    together.learn(observation, estimate(place), np.full((20, 4), 0.5))
    for vehicle in range(20):
        one = place[vehicle:vehicle + 1]
        apart.learn(observation.vehicle(vehicle), estimate(one), np.full((1, 4), 0.5))
    assert together.scale == pytest.approx(apart.scale, abs=1e-4)
    assert together.bias == pytest.approx(apart.bias, abs=1e-3)


def test_it_follows_a_radio_that_changes():
    calibration = learn(RangeCalibration(1.0, 0.0), 200, vehicles=10, scale=1.05)
    learn(calibration, 2000, vehicles=10, scale=1.04, seed=1)
    assert calibration.scale == pytest.approx(1.04, abs=0.003)


def test_outliers_are_ignored():
    calibration = learn(RangeCalibration(1.0, 0.0), 100)
    before = calibration.scale, calibration.bias
    place = [[30.0, 20.0]]
    observation = ranges(place)
    observation.range[:] += 25
    calibration.learn(observation, estimate(place), np.full((1, 4), 0.5))
    assert (calibration.scale, calibration.bias) == pytest.approx(before, abs=1e-12)


def test_vehicles_that_are_uncertain_do_not_take_part():
    calibration = learn(RangeCalibration(1.0, 0.0), 20, variance=13.0)  # std 5.1 m
    assert (calibration.scale, calibration.bias) == (1.0, 0.0)


def test_the_less_certain_the_position_the_less_is_learnt():
    sure, unsure = (
        learn(RangeCalibration(1.0, 0.0), 1, variance=variance) for variance in (0.01, 5.0))
    assert 0 < unsure.scale - 1 < 0.5 * (sure.scale - 1)


@pytest.mark.parametrize('missing', ['place', 'range', 'sender'])
def test_what_is_not_known_teaches_nothing(missing):
    calibration = RangeCalibration(1.0, 0.0)
    place = np.array([[30.0, 20.0]])
    observation = ranges(place)
    if missing == 'place':
        place[:] = np.nan
    elif missing == 'range':
        observation.range[:] = np.nan
    else:
        observation.sender[:] = -1
    variance = np.nan if missing == 'place' else 0.01
    calibration.learn(observation, estimate(place, variance), np.full((1, 4), 0.5))
    assert (calibration.scale, calibration.bias) == (1.0, 0.0)


def test_a_vehicle_on_top_of_an_anchor_does_no_harm():
    calibration = RangeCalibration(1.0, 0.0)
    place = ANCHORS[:1]
    calibration.learn(ranges(place), estimate(place), np.full((1, 4), 0.5))
    assert np.isfinite([calibration.scale, calibration.bias]).all()
