"""Bags of both storages, of which one file is wrong."""

from __future__ import annotations

from functools import partial
import sqlite3

from harness import Scratch, Target
import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader, Writer
from tsmcl_ros.evaluation.recording import read_runs
from tsmcl_ros.types import Odometry

_folder = Scratch()
_parts: dict[str, dict[str, bytes]] = {}

_METADATA = tuple(text.encode() for text in (
    '../../../etc/passwd', '/etc/passwd', '&a [x, x]', '*a', '[[[[[[[[', '~', '[]', '{}', '-1',
    '1e400', '9' * 400, '!!python/object/apply:os.system [id]', '!!binary x', '.nan', ': ', '- ',
    'compression_mode: file', 'compression_mode: message', 'compression_format: zstd', '\n',
    "'\\x1b[2J'", '"\\e[2J"', 'mcap', 'sqlite3', 'cdr', '<<: 1', '? ',
    '2001-01-01T00:00:00+23:59'))
_SQL = (b'CREATE VIEW messages AS SELECT', b'CREATE TABLE', b'INTEGER', b'TEXT', b'messages')


def _files(storage: str) -> dict[str, bytes]:
    """Return the files of a small bag."""
    if storage not in _parts:
        path = _folder / f'whole_{storage}'
        with Writer(path, storage, {'command': 'localize_bag in out'}) as bag:
            bag.topic('/veh_0/pose', messages.POSE, latched=True)
            bag.topic('/veh_0/ground_truth', messages.ODOMETRY)
            for time in range(1, 5):
                bag.write('/veh_0/pose', time, messages.encode_pose(
                    time, 'map', np.zeros(2), np.eye(2), 0.0, 1.0))
                bag.write('/veh_0/ground_truth', time, messages.encode_odometry(
                    Odometry(time, np.zeros(3), 0.0), 'map', 'base_link'))
        for database in path.glob('*.db3'):
            with sqlite3.connect(database) as open_database:
                open_database.execute('PRAGMA page_size=512')
            open_database.execute('VACUUM')
            open_database.close()
        _parts[storage] = {part.suffix: part.read_bytes() for part in path.iterdir()}
    return _parts[storage]


def _read(storage: str, wrong: str, data: bytes) -> None:
    """Read a bag whose file of that kind is the input."""
    path = _folder / f'bag_{storage}'
    if not path.exists():
        path.mkdir()
    for suffix, content in _files(storage).items():
        name = 'metadata.yaml' if suffix == '.yaml' else f'whole_{storage}{suffix}'
        (path / name).write_bytes(data if suffix == wrong else content)
    with Reader(path) as bag:
        assert bag.duration >= 0
        for message in bag.messages():
            assert isinstance(message.data, bytes)
    read_runs(path)


def _target(name: str, storage: str, wrong: str, tokens: tuple[bytes, ...],
            share: float) -> Target:
    return Target(name, partial(_read, storage, wrong), lambda _: _files(storage)[wrong], tokens,
                  share)


TARGETS = (
    _target('mcap', 'mcap', '.mcap', (b'zstd', b'lz4', b'\x89MCAP0\r\n'), 0.4),
    _target('sqlite3', 'sqlite3', '.db3', _SQL, 0.3),
    _target('metadata', 'mcap', '.yaml', _METADATA, 0.3),
)
