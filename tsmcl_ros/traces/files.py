"""What the files of traces have in common: compression, errors, and waypoints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import gzip
import io
from io import BufferedIOBase
import math
import os
from pathlib import Path
from typing import Any, NamedTuple
import zlib

import numpy as np
from tsmcl_ros.model.mobility import Trace
from tsmcl_ros.types import Array, LogError

LARGEST = 1e12  # any time [s], coordinate [m] or speed [m/s]
FURTHEST = 1e5  # m; beacons carry float32 coordinates, which want a local origin
_MOST_NUMBERS = 50_000_000  # of a trace in memory, 400 MB
_GZIP_MAGIC = b'\x1f\x8b'
# Traces shrink to a tenth; a few bytes may as well stand for gigabytes.
_MOST_SHRUNK = 50
_ALWAYS_FINE = 2**20  # bytes
_CHUNK = 2**16  # bytes
_LONGEST_LINE = 2**21  # bytes; a node's waypoints of many hours


class Refused(Exception):
    """What is wrong with the file; `reading` adds its name, and the line."""


class Way(NamedTuple):
    """
    One vehicle's waypoints, between which it goes straight at constant speed.

    Attributes
    ----------
    name : str
    stamp : (W,) float64
        Strictly increasing [s]; the vehicle is there from the first to the last.
    position : (W, D) float64
        [m].

    """

    name: str
    stamp: Array
    position: Array


class _Unpacked(io.RawIOBase):
    """What a compressed file holds; raises Refused if that is beyond measure."""

    def __init__(self, packed: BufferedIOBase) -> None:
        super().__init__()
        self._file = gzip.GzipFile(fileobj=packed)
        self._left = _ALWAYS_FINE + _MOST_SHRUNK * os.fstat(packed.fileno()).st_size

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        count = self._file.readinto(buffer)
        self._left -= count
        if self._left < 0:
            raise Refused(
                f'unpacks to more than {_MOST_SHRUNK} times its size, which no trace does')
        return count


@contextmanager
def opened(path: Path) -> Iterator[BufferedIOBase]:
    """Open a file that may be compressed; its name does not matter."""
    with path.open('rb') as raw:
        if raw.peek(2)[:2] == _GZIP_MAGIC:
            with io.BufferedReader(_Unpacked(raw), _CHUNK) as unpacked:
                yield unpacked
        else:
            yield raw


@contextmanager
def reading(path: Path, line: Callable[[], int] | None = None) -> Iterator[None]:
    """Turn what may go wrong in reading a file into a LogError with its name, and the line."""
    def where() -> str:
        return f'{path}:{line()}' if line else f'{path}'

    try:
        yield
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f'{where()}: the gzip file is damaged: {error}') from None
    except OSError as error:
        raise LogError(f'{path}: cannot read the trace: {error.strerror}') from None
    except UnicodeDecodeError:
        raise LogError(f'{where()}: is not text') from None
    except Refused as error:
        raise LogError(f'{where()}: {error}') from None


class Lines:
    """
    The lines of a text file that may be compressed, without those of comments and blank ones.

    Attributes
    ----------
    number : int
        Of the line read last, from 1.

    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.number = 0

    def __iter__(self) -> Iterator[str]:
        self.number = 0
        with reading(self._path, lambda: self.number), opened(self._path) as stream:
            while line := stream.readline(_LONGEST_LINE + 1):
                self.number += 1
                if len(line) > _LONGEST_LINE:
                    raise Refused(f'is longer than {_LONGEST_LINE} bytes, as no line may be')
                text = line.decode().strip()
                if text and not text.startswith('#'):
                    yield text


def number(text: str) -> float:
    """Return the number that a text stands for; raise Refused if it is none of this world."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refused(f'{text!r} is not a finite number')
    if abs(value) > LARGEST:
        raise Refused(f'{text} is not allowed, must be within {LARGEST:g}')
    return value


def meet(ways: Sequence[Way], vehicles: int, start: float, duration: float) -> Trace:
    """
    Return the trace of the longest-lived vehicles, from the start as long as all are there.

    It has an instant wherever one of them has a waypoint, and so loses nothing of them.

    Parameters
    ----------
    ways : sequence of Way
        All that are known.
    vehicles : int
        V, at least 1; of equally long-lived ones the first are taken.
    start : float
        [s].
    duration : float
        Time from the start that all vehicles must be there, and at which the trace ends [s]; 0
        for as long as they are.

    Raises
    ------
    Refused
        If too few vehicles are there; if they have too many waypoints to be held in memory.

    """
    end = start + duration if duration > 0 else math.inf
    there = [way for way in ways if way.stamp[0] <= start and way.stamp[-1] > start
             and (way.stamp[-1] >= end or end == math.inf)]
    refuse_few(len(there), vehicles, start, end)
    lives = np.array([way.stamp[-1] for way in there])
    # The longest-lived, put back into the order of the file.
    chosen = [there[index] for index in np.sort(np.argsort(-lives, kind='stable')[:vehicles])]
    end = min(end, *(way.stamp[-1] for way in chosen))
    stamp = np.unique(np.concatenate([[start, end], *(way.stamp for way in chosen)]))
    stamp = stamp[(stamp >= start) & (stamp <= end)]
    numbers = len(stamp) * sum(way.position.shape[1] for way in chosen)
    if numbers > _MOST_NUMBERS:
        raise Refused(
            f'{vehicles} vehicles have {len(stamp)} waypoints from {start:g} s to {end:g} s, '
            f'which makes {numbers:.2g} coordinates, at most {_MOST_NUMBERS:.2g} are allowed; ask '
            'for fewer vehicles or a shorter time (trace_duration)')
    position = np.array([
        [np.interp(stamp, way.stamp, axis) for axis in way.position.T] for way in chosen])
    return Trace(tuple(way.name for way in chosen), stamp, position.transpose(2, 0, 1), None)


def refuse_few(found: int, vehicles: int, start: float, end: float) -> None:
    """Raise Refused if too few vehicles are there from start to end [s]."""
    if found < vehicles:
        wanted = f'to {end:g} s' if end < math.inf else 'on'
        raise Refused(f'holds {found} vehicles that are there from {start:g} s {wanted}, '
                      f'{vehicles} are wanted')


def place(trace: Trace, path: Path, local_origin: bool) -> Trace:
    """
    Return the trace, with the whole metres of the lowest x and y as its origin if that is wanted.

    Raises
    ------
    LogError
        If coordinates are beyond 100 km.

    """
    if local_origin:
        trace.position[..., :2] -= np.floor(trace.position[..., :2].min(axis=(0, 1)))
    if np.abs(trace.position).max() > FURTHEST:
        raise LogError(
            f'{path}: has coordinates beyond 100 km, at {_text(trace.position)} m; ask for a '
            'local origin (trace_local_origin)'
        )
    return trace


def _text(position: Array) -> str:
    furthest = position.reshape(-1, position.shape[-1])[np.abs(position).max(axis=-1).argmax()]
    return '(' + ', '.join(f'{value:.0f}' for value in furthest) + ')'
