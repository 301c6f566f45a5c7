"""Random waypoint against its known stationary distribution."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.mobility.random_waypoint import (
    _mean_leg,
    RandomWaypoint,
    RandomWaypointConfig,
)
from tsmcl_ros.types import ConfigError

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
FLEET = 4000


def fleet(vehicles: int = FLEET, seed: int = 1, **settings: object) -> RandomWaypoint:
    config = RandomWaypointConfig(**settings)  # type: ignore[arg-type]
    return RandomWaypoint(config, vehicles, np.random.default_rng(seed))


def speeds(mobility: RandomWaypoint) -> np.ndarray:
    return np.linalg.norm(mobility.state.velocity, axis=1)


@pytest.mark.parametrize(('size', 'known'), [
    ([1.0, 1.0], (2 + math.sqrt(2) + 5 * math.log(1 + math.sqrt(2))) / 15),
    ([1.0, 1.0, 1.0], 0.66170718226717623515),  # Robbins' constant
    ([9.0, 1e-6], 3.0),
])
def test_mean_leg_is_the_mean_distance_of_two_points_in_a_box(size, known) -> None:
    assert _mean_leg(np.array(size)) == pytest.approx(known, rel=1e-6)


def test_a_flat_area_gives_two_dimensions() -> None:
    assert fleet(3).state.position.shape == (3, 2)


def test_an_area_with_height_gives_three_dimensions() -> None:
    assert fleet(3, area_z=100.0).state.velocity.shape == (3, 3)


def test_vehicles_stay_inside_the_area() -> None:
    mobility = fleet(500, area_x=300.0, area_y=200.0, area_z=50.0)
    for _ in range(50):
        position = mobility.step(7.0).position
        assert np.all((position >= 0) & (position <= [300.0, 200.0, 50.0]))


def test_speeds_stay_between_slowest_and_fastest() -> None:
    mobility = fleet(min_speed=5.0, max_speed=50.0)
    mobility.step(100.0)
    assert 5.0 <= speeds(mobility).min() < 6.0
    assert 49.0 < speeds(mobility).max() <= 50.0


def test_no_vehicle_covers_more_ground_than_its_fastest_leg_allows() -> None:
    mobility = fleet(area_x=100.0, area_y=100.0, max_speed=50.0)
    before = mobility.state.position
    after = mobility.step(0.7).position
    assert np.linalg.norm(after - before, axis=1).max() <= 0.7 * 50.0 + 1e-9


def test_between_waypoints_a_vehicle_goes_straight_at_its_velocity() -> None:
    mobility = fleet(area_x=1e5, area_y=1e5)
    before = mobility.state
    after = mobility.step(0.5)
    same_leg = np.all(after.velocity == before.velocity, axis=1)
    assert same_leg.mean() > 0.99
    np.testing.assert_allclose(
        after.position[same_leg], (before.position + 0.5 * before.velocity)[same_leg], atol=1e-8)


@pytest.mark.parametrize('pause', [0.0, 3.0])
def test_the_way_does_not_depend_on_how_time_is_cut_into_steps(pause) -> None:
    settings = {'area_x': 200.0, 'area_y': 100.0, 'area_z': 20.0, 'pause': pause}
    once, often = fleet(50, **settings), fleet(50, **settings)
    once.step(100.0)  # through a dozen waypoints at a time
    for _ in range(500):
        often.step(0.2)
    np.testing.assert_allclose(often.state.position, once.state.position, atol=1e-6)
    np.testing.assert_allclose(often.state.velocity, once.state.velocity, atol=1e-6)
    np.testing.assert_allclose(often.state.yaw, once.state.yaw, atol=1e-6)


def test_the_same_seed_gives_the_same_bits() -> None:
    np.testing.assert_array_equal(fleet(9).step(999.0).position, fleet(9).step(999.0).position)


def test_another_seed_gives_another_way() -> None:
    assert np.all(fleet(9, seed=1).state.position != fleet(9, seed=2).state.position)


def test_a_step_of_no_time_changes_nothing() -> None:
    mobility = fleet(9)
    before = mobility.state
    after = mobility.step(0.0)
    np.testing.assert_array_equal(after.position, before.position)
    np.testing.assert_array_equal(after.velocity, before.velocity)


def test_a_state_stays_as_it_was_when_the_vehicles_move_on() -> None:
    mobility = fleet(9)
    state = mobility.state
    kept = state.position.copy()
    mobility.step(10.0)
    np.testing.assert_array_equal(state.position, kept)


def test_yaw_is_the_direction_of_travel() -> None:
    state = fleet(100).step(300.0)
    np.testing.assert_allclose(
        state.yaw, np.arctan2(state.velocity[:, 1], state.velocity[:, 0]), atol=1e-12)


def test_a_standing_vehicle_keeps_its_yaw() -> None:
    mobility = fleet(area_x=100.0, area_y=100.0, pause=1000.0)
    before = mobility.state
    after = mobility.step(1.0)
    stood = np.all(before.velocity == 0, axis=1) & np.all(after.velocity == 0, axis=1)
    assert stood.sum() > 1000
    np.testing.assert_array_equal(after.yaw[stood], before.yaw[stood])


def test_steady_speeds_are_in_proportion_to_the_time_spent_at_them() -> None:
    found = speeds(fleet(min_speed=5.0, max_speed=50.0))
    expected = stats.loguniform(5.0, 50.0)
    assert stats.kstest(found, expected.cdf).pvalue > SIGNIFICANCE


@pytest.mark.accuracy
@pytest.mark.parametrize('settings', [
    {'pause': 0.0}, {'pause': 60.0}, {'pause': 60.0, 'area_z': 2000.0},
])
def test_a_steady_start_is_what_a_uniform_one_comes_to_in_the_long_run(settings) -> None:
    steady = fleet(seed=3, **settings).state
    late = fleet(seed=4, start_distribution='uniform', **settings).step(20_000.0)
    for axis in range(steady.position.shape[1]):
        for now, then in ((steady.position, late.position), (steady.velocity, late.velocity)):
            assert stats.ks_2samp(now[:, axis], then[:, axis]).pvalue > SIGNIFICANCE


def test_a_steady_fleet_stays_what_it_is() -> None:
    mobility = fleet(seed=5, pause=60.0)
    before, after = mobility.state, mobility.step(130.0)
    centre = np.array([2000.0, 2000.0])
    for one, other in ((before.position - centre, after.position - centre),
                       (before.velocity, after.velocity)):
        radii = np.linalg.norm(one, axis=1), np.linalg.norm(other, axis=1)
        assert stats.ks_2samp(*radii).pvalue > SIGNIFICANCE


def test_a_steady_fleet_stands_for_the_share_of_time_that_pauses_take() -> None:
    standing = np.all(fleet(pause=60.0).state.velocity == 0, axis=1)
    mean_length = 0.5214054331647207 * 4000.0
    mean_drive = mean_length * math.log(50.0 / 5.0) / 45.0
    expected = 60.0 / (60.0 + mean_drive)
    assert stats.binomtest(int(standing.sum()), FLEET, expected).pvalue > SIGNIFICANCE


def test_a_uniform_start_covers_the_area_evenly() -> None:
    position = fleet(start_distribution='uniform').state.position
    for axis in range(2):
        assert stats.kstest(position[:, axis] / 4000.0, 'uniform').pvalue > SIGNIFICANCE


def test_a_uniform_start_drives_at_uniform_speeds() -> None:
    found = speeds(fleet(start_distribution='uniform'))
    assert stats.kstest(found, stats.uniform(5.0, 45.0).cdf).pvalue > SIGNIFICANCE


def test_one_speed_for_all_is_allowed() -> None:
    np.testing.assert_allclose(speeds(fleet(9, min_speed=10.0, max_speed=10.0)), 10.0)


def test_a_slowest_speed_above_the_fastest_is_refused() -> None:
    with pytest.raises(ConfigError, match='min_speed: 60.0 .* at most max_speed, 50 m/s'):
        RandomWaypointConfig(min_speed=60.0)


def test_a_slowest_speed_of_zero_is_refused_for_it_has_no_steady_state() -> None:
    with pytest.raises(ConfigError, match='min_speed'):
        RandomWaypointConfig(min_speed=0.0)


@pytest.mark.parametrize('elapsed', [-1.0, math.nan, math.inf])
def test_time_that_cannot_elapse_is_refused(elapsed) -> None:
    with pytest.raises(ConfigError, match='at least 0 s'):
        fleet(2).step(elapsed)
