"""Reading of BonnMotion's movements: a line a node, of the waypoints `t x y` or `t x y z`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tsmcl_ros.model.mobility import Trace
from tsmcl_ros.traces.files import Lines, meet, number, place, reading, Refused, Way


def read_bonnmotion(
    path: str | Path,
    vehicles: int,
    start: float = 0.0,
    duration: float = 0.0,
    *,
    elevation: bool = False,
    local_origin: bool = False,
) -> Trace:
    """
    Read the ways of the longest-lived nodes of a BonnMotion scenario, `NAME.movements.gz`.

    A node is there from its first waypoint to its last, and goes straight between them at
    constant speed. Lines of comments begin with #.

    Parameters
    ----------
    path : str or Path
        Plain or gzip, whatever its name.
    vehicles, start, duration
        See `tsmcl_ros.traces.files.meet`.
    elevation : bool
        The waypoints are `t x y z`, D = 3.
    local_origin : bool
        Subtract the whole metres of the lowest x and y.

    Returns
    -------
    Trace
        Whose names are the numbers of the nodes, from 0.

    Raises
    ------
    LogError
        If the file cannot be read or is not such a file, by file and line; if it holds too few
        nodes in the wanted time; if coordinates are beyond 100 km and no local origin is asked
        for.

    """
    path = Path(path)
    fields = 't x y z'.split()[:4 if elevation else 3]
    lines = Lines(path)
    ways: list[Way] = []
    for text in lines:
        with reading(path, lambda: lines.number):
            ways.append(_way(str(len(ways)), text.split(), fields))
    with reading(path):
        trace = meet(ways, vehicles, start, duration)
    return place(trace, path, local_origin)


def _way(name: str, words: list[str], fields: list[str]) -> Way:
    """Return the way that a line's words stand for."""
    other = '"t x y" (trace_elevation: false)' if len(fields) == 4 else \
        '"t x y z" (trace_elevation: true)'
    hint = f'expected waypoints of "{" ".join(fields)}"; if they are of {other}, say so'
    if len(words) % len(fields):
        raise Refused(f'has {len(words)} numbers, {hint}')
    row = np.fromiter(map(number, words), float, len(words)).reshape(-1, len(fields))
    late = np.diff(row[:, 0]) <= 0
    if late.any():
        before, time = row[late.argmax():, 0][:2]
        raise Refused(f'time {time:g} s does not come after {before:g} s, {hint}')
    return Way(name, row[:, 0], row[:, 1:])
