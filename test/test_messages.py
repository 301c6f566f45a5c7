"""Messages against rclpy's serialization and rosbags' own, and against damage of all kinds."""

from dataclasses import replace
import math

from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import get_typestore, Stores
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField, Range
from std_msgs.msg import UInt32
from tsmcl_ros import cdr, messages
from tsmcl_ros.types import Links, MessageError, Observation, Odometry

pytestmark = pytest.mark.filterwarnings('error')

JAZZY = get_typestore(Stores.ROS2_JAZZY)
FOXY = get_typestore(Stores.ROS2_FOXY)
DATATYPES = {'u1': PointField.UINT8, 'i4': PointField.INT32, 'u4': PointField.UINT32,
             'f4': PointField.FLOAT32, 'f8': PointField.FLOAT64}
CLASSES = {
    messages.POINT_CLOUD: PointCloud2, messages.ODOMETRY: OdometryMessage,
    messages.POSE: PoseWithCovarianceStamped, messages.POSE_ARRAY: PoseArray,
    messages.RANGE: Range, messages.CLOCK: Clock,
}
OBSERVED = ('sender', 'kind', 'hops', 'position', 'covariance', 'max_range', 'range', 'range_std',
            'rssi')

STAMPS = st.integers(0, 2**31 - 1).flatmap(
    lambda s: st.integers(0, 10**9 - 1).map(lambda ns: (s * 10**9 + ns) / 10**9))
FINITE = st.floats(-1e6, 1e6)
YAWS = st.floats(-3.14, 3.14)


def observation(vehicles=1, references=6, dimension=3, stamp=12.25, seed=0):
    """Return an observation with something in every field."""
    rng = np.random.default_rng(seed)
    scan = Observation.empty(vehicles, references, dimension, stamp)
    scan.sender[:] = rng.permutation(2**32 - 1 - np.arange(references))[None]
    scan.kind[:] = rng.integers(0, 2, scan.kind.shape)
    scan.hops[:] = rng.integers(1, 3, scan.hops.shape)
    scan.position[:] = rng.uniform(-1e5, 1e5, scan.position.shape)
    root = rng.normal(size=scan.covariance.shape)
    scan.covariance[:] = root @ np.swapaxes(root, -1, -2)
    for name in ('max_range', 'range', 'range_std'):
        getattr(scan, name)[:] = rng.uniform(1, 1000, scan.sender.shape)
    scan.rssi[:] = rng.uniform(-100, -30, scan.sender.shape)
    scan.range[:, ::2] = np.nan
    return scan


def cloud(rows, layout=None, step=None, **changes):
    """
    Return a PointCloud2 of dicts, one a beacon, as a driver would make it with rclpy.

    `layout` gives (name, format, offset) of the fields, `step` the size of a row; by default
    they are packed. `changes` are what the message says otherwise.
    """
    if layout is None:
        formats = {'id': 'u4', 'kind': 'u1', 'hops': 'u1'}
        layout, offset = [], 0
        for name in rows[0]:
            layout.append((name, formats.get(name, 'f4'), offset))
            offset += np.dtype(layout[-1][1]).itemsize
    step = step or max(offset + np.dtype(form).itemsize for _, form, offset in layout)
    table = np.zeros(len(rows), np.dtype({
        'names': [name for name, _, _ in layout], 'formats': ['<' + f for _, f, _ in layout],
        'offsets': [offset for _, _, offset in layout], 'itemsize': step}))
    for place, row in enumerate(rows):
        for name, value in row.items():
            table[name][place] = value
    message = PointCloud2(
        height=1, width=len(rows), point_step=step, row_step=step * len(rows),
        fields=[PointField(name=name, offset=offset, datatype=DATATYPES[form], count=1)
                for name, form, offset in layout],
        data=table.tobytes(), is_dense=True)
    message.header.frame_id = 'map'
    for name, value in changes.items():
        setattr(message, name, value)
    return serialize_message(message)


def beacon(number=1, **values):
    return {'x': 1.0, 'y': 2.0, 'z': 3.0, 'id': number, **values}


def assert_equal(found, expected):
    assert found.stamp == expected.stamp
    for name in OBSERVED:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


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


# --- beacons ---------------------------------------------------------------------------------


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('references', [0, 1, 6, 100])
def test_beacons_survive_a_round_trip(dimension, references):
    sent = observation(references=references, dimension=dimension)
    data, = messages.encode_beacons(sent, 'map')
    found, frame_id = messages.decode_beacons(data)
    assert frame_id == 'map'
    assert found.position.shape == (1, references, 3)
    assert_equal(found.project(dimension), sent)
    assert not found.position[..., dimension:].any()


def test_each_vehicle_gets_a_message_of_what_it_heard():
    sent = observation(vehicles=3, references=4)
    sent.sender[1, 2:] = -1
    sent.sender[2] = -1
    scans = [messages.decode_beacons(data)[0] for data in messages.encode_beacons(sent, 'map')]
    assert [scan.sender.shape for scan in scans] == [(1, 4), (1, 2), (1, 0)]
    for number, scan in enumerate(scans):
        assert_equal(scan, sent.vehicle(number))


def test_beacons_read_the_same_in_rclpy_and_rosbags():
    sent = observation(references=5)
    data, = messages.encode_beacons(sent, 'map')
    for found in (deserialize_message(data, PointCloud2),
                  JAZZY.deserialize_cdr(data, messages.POINT_CLOUD)):
        assert found.header.frame_id == 'map'
        assert (found.header.stamp.sec, found.header.stamp.nanosec) == (12, 250_000_000)
        assert (found.height, found.width, found.row_step) == (1, 5, 5 * found.point_step)
        assert found.is_bigendian is False
        assert found.is_dense is False  # a range is NaN
        layout = np.dtype({
            'names': [field.name for field in found.fields],
            'formats': [{v: k for k, v in DATATYPES.items()}[field.datatype]
                        for field in found.fields],
            'offsets': [field.offset for field in found.fields],
            'itemsize': found.point_step})
        rows = np.frombuffer(bytes(found.data), layout)
        assert list(layout.names) == [
            'x', 'y', 'z', 'id', 'kind', 'hops', 'max_range', 'range', 'range_std', 'rssi',
            'cov_xx', 'cov_xy', 'cov_xz', 'cov_yy', 'cov_yz', 'cov_zz']
        np.testing.assert_array_equal(rows['id'], sent.sender[0])
        np.testing.assert_array_equal(rows['y'], sent.position[0, :, 1])
        np.testing.assert_array_equal(rows['cov_yz'], sent.covariance[0, :, 1, 2])
        np.testing.assert_array_equal(rows['rssi'], sent.rssi[0])


def test_a_scan_without_nan_is_dense():
    sent = observation()
    sent = replace(sent, range=np.ones_like(sent.range))
    data, = messages.encode_beacons(sent, 'map')
    assert deserialize_message(data, PointCloud2).is_dense is True


def test_beacons_that_other_tools_serialized_anew_are_the_same():
    sent = observation()
    data, = messages.encode_beacons(sent, 'map')
    for again in (serialize_message(deserialize_message(data, PointCloud2)),
                  JAZZY.serialize_cdr(JAZZY.deserialize_cdr(data, messages.POINT_CLOUD),
                                      messages.POINT_CLOUD)):
        assert_equal(messages.decode_beacons(bytes(again))[0], sent)


def test_absent_fields_are_not_measured():
    found, _ = messages.decode_beacons(cloud([beacon(7)]))
    assert_equal(found, replace(
        Observation.empty(1, 1, 3, 0.0), sender=np.array([[7]]),
        position=np.array([[[1, 2, 3]]])))


def test_unknown_covariance_terms_are_zero():
    found, _ = messages.decode_beacons(cloud([beacon(cov_xx=4.0, cov_yy=9.0, cov_zz=math.nan,
                                                     cov_xy=math.nan)]))
    np.testing.assert_array_equal(found.covariance[0, 0], np.diag([4, 9, 0]))


@st.composite
def layouts(draw):
    """Fields in any order, with gaps between them and strangers among them."""
    names = ['x', 'y', 'z', 'id', *draw(st.sets(st.sampled_from(messages.BEACON.names[4:])))]
    strangers = draw(st.sets(st.sampled_from(['intensity', 'ring', 'peer_id', 'grüß'])))
    layout, offset = [], draw(st.integers(0, 3))
    for name in draw(st.permutations([*names, *strangers])):
        form = {'id': 'u4', 'kind': 'u1', 'hops': 'u1', 'ring': 'i4'}.get(name, 'f4')
        if name in ('x', 'y', 'z'):
            form = draw(st.sampled_from(['f4', 'f8']))
        layout.append((name, form, offset))
        offset += np.dtype(form).itemsize + draw(st.integers(0, 5))
    return layout, offset + draw(st.integers(0, 3))


@settings(deadline=None)
@given(layouts(), st.integers(0, 5), st.integers(0, 99), STAMPS)
def test_fields_are_read_in_any_order_and_with_any_padding(layout, count, seed, stamp):
    fields, step = layout
    present = {name for name, _, _ in fields} & set(messages.BEACON.names)
    sent = observation(references=count, seed=seed)
    data, = messages.encode_beacons(sent, 'map')
    ours = deserialize_message(data, PointCloud2)
    table = np.frombuffer(bytes(ours.data), messages.BEACON)
    if {name for name in present if name.startswith('cov')} != set(messages.BEACON.names[10:]):
        present -= set(messages.BEACON.names[10:])  # a part of a covariance need not be one
        fields = [field for field in fields if not field[0].startswith('cov')]
    rows = [{name: row[name] for name in present} for row in table]
    message = deserialize_message(cloud(rows, fields, step), PointCloud2)
    message.header.stamp.sec = int(stamp)
    found, _ = messages.decode_beacons(serialize_message(message))
    assert found.stamp == int(stamp)
    expected = Observation.empty(1, count, 3, found.stamp)
    names = {'sender': 'id', 'position': 'x', 'covariance': 'cov_xx'}
    expected = replace(expected, **{
        name: getattr(sent, name) for name in OBSERVED if names.get(name, name) in present})
    assert_equal(found, expected)


def test_what_fills_the_gaps_between_fields_does_not_matter():
    """Fast DDS leaves them unset, so that equal messages differ in their bytes."""
    data = bytearray(messages.encode_beacons(observation(), 'map')[0])
    reader = cdr.Reader(bytes(data))
    reader.values('iI')
    reader.string()
    reader.values('II')
    messages._parse_layout(reader)
    before = len(messages._known_layouts)
    for filler in (1, 77, 255):
        for position in reader.padding:
            data[position] = filler
        found, _ = messages.decode_beacons(bytes(data))
        assert_equal(found, observation())
    assert len(messages._known_layouts) <= before + 1


def test_equal_observations_make_equal_bytes_whatever_the_memory_held():
    scan = observation(references=50)
    first, = messages.encode_beacons(scan, 'map')
    used = [np.full(3000, 255, np.uint8) for _ in range(100)]  # 50 rows of 60 bytes
    del used
    assert messages.encode_beacons(scan, 'map') == [first]
    data = np.frombuffer(deserialize_message(first, PointCloud2).data, np.uint8)
    assert not data.reshape(50, 60)[:, 18:20].any()  # between hops and max_range


def test_layouts_are_not_remembered_without_end():
    for step in range(100, 200):
        messages.decode_beacons(cloud([beacon()], step=step))
    assert len(messages._known_layouts) <= 16


def test_rows_may_be_spread_over_lines_of_an_image():
    data = cloud([beacon(number) for number in range(6)], height=2, width=3)
    assert messages.decode_beacons(data)[0].sender.tolist() == [[0, 1, 2, 3, 4, 5]]


def test_an_id_heard_twice_is_fine_where_its_position_is_the_same():
    found, _ = messages.decode_beacons(cloud([beacon(3, rssi=-50), beacon(3, rssi=-60)]))
    assert found.sender.tolist() == [[3, 3]]


def test_a_vehicle_may_be_heard_at_an_old_and_a_new_position():
    rows = [beacon(3, kind=1, hops=1), {**beacon(3, kind=1, hops=2), 'x': 8.0}]
    assert messages.decode_beacons(cloud(rows))[0].sender.tolist() == [[3, 3]]


FIELDS = [('x', 'f4', 0), ('y', 'f4', 4), ('z', 'f4', 8), ('id', 'u4', 12)]
BAD_CLOUDS = {
    'a missing field': (
        lambda: cloud([{'x': 1.0, 'y': 2.0, 'id': 3}]),
        'fields z are missing, must have at least x, y, z, id'),
    'several missing fields': (
        lambda: cloud([{'y': 2.0}]), 'fields x, z, id are missing'),
    'no fields': (lambda: cloud([beacon()], fields=[]), 'fields x, y, z, id are missing'),
    'an id that is a float': (
        lambda: cloud([beacon()], FIELDS[:3] + [('id', 'f4', 12)]),
        'field id: datatype FLOAT32 is not allowed, must be UINT32'),
    'an id that is signed': (
        lambda: cloud([beacon()], FIELDS[:3] + [('id', 'i4', 12)]),
        'field id: datatype INT32 is not allowed, must be UINT32'),
    'a coordinate that is whole': (
        lambda: cloud([beacon()], [('x', 'i4', 0), *FIELDS[1:]]),
        'field x: datatype INT32 is not allowed, must be FLOAT32 or FLOAT64'),
    'an rssi that is a double': (
        lambda: cloud([beacon(rssi=-1.0)], [*FIELDS, ('rssi', 'f8', 16)]),
        'field rssi: datatype FLOAT64 is not allowed, must be FLOAT32'),
    'an unheard-of datatype': (
        lambda: cloud([beacon()], fields=[PointField(name='x', datatype=9, count=1)]),
        'field x: datatype 9 is not allowed'),
    'a vector field': (
        lambda: cloud([beacon()], fields=[PointField(name='x', datatype=7, count=3)]),
        'field x: count 3 is not allowed, must be 1'),
    'a field that comes twice': (
        lambda: cloud([beacon()], fields=[PointField(name='x', datatype=7, count=1)] * 2),
        'field x comes twice'),
    'a point_step too small': (
        lambda: cloud([beacon()], point_step=14),
        'field id: offset 12 is not allowed, ends at byte 16 of a row whose point_step is 14'),
    'a point_step too large': (
        lambda: cloud([beacon()], point_step=20),
        'data has 16 bytes, must be height 1 x width 1 x point_step 20 = 20'),
    'a point_step beyond all sense': (
        lambda: cloud([], FIELDS, data=b'', point_step=2**32 - 1),
        'point_step 4294967295 is not allowed, must be at most 65536'),
    'too little data': (
        lambda: cloud([beacon()], data=bytes(15)), 'data has 15 bytes, must be .* = 16'),
    'too much data': (
        lambda: cloud([beacon()], data=bytes(32)), 'data has 32 bytes, must be .* = 16'),
    'a count that overflows': (
        lambda: cloud([beacon()], height=2**32 - 1, width=2**32 - 1),
        'data has 16 bytes, must be height 4294967295 x width 4294967295'),
    'big-endian rows': (
        lambda: cloud([beacon()], is_bigendian=True), 'is_bigendian true is not supported'),
    'a position that is NaN': (
        lambda: cloud([beacon(), {**beacon(5), 'z': math.nan}]),
        'z nan of id 5 is not allowed, must be a number'),
    'a position that is infinite': (
        lambda: cloud([{**beacon(5), 'y': -math.inf}]), 'y -inf of id 5 is not allowed'),
    'a position beyond 100 km': (
        lambda: cloud([{**beacon(5), 'x': 456789.0}]),
        'x 456789 of id 5 is not allowed, must be within 100 km of the origin: use a local'),
    'a position beyond FLOAT32': (
        lambda: cloud([{**beacon(5), 'x': 1e300}],
                      [('x', 'f8', 16), *FIELDS[1:]]), 'x inf of id 5 is not allowed'),
    'a negative range': (
        lambda: cloud([beacon(5, range=-0.5)]), 'range -0.5 of id 5 is not allowed, must be fin'),
    'an infinite range': (
        lambda: cloud([beacon(5, range=math.inf)]), 'range inf of id 5 is not allowed'),
    'a negative range_std': (
        lambda: cloud([beacon(5, range_std=-1.0)]), 'range_std -1 of id 5 is not allowed'),
    'a radio range of zero': (
        lambda: cloud([beacon(5, max_range=0.0)]), 'max_range 0 of id 5 .* must be above 0'),
    'an infinite rssi': (
        lambda: cloud([beacon(5, rssi=-math.inf)]), 'rssi -inf of id 5 is not allowed'),
    'an unknown kind': (
        lambda: cloud([beacon(5, kind=2)]), 'kind 2 is not allowed, must be 0 .anchor. or 1'),
    'no hops': (lambda: cloud([beacon(5, hops=0)]), 'hops 0 is not allowed, must be 1 .heard'),
    'too many hops': (lambda: cloud([beacon(5, hops=3)]), 'hops 3 is not allowed'),
    'a negative variance': (
        lambda: cloud([beacon(5, cov_yy=-1.0)]), 'cov_yy -1 of id 5 is not allowed'),
    'an infinite covariance': (
        lambda: cloud([beacon(5, cov_xy=math.inf)]), 'cov_xy inf of id 5 is not allowed'),
    'a covariance that is none': (
        lambda: cloud([beacon(5, cov_xx=1.0, cov_xy=2.0, cov_yy=1.0)]),
        'cov_xx to cov_zz are not allowed, must be positive semidefinite'),
    'a small covariance that is none beside a large variance': (
        lambda: cloud([beacon(5, cov_xx=1.0, cov_xy=2.0, cov_yy=1.0, cov_zz=1e9)]),
        'must be positive semidefinite'),
    'two anchors that claim one id': (
        lambda: cloud([beacon(5), beacon(6), {**beacon(5), 'y': 2.5}]),
        'two anchors claim id 5, at .1.0, 2.0, 3.0. and at .1.0, 2.5, 3.0.'),
    'a vehicle that claims the id of an anchor': (
        lambda: cloud([beacon(5, kind=0), beacon(6, kind=1), beacon(5, kind=1)]),
        'an anchor and a vehicle claim id 5: an id must have one sender'),
}


@pytest.mark.parametrize('what', BAD_CLOUDS)
def test_a_scan_is_refused_for(what):
    make, error = BAD_CLOUDS[what]
    with pytest.raises(MessageError, match=error):
        messages.decode_beacons(make())


def test_a_bad_layout_is_refused_every_time():
    data = cloud([beacon()], is_bigendian=True)
    for _ in range(3):
        with pytest.raises(MessageError, match='is_bigendian'):
            messages.decode_beacons(data)


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
    ({'c0': math.nan}, 'pose.covariance is not allowed'),
    ({'c0': -1.0}, 'pose.covariance is not allowed'),
    ({'c1': 0.1}, 'pose.covariance is not allowed'),
    ({'c1': 1.0, 'c6': 1.0}, 'pose.covariance is not allowed'),
    ({'c3': 1e300, 'c18': 1e300}, 'pose.covariance is not allowed'),
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
    'odometries': lambda data: messages.decode_odometries([data]),
    'poses': lambda data: messages.decode_poses([data]),
}
VALID = {
    messages.POINT_CLOUD: messages.encode_beacons(observation(), 'map')[0],
    messages.ODOMETRY: odometry_at(1.0)[0],
    messages.POSE: pose_message(),
    messages.RANGE: messages.encode_range(messages.RangeReading(3.5, 'n', 7.5, 0.5, 50.0, 0.25)),
    messages.CLOCK: messages.encode_clock(1.5),
    messages.UINT32: messages.encode_period(5),
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


# --- links -----------------------------------------------------------------------------------


def link(number=1, peer=2, **values):
    return {'x': float(number), 'y': 0.0, 'z': 3.0, 'id': number, 'peer_id': peer, 'rssi': -60.0,
            **values}


def links_of(rows):
    layout = [(name, 'u4' if 'id' in name else 'f4', 4 * place)
              for place, name in enumerate(rows[0])]
    return cloud(rows, layout)


def test_links_survive_a_round_trip():
    sent = Links(np.array([5, 9, 5]), np.array([9, 5, 2**32 - 2]),
                 *np.random.default_rng(0).uniform(-1e5, 1e5, (2, 3, 3)).astype(np.float32),
                 np.array([-60.5, -61, -90], np.float32))
    sent.receiver_position[2] = sent.receiver_position[0]
    sent = sent.without(np.array([2**32 - 2]))
    sent.sender_position[:] = sent.receiver_position[::-1]
    found, frame_id = messages.decode_links(messages.encode_links(1.5, sent, 'map'))
    assert frame_id == 'map'
    for name, value in vars(sent).items():
        np.testing.assert_array_equal(getattr(found, name), value, name)


def test_no_links_are_a_message_too():
    found, _ = messages.decode_links(messages.encode_links(0.0, Links.none(), 'map'))
    assert found.rssi.shape == (0,)


def test_links_read_the_same_in_rclpy():
    sent, _ = messages.decode_links(links_of([link(1, 2), link(2, 1, rssi=-61.0)]))
    found = deserialize_message(messages.encode_links(2.0, sent, 'map'), PointCloud2)
    assert [field.name for field in found.fields] == ['x', 'y', 'z', 'id', 'peer_id', 'rssi']
    rows = np.frombuffer(bytes(found.data), messages.LINK)
    assert rows['peer_id'].tolist() == [2, 1]
    assert rows['rssi'].tolist() == [-60, -61]
    assert found.is_dense is True


@pytest.mark.parametrize(('rows', 'complaint'), [
    ([link(1, 1)], 'peer_id 1 of id 1 is not allowed, must be another anchor'),
    ([link(1, 2), link(2, 1, rssi=math.nan)],
     'rssi nan of the link from id 2 to peer_id 1 is not allowed, must be finite'),
    ([link(1, 2), link(2, 1, rssi=math.inf)], 'rssi inf of the link from id 2'),
    ([link(1, 2), link(2, 7)], 'peer_id 7 of id 2 is unknown, must have a row of its own'),
    ([link(1, 2, y=2e5), link(2, 1)],
     'y 200000 of id 1 is not allowed, must be a number within 100 km of the origin'),
    ([link(1, 2), link(2, 1, z=math.nan)], 'z nan of id 2 is not allowed'),
    ([link(1, 2), link(2, 1), link(1, 3, x=4.0), link(3, 1)], 'id 1 stands at'),
    ([link(1, 2), link(2, 1), link(1, 2)],
     'the link from id 1 to peer_id 2 comes twice, must come once'),
    ([beacon(1)], 'fields peer_id, rssi are missing'),
])
def test_links_that_cannot_be_true_are_refused(rows, complaint):
    data = cloud(rows) if 'kind' in rows[0] or 'peer_id' not in rows[0] else links_of(rows)
    with pytest.raises(MessageError, match=complaint):
        messages.decode_links(data)


@given(st.binary(max_size=400), st.integers(0, 300))
def test_damaged_links_are_refused_or_read_but_nothing_else(noise, at):
    data = bytearray(links_of([link(1, 2), link(2, 1)]))
    data[at:at + len(noise)] = noise
    try:
        messages.decode_links(bytes(data))
    except MessageError:
        pass
