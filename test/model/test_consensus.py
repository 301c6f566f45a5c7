"""Whom the majority contradicts, where there is no prediction."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.model.consensus import (
    outvoted_by_disks,
    outvoted_by_ranges,
    supported_by_ranges,
)
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.recollection import Disks
from tsmcl_ros.types import Observation, Silence

CHANNEL = Channel(RadioConfig(radio_range=1000.0))
HARD = Channel(RadioConfig(radio_range=1000.0, edge_softness=5.0))
HERE = np.array([100.0, 50.0])


def ranged(anchors, lies=(), noise=0.0, dimension=2, seed=0):
    """Return ranges to anchors around a place, of which some claim to be elsewhere."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-800, 800, (anchors, dimension))
    table = Observation.empty(1, anchors, dimension, 0.0)
    table.sender[0] = np.arange(anchors)
    here = np.append(HERE, 30.0)[:dimension]
    table.range[0] = np.linalg.norm(place - here, axis=1) + noise * rng.standard_normal(anchors)
    table.range_std[0] = max(noise, 1.0)
    table.position[0] = place
    for lie in lies:
        table.position[0, lie] += rng.choice([-1, 1], dimension) * 1000.0
    return table


def blamed(table):
    return np.flatnonzero(outvoted_by_ranges(CHANNEL, table, 3.0)[0]).tolist()


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('seed', range(5))
def test_nobody_is_outvoted_where_ranges_agree(dimension, seed):
    assert blamed(ranged(7, noise=3.0, dimension=dimension, seed=seed)) == []


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('lies', [(2,), (0, 5)])
def test_whose_ranges_disagree_with_the_others_is_outvoted(dimension, lies):
    assert blamed(ranged(8, lies, noise=3.0, dimension=dimension)) == list(lies)


def test_three_ranges_in_the_plane_tell_no_liar():
    assert blamed(ranged(3, (1,))) == []


def test_where_half_of_them_lie_nobody_is_outvoted():
    assert blamed(ranged(4, (0, 1))) == []


def test_vehicles_are_judged_apart_by_ranges():
    both = Observation.stack([ranged(6, (1,), seed=1), ranged(7, (4,), seed=2)], 0.0)
    found = outvoted_by_ranges(CHANNEL, both, 3.0)
    assert [np.flatnonzero(row).tolist() for row in found] == [[1], [4]]


def supported(table, belief=HERE):
    return supported_by_ranges(
        CHANNEL, table, np.array([belief]), 25 * np.eye(2)[None], 3.0).tolist() == [True]


@pytest.mark.parametrize('heard', [4, 6])
def test_a_right_belief_is_supported_though_half_of_the_ranges_are_lies(heard):
    assert supported(ranged(heard, range(heard // 2)))


@pytest.mark.parametrize('belief', [(900.0, 700.0), (-500.0, 50.0)])
def test_a_belief_is_not_supported_where_more_ranges_agree_on_another_place(belief):
    assert not supported(ranged(5), belief)


def test_a_belief_with_which_one_range_agrees_is_not_supported():
    assert not supported(ranged(3, (0, 1)))


def disks(*centres, radius=1000.0, later=None):
    """Return disks of one vehicle, when first and last heard."""
    place = np.array([centres, centres if later is None else later], float)[:, None]
    rows = (1, len(centres))
    return Disks(np.arange(len(centres))[None], np.ones(rows, bool), place,
                 np.full(rows, radius), np.zeros((2, *rows)))


def verdict(found, mean=(np.nan, np.nan), variance=1.0, silent=None):
    return outvoted_by_disks(
        HARD, found, silent, 3.0, np.array([mean], float), np.array([variance]))


AROUND = [(700, 0), (-700, 0), (0, 700), (0, -700)]


def test_nobody_is_outvoted_where_disks_meet():
    assert not verdict(disks(*AROUND)).against.any()


def test_whose_disk_misses_where_the_others_meet_is_outvoted():
    assert np.flatnonzero(verdict(disks(*AROUND, (1500, 1500))).against).tolist() == [4]


def test_a_way_on_which_it_was_heard_tells_of_a_liar_what_one_place_does_not():
    lie = 950, 650
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    first, last = [*(700 * ring), lie], [*(980 * ring), lie]
    assert not verdict(disks(*first)).against.any()
    assert np.flatnonzero(verdict(disks(*first, later=last)).against).tolist() == [8]


def test_where_two_majorities_are_possible_nobody_is_outvoted():
    assert not verdict(disks((0, 0), (1500, 0), (3000, 0))).against.any()


def test_whom_one_of_two_majorities_contradicts_is_disputed():
    near = [(0, y) for y in (-100, 0, 100)]
    found = verdict(disks(*near, (1500, 0), (-1500, 0)))
    assert not found.against.any()
    assert np.flatnonzero(found.disputed).tolist() == [3, 4]


def test_nobody_is_disputed_where_less_than_three_would_be_left():
    assert not verdict(disks((0, 0), (1500, 0), (3000, 0))).disputed.any()


def test_hard_edges_of_certain_beliefs_are_crossed_without_a_warning():
    sharp = Channel(RadioConfig(radio_range=1000.0, edge_softness=0.0))
    with np.errstate(all='raise'):
        found = outvoted_by_disks(
            sharp, disks(*AROUND, (1500, 1500)), None, 3.0, np.zeros((1, 2)), np.zeros(1))
    assert np.flatnonzero(found.against).tolist() == [4]


def test_of_two_majorities_the_belief_chooses():
    found = verdict(disks((0, 0), (1500, 0), (3000, 0)), mean=(700, 0))
    assert np.flatnonzero(found.against).tolist() == [2]


def test_a_belief_that_more_disks_miss_than_need_to_is_refuted():
    found = disks(*AROUND, (1500, 1500))
    assert verdict(found, mean=(0, 0)).refutation == 0
    assert verdict(found, mean=(900, 900)).refutation == 1


def test_where_most_agree_is_told_by_the_corners_of_it():
    found = verdict(disks(*AROUND, (1500, 1500)))
    np.testing.assert_allclose(found.mean, [[0, 0]], atol=1)
    assert 100 < np.sqrt(found.covariance[0, 0, 0]) < 400


def test_silence_tells_majorities_apart():
    anchor = np.array([[9]]), np.array([[(2250.0, 0.0)]], np.float32), np.array([[1000.0]])
    found = verdict(disks((0, 0), (1500, 0), (3000, 0)), silent=Silence(
        np.ones((1, 1), bool), *anchor))
    assert np.flatnonzero(found.against).tolist() == [2]
