"""
How vehicles move: random waypoint in a rectangle or a box, and the replay of a recorded trace.

A mobility object holds where its V vehicles are and steps them through time, all at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
import math
from typing import Protocol

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.types import Array, ConfigError, LogError


@dataclass(frozen=True, eq=False)
class State:
    """
    Where V vehicles are, and how they move, at one instant.

    Attributes
    ----------
    position, velocity : (V, D) float64
        [m], [m/s].
    yaw : (V,) float64
        Direction of travel in the plane, east 0, north pi/2 [rad]; a standing vehicle keeps its.
    """

    position: Array
    velocity: Array
    yaw: Array


class Mobility(Protocol):
    """What every mobility offers to the world."""

    state: State
    duration: float

    def step(self, elapsed: float) -> State:
        """Move all vehicles on by the elapsed time [s] and return their new state."""


@dataclass(frozen=True)
class RandomWaypointConfig(Config):
    """Parameters of `RandomWaypoint`."""

    area_x: float = param(4000.0, 'extent of the area along x, from 0', unit='m', above=0,
                          high=1e5)
    area_y: float = param(4000.0, 'extent of the area along y, from 0', unit='m', above=0,
                          high=1e5)
    area_z: float = param(0.0, 'height of the area, from 0; 0 keeps the vehicles in the plane',
                          unit='m', low=0, high=1e5)
    min_speed: float = param(5.0, 'speed of the slowest leg', unit='m/s', above=0, high=1e4)
    max_speed: float = param(50.0, 'speed of the fastest leg', unit='m/s', above=0, high=1e4)
    pause: float = param(0.0, 'time that a vehicle stands at each waypoint', unit='s', low=0,
                         high=1e5)
    start_distribution: str = param(
        'steady', 'vehicles start as if long under way, or all at the beginning of a leg',
        choices=('steady', 'uniform'),
    )

    def check(self) -> None:
        """Refuse a slowest leg that is faster than the fastest."""
        if self.min_speed > self.max_speed:
            raise ConfigError(
                f'min_speed: {self.min_speed!r} is not allowed, must be at most max_speed, '
                f'{self.max_speed:g} m/s'
            )

    @property
    def size(self) -> Array:
        """(D,) extent of the area [m]."""
        return np.array([self.area_x, self.area_y, self.area_z][:3 if self.area_z else 2])


class RandomWaypoint:
    """
    Vehicles that drive straight to a random point, pause, and go on to the next.

    Waypoints are uniform in the area, the speed of a leg is uniform between the two speeds. The
    `steady` start draws from the model's time-stationary distribution, so that statistics do not
    drift during a run; with `uniform` the fleet slows down and gathers in the middle for its
    first several legs (Le Boudec and Vojnovic, Perfect Simulation and Stationarity of a Class of
    Mobility Models, 2005). That distribution needs a lowest speed above zero.

    The way that a seed gives does not depend on how its time is cut into steps.

    Parameters
    ----------
    config : RandomWaypointConfig
    vehicles : int
        V.
    rng : numpy.random.Generator
        This object's own; sharing it with others would make the way depend on the steps.
    """

    duration = math.inf

    def __init__(
        self, config: RandomWaypointConfig, vehicles: int, rng: np.random.Generator
    ) -> None:
        self._config = config
        self._size = config.size
        self._rng = rng
        self._legs = np.empty((0, vehicles, self._size.size + 1))
        self._legs_dropped = 0
        self._leg = np.zeros(vehicles, np.intp)
        everyone = np.arange(vehicles)
        self._position = np.empty((vehicles, self._size.size))
        self._target = np.empty_like(self._position)
        self._heading = np.empty_like(self._position)
        self._speed = np.empty(vehicles)
        self._standing = np.zeros(vehicles)
        self._yaw = np.zeros(vehicles)
        if config.start_distribution == 'steady':
            self._start_steady(everyone)
        else:
            self._position[:] = rng.random(self._position.shape) * self._size
            self._next_leg(everyone)
            self._face(everyone)
        self.state = self._snapshot()

    def step(self, elapsed: float) -> State:
        """
        Move all vehicles on by the elapsed time, through as many waypoints as it takes.

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
        """
        _require_elapsed(elapsed)
        rows = np.arange(self._speed.size)
        left = np.full(rows.size, float(elapsed))
        while rows.size:
            rest = np.minimum(self._standing[rows], left)
            self._standing[rows] -= rest
            left -= rest
            self._face(rows[self._standing[rows] == 0])
            way = np.linalg.norm(self._target[rows] - self._position[rows], axis=1)
            speed = self._speed[rows]
            arrives = way <= speed * left
            self._position[rows] = np.where(
                arrives[:, None],
                self._target[rows],
                self._position[rows] + self._heading[rows] * (speed * left)[:, None],
            )
            left = (left - way / speed)[arrives]
            rows = rows[arrives]
            self._standing[rows] = self._config.pause
            self._next_leg(rows)
        self.state = self._snapshot()
        return self.state

    def _snapshot(self) -> State:
        drives = self._standing == 0
        velocity = self._heading * np.where(drives, self._speed, 0.0)[:, None]
        return State(self._position.copy(), velocity, self._yaw.copy())

    def _next_leg(self, rows: Array) -> None:
        """Give these vehicles their next waypoint and the speed at which they go there."""
        if not rows.size:
            return
        while self._leg[rows].max() - self._legs_dropped >= len(self._legs):
            done = int(self._leg.min()) - self._legs_dropped
            self._legs_dropped += done
            drawn = self._rng.random((1, *self._legs.shape[1:]))
            self._legs = np.concatenate([self._legs[done:], drawn])
        drawn = self._legs[self._leg[rows] - self._legs_dropped, rows]
        self._leg[rows] += 1
        low, high = self._config.min_speed, self._config.max_speed
        self._target[rows] = drawn[:, :-1] * self._size
        self._speed[rows] = low + (high - low) * drawn[:, -1]
        self._aim(rows)

    def _aim(self, rows: Array) -> None:
        """Head these vehicles for their waypoint."""
        way = self._target[rows] - self._position[rows]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        self._heading[rows] = np.divide(way, length, out=np.zeros_like(way), where=length > 0)

    def _face(self, rows: Array) -> None:
        """Turn these vehicles, which set off, to where they head; upright ways have no yaw."""
        rows = rows[np.any(self._heading[rows, :2] != 0, axis=1)]
        self._yaw[rows] = np.arctan2(self._heading[rows, 1], self._heading[rows, 0])

    def _start_steady(self, rows: Array) -> None:
        """
        Draw from the stationary distribution.

        A vehicle is met standing in proportion to the time it stands, and then at a waypoint; a
        driving one is met on a leg in proportion to the leg's length, anywhere on it, and at a
        speed in proportion to the time that it takes, 1/v.
        """
        rng, config = self._rng, self._config
        low, high = config.min_speed, config.max_speed
        mean_drive = _mean_leg(self._size) * _mean_inverse(low, high)
        stands = rng.random(rows.size) < config.pause / (config.pause + mean_drive)
        origin = np.empty_like(self._position)
        pending = rows
        while pending.size:
            ends = rng.random((2, pending.size, self._size.size)) * self._size
            origin[pending], self._target[pending] = ends
            length = np.linalg.norm(ends[1] - ends[0], axis=1)
            longest = np.linalg.norm(self._size)
            taken = stands[pending] | (rng.random(pending.size) * longest < length)
            pending = pending[~taken]
        self._position[:] = origin
        self._aim(rows)
        self._face(rows)
        done = np.where(stands, 1.0, rng.random(rows.size))[:, None]
        self._position[:] = origin + done * (self._target - origin)
        self._speed[:] = low * (high / low) ** rng.random(rows.size)
        self._standing[stands] = config.pause * (1.0 - rng.random(np.count_nonzero(stands)))
        self._next_leg(rows[stands])


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
    yaw : (T, V) float64
        [rad].
    """

    names: tuple[str, ...]
    stamp: Array
    position: Array
    yaw: Array


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
        self._yaw = np.unwrap(trace.yaw, axis=0)
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
        _require_elapsed(elapsed)
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
        turn = self._yaw[after] - self._yaw[after - 1]
        return State(
            position=position[after - 1] + share * way,
            velocity=way / span,
            yaw=wrap(self._yaw[after - 1] + share * turn),
        )


def wrap(angle: Array) -> Array:
    """Return angles of any shape brought into (-pi, pi] [rad]."""
    return np.asarray(math.pi - np.mod(math.pi - angle, 2 * math.pi))


def _require_elapsed(elapsed: float) -> None:
    if not 0 <= elapsed < math.inf:
        raise ConfigError(
            f'elapsed time: {elapsed!r} is not allowed, must be a number at least 0 s'
        )


def _mean_leg(size: Array) -> float:
    """Return the mean distance of two uniform points in a box of (D,) size [m]."""
    node, weight = np.polynomial.legendre.leggauss(64)
    node = (node + 1) / 2
    # Two uniform points on a unit line are u apart with density 2 (1 - u).
    squared = reduce(np.add.outer, [(side * node) ** 2 for side in size])
    density = reduce(np.multiply.outer, [weight * (1 - node)] * len(size))
    return float(np.sum(density * np.sqrt(squared)))


def _mean_inverse(low: float, high: float) -> float:
    """Return the mean of 1/v for v uniform in [low, high] [s/m]."""
    return math.log(high / low) / (high - low) if high > low else 1 / low
