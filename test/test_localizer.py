"""The pipeline from messages to estimates: when epochs are worked on, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
import tracemalloc

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.health import LOST, OK, STALE
from tsmcl_ros.types import (
    ConfigError,
    Estimate,
    MessageError,
    Observation,
    Odometry,
    Prior,
    VEHICLE,
)

CORNERS = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0], [100, 100, 0]], np.float32)
# Few particles, and ranges to all corners: what is tested here is time, not accuracy.
SETTINGS = {'min_particles': 100, 'max_particles': 500, 'range_std': 1.0, 'max_speed': 5.0}
# So many that what is tested does not hang on the seed, where accuracy is.
MANY = {'min_particles': 1000, 'max_particles': 5000}


def anchors(identity=(1, 2, 3, 4), position=CORNERS):
    table = Observation.empty(1, len(identity), 3, 0.0)
    table.sender[0] = identity
    table.position[0] = position
    return table


def scan(stamp, place):
    """Return what is heard at a place (2,) [m]: all corners, with their ranges."""
    heard = replace(anchors(), stamp=stamp)
    heard.range[0] = np.linalg.norm(CORNERS[:, :2] - place, axis=1)
    return heard


def silence(stamp):
    return Observation.empty(1, 0, 3, stamp)


def place(stamp, vehicle=0):
    """Return where a vehicle is: on a circle, at 2 m/s [m]."""
    turn = stamp / 10 + vehicle
    return np.array([50 + 20 * np.cos(turn), 50 + 20 * np.sin(turn)])


def odometry(stamp, vehicle=0, rotation=0.0):
    """Return the odometry there, in a frame that is rotated against the map."""
    x, y = place(stamp, vehicle)
    cos, sin = np.cos(-rotation), np.sin(-rotation)
    heading = stamp / 10 + vehicle + np.pi / 2 - rotation
    return Odometry(stamp, np.array([cos * x - sin * y, sin * x + cos * y, 0]), heading)


def drive(seconds, vehicles=1, start=0.0, outage=(np.inf, np.inf), wheels=True):
    """Return the messages of a drive in order of time: beacons at 1 Hz, odometry at 10 Hz."""
    events = []
    for vehicle in range(vehicles):
        if wheels:
            events += [('odometry', vehicle, start + tick / 10)
                       for tick in range(10 * seconds + 1)]
        events += [('beacons', vehicle, start + epoch) for epoch in range(seconds + 1)
                   if not outage[0] < epoch < outage[1]]
    return sorted(events, key=lambda event: event[2])


def hand_over(localizer, event):
    what, vehicle, stamp = event
    if what == 'odometry':
        localizer.odometry(vehicle, odometry(stamp, vehicle))
    else:
        localizer.beacons(vehicle, scan(stamp, place(stamp, vehicle)))


def feed(localizer, events) -> list[Estimate]:
    """Hand over messages and return the estimates that become due."""
    estimates = []
    for event in events:
        hand_over(localizer, event)
        estimates += localizer.due()
    return estimates


def run(events, vehicles=1, **parameters) -> list[Estimate]:
    localizer = Localizer({**SETTINGS, **parameters}, vehicles)
    return feed(localizer, events) + localizer.finish()


def stamps(estimates):
    return [estimate.stamp for estimate in estimates]


def bits(estimates):
    return [
        (one.stamp, one.mean.tobytes(), one.covariance.tobytes(), one.yaw.tobytes(),
         one.rotation_variance.tobytes(), one.heard.tobytes())
        for one in estimates
    ]


# --- accuracy, only so much that all parts are seen to be connected --------------------------

def test_a_vehicle_is_found_by_ranges_and_odometry():
    estimates = run(drive(30))
    errors = [np.linalg.norm(one.mean[0] - place(one.stamp)) for one in estimates[10:]]
    assert max(errors) < 1.0


def test_the_yaw_is_that_of_the_vehicle_in_the_map():
    last = run(drive(60))[-1]
    heading = 60 / 10 + np.pi / 2
    assert abs(np.angle(np.exp(1j * (last.yaw[0] - heading)))) < 0.1


def test_every_vehicle_of_a_fleet_is_found():
    last = run(drive(30, vehicles=3), vehicles=3)[-1]
    np.testing.assert_allclose(last.mean, [place(30, vehicle) for vehicle in range(3)], atol=1)


# --- when an epoch is worked on --------------------------------------------------------------

def test_an_epoch_waits_for_the_odometry_to_pass_it():
    localizer = Localizer(SETTINGS)
    localizer.odometry(0, odometry(0.9))
    localizer.beacons(0, scan(1.0, place(1.0)))
    assert localizer.due() == []
    localizer.odometry(0, odometry(1.0))
    assert stamps(localizer.due()) == [1.0]


def test_an_epoch_waits_for_the_beacons_of_all_vehicles():
    localizer = Localizer(SETTINGS, vehicles=2)
    for vehicle in (0, 1):
        localizer.odometry(vehicle, odometry(1.05, vehicle))
    localizer.beacons(0, scan(1.0, place(1.0)))
    assert localizer.due() == []
    localizer.beacons(1, scan(1.1, place(1.1, 1)))
    assert stamps(localizer.due()) == [1.0]


def test_an_epoch_waits_for_the_odometry_of_all_vehicles():
    localizer = Localizer(SETTINGS, vehicles=2)
    for vehicle in (0, 1):
        localizer.odometry(vehicle, odometry(0.9, vehicle))
        localizer.beacons(vehicle, scan(1.0, place(1.0, vehicle)))
    localizer.odometry(0, odometry(1.1))
    assert localizer.due() == []
    localizer.odometry(1, odometry(1.1, 1))
    assert stamps(localizer.due()) == [1.0]


def test_one_epoch_holds_the_beacons_of_all_vehicles_with_its_stamp():
    estimates = run(drive(3, vehicles=2), vehicles=2)
    assert stamps(estimates) == [0, 1, 2, 3]
    assert all(one.heard.tolist() == [4, 4] for one in estimates)


def test_an_epoch_does_not_wait_longer_than_max_wait_of_the_messages_time():
    localizer = Localizer({**SETTINGS, 'max_wait': 0.3})
    localizer.beacons(0, scan(1.0, place(1.0)))
    localizer.beacons(0, scan(1.29, place(1.29)))
    assert localizer.due() == []
    localizer.beacons(0, scan(1.3, place(1.3)))
    assert stamps(localizer.due())[0] == 1.0


def test_a_clock_lets_time_pass_as_messages_do():
    localizer = Localizer(SETTINGS)
    localizer.beacons(0, scan(1.0, place(1.0)))
    localizer.clock(1.4)
    assert localizer.due() == []
    localizer.clock(1.5)
    assert stamps(localizer.due()) == [1.0]
    assert localizer.now == 1.5


def test_a_vehicle_without_odometry_does_not_wait_for_any_after_its_first_epoch():
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(2, wheels=False))
    localizer.beacons(0, scan(3.0, place(3.0)))
    assert stamps(localizer.due()) == [3.0]


def test_what_still_waits_at_the_end_is_finished():
    localizer = Localizer(SETTINGS)
    estimates = feed(localizer, drive(5, wheels=False)[:1])
    assert estimates == []
    assert stamps(localizer.finish()) == [0.0]
    assert localizer.finish() == []


def test_the_end_is_no_outage():
    assert stamps(run(drive(5), outage_period=0.1, max_wait=1.0))[-1] == 5.0


@pytest.fixture(scope='module')
def in_order():
    """Return messages of a fleet in order of time, and the bits of their estimates."""
    events = drive(9, vehicles=2, outage=(3, 7))
    return events, bits(run(events, vehicles=2))


@settings(max_examples=12)
@given(lags=st.lists(st.floats(0, 0.3), min_size=4, max_size=4), seed=st.integers(0, 999))
def test_estimates_do_not_depend_on_how_topics_interleave(in_order, lags, seed):
    # Lag, jitter and the time between two odometry poses together stay below max_wait, 0.5 s.
    events, expected = in_order
    jitter = np.random.default_rng(seed).uniform(0, 0.09, len(events))
    arrivals, latest = [], {}
    for (what, vehicle, stamp), late in zip(events, jitter, strict=True):
        topic = what, vehicle
        arrival = stamp + lags[2 * vehicle + (what == 'beacons')] + late
        latest[topic] = max(arrival, latest.get(topic, -np.inf))
        arrivals.append(latest[topic])
    shuffled = [events[index] for index in np.argsort(arrivals, kind='stable')]
    assert bits(run(shuffled, vehicles=2)) == expected


@pytest.mark.parametrize('method', ['mcl', 'ts_mcl'])
def test_the_same_seed_gives_the_same_bits(method):
    assert bits(run(drive(10), method=method, seed=3)) == bits(
        run(drive(10), method=method, seed=3))


def test_another_seed_gives_others():
    assert bits(run(drive(10), seed=3)) != bits(run(drive(10), seed=4))


# --- outages ---------------------------------------------------------------------------------

def test_an_outage_is_predicted_through_every_outage_period():
    estimates = run(drive(20, outage=(5, 15)), outage_period=1.5)
    assert stamps(estimates) == [0, 1, 2, 3, 4, 5, 6.5, 8, 9.5, 11, 12.5, 14, 15, 16, 17, 18,
                                 19, 20]
    assert [int(one.heard[0]) for one in estimates[5:8]] == [4, 0, 0]


def test_an_outage_is_not_predicted_through_with_an_outage_period_of_0():
    assert stamps(run(drive(20, outage=(5, 15)), outage_period=0.0))[5:7] == [5, 15]


def test_the_covariance_grows_through_an_outage():
    estimates = run(drive(20, outage=(5, 15)), outage_period=1.5)
    variances = [np.trace(one.covariance[0]) for one in estimates[5:12]]
    assert (np.diff(variances) > 0).all()


def test_predictions_follow_the_odometry():
    estimates = run(drive(40, outage=(20, 30)), alpha3=0.0, alpha2=0.0, alpha1=0.0, **MANY)
    silent = [one for one in estimates if 20 < one.stamp < 30]
    assert len(silent) == 4
    for one in silent:
        np.testing.assert_allclose(one.mean[0], place(one.stamp), atol=2.0)


def test_an_empty_scan_predicts_only():
    localizer = Localizer(SETTINGS)
    *_, before = feed(localizer, drive(10))
    localizer.odometry(0, odometry(10.5))
    localizer.beacons(0, silence(10.5))
    [after] = localizer.due()
    assert after.heard.tolist() == [0]
    assert np.isnan(after.log_likelihood[0])
    assert np.trace(after.covariance[0]) > np.trace(before.covariance[0])


def test_no_beacon_ever_means_no_estimate():
    localizer = Localizer(SETTINGS)
    for tick in range(100):
        localizer.odometry(0, odometry(tick / 10))
        assert localizer.due() == []


def test_empty_scans_alone_place_nobody():
    localizer = Localizer(SETTINGS)
    for stamp in range(5):
        localizer.beacons(0, silence(float(stamp)))
    estimates = localizer.finish()
    assert len(estimates) == 5
    assert all(np.isnan(one.mean).all() for one in estimates)


def test_health_tells_an_outage():
    localizer = Localizer(SETTINGS)
    assert localizer.health.status.tolist() == [LOST]
    assert localizer.health.age.tolist() == [np.inf]
    feed(localizer, drive(20, outage=(5, 99)))
    health = localizer.health
    assert health.status.tolist() == [STALE]
    assert health.age.tolist() == [14]  # of the last prediction, at 19 s
    feed(localizer, drive(3, start=21.0))
    assert localizer.health.status.tolist() == [OK]


# --- odometry that is not there from the beginning -------------------------------------------

def test_odometry_that_begins_late_is_adopted():
    events = drive(20, wheels=False) + drive(40, start=21.0)
    localizer = Localizer({**SETTINGS, **MANY})
    estimates = feed(localizer, events)
    assert np.isnan(estimates[20].rotation[0])
    assert np.isfinite(estimates[-1].rotation[0])
    assert np.linalg.norm(estimates[-1].mean[0] - place(61.0)) < 1.0


def test_adopting_odometry_does_not_lose_the_vehicle():
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(20, wheels=False))
    localizer.odometry(0, odometry(20.0))
    localizer.odometry(0, odometry(20.2))
    localizer.beacons(0, silence(20.1))
    [first] = localizer.due()
    assert np.linalg.norm(first.mean[0] - place(20.1)) < 5.0


def test_a_vehicle_whose_odometry_begins_late_is_followed_in_a_fleet():
    late = [event for event in drive(40, vehicles=2)
            if event[:2] != ('odometry', 1) or event[2] > 20]
    last = run(late, vehicles=2)[-1]
    assert np.isfinite(last.odometry).all()
    np.testing.assert_allclose(last.mean, [place(40), place(40, 1)], atol=2.0)


# --- what is refused -------------------------------------------------------------------------

@pytest.mark.parametrize('stamp', [4.0, 3.5])
def test_beacons_that_come_again_or_late_are_refused(stamp):
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(4))
    with pytest.raises(MessageError, match=rf'beacons: stamp {stamp:.6f} s is not allowed, must '
                                           r'be after the last one, 4\.000000 s'):
        localizer.beacons(0, scan(stamp, place(stamp)))


@pytest.mark.parametrize('stamp', [4.0, 3.95])
def test_odometry_that_comes_again_or_late_is_refused(stamp):
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(4))
    with pytest.raises(MessageError, match=rf'odometry: stamp {stamp:.6f} s is not allowed, must '
                                           r'be after the last one, 4\.000000 s'):
        localizer.odometry(0, odometry(stamp))


def test_beacons_of_an_epoch_that_is_over_are_refused():
    localizer = Localizer(SETTINGS, vehicles=2)
    feed(localizer, [event for event in drive(4, vehicles=2) if event[1] == 0])
    with pytest.raises(MessageError, match=r'stamp 3\.000000 s .* after the last epoch, 3\.0'):
        localizer.beacons(1, scan(3.0, place(3.0, 1)))


def test_what_is_refused_changes_nothing():
    clean, disturbed = Localizer(SETTINGS), Localizer(SETTINGS)
    expected = feed(clean, drive(10))
    estimates = feed(disturbed, drive(5))
    for _ in range(3):
        with pytest.raises(MessageError):
            disturbed.beacons(0, scan(4.5, place(50.0)))
        with pytest.raises(MessageError):
            disturbed.odometry(0, odometry(4.5))
    assert bits(estimates + feed(disturbed, drive(10)[len(drive(5)):])) == bits(expected)


def test_a_vehicle_whose_clock_is_far_behind_disturbs_nobody():
    localizer = Localizer(SETTINGS, vehicles=2)
    mine = [event for event in drive(30, vehicles=2, start=100.0) if event[1] == 0]
    feed(localizer, mine)
    for stamp in (5.0, 6.0):
        with pytest.raises(MessageError, match=r'at most 10 s before the newest of all messages, '
                                               r'130\.000000 s'):
            localizer.odometry(1, odometry(stamp, 1))
    assert localizer.restarts == 0
    assert localizer.health.status.tolist() == [OK, LOST]


def test_a_map_with_one_anchor_twice_is_refused():
    with pytest.raises(MessageError, match='anchor map: id 7 stands in it more than once'):
        Localizer(SETTINGS).anchor_map(anchors((3, 7, 7), CORNERS[:3]))


def test_an_anchor_that_is_not_where_the_map_has_it_is_not_believed():
    honest, lied_to = Localizer(SETTINGS), Localizer(SETTINGS)
    for localizer in (honest, lied_to):
        localizer.anchor_map(anchors())
        localizer.ignore_silence()
    lying, missing = scan(1.0, place(1.0)), scan(1.0, place(1.0))
    lying.position[0, 2] += [0, 1.5, 0]
    missing.sender[0, 2] = -1
    honest.beacons(0, missing)
    lied_to.beacons(0, lying)
    assert bits(lied_to.finish()) == bits(honest.finish())


@pytest.mark.parametrize('again', [False, True])
def test_who_contradicts_any_map_is_suspected_after_a_loop_too(again):
    localizer = Localizer(SETTINGS)
    localizer.anchor_map(anchors((1, 2), CORNERS[:2]))
    localizer.anchor_map(anchors((3, 4), CORNERS[2:]))
    if again:
        feed(localizer, drive(20))
    for stamp in range(1, 8):
        lying = scan(float(stamp), place(stamp))
        lying.position[0, 0] += 2
        localizer.beacons(0, lying)
    localizer.finish()
    assert localizer.health.suspects == [[1]]
    assert localizer.restarts == again


def test_heights_do_not_matter_in_two_dimensions():
    localizer = Localizer(SETTINGS)
    localizer.anchor_map(anchors())
    high = scan(1.0, place(1.0))
    high.position[0, :, 2] = 30
    localizer.beacons(0, high)
    assert len(localizer.finish()) == 1


# --- time that jumps -------------------------------------------------------------------------

def test_a_loop_gives_the_first_rounds_estimates_again():
    events = drive(20)
    once = run(events)
    assert bits(run(events + events)) == 2 * bits(once)


def test_a_clock_that_jumps_back_starts_anew():
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(20))
    localizer.clock(11.0)
    assert localizer.restarts == 0
    localizer.clock(9.0)
    assert localizer.restarts == 1
    assert localizer.health.status.tolist() == [LOST]


def test_time_jump_says_how_far_back_is_late():
    localizer = Localizer({**SETTINGS, 'time_jump': 2.0})
    feed(localizer, drive(20))
    with pytest.raises(MessageError):
        localizer.odometry(0, odometry(18.5))
    localizer.odometry(0, odometry(17.5))
    assert localizer.restarts == 1


def test_a_clock_set_to_today_starts_anew_rather_than_predicting_through_decades():
    today = 1.7e9
    estimates = run(drive(5) + drive(5, start=today))
    assert stamps(estimates) == [0, 1, 2, 3, 4, 5, *(today + epoch for epoch in range(6))]


def test_a_single_stamp_from_the_future_is_survived():
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(5))
    feed(localizer, [('odometry', 0, 1e9)])
    feed(localizer, drive(5, start=6.0))
    assert localizer.restarts == 2
    assert localizer.health.status.tolist() == [OK]


def test_a_reset_forgets_the_calibration():
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(5))
    assert localizer.channel.calibration.scale != 1.0
    localizer.reset()
    assert localizer.channel.calibration.scale == 1.0


# --- where a vehicle starts ------------------------------------------------------------------

def prior(x, y, std=0.5, vehicle=0, **yaw):
    return Prior(vehicle, np.array([x, y]), std ** 2 * np.eye(2), **yaw)


def test_an_initial_pose_is_where_the_vehicle_starts():
    localizer = Localizer({
        **SETTINGS, 'set_initial_pose': True, 'initial_pose.x': 30.0, 'initial_pose.y': -20.0})
    localizer.beacons(0, silence(0.0))
    [first] = localizer.finish()
    np.testing.assert_allclose(first.mean[0], [30, -20], atol=0.5)
    assert np.trace(first.covariance[0]) == pytest.approx(2, rel=0.5)


def test_an_initial_pose_by_message_wins_over_the_configured_one():
    localizer = Localizer({**SETTINGS, 'set_initial_pose': True, 'initial_pose.x': 30.0})
    localizer.initial_pose(prior(80, 70))
    localizer.beacons(0, silence(0.0))
    np.testing.assert_allclose(localizer.finish()[0].mean[0], [80, 70], atol=0.5)


def test_an_initial_pose_replaces_a_belief():
    localizer = Localizer(SETTINGS)
    feed(localizer, drive(5))
    localizer.initial_pose(prior(500, 500))
    localizer.odometry(0, odometry(5.5))
    localizer.beacons(0, silence(5.5))
    np.testing.assert_allclose(localizer.due()[0].mean[0], [500, 500], atol=0.5)


def test_an_initial_pose_concerns_one_vehicle_only():
    localizer = Localizer(SETTINGS, vehicles=2)
    localizer.initial_pose(prior(500, 500, vehicle=1))
    for vehicle in (0, 1):
        localizer.beacons(vehicle, silence(0.0))
    mean = localizer.finish()[0].mean
    assert np.isnan(mean[0]).all()
    np.testing.assert_allclose(mean[1], [500, 500], atol=0.5)


@pytest.mark.parametrize('rotation', [0.0, 2.0])
def test_an_initial_yaw_is_the_vehicles_however_the_odometry_frame_lies(rotation):
    localizer = Localizer({**SETTINGS, 'alpha1': 0.0, 'alpha2': 0.0})
    heading = np.pi / 2 + 0.3
    x, y = place(3.0)
    localizer.initial_pose(prior(x, y, yaw=heading, yaw_std=0.01))
    for tick in range(30, 61):
        localizer.odometry(0, odometry(tick / 10, rotation=rotation))
        if tick % 10 == 0:
            localizer.beacons(0, silence(tick / 10))
    *_, last = localizer.due()
    assert last.rotation[0] == pytest.approx(rotation, abs=0.02)
    assert last.yaw[0] == pytest.approx(heading + 0.3, abs=0.02)
    np.testing.assert_allclose(last.mean[0], place(6.0), atol=1.0)


def test_a_configured_initial_yaw_is_the_vehicles_too():
    localizer = Localizer({
        **SETTINGS, 'set_initial_pose': True, 'initial_pose.yaw': 1.0,
        'initial_pose.yaw_std': 0.001})
    localizer.odometry(0, Odometry(0.0, np.zeros(3), 0.25))
    localizer.beacons(0, silence(0.0))
    [first] = localizer.due()
    assert first.yaw[0] == pytest.approx(1.0, abs=0.01)
    assert first.rotation[0] == pytest.approx(0.75, abs=0.01)


def test_a_reinitialized_vehicle_is_placed_anew_at_its_next_beacon():
    localizer = Localizer(SETTINGS)
    localizer.initial_pose(prior(500, 500))
    feed(localizer, [('odometry', 0, 0.0)])
    localizer.beacons(0, silence(0.0))
    localizer.due()
    localizer.reinitialize(0)
    localizer.odometry(0, odometry(0.5))
    localizer.beacons(0, scan(0.5, place(0.5)))
    np.testing.assert_allclose(localizer.due()[0].mean[0], place(0.5), atol=2)


# --- parameters ------------------------------------------------------------------------------

def test_an_unknown_method_lists_those_there_are():
    with pytest.raises(ConfigError, match="method: 'kalman' is not allowed, must be one of "
                                          + ', '.join(METHODS)):
        Localizer({'method': 'kalman'})


def test_an_unknown_parameter_names_the_nearest():
    with pytest.raises(ConfigError, match="unknown parameter 'min_particle', did you mean "
                                          'min_particles'):
        Localizer({'min_particle': 10})


def test_a_method_that_the_motion_does_not_fit_is_refused_at_once():
    with pytest.raises(ConfigError, match='motion_model must be random'):
        Localizer({'method': 'grid', 'motion_model': 'velocity'})


def test_outage_periods_without_end_are_refused():
    with pytest.raises(ConfigError, match='outage_period: 1e-09 is not allowed'):
        Localizer({'outage_period': 1e-9})


@pytest.mark.parametrize('parameters', [
    {'method': 'mcl', 'min_particles': 300, 'max_particles': 3000},
    {'motion_model': 'random'},
    {'motion_model': 'velocity'}, {'motion_model': 'odometry', 'odom_heading': 'known'},
    {'method': 'grid', 'motion_model': 'random', 'grid_cell': 2.0, 'grid_x_max': 100.0,
     'grid_y_max': 100.0}])
def test_every_method_finds_a_vehicle_with_every_motion_model(parameters):
    last = run(drive(20), **parameters)[-1]
    np.testing.assert_allclose(last.mean[0], place(20.0), atol=2.0)


# --- simulations, and long runs --------------------------------------------------------------

def test_a_whole_fleets_epoch_can_be_handed_over_at_once():
    localizer = Localizer({**SETTINGS, **MANY}, vehicles=2)
    for stamp in np.arange(0, 20.0, 0.5):
        both = [odometry(stamp, vehicle) for vehicle in (0, 1)]
        estimate = localizer.epoch(
            Observation.stack([scan(stamp, place(stamp, vehicle)) for vehicle in (0, 1)], stamp),
            np.stack([one.position for one in both]), np.array([one.yaw for one in both]))
    np.testing.assert_allclose(
        estimate.mean, [place(stamp, vehicle) for vehicle in (0, 1)], atol=1.0)


@pytest.mark.accuracy
def test_memory_does_not_grow():
    localizer = Localizer({'min_particles': 10, 'max_particles': 10, 'max_iterations': 0})
    tracemalloc.start()
    try:
        used = []
        for minute in range(0, 300, 60):
            feed(localizer, drive(58, start=float(minute)))
            used.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # Kept, these minutes' messages would take four times that; coverage keeps notes of its own.
    assert max(used[1:]) - min(used[1:]) < 50_000


# --- outages -----------------------------------------------------------------------------------

def mowing(seconds, vehicles=1, outage=(np.inf, np.inf)):
    """Return epochs (V vehicles) of lanes to and fro across the square, 40 m at 2 m/s."""
    for stamp in range(seconds):
        lane = 30 + 40 * abs((stamp / 20 + 0.3 * np.arange(vehicles)) % 2 - 1)
        truth = np.stack([lane, np.full(vehicles, 50.0)], axis=1)
        heard = [silence(stamp) if outage[0] < stamp < outage[1] else scan(stamp, one)
                 for one in truth]
        yield truth, Observation.stack(heard, float(stamp))


@cache
def through_outage(begin=150, wheels=False, **parameters):
    """Return errors (60, 5) [m] of 5 vehicles in an outage of 60 s, and their estimates."""
    localizer = Localizer({**SETTINGS, 'method': 'ekf', **parameters}, 5)
    errors, estimates = [], []
    for truth, observation in mowing(begin + 60, 5, outage=(begin - 1, begin + 60)):
        estimate = localizer.epoch(
            observation, truth if wheels else None, np.zeros(5) if wheels else None)
        errors.append(np.linalg.norm(estimate.mean - truth, axis=1))
        estimates.append(estimate)
    return np.array(errors)[begin:], estimates[begin:]


def nees(errors, estimates):
    """Return the normalized error squared (T, V) where covariances are round."""
    variance = [np.trace(one.covariance, axis1=1, axis2=2) / 2 for one in estimates]
    return errors ** 2 / np.array(variance)


@pytest.mark.accuracy
def test_without_odometry_an_outage_is_bridged_by_how_vehicles_used_to_move():
    forgotten, estimates = through_outage()
    constant, _ = through_outage(outage_predictor='none')

    assert forgotten[-1].mean() < 0.5 * constant[-1].mean()
    # Twice the dimension's 2 would take a chance of 1 in 50 for 5 independent vehicles.
    assert nees(forgotten, estimates).mean() < 4
    spread = np.array([np.trace(one.covariance[0]) for one in estimates])
    assert (np.diff(spread) >= 0).all()


def test_with_odometry_the_methods_own_prediction_stays():
    with_one, _ = through_outage(20, wheels=True)
    without, _ = through_outage(20, wheels=True, outage_predictor='none')

    np.testing.assert_array_equal(with_one, without)


def test_what_is_said_to_move_at_random_is_not_predicted_otherwise():
    one, _ = through_outage(20, motion_model='random')
    other, _ = through_outage(20, motion_model='random', outage_predictor='none')

    np.testing.assert_array_equal(one, other)


@pytest.mark.accuracy
def test_after_a_long_outage_the_method_goes_on_from_where_the_past_leads():
    errors = []
    for predictor in ('velocity', 'none'):
        localizer = Localizer({**SETTINGS, 'method': 'ekf', 'outage_predictor': predictor}, 5)
        after = []
        for truth, observation in mowing(190, 5, outage=(119, 180)):
            # One range at a time finds a vehicle slowly.
            if observation.stamp >= 180:
                observation.sender[:, 1:] = -1
            estimate = localizer.epoch(observation)
            after.append(np.linalg.norm(estimate.mean - truth, axis=1))
        errors.append(np.mean(after[180:]))
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.accuracy
def test_a_short_outage_leaves_the_method_alone():
    ends = []
    for predictor in ('velocity', 'none'):
        localizer = Localizer({**SETTINGS, 'outage_predictor': predictor})
        for _, observation in mowing(120, outage=(100, 104)):
            estimate = localizer.epoch(observation)
        ends.append(estimate.mean)
    np.testing.assert_array_equal(*ends)


def test_a_grey_azimuth_does_not_lead_far_astray():
    errors, estimates = through_outage(outage_predictor='grey_ekf')

    assert errors[-1].mean() < 40
    assert nees(errors, estimates).mean() < 4


@pytest.mark.parametrize('change', ['reinitialize', 'initial_pose'])
def test_a_vehicle_that_is_placed_elsewhere_has_no_past(change):
    predicted = []
    for predictor in ('velocity', 'none'):
        localizer = Localizer({**SETTINGS, 'outage_predictor': predictor})
        for _, observation in mowing(60):
            localizer.epoch(observation)
        if change == 'reinitialize':
            localizer.reinitialize(0)
        else:
            localizer.initial_pose(prior(10, 10))
        localizer.epoch(scan(60.0, place(60.0)))
        predicted.append(localizer.epoch(silence(62.0)).mean)
    np.testing.assert_array_equal(*predicted)


# --- other vehicles --------------------------------------------------------------------------

def meet(stamp, place, other, variance):
    """Return the range to a vehicle, which claims a position with some variance."""
    heard = replace(anchors((900,), np.append(other, 0.0)[None]), stamp=stamp)
    heard.kind[:], heard.covariance[:] = VEHICLE, variance * np.eye(3)
    heard.range[:] = np.linalg.norm(np.asarray(other) - place)
    return Observation.join([scan(stamp, place), heard])


def locate(stamps, other, variance, **parameters):
    """Return the last estimate of a vehicle at (50, 50) that ranges a vehicle to the right."""
    localizer = Localizer({**SETTINGS, 'range_calibration': 'off', **parameters})
    for stamp in range(stamps):
        localizer.beacons(0, meet(stamp, np.array([50.0, 50.0]), other, variance))
    return localizer.finish()[-1]


def test_a_less_certain_vehicle_is_no_reference_unless_the_guard_is_off():
    assert locate(3, np.array([60.0, 50.0]), 100.0).heard[0] == 4
    assert locate(3, np.array([60.0, 50.0]), 100.0, echo_guard=0.0).heard[0] == 5


def test_vehicles_can_be_left_out():
    assert locate(3, np.array([60.0, 50.0]), 0.001).heard[0] == 5
    assert locate(3, np.array([60.0, 50.0]), 0.001, use_vehicles=False).heard[0] == 4


def test_ranges_to_vehicles_do_not_calibrate():
    localizer = Localizer({**SETTINGS, 'range_calibration': 'online'})
    alone = Localizer({**SETTINGS, 'range_calibration': 'online', 'use_vehicles': False})
    for stamp in range(5):
        heard = meet(stamp, np.array([50.0, 50.0]), np.array([60.0, 50.0]), 1e-3)
        heard.range[0, :4] = np.nan
        for one in (localizer, alone):
            one.beacons(0, heard)
            one.due()
    assert localizer.channel.calibration.scale == alone.channel.calibration.scale == 1.0
