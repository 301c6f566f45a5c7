"""What the models of mobility have in common."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Protocol

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.types import Array, ConfigError


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
class AreaConfig(Config):
    """Where, and how fast, vehicles go that follow no trace."""

    area_x: float = param(4000.0, 'extent of the area along x, from 0', unit='m', above=0,
                          high=1e5)
    area_y: float = param(4000.0, 'extent of the area along y, from 0', unit='m', above=0,
                          high=1e5)
    min_speed: float = param(5.0, 'speed of the slowest leg', unit='m/s', above=0, high=1e4)
    max_speed: float = param(50.0, 'speed of the fastest leg', unit='m/s', above=0, high=1e4)

    def check(self) -> None:
        """Refuse a slowest leg that is faster than the fastest."""
        if self.min_speed > self.max_speed:
            raise ConfigError(
                f'min_speed: {self.min_speed!r} is not allowed, must be at most max_speed, '
                f'{self.max_speed:g} m/s'
            )


class Draws:
    """
    Random numbers of the V vehicles, a row for each of a vehicle's legs.

    What a vehicle draws depends neither on how far the others are nor on how time is cut into
    steps.

    Parameters
    ----------
    rng : numpy.random.Generator
        Nobody else's from the first draw on.
    vehicles : int
        V.
    width : int
        Numbers of a row.

    """

    def __init__(self, rng: np.random.Generator, vehicles: int, width: int) -> None:
        self._rng = rng
        self._rows = np.empty((0, vehicles, width))
        self._dropped = 0
        self._next = np.zeros(vehicles, np.intp)

    def take(self, vehicles: Array) -> Array:
        """Return the next rows (n, width) of n different vehicles, uniform in [0, 1)."""
        while self._next[vehicles].max(initial=0) - self._dropped >= len(self._rows):
            done = int(self._next.min()) - self._dropped
            self._dropped += done
            drawn = self._rng.random((1, *self._rows.shape[1:]))
            self._rows = np.concatenate([self._rows[done:], drawn])
        drawn = self._rows[self._next[vehicles] - self._dropped, vehicles]
        self._next[vehicles] += 1
        return drawn


def wrap(angle: Array) -> Array:
    """Return angles of any shape brought into (-pi, pi] [rad]."""
    return np.asarray(math.pi - np.mod(math.pi - angle, 2 * math.pi))


def steady_speed(low: float, high: float, share: Array) -> Array:
    """
    Return speeds [m/s] by shares in [0, 1), as vehicles are met that draw uniform ones for ways.

    A way is under way for a time in proportion to 1/v, and so is the density of its speed.
    """
    return np.asarray(low * (high / low) ** share)


def require_elapsed(elapsed: float) -> None:
    """Raise ConfigError unless the time [s] is one that can elapse."""
    if not 0 <= elapsed < math.inf:
        raise ConfigError(
            f'elapsed time: {elapsed!r} is not allowed, must be a number at least 0 s'
        )
