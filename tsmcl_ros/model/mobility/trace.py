"""The replay of recorded ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.mobility.base import require_elapsed, State, wrap
from tsmcl_ros.types import Array, LogError


@dataclass(frozen=True, eq=False)
class Trace:
    """
    Recorded ways of V vehicles that are all there at every one of T instants.

    Attributes
    ----------
    names : tuple of str
        The vehicles' names in the recording, V of them.
    stamp : (T,) float64
        Strictly increasing, at least two [s].
    position : (T, V, D) float64
        [m].
    yaw : (T, V) float64 or None
        [rad]. None if they face where they drive.

    """

    names: tuple[str, ...]
    stamp: Array
    position: Array
    yaw: Array | None


class Replay:
    """
    Vehicles that repeat a trace, at constant velocity from each of its instants to the next.

    Parameters
    ----------
    trace : Trace
    start : float or None
        Where in the trace to begin [s]; by default at its first instant.

    Attributes
    ----------
    names : tuple of str
        The vehicles' names in the recording.
    duration : float
        Time from the beginning to the end of the trace [s].

    """

    def __init__(self, trace: Trace, start: float | None = None) -> None:
        self.names = trace.names
        self._trace = trace
        if trace.yaw is None:
            self._yaw = _headings(np.diff(trace.position, axis=0))
            self._turn = np.zeros_like(self._yaw)
        else:
            self._yaw = np.unwrap(trace.yaw, axis=0)
            self._turn = np.diff(self._yaw, axis=0)
        self._now = float(trace.stamp[0]) if start is None else start
        self.duration = float(trace.stamp[-1]) - self._now
        self.state = self._at(self._now)

    def step(self, elapsed: float) -> State:
        """
        Move all vehicles on by the elapsed time.

        Parameters
        ----------
        elapsed : float
            [s], at least 0.

        Returns
        -------
        State

        Raises
        ------
        ConfigError
            If the elapsed time is negative or not finite.
        LogError
            If the trace ends before.

        """
        require_elapsed(elapsed)
        self.state = self._at(self._now + elapsed)
        self._now += elapsed
        return self.state

    def _at(self, time: float) -> State:
        stamp, position = self._trace.stamp, self._trace.position
        # Time is a sum of steps: the end may be passed by the rounding of that sum.
        if not stamp[0] - 1e-6 <= time <= stamp[-1] + 1e-6:
            raise LogError(
                f'mobility trace: {time:g} s is not in it, it lasts from {stamp[0]:g} s to '
                f'{stamp[-1]:g} s'
            )
        after = int(np.clip(np.searchsorted(stamp, time, 'right'), 1, stamp.size - 1))
        span = stamp[after] - stamp[after - 1]
        share = np.clip((time - stamp[after - 1]) / span, 0.0, 1.0)
        way = position[after] - position[after - 1]
        return State(
            position=position[after - 1] + share * way,
            velocity=way / span,
            yaw=wrap(self._yaw[after - 1] + share * self._turn[after - 1]),
        )


def _headings(way: Array) -> Array:
    """Return where ways (T, V, D) lead to [rad]; a standing vehicle keeps its yaw, or has 0."""
    moves = np.any(way[..., :2] != 0, axis=2)
    last = np.maximum.accumulate(np.where(moves, np.arange(len(way))[:, None], 0))
    heading = np.arctan2(way[..., 1], way[..., 0])
    return np.asarray(np.take_along_axis(heading, last, axis=0))
