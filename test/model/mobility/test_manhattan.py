"""Vehicles in a grid city: where they are, how they turn, and that they start as they go on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.mobility.manhattan import Manhattan, ManhattanConfig

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
CITY = {'area_x': 1000.0, 'area_y': 600.0, 'blocks_x': 5, 'blocks_y': 4}
BLOCK = np.array([200.0, 150.0])


def fleet(vehicles: int = 2000, seed: int = 1, **settings: object) -> Manhattan:
    config = ManhattanConfig(**{**CITY, **settings})  # type: ignore[arg-type]
    return Manhattan(config, vehicles, np.random.default_rng(seed))


def on_street(position: np.ndarray) -> np.ndarray:
    """Tell of each vehicle whether it is in the middle of a street."""
    blocks = position / BLOCK
    return np.isclose(blocks, blocks.round(), rtol=0, atol=1e-9).any(axis=1)


def turns(seed: int, **settings: object) -> tuple[np.ndarray, np.ndarray]:
    """
    Return where vehicles crossed, in blocks (n, 2), and what they did there.

    That is 1 to the left, -1 to the right, 0 straight on and 2 back. They are watched so often
    that nobody passes two crossings in between.
    """
    mobility = fleet(300, seed, **settings)
    before = mobility.state
    places, actions = [], []
    for _ in range(200):
        after = mobility.step(2.5)
        speed = np.linalg.norm(before.velocity, axis=1, keepdims=True)
        one = before.velocity / speed
        blocks = before.position / BLOCK
        place = np.where(one > 0.5, np.floor(blocks + 1 + 1e-9), np.where(
            one < -0.5, np.ceil(blocks - 1 - 1e-9), blocks.round()))
        crossed = np.sum(np.abs(place * BLOCK - before.position), axis=1) < 2.5 * speed[:, 0]
        other = after.velocity / np.linalg.norm(after.velocity, axis=1, keepdims=True)
        cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
        action = np.where(np.sum(one * other, axis=1) < -0.5, 2, np.round(cross))
        places.append(place[crossed])
        actions.append(action[crossed])
        before = after
    return np.concatenate(places), np.concatenate(actions)


def test_vehicles_are_always_on_a_street() -> None:
    mobility = fleet()
    assert on_street(mobility.state.position).all()
    for _ in range(50):
        assert on_street(mobility.step(3.3).position).all()


def test_vehicles_stay_in_the_city() -> None:
    mobility = fleet()
    for _ in range(50):
        position = mobility.step(7.0).position
        assert np.all((position >= 0) & (position <= [1000.0, 600.0]))


def test_vehicles_drive_along_their_street() -> None:
    state = fleet().step(100.0)
    assert np.all((state.velocity == 0).sum(axis=1) == 1)
    np.testing.assert_allclose(
        state.yaw, np.arctan2(state.velocity[:, 1], state.velocity[:, 0]), atol=1e-12)


def test_speeds_stay_between_slowest_and_fastest() -> None:
    mobility = fleet(min_speed=5.0, max_speed=15.0)
    for _ in range(20):
        speeds = np.linalg.norm(mobility.step(5.0).velocity, axis=1)
        assert np.all((speeds >= 5.0) & (speeds <= 15.0))


def test_a_vehicle_keeps_its_speed_until_it_turns() -> None:
    mobility = fleet(turn_probability=0.0, area_x=1e5, area_y=1e5)
    before = mobility.state
    after = mobility.step(1.0)
    same = np.all(np.sign(before.velocity) == np.sign(after.velocity), axis=1)
    assert same.mean() > 0.9
    np.testing.assert_array_equal(after.velocity[same], before.velocity[same])


def test_inside_the_city_half_go_straight_on_and_a_quarter_to_each_side() -> None:
    place, action = turns(seed=2, max_speed=40.0)
    inside = np.all((place > 0) & (place < [5, 4]), axis=1)
    found = [int(np.sum(action[inside] == kind)) for kind in (0, 1, -1)]
    total = sum(found)
    assert total > 5000
    assert total == inside.sum()
    for count, share in zip(found, (0.5, 0.25, 0.25), strict=True):
        assert stats.binomtest(count, total, share).pvalue > SIGNIFICANCE


def test_the_share_of_turns_is_the_turn_probability() -> None:
    place, action = turns(seed=3, max_speed=40.0, turn_probability=0.2)
    inside = np.all((place > 0) & (place < [5, 4]), axis=1)
    turned = int(np.sum(action[inside] != 0))
    assert stats.binomtest(turned, int(inside.sum()), 0.2).pvalue > SIGNIFICANCE


def test_nobody_turns_back() -> None:
    _, action = turns(seed=4, max_speed=40.0)
    assert np.all(action != 2)


@pytest.mark.accuracy
def test_a_steady_fleet_stays_on_all_streets_alike_and_at_all_speeds() -> None:
    mobility = fleet(8000, seed=5)
    before, after = mobility.state, mobility.step(300.0)
    for axis in range(2):
        for one, other in ((before.position, after.position), (before.velocity, after.velocity)):
            assert stats.ks_2samp(one[:, axis], other[:, axis]).pvalue > SIGNIFICANCE


def test_streets_are_used_in_proportion_to_their_length() -> None:
    along_x = int(np.sum(fleet().step(200.0).velocity[:, 1] == 0))
    share = 5 * 1000 / (5 * 1000 + 6 * 600)
    assert stats.binomtest(along_x, 2000, share).pvalue > SIGNIFICANCE


@pytest.mark.accuracy
def test_the_way_does_not_depend_on_how_time_is_cut_into_steps() -> None:
    once, often = fleet(50), fleet(50)
    once.step(100.0)
    for _ in range(500):
        often.step(0.2)
    np.testing.assert_allclose(often.state.position, once.state.position, atol=1e-6)
    np.testing.assert_allclose(often.state.velocity, once.state.velocity, atol=1e-6)
    np.testing.assert_allclose(often.state.yaw, once.state.yaw, atol=1e-6)


def test_the_same_seed_gives_the_same_bits() -> None:
    np.testing.assert_array_equal(fleet(9).step(999.0).position, fleet(9).step(999.0).position)


@pytest.mark.parametrize('blocks', [(1, 1), (1, 7)])
def test_a_city_may_be_a_single_block_or_row(blocks) -> None:
    mobility = fleet(100, blocks_x=blocks[0], blocks_y=blocks[1])
    position = mobility.step(500.0).position
    assert np.all((position >= 0) & (position <= [1000.0, 600.0]))
