"""
Reading and writing of rosbag2 recordings as serialized bytes; the only importer of rosbags.

A bag is named by its folder, as rosbag2 does. Log times are float seconds, see `messages`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
import re
import shlex
import signal
import threading
from types import FrameType, TracebackType
from typing import Any, NamedTuple

from rosbags import rosbag2
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore
from tsmcl_ros import bag_checks
from tsmcl_ros import storage as files
from tsmcl_ros.types import BagError

STORAGES = ('mcap', 'sqlite3')

# What guards the writing of one message costs more than the writing.
_BATCH = 256  # messages
_BATCH_SIZE = 2**20  # bytes

SECOND = 1_000_000_000  # ns
_MAX_STAMP = 2**33  # s, what still fits into 64 bits of nanoseconds


class Message(NamedTuple):
    """One recorded message: its topic and type, when it was recorded [s], and its bytes."""

    topic: str
    type: str
    stamp: float
    data: bytes


class Reader:
    """
    Reads a bag front to back without taking its messages apart; a context manager.

    Attributes
    ----------
    topics : dict of str to str
        Type of each topic, such as 'sensor_msgs/msg/PointCloud2'.
    counts : dict of str to int
        Number of messages of each topic.
    latched : set of str
        Topics that late joiners get the last message of (transient local).
    start, duration : float
        Log time of the first message, and from it to the last [s].
    about : dict of str to str
        What the bag says of how it was made; see `Writer`.

    """

    def __init__(self, path: str | Path) -> None:
        """
        Open a bag.

        Raises
        ------
        BagError
            If there is none, or it is empty, damaged, or of an unknown kind.

        """
        self.path = Path(path)
        with readable(self.path):
            _refuse_what_is_no_bag(self.path)
            self._bag = rosbag2.Reader(self.path)
            self._bag.open()
            try:
                self._describe()
            except BaseException:
                self.close()
                raise

    def _describe(self) -> None:
        """Take over what the bag says of itself."""
        storage = self._bag.storage
        self._packed = storage.metadata.compression_mode == 'message'
        if self._packed:
            # rosbags would unpack messages of any size.
            storage.metadata = storage.metadata._replace(compression_mode=None)
        connections = self._bag.connections
        for item in connections:
            bag_checks.check_topic(self.path, item.topic)
        self.topics = {item.topic: str(item.msgtype) for item in connections}
        self.counts = dict.fromkeys(self.topics, 0)
        for item in connections:
            self.counts[item.topic] += item.msgcount
        self.latched = {item.topic for item in connections if is_latched(item)}
        custom = storage.metadata.custom
        self.about = {str(key): str(value) for key, value in custom.items()} if isinstance(
            custom, dict) else {}
        self.start = self._bag.start_time / SECOND
        # The end that rosbags names is a nanosecond after the last message.
        self.duration = max(self._bag.duration - 1, 0) / SECOND
        if not self._bag.message_count:
            raise BagError(f'{self.path}: holds no messages')

    @property
    def undecodable(self) -> dict[str, str]:
        """Topics with types that neither the bag nor ROS itself defines, and these types."""
        return {
            item.topic: item.msgtype
            for item in self._bag.connections
            if item.msgdef.format is MessageDefinitionFormat.NONE
            and item.msgtype not in _typestore(Stores.ROS2_FOXY).fielddefs
        }

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Message]:
        """
        Yield the messages of some topics, or of all, in order of log time.

        Raises
        ------
        BagError
            If a topic is not in the bag, or the bag turns out to be damaged on the way.

        """
        wanted = set(self.topics if topics is None else topics)
        for topic in sorted(wanted - set(self.topics)):
            raise BagError(
                f'{self.path}: has no topic {topic}, has {", ".join(sorted(self.topics))}'
            )
        connections = [item for item in self._bag.connections if item.topic in wanted]
        if not connections:
            return
        with readable(self.path):
            for item, nanoseconds, data in self._bag.messages(connections):
                if self._packed:
                    data = bag_checks.unpack_message(data)
                yield Message(item.topic, item.msgtype, nanoseconds / SECOND, data)

    def close(self) -> None:
        """Close the bag; closing it again does nothing."""
        if self._bag.is_open:
            self._bag.close()

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Writer:
    """
    Writes a new bag; a context manager.

    Whatever ends the context, the bag is closed complete with what was written so far; where the
    disk fails, with what was saved. Signals that raise KeyboardInterrupt wait while a record is
    being written. A process that is killed leaves what was saved, for `repair`.
    """

    def __init__(self, path: str | Path, storage: str = 'mcap',
                 about: Mapping[str, str] | None = None) -> None:
        """
        Create a bag and its parent folders.

        Parameters
        ----------
        path : str or Path
            The bag's folder.
        storage : str
            One of `STORAGES`.
        about : mapping of str to str, optional
            How the bag is made, left in it as rosbag2's custom data: `command` is a command line,
            any other name what has parameters, with them as a ROS parameter file.

        Raises
        ------
        BagError
            If the path exists or cannot be made, or the storage is unknown.

        """
        self.path = Path(path)
        if storage not in STORAGES:
            raise BagError(
                f'storage {storage!r} is not allowed, must be one of {", ".join(STORAGES)}'
            )
        if self.path.exists():
            raise BagError(f'{self.path}: exists already, bags are never overwritten')
        # Now, as it takes long, and what is recorded does not wait.
        self._store = _typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}
        self._pending: list[tuple[Connection, int, bytes]] = []
        self._pending_size = 0
        self._open = False
        try:
            with self._writing():
                self._bag = files.Writer(
                    self.path,
                    version=files.Writer.VERSION_LATEST,
                    storage_plugin=rosbag2.StoragePlugin[storage.upper()],
                )
                self._bag.open()
                self._open = True
                for key, value in (about or {}).items():
                    self._bag.set_custom_data(key, value)
        except KeyboardInterrupt:
            # A signal that waited: nobody else can close what nobody has yet.
            self.close()
            raise

    def topic(self, name: str, type: str, latched: bool = False) -> None:  # noqa: A002
        """
        Register a topic with its type; a latched one is replayed to late joiners too.

        Raises
        ------
        BagError
            If the topic has another type already, or the type is unknown to ROS 2 Jazzy.

        """
        known = self._connections.get(name)
        if known is not None:
            if known.msgtype != type:
                raise BagError(
                    f'{self.path}: topic {name} has type {known.msgtype} and cannot have {type}'
                )
            return
        if type not in self._store.fielddefs:
            raise BagError(f'{self.path}: topic {name}: type {type} is unknown to ROS 2 Jazzy')
        with self._writing():
            self._connections[name] = self._bag.add_connection(
                name, type, typestore=self._store,
                offered_qos_profiles=[_LATCHED if latched else _QOS],
            )

    def write(self, name: str, stamp: float, data: bytes) -> None:
        """
        Write one message of a registered topic under its log time [s].

        Raises
        ------
        BagError
            If the bag is closed, the topic not registered, the stamp no time, or the disk fails.

        """
        if not self._open:
            raise BagError(f'{self.path}: is closed')
        if name not in self._connections:
            raise BagError(f'{self.path}: topic {name} is not registered')
        if not 0 <= stamp < _MAX_STAMP:
            raise BagError(
                f'{self.path}: topic {name}: log time {stamp!r} s is not allowed, must be at '
                f'least 0 and below {_MAX_STAMP}'
            )
        whole, part = divmod(stamp, 1)
        nanoseconds = int(whole) * SECOND + round(part * SECOND)
        self._pending.append((self._connections[name], nanoseconds, data))
        self._pending_size += len(data)
        if len(self._pending) >= _BATCH or self._pending_size >= _BATCH_SIZE:
            with self._writing():
                self._flush()

    def save(self) -> None:
        """
        Have all on disk that was written, as far as the system takes care of that.

        Raises
        ------
        BagError
            If the disk fails.

        """
        if self._open:
            with self._writing():
                self._flush()
                self._bag.save()

    def close(self) -> None:
        """Complete the bag; closing it again does nothing."""
        if self._open:
            with self._writing():
                self._flush()
                self._bag.close()
                self._open = False

    @property
    def is_open(self) -> bool:
        """Whether it takes messages: it has not been closed, nor has the disk failed."""
        return self._open

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Undisturbed by signals, turn what fails into one clear line, and complete the bag."""
        with _undisturbed():
            try:
                yield
            except Exception as error:
                raise BagError(
                    f'{self.path}: cannot be written: {_reason(error)}{self._salvaged()}'
                ) from error

    def _salvaged(self) -> str:
        """Complete the bag as far as it was saved, and say what it holds."""
        if not self._open:
            return ''
        self._open = False
        self._pending.clear()
        try:
            return f'; complete are the {self._bag.salvage()} messages before'
        except Exception:
            return f'; to read what it holds: {_repair(self.path)}'

    def _flush(self) -> None:
        pending, self._pending, self._pending_size = self._pending, [], 0
        for message in pending:
            self._bag.write(*message)

    def __enter__(self) -> Writer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


_FOREVER = QosTime(9223372036, 854775807)
_QOS = Qos(
    QosHistory.KEEP_LAST, 10, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False,
)
_LATCHED = _QOS._replace(depth=1, durability=QosDurability.TRANSIENT_LOCAL)


@cache
def _typestore(store: Stores) -> Typestore:
    return get_typestore(store)


def is_latched(connection: Connection) -> bool:
    extension = connection.ext
    return isinstance(extension, ConnectionExtRosbag2) and any(
        profile.durability is QosDurability.TRANSIENT_LOCAL
        for profile in extension.offered_qos_profiles
    )


def _refuse_what_is_no_bag(path: Path) -> None:
    if not path.exists():
        raise BagError(f'{path}: there is no such bag')
    if not path.is_dir():
        raise BagError(f'{path}: is a file; a bag is named by its folder, {path.parent}')
    if not any(path.iterdir()):
        raise BagError(f'{path}: is an empty folder; a bag has a metadata.yaml')
    metadata = path / 'metadata.yaml'
    if not metadata.is_file():
        if any(item.suffix in ('.mcap', '.db3') for item in path.iterdir()):
            raise BagError(
                f'{path}: is being recorded still: it has no metadata.yaml'
                if files.is_being_written(path) else
                f'{path}: its recording was cut short; to read what it holds: {_repair(path)}')
        raise BagError(
            f'{path}: is not a bag, or its recording was cut short: it has no metadata.yaml'
        )
    text = metadata.read_text('utf-8')
    storage = re.search(r'storage_identifier:\s*["\']?(\w+)', text)
    if storage and storage[1] not in STORAGES:
        raise BagError(
            f'{path}: storage {storage[1]!r} is not supported, must be one of '
            f'{", ".join(STORAGES)}'
        )
    bag_checks.check_metadata(metadata, text)
    for database in path.glob('*.db3'):
        bag_checks.check_database(database)
    for packed in path.glob('*.zstd'):
        bag_checks.check_packed(packed)


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file makes a parser trip over into one clear line."""
    try:
        yield
    except BagError:
        raise
    except PermissionError as error:
        raise BagError(f'{path}: cannot be read: {error.strerror}') from error
    except Exception as error:
        raise BagError(
            f'{path}: cannot be read, it is truncated or damaged: {_damage(error)}') from error


def _damage(error: Exception) -> str:
    """Say what a parser tripped over, where it was written for people."""
    own = type(error).__module__ == 'builtins' and not isinstance(error, (OSError, ValueError))
    return 'its records do not fit together' if own else _reason(error)


def _reason(error: Exception) -> str:
    return ' '.join(str(error).split()) or type(error).__name__


def _repair(path: Path) -> str:
    """Return the command that makes a bag readable whose recording was cut short."""
    return shlex.join(['recorder', '--repair', str(path)])


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Put signals off that may raise KeyboardInterrupt: half a record would spoil the bag."""
    late: list[tuple[int, FrameType | None]] = []
    previous: dict[int, Callable[[int, FrameType | None], Any]] = {}
    number: int
    try:
        # Python runs handlers in the main thread only.
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                handler = signal.getsignal(number)
                if callable(handler):
                    previous[number] = handler
                    signal.signal(number, lambda *arguments: late.append(arguments))
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        for arguments in late:
            previous[arguments[0]](*arguments)
