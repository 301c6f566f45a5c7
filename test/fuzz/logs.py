"""CSV logs: one of their files at a time is wrong."""

from __future__ import annotations

from random import Random

from harness import number, Scratch, Target, text
from tsmcl_ros.csv_log import read_log

_FILES = {
    'anchors.csv': ('id', 'x', 'y', 'z'),
    'beacons.csv': ('t', 'anchor', 'range', 'rssi'),
    'odometry.csv': ('t', 'x', 'y', 'yaw'),
    'truth.csv': ('t', 'x', 'y', 'z', 'yaw'),
}
_NAMES = tuple(_FILES)
_WHOLE = ('id', 'anchor')
_folder = Scratch()


def _cell(rng: Random, column: str, row: int, wrong: float) -> str:
    if rng.random() < wrong:
        return text(rng, '')
    if column in _WHOLE:
        return str(row % 4)
    if column == 't':
        return f'{row:.1f}'
    value = number(rng, -90, -1) if column == 'rssi' else abs(number(rng))
    return f'{value:.4g}' if wrong else f'{-(column == "rssi")}'


def _table(rng: Random, columns: tuple[str, ...], wrong: float) -> str:
    names = list(columns)
    if wrong and rng.random() < 0.1:
        rng.shuffle(names)
    rows = [[_cell(rng, name, row, wrong) for name in names] for row in range(4)]
    end = rng.choice(('\n', '\n', '\r\n', '\r', ''))
    return '\n'.join(','.join(row) for row in [names, *rows]) + end


def _log(rng: Random) -> bytes:
    """Return which file it is, and its content."""
    which = rng.randrange(len(_NAMES))
    return bytes([which]) + _table(rng, _FILES[_NAMES[which]], rng.choice((0.001, 0.03))).encode()


def _read(data: bytes) -> None:
    folder = _folder / 'log'
    if not folder.exists():
        folder.mkdir()
    mutated = _NAMES[(data or b'\0')[0] % len(_NAMES)]
    for name, columns in _FILES.items():
        (folder / name).write_bytes(
            data[1:] if name == mutated else _table(Random(1), columns, 0.0).encode())
    log = read_log(folder)
    for _ in log.epochs(1.0):
        pass


TARGETS = (
    Target('csv', _read, _log, (b',', b'\n', b'"', b'""', b'\r', b'1', b'nan', b'-', b'e9',
                                b'x,y', b';', b'\xef\xbb\xbf', b'\0', b'9' * 400), 8),
)
