"""Reading of ns-2 movement files, as ns-2's setdest, BonnMotion and SUMO's tools write them."""

from __future__ import annotations

import math
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np
from tsmcl_ros.model.mobility import Trace
from tsmcl_ros.traces.files import LARGEST, Lines, meet, number, place, reading, Refused, Way
from tsmcl_ros.types import Array

_SET = re.compile(r'\$node_\((\d{1,9})\) set ([XYZ])_ (\S+?)\s*;?')
_SETDEST = re.compile(r'\$ns_? at (\S+) "\$node_\((\d{1,9})\) setdest ((?:\S+ ){2,3})(\S+?)"\s*;?')
_GOD = re.compile(r'(\$ns_? at \S+ ")?\$god_ .*')  # distances in hops, for ns-2 alone


class _Order(NamedTuple):
    """From a time on [s], go to a place (3,) [m] at a speed [m/s]."""

    stamp: float
    target: Array
    speed: float


def read_ns2(
    path: str | Path,
    vehicles: int,
    start: float = 0.0,
    duration: float = 0.0,
    *,
    elevation: bool = False,
    local_origin: bool = False,
) -> Trace:
    """
    Read the ways of the first nodes of an ns-2 movement file.

    Understood are the statements `$node_(0) set X_ 1.0` (Y_, Z_) and
    `$ns_ at 2.0 "$node_(0) setdest 30.0 40.0 5.0"`, in 3-D with a z before the speed; those of
    `$god_` are passed over. From its time on a node goes straight to the destination at the
    speed, until it is there, where it stands, or sent elsewhere. All nodes are there from 0 s
    until the last of them has arrived.

    Parameters
    ----------
    path : str or Path
        Plain or gzip, whatever its name.
    vehicles, start, duration
        See `tsmcl_ros.traces.files.meet`.
    elevation : bool
        Keep the height z of the nodes, so that D = 3.
    local_origin : bool
        Subtract the whole metres of the lowest x and y.

    Returns
    -------
    Trace
        Whose names are the numbers of the nodes.

    Raises
    ------
    LogError
        If the file cannot be read or has another statement, by file and line; if it holds too
        few nodes in the wanted time; if coordinates are beyond 100 km and no local origin is
        asked for.

    """
    path = Path(path)
    begins: dict[int, Array] = {}
    orders: dict[int, list[_Order]] = {}
    lines = Lines(path)
    for text in lines:
        with reading(path, lambda: lines.number):
            _read(' '.join(text.split()), begins, orders)
    with reading(path):
        for node, begin in begins.items():
            _complete(node, begin, orders.get(node, []))
        ways = [_way(begins[node], orders.get(node, [])) for node in sorted(begins)]
        end = max((way[-1][0] for way in ways), default=0.0)
        # Who has arrived stands until the end.
        ways = [way if way[-1][0] == end else [*way, (end, way[-1][1])] for way in ways]
        trace = meet([
            Way(str(node), np.array([stamp for stamp, _ in way]),
                np.array([point for _, point in way])[:, :3 if elevation else 2])
            for node, way in zip(sorted(begins), ways, strict=True)
        ], vehicles, start, duration)
    return place(trace, path, local_origin)


def _read(text: str, begins: dict[int, Array], orders: dict[int, list[_Order]]) -> None:
    """Take in one statement."""
    if found := _SET.fullmatch(text):
        node, axis, value = found.groups()
        begin = begins.setdefault(int(node), np.full(3, math.nan))
        begin['XYZ'.index(axis)] = number(value)
    elif found := _SETDEST.fullmatch(text):
        stamp, node, target, speed = found.groups()
        wanted = [number(word) for word in target.split()]
        order = _Order(number(stamp), np.array([*wanted, math.nan][:3]), number(speed))
        given = orders.setdefault(int(node), [])
        if order.stamp < (given[-1].stamp if given else 0):
            raise Refused(f'time {order.stamp:g} s of $node_({node}) does not come after '
                          f'{given[-1].stamp if given else 0:g} s')
        if order.speed < 0:
            raise Refused(f'speed {order.speed:g} m/s is not allowed, must be at least 0')
        begins.setdefault(int(node), np.full(3, math.nan))
        given.append(order)
    elif not _GOD.fullmatch(text):
        raise Refused(f'{text!r} is not understood, expected "$node_(N) set X_ NUMBER" or '
                      '"$ns_ at TIME \\"$node_(N) setdest X Y SPEED\\""')


def _complete(node: int, begin: Array, orders: list[_Order]) -> None:
    """Set the height where a node begins (3,) [m] to 0 if it has none; refuse to lack more."""
    if np.isnan(begin[:2]).any():
        raise Refused(f'$node_({node}) has no place to begin, expected "set X_" and "set Y_"')
    if np.isnan(begin[2]):
        if not all(np.isnan(order.target[2]) for order in orders):
            raise Refused(f'$node_({node}) is sent to "x y z" but has no height to begin at, '
                          'expected "set Z_"')
        begin[2] = 0.0


def _way(begin: Array, orders: list[_Order]) -> list[tuple[float, Array]]:
    """Return the waypoints, a stamp [s] and a place (3,) [m] each, that follow from orders."""
    way = [(0.0, begin)]
    ends = [*(order.stamp for order in orders[1:]), math.inf]
    for order, end in zip(orders, ends, strict=False):
        here = way[-1][1]
        if order.stamp > way[-1][0]:
            way.append((order.stamp, here))
        target = np.where(np.isnan(order.target), here, order.target)
        distance = float(np.linalg.norm(target - here))
        if distance == 0 or order.speed == 0:
            continue
        arrival = order.stamp + distance / order.speed
        if min(arrival, end) > LARGEST:
            raise Refused(f'who goes {distance:g} m at {order.speed:g} m/s arrives after '
                          f'{LARGEST:g} s')
        if arrival <= end:
            way.append((arrival, target))
        elif end > order.stamp:
            share = (end - order.stamp) / (arrival - order.stamp)
            way.append((end, here + share * (target - here)))
    return way
