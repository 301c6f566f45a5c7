"""
Completion of bags whose recording was cut short: by a signal, by power, or by a full disk.

A cut mcap file lacks its last records, its index and its end; a cut database has a journal of
what was not done; both lack their metadata.yaml. What is whole in them is written anew beside
them, and takes their place once it is on disk.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
import io
import os
from pathlib import Path
import shlex
import shutil
import sqlite3
import struct
from types import SimpleNamespace
from typing import Any, cast

from rosbags.interfaces import Connection
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from tsmcl_ros import storage
from tsmcl_ros.bag import is_latched, readable, Reader, SECOND, Writer
from tsmcl_ros.types import BagError

_KINDS = {'.mcap': 'mcap', '.db3': 'sqlite3'}
_FOOTER, _LAST = 0x02, 0x0F  # kinds of mcap records
_WORKSHOP = '.repair'


def repair(path: str | Path) -> tuple[bool, int, int]:
    """
    Complete a bag in its place; a complete one is left as it is.

    Returns
    -------
    repaired, messages, topics : bool, int, int
        Whether there was anything to do, and how many messages of how many topics there are.

    Raises
    ------
    BagError
        If it is no bag, is being recorded, holds nothing, is damaged rather than cut, or cannot
        be written. Then it is left as it was.

    """
    path = Path(path)
    try:
        with Reader(path) as bag:
            return False, sum(bag.counts.values()), len(bag.topics)
    except BagError:
        source = _file(path)
    with _locked(path), readable(path):
        workshop = path / _WORKSHOP
        # Of a repair that was cut short itself.
        shutil.rmtree(workshop, ignore_errors=True)
        try:
            counts = _rewrite(source, workshop / source.stem, path)
        finally:
            shutil.rmtree(workshop, ignore_errors=True)
    return True, sum(counts.values()), len(counts)


def _file(path: Path) -> Path:
    """Return the file of a bag that holds its messages."""
    if not path.is_dir():
        raise BagError(f'{path}: there is no such bag; a bag is named by its folder')
    files = [item for item in path.iterdir() if item.suffix in _KINDS]
    if len(files) != 1:
        raise BagError(f'{path}: cannot be repaired: has {len(files)} files '
                       f'{" or ".join(_KINDS)}, must have 1')
    return files[0]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    folder = os.open(path, os.O_RDONLY)
    try:
        if not storage.try_lock(folder):
            raise BagError(f'{path}: is being recorded still, and cannot be repaired')
        yield
    finally:
        os.close(folder)


def _rewrite(source: Path, target: Path, path: Path) -> dict[str, int]:
    """Write a file's messages into a new bag, which takes its place; return each topic's."""
    counts: dict[str, int] = {}
    about = {'command': shlex.join(['recorder', '--repair', str(path)])}
    with Writer(target, _KINDS[source.suffix], about) as bag:
        for connection, nanoseconds, data in _messages(source):
            if connection.topic not in counts:
                bag.topic(connection.topic, connection.msgtype, is_latched(connection))
            bag.write(connection.topic, nanoseconds / SECOND, data)
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
    if not counts:
        raise BagError(f'{path}: holds no messages')
    # First the messages: without its metadata.yaml it is still a bag to repair.
    for made, old in ((target / source.name, source),
                      (target / 'metadata.yaml', path / 'metadata.yaml')):
        with made.open('rb') as file:
            os.fsync(file.fileno())
        made.replace(old)
    (path / storage.RESERVE).unlink(missing_ok=True)
    return counts


def _messages(source: Path) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield what is whole in a file, with log times [ns]."""
    if source.suffix == '.mcap':
        view = _Ended(source, _whole(source))
        mcap = McapReader(cast(Any, SimpleNamespace(open=lambda _: io.BufferedReader(view))))
        mcap.open()
        with closing(mcap):
            # From before zero, as rosbags 0.11.0 skips chunks that end where it is to begin.
            yield from mcap.messages_scan(mcap.connections, -1)
        return
    # SQLite undoes by its journal what was not done, whenever somebody looks.
    with closing(sqlite3.connect(source)) as connection:
        connection.execute('SELECT COUNT(*) FROM sqlite_master').fetchone()
    database = Sqlite3Reader(source)
    database.open()
    with closing(database):
        yield from database.messages(database.connections)


def _whole(path: Path) -> int:
    """
    Return the size of the whole records of an mcap file.

    Raises
    ------
    BagError
        If what follows is no record that was cut short.

    """
    with path.open('rb') as file:
        size, end = path.stat().st_size, len(storage.MAGIC)
        if file.read(end) != storage.MAGIC:
            raise BagError(f'{path}: cannot be repaired: is no mcap file'
                           if size else f'{path}: holds no messages')
        while len(header := file.read(9)) == 9:
            kind, length = struct.unpack('<BQ', header)
            # Where power failed, zeros are what a file system knows of a file's end.
            if not 0 < kind <= _LAST and (any(header) or any(file.read())):
                raise BagError(
                    f'{path}: is damaged at byte {end} of {size}, and not only cut short')
            if kind in (0, _FOOTER) or end + 9 + length > size:
                break
            end += 9 + length
            file.seek(end)
    return end


class _Ended(io.RawIOBase):
    """The first bytes of an mcap file, and an end."""

    def __init__(self, path: Path, size: int) -> None:
        self._file = path.open('rb')
        self._size = size
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        whole = self._size + len(storage.BARE_END)
        self._position = offset + {
            os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: whole}[whence]
        return self._position

    def tell(self) -> int:
        return self._position

    def readinto(self, buffer: Any) -> int:
        left = self._size - self._position
        if left > 0:
            self._file.seek(self._position)
            data = self._file.read(min(left, len(buffer)))
        else:
            data = storage.BARE_END[-left:][:len(buffer)]
        buffer[:len(data)] = data
        self._position += len(data)
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()
