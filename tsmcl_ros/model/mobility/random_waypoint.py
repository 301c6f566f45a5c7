"""Random waypoint in a rectangle or a box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
import math

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.mobility.base import AreaConfig, steady_speed
from tsmcl_ros.model.mobility.legs import Legs
from tsmcl_ros.types import Array


@dataclass(frozen=True)
class RandomWaypointConfig(AreaConfig):
    """Parameters of `RandomWaypoint`."""

    area_z: float = param(0.0, 'height of the area, from 0; 0 keeps the vehicles in the plane',
                          unit='m', low=0, high=1e5)
    pause: float = param(0.0, 'time that a vehicle stands at each waypoint', unit='s', low=0,
                         high=1e5)
    start_distribution: str = param(
        'steady', 'vehicles start as if long under way, or all at the beginning of a leg',
        choices=('steady', 'uniform'),
    )

    @property
    def size(self) -> Array:
        """(D,) extent of the area [m]."""
        return np.array([self.area_x, self.area_y, self.area_z][:3 if self.area_z else 2])


class RandomWaypoint(Legs):
    """
    Vehicles that drive straight to a random point, pause, and go on to the next.

    Waypoints are uniform in the area, the speed of a leg is uniform between the two speeds. The
    `steady` start draws from the model's time-stationary distribution, so that statistics do not
    drift during a run; with `uniform` the fleet slows down and gathers in the middle for its
    first several legs (Le Boudec and Vojnovic, Perfect Simulation and Stationarity of a Class of
    Mobility Models, 2005). That distribution needs a lowest speed above zero.

    Parameters
    ----------
    config : RandomWaypointConfig
    vehicles : int
        V.
    rng : numpy.random.Generator
        This object's own.

    """

    def __init__(
        self, config: RandomWaypointConfig, vehicles: int, rng: np.random.Generator
    ) -> None:
        self._config = config
        self._size = config.size
        super().__init__(vehicles, self._size.size, rng, self._size.size + 1, config.pause)

    def _choose(self, rows: Array, drawn: Array) -> None:
        low, high = self._config.min_speed, self._config.max_speed
        self._target[rows] = drawn[:, :-1] * self._size
        self._speed[rows] = low + (high - low) * drawn[:, -1]

    def _start(self, rng: np.random.Generator) -> None:
        everyone = np.arange(self._speed.size)
        if self._config.start_distribution == 'steady':
            self._start_steady(everyone, rng)
        else:
            self._position[:] = rng.random(self._position.shape) * self._size
            self._next_leg(everyone)
            self._face(everyone)

    def _start_steady(self, rows: Array, rng: np.random.Generator) -> None:
        """
        Draw from the stationary distribution.

        A vehicle is met standing in proportion to the time it stands, and then at a waypoint; a
        driving one is met on a leg in proportion to the leg's length, anywhere on it, and at a
        speed in proportion to the time that it takes, 1/v.
        """
        config = self._config
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
        self._speed[:] = steady_speed(low, high, rng.random(rows.size))
        self._standing[stands] = config.pause * (1.0 - rng.random(np.count_nonzero(stands)))
        self._next_leg(rows[stands])


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
