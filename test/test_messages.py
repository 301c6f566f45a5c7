"""Messages against rclpy's serialization and rosbags' own, and against damage of all kinds."""

from dataclasses import replace
import math

from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import get_typestore, Stores
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range
from std_msgs.msg import UInt32
from tsmcl_ros import cdr, messages
from tsmcl_ros.types import MessageError, Observation, Odometry

pytestmark = pytest.mark.filterwarnings('error', 'ignore::DeprecationWarning:lark')

JAZZY = get_typestore(Stores.ROS2_JAZZY)
FOXY = get_typestore(Stores.ROS2_FOXY)

STAMPS = st.integers(0, 2**31 - 1).flatmap(
    lambda s: st.integers(0, 10**9 - 1).map(lambda ns: (s * 10**9 + ns) / 10**9))
FINITE = st.floats(-1e6, 1e6)
YAWS = st.floats(-3.14, 3.14)


# --- stamps ----------------------------------------------------------------------------------


@given(st.integers(0, 2**22 * 10**9 - 1))
def test_stamps_below_48_days_are_exact_to_the_nanosecond(nanoseconds):
    stamp = nanoseconds / 10**9
    found = deserialize_message(messages.encode_clock(stamp), Clock).clock
    assert found.sec * 10**9 + found.nanosec == nanoseconds
    assert messages.decode_clock(messages.encode_clock(stamp)) == stamp


@given(st.floats(2**22, 2**31, exclude_max=True))
def test_later_stamps_survive_as_the_doubles_that_they_are(stamp):
    assert messages.decode_clock(messages.encode_clock(stamp)) == stamp


@given(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))
def test_a_stamp_is_the_nearest_double_in_bulk_as_alone(seconds, nanoseconds):
    message = OdometryMessage()
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    data = serialize_message(message)
    nearest = (seconds * 10**9 + nanoseconds) / 10**9
    assert messages.decode_odometry(data).stamp == nearest
    assert messages.decode_odometries([data]).stamp == [nearest]


@pytest.mark.parametrize('stamp', [-1e-9, math.nan, math.inf, 2.0**31])
def test_what_is_no_stamp_is_not_written(stamp):
    with pytest.raises(MessageError, match='stamp .* is not allowed, must be at least 0'):
        messages.encode_clock(stamp)


@pytest.mark.parametrize('fields', [(-1, 0), (0, 10**9), (5, 2**32 - 1)])
def test_what_is_no_stamp_is_not_read(fields):
    writer = cdr.Writer()
    writer.values('iI', *fields)
    with pytest.raises(MessageError, match=f'stamp of {fields[0]} s and {fields[1]} ns'):
        messages.decode_clock(writer.finish())


# --- poses, odometry, ranges -----------------------------------------------------------------


def heading(orientation):
    """Yaw of a rotation about z, by the half-angle formula."""
    return 2 * math.atan2(orientation.z, orientation.w)


@given(STAMPS, FINITE, FINITE, FINITE, YAWS)
def test_odometry_reads_the_same_in_rclpy_and_rosbags(stamp, x, y, z, yaw):
    sent = Odometry(stamp, np.array([x, y, z]), yaw)
    data = messages.encode_odometry(sent, 'odom', 'base_link', [3.0, 0.5])
    for found in (deserialize_message(data, OdometryMessage),
                  JAZZY.deserialize_cdr(data, messages.ODOMETRY)):
        assert (found.header.frame_id, found.child_frame_id) == ('odom', 'base_link')
        position = found.pose.pose.position
        assert (position.x, position.y, position.z) == (x, y, z)
        assert heading(found.pose.pose.orientation) == pytest.approx(yaw, abs=1e-12)
        assert (found.twist.twist.linear.x, found.twist.twist.linear.y) == (3.0, 0.5)
        assert not np.any(found.pose.covariance)
        assert not np.any(found.twist.covariance)


@given(STAMPS, FINITE, FINITE, FINITE, YAWS, st.floats(0.1, 10),
       st.text(max_size=9).filter(lambda text: '\0' not in text and text.isprintable()))
def test_odometry_of_rclpy_and_rosbags_is_read(stamp, x, y, z, yaw, length, child):
    message = OdometryMessage(child_frame_id=child)
    message.header.frame_id = 'odom'
    message.header.stamp.sec = int(stamp)
    pose = message.pose.pose
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.z = length * math.sin(yaw / 2)
    pose.orientation.w = length * math.cos(yaw / 2)
    data = serialize_message(message)
    again = JAZZY.serialize_cdr(JAZZY.deserialize_cdr(data, messages.ODOMETRY), messages.ODOMETRY)
    for found in map(messages.decode_odometry, (data, bytes(again))):
        assert found.stamp == int(stamp)
        np.testing.assert_array_equal(found.position, [x, y, z])
        assert found.yaw == pytest.approx(yaw, abs=1e-12)


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_pose_reads_the_same_in_rclpy_and_rosbags(dimension):
    mean, covariance = np.array([1.5, -2.5, 3.5][:dimension]), np.eye(dimension) + 0.25
    data = messages.encode_pose(7.5, 'map', mean, covariance, 0.5, 0.01)
    for found in (deserialize_message(data, PoseWithCovarianceStamped),
                  JAZZY.deserialize_cdr(data, messages.POSE)):
        assert found.header.frame_id == 'map'
        position = found.pose.pose.position
        assert [position.x, position.y, position.z] == [*mean, 0.0][:3]
        assert heading(found.pose.pose.orientation) == pytest.approx(0.5)
        matrix = np.reshape(found.pose.covariance, (6, 6))
        np.testing.assert_array_equal(matrix[:dimension, :dimension], covariance)
        unmeasured = [*range(dimension, 3), 3, 4]
        np.testing.assert_array_equal(np.diag(matrix)[unmeasured], messages.UNMEASURED)
        assert matrix[5, 5] == 0.01


def test_a_pose_survives_a_round_trip():
    data = messages.encode_pose(7.5, 'map', np.array([1.5, -2.5]), np.eye(2), 0.5, 0.01)
    for again in (data, serialize_message(deserialize_message(data, PoseWithCovarianceStamped))):
        found = messages.decode_pose(again)
        assert (found.stamp, found.frame_id) == (7.5, 'map')
        assert found.yaw == pytest.approx(0.5)
        np.testing.assert_array_equal(found.position, [1.5, -2.5, 0])
        np.testing.assert_array_equal(found.covariance[:2, :2], np.eye(2))


def test_poses_of_a_fleet_are_those_of_its_vehicles():
    mean, covariance = np.array([[1.5, -2.5], [3.0, 4.0]]), np.array([np.eye(2), 2 * np.eye(2)])
    yaw = np.array([0.5, math.nan])
    found = [deserialize_message(data, PoseWithCovarianceStamped).pose for data in
             messages.encode_poses(7.5, 'map', mean, covariance, yaw, np.array([0.1, math.nan]))]
    assert [[pose.pose.position.x, pose.pose.position.y] for pose in found] == mean.tolist()
    assert [pose.covariance[0] for pose in found] == [1.0, 2.0]
    assert [pose.covariance[35] for pose in found] == [0.1, messages.UNMEASURED]
    assert heading(found[0].pose.orientation) == pytest.approx(0.5)


def test_a_yaw_that_is_not_known_comes_back_as_that():
    pose = messages.encode_pose(7.5, 'map', np.zeros(2), np.eye(2), math.nan, math.nan)
    found = deserialize_message(pose, PoseWithCovarianceStamped)
    assert found.pose.pose.orientation.w == 1.0
    assert found.pose.covariance[35] == messages.UNMEASURED
    assert math.isnan(messages.decode_pose(pose).yaw)
    assert np.isnan(messages.decode_poses([pose]).yaw).all()
    truth = messages.encode_odometry(Odometry(7.5, np.zeros(3), math.nan), 'map', 'base_link')
    assert np.isnan(messages.decode_odometries([truth]).yaw).all()


def pose_message(**changes):
    """Return a pose as RViz sends it, with some doubles changed."""
    message = PoseWithCovarianceStamped()
    message.pose.covariance = np.diag([0.25, 0.25, 0, 0, 0, 0.07]).ravel()
    for name, value in changes.items():
        if name.startswith('c'):
            message.pose.covariance[int(name[1:])] = value
        else:
            part = message.pose.pose.position if name in 'xyz' else message.pose.pose.orientation
            setattr(part, name[-1], value)
    return serialize_message(message)


def test_a_pose_as_rviz_sends_it_is_read():
    found = messages.decode_pose(pose_message(x=3.0))
    np.testing.assert_array_equal(found.position, [3, 0, 0])
    np.testing.assert_array_equal(np.diag(found.covariance), [0.25, 0.25, 0, 0, 0, 0.07])


@pytest.mark.parametrize(('changes', 'error'), [
    ({'x': math.nan}, 'position x nan, y 0, z 0 is not allowed, must be finite'),
    ({'z': math.inf}, 'position x 0, y 0, z inf is not allowed'),
    ({'qw': 0.0}, 'orientation 0 0 0 0 is not allowed, must be a quaternion'),
    ({'qx': math.nan}, 'orientation nan 0 0 1 is not allowed'),
    ({'qx': 1e200}, r'orientation 1e\+200 0 0 1 is not allowed'),
    ({'c0': math.nan}, 'pose.covariance is not allowed, must be finite, symmetric and positive '
                       'semidefinite'),
    ({'c0': -1.0}, 'pose.covariance is not allowed'),
    ({'c1': 0.1}, 'pose.covariance is not allowed'),
    ({'c1': 1.0, 'c6': 1.0}, 'pose.covariance is not allowed'),
    ({'c3': 1e300, 'c18': 1e300}, 'pose.covariance is not allowed'),
    ({'c0': 1e-300, 'c3': 1e300, 'c18': 1e300, 'c21': 1e-300}, 'pose.covariance is not allowed'),
])
def test_a_pose_is_refused(changes, error):
    with pytest.raises(MessageError, match=error):
        messages.decode_pose(pose_message(**changes))


def test_a_position_that_is_not_finite_is_not_written():
    with pytest.raises(MessageError, match='position .* is not allowed, must be finite'):
        messages.encode_pose(1.0, 'map', np.array([math.nan, 0]), np.eye(2), 0.0, 1.0)
    with pytest.raises(MessageError, match='position .* is not allowed, must be finite'):
        messages.encode_odometry(Odometry(1.0, np.full(3, math.inf), 0.0), 'odom', 'base_link')


def stacked(arrays):
    return np.concatenate([np.empty(0), *(array.ravel() for array in arrays)])


@settings(deadline=None)
@given(st.lists(st.tuples(FINITE, FINITE, YAWS), max_size=20), st.text('abcdefgh', max_size=8))
def test_trajectories_in_bulk_are_what_single_messages_say(poses, frame):
    data = [messages.encode_pose(0.1 * k, frame, np.array([x, y]), np.eye(2) * (k + 1), yaw, 1.0)
            for k, (x, y, yaw) in enumerate(poses)]
    single = [messages.decode_pose(one) for one in data]
    found = messages.decode_poses(data)
    np.testing.assert_array_equal(found.stamp, [one.stamp for one in single])
    np.testing.assert_array_equal(found.position.ravel(), stacked(one.position for one in single))
    np.testing.assert_array_equal(found.yaw, [one.yaw for one in single])
    np.testing.assert_array_equal(
        found.covariance.ravel(), stacked(one.covariance[:3, :3] for one in single))
    data = [messages.encode_odometry(Odometry(0.1 * k, np.array([x, y, 1]), yaw), frame, 'base')
            for k, (x, y, yaw) in enumerate(poses)]
    single = [messages.decode_odometry(one) for one in data]
    found = messages.decode_odometries(data)
    np.testing.assert_array_equal(found.stamp, [one.stamp for one in single])
    np.testing.assert_array_equal(found.position.ravel(), stacked(one.position for one in single))
    np.testing.assert_array_equal(found.yaw, [one.yaw for one in single])
    assert found.covariance is None


def odometry_at(*stamps, frame='odom', child='base', x=1.0):
    return [messages.encode_odometry(Odometry(stamp, np.array([x, 0, 0]), 0.0), frame, child)
            for stamp in stamps]


def test_messages_padded_in_different_ways_are_one_trajectory():
    data = odometry_at(1.0, 2.0, 3.0)
    data[1] += bytes(3)
    gaps = bytearray(data[2])
    gaps[22] = gaps[34] = 255  # behind the texts, where Fast DDS leaves what the memory held
    found = messages.decode_odometries([data[0], data[1], bytes(gaps)])
    assert found.stamp.tolist() == [1, 2, 3]


def test_a_repeated_stamp_is_left_out():
    assert messages.decode_odometries(odometry_at(0.0, 1.0, 1.0, 1.0, 2.0)).stamp.tolist() == [
        0, 1, 2]


@pytest.mark.parametrize(('data', 'error'), [
    (odometry_at(1.0, 2.0, 1.5), 'message 2: stamp 1.500000000 s goes back, must be at least'),
    (odometry_at(1.0) + odometry_at(2.0, frame='maps'),
     "message 1: its frame is 'maps' to 'base', must be as before 'odom' to 'base'"),
    (odometry_at(1.0) + odometry_at(2.0, frame='a_map'), "message 1: its frame is 'a_map' to"),
    (odometry_at(1.0, 2.0) + odometry_at(3.0, child='b_se'), "message 2: its frame is 'odom' to"),
    (odometry_at(1.0) + [odometry_at(2.0)[0][:-1]], 'message 1: truncated'),
    (odometry_at(1.0, 2.0) + [b'\0\0' + odometry_at(3.0)[0][2:]], 'message 2: big-endian'),
    (odometry_at(1.0) + [pose_message()], 'message 1: '),
    (odometry_at(1.0) + [odometry_at(2.0)[0][:4] + b'\xff' * 8 + odometry_at(2.0)[0][12:]],
     'message 1: stamp of -1 s and 4294967295 ns'),
    (odometry_at(1.0) + [odometry_at(2.0, x=77.0)[0].replace(
        np.float64(77).tobytes(), np.float64(math.nan).tobytes())],
     'message 1: position x nan, y 0, z 0 is not allowed'),
    (odometry_at(1.0) + [odometry_at(2.0)[0].replace(np.float64(1).tobytes(), bytes(8))],
     'message 1: orientation 0 0 0 0'),
    (odometry_at(1.0) + [messages.encode_odometry(Odometry(2.0, np.zeros(3), math.nan), 'odom',
     'base').replace(np.float64(messages.UNMEASURED).tobytes(), np.float64(math.inf).tobytes())],
     'message 1: pose.covariance is not allowed, must be finite'),
])
def test_a_trajectory_names_the_message_that_is_wrong(data, error):
    with pytest.raises(MessageError, match=error):
        messages.decode_odometries(data)


def test_a_trajectory_of_nothing_is_empty():
    found = messages.decode_poses([])
    assert found.stamp.shape == (0,)
    assert found.position.shape == (0, 3)
    assert found.covariance.shape == (0, 3, 3)


def test_a_reading_of_jazzy_has_a_variance_and_one_of_foxy_has_none():
    header = FOXY.types['std_msgs/msg/Header'](
        stamp=FOXY.types['builtin_interfaces/msg/Time'](sec=3, nanosec=500_000_000),
        frame_id='n_7')
    foxy = FOXY.types[messages.RANGE](
        header=header, radiation_type=0, field_of_view=0.0, min_range=0.0, max_range=0.0,
        range=7.5)
    found = messages.decode_range(bytes(FOXY.serialize_cdr(foxy, messages.RANGE)))
    assert (found.stamp, found.frame_id, found.range) == (3.5, 'n_7', 7.5)
    assert math.isnan(found.variance)
    assert math.isnan(found.max_range)
    jazzy = Range(min_range=0.5, max_range=50.0, range=7.5, variance=0.25)
    jazzy.header.frame_id = 'n_7'
    found = messages.decode_range(serialize_message(jazzy))
    assert (found.range, found.min_range, found.max_range, found.variance) == (7.5, 0.5, 50, 0.25)


def test_a_reading_reads_the_same_in_rclpy_and_rosbags():
    sent = messages.RangeReading(3.5, 'n_7', 7.5, 0.5, 50.0, 0.25)
    data = messages.encode_range(sent)
    assert messages.decode_range(data) == sent
    for found in (deserialize_message(data, Range), JAZZY.deserialize_cdr(data, messages.RANGE)):
        assert (found.header.frame_id, found.range, found.variance) == ('n_7', 7.5, 0.25)
        assert (found.min_range, found.max_range) == (0.5, 50.0)


@pytest.mark.parametrize('measured', [math.nan, math.inf, -math.inf, 0.25, 51.0])
def test_a_reading_out_of_reach_is_no_measurement(measured):
    data = serialize_message(Range(min_range=0.5, max_range=50.0, range=measured))
    assert math.isnan(messages.decode_range(data).range)


def test_a_negative_reading_is_refused():
    with pytest.raises(MessageError, match='range -1 is not allowed, must be at least 0'):
        messages.decode_range(serialize_message(Range(range=-1.0)))


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('count', [0, 1, 50])
def test_particles_read_the_same_in_rclpy_and_rosbags(count, dimension):
    particles = np.random.default_rng(0).normal(size=(count, dimension)).astype(np.float32)
    data = messages.encode_pose_array(7.5, 'map', particles)
    for found in (deserialize_message(data, PoseArray),
                  JAZZY.deserialize_cdr(data, messages.POSE_ARRAY)):
        assert found.header.frame_id == 'map'
        poses = [(p.position.x, p.position.y, p.position.z)[:dimension] for p in found.poses]
        np.testing.assert_array_equal(np.reshape(poses, (count, dimension)), particles)
        assert all(pose.orientation.w == 1.0 for pose in found.poses)


# --- periods ---------------------------------------------------------------------------------

@given(st.integers(1, 2**31 - 1))
def test_a_period_factor_is_what_ros_reads(factor):
    data = messages.encode_period(factor)
    assert deserialize_message(data, UInt32).data == factor
    assert messages.decode_period(serialize_message(UInt32(data=factor))) == factor


@pytest.mark.parametrize('factor', [0, 2**31, 2**32 - 1])
def test_a_period_factor_that_is_none_is_refused(factor):
    with pytest.raises(MessageError, match=f'period factor {factor} is not allowed, must be '
                                           'from 1 to 2147483647'):
        messages.decode_period(messages.encode_period(factor))


# --- damage ----------------------------------------------------------------------------------

DECODERS = {
    messages.POINT_CLOUD: messages.decode_beacons,
    messages.ODOMETRY: messages.decode_odometry,
    messages.POSE: messages.decode_pose,
    messages.RANGE: messages.decode_range,
    messages.CLOCK: messages.decode_clock,
    messages.UINT32: messages.decode_period,
    messages.POSE_STAMPED: lambda data: messages.decode_any_pose(messages.POSE_STAMPED, data),
    'odometry as a pose': lambda data: messages.decode_any_pose(messages.ODOMETRY, data),
    'odometries': lambda data: messages.decode_odometries([data]),
    'poses': lambda data: messages.decode_poses([data]),
}
VALID = {
    messages.POINT_CLOUD: messages.encode_beacons(replace(
        Observation.empty(1, 3, 3, 12.25), sender=np.array([[7, 2**32 - 1, 9]]),
        range=np.array([[7.5, np.nan, 1e5]]), rssi=np.full((1, 3), -60.0)), 'map')[0],
    messages.ODOMETRY: odometry_at(1.0)[0],
    messages.POSE: pose_message(),
    messages.RANGE: messages.encode_range(messages.RangeReading(3.5, 'n', 7.5, 0.5, 50.0, 0.25)),
    messages.CLOCK: messages.encode_clock(1.5),
    messages.UINT32: messages.encode_period(5),
    messages.POSE_STAMPED: serialize_message(PoseStamped()),
    'odometry as a pose': odometry_at(1.0)[0],
    'odometries': odometry_at(1.0)[0],
    'poses': pose_message(),
}


@pytest.mark.parametrize('kind', DECODERS)
def test_truncation_anywhere_is_refused(kind):
    shortest = 4 if kind == messages.RANGE else 0  # without its variance it is one of foxy's
    for size in range(len(VALID[kind]) - shortest):
        with pytest.raises(MessageError):
            DECODERS[kind](VALID[kind][:size])


@pytest.mark.parametrize('kind', DECODERS)
def test_a_longer_message_is_refused(kind):
    with pytest.raises(MessageError, match='bytes follow the last field'):
        DECODERS[kind](VALID[kind] + bytes(4))


@pytest.mark.parametrize('kind', DECODERS)
@given(data=st.one_of(st.binary(max_size=200), st.binary(max_size=900).map(cdr.HEADER.__add__)))
def test_arbitrary_bytes_raise_a_message_error_at_most(kind, data):
    try:
        DECODERS[kind](data)
    except MessageError as error:
        assert '\n' not in str(error)


EXTREMES = [b'\xff\xff\xff\xff', b'\0\0\0\x80', b'\0\0\x80\x7f', b'\1\0\x80\x7f', b'\0\0\xf0\x7f']


@pytest.mark.parametrize('kind', DECODERS)
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_mutations_raise_a_message_error_at_most(kind, data):
    mutated = bytearray(VALID[kind])
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(4, len(mutated) - 1))
        some = data.draw(st.one_of(st.binary(min_size=1, max_size=4), st.sampled_from(EXTREMES)))
        mutated[place:place + len(some)] = some
    try:
        DECODERS[kind](bytes(mutated[:len(VALID[kind])]))
    except MessageError as error:
        assert '\n' not in str(error)


@pytest.mark.parametrize('x', [1.1e8, -1e300])
def test_a_place_beyond_the_earth_is_refused(x):
    data = messages.encode_odometry(Odometry(1.0, np.array([x, 0.0, 0.0]), 0.0), 'odom', 'base')
    error = 'position x .* is not allowed, must be finite and within 1e[+]08 m'
    for decode in (messages.decode_odometry, lambda data: messages.decode_odometries([data])):
        with pytest.raises(MessageError, match=error):
            decode(data)


def test_a_range_beyond_any_radio_is_refused():
    message = Range(range=3e38)
    with pytest.raises(MessageError, match=r'range 3e\+38 is not allowed, must be at most 1e\+06'):
        messages.decode_range(serialize_message(message))
