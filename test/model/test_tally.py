"""Counts of what was left out."""

from __future__ import annotations

from tsmcl_ros.model.tally import Tally, untrue_note


def test_the_reason_is_that_of_the_last_sender_that_came_new() -> None:
    tally = Tally(2)
    tally.count(0, [7], 'its range')
    tally.count(1, [9, 7], 'its kind')
    tally.count(0, [7], 'its range')
    assert tally.ignored.tolist() == [2, 2]
    assert untrue_note(tally.news(), tally.reason) == (
        'left out beacons that cannot be true, 3 of id 7, 1 of id 9, such as: its kind')
    assert tally.news() == {}


def test_of_many_ids_that_somebody_makes_up_a_hundred_are_kept() -> None:
    tally = Tally(1)
    for first in range(0, 4000, 40):
        tally.count(0, list(range(first, first + 40)), 'a lie')
    assert (tally.ignored.tolist(), len(tally.senders)) == ([4000], 100)
