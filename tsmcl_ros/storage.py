"""
Writers of rosbags that do not lose what they were given; `bag` builds on them.

rosbags keeps a megabyte of an mcap, or all of a database, to itself until the end. Here what was
saved is on disk, for `repair` to read however the process ends, and where the disk is full the
bag ends with what was saved before.
"""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
import errno
import fcntl
import io
from itertools import pairwise
import os
from pathlib import Path
import sqlite3
import struct
from tempfile import TemporaryFile
from typing import Any, cast, NamedTuple

from rosbags import rosbag2
from rosbags.interfaces import Connection
from rosbags.rosbag2.enums import CompressionMode, StoragePlugin
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

MAGIC = b'\x89MCAP0\r\n'
# The least that makes an mcap file whole: the records DataEnd and Footer, without an index.
BARE_END = struct.pack('<BQI', 0x0F, 4, 0) + struct.pack('<BQQQI', 0x02, 20, 0, 0, 0) + MAGIC
# What the bag's description is written into when nothing else finds room.
RESERVE = 'metadata.yaml.tmp'

_RESERVE_SIZE = 2**20  # bytes
_UNSAVED = 2**22  # bytes, that a database takes before they are saved
_NEVER = 2**63 - 1  # ns
_DISK_ERRORS = (OSError, sqlite3.Error)


class _Extent(NamedTuple):
    """How many messages of which connections there are, and from when to when [ns]."""

    counts: dict[int, int]
    start: int
    end: int


class _Mark(NamedTuple):
    """What an mcap file held when it was saved."""

    size: int
    chunks: int
    extent: _Extent


class _Index:
    """
    The records of an index, in a file without a name, as recordings have no end.

    What is saved twice a second has an index that would take megabytes of memory in an hour.
    """

    def __init__(self, folder: Path) -> None:
        self._file = TemporaryFile(buffering=0, dir=folder)
        self._ends = array('Q', [0])

    def append(self, record: io.BytesIO) -> None:
        self._file.seek(self._ends[-1])
        if self._file.write(record.getbuffer()) != record.tell():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._ends.append(self._ends[-1] + record.tell())

    def cut(self, length: int) -> None:
        """Forget all but the first records."""
        del self._ends[length + 1:]

    def close(self) -> None:
        self._file.close()

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __iter__(self) -> Iterator[io.BytesIO]:
        for begin, end in pairwise(self._ends):
            self._file.seek(begin)
            record = io.BytesIO()
            record.write(self._file.read(end - begin))
            yield record


class Mcap(McapWriter):
    """An mcap file that is saved by chunks."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._index = _Index(path)
        self.chunks = cast(list[io.BytesIO], self._index)
        self._marks: deque[_Mark] = deque(maxlen=2)
        self._is_bare = False
        self._mark()

    def close_chunk(self) -> None:
        """Write the pending chunk, as far as the system's cache."""
        super().close_chunk()
        self._mark()

    def save(self) -> None:
        """Have all on disk that was written."""
        if self.chunk.msgs:
            self.close_chunk()

    def retreat(self) -> _Extent:
        """Go back to when it was saved last, and return what it holds then."""
        mark = self._marks[-1]
        # What its buffer holds must not follow, not even when it is forgotten.
        self.bio.raw.close()
        os.truncate(self.path, mark.size)
        self.bio = self.path.open('ab')
        self._index.cut(mark.chunks)
        self.chunk = PendingChunk(_NEVER, 0, io.BytesIO(), defaultdict(list))
        counts, self.message_start_time, self.message_end_time = mark.extent
        self.channel_stats |= dict.fromkeys(self.channel_stats, 0) | counts
        return mark.extent

    def shrink(self) -> _Extent:
        """Make room: go back by another chunk, and do without an index."""
        if len(self._marks) > 1:
            self._marks.pop()
        self._is_bare = True
        return self.retreat()

    def close(self, version: int, metadata: str) -> None:
        """Complete the file."""
        if self._is_bare:
            self.bio.write(BARE_END)
            self.bio.close()
        else:
            super().close(version, metadata)
        self._index.close()

    def _mark(self) -> None:
        self.bio.flush()
        self._marks.append(_Mark(self.bio.tell(), len(self._index), _Extent(
            dict(self.channel_stats), self.message_start_time, self.message_end_time)))


class Sqlite3(Sqlite3Writer):
    """A database that is saved by transactions."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        self._unsaved = 0
        self._is_bare = False

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message, and save all that were written now and then."""
        super().write(connection, timestamp, data)
        self._unsaved += len(data)
        if self._unsaved > _UNSAVED:
            self.save()

    def save(self) -> None:
        """Have all on disk that was written."""
        self.conn.commit()
        self._unsaved = 0

    def retreat(self) -> _Extent:
        """Go back to when it was saved last, and return what it holds then."""
        self.conn.rollback()
        rows = self.conn.execute(
            'SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages '
            'GROUP BY topic_id').fetchall()
        return _Extent(
            {topic: count for topic, count, _, _ in rows},
            min((start for _, _, start, _ in rows), default=_NEVER),
            max((end for _, _, _, end in rows), default=0))

    def shrink(self) -> _Extent:
        """Make room: do without what the bag's description says as well."""
        self._is_bare = True
        return self.retreat()

    def close(self, version: int, metadata: str) -> None:
        """Complete the database."""
        if self._is_bare:
            self.conn.close()
        else:
            super().close(version, metadata)


class Writer(rosbag2.Writer):
    """
    A writer of bags that can save what was written, and ends well where there is no room.

    While it is open it holds a lock on the bag's folder, which ends with the process; see
    `is_being_written`.
    """

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {
        StoragePlugin.MCAP: Mcap, StoragePlugin.SQLITE3: Sqlite3}

    def open(self) -> None:
        """Make the bag's folder, and its file."""
        super().open()
        self._lock = os.open(self.path, os.O_RDONLY)
        try_lock(self._lock)
        (self.path / RESERVE).write_bytes(bytes(_RESERVE_SIZE))

    def save(self) -> None:
        """Have all on disk that was written; what the process leaves then can be repaired."""
        cast(Any, self.storage).save()

    def close(self) -> None:
        """Complete the bag."""
        (self.path / RESERVE).unlink(missing_ok=True)
        super().close()
        self._unlock()

    def salvage(self) -> int:
        """
        Complete the bag as of when it was saved last, after an error; return its messages.

        Raises
        ------
        OSError, sqlite3.Error
            If not even that has room.

        """
        storage = cast(Any, self.storage)
        for make_room in (storage.retreat, storage.shrink):
            counts, self.min_timestamp, self.max_timestamp = make_room()
            self.counts = dict.fromkeys(self.counts, 0) | counts
            try:
                self.close()
                break
            except _DISK_ERRORS:
                if make_room == storage.shrink or self.storage is None:
                    self._unlock()
                    raise
        return sum(self.counts.values())

    def _unlock(self) -> None:
        os.close(self._lock)


def try_lock(folder: int) -> bool:
    """Lock a folder, given its descriptor, until that is closed; False if somebody else has."""
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # A file system without locks has nobody say that he writes.
        return True
    return True


def is_being_written(path: Path) -> bool:
    """Tell whether a process of this host has the bag open for writing."""
    folder = os.open(path, os.O_RDONLY)
    try:
        return not try_lock(folder)
    finally:
        os.close(folder)
