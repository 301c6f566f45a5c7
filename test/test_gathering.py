"""Readings gathered into epochs by their stamps, in whatever order the topics interleave."""

import itertools
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.gathering import gather, Gatherer, period_number, Reading, Track
from tsmcl_ros.types import ANCHOR, MessageError, Observation, VEHICLE

WAIT = 0.5


def gatherer(*topics, vehicles=1, period=0.1, max_age=1.0):
    made = Gatherer(vehicles, period, max_age)
    made.anchors = {5: np.array([5.0, 6.0, 0.0]), 6: np.array([1.0, 0.0, 0.0])}
    for topic in topics:
        made.expect(0, topic)
    return made


def reading(stamp, sender=5, distance=2.0, std=math.nan):
    return Reading(stamp, sender, distance, std)


def moving(made, stamps, sender=3, speed=1.0):
    for stamp in stamps:
        made.move(sender, stamp, np.array([speed * stamp, 0.0, 0.0]), 0.01 * np.eye(3))


def due(made, now, max_wait=WAIT):
    return [scan for _, scan in made.due(now, max_wait)]


# --- one row a sender ------------------------------------------------------------------------

def rows(*senders):
    scan = Observation.empty(1, len(senders), 2, 1.0)
    scan.sender[0] = senders
    scan.position[0, :, 0] = np.arange(len(senders))
    return scan


def test_of_a_sender_heard_twice_the_last_range_counts_and_where_it_was_then():
    scan = rows(7, 4, 7)
    scan.range[0] = [1.0, 2.0, 3.0]
    found = gather(scan)
    assert found.sender.tolist() == [[4, 7]]
    assert found.range.tolist() == [[2.0, 3.0]]
    assert found.position[0, :, 0].tolist() == [1.0, 2.0]


def test_a_beacon_without_a_range_does_not_take_one_away():
    scan = rows(7, 7)
    scan.range[0] = [1.0, np.nan]
    assert gather(scan).range.tolist() == [[1.0]]


def test_rssi_of_a_sender_is_averaged():
    scan = rows(7, 7, 7, 8)
    scan.rssi[0] = [-60.0, np.nan, -70.0, np.nan]
    np.testing.assert_array_equal(gather(scan).rssi, [[-65.0, np.nan]])


@pytest.mark.parametrize(('stamp', 'number'), [(0.0, 0), (0.3, 3), (0.39, 3), (0.1 + 0.2, 3)])
def test_periods_count_from_zero_whatever_decimals_round_to(stamp, number):
    assert period_number(stamp, 0.1) == number


# --- when an epoch is complete ---------------------------------------------------------------

def test_an_epoch_is_complete_once_all_topics_have_passed_its_end():
    made = gatherer('a', 'b')
    made.add(0, 'a', reading(0.02, 5))
    made.add(0, 'b', reading(0.04, 6))
    made.add(0, 'a', reading(0.15, 5))
    assert due(made, 0.15) == []
    made.add(0, 'b', reading(0.17, 6))
    scan, = due(made, 0.17)
    assert scan.sender.tolist() == [[5, 6]]
    assert scan.stamp == 0.04


def test_a_topic_that_is_silent_is_waited_for_no_longer_than_max_wait():
    made = gatherer('a', 'b')
    made.add(0, 'a', reading(0.02))
    assert due(made, 0.4999) == []
    assert len(due(made, 0.5)) == 1


def test_an_epoch_waits_until_its_references_have_moved_past_it():
    made = gatherer('a')
    moving(made, [0.0, 0.09])
    made.add(0, 'a', reading(0.02, 3))
    made.add(0, 'a', reading(0.15, 3))
    assert due(made, 0.15) == []
    moving(made, [0.11])
    assert len(due(made, 0.15)) == 1


def test_at_the_end_all_that_waits_is_handed_over():
    made = gatherer('a', 'b')
    made.add(0, 'a', reading(0.02))
    made.add(0, 'a', reading(0.15))
    assert [scan.stamp for scan in due(made, math.inf)] == [0.02, 0.15]


def test_vehicles_have_epochs_of_their_own():
    made = gatherer('a', vehicles=2)
    made.add(0, 'a', reading(0.02, 5))
    made.add(1, 'b', reading(0.03, 6))
    assert [(vehicle, scan.sender.tolist()) for vehicle, scan in made.due(math.inf, WAIT)] == [
        (0, [[5]]), (1, [[6]])]


@settings(deadline=None)
@given(st.permutations(range(4)), st.integers(0, 100))
def test_epochs_do_not_depend_on_how_topics_interleave(order, seed):
    rng = np.random.default_rng(seed)
    streams = {
        name: [(name, stamp) for stamp in np.sort(rng.uniform(0, 2, 20)).tolist()]
        for name in ('a', 'b', 'c')}
    streams['pose'] = [('pose', 0.05 * k) for k in range(60)]

    def run(rows):
        made, scans = gatherer('a', 'b', 'c'), []
        made.references = {3: Track()}
        for name, stamp in rows:
            if name == 'pose':
                moving(made, [stamp])
            else:
                sender = {'a': 5, 'b': 6, 'c': 3}[name]
                made.add(0, name, reading(stamp, sender, 1 + stamp))
            scans += due(made, 0.0)  # nobody tells the time: only what has passed counts
        scans += due(made, math.inf)
        return [(scan.stamp, scan.sender.tolist(), scan.range.tolist(), scan.position.tolist())
                for scan in scans]

    by_time = sorted(itertools.chain(*streams.values()), key=lambda row: row[1])
    one_after_the_other = [row for k in order for row in list(streams.values())[k]]
    assert run(by_time) == run(one_after_the_other)


# --- where senders are -----------------------------------------------------------------------

def test_an_anchor_and_a_reference_are_told_apart():
    made = gatherer('a')
    moving(made, [0.0, 1.0])
    made.add(0, 'a', reading(0.01, 5, 2.0, 0.25))
    made.add(0, 'a', reading(0.02, 3))
    scan, = due(made, math.inf)
    assert scan.sender.tolist() == [[3, 5]]
    assert scan.kind.tolist() == [[VEHICLE, ANCHOR]]
    np.testing.assert_array_equal(scan.range_std, [[np.nan, 0.25]])
    np.testing.assert_array_equal(scan.covariance[0, 1], np.zeros((3, 3)))
    np.testing.assert_allclose(scan.covariance[0, 0], 0.01 * np.eye(3))


def test_a_reference_is_where_it_was_when_the_range_was_measured():
    made = gatherer('a')
    moving(made, [0.0, 0.5, 1.0], speed=2.0)
    made.add(0, 'a', reading(0.61, 3))
    scan, = due(made, math.inf)
    np.testing.assert_allclose(scan.position[0, 0], [1.22, 0, 0], rtol=1e-6)


@pytest.mark.parametrize('stamp', [-0.1, 1.6])
def test_a_range_from_when_a_reference_was_nowhere_is_left_out_and_counted(stamp):
    made = gatherer('a', max_age=0.5)
    moving(made, [0.0, 1.0])
    made.add(0, 'a', reading(10 + stamp - 10, 3))
    assert due(made, math.inf) == []
    assert made.unplaced == {3: 1}


def test_a_range_of_a_sender_that_nobody_knows_is_left_out_and_counted():
    made = gatherer('a')
    made.add(0, 'a', reading(0.01, 9))
    made.add(0, 'a', reading(0.02, 5))
    scan, = due(made, math.inf)
    assert scan.sender.tolist() == [[5]]
    assert made.unplaced == {9: 1}


def test_a_range_that_is_none_only_tells_the_time():
    made = gatherer('a')
    made.add(0, 'a', reading(0.02, 5, math.nan))
    made.add(0, 'a', reading(0.15, 5))
    assert [scan.stamp for scan in due(made, math.inf)] == [0.15]


def test_poses_of_a_reference_that_go_back_are_refused():
    made = gatherer()
    moving(made, [1.0])
    with pytest.raises(MessageError, match=r'reference 3: stamp 0\.900000 s is not allowed'):
        moving(made, [0.9])


def test_a_reference_begins_anew_where_its_time_starts_over():
    made = gatherer('a')
    moving(made, [100.0, 101.0])
    moving(made, [1.0, 2.0])
    made.add(0, 'a', reading(1.5, 3))
    scan, = due(made, math.inf)
    np.testing.assert_allclose(scan.position[0, 0, 0], 1.5)


def test_what_waits_is_forgotten_by_a_reset_and_topics_are_not():
    made = gatherer('a', 'b')
    made.add(0, 'a', reading(0.02))
    made.reset()
    assert due(made, math.inf) == []
    made.add(0, 'a', reading(0.02))
    made.add(0, 'a', reading(0.15))
    assert due(made, 0.15) == []  # still waits for b
