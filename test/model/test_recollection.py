"""What vehicles heard on their way."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.recollection import Recollection


def hear(found, *rows):
    """Let vehicles hear rows of a vehicle, a sender and a place."""
    vehicle, sender, place = zip(*rows, strict=True)
    found.hear(np.array(vehicle), np.array(sender), np.array(place, float),
               np.full(len(rows), 100.0))


def move(found, *ways, variance=4.0):
    found.move(np.array(ways, float), np.full(len(ways), variance))


def recalled(found, vehicle=0):
    disks = found.disks(np.array([vehicle]))
    return {int(sender): disks.centre[:, 0, column].tolist()
            for column, sender in enumerate(disks.sender[0]) if disks.used[0, column]}


def test_a_disk_moves_along_with_the_vehicle():
    found = Recollection(1, 2)
    hear(found, (0, 7, (50, 0)))
    move(found, (10, 5))
    assert recalled(found) == {7: [[60, 5], [60, 5]]}


def test_the_first_and_the_last_time_are_kept():
    found = Recollection(1, 2)
    for _ in range(3):
        hear(found, (0, 7, (50, 0)))
        move(found, (10, 0))
    assert recalled(found) == {7: [[80, 0], [60, 0]]}


def test_what_is_uncertain_of_the_way_grows():
    found = Recollection(1, 2)
    hear(found, (0, 7, (50, 0)))
    move(found, (10, 0))
    hear(found, (0, 7, (50, 0)))
    move(found, (10, 0))
    assert found.disks(np.array([0])).variance[:, 0, 0].tolist() == [8, 4]


def test_vehicles_remember_their_own():
    found = Recollection(3, 2)
    hear(found, (0, 7, (50, 0)), (2, 7, (1, 1)), (2, 8, (2, 2)))
    assert [list(recalled(found, vehicle)) for vehicle in range(3)] == [[7], [], [7, 8]]


def test_a_way_that_nobody_knows_makes_all_before_useless():
    found = Recollection(2, 2)
    hear(found, (0, 7, (50, 0)), (1, 8, (50, 0)))
    move(found, (np.nan, np.nan), (1, 0))
    assert [recalled(found, vehicle) for vehicle in range(2)] == [{}, {8: [[51, 0], [51, 0]]}]


def test_who_is_not_heard_any_more_is_forgotten():
    found = Recollection(1, 2)
    hear(found, (0, 7, (50, 0)))
    for _ in range(100):
        move(found, (0, 0))
        hear(found, (0, 8, (50, 0)))
    assert list(recalled(found)) == [8]
