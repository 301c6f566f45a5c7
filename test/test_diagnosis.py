"""What a localizer says of how its vehicles are doing."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.diagnosis import diagnose
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.types import Observation

CORNERS = np.array([[0, 0], [100, 0], [0, 100], [100, 100]], np.float32)
VEHICLES = ['/veh_0', '/veh_1']


def scan(stamp, place, liar=None):
    """Return what two vehicles hear, the first at a place (2,) [m] and the other nothing."""
    heard = Observation.empty(2, 4, 2, stamp)
    heard.sender[0] = np.arange(4)
    heard.position[:] = CORNERS
    heard.range[0] = np.linalg.norm(CORNERS - place, axis=1)
    if liar is not None:
        heard.position[0, liar] += 60
    return heard


def run(*scans, **settings):
    localizer = Localizer(
        {'range_std': 1.0, 'motion_model': 'velocity', 'method': 'ekf'} | settings, 2)
    for observation in scans:
        localizer.epoch(observation)
    return diagnose(localizer, VEHICLES, 'here', localizer.health.status, {'latency [s]': 0.25})


def still(count, start=0, **arguments):
    return [scan(float(start + number), [30, 40], **arguments) for number in range(count)]


def test_a_vehicle_that_is_found_is_fine():
    diagnosis, _ = run(*still(5))
    assert (diagnosis.level, diagnosis.name, diagnosis.message, diagnosis.hardware_id) == (
        0, 'here: /veh_0', 'OK', '/veh_0')


def test_the_numbers_behind_it_are_told():
    diagnosis, _ = run(*still(5))
    assert diagnosis.values.keys() == {
        'method', 'seed', 'particles', 'probability of being lost', 'suspects',
        'age of the last beacon [s]', 're-initialisations', 'effective particles',
        'beacons heard', 'latency [s]', 'range scale', 'range bias [m]'}
    assert diagnosis.values['beacons heard'] == '4'
    assert diagnosis.values['latency [s]'] == '0.25'
    assert float(diagnosis.values['probability of being lost']) < 0.01


def test_who_is_ignored_is_told_and_how_often():
    told = [diagnosis.values for diagnosis in run(*still(5), anchor_allowlist=('0', '1'))]
    assert [values['beacons and ranges ignored'] for values in told] == ['10', '0']
    assert {values['senders ignored'] for values in told} == {'2, 3'}


def test_who_says_what_cannot_be_true_is_told_and_how_often():
    localizer = Localizer({'method': 'ekf', 'motion_model': 'velocity'}, 2)
    localizer.untrue.count(1, [7, 9, 7], 'range -1 is not allowed')
    told = [each.values for each in diagnose(
        localizer, VEHICLES, 'here', localizer.health.status, {})]
    assert [values['beacons that cannot be true'] for values in told] == ['0', '3']
    assert {values['senders of what cannot be true'] for values in told} == {'7, 9'}


def test_a_vehicle_that_no_beacon_has_placed_is_lost():
    _, diagnosis = run(*still(5))
    assert diagnosis.level == 2
    assert diagnosis.message == 'LOST: no beacon has told where the vehicle is'


def test_a_vehicle_that_beacons_contradict_is_lost():
    diagnosis, _ = run(*still(5), scan(5.0, [90, 95]))
    assert diagnosis.level == 2
    assert diagnosis.message == 'LOST: what is heard contradicts where the vehicle should be'


def test_a_vehicle_in_an_outage_is_stale():
    diagnosis, _ = run(*still(5), Observation.empty(2, 0, 2, 30.0))
    assert diagnosis.level == 1
    assert diagnosis.message == 'STALE: predicting through an outage'


def test_suspects_are_named():
    diagnosis, _ = run(*still(5), *still(10, 5, liar=2))
    assert diagnosis.level == 0
    assert diagnosis.message == 'OK, suspects 2'
    assert diagnosis.values['suspects'] == '2'


def test_before_the_first_epoch_all_are_lost():
    assert [diagnosis.level for diagnosis in run()] == [2, 2]
