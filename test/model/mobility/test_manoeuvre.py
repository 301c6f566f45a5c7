"""Manoeuvres against the integral of their own velocity, and against what they promise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.mobility.base import wrap
from tsmcl_ros.model.mobility.manoeuvre import Manoeuvre, ManoeuvreConfig
from tsmcl_ros.types import ConfigError

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
ENDLESS = {'area_x': 1e5, 'area_y': 1e5}


def fleet(vehicles: int = 1000, seed: int = 1, **settings: object) -> Manoeuvre:
    config = ManoeuvreConfig(**settings)  # type: ignore[arg-type]
    return Manoeuvre(config, vehicles, np.random.default_rng(seed))


def speeds(mobility: Manoeuvre) -> np.ndarray:
    return np.linalg.norm(mobility.state.velocity, axis=1)


def turned(mobility: Manoeuvre, elapsed: float) -> np.ndarray:
    """Return by how much the vehicles turn in that time [rad]."""
    before = mobility.state.yaw
    return wrap(mobility.step(elapsed).yaw - before)


def test_the_way_is_the_integral_of_the_velocity() -> None:
    mobility = fleet(200, **ENDLESS, max_turn_rate=1.0, max_acceleration=5.0)
    begin, way, step = mobility.state.position, np.zeros((200, 2)), 0.02
    mobility.step(step / 2)
    for _ in range(1500):
        way += step * mobility.state.velocity
        mobility.step(step)
    end = mobility.state.position
    inside = np.all((end > 3e3) & (end < 9.7e4) & (begin > 3e3) & (begin < 9.7e4), axis=1)
    assert inside.sum() > 150
    moved = end - step / 2 * mobility.state.velocity - begin  # we are half a step further
    # The midpoint rule misses by step^2/8 times what the acceleration, centripetal up to
    # 50 m/s^2, changes by where a segment ends, and less within.
    np.testing.assert_allclose(moved[inside], way[inside], atol=6 * 0.02 ** 2 / 8 * 100)


def test_without_turns_and_accelerations_velocity_is_constant() -> None:
    mobility = fleet(turn_share=0.0, acceleration_share=0.0, **ENDLESS)
    before = mobility.state
    after = mobility.step(60.0)
    kept = np.all(np.sign(before.velocity) == np.sign(after.velocity), axis=1)  # no edge met
    assert kept.mean() > 0.9
    np.testing.assert_allclose(after.velocity[kept], before.velocity[kept], atol=1e-9)
    np.testing.assert_allclose(
        after.position[kept], (before.position + 60.0 * before.velocity)[kept], atol=1e-6)


def test_a_turn_alone_is_a_circle() -> None:
    mobility = fleet(turn_share=1.0, acceleration_share=0.0, min_segment=1000.0,
                     max_segment=1000.0, **ENDLESS)
    begin = mobility.state.position
    points = np.array([mobility.step(2.0).position for _ in range(3)])
    speed, rate = speeds(mobility), turned(mobility, 1.0)
    a, b, c = (np.linalg.norm(points[i] - points[j], axis=1) for i, j in ((0, 1), (1, 2), (0, 2)))
    # Three points of a circle: its radius is the product of the sides over four areas.
    one, other = points[1] - points[0], points[2] - points[0]
    area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    far = np.all((begin > 500) & (begin < 1e5 - 500), axis=1)  # from the edges
    tight = far & (np.abs(rate) > 0.01)
    np.testing.assert_allclose(
        (a * b * c / (4 * area))[tight], (speed / np.abs(rate))[tight], rtol=1e-4)


def test_no_turn_is_faster_than_the_fastest() -> None:
    mobility = fleet(turn_share=1.0, max_turn_rate=0.2, min_segment=50.0, max_segment=50.0,
                     **ENDLESS)
    rates = np.abs(turned(mobility, 1.0))
    assert 0.19 < np.sort(rates)[-5] <= 0.2 + 1e-9


def test_the_share_of_turns_is_that_asked_for() -> None:
    mobility = fleet(4000, turn_share=0.3, min_segment=50.0, max_segment=50.0, **ENDLESS)
    turns = int(np.sum(np.abs(turned(mobility, 10.0)) > 1e-9))
    assert stats.binomtest(turns, 4000, 0.3).pvalue > SIGNIFICANCE


def test_speeds_stay_between_slowest_and_fastest() -> None:
    mobility = fleet(min_speed=2.0, max_speed=20.0, acceleration_share=1.0, max_acceleration=10.0)
    for _ in range(100):
        mobility.step(3.0)
        assert np.all((speeds(mobility) > 2.0 - 1e-9) & (speeds(mobility) < 20.0 + 1e-9))


def test_no_acceleration_is_stronger_than_the_strongest() -> None:
    mobility = fleet(max_acceleration=0.5, acceleration_share=1.0)
    before = speeds(mobility)
    mobility.step(2.0)
    assert 0.45 < (np.abs(speeds(mobility) - before) / 2.0).max() <= 0.5 + 1e-9


def test_vehicles_stay_inside_the_area() -> None:
    mobility = fleet(area_x=300.0, area_y=200.0)
    for _ in range(100):
        position = mobility.step(7.0).position
        assert np.all((position >= 0) & (position <= [300.0, 200.0]))


def test_an_edge_mirrors_the_way() -> None:
    settings = {'turn_share': 0.0, 'acceleration_share': 0.0}
    wide, narrow = fleet(**settings, area_x=2e4), fleet(**settings, area_x=1e4)
    # The same draws: the narrow area's starts are half as far along x.
    begin = narrow.state
    end = narrow.step(30.0)
    straight = begin.position + 30.0 * begin.velocity
    beyond = straight[:, 0] > 1e4
    assert beyond.sum() > 10
    np.testing.assert_allclose(end.position[beyond, 0], 2e4 - straight[beyond, 0], atol=1e-6)
    np.testing.assert_allclose(end.velocity[beyond, 0], -begin.velocity[beyond, 0], atol=1e-9)
    np.testing.assert_allclose(wide.state.velocity, begin.velocity)


def test_places_and_headings_stay_uniform() -> None:
    mobility = fleet(4000, area_x=1000.0, area_y=500.0)
    state = mobility.step(500.0)
    assert stats.kstest(state.position[:, 0] / 1000.0, 'uniform').pvalue > SIGNIFICANCE
    assert stats.kstest(state.position[:, 1] / 500.0, 'uniform').pvalue > SIGNIFICANCE
    assert stats.kstest(state.yaw / (2 * math.pi) + 0.5, 'uniform').pvalue > SIGNIFICANCE


def test_yaw_is_the_direction_of_travel() -> None:
    state = fleet().step(300.0)
    np.testing.assert_allclose(
        state.yaw, np.arctan2(state.velocity[:, 1], state.velocity[:, 0]), atol=1e-12)


def test_the_way_does_not_depend_on_how_time_is_cut_into_steps() -> None:
    once, often = fleet(50), fleet(50)
    once.step(100.0)  # through a dozen segments at a time
    for _ in range(500):
        often.step(0.2)
    np.testing.assert_allclose(often.state.position, once.state.position, atol=1e-6)
    np.testing.assert_allclose(often.state.velocity, once.state.velocity, atol=1e-6)


def test_the_same_seed_gives_the_same_bits() -> None:
    np.testing.assert_array_equal(fleet(9).step(999.0).position, fleet(9).step(999.0).position)


def test_a_shortest_manoeuvre_longer_than_the_longest_is_refused() -> None:
    with pytest.raises(ConfigError, match='min_segment: 60.0 .* at most max_segment, 30 s'):
        ManoeuvreConfig(min_segment=60.0)


@pytest.mark.parametrize('elapsed', [-1.0, math.nan, math.inf])
def test_time_that_cannot_elapse_is_refused(elapsed) -> None:
    with pytest.raises(ConfigError, match='at least 0 s'):
        fleet(2).step(elapsed)
