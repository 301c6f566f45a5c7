"""Vehicles that drive straight legs, each at one speed, from waypoint to waypoint."""

from __future__ import annotations

from abc import ABC, abstractmethod
import math

import numpy as np
from tsmcl_ros.model.mobility.base import Draws, require_elapsed, State
from tsmcl_ros.types import Array


class Legs(ABC):
    """
    V vehicles in D dimensions on straight legs; subclasses say where these lead.

    The way that a seed gives does not depend on how its time is cut into steps.

    Parameters
    ----------
    vehicles, dimension : int
        V, D.
    rng : numpy.random.Generator
        This object's own; sharing it with others would make the way depend on the steps.
    width : int
        How many random numbers a leg takes.
    pause : float
        Time that a vehicle stands at each waypoint [s].

    """

    duration = math.inf

    def __init__(
        self, vehicles: int, dimension: int, rng: np.random.Generator, width: int,
        pause: float = 0.0,
    ) -> None:
        self._draws = Draws(rng, vehicles, width)
        self._pause = pause
        self._position = np.empty((vehicles, dimension))
        self._target = np.empty_like(self._position)
        self._heading = np.empty_like(self._position)
        self._speed = np.empty(vehicles)
        self._standing = np.zeros(vehicles)
        self._yaw = np.zeros(vehicles)
        self._start(rng)
        self.state = self._snapshot()

    @abstractmethod
    def _start(self, rng: np.random.Generator) -> None:
        """Put all vehicles on their first leg."""

    @abstractmethod
    def _choose(self, rows: Array, drawn: Array) -> None:
        """Give vehicles (n,) at a waypoint their next target and speed, by draws (n, width)."""

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
        require_elapsed(elapsed)
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
            self._standing[rows] = self._pause
            self._next_leg(rows)
        self.state = self._snapshot()
        return self.state

    def _next_leg(self, rows: Array) -> None:
        """Put these vehicles, which are at their waypoint, on their next leg."""
        self._choose(rows, self._draws.take(rows))
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

    def _snapshot(self) -> State:
        drives = self._standing == 0
        velocity = self._heading * np.where(drives, self._speed, 0.0)[:, None]
        return State(self._position.copy(), velocity, self._yaw.copy())
