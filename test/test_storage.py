"""Bags on disks that fill up, by a limit that the kernel sets, against rosbags and mcap."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import resource

from mcap.reader import make_reader, NonSeekingReader
import pytest
from rosbags import rosbag2
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader, STORAGES, Writer
from tsmcl_ros.types import BagError

IMAGE = 'sensor_msgs/msg/Image'


@pytest.fixture
def limit() -> Iterator[Callable[[int], None]]:
    """Return a function that sets how many bytes a file may have."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def failure(*words: str) -> Iterator[None]:
    with pytest.raises(BagError) as caught:
        yield
    assert '\n' not in str(caught.value)
    assert all(word in str(caught.value) for word in words), caught.value


def write_until_full(bag: Writer, size: int = 1000, saved_every: int = 0) -> None:
    bag.topic('/image', IMAGE)
    bag.topic('/clock', messages.CLOCK)
    for count in range(10**5):
        bag.write('/image', float(count), count.to_bytes(4, 'little') * (size // 4))
        bag.write('/clock', float(count), messages.encode_clock(float(count)))
        if saved_every and count % saved_every == 0:
            bag.save()


def stamps_of(path: object) -> list[float]:
    with rosbag2.Reader(path) as bag:
        return [stamp / 1e9 for connection, stamp, _ in bag.messages()
                if connection.topic == '/image']


@pytest.mark.parametrize('storage', STORAGES)
def test_a_bag_on_a_full_disk_is_complete_up_to_what_was_saved_last(tmp_path, storage, limit):
    bag = Writer(tmp_path / 'bag', storage)
    limit(3 * 2**20)
    with failure('bag: cannot be written: ', '; complete are the '):
        write_until_full(bag, saved_every=100)
    limit(resource.RLIM_INFINITY)
    found = stamps_of(tmp_path / 'bag')
    assert found == list(range(len(found)))
    # A kilobyte each, and a clock, and what a storage tells of both.
    assert len(found) > 2000
    with Reader(tmp_path / 'bag') as reader:
        assert reader.counts == {'/image': len(found), '/clock': pytest.approx(len(found), abs=1)}
        assert len(list(reader.messages())) == sum(reader.counts.values())
        assert reader.duration == len(found) - 1


@pytest.mark.parametrize('storage', STORAGES)
def test_one_that_nobody_saves_by_the_clock_keeps_all_but_the_last_megabytes(
        tmp_path, storage, limit):
    bag = Writer(tmp_path / 'bag', storage)
    limit(12 * 2**20)
    with failure('complete are the '):
        write_until_full(bag, size=10_000)
    assert len(stamps_of(tmp_path / 'bag')) > 500


def test_mcaps_own_reader_counts_what_the_error_says(tmp_path, limit):
    bag = Writer(tmp_path / 'bag')
    limit(3 * 2**20)
    with pytest.raises(BagError) as caught:
        write_until_full(bag)
    [file] = (tmp_path / 'bag').glob('*.mcap')
    with file.open('rb') as stream:
        count = sum(1 for _ in NonSeekingReader(stream).iter_messages())
    assert f'complete are the {count} messages before' in str(caught.value)


def test_where_an_index_has_no_room_the_file_has_an_end_at_least(tmp_path, limit):
    bag = Writer(tmp_path / 'bag')
    bag.topic('/clock', messages.CLOCK)
    for stamp in range(1, 11):
        bag.write('/clock', float(stamp), messages.encode_clock(float(stamp)))
        bag.save()
    [file] = (tmp_path / 'bag').glob('*.mcap')
    limit(file.stat().st_size)
    with failure('complete are the 9 messages before'):
        bag.close()
    assert len(list(Reader(tmp_path / 'bag').messages())) == 9
    with file.open('rb') as stream:
        reader = make_reader(stream)
        assert reader.get_summary() is None
        assert len(list(reader.iter_messages())) == 9


@pytest.mark.parametrize('storage', STORAGES)
def test_a_bag_that_failed_takes_nothing_more_and_closes(tmp_path, storage, limit):
    bag = Writer(tmp_path / 'bag', storage)
    limit(3 * 2**20)
    with failure('cannot be written'):
        write_until_full(bag)
    assert not bag.is_open
    bag.save()
    bag.close()
    with failure('is closed'):
        bag.write('/clock', 1.0, messages.encode_clock(1.0))


def test_a_disk_with_no_room_at_all_is_an_error_before_anything_is_recorded(tmp_path, limit):
    limit(100)
    with failure('bag: cannot be written: [Errno 27] File too large'):
        Writer(tmp_path / 'bag')


@pytest.mark.parametrize('storage', STORAGES)
def test_nothing_but_the_bag_is_left(tmp_path, storage):
    with Writer(tmp_path / 'bag', storage) as bag:
        bag.topic('/clock', messages.CLOCK)
        bag.write('/clock', 1.0, messages.encode_clock(1.0))
        bag.save()
    assert len(list((tmp_path / 'bag').iterdir())) == 2
