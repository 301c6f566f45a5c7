"""Who may speak, and who is only counted."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.speakers import ignored_note, SpeakerConfig, Speakers
from tsmcl_ros.types import ConfigError, Links, Observation, VEHICLE

CORNERS = np.array([[0, 0], [100, 0], [0, 100], [100, 100]], np.float32)
PLACE = np.array([30.0, 40.0])
SETTINGS = {'method': 'ekf', 'range_std': 1.0, 'motion_model': 'velocity'}


def heard(stamp=1.0, senders=(1, 2, 3, 4), vehicles=1):
    scan = Observation.empty(vehicles, len(senders), 2, stamp)
    scan.sender[:] = senders
    scan.position[:] = CORNERS[np.arange(len(senders)) % 4]
    scan.range[:] = np.linalg.norm(scan.position - PLACE, axis=2)
    return scan


def heeded(scan, *anchors, vehicles=('all',), listed=()):
    speakers = Speakers(SpeakerConfig(anchors or ('all',), vehicles), len(scan.sender))
    if listed:
        speakers.learn_map(heard(senders=listed))
    return speakers, speakers.heed(scan, range(len(scan.sender)))


def senders(scan, vehicle=0):
    return scan.sender[vehicle][scan.heard[vehicle]].tolist()


def localize(*scans, before=lambda localizer: None, **settings):
    localizer = Localizer(SETTINGS | settings)
    before(localizer)
    for scan in scans:
        localizer.beacons(0, scan)
    return localizer, localizer.finish()


def test_all_are_heeded_as_it_comes():
    scan = heard()
    assert heeded(scan)[1] is scan


@pytest.mark.parametrize(('words', 'expected'), [
    (('2',), [2]), (('2', '4'), [2, 4]), (('2-3',), [2, 3]), (('3-4', '1'), [1, 3, 4]),
    (('9',), []), (('1', 'all'), [1, 2, 3, 4])])
def test_ids_and_spans_of_ids_are_heeded(words, expected):
    assert senders(heeded(heard(), *words)[1]) == expected


def test_the_anchors_of_maps_are_heeded():
    assert senders(heeded(heard(), 'map', listed=(3, 1))[1]) == [1, 3]


def test_before_there_is_a_map_nobody_of_it_is_heeded():
    assert senders(heeded(heard(), 'map', '4')[1]) == [4]


def test_ids_are_up_to_what_a_beacon_holds():
    assert senders(heeded(heard(senders=(2**32 - 1, 7)), '8-4294967295')[1]) == [2**32 - 1]


def test_vehicles_have_a_list_of_their_own():
    scan = heard()
    scan.kind[0, 2:] = VEHICLE
    assert senders(heeded(scan, '1', vehicles=('4',))[1]) == [1, 4]


def test_an_anchor_does_not_get_in_as_a_vehicle_whose_list_does_not_hold_it():
    scan = heard()
    scan.kind[:] = VEHICLE
    assert senders(heeded(scan, '1-4', vehicles=('9',))[1]) == []


def test_others_are_counted_by_vehicle_and_by_sender():
    scan = heard(vehicles=2)
    scan.sender[0, :2] = -1
    speakers, _ = heeded(scan, '4')
    assert speakers.ignored.tolist() == [1, 3]
    assert speakers.senders == {3: 2, 1: 1, 2: 1}


def test_memory_does_not_grow_with_made_up_ids():
    speakers, _ = heeded(heard(senders=range(1000)), '2000')
    assert speakers.ignored.tolist() == [1000]
    assert len(speakers.senders) == 100


def test_each_sender_is_news_once():
    speakers, _ = heeded(heard(), '3', '4')
    assert speakers.news() == {1: 1, 2: 1}
    speakers.heed(heard(senders=(1, 7)), [0])
    assert speakers.news() == {7: 1}


@pytest.mark.parametrize(('settings', 'error'), [
    ({'anchor_allowlist': ['maps']}, "anchor_allowlist: 'maps' is not allowed, must be 'all', "
     "'map', an id, or a span of ids as '10-19'"),
    ({'anchor_allowlist': ['9-3']}, "'9-3' is not allowed"),
    ({'anchor_allowlist': ['-3']}, "'-3' is not allowed"),
    ({'anchor_allowlist': ['4294967296']}, "'4294967296' is not allowed"),
    ({'anchor_allowlist': ['9' * 5000]}, "is not allowed, must be 'all', 'map', an id, or a span"),
    ({'anchor_allowlist': []}, 'anchor_allowlist: an empty list is not allowed'),
    ({'vehicle_allowlist': ['map']}, "vehicle_allowlist: 'map' is not allowed, must be 'all', an "
     'id')])
def test_lists_that_cannot_be_read_are_refused(settings, error):
    with pytest.raises(ConfigError, match=error):
        Localizer(settings)


def test_ids_may_be_numbers_as_yaml_has_them():
    assert SpeakerConfig(anchor_allowlist=[7, 'map']).anchor_allowlist == ('7', 'map')


# --- in a localizer --------------------------------------------------------------------------

def test_a_stranger_that_lies_does_not_move_the_estimate():
    lying = heard(senders=(1, 2, 3, 66))
    lying.range[0, 3] = 500
    _, (honest,) = localize(heard(senders=(1, 2, 3)))
    _, (estimate,) = localize(lying, anchor_allowlist=['1-4'])
    np.testing.assert_array_equal(estimate.mean, honest.mean)
    assert estimate.heard.tolist() == [3]


@pytest.mark.parametrize('allowed', ['all', '1-4'])
def test_a_stranger_who_claims_an_anchors_id_elsewhere_does_not_spoil_the_others(allowed):
    def survey(localizer):
        localizer.anchor_map(heard(senders=(1, 2, 3, 66)))

    scan = heard(senders=(1, 2, 3, 66))
    scan.position[0, 3] += 50
    _, (estimate,) = localize(scan, before=survey, anchor_allowlist=[allowed])
    assert estimate.heard.tolist() == [3]


def test_the_silence_of_strangers_says_nothing():
    def mean(surveyed, **settings):
        scan = heard(senders=(1, 2))
        scan.range[:] = np.nan
        _, (estimate,) = localize(
            scan, before=lambda localizer: localizer.anchor_map(heard(senders=surveyed)),
            method='mcl', silence='map', motion_model='random', radio_range=80.0, **settings)
        return estimate.mean

    np.testing.assert_array_equal(
        mean((1, 2, 3, 4), anchor_allowlist=['1', '2']), mean((1, 2)))
    assert (mean((1, 2, 3, 4)) != mean((1, 2))).any()


def test_strangers_links_do_not_calibrate():
    place = np.array([[0, 0, 0], [10, 0, 0], [20, 0, 0]], np.float32)
    links = Links(np.array([1, 1, 9]), np.array([2, 9, 2]), place, place[[1, 2, 0]],
                  np.array([-60, -10, -10], np.float32))

    def reach(told, *heeded):
        localizer = Localizer({'radio_model': 'lognormal', 'anchor_allowlist': heeded})
        localizer.anchor_links(told)
        return localizer.channel.radio_range

    ours = reach(links.picked(np.array([True, False, False])), 'all')
    assert reach(links, '1', '2') == ours
    assert reach(links, 'all') != ours


def test_the_list_can_change_while_it_runs():
    localizer, _ = localize(heard(1.0), anchor_allowlist=['1'])
    localizer.reconfigure({'anchor_allowlist': ['1', '2', '3']})
    localizer.beacons(0, heard(2.0))
    assert [one.heard.tolist() for one in localizer.finish()] == [[3]]


def test_a_whole_fleet_handed_over_at_once_is_held_against_the_list_too():
    localizer = Localizer(SETTINGS | {'anchor_allowlist': ['1-3']}, 2)
    assert localizer.epoch(heard(vehicles=2)).heard.tolist() == [3, 3]


def test_a_line_says_who_was_ignored():
    assert ignored_note({7: 2, 3: 1}) == (
        'ignored beacons and ranges, 1 of id 3, 2 of id 7, whom neither anchor_allowlist nor '
        'vehicle_allowlist names')
