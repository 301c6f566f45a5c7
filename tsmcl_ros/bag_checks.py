"""
What bags of others must not do: grow without bound in unpacking, compute, or lead astray.

rosbags trusts what it reads. An SQLite database may hold views, which are programs that run when
they are read; YAML and compressed parts may be tiny and stand for gigabytes; and names of topics
end in tables, logs and names of files.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
import re
import sqlite3
from typing import Any

from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag2 import storage_mcap
from tsmcl_ros.types import BagError
import yaml

LARGEST = 2**26  # bytes that a message or a chunk of messages may have
_RATIO = 200  # of sizes, that a file which is compressed as a whole may have above LARGEST

_TOPIC = re.compile(r'[\w~/-]{1,255}', re.ASCII)
# rosbag2 writes none. Where text looks so, it may be quoted still.
_LIKE_ALIAS = re.compile(r'(?:^|[\s,:\[{-])[&*]\w', re.MULTILINE)
# rosbag2 makes plain tables and indices; an expression in any of them follows one of these.
_COMPUTED = re.compile(r'\b(as|virtual|view|trigger)\b', re.IGNORECASE)

_zstd: Any = vars(storage_mcap)['zstd']  # of Python or of a backport, whichever rosbags uses


def check_topic(path: Path, topic: object) -> None:
    """Raise BagError if a topic has a name that ROS allows none to have."""
    if not isinstance(topic, str) or not _TOPIC.fullmatch(topic):
        raise BagError(
            f'{path}: topic {topic!r} is not allowed, must be named by at most 255 letters, '
            'digits and any of _ ~ / -')


def check_metadata(path: Path, text: str) -> None:
    """Raise BagError if a bag's metadata repeat parts of themselves, by which they may explode."""
    if not _LIKE_ALIAS.search(text):
        return
    for event in yaml.parse(text, getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):
        if isinstance(event, yaml.AliasEvent):
            raise BagError(
                f'{path}:{event.start_mark.line + 1}: the alias *{event.anchor} is not allowed, '
                "a bag's metadata have none")


def check_database(path: Path) -> None:
    """
    Raise BagError if an SQLite file lacks its end, or holds more than plain tables.

    SQLite takes a page's missing bytes for zeros.
    """
    with path.open('rb') as file:
        header = file.read(100)
    page_size, pages = int.from_bytes(header[16:18], 'big'), int.from_bytes(header[28:32], 'big')
    size = (page_size if page_size > 1 else 2**16) * pages
    # The number of pages counts where the header's two change counters agree.
    if header[24:28] == header[92:96] and path.stat().st_size < size:
        raise BagError(
            f'{path}: cannot be read, it is truncated or damaged: has {path.stat().st_size} '
            f'bytes, must have {size}')
    place = f'{path.resolve().as_uri()}?mode=ro&immutable=1'
    with closing(sqlite3.connect(place, uri=True)) as database:
        for name, sql in database.execute('SELECT name, sql FROM sqlite_master'):
            if _COMPUTED.search(sql or ''):
                raise BagError(
                    f'{path}: {name!r} is not allowed, a bag has plain tables alone: {sql!r}')


def check_packed(path: Path) -> None:
    """Raise BagError if a file that is compressed as a whole grows beyond measure."""
    most = max(LARGEST, _RATIO * path.stat().st_size)
    size = 0
    with _zstd.open(path, 'rb') as file:
        while part := file.read(2**20):
            size += len(part)
            if size > most:
                raise BagError(
                    f'{path}: unpacks to more than {most} bytes, which is not allowed')


def unpack_message(data: bytes) -> bytes:
    """Return a message that is compressed on its own; raise ValueError if it is too large."""
    return _unpacked(_zstd.ZstdDecompressor, data, LARGEST)


def _unpacked(decompressor: Callable[[], Any], data: bytes, most: int) -> bytes:
    """Return what one or several frames hold; raise ValueError if that is too large."""
    whole = b''
    while data:
        frame = decompressor()
        whole += frame.decompress(data, most + 1 - len(whole))
        if len(whole) > most:
            raise ValueError(f'a compressed part has more than the {most} bytes that it may have')
        if not frame.eof:
            raise ValueError('a compressed part has no end')
        data = frame.unused_data or b''
    return whole


def _unpacker(decompressor: Callable[[], Any]) -> Callable[[bytes, int], bytes]:
    """Return what unpacks a chunk of an mcap, of the size that the chunk itself claims."""
    return lambda data, size: _unpacked(decompressor, data, min(size, LARGEST))


# rosbags unpacks a chunk to whatever size it has before it looks at the size that it should have.
storage_mcap.DECOMPRESSORS.update(
    zstd=_unpacker(_zstd.ZstdDecompressor), lz4=_unpacker(LZ4FrameDecompressor))
