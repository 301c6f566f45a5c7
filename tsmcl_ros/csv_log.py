"""
Reading and checking of CSV logs: a folder with anchors, beacons, odometry and truth.

SI units; t in seconds from the log's start; an empty cell is unknown. Errors name file and line,
the bad value, and what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterator
import csv
from dataclasses import dataclass, replace
from functools import partial
import math
from pathlib import Path

import numpy as np
from tsmcl_ros.gathering import gather, period_number
from tsmcl_ros.messages import MAX_COORDINATE
from tsmcl_ros.types import Array, LogError, Observation, Progress, Trajectory, unshown


@dataclass(frozen=True, eq=False)
class CsvLog:
    """
    One vehicle's recording.

    Attributes
    ----------
    anchors : Observation
        All anchors as one scan (V = 1, D = 3), stamped with the first stamp of the log.
    stamp : (B,) float64
        When each beacon was heard, in order of time [s].
    sender : (B,) int64
        The anchor that each beacon is from.
    range, rssi : (B,) float64
        [m], [dBm]; NaN where unknown.
    odometry, truth : Trajectory or None
        D = 3; an unknown z is zero, an unknown yaw NaN. None where the log has no such file.
    notes : tuple of str
        What was mended in the log, for its user to know.

    """

    anchors: Observation
    stamp: Array
    sender: Array
    range: Array
    rssi: Array
    odometry: Trajectory | None
    truth: Trajectory | None
    notes: tuple[str, ...]

    def range_free(self, threshold: float) -> CsvLog:
        """
        Return a log that knows of each beacon only that it was heard.

        Parameters
        ----------
        threshold
            Beacons with a lower rssi [dBm], or without one, count as not heard.

        Raises
        ------
        LogError
            If no beacon is left.

        """
        heard = self.rssi >= threshold
        if not heard.any():
            known = self.rssi[~np.isnan(self.rssi)]
            found = f'the strongest has {known.max():g} dBm' if known.size else 'none has an rssi'
            raise LogError(f'no beacon has an rssi of at least {threshold:g} dBm: {found}')
        unmeasured = np.full(np.count_nonzero(heard), np.nan)
        return replace(
            self, stamp=self.stamp[heard], sender=self.sender[heard],
            range=unmeasured, rssi=unmeasured,
        )

    def epochs(self, period: float) -> Iterator[Observation]:
        """
        Yield what was heard in each period [s] in which anything was (V = 1, D = 3).

        Periods count from t = 0, and a scan is stamped with its last beacon; of an anchor that
        was heard several times see `gather`.
        """
        anchors, count = self.anchors.sender[0], len(self.stamp)
        heard = Observation.empty(1, count, 3, math.nan)
        heard.sender[0], heard.range[0], heard.rssi[0] = self.sender, self.range, self.rssi
        heard.position[0] = self.anchors.position[0, np.searchsorted(anchors, self.sender)]
        last = np.flatnonzero(np.diff(period_number(self.stamp, period)))
        for rows in np.split(np.arange(count), last + 1):
            yield replace(gather(heard.columns(rows)), stamp=float(self.stamp[rows[-1]]))


def read_log(path: str | Path, progress: Progress = unshown) -> CsvLog:
    """
    Read and check a folder with anchors.csv, beacons.csv, and odometry.csv and truth.csv if any.

    Beacons are put into order of time: radios with several receivers, or with buffers, log them
    late. Rows with an rssi of 0 dBm or more, which receivers write where they measured none, are
    left out. Both are noted.

    Parameters
    ----------
    path : str or Path
        The folder.
    progress : Progress
        Shows the reading of each file.

    Raises
    ------
    LogError
        If a file is missing, has a bad row, or holds nothing; if an anchor's id comes twice, or
        a beacon's in no row of anchors.csv; if odometry or truth go back in time.

    """
    folder = Path(path)
    if not folder.is_dir():
        reason = 'is no folder' if folder.exists() else 'there is no such folder'
        raise LogError(f'{folder}: {reason}, a CSV log is one with anchors.csv and beacons.csv')
    anchors = read_anchors(folder / 'anchors.csv')
    beacons = _read_table(folder / 'beacons.csv', _BEACONS, progress)
    notes = []
    number, sender = np.array(beacons.lines), beacons['anchor']
    strange = ~np.isin(sender, anchors.sender[0])
    if strange.any():
        row = int(np.argmax(strange))
        raise LogError(
            f'{beacons.path}:{number[row]}: anchor {sender[row]:.0f} is not in anchors.csv, must '
            f'be one of {", ".join(map(str, anchors.sender[0]))}'
        )
    impossible = beacons['rssi'] >= 0
    if impossible.any():
        notes.append(
            f'{beacons.path}: left out rows with an rssi of 0 dBm or more, in '
            f'{_lines(number[impossible])}'
        )
    back = np.diff(beacons['t'], prepend=0.0) < 0
    if back.any():
        notes.append(
            f'{beacons.path}: put into order of time, which goes back in {_lines(number[back])}'
        )
    order = np.argsort(beacons['t'], kind='stable')
    order = order[~impossible[order]]
    if not order.size:
        raise LogError(f'{beacons.path}: holds no beacons')
    stamp = beacons['t'][order]
    odometry = _read_trajectory(folder / 'odometry.csv', _ODOMETRY, progress)
    truth = _read_trajectory(folder / 'truth.csv', _TRUTH, progress)
    starts = [stamp[0], *(part.stamp[0] for part in (odometry, truth) if part is not None)]
    return CsvLog(
        anchors=replace(anchors, stamp=float(min(starts))),
        stamp=stamp,
        sender=sender[order].astype(np.int64),
        range=beacons['range'][order],
        rssi=beacons['rssi'][order],
        odometry=odometry,
        truth=truth,
        notes=tuple(notes),
    )


def _lines(numbers: Array) -> str:
    """Name lines, at most a few of them."""
    shown = ', '.join(map(str, numbers[:5]))
    return f'line {shown}' if len(numbers) <= 5 else f'line {shown} and {len(numbers) - 5} more'


@dataclass(frozen=True)
class _Column:
    """A column's name, bounds, and what an empty cell stands for (None: must not be empty)."""

    name: str
    low: float = -math.inf
    high: float = math.inf
    unknown: float | None = None
    whole: bool = False

    def parse(self, text: str) -> float:
        """Return a cell's value; raise ValueError if it is not allowed."""
        text = text.strip()
        if not text and self.unknown is not None:
            return self.unknown
        value = float(int(text) if self.whole else text)
        # Python reads 1_000 as a number, and nan.
        if '_' in text or not math.isfinite(value) or not self.low <= value <= self.high:
            raise ValueError
        return value

    @property
    def allowed(self) -> str:
        """Say in words which values are allowed."""
        bounds = [
            f'{word} {bound:.10g}'
            for word, bound in (('at least', self.low), ('at most', self.high))
            if math.isfinite(bound)
        ]
        kind = 'a whole number' if self.whole else 'a number'
        empty = [] if self.unknown is None else ['or empty where unknown']
        return ', '.join([f'{kind} {" and ".join(bounds)}'.strip(), *empty])


_T = _Column('t', low=0, high=2**31 - 1)
_X, _Y = _Column('x'), _Column('y')
_Near = partial(_Column, low=-MAX_COORDINATE, high=MAX_COORDINATE)
_ANCHORS = (
    _Column('id', low=0, high=2**32 - 1, whole=True),
    _Near('x'), _Near('y'), _Near('z', unknown=0.0),
)
_BEACONS = (
    _T, replace(_ANCHORS[0], name='anchor'),
    _Column('range', low=0, high=1e6, unknown=math.nan),
    _Column('rssi', low=-1000, high=1000, unknown=math.nan),
)
_ODOMETRY = (_T, _X, _Y, _Column('yaw'))
_TRUTH = (_T, _X, _Y, _Column('z', unknown=0.0), _Column('yaw', unknown=math.nan))


@dataclass(frozen=True, eq=False)
class _Table:
    """The checked columns of a CSV file, and the line that each row ends in."""

    path: Path
    columns: dict[str, Array]
    lines: list[int]

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]


def _read_table(
    path: Path, columns: tuple[_Column, ...], progress: Progress = unshown,
) -> _Table:
    lines: list[int] = []
    values: list[list[float]] = []
    try:
        total = path.read_bytes().count(b'\n')
        with path.open(encoding='utf-8-sig', newline='') as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            if missing := [column.name for column in columns if column.name not in header]:
                raise LogError(
                    f'{path}:1: columns {", ".join(missing)} are missing, must have '
                    f'{",".join(column.name for column in columns)}'
                )
            places = [(header.index(column.name), column) for column in columns]
            for cells in progress(reader, total, 'row', str(path)):
                if not cells:
                    continue
                if len(cells) != len(header):
                    raise LogError(
                        f'{path}:{reader.line_num}: has {len(cells)} cells, must have '
                        f'{len(header)}: {",".join(header)}'
                    )
                values.append([
                    _parse(path, reader.line_num, column, cells[place]) for place, column in places
                ])
                lines.append(reader.line_num)
    except OSError as error:
        raise LogError(f'{path}: cannot be read: {error.strerror}') from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise LogError(f'{path}: is not a CSV file in UTF-8: {error}') from None
    if not values:
        raise LogError(f'{path}: holds no rows below its header')
    found = np.array(values).T
    return _Table(path, {column.name: found[at] for at, column in enumerate(columns)}, lines)


def _parse(path: Path, line: int, column: _Column, text: str) -> float:
    try:
        return column.parse(text)
    except (ValueError, OverflowError):
        raise LogError(
            f'{path}:{line}: {column.name} {text!r} is not allowed, must be {column.allowed}'
        ) from None


def read_anchors(path: str | Path) -> Observation:
    """
    Return the anchors of an anchors.csv as one scan (V = 1, D = 3), in order of their ids.

    Raises
    ------
    LogError
        If the file is missing, has a bad row or none, or an id comes twice.

    """
    table = _read_table(Path(path), _ANCHORS)
    sender = table['id'].astype(np.int64)
    order = np.argsort(sender, kind='stable')
    twice = np.flatnonzero(np.diff(sender[order]) == 0)
    if twice.size:
        first, second = order[twice[0]], order[twice[0] + 1]
        raise LogError(
            f'{path}:{table.lines[second]}: id {sender[second]} is claimed by two anchors, the '
            f'other is in line {table.lines[first]}'
        )
    anchors = Observation.empty(1, len(order), 3, 0.0)
    anchors.sender[0] = sender[order]
    anchors.position[0] = np.stack([table[axis] for axis in 'xyz'], axis=1)[order]
    return anchors


def _read_trajectory(
    path: Path, columns: tuple[_Column, ...], progress: Progress,
) -> Trajectory | None:
    if not path.exists():
        return None
    table = _read_table(path, columns, progress)
    back = np.flatnonzero(np.diff(table['t']) < 0)
    if back.size:
        row = int(back[0]) + 1
        raise LogError(
            f'{path}:{table.lines[row]}: t {table["t"][row]:g} goes back, must be at least '
            f'{table["t"][row - 1]:g} as in the row before'
        )
    x, y = table['x'], table['y']
    z = table.columns.get('z', np.zeros_like(x))
    return Trajectory(table['t'], np.stack([x, y, z], axis=1), table['yaw'])
