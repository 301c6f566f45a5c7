"""Whom a cooperative simulation waits for, with poses that are encoded for real."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.nodes.reports import Reports
from tsmcl_ros.types import MessageError

ALL = np.ones(3, bool)


def pose(stamp: float, x: float = 0.0, frame_id: str = 'map') -> bytes:
    return messages.encode_pose(
        stamp, frame_id, np.array([x, 0.0]), np.eye(2), float('nan'), float('nan'))


def reports(*vehicles: int, stamp: float = 1.0) -> Reports:
    """Return what these of three vehicles, which all hear beacons, have reported."""
    found = Reports(3, 'map')
    found.expect(1.0, ALL)
    for vehicle in vehicles:
        found.take(vehicle, pose(stamp, x=vehicle))
    return found


def test_an_epoch_is_complete_when_all_who_hear_beacons_have_reported() -> None:
    assert not reports(0, 1).is_complete()
    assert reports(0, 1, 2).is_complete()
    assert not reports(0, 1, 2, stamp=0.9).is_complete()


def test_who_never_heard_a_beacon_is_not_waited_for() -> None:
    found = Reports(3, 'map')
    found.expect(1.0, np.array([True, False, False]))
    found.take(0, pose(1.0))
    assert found.is_complete()
    found.expect(2.0, np.array([False, True, False]))
    found.take(1, pose(2.0))
    assert not found.is_complete()  # once heard, waited for


def test_the_poses_are_those_that_were_sent_last() -> None:
    found = reports(0, 1, 2)
    found.take(1, pose(0.5, x=9.0))  # late
    poses = found.poses(2)
    assert poses.stamp.tolist() == [1, 1, 1]
    np.testing.assert_array_equal(poses.mean, [[0, 0], [1, 0], [2, 0]])
    np.testing.assert_array_equal(poses.covariance[2], np.eye(2))


def test_whom_one_has_given_up_counts_again_from_the_epoch_after_it_reports() -> None:
    found = reports(0, 1)
    assert found.give_up() == [2]
    assert found.is_complete()
    found.take(2, pose(1.0))
    assert np.isnan(found.poses(2).stamp).tolist() == [False, False, True]
    found.expect(2.0, ALL)
    for vehicle in range(3):
        found.take(vehicle, pose(2.0))
    assert found.is_complete()
    assert not np.isnan(found.poses(2).stamp).any()


def test_who_stays_silent_is_given_up_once() -> None:
    found = reports(0, 1)
    found.give_up()
    found.expect(2.0, ALL)
    found.take(0, pose(2.0))
    found.take(1, pose(2.0))
    assert found.is_complete()


@pytest.mark.parametrize('data', [pose(1.0, frame_id='odom'), b'\0\1\0\0broken'])
def test_what_is_no_pose_in_the_map_is_refused(data: bytes) -> None:
    with pytest.raises(MessageError):
        reports().take(0, data)
