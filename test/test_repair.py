"""Bags that are cut short in all ways, against what was saved, rosbags and mcap."""

import os
import shutil
import struct

from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags import rosbag2
from tsmcl_ros import messages
from tsmcl_ros import repair as repairing
from tsmcl_ros.bag import Reader, STORAGES, Writer
from tsmcl_ros.repair import repair
from tsmcl_ros.types import BagError

IMAGE = 'sensor_msgs/msg/Image'


def cut(tmp_path, storage='mcap', saved=300, unsaved=50, size=100, every=20):
    """Make what a recorder leaves that is killed, with some messages saved and some not."""
    bag = Writer(tmp_path / 'open', storage)
    bag.topic('/map', messages.POINT_CLOUD, latched=True)
    bag.topic('/image', IMAGE)
    bag.write('/map', 0.0, b'map')
    for count in range(saved + unsaved):
        bag.write('/image', float(count), count.to_bytes(4, 'little') * (size // 4))
        if count < saved and count % every == every - 1:
            bag.save()
    # Others see of its files what would be left of them.
    shutil.copytree(tmp_path / 'open', tmp_path / 'bag')
    bag.close()
    return tmp_path / 'bag'


def file_of(bag):
    return next(item for item in bag.iterdir() if item.suffix in ('.mcap', '.db3'))


def numbers(bag):
    with rosbag2.Reader(bag) as reader:
        return [int.from_bytes(data[:4], 'little') for connection, _, data in reader.messages()
                if connection.topic == '/image']


@pytest.mark.parametrize('storage', STORAGES)
def test_all_that_was_saved_is_read_after_a_repair(tmp_path, storage):
    bag = cut(tmp_path, storage)
    # rosbags 0.11.0 does not write a file's QoS.
    latched = {'/map'} if b'transient_local' in file_of(bag).read_bytes() else set()
    assert repair(bag) == (True, 301, 2)
    assert numbers(bag) == list(range(300))
    with Reader(bag) as reader:
        assert reader.latched == latched
        assert reader.topics == {'/map': messages.POINT_CLOUD, '/image': IMAGE}
        assert reader.about == {'command': f'recorder --repair {bag}'}
    assert {item.name for item in bag.iterdir()} == {file_of(bag).name, 'metadata.yaml'}


def test_mcaps_own_reader_finds_an_index_in_a_repaired_file(tmp_path):
    bag = cut(tmp_path)
    repair(bag)
    with file_of(bag).open('rb') as stream:
        reader = make_reader(stream)
        assert reader.get_summary().statistics.message_count == 301
        assert [struct.unpack('<I', message.data[:4])[0]
                for _, _, message in reader.iter_messages('/image')] == list(range(300))


def test_a_database_cut_amid_a_transaction_is_rolled_back_by_its_journal(tmp_path):
    bag = cut(tmp_path, 'sqlite3', saved=20, unsaved=35, size=100_000)
    assert list(bag.glob('*-journal'))
    assert repair(bag) == (True, 21, 2)
    assert numbers(bag) == list(range(20))
    assert not list(bag.glob('*-journal'))


def test_a_file_cut_at_any_byte_keeps_the_records_before(tmp_path):
    whole = file_of(cut(tmp_path, saved=40, every=1)).read_bytes()
    # A chunk of two messages comes first.
    ends = [at for at in range(len(whole)) if whole[at:at + 9] in (
        struct.pack('<BQ', 0x07, 22), struct.pack('<BQ', 0x07, 38))]
    for number, size in enumerate(np.linspace(ends[1], len(whole), 11).astype(int)):
        bag = tmp_path / str(number)
        bag.mkdir()
        (bag / 'x.mcap').write_bytes(whole[:size])
        repair(bag)
        found = numbers(bag)
        assert found == list(range(len(found)))
        assert len(found) >= sum(end < size for end in ends) - 2


def test_zeros_that_a_power_cut_leaves_at_the_end_are_passed_over(tmp_path):
    bag = cut(tmp_path)
    with file_of(bag).open('ab') as file:
        file.write(bytes(5000))
    assert repair(bag) == (True, 301, 2)


def test_a_whole_file_whose_description_is_missing_gets_one(tmp_path):
    for storage in STORAGES:
        with Writer(tmp_path / storage, storage) as bag:
            bag.topic('/image', IMAGE)
            bag.write('/image', 1.0, b'abcd')
        (tmp_path / storage / 'metadata.yaml').unlink()
        assert repair(tmp_path / storage) == (True, 1, 1)
        assert len(numbers(tmp_path / storage)) == 1


@pytest.mark.parametrize('storage', STORAGES)
def test_a_complete_bag_is_left_as_it_is(tmp_path, storage):
    bag = cut(tmp_path, storage)
    repair(bag)
    before = {item: item.read_bytes() for item in bag.iterdir()}
    assert repair(bag) == (False, 301, 2)
    assert {item: item.read_bytes() for item in bag.iterdir()} == before


@pytest.mark.parametrize('storage', STORAGES)
def test_a_repair_that_fails_halfway_leaves_what_was_there(tmp_path, storage, monkeypatch):
    def full(_):
        raise OSError('no space')

    bag = cut(tmp_path, storage)
    before = file_of(bag).read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(os, 'fsync', full)
        with pytest.raises(BagError, match='no space'):
            repair(bag)
    assert file_of(bag).read_bytes() == before
    assert not (bag / repairing._WORKSHOP).exists()
    assert repair(bag) == (True, 301, 2)


def test_what_a_killed_repair_leaves_is_cleared_by_the_next(tmp_path):
    bag = cut(tmp_path)
    shutil.copytree(tmp_path / 'open', bag / repairing._WORKSHOP / file_of(bag).stem)
    assert repair(bag) == (True, 301, 2)
    assert not (bag / repairing._WORKSHOP).exists()


def test_a_bag_that_is_being_recorded_is_not_touched(tmp_path):
    with Writer(tmp_path / 'bag') as bag:
        bag.topic('/image', IMAGE)
        bag.write('/image', 1.0, b'abcd')
        bag.save()
        with pytest.raises(BagError, match='bag: is being recorded still, and cannot be repaired'):
            repair(tmp_path / 'bag')
        with pytest.raises(BagError, match='bag: is being recorded still: it has no metadata'):
            Reader(tmp_path / 'bag')
    assert len(numbers(tmp_path / 'bag')) == 1


def test_reading_a_cut_bag_names_the_command_that_repairs_it(tmp_path):
    bag = cut(tmp_path)
    with pytest.raises(BagError) as caught:
        Reader(bag)
    assert str(caught.value) == (
        f'{bag}: its recording was cut short; to read what it holds: recorder --repair {bag}')


def test_damage_within_is_an_error_and_the_bag_is_left_as_it_was(tmp_path):
    bag = cut(tmp_path)
    data = bytearray(file_of(bag).read_bytes())
    start = data.index(struct.pack('<BQ', 0x07, 6 + 16 * 20))
    data[start] = 0x7f
    file_of(bag).write_bytes(data)
    with pytest.raises(BagError, match=f'is damaged at byte {start} of {len(data)}, and not only'):
        repair(bag)
    assert file_of(bag).read_bytes() == data


def test_what_is_no_bag_cannot_be_repaired(tmp_path):
    with pytest.raises(BagError, match='there is no such bag; a bag is named by its folder'):
        repair(tmp_path / 'none')
    with pytest.raises(BagError, match=r'has 0 files \.mcap or \.db3, must have 1'):
        repair(tmp_path)
    (tmp_path / 'x.mcap').write_bytes(b'')
    with pytest.raises(BagError, match=r'x\.mcap: holds no messages'):
        repair(tmp_path)
    (tmp_path / 'x.mcap').write_bytes(b'hello, this is text')
    with pytest.raises(BagError, match=r'x\.mcap: cannot be repaired: is no mcap file'):
        repair(tmp_path)
    assert (tmp_path / 'x.mcap').read_bytes() == b'hello, this is text'


def test_a_recording_of_others_with_types_that_ros_has_not_is_left_as_it_is(shared_data, tmp_path):
    bag = tmp_path / 'tiers_bag'
    shutil.copytree(shared_data / 'tiers_bag', bag)
    (bag / 'metadata.yaml').unlink()
    file = file_of(bag)
    before = file.read_bytes()
    with pytest.raises(BagError, match='topic .* type depthai_ros_msgs/msg/.* is unknown'):
        repair(bag)
    assert file.read_bytes() == before
