"""Bags made to harm whoever reads them: refused in a line, at once, and nothing else happens."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
import sqlite3
import sys
import tracemalloc

from lz4.frame import compress as lz4_compress
import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.typesys import get_typestore, Stores
from tsmcl_ros import bag_checks, messages
from tsmcl_ros.bag import Reader, Writer
from tsmcl_ros.types import BagError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

JAZZY = get_typestore(Stores.ROS2_JAZZY)
BOMB = 3 * bag_checks.LARGEST
ERRORS = {'FILE': r'db3.zstd: unpacks to more than \d+ bytes, which is not allowed',
          'MESSAGE': 'a compressed part has more than the 67108864 bytes that it may have'}


def write(path: Path, storage: str = 'mcap', topic: str = '/pose') -> Path:
    with Writer(path, storage, {'command': 'ros2 bag record & play *all'}) as bag:
        bag.topic(topic, messages.POSE)
        bag.write(topic, 1.0, messages.encode_pose(1.0, 'map', np.zeros(2), np.eye(2), 0.0, 1.0))
    return path


def read(path: Path) -> list[bytes]:
    with Reader(path) as bag:
        return [message.data for message in bag.messages()]


def change(path: Path, old: str, new: str) -> None:
    metadata = path / 'metadata.yaml'
    text = metadata.read_text()
    assert old in text
    metadata.write_text(text.replace(old, new))


@pytest.mark.parametrize('topic', [
    '', '/pose\n[ERROR] forged', '/\x1b[2J', '/../../etc', '/<b>', '/$x^{$', '/' + 'x' * 255])
def test_a_topic_that_ros_allows_no_name_of_is_refused(tmp_path, topic: str) -> None:
    path = write(tmp_path / 'bag', topic=topic)
    with pytest.raises(BagError, match='is not allowed, must be named by at most 255 letters'):
        Reader(path)


def test_metadata_that_repeat_themselves_are_refused(tmp_path) -> None:
    path = write(tmp_path / 'bag')
    bomb = '&a [x, x]\n' + '\n'.join(
        f'    {new}: &{new} [{", ".join([f"*{old}"] * 9)}]'
        for old, new in zip('abcdefghij', 'bcdefghijk', strict=True))
    change(path, '  custom_data:\n', f'  custom_data:\n    a: {bomb}\n')
    with pytest.raises(BagError, match=r'metadata.yaml:\d+: the alias \*a is not allowed'):
        Reader(path)


def test_a_file_is_looked_for_in_the_bag_alone(tmp_path) -> None:
    path = write(tmp_path / 'bag')
    (path / 'bag.mcap').rename(tmp_path / 'bag.mcap')
    for place in ('../bag.mcap', str(tmp_path / 'bag.mcap')):
        (path / 'metadata.yaml').write_text(
            (path / 'metadata.yaml').read_text().replace('- bag.mcap', f'- {place}'))
        with pytest.raises(BagError, match='Some database files are missing'):
            Reader(path)


def test_a_database_without_its_end_is_refused(tmp_path) -> None:
    path = write(tmp_path / 'bag', 'sqlite3') / 'bag.db3'
    whole = path.read_bytes()
    path.write_bytes(whole[:-7])
    with pytest.raises(BagError, match='cannot be read, it is truncated or damaged: has '
                                       f'{len(whole) - 7} bytes, must have {len(whole)}'):
        Reader(path.parent)


@pytest.mark.parametrize('sql', [
    'CREATE VIEW endless AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) '
    'SELECT x FROM c',
    'CREATE TRIGGER t AFTER INSERT ON topics BEGIN DELETE FROM topics; END',
    'CREATE TABLE t (x, y GENERATED ALWAYS AS (zeroblob(1000000000)))',
    'CREATE INDEX i ON topics (name) WHERE name = cast(id as text)',
])
def test_a_database_that_computes_is_refused(tmp_path, sql: str) -> None:
    path = write(tmp_path / 'bag', 'sqlite3')
    with closing(sqlite3.connect(path / 'bag.db3')) as database:
        database.execute(sql)
    with pytest.raises(BagError, match='is not allowed, a bag has plain tables alone: .CREATE'):
        Reader(path)


@pytest.mark.parametrize(('unpacker', 'packed'), [
    ('zstd', zstd.compress(bytes(BOMB))), ('lz4', lz4_compress(bytes(BOMB)))])
def test_a_chunk_unpacks_to_what_it_claims_at_most(unpacker: str, packed: bytes) -> None:
    unpack = bag_checks.storage_mcap.DECOMPRESSORS[unpacker]
    for claimed, most in ((1000, 1000), (BOMB, bag_checks.LARGEST)):
        tracemalloc.start()
        with pytest.raises(ValueError, match=f'has more than the {most} bytes that it may have'):
            unpack(packed, claimed)
        assert tracemalloc.get_traced_memory()[1] < 2.5 * most + 2**20
        tracemalloc.stop()


@pytest.mark.parametrize('compress', [zstd.compress, lz4_compress])
def test_a_chunk_of_several_frames_is_unpacked_and_one_without_an_end_is_not(compress) -> None:
    unpack = bag_checks.storage_mcap.DECOMPRESSORS['lz4' if compress is lz4_compress else 'zstd']
    packed = compress(b'one') + compress(b'two')
    assert unpack(packed, 6) == b'onetwo'
    with pytest.raises(ValueError, match='a compressed part has no end'):
        unpack(packed[:-5], 6)


@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE'])
@pytest.mark.parametrize('size', [1000, BOMB])
def test_what_is_compressed_is_read_and_what_explodes_is_refused(
        tmp_path, mode: str, size: int) -> None:
    path = tmp_path / 'bag'
    bag = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    bag.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with bag:
        connection = bag.add_connection('/x', 'std_msgs/msg/String', typestore=JAZZY)
        bag.write(connection, 1_000_000_000, bytes(size))
    if size == 1000:
        assert read(path) == [bytes(size)]
        return
    with pytest.raises(BagError, match=ERRORS[mode]):
        read(path)
