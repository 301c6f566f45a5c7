"""The echo guard: by hand in one line of sight, and by the honesty of whole fleets."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.evaluation.metrics import nees_band, normalized_error_squared
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.echo import certain, guard, handed_on, Hearsay
from tsmcl_ros.model.relay import Poses
from tsmcl_ros.types import ANCHOR, Estimate, Observation, PADDED, VEHICLE
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


# What is inherited from references

AROUND = [(20, 0), (-20, 0), (0, 20), (0, -20)]


def estimated(covariance: np.ndarray, mean: np.ndarray = MEAN) -> Estimate:
    nothing = np.zeros(1)
    return Estimate(1.0, mean, covariance, nothing, nothing, nothing, 1, nothing, nothing,
                    np.zeros(1, bool))


def inherited(hearsay: Hearsay, covariance: np.ndarray, observation: Observation) -> np.ndarray:
    """Return what ranges of 1 m to all references add to the covariance."""
    std = np.ones(observation.sender.shape)
    total = hearsay.add(estimated(covariance), observation, observation, std, observation.heard)
    return np.asarray(total.covariance - covariance)


def test_one_placed_by_vehicles_alone_inherits_their_whole_error() -> None:
    # Four ranges of 1 m to references of 3 m^2: a variance of (1 + 3) / 2 along each axis.
    added = inherited(Hearsay(1, 2), 2.0 * np.eye(2)[None], heard(*AROUND, variance=3.0))
    np.testing.assert_allclose(added, 3.0 * np.eye(2)[None], atol=1e-5)


def test_nothing_is_inherited_from_anchors() -> None:
    added = inherited(Hearsay(1, 2), COVARIANCE, heard(*AROUND, kind=ANCHOR))
    np.testing.assert_array_equal(added, 0)


def test_ranges_to_anchors_wear_down_what_was_inherited() -> None:
    hearsay = Hearsay(1, 2)
    hearsay.covariance[:] = 4.0 * np.eye(2)
    # A posterior of 0.25 m^2 from two ranges of 1 m along each axis: a gain of one half.
    added = inherited(hearsay, 0.25 * np.eye(2)[None], heard(*AROUND, variance=0.0, kind=ANCHOR))
    np.testing.assert_allclose(added, np.eye(2)[None], atol=1e-5)


@pytest.mark.parametrize(('variance', 'owed'), [(3.0, 1.5), (0.0, 0.0)])
def test_a_placed_vehicle_hands_on_what_its_references_made_it_err(
    variance: float, owed: float,
) -> None:
    # The mean of two opposite references along each axis, each heard with an error of its own.
    observation = heard(*AROUND, variance=variance)
    estimate = estimated((1.0 + variance) / 2 * np.eye(2)[None])
    found = handed_on(estimate, observation, np.ones((1, 4)), observation.heard)
    np.testing.assert_allclose(found, owed * np.eye(2)[None], atol=1e-6)


def test_who_is_placed_anew_inherits_nothing_of_what_it_believed() -> None:
    hearsay = Hearsay(1, 2)
    hearsay.covariance[:] = 4.0 * np.eye(2)
    hearsay.forget(0)
    np.testing.assert_array_equal(hearsay.covariance, 0)


def test_without_an_estimate_nothing_is_inherited() -> None:
    unknown = estimated(np.full((1, 2, 2), np.nan), np.full((1, 2), np.nan))
    observation = heard(*AROUND)
    hearsay = Hearsay(1, 2)
    hearsay.add(unknown, observation, observation, np.ones((1, 4)), observation.heard)
    np.testing.assert_array_equal(hearsay.covariance, 0)


def test_references_that_share_one_error_do_not_make_sure() -> None:
    # A Kalman filter of 2000 vehicles that takes four references' errors for independent news in
    # each of 30 epochs, though all have one and the same error all the time.
    rng = np.random.default_rng(1)
    shared = rng.normal(0, np.sqrt(3.0), (2000, 1))
    error, own = rng.normal(0, 5.0, (2000, 1)), 25.0
    hearsay, observation = Hearsay(1, 2), heard(*AROUND, variance=3.0)
    for _ in range(30):
        gain = own / (own + (1.0 + 3.0) / 2)
        noise = rng.normal(0, np.sqrt(0.5), error.shape)
        error, own = error + gain * (shared + noise - error), (1 - gain) * own
        total = own + inherited(hearsay, own * np.eye(2)[None], observation)[0, 0, 0]
    assert own < 0.1
    assert 0.7 < np.var(error) / total < 1.1


def test_vehicles_that_know_an_axis_exactly_are_found_and_anchors_are_not() -> None:
    some = heard((20, 0), (30, 0))
    some.covariance[0, 1] = 0
    rows, fault = certain(some)
    assert rows.tolist() == [[False, True]]
    assert 'vehicle 1 claims a singular covariance' in fault
    for others in (heard((20, 0), variance=0.0, kind=ANCHOR), heard((20, 0))):
        rows, fault = certain(others)
        assert not rows.any() and fault == ''


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


@pytest.mark.accuracy
@pytest.mark.parametrize(('seed', 'world'), [
    (4, {'radio_range': 35.0}),
    (1, {'radio_range': 45.0, 'min_speed': 1e-3, 'max_speed': 1e-3}),
    (3, {'radio_range': 35.0})], ids=['moving', 'parked', 'much from others'])
def test_a_fleet_is_honest_with_the_guard_and_overconfident_without(
    seed: int, world: dict[str, float],
) -> None:
    low, high = nees_band(2, FLEET['vehicles'])
    assert low < nees(seed, echo_guard=1.0, **world) < high
    assert nees(seed, echo_guard=0.0, **world) > high
