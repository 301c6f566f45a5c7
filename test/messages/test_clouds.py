"""Clouds of beacons and links against rclpy's serialization and rosbags' own."""

from dataclasses import replace
import math
import time

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import PointCloud2, PointField
from tsmcl_ros import cdr, messages
from tsmcl_ros.messages import beacons
from tsmcl_ros.types import Links, MessageError, Observation, UNTRUE

pytestmark = pytest.mark.filterwarnings('error', 'ignore::DeprecationWarning:lark')

JAZZY = get_typestore(Stores.ROS2_JAZZY)
FOXY = get_typestore(Stores.ROS2_FOXY)
DATATYPES = {'u1': PointField.UINT8, 'i4': PointField.INT32, 'u4': PointField.UINT32,
             'f4': PointField.FLOAT32, 'f8': PointField.FLOAT64}
OBSERVED = ('sender', 'kind', 'hops', 'position', 'covariance', 'max_range', 'range', 'range_std',
            'rssi')

STAMPS = st.integers(0, 2**31 - 1).flatmap(
    lambda s: st.integers(0, 10**9 - 1).map(lambda ns: (s * 10**9 + ns) / 10**9))


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
    beacons._read_layout(reader)
    before = len(beacons._known_layouts)
    for filler in (1, 77, 255):
        for position in reader.padding:
            data[position] = filler
        found, _ = messages.decode_beacons(bytes(data))
        assert_equal(found, observation())
    assert len(beacons._known_layouts) <= before + 1


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
    assert len(beacons._known_layouts) <= 16


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
}


@pytest.mark.parametrize('what', BAD_CLOUDS)
def test_a_scan_is_refused_for(what):
    make, error = BAD_CLOUDS[what]
    with pytest.raises(MessageError, match=error):
        messages.decode_beacons(make())


def test_a_nan_that_signals_is_a_nan_as_others():
    rows = cloud([{**beacon(5), 'x': math.pi}], [('x', 'f8', 16), *FIELDS[1:]])
    signals = np.uint64(0x7ff0000000000001).tobytes()
    with pytest.raises(MessageError, match='x nan of id 5 is not allowed, must be a number'):
        messages.decode_beacons(rows.replace(np.float64(math.pi).tobytes(), signals))


SOUND = beacon(1, kind=0, hops=1, range=3.0, rssi=-60.0, cov_xx=0.0, cov_xy=0.0, cov_yy=0.0)
UNTRUE_ROWS = [{'x': math.nan}, {'y': 2e5}, {'range': -1.0}, {'rssi': math.inf}, {'kind': 2},
               {'hops': 0}, {'cov_yy': -1.0}, {'cov_xy': math.inf}, {'cov_xy': 1.0},
               {'cov_xx': 1.0, 'cov_xy': 2.0, 'cov_yy': 1.0}]


@pytest.mark.parametrize('values', UNTRUE_ROWS, ids=str)
def test_of_a_row_that_cannot_be_true_only_its_sender_is_left(values):
    rows = [SOUND, {**SOUND, 'id': 5, **values}, {**SOUND, 'id': 7}]
    scan = messages.decode_scan(cloud(rows))
    assert scan.untrue.tolist() == [5]
    assert scan.fault
    assert scan.observation.sender.tolist() == [[1, 5, 7]]
    assert scan.observation.kind.tolist() == [[0, UNTRUE, 0]]
    assert np.isnan(scan.observation.range[0, 1])
    for array in (scan.observation.position, scan.observation.covariance):
        assert not array[0, 1].any()
    for sound, row in ((0, SOUND), (2, SOUND)):
        assert scan.observation.range[0, sound] == row['range']
        assert scan.observation.position[0, sound].tolist() == [1.0, 2.0, 3.0]


def test_all_rows_that_cannot_be_true_are_found():
    rows = [SOUND, *({**SOUND, 'id': 10 + i, **each} for i, each in enumerate(UNTRUE_ROWS))]
    assert messages.decode_scan(cloud(rows)).untrue.tolist() == [
        10 + i for i in range(len(UNTRUE_ROWS))]


def test_who_uses_anothers_id_does_not_silence_it_by_what_cannot_be_true():
    scan = messages.decode_scan(cloud([{**SOUND, 'range': -1.0}, SOUND]))
    assert scan.observation.sender.tolist() == [[1]]
    assert scan.observation.range.tolist() == [[3.0]]
    assert scan.untrue.tolist() == [1]


def test_a_scan_in_which_nothing_can_be_true_is_refused():
    with pytest.raises(MessageError, match='range -1 of id 1 is not allowed'):
        messages.decode_scan(cloud([{**SOUND, 'range': -1.0}]))


def test_a_scan_of_many_rows_that_cannot_be_true_takes_no_long():
    rows = np.zeros(2**16, [('x', 'f4'), ('y', 'f4'), ('z', 'f4'), ('id', 'u4'), ('rssi', 'f4')])
    rows['id'] = np.arange(len(rows))
    rows['rssi'][1:] = math.inf
    layout = [(name, {'id': 'u4'}.get(name, 'f4'), 4 * i)
              for i, name in enumerate(rows.dtype.names)]
    data = cloud([{}], layout, data=rows.tobytes(), width=len(rows), row_step=rows.nbytes)
    begin = time.process_time()
    assert len(messages.decode_scan(data).untrue) == len(rows) - 1
    assert time.process_time() - begin < 1


def test_a_bad_layout_is_refused_every_time():
    data = cloud([beacon()], is_bigendian=True)
    for _ in range(3):
        with pytest.raises(MessageError, match='is_bigendian'):
            messages.decode_beacons(data)


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


def test_more_rows_than_any_radio_hears_are_refused():
    scan = Observation.empty(1, 2**16 + 1, 3, 1.0)
    scan.sender[0] = np.arange(2**16 + 1)
    data, = messages.encode_beacons(scan, 'map')
    with pytest.raises(MessageError, match='has 65537 rows, must have at most 65536'):
        messages.decode_beacons(data)


def test_more_fields_than_any_row_has_are_refused():
    fields = [PointField(name='', offset=0, datatype=7, count=1)] * 257
    with pytest.raises(MessageError, match='has 257 fields, must have at most 256'):
        messages.decode_beacons(cloud([beacon()], fields=fields))


@pytest.mark.parametrize(('name', 'value', 'most'), [
    ('range', 3e38, '1e[+]06'), ('max_range', 1.1e6, '1e[+]06'), ('cov_xx', 1e13, '1e[+]12')])
def test_what_no_radio_measures_is_refused(name, value, most):
    error = f'{name} .* of id 1 is not allowed, must be at most {most}'
    with pytest.raises(MessageError, match=error):
        messages.decode_beacons(cloud([beacon(**{name: value})]))
