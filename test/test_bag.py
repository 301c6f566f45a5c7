"""Bags against rosbags and mcap, and against damage."""

from contextlib import contextmanager
import shutil
import signal
import threading

from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import storage_mcap
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader, STORAGES, Writer
from tsmcl_ros.types import BagError, Odometry

TODAY = 1_800_000_000.0


def write(path, storage='mcap', count=5, start=10.0):
    """Make a bag of a latched pose, and of a clock and odometry each second."""
    with Writer(path, storage) as bag:
        bag.topic('/pose', messages.POSE, latched=True)
        bag.topic('/clock', messages.CLOCK)
        bag.topic('/odom', messages.ODOMETRY)
        bag.write('/pose', start, messages.encode_pose(start, 'map', np.ones(2), np.eye(2), 0, 1))
        for stamp in start + np.arange(count):
            odometry = Odometry(stamp, np.zeros(3), 0.0)
            bag.write('/clock', stamp, messages.encode_clock(stamp))
            bag.write('/odom', stamp, messages.encode_odometry(odometry, 'odom', 'base_link'))
    return path


@pytest.fixture(params=STORAGES)
def bag(request, tmp_path):
    return write(tmp_path / 'bag', request.param)


def storage_of(bag):
    return next(path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))


def test_what_is_written_is_read_back_in_order_of_time(bag):
    with Reader(bag) as reader:
        assert reader.topics == {
            '/pose': messages.POSE, '/clock': messages.CLOCK, '/odom': messages.ODOMETRY}
        assert reader.counts == {'/pose': 1, '/clock': 5, '/odom': 5}
        assert (reader.start, reader.duration) == (10.0, 4.0)
        found = list(reader.messages())
    assert [one.topic for one in found] == ['/pose', *['/clock', '/odom'] * 5]
    assert [one.stamp for one in found] == [10, *np.repeat(np.arange(10, 15), 2)]
    assert all(one.type == reader.topics[one.topic] for one in found)
    assert [messages.decode_clock(one.data) for one in found if one.topic == '/clock'] == [
        10, 11, 12, 13, 14]


def test_messages_written_out_of_order_are_read_in_order(tmp_path):
    for storage in STORAGES:
        with Writer(tmp_path / storage, storage) as bag:
            bag.topic('/clock', messages.CLOCK)
            for stamp in (3.0, 1.0, 2.0):
                bag.write('/clock', stamp, messages.encode_clock(stamp))
        with Reader(tmp_path / storage) as reader:
            assert [one.stamp for one in reader.messages()] == [1, 2, 3]


def test_topics_can_be_chosen(bag):
    with Reader(bag) as reader:
        assert {one.topic for one in reader.messages(['/odom', '/pose'])} == {'/odom', '/pose'}
        assert list(reader.messages([])) == []


def test_a_topic_that_is_not_there_is_an_error_that_lists_those_that_are(bag):
    with Reader(bag) as reader, pytest.raises(
            BagError, match='has no topic /ponse, has /clock, /odom, /pose'):
        list(reader.messages(['/ponse', '/odom']))


def test_a_bag_can_be_read_twice_and_closed_twice(bag):
    reader = Reader(bag)
    assert len(list(reader.messages())) == len(list(reader.messages())) == 11
    reader.close()
    reader.close()


def test_reading_streams(tmp_path):
    path = write(tmp_path / 'bag', count=3000)
    with Reader(path) as reader:
        first = next(iter(reader.messages(['/odom'])))
        assert first.stamp == 10.0


def test_latched_topics_are_known_to_be(bag):
    with Reader(bag) as reader:
        assert reader.latched == {'/pose'}


@pytest.mark.parametrize('storage', STORAGES)
def test_what_a_bag_says_of_how_it_was_made_is_read_back(tmp_path, storage):
    about = {'command': "make 'a bag'", 'localizer': '/**:\n  ros__parameters:\n    x: "1: 2"\n'}
    with Writer(tmp_path / 'bag', storage, about) as bag:
        bag.topic('/clock', messages.CLOCK)
        bag.write('/clock', 1.0, messages.encode_clock(1.0))
    with Reader(tmp_path / 'bag') as reader:
        assert reader.about == about


def test_a_bag_need_not_say_how_it_was_made(bag):
    with Reader(bag) as reader:
        assert reader.about == {}


def test_what_others_say_of_how_they_made_a_bag_is_taken_as_text(bag):
    metadata = bag / 'metadata.yaml'
    text = metadata.read_text()
    assert 'custom_data: null' in text
    for custom, about in (('{a: 1}', {'a': '1'}), ('[1, 2]', {}), ('words', {})):
        metadata.write_text(text.replace('custom_data: null', f'custom_data: {custom}'))
        with Reader(bag) as reader:
            assert reader.about == about


@pytest.mark.parametrize('storage', STORAGES)
def test_stamps_of_today_survive_as_the_doubles_that_they_are(tmp_path, storage):
    stamps = np.sort(TODAY + np.random.default_rng(0).uniform(0, 100, 200)).tolist()
    with Writer(tmp_path / 'bag', storage) as bag:
        bag.topic('/clock', messages.CLOCK)
        for stamp in stamps:
            bag.write('/clock', stamp, messages.encode_clock(stamp))
    with Reader(tmp_path / 'bag') as reader:
        found = list(reader.messages())
    assert [one.stamp for one in found] == stamps
    assert [messages.decode_clock(one.data) for one in found] == stamps


def test_large_messages_reach_the_disk_at_once(tmp_path):
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/image', 'sensor_msgs/msg/Image')
        bag.write('/image', 1.0, bytes(2**21))
        assert storage_of(tmp_path / 'bag').stat().st_size > 2**21


def test_rosbags_reads_the_bag_by_its_own_definitions(bag):
    with AnyReader([bag]) as reader:
        found = [reader.deserialize(data, connection.msgtype)
                 for connection, _, data in reader.messages() if connection.topic == '/odom']
    assert [message.header.stamp.sec for message in found] == [10, 11, 12, 13, 14]
    assert {message.child_frame_id for message in found} == {'base_link'}


def test_rosbags_finds_the_latched_topic_transient_local(bag):
    with AnyReader([bag]) as reader:
        offered = {one.topic: one.ext.offered_qos_profiles[0] for one in reader.connections}
    assert {topic: qos.durability.name for topic, qos in offered.items()} == {
        '/pose': 'TRANSIENT_LOCAL', '/clock': 'VOLATILE', '/odom': 'VOLATILE'}
    assert offered['/pose'].depth == 1


def test_mcap_reads_the_bag(tmp_path):
    path = storage_of(write(tmp_path / 'bag'))
    with path.open('rb') as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 11
        assert {channel.topic: summary.schemas[channel.schema_id].name
                for channel in summary.channels.values()} == {
            '/pose': messages.POSE, '/clock': messages.CLOCK, '/odom': messages.ODOMETRY}
        assert all(schema.encoding == 'ros2msg' and schema.data
                   for schema in summary.schemas.values())
        assert len(list(reader.iter_messages())) == 11


def test_parent_folders_are_made(tmp_path):
    assert write(tmp_path / 'a' / 'b' / 'bag').is_dir()


def test_a_bag_is_never_overwritten(bag, tmp_path):
    before = storage_of(bag).read_bytes()
    with pytest.raises(BagError, match='bag: exists already, bags are never overwritten'):
        Writer(bag)
    assert storage_of(bag).read_bytes() == before
    (tmp_path / 'empty').mkdir()
    with pytest.raises(BagError, match='exists already'):
        Writer(tmp_path / 'empty')


def test_a_bag_below_a_file_cannot_be_written(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(BagError, match='cannot be written'):
        Writer(tmp_path / 'file' / 'bag')


def test_an_unknown_storage_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(BagError, match="storage 'db3' is not allowed, must be one of mcap, sql"):
        Writer(tmp_path / 'bag', 'db3')
    assert not (tmp_path / 'bag').exists()


@pytest.mark.parametrize('error', [ValueError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize('storage', STORAGES)
def test_what_was_written_before_an_exception_is_a_complete_bag(tmp_path, storage, error):
    with pytest.raises(error), Writer(tmp_path / 'bag', storage) as bag:
        bag.topic('/clock', messages.CLOCK)
        bag.write('/clock', 1.0, messages.encode_clock(1.0))
        raise error
    with Reader(tmp_path / 'bag') as reader:
        assert [one.stamp for one in reader.messages()] == [1.0]
    if storage == 'mcap':
        with storage_of(tmp_path / 'bag').open('rb') as file:
            assert make_reader(file).get_summary().statistics.message_count == 1


@pytest.fixture
def interrupted_record(monkeypatch):
    """Return a context in which Ctrl+C is pressed whenever a part of a record was written."""
    whole = storage_mcap.write_uint64

    def interrupted(*arguments):
        whole(*arguments)
        signal.raise_signal(signal.SIGINT)

    @contextmanager
    def within():
        with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(storage_mcap, 'write_uint64', interrupted)
            yield

    return within


def test_a_signal_in_the_midst_of_a_record_comes_after_it(tmp_path, interrupted_record):
    stamps = [float(stamp) for stamp in range(1000)]
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/clock', messages.CLOCK)
        while stamps:
            with interrupted_record():
                while stamps:
                    stamp = stamps.pop(0)
                    bag.write('/clock', stamp, messages.encode_clock(stamp))
                bag.close()
    with Reader(tmp_path / 'bag') as reader:
        found = [messages.decode_clock(one.data) for one in reader.messages()]
    assert found == list(range(1000))


@pytest.mark.parametrize('storage', STORAGES)
def test_a_signal_while_a_bag_is_made_leaves_it_complete(tmp_path, monkeypatch, storage):
    whole = rosbag2.Writer.open

    def interrupted(bag):
        whole(bag)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(rosbag2.Writer, 'open', interrupted)
    with pytest.raises(KeyboardInterrupt):
        Writer(tmp_path / 'bag', storage)
    assert (tmp_path / 'bag' / 'metadata.yaml').exists()
    with pytest.raises(BagError, match='holds no messages'):
        Reader(tmp_path / 'bag')


def test_bags_are_written_in_any_thread(tmp_path):
    thread = threading.Thread(target=write, args=(tmp_path / 'bag',))
    thread.start()
    thread.join()
    with Reader(tmp_path / 'bag') as reader:
        assert len(list(reader.messages())) == 11


def test_closing_twice_does_nothing(tmp_path):
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/clock', messages.CLOCK)
        bag.write('/clock', 1.0, messages.encode_clock(1.0))
        bag.close()
    bag.close()
    with pytest.raises(BagError, match='is closed'):
        bag.write('/clock', 2.0, messages.encode_clock(2.0))


def test_a_topic_has_one_type(tmp_path):
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/clock', messages.CLOCK)
        bag.topic('/clock', messages.CLOCK)
        with pytest.raises(BagError, match='/clock has type rosgraph_msgs/msg/Clock and cannot '
                                           'have geometry_msgs/msg/PoseWithCovarianceStamped'):
            bag.topic('/clock', messages.POSE)


def test_a_type_that_ros_does_not_have_is_refused(tmp_path):
    with Writer(tmp_path / 'bag') as bag, pytest.raises(
            BagError, match='topic /x: type my_msgs/msg/X is unknown to ROS 2 Jazzy'):
        bag.topic('/x', 'my_msgs/msg/X')


def test_only_registered_topics_are_written_and_only_at_times_that_are_any(tmp_path):
    with Writer(tmp_path / 'bag') as bag:
        with pytest.raises(BagError, match='topic /clock is not registered'):
            bag.write('/clock', 1.0, b'')
        bag.topic('/clock', messages.CLOCK)
        for stamp in (-1.0, float('nan'), float('inf')):
            with pytest.raises(BagError, match='log time .* is not allowed, must be at least 0'):
                bag.write('/clock', stamp, b'')


def refusal(path):
    with pytest.raises(BagError) as caught, Reader(path) as reader:
        for _ in reader.messages():
            pass
    assert '\n' not in str(caught.value)
    return str(caught.value)


def test_a_missing_bag_is_an_error(tmp_path):
    assert refusal(tmp_path / 'none').endswith('none: there is no such bag')


def test_a_file_is_no_bag(bag):
    path = storage_of(bag)
    assert refusal(path) == f'{path}: is a file; a bag is named by its folder, {bag}'


def test_an_empty_folder_is_no_bag(tmp_path):
    assert 'is an empty folder' in refusal(tmp_path)


def test_a_folder_of_other_things_is_no_bag(tmp_path):
    (tmp_path / 'notes.txt').write_text('hello')
    assert 'is not a bag, or its recording was cut short' in refusal(tmp_path)


@pytest.mark.parametrize('storage', STORAGES)
def test_a_bag_without_messages_is_an_error(tmp_path, storage):
    with Writer(tmp_path / 'bag', storage) as bag:
        bag.topic('/clock', messages.CLOCK)
    assert refusal(tmp_path / 'bag').endswith('bag: holds no messages')


def test_a_storage_of_another_kind_is_refused_with_the_known_ones(bag):
    metadata = bag / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(
        'storage_identifier: ', 'storage_identifier: rosbag_v3_'))
    assert "storage 'rosbag_v3_" in refusal(bag)
    assert refusal(bag).endswith('is not supported, must be one of mcap, sqlite3')


@pytest.mark.parametrize('text', ['', 'hello', 'a: [', 'rosbag2_bagfile_information: {}',
                                  'rosbag2_bagfile_information:\n  version: 99\n'])
def test_metadata_that_is_none_is_refused(bag, text):
    (bag / 'metadata.yaml').write_text(text)
    assert 'cannot be read' in refusal(bag)


def test_metadata_that_is_not_text_is_refused(bag):
    (bag / 'metadata.yaml').write_bytes(b'\xff\xfe\0')
    assert 'cannot be read' in refusal(bag)


def test_a_bag_whose_file_is_gone_is_refused(bag):
    storage_of(bag).unlink()
    assert 'cannot be read' in refusal(bag)


@pytest.mark.parametrize('storage', STORAGES)
def test_a_truncated_bag_is_refused_wherever_it_was_cut(tmp_path, storage):
    bag = write(tmp_path / 'bag', storage, count=200)
    path = storage_of(bag)
    whole = path.read_bytes()
    for size in [0, 1, 7, 8, 30, 100, *range(1000, len(whole), len(whole) // 10),
                 len(whole) - 100, len(whole) - 1]:
        path.write_bytes(whole[:size])
        assert 'cannot be read, it is truncated or damaged: ' in refusal(bag)


@pytest.mark.parametrize('storage', STORAGES)
def test_damage_anywhere_raises_a_bag_error_at_most(tmp_path, storage):
    bag = write(tmp_path / 'bag', storage, count=50)
    path = storage_of(bag)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(25):
        damaged = bytearray(whole)
        start = rng.integers(len(whole))
        damaged[start:start + 16] = rng.bytes(len(damaged[start:start + 16]))
        path.write_bytes(damaged)
        try:
            with Reader(bag) as reader:
                for _ in reader.messages():
                    pass
        except BagError as error:
            assert '\n' not in str(error)


def test_a_recording_of_somebody_else_is_read_raw(shared_data):
    with Reader(shared_data / 'tiers_bag') as reader:
        assert len(reader.topics) == 50
        assert sum(reader.counts.values()) == 13112
        assert reader.duration == pytest.approx(17.195917331)
        assert set(reader.undecodable.values()) == {'depthai_ros_msgs/msg/SpatialDetectionArray'}
        assert len(reader.undecodable) == 4
        ranges = [name for name, kind in reader.topics.items() if kind == messages.RANGE]
        found = [messages.decode_range(one.data) for one in reader.messages(ranges)]
        assert len(found) == 4020
        assert 1.5 < min(one.range for one in found) < max(one.range for one in found) < 10
        odometry = [one.data for one in reader.messages(['/cali/turtle01/odom'])]
        assert messages.decode_odometries(odometry).stamp.size == 338


def test_a_bag_can_be_copied_elsewhere(bag, tmp_path):
    shutil.copytree(bag, tmp_path / 'copy')
    with Reader(tmp_path / 'copy') as reader:
        assert len(list(reader.messages())) == 11
