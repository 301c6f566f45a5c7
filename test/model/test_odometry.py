"""Odometry at the stamps of epochs, against motions that are known exactly."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.model.odometry import OdometryBuffer
from tsmcl_ros.types import Odometry


def pose(stamp, x=0.0, y=0.0, yaw=0.0):
    return Odometry(stamp, np.array([x, y, 0.0]), yaw)


def straight(stamp):
    """Return a pose of a straight drive with a constant turn."""
    return pose(stamp, 3 * stamp, -2 * stamp, np.angle(np.exp(1j * 0.5 * stamp)))


@given(rate=st.floats(0.5, 100), until=st.floats(1, 10))
def test_a_uniform_motion_is_interpolated_exactly(rate, until):
    buffer = OdometryBuffer(1, depth=2000)
    for stamp in np.arange(0, 12.1, 1 / rate):
        buffer.add(0, straight(stamp))
    buffer.motion(None, 0.0, 2)
    end = min(until, buffer.latest[0])
    motion = buffer.motion(0.0, end, 2)
    np.testing.assert_allclose(motion.displacement, [[3 * end, -2 * end]], atol=1e-9)
    np.testing.assert_allclose(motion.turn, [0.5 * end], atol=1e-9)
    assert motion.elapsed == end


def test_each_displacement_starts_where_the_last_one_ended():
    buffer = OdometryBuffer(1)
    for stamp in np.arange(0, 5.1, 0.25):
        buffer.add(0, straight(stamp))
    stamps = [0.1, 0.8, 1.5, 3.3, 4.3]
    buffer.motion(None, stamps[0], 2)
    total = sum(buffer.motion(since, until, 2).displacement
                for since, until in zip(stamps, stamps[1:], strict=False))
    np.testing.assert_allclose(total, [[3 * 4.2, -2 * 4.2]])


def test_the_yaw_goes_on_across_pi():
    buffer = OdometryBuffer(1)
    for stamp, yaw in ((0.0, 3.0), (1.0, 3.1), (2.0, -3.1), (3.0, -3.0)):
        buffer.add(0, pose(stamp, yaw=yaw))
    buffer.motion(None, 0.5, 2)
    turn = buffer.motion(0.5, 2.5, 2).turn[0]
    assert turn == pytest.approx(2 * np.pi - 6.1)
    assert buffer.at_epoch[0, 3] == pytest.approx(2 * np.pi - 3.05)


def test_the_yaw_between_poses_on_both_sides_of_pi_is_not_turned_round():
    buffer = OdometryBuffer(1)
    buffer.add(0, pose(0.0, yaw=3.1))
    buffer.add(0, pose(1.0, yaw=-3.1))
    buffer.motion(None, 0.5, 2)
    assert np.angle(np.exp(1j * (buffer.at_epoch[0, 3] - np.pi))) == pytest.approx(0, abs=1e-12)


def test_outside_of_what_is_known_the_nearest_pose_holds():
    buffer = OdometryBuffer(1)
    buffer.add(0, pose(1.0, x=5.0))
    buffer.add(0, pose(2.0, x=6.0))
    buffer.motion(None, 0.0, 2)
    assert buffer.at_epoch[0, 0] == 5.0
    buffer.motion(0.0, 3.0, 2)
    assert buffer.at_epoch[0, 0] == 6.0


def test_what_a_late_pose_missed_comes_with_the_next_motion():
    buffer = OdometryBuffer(1)
    buffer.add(0, pose(0.0))
    buffer.motion(None, 0.0, 2)
    assert buffer.motion(0.0, 1.0, 2).displacement[0, 0] == 0.0
    buffer.add(0, pose(2.0, x=8.0))
    assert buffer.motion(1.0, 2.0, 2).displacement[0, 0] == 8.0


def test_nobody_having_odometry_is_no_motion():
    buffer = OdometryBuffer(2)
    assert buffer.motion(0.0, 1.0, 2) is None
    assert np.isnan(buffer.at_epoch).all()


def test_a_vehicle_without_odometry_has_a_displacement_of_nan():
    buffer = OdometryBuffer(2)
    for stamp in (0.0, 1.0):
        buffer.add(1, straight(stamp))
    buffer.motion(None, 0.0, 2)
    motion = buffer.motion(0.0, 1.0, 2)
    assert np.isnan(motion.displacement[0]).all()
    np.testing.assert_allclose(motion.displacement[1], [3, -2])


def test_a_displacement_is_known_from_the_second_epoch_with_odometry():
    buffer = OdometryBuffer(1)
    for stamp in (0.0, 1.0, 2.0):
        buffer.add(0, straight(stamp))
    assert np.isnan(buffer.motion(None, 1.0, 2).displacement).all()
    assert np.isfinite(buffer.motion(1.0, 2.0, 2).displacement).all()


def test_the_height_counts_in_three_dimensions():
    buffer = OdometryBuffer(1)
    for stamp in (0.0, 1.0):
        buffer.add(0, Odometry(stamp, np.array([0, 0, 7 * stamp]), 0.0))
    buffer.motion(None, 0.0, 3)
    np.testing.assert_allclose(buffer.motion(0.0, 1.0, 3).displacement, [[0, 0, 7]])


def test_the_oldest_poses_make_place():
    buffer = OdometryBuffer(1, depth=4)
    for stamp in range(10):
        buffer.add(0, straight(float(stamp)))
    buffer.motion(None, 6.5, 2)
    assert buffer.at_epoch[0, 0] == 3 * 6.5
    buffer.motion(6.5, 2.0, 2)
    assert buffer.at_epoch[0, 0] == 3 * 6.0


def test_adding_all_vehicles_at_once_is_adding_each():
    one, other = OdometryBuffer(2), OdometryBuffer(2)
    for stamp in (0.0, 1.0, 2.0):
        poses = [pose(stamp, stamp, 1.0, 3 * stamp), pose(stamp, 2 * stamp, 0.0, -3 * stamp)]
        for vehicle, item in enumerate(poses):
            one.add(vehicle, item)
        other.add_all(stamp, np.stack([item.position[:2] for item in poses]),
                      np.array([item.yaw for item in poses]))
    for stamp in (0.5, 1.75):
        first, second = (buffer.motion(0.0, stamp, 2) for buffer in (one, other))
        np.testing.assert_array_equal(first.displacement, second.displacement)
        np.testing.assert_array_equal(first.turn, second.turn)


def test_without_yaws_nobody_turns():
    buffer = OdometryBuffer(1)
    for stamp in (0.0, 1.0):
        buffer.add_all(stamp, np.array([[stamp, 0.0]]), None)
    buffer.motion(None, 0.0, 2)
    motion = buffer.motion(0.0, 1.0, 2)
    assert motion.turn.tolist() == [0]
    assert motion.displacement.tolist() == [[1, 0]]


def test_odometry_that_has_ceased_is_none_rather_than_one_of_a_vehicle_that_stands():
    buffer = OdometryBuffer(2)
    for stamp in np.arange(0, 2.1, 0.1):
        buffer.add(0, pose(stamp, x=stamp))
    for stamp in (0.0, 2.0):
        buffer.add(1, pose(stamp, x=stamp))
    buffer.motion(None, 2.0, 2)
    motion = buffer.motion(2.0, 4.0, 2)
    assert np.isnan(motion.displacement[0]).all()
    # One that comes each other second is not late yet.
    np.testing.assert_array_equal(motion.displacement[1], [0.0, 0.0])
