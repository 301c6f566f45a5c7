"""Vehicles that go on where another localizer left them, against the truth of a simulation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.health import OK, STALE
from tsmcl_ros.model.resume import Last, resumed
from tsmcl_ros.scripts.scenario import LOCALIZER
from tsmcl_ros.types import Observation, Prior
from tsmcl_ros.world import make_world

# Poses from the first beacon on, and of ranges that need no calibration, which is learnt again.
SETTINGS = {**LOCALIZER, 'range_calibration': 'off', 'hold_circles': False}
VEHICLES, BEFORE, AWAY = 20, 30, 3
WORLD = {'vehicles': VEHICLES, 'radio_range': 1000.0}
LAST = Last(3, 100.0, np.array([10.0, 20.0]), 4 * np.eye(2), np.pi / 2, 0.01,
            np.array([500.0, 0.0, 0.0, 0.3]), 8.0)


def after(stamp: float, odometry: list[float], last: Last = LAST) -> Prior:
    found = resumed(last, stamp, np.array(odometry), max_speed=50.0, radio_range=1000.0)
    assert found is not None
    return found


def test_odometry_that_went_on_leads_from_the_last_pose_to_the_present_one() -> None:
    found = after(102.0, [515.0, 0.0, 0.0, 0.4])
    np.testing.assert_allclose(found.mean, [10.0, 35.0])
    # A tenth of the way, and as far as the rotation is uncertain over it.
    np.testing.assert_allclose(found.covariance, (4 + 15**2 * (0.1**2 + 0.01)) * np.eye(2))
    assert found.vehicle == 3
    # The vehicle's yaw, of which the localizer takes the odometry's.
    assert found.yaw == pytest.approx(np.pi / 2 + 0.4)
    assert found.yaw_std == pytest.approx(0.1)


@pytest.mark.parametrize('odometry', [
    [0.0, 0.0, 0.0, 0.0],  # begun anew
    [3.0, 0.0, 0.0, 0.0],  # begun anew and gone on
    [560.0, 0.0, 0.0, 0.0],  # too far away to be the same
    [np.nan] * 4,  # gone
])
def test_other_odometry_leaves_the_pose_uncertain_by_the_way_the_vehicle_can_have_gone(
    odometry: list[float],
) -> None:
    found = after(102.0, odometry)
    np.testing.assert_array_equal(found.mean, LAST.mean)
    # 8 m/s for 2 s, and as much as 3 m/s^2 add.
    np.testing.assert_allclose(found.covariance, (4 + (16 + 6) ** 2 / 4) * np.eye(2))
    assert found.yaw is None


def test_without_odometry_a_vehicle_may_have_gone_at_full_speed() -> None:
    found = after(102.0, [np.nan] * 4, replace(LAST, speed=np.nan))
    np.testing.assert_allclose(found.covariance, (4 + 100**2 / 4) * np.eye(2))


@pytest.mark.parametrize('stamp', [99.0, 1000.0])
def test_a_pose_of_later_or_of_long_ago_tells_nothing(stamp: float) -> None:
    assert resumed(LAST, stamp, np.array([515.0, 0.0, 0.0, 0.4]), 50.0, 1000.0) is None


@pytest.mark.accuracy
@pytest.mark.parametrize('measure_range', [False, True])
def test_a_localizer_that_is_started_again_is_right_within_three_epochs(
    measure_range: bool,
) -> None:
    world = make_world({**WORLD, 'measure_range': measure_range}, np.random.default_rng(5))

    def begin() -> Localizer:
        localizer = Localizer(SETTINGS, VEHICLES)
        localizer.anchor_map(world.anchors)
        return localizer

    def step(*localizers: Localizer) -> list[Any]:
        epoch = world.step()
        estimates = [localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
                     for localizer in localizers]
        return [estimate.mean - epoch.position for estimate in estimates], estimates

    never_away = begin()
    for _ in range(BEFORE):
        step(never_away)
    again, fresh = begin(), begin()
    again.resume(never_away.last_known())
    for _ in range(AWAY):
        step(never_away)
    for _ in range(3):
        errors, estimates = step(never_away, again, fresh)
    rmse = [np.sqrt((error ** 2).sum(axis=1).mean()) for error in errors]
    assert rmse[1] < 1.6 * rmse[0]
    assert rmse[1] < 0.7 * rmse[2]
    nees = np.einsum('vi,vij,vj->v', errors[1], np.linalg.inv(estimates[1].covariance), errors[1])
    assert nees.mean() < 3
    assert (again.status == OK).all()


@pytest.mark.accuracy
@pytest.mark.parametrize('measure_range', [False, True])
def test_where_beacons_and_odometry_are_silent_poses_are_stale_and_honest_and_right_soon_after(
    measure_range: bool,
) -> None:
    world = make_world({**WORLD, 'measure_range': measure_range}, np.random.default_rng(6))
    localizer = Localizer(SETTINGS, VEHICLES)
    localizer.anchor_map(world.anchors)
    errors: dict[int, Any] = {}
    inside: dict[int, Any] = {}
    for second in range(1, 36):
        epoch = world.step()
        if 14 < second < 25:  # a link is cut, and the localizer predicts each other second
            if second % 2:
                continue
            nothing = Observation.empty(VEHICLES, 0, 2, epoch.stamp)
            estimate = localizer.epoch(nothing)
            assert (localizer.status == STALE).all()
        else:
            estimate = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
            assert (localizer.status == OK).all()
        error = errors[second] = estimate.mean - epoch.position
        inside[second] = np.einsum(
            'vi,vij,vj->v', error, np.linalg.inv(estimate.covariance), error) < 5.99
    rmse = {second: np.sqrt((error ** 2).sum(axis=1).mean()) for second, error in errors.items()}
    assert rmse[24] > rmse[14] + 50
    assert rmse[25] < rmse[14] + 20
    assert np.mean([inside[second] for second in inside if second >= 14]) > 0.9


def test_lost_vehicles_are_not_kept() -> None:
    world = make_world(WORLD, np.random.default_rng(5))
    localizer = Localizer(SETTINGS, VEHICLES)
    assert localizer.last_known() == []
    epoch = world.step()
    localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
    assert len(localizer.last_known()) == VEHICLES
    localizer._core.credibility.monitor.doubt(np.arange(VEHICLES) < 5)
    assert [last.vehicle for last in localizer.last_known()] == list(range(5, VEHICLES))
