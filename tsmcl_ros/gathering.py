"""
Single measurements, gathered into epochs by their stamps.

Radio drivers publish one range after the other, each pair of radios on a topic of its own, and
logs hold one beacon after the other. A method wants them together: what was measured within a
short time makes an epoch. Which measurements that are depends on their stamps alone, and so does
when an epoch is complete: once all topics have passed its end, or `max_wait` after its begin.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
import math

import numpy as np
from tsmcl_ros.types import ANCHOR, Array, MessageError, Observation, VEHICLE

_MEMORY = 10.0  # s, for how long the poses of a reference are kept


def period_number(stamp: Array | float, period: float) -> Array:
    """Return in which period [s] since 0 each stamp [s] lies, as whole float64."""
    # A stamp written in decimals may fall a rounding short of the period that it begins.
    return np.asarray(np.floor(np.asarray(stamp) / period + 1e-9))


def gather(rows: Observation) -> Observation:
    """
    Return one row a sender of what one radio heard (V = 1), in order of time, with one row each.

    Of a sender that was heard several times the rssi is averaged, as its noise is symmetric in
    dB, and the last range is taken, with where the sender was then, as they moved since.
    """
    identity, which = np.unique(rows.sender[0], return_inverse=True)
    last = np.zeros(len(identity), int)
    number = np.arange(len(which))
    last[which] = number
    ranged = ~np.isnan(rows.range[0])
    last[which[ranged]] = number[ranged]
    scan = rows.columns(last)
    known = ~np.isnan(rows.rssi[0])
    count = np.bincount(which[known], minlength=len(identity))
    total = np.bincount(which[known], rows.rssi[0, known], len(identity))
    scan.rssi[0, count > 0] = total[count > 0] / count[count > 0]
    return scan


@dataclass(frozen=True, order=True)
class Reading:
    """A range [m] to a sender, when it was measured [s], and its std [m], NaN if not told."""

    stamp: float
    sender: int
    range: float
    std: float


@dataclass(eq=False)
class Track:
    """
    Where a reference has been lately.

    Attributes
    ----------
    stamp : list of float
        Increasing [s].
    pose : list of ((3,), (3, 3))
        Position [m] and its covariance [m^2].

    """

    stamp: list[float] = field(default_factory=list)
    pose: list[tuple[Array, Array]] = field(default_factory=list)

    @property
    def latest(self) -> float:
        """Stamp of the last pose [s], -inf without any."""
        return self.stamp[-1] if self.stamp else -math.inf

    def add(self, stamp: float, position: Array, covariance: Array) -> None:
        """Append a pose, and forget what is of no use any more."""
        self.stamp.append(stamp)
        self.pose.append((position, covariance))
        old = bisect_left(self.stamp, stamp - _MEMORY)
        del self.stamp[:old], self.pose[:old]

    def gap(self, stamp: float) -> float:
        """Return how far the nearest pose is from a stamp [s], inf if none was before it."""
        after = bisect_left(self.stamp, stamp)
        near = self.stamp[max(after - 1, 0):after + 1]
        if not near or near[0] > stamp:
            return math.inf
        return min(abs(stamp - one) for one in near)

    def at(self, stamp: float) -> tuple[Array, Array]:
        """Return position and covariance at a stamp [s], interpolated; the last one after it."""
        after = bisect_left(self.stamp, stamp)
        if after == len(self.stamp) or self.stamp[after] == stamp:
            return self.pose[min(after, len(self.stamp) - 1)]
        low, high = self.stamp[after - 1], self.stamp[after]
        share = (stamp - low) / (high - low)
        (start, uncertain), (end, other) = self.pose[after - 1:after + 1]
        return (1 - share) * start + share * end, (1 - share) * uncertain + share * other


class Gatherer:
    """
    Gathers the ranges of V vehicles, from many topics, into epochs.

    Parameters
    ----------
    vehicles : int
        V.
    period : float
        Length of an epoch [s].
    max_age : float
        How far from a range a reference's pose may be in time [s].

    Attributes
    ----------
    anchors : dict of int to (3,)
        Positions of the anchors [m].
    references : dict of int to Track
        Where the moving references have been.
    unplaced : Counter of int
        How many ranges of each sender were left out, as nobody tells where it is or was.

    """

    def __init__(self, vehicles: int, period: float, max_age: float) -> None:
        self._period, self._max_age = period, max_age
        self.anchors: dict[int, Array] = {}
        self.references: dict[int, Track] = {}
        # The stamp of the last range of each topic, by vehicle, and of each sender on it [s].
        self._passed: list[dict[str, float]] = [{} for _ in range(vehicles)]
        self._last: dict[tuple[int, str, int], float] = {}
        self.unplaced: Counter[int] = Counter()
        self._pending: dict[int, dict[float, list[Reading]]] = {}

    def reset(self) -> None:
        """Forget all ranges and poses; topics, references and anchors stay."""
        self._pending.clear()
        self._passed = [dict.fromkeys(topics, -math.inf) for topics in self._passed]
        self._last.clear()
        self.references = {sender: Track() for sender in self.references}

    def expect(self, vehicle: int, topic: str) -> None:
        """Let epochs wait for a vehicle's topic."""
        self._passed[vehicle].setdefault(topic, -math.inf)

    def last(self, vehicle: int, topic: str, sender: int) -> float:
        """Return the stamp of the last range to a sender on a topic [s], -inf without any."""
        return self._last.get((vehicle, topic, sender), -math.inf)

    def add(self, vehicle: int, topic: str, reading: Reading) -> None:
        """Take in one reading of a topic; a range of NaN says only that time has passed."""
        self._last[vehicle, topic, reading.sender] = reading.stamp
        passed = self._passed[vehicle]
        passed[topic] = max(passed.get(topic, -math.inf), reading.stamp)
        if not math.isnan(reading.range):
            number = float(period_number(reading.stamp, self._period))
            self._pending.setdefault(vehicle, {}).setdefault(number, []).append(reading)

    def move(self, sender: int, stamp: float, position: Array, covariance: Array) -> None:
        """
        Take in where a reference is: position (3,) [m] and its covariance (3, 3) [m^2].

        Raises
        ------
        MessageError
            If it comes too late.

        """
        track = self.references.setdefault(sender, Track())
        if stamp < track.latest - _MEMORY:  # a looped bag
            track = self.references[sender] = Track()
        if stamp <= track.latest:
            raise MessageError(
                f'reference {sender}: stamp {stamp:.6f} s is not allowed, must be after the last '
                f'one, {track.latest:.6f} s')
        track.add(stamp, position, covariance)

    def due(self, now: float, max_wait: float) -> Iterator[tuple[int, Observation]]:
        """
        Yield the vehicle and what it heard (V = 1, D = 3), of each epoch that is complete.

        Parameters
        ----------
        now : float
            Time [s]; at infinity all epochs are complete.
        max_wait : float
            How long after its begin an epoch waits for topics that lag or are silent [s].

        """
        moved = min((track.latest for track in self.references.values()), default=math.inf)
        for vehicle, pending in self._pending.items():
            passed = min(moved, min(self._passed[vehicle].values()))
            for number in sorted(pending):
                begin = number * self._period
                if passed < begin + self._period and now < begin + max_wait:
                    break
                rows = [row for row in sorted(pending.pop(number)) if self._is_placed(row)]
                if rows:
                    yield vehicle, gather(self._rows(rows))

    def _is_placed(self, reading: Reading) -> bool:
        """Tell whether it is known where a sender was, counting those of which it is not."""
        known = reading.sender in self.anchors or (
            reading.sender in self.references
            and self.references[reading.sender].gap(reading.stamp) <= self._max_age)
        if not known:
            self.unplaced[reading.sender] += 1
        return known

    def _rows(self, readings: list[Reading]) -> Observation:
        """Return one row a reading."""
        rows = Observation.empty(1, len(readings), 3, readings[-1].stamp)
        for row, reading in enumerate(readings):
            rows.sender[0, row] = reading.sender
            rows.range[0, row], rows.range_std[0, row] = reading.range, reading.std
            if reading.sender in self.references:
                rows.kind[0, row] = VEHICLE
                rows.position[0, row], rows.covariance[0, row] = (
                    self.references[reading.sender].at(reading.stamp))
            else:
                rows.kind[0, row] = ANCHOR
                rows.position[0, row] = self.anchors[reading.sender]
        return rows
