"""The echo guard: by hand in one line of sight, and by the honesty of whole fleets."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.evaluation.metrics import nees_band, normalized_error_squared
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.echo import guard, refuse_certainty
from tsmcl_ros.model.relay import Poses
from tsmcl_ros.types import ANCHOR, MessageError, Observation, PADDED, VEHICLE
from tsmcl_ros.world import make_world

# What one vehicle, at the origin with a variance of 9 m^2 along x and 1 along y, hears.
MEAN, COVARIANCE = np.zeros((1, 2)), np.diag([9.0, 1.0])[None]


def heard(*places: tuple[float, float], variance: float = 3.0, kind: int = VEHICLE) -> Observation:
    observation = Observation.empty(1, len(places), 2, 1.0)
    observation.sender[0] = np.arange(len(places))
    observation.kind[:] = kind
    observation.position[0] = places
    observation.covariance[:] = variance * np.eye(2)
    return observation


def test_a_reference_less_certain_along_the_line_of_sight_is_left_out() -> None:
    guarded = guard(heard((20, 0), (0, 20)), MEAN, COVARIANCE, 1.0)
    assert guarded.sender.tolist() == [[0, PADDED]]


def test_the_covariance_of_one_more_certain_is_divided_by_what_it_knows_better() -> None:
    guarded = guard(heard((20, 0)), MEAN, COVARIANCE, 1.0)
    np.testing.assert_allclose(guarded.covariance[0, 0], 3 / (1 - 3 / 9) * np.eye(2), rtol=1e-6)


def test_the_strength_multiplies_the_share() -> None:
    guarded = guard(heard((20, 0)), MEAN, COVARIANCE, 2.0)
    np.testing.assert_allclose(guarded.covariance[0, 0], 3 / (1 - 6 / 9) * np.eye(2), rtol=1e-6)
    assert not guard(heard((20, 0)), MEAN, COVARIANCE, 3.0).heard.any()


def test_heard_again_and_again_a_reference_teaches_no_more_than_it_knows() -> None:
    variance = 9.0
    for _ in range(1000):
        observation = guard(heard((20, 0)), MEAN, np.diag([variance, 1.0])[None], 1.0)
        if not observation.heard.any():
            break
        # A Kalman update by an exact range.
        variance = 1 / (1 / variance + 1 / float(observation.covariance[0, 0, 0, 0]))
    assert variance == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize(('mean', 'covariance', 'strength', 'kind'), [
    (MEAN, COVARIANCE, 1.0, ANCHOR),
    (MEAN, COVARIANCE, 0.0, VEHICLE),
    (np.full((1, 2), np.nan), np.full((1, 2, 2), np.nan), 1.0, VEHICLE),
], ids=['anchors', 'no guard', 'no estimate yet'])
def test_rows_stay_as_they_are_of(
    mean: np.ndarray, covariance: np.ndarray, strength: float, kind: int,
) -> None:
    observation = heard((20, 0), (0, 20), kind=kind)
    guarded = guard(observation, mean, covariance, strength)
    np.testing.assert_array_equal(guarded.sender, observation.sender)
    np.testing.assert_array_equal(guarded.covariance, observation.covariance)


@pytest.mark.parametrize('covariance', [np.zeros((1, 2, 2)), 1e-30 * COVARIANCE, COVARIANCE])
def test_no_covariance_makes_nan_of_a_reference(covariance: np.ndarray) -> None:
    observation = heard((0, 0), (20, 0), variance=1e-20)
    for strength in (1.0, 100.0):
        guarded = guard(observation, MEAN, covariance, strength)
        assert np.isfinite(guarded.covariance).all()


def test_vehicles_that_know_an_axis_exactly_are_refused_and_anchors_are_not() -> None:
    exact = heard((20, 0), variance=0.0)
    with pytest.raises(MessageError, match='vehicle 0 claims a singular covariance'):
        refuse_certainty(exact)
    refuse_certainty(heard((20, 0), variance=0.0, kind=ANCHOR))
    refuse_certainty(heard((20, 0)))


FLEET = {
    'vehicles': 20, 'area_x': 100.0, 'area_y': 100.0, 'anchor_layout': 'list',
    'anchor_positions': ('20 20', '80 20', '50 80', '50 45'),
    'measure_range': True, 'range_std': 1.0, 'odom_noise': 0.1, 'min_speed': 0.75,
    'max_speed': 1.5,
    'pose_max_spread': 1.0,  # the guard has to do without the help of this
}
FILTER = {
    'min_particles': 200, 'max_particles': 1000, 'motion_model': 'odometry',
    'odom_heading': 'known', 'odom_std': 0.1, 'alpha3': 0.0, 'alpha4': 0.0,
    'range_std': 1.0, 'range_calibration': 'off', 'seed': 1,
}


def nees(seed: int, echo_guard: float, radio_range: float, **world: float) -> float:
    """Return the mean NEES of a fleet that cooperates by ranges, from epoch 20 to 60."""
    made = make_world({**FLEET, **world, 'radio_range': radio_range}, np.random.default_rng(seed))
    localizer = Localizer({**FILTER, 'radio_range': radio_range, 'echo_guard': echo_guard},
                          FLEET['vehicles'])
    localizer.anchor_map(made.anchors)
    poses, found = None, []
    for _ in range(60):
        epoch = made.step(poses=poses)
        estimate = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
        poses = Poses.of(estimate)
        found.append(normalized_error_squared(
            estimate.mean - epoch.position, estimate.covariance))
    return float(np.mean(found[20:]))


@pytest.mark.parametrize(('seed', 'world'), [
    (2, {'radio_range': 35.0}),
    (1, {'radio_range': 45.0, 'min_speed': 1e-3, 'max_speed': 1e-3})], ids=['moving', 'parked'])
def test_a_fleet_is_honest_with_the_guard_and_overconfident_without(
    seed: int, world: dict[str, float],
) -> None:
    low, high = nees_band(2, FLEET['vehicles'])
    assert low < nees(seed, echo_guard=1.0, **world) < high
    assert nees(seed, echo_guard=0.0, **world) > high
