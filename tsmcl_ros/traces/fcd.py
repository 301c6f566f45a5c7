"""
Reading of floating-car data, the vehicle trajectories that SUMO writes with `--fcd-output`.

The file is streamed, and only the vehicles that may still be wanted are kept. A document type
definition, and with it any entity, is refused: such data need none, and it is how small files
grow into gigabytes.
"""

from __future__ import annotations

from array import array
import math
from pathlib import Path
from xml.parsers import expat

import numpy as np
from tsmcl_ros.model.mobility import Trace, wrap
from tsmcl_ros.traces.files import opened, place, reading, refuse_few, Refused
from tsmcl_ros.types import LogError

_CHUNK = 1 << 16
_LONGEST_ELEMENT = 1 << 20


def read_fcd(
    path: str | Path,
    vehicles: int,
    start: float = 0.0,
    duration: float = 0.0,
    *,
    elevation: bool = False,
    local_origin: bool = False,
) -> Trace:
    """
    Read the ways of the longest-lived vehicles from a SUMO fcd-export file.

    A vehicle lives from `start` for as long as no time step misses it. The trace begins with the
    last time step at or before `start`, and ends where the first of the chosen vehicles does.
    Positions are SUMO's, of the front bumper, in the network's plane [m]; those of
    `--fcd-output.geo`, in degrees, are not for this. SUMO's angle (0 north, clockwise, degrees)
    becomes a yaw.

    Parameters
    ----------
    path : str or Path
        Plain or gzip, whatever its name.
    vehicles : int
        V, at least 1; of equally long-lived ones the first in the file are taken.
    start : float
        [s].
    duration : float
        Time from the start that all vehicles must live [s]; nothing after it is read. 0 for
        as long as it goes.
    elevation : bool
        Read z as well, so that D = 3.
    local_origin : bool
        Subtract the whole metres of the lowest x and y.

    Returns
    -------
    Trace

    Raises
    ------
    LogError
        If the file cannot be read or is not such a file, by file and line; if it holds too few
        vehicles in the wanted time; if coordinates are beyond 100 km and no local origin is
        asked for.

    """
    path = Path(path)
    steps = _TimeSteps(start, duration, elevation)
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = steps.refuse_doctype
    parser.StartElementHandler = steps.begin
    parser.EndElementHandler = steps.end
    taken = 0
    with reading(path, lambda: parser.CurrentLineNumber), opened(path) as stream:
        try:
            while not steps.complete:
                chunk = stream.read(_CHUNK)
                parser.Parse(chunk, not chunk)
                if not chunk:
                    break
                taken += len(chunk)
                # expat begins anew with what is not complete, at each chunk.
                if taken - parser.CurrentByteIndex > _LONGEST_ELEMENT:
                    raise Refused(f'has an element of more than {_LONGEST_ELEMENT} bytes')
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise LogError(f'{path}:{error.lineno}: is not well-formed XML: {reason}') from None
        except (LookupError, ValueError) as error:
            # Of Python's codecs, which any XML declaration may name.
            raise Refused(f'has an encoding that cannot be read, must be UTF-8: {error}') from None
    with reading(path):
        trace = steps.trace(vehicles)
    return place(trace, path, local_origin)


class _TimeSteps:
    """Gathers the vehicles that have been in every time step of the window so far."""

    def __init__(self, start: float, duration: float, elevation: bool) -> None:
        self._start = start
        self._end = start + duration if duration > 0 else math.inf
        self._axes = ('x', 'y', 'z') if elevation else ('x', 'y')
        self._path: list[str] = []
        self._first = math.inf
        self._last = -math.inf
        self._stamps: list[float] = []
        self._ways: dict[str, array[float]] = {}
        self.complete = False

    def refuse_doctype(self, name: str, *_: object) -> None:
        raise Refused(f'has a document type definition (<!DOCTYPE {name}>), refused: '
                      'fcd-export files have none')

    def begin(self, element: str, attributes: dict[str, str]) -> None:
        depth = len(self._path)
        self._path.append(element)
        if self.complete:
            return
        if depth == 0 and element != 'fcd-export':
            raise Refused(f'<{element}> is not the root of a SUMO trace, expected '
                          '<fcd-export>')
        if element == 'timestep':
            self._begin_step(_number(element, attributes, 'time'))
        elif element == 'vehicle':
            if depth == 0 or self._path[-2] != 'timestep':
                raise Refused('<vehicle> stands outside of a <timestep>')
            self._add(attributes)

    def end(self, element: str) -> None:
        self._path.pop()
        if element == 'timestep' and self._last >= self._end:
            self.complete = True

    def _begin_step(self, time: float) -> None:
        if time <= self._last:
            raise Refused(f'time {time:g} s does not come after {self._last:g} s, expected '
                          'time steps in order')
        self._first = min(self._first, time)
        self._last = time
        if time <= self._start:
            self._stamps.clear()
            self._ways.clear()
        self._stamps.append(time)

    def _add(self, attributes: dict[str, str]) -> None:
        name = attributes.get('id')
        if name is None:
            raise Refused('<vehicle> has no id')
        row = [_number('vehicle', attributes, key) for key in (*self._axes, 'angle')]
        if len(self._stamps) == 1:
            self._ways.setdefault(name, array('d'))
        way = self._ways.get(name)
        if way is None:
            return  # came too late
        missed = len(self._stamps) - 1 - len(way) // len(row)
        if missed < 0:
            raise Refused(f'vehicle {name!r} appears twice in the time step {self._last:g} s')
        if missed == 0:
            way.extend(row)

    def trace(self, vehicles: int) -> Trace:
        """Return the ways of the longest-lived vehicles, for as long as all of them live."""
        stamp = np.array(self._stamps)
        if not self._first <= self._start <= self._last:
            held = f'it lasts from {self._first:g} s to {self._last:g} s' if stamp.size \
                else 'it is empty'
            raise Refused(f'holds nothing at the wanted start, {self._start:g} s: {held}')
        width = len(self._axes) + 1
        lives = np.array([len(way) // width for way in self._ways.values()], np.intp)
        needed = max(2, int(np.searchsorted(stamp, self._end)) + 1 if self._end < math.inf else 0)
        refuse_few(int(np.sum(lives >= needed)), vehicles, self._start, self._end)
        # The longest-lived, put back into the order of the file.
        chosen = np.sort(np.argsort(-lives, kind='stable')[:vehicles])
        length = lives[chosen].min()
        names = list(self._ways)
        rows = np.stack([
            np.frombuffer(self._ways[names[index]]).reshape(-1, width)[:length]
            for index in chosen
        ], axis=1)
        return Trace(
            names=tuple(names[index] for index in chosen),
            stamp=stamp[:length],
            position=rows[..., :-1].copy(),
            yaw=wrap(np.radians(90.0 - rows[..., -1])),
        )


def _number(element: str, attributes: dict[str, str], key: str) -> float:
    text = attributes.get(key)
    if text is None:
        raise Refused(f'<{element}> has no {key}, expected a number')
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise Refused(f'{key}={text!r} of <{element}> is not a finite number')
    return value
