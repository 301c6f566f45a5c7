"""Clocks that are wrong, late, or start over: nobody else is stalled, and nothing is lost."""

from __future__ import annotations

import heapq
from types import SimpleNamespace

import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.health import OK
from tsmcl_ros.types import MessageError, Observation, Odometry

CORNERS = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0], [100, 100, 0]], np.float32)
SETTINGS = {'method': 'ekf', 'range_std': 1.0, 'odom_heading': 'known', 'outage_period': 0.0}


def place(stamp, vehicle):
    turn = stamp / 10 + vehicle
    return np.array([50 + 20 * np.cos(turn), 50 + 20 * np.sin(turn), 0])


def beacons(stamp, vehicle, told=None):
    scan = Observation.empty(1, 4, 3, stamp if told is None else told)
    scan.sender[0] = np.arange(4)
    scan.position[0] = CORNERS
    scan.range[0] = np.linalg.norm(CORNERS - place(stamp, vehicle), axis=1)
    return scan


def odometry(stamp, vehicle, told=None):
    return Odometry(stamp if told is None else told, place(stamp, vehicle),
                    stamp / 10 + vehicle + np.pi / 2)


def drive(seconds, vehicles=1, start=100.0, rate=1.0, wheels=10.0):
    """Return (time, what, vehicle, stamp) of messages in order of time."""
    rows = []
    for vehicle in range(vehicles):
        rows.append([(start + n / rate, 'beacons', vehicle, start + n / rate)
                     for n in range(int(seconds * rate))])
        rows.append([(start + n / wheels, 'odometry', vehicle, start + n / wheels)
                     for n in range(int(seconds * wheels))])
    return list(heapq.merge(*rows))


def wrong(rows, vehicle, offset, begin=-np.inf, end=np.inf, what=('beacons', 'odometry')):
    """Return them with the clock of a vehicle's topics off by some time for a while [s]."""
    return [(time, kind, who, stamp + offset * (
        who == vehicle and kind in what and begin <= time < end))
        for time, kind, who, stamp in rows]


def run(rows, vehicles=1, **settings):
    """Hand messages over, and return what came of it."""
    localizer = Localizer(SETTINGS | settings, vehicles)
    told = SimpleNamespace(localizer=localizer, estimates=[], refused=[], waiting=0)
    for time, what, vehicle, stamp in rows:
        give, make = (localizer.beacons, beacons) if what == 'beacons' else (
            localizer.odometry, odometry)
        try:
            give(vehicle, make(time, vehicle, stamp))
        except MessageError as error:
            told.refused.append((vehicle, str(error)))
        told.refused += [(who, str(error)) for who, error in localizer.refused()]
        told.estimates += localizer.due()
        told.waiting = max(told.waiting, localizer.schedule.waiting)
    told.estimates += localizer.finish()
    return told


def served(told, vehicle):
    """Return the stamps of epochs in which a vehicle heard something."""
    return [one.stamp for one in told.estimates if one.heard[vehicle]]


def errors(told, vehicle, offset=0.0):
    return [float(np.linalg.norm(one.mean[vehicle] - place(one.stamp - offset, vehicle)[:2]))
            for one in told.estimates if one.heard[vehicle]]


# --- one vehicle of a fleet ------------------------------------------------------------------

@pytest.mark.parametrize('offset', [4.0, 60.0, 5000.0, 1.7e9, -60.0, -99.0])
def test_a_vehicle_whose_clock_is_wrong_stalls_and_restarts_nobody_else(offset):
    rows = drive(40, vehicles=3)
    told = run(wrong(rows, 1, offset), vehicles=3)
    assert told.localizer.restarts == 0
    for vehicle in (0, 2):
        assert served(told, vehicle) == [100.0 + epoch for epoch in range(40)]
    assert {vehicle for vehicle, _ in told.refused} == {1}


def test_who_spoke_first_does_not_keep_the_others_out():
    rows = wrong(drive(60, vehicles=3), 0, 60.0)
    told = run([row for row in rows if row[2] == 0 or row[0] > 101], vehicles=3)
    assert told.localizer.restarts == 1
    for vehicle in (1, 2):
        assert served(told, vehicle)[-40:] == [120.0 + epoch for epoch in range(40)]


@pytest.mark.parametrize('offset', [8.0, 60.0, 5000.0, -50.0])
def test_a_single_wrong_stamp_of_a_vehicle_costs_that_message_alone(offset):
    rows = drive(30, vehicles=3)
    told = run(wrong(rows, 1, offset, 110.0, 110.05, ['beacons']), vehicles=3)
    assert told.localizer.restarts == 0
    assert [vehicle for vehicle, _ in told.refused] == [1]
    assert 'of what most vehicles tell' in told.refused[0][1]
    assert len(served(told, 0)) == len(served(told, 2)) == 30
    assert len(served(told, 1)) == 29


def test_a_vehicle_whose_clock_is_put_right_is_served_again():
    rows = drive(60, vehicles=3)
    told = run(wrong(rows, 1, 300.0, 110.0, 130.0), vehicles=3)
    assert told.localizer.restarts == 0
    assert served(told, 1)[-30:] == [130.0 + epoch for epoch in range(30)]
    assert errors(told, 1)[-1] < 2


@pytest.mark.parametrize('offset', [-90.0, 60.0, 5000.0])
def test_a_fleet_whose_time_jumps_together_loses_no_message(offset):
    rows = drive(20, vehicles=3)
    again = [(time + offset, what, vehicle, stamp + offset) for time, what, vehicle, stamp in rows]
    told = run(rows + again, vehicles=3)
    assert told.refused == []
    assert told.localizer.restarts == (0 if offset == 60.0 else 1)
    for vehicle in range(3):
        assert len(served(told, vehicle)) == 40


def test_a_looped_bag_of_a_fleet_gives_the_first_rounds_estimates_again():
    rows = drive(20, vehicles=3)
    once, twice = run(rows, vehicles=3), run(rows + rows, vehicles=3)
    assert [one.mean.tobytes() for one in twice.estimates] == 2 * [
        one.mean.tobytes() for one in once.estimates]


def test_a_vehicle_that_is_left_alone_is_believed_after_a_while():
    rows = [row for row in wrong(drive(60, vehicles=3), 1, 300.0) if row[2] == 1 or row[0] < 110]
    told = run(rows, vehicles=3)
    assert served(told, 1)[-10:] == [450.0 + epoch for epoch in range(10)]


def test_memory_does_not_grow_while_a_vehicle_is_silent_or_wrong():
    rows = [row for row in wrong(drive(40, vehicles=3, wheels=20), 1, 600.0)
            if row[2] != 2 or row[0] < 105]
    told = run(rows, vehicles=3)
    assert told.waiting <= 3
    assert len(told.localizer.schedule._timeline._held) <= 1000
    assert len(served(told, 0)) == 40


# --- a vehicle alone -------------------------------------------------------------------------

def test_a_stamp_of_the_future_on_a_topic_that_falls_silent_is_outlived():
    rows = drive(60)
    told = run([row for row in wrong(rows, 0, 1e6, 105.0, 105.05, ['beacons'])
                if row[1] == 'odometry' or row[0] <= 105.0 or row[0] > 108], outage_period=2.0)
    assert served(told, 0)[-40:] == [120.0 + epoch for epoch in range(40)]
    assert told.localizer.health.status.tolist() == [OK]


@pytest.mark.parametrize('offset', [-100.0, 50.0, -5.0, 1e6])
def test_single_wrong_stamps_of_beacons_never_stop_it(offset):
    rows = drive(60)
    for begin in (110.0, 120.0, 121.0):
        rows = wrong(rows, 0, offset, begin, begin + 0.05, ['beacons'])
    told = run(rows)
    assert served(told, 0)[-30:] == [130.0 + epoch for epoch in range(30)]


def test_a_driver_that_leaves_stamps_zero_is_refused_and_the_rest_goes_on():
    """Beacons without odometry are nothing, but odometry goes on, and so would other inputs."""
    rows = drive(30, start=1.7e9)
    zero = [(time, what, vehicle, 0.0 if what == 'beacons' else stamp)
            for time, what, vehicle, stamp in rows]
    told = run(zero)
    assert told.localizer.restarts <= 1
    assert told.localizer.now == pytest.approx(1.7e9 + 29.9)
    assert len(told.refused) >= 29


def test_stamps_that_are_left_at_zero_now_and_then_cost_those_messages_alone():
    rows = drive(40, start=1.7e9)
    told = run([(time, what, vehicle, 0.0 if what == 'beacons' and time % 4 == 1 else stamp)
                for time, what, vehicle, stamp in rows])
    assert told.localizer.restarts == 0
    assert len(told.refused) == 10
    assert len(served(told, 0)) == 30


@pytest.mark.parametrize(('rate', 'wheels'), [(1.0, 50.0), (5.0, 10.0), (50.0, 20.0)])
def test_beacons_come_as_often_as_they_like_and_with_jitter(rate, wheels):
    rng = np.random.default_rng(1)
    arrivals = [(row[0] + rng.uniform(0, 0.2), row) for row in drive(5, rate=rate, wheels=wheels)]
    latest, ordered = {}, []
    for arrival, row in arrivals:
        # In order on each topic, as a network keeps it.
        latest[row[1]] = max(arrival, latest.get(row[1], 0.0))
        ordered.append((latest[row[1]], row))
    told = run([row for _, row in sorted(ordered, key=lambda one: one[0])])
    assert told.refused == []
    assert len(served(told, 0)) == int(5 * rate)
    assert errors(told, 0)[-1] < 2


def test_messages_that_come_twice_late_or_out_of_order_cost_no_others():
    rng = np.random.default_rng(2)
    rows = drive(60, vehicles=2)
    disturbed = []
    for number, row in enumerate(rows):
        disturbed.append(row)
        if rng.random() < 0.2:
            disturbed.append(rows[max(number - int(rng.integers(0, 100)), 0)])
    clean, told = run(rows, vehicles=2), run(disturbed, vehicles=2)
    assert told.localizer.restarts == 0
    assert [one.mean.tobytes() for one in told.estimates] == [
        one.mean.tobytes() for one in clean.estimates]


@pytest.mark.parametrize(('outage_period', 'lost'), [(0.0, 0), (2.0, 5)])
def test_beacons_that_are_five_seconds_late_are_taken_once_predictions_wait_for_them(
        outage_period, lost):
    late = sorted((row[0] + 5.0 * (row[1] == 'beacons'), *row) for row in drive(30))
    told = run([row[1:] for row in late], outage_period=outage_period)
    assert told.localizer.restarts == 0
    assert len(served(told, 0)) >= 30 - lost
    assert len(told.refused) <= lost
    assert errors(told, 0)[-1] < 2


def test_a_clock_that_is_paused_is_no_event():
    localizer = Localizer(SETTINGS)
    localizer.odometry(0, odometry(1.0, 0))
    localizer.beacons(0, beacons(1.0, 0))
    for _ in range(100):
        localizer.clock(1.0)
    assert localizer.restarts == 0
    assert len(localizer.due()) == 1
