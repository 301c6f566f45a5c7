"""What anchors say of themselves, against the map and what they said before."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.model.claims import Claims
from tsmcl_ros.model.silence import Anchors
from tsmcl_ros.types import ANCHOR, Observation, PADDED, split, VEHICLE


def heard(*vehicles, kind=ANCHOR, hops=1):
    """Return what vehicles hear: rows of an id and a place each."""
    table = Observation.empty(len(vehicles), max(map(len, vehicles)), 2, 0.0)
    for vehicle, rows in enumerate(vehicles):
        for row, (sender, place) in enumerate(rows):
            table.sender[vehicle, row], table.position[vehicle, row] = sender, place
    table.kind[:], table.hops[:] = kind, hops
    return table


def claims(*anchors):
    """Return claims that know a map of an id and a place each."""
    found = Claims(2)
    if anchors:
        found.learn_map(Anchors(
            np.array([sender for sender, _ in anchors]),
            np.array([place for _, place in anchors], np.float32), np.ones(len(anchors))))
    return found


def disproved(found, observation):
    return [tuple(pair) for pair in zip(*map(
        np.ndarray.tolist, split(found.disproved(observation))), strict=True)]


def test_anchors_where_the_map_has_them_are_right():
    assert not disproved(claims((1, (0, 0)), (2, (5, 5))), heard([(1, (0.9, -0.9)), (2, (5, 5))]))


@pytest.mark.parametrize('place', [(0, 1.1), (-1.1, 0), (500, 500)])
def test_an_anchor_elsewhere_than_the_map_has_it_is_disproved(place):
    assert disproved(claims((1, (0, 0)), (2, (5, 5))), heard([(2, (5, 5))], [(1, place)])) == [
        (1, 1)]


def test_a_vehicle_with_the_id_of_an_anchor_of_the_map_is_disproved():
    assert disproved(claims((1, (0, 0))), heard([(1, (0, 0)), (2, (0, 0))], kind=VEHICLE)) == [
        (0, 1)]


def test_an_anchor_that_claims_another_place_than_before_is_disproved():
    found = claims()
    assert not disproved(found, heard([(1, (0, 0)), (2, (5, 5))]))
    assert disproved(found, heard([(1, (0, 20)), (2, (5, 5))])) == [(0, 1)]


def test_an_anchor_that_has_moved_once_is_disproved_once():
    found = claims()
    disproved(found, heard([(1, (0, 0))]))
    disproved(found, heard([(1, (0, 20))]))
    assert not disproved(found, heard([(1, (0, 20))]))


def test_one_vehicle_knows_what_another_one_heard_before():
    found = claims()
    disproved(found, heard([(1, (0, 0))], []))
    assert disproved(found, heard([], [(1, (0, 20))])) == [(1, 1)]


def test_of_two_places_of_one_id_none_is_believed():
    assert disproved(claims(), heard([(1, (0, 0)), (1, (0, 20))], [(1, (0, 0))])) == [
        (0, 1), (1, 1)]


def test_a_vehicle_with_the_id_of_an_anchor_that_was_heard_is_disproved():
    found = claims()
    disproved(found, heard([(1, (0, 0))]))
    assert disproved(found, heard([(1, (0, 0))], kind=VEHICLE)) == [(0, 1)]


def test_vehicles_may_move():
    found = claims()
    disproved(found, heard([(1, (0, 0))], kind=VEHICLE))
    assert not disproved(found, heard([(1, (0, 20))], kind=VEHICLE))


def test_the_map_outlives_what_was_heard():
    found = claims((1, (0, 0)))
    disproved(found, heard([(2, (0, 0))]))
    found.forget()
    assert disproved(found, heard([(1, (0, 20)), (2, (0, 20))])) == [(0, 1)]


def test_padding_claims_nothing():
    assert not disproved(claims((1, (0, 0))), heard([(PADDED, (7, 7))]))
