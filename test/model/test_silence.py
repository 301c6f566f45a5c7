"""Which silences count: who is known, who was heard, and who could have been."""

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.model.silence import KnownAnchors
from tsmcl_ros.types import ANCHOR, MessageError, Observation, VEHICLE

NOWHERE = np.full((1, 2), np.nan)
ANYWHERE = np.zeros(1)


def rows(*identities, position=None, max_range=np.nan, kind=ANCHOR, hops=1):
    """Return what one vehicle heard; anchor i stands at (10 i, 0) m."""
    heard = Observation.empty(1, len(identities), 2, 0.0)
    heard.sender[0] = identities
    heard.position[0, :, 0] = 10 * np.array(identities)
    if position is not None:
        heard.position[0] = position
    heard.max_range[:], heard.kind[:], heard.hops[:] = max_range, kind, hops
    return heard


def both(first, second):
    return Observation.stack([first, second], 0.0)


def silent(observation, vehicle=0):
    """Return the ids of those that a vehicle did not hear."""
    if observation.silent is None:
        return []
    return observation.silent.sender[vehicle, observation.silent.known[vehicle]].tolist()


def listen(anchors, observation, centre=NOWHERE, reach=ANYWHERE):
    return anchors.listen(observation, np.asarray(centre), np.asarray(reach))


def test_anchors_of_the_map_that_are_not_heard_are_silent():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(1, 2, 3, max_range=20))
    heard = listen(anchors, rows(2))
    assert silent(heard) == [1, 3]
    np.testing.assert_array_equal(heard.silent.position[0], [[10, 0], [30, 0]])
    np.testing.assert_array_equal(heard.silent.max_range[0], [20, 20])


def test_without_a_map_nobody_is_silent():
    anchors = KnownAnchors('map', 1, 2)
    listen(anchors, rows(1, 2))
    assert listen(anchors, rows(2)).silent is None


def test_mode_none_knows_nobody():
    anchors = KnownAnchors('none', 1, 2)
    anchors.learn_map(rows(1, 2, 3))
    assert listen(anchors, rows(2)).silent is None


def test_mode_memory_knows_whom_it_has_heard_and_not_the_map():
    anchors = KnownAnchors('memory', 1, 2)
    anchors.learn_map(rows(1, 2, 3, 4))
    assert silent(listen(anchors, rows(1, 2))) == []
    assert silent(listen(anchors, rows(3))) == [1, 2]
    assert silent(listen(anchors, rows())) == [1, 2, 3]


def test_memories_are_each_vehicles_own():
    anchors = KnownAnchors('memory', 2, 2)
    nowhere, anywhere = np.full((2, 2), np.nan), np.zeros(2)
    anchors.listen(both(rows(1), rows(2, 3)), nowhere, anywhere)
    heard = anchors.listen(both(rows(), rows()), nowhere, anywhere)
    assert silent(heard, 0) == [1]
    assert silent(heard, 1) == [2, 3]


def test_rows_are_padded_to_the_vehicle_that_misses_most():
    anchors = KnownAnchors('map', 2, 2)
    anchors.learn_map(rows(1, 2, 3))
    heard = anchors.listen(
        both(rows(1, 2, 3), rows(1)), np.full((2, 2), np.nan), np.zeros(2))
    assert heard.silent.known.tolist() == [[False, False], [True, True]]


def test_who_is_relayed_counts_as_heard():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(1, 2))
    assert silent(listen(anchors, rows(1, hops=2))) == [2]


@pytest.mark.parametrize('heard', [rows(1, hops=2), rows(1, kind=VEHICLE)])
def test_only_anchors_heard_directly_are_remembered(heard):
    anchors = KnownAnchors('memory', 1, 2)
    listen(anchors, heard)
    assert silent(listen(anchors, rows())) == []


def test_a_remembered_anchor_is_where_it_was_heard_last():
    anchors = KnownAnchors('memory', 1, 2)
    listen(anchors, rows(1))
    listen(anchors, rows(1, position=[[7, 8]], max_range=5))
    heard = listen(anchors, rows())
    np.testing.assert_array_equal(heard.silent.position[0], [[7, 8]])
    assert heard.silent.max_range[0] == [5]


@pytest.mark.parametrize(('centre', 'reach', 'expected'), [
    ([0, 0], 0.0, [1, 2]),  # anchor 2 is 20 m away, twice its range
    ([0, 0], 9.9, [1, 2]),
    ([0, 0], 10.1, [1, 2, 3]),  # may be within 20 m of anchor 3 at 30 m
    ([90, 0], 0.0, []),
    ([np.nan, np.nan], 0.0, [1, 2, 3]),
    ([0, 0], np.nan, [1, 2, 3])])
def test_anchors_beyond_twice_their_range_are_left_out(centre, reach, expected):
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(1, 2, 3, max_range=10))
    assert silent(listen(anchors, rows(), [centre], [reach])) == expected


def test_anchors_of_unknown_range_are_never_left_out():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(1, 2))
    assert silent(listen(anchors, rows(), [[1e6, 0]])) == [1, 2]


def test_maps_complete_each_other_and_the_newer_wins():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(1, 3))
    anchors.learn_map(rows(2, 3, position=[[20, 0], [35, 0]]))
    heard = listen(anchors, rows())
    assert silent(heard) == [1, 2, 3]
    np.testing.assert_array_equal(heard.silent.position[0, :, 0], [10, 20, 35])


def test_a_map_may_come_in_any_order():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(5, 1, 3))
    heard = listen(anchors, rows(3))
    assert silent(heard) == [1, 5]
    np.testing.assert_array_equal(heard.silent.position[0, :, 0], [10, 50])


def test_a_map_with_an_id_twice_is_refused():
    with pytest.raises(MessageError, match='id 4 stands in it more than once'):
        KnownAnchors('map', 1, 2).learn_map(rows(4, 2, 4))


def test_forgetting_keeps_the_map():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(1, 2))
    anchors.forget()
    assert silent(listen(anchors, rows())) == [1, 2]


def test_forgetting_clears_the_memory():
    anchors = KnownAnchors('memory', 1, 2)
    listen(anchors, rows(1, 2))
    anchors.forget()
    assert silent(listen(anchors, rows(3))) == []


@pytest.mark.parametrize('mode', ['none', 'memory', 'map'])
def test_a_table_is_checked_against_the_map_in_every_mode(mode):
    anchors = KnownAnchors(mode, 1, 2)
    anchors.learn_map(rows(1, 2))
    anchors.check(rows(1, 2, position=[[10.9, -0.9], [20, 0]]), 'anchor links')
    with pytest.raises(MessageError, match=r'anchor links: anchor 2 claims \[20\.0, 1\.5\] m, '
                                           r'must be where the anchor map has it, \[20\.0, 0'):
        anchors.check(rows(1, 2, position=[[10, 0], [20, 1.5]]), 'anchor links')


def test_who_is_in_no_map_is_not_checked():
    anchors = KnownAnchors('map', 1, 2)
    anchors.check(rows(7, position=[[1, 2]]), 'anchor links')
    anchors.learn_map(rows(1))
    anchors.check(rows(7, position=[[1, 2]]), 'anchor links')


def test_padding_is_nobody():
    anchors = KnownAnchors('map', 1, 2)
    anchors.learn_map(rows(0, 1))
    padded = Observation.empty(1, 3, 2, 0.0)
    anchors.check(padded, 'anchor links')
    assert silent(listen(anchors, padded)) == [0, 1]
    assert silent(listen(anchors, replace(padded, sender=np.array([[-1, 1, -1]])))) == [0]
