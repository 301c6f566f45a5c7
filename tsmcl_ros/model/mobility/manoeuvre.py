"""Vehicles that manoeuvre: constant velocity, coordinated turns, accelerations."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.mobility.base import AreaConfig, Draws, require_elapsed, State, wrap
from tsmcl_ros.types import Array, ConfigError


@dataclass(frozen=True)
class ManoeuvreConfig(AreaConfig):
    """Parameters of `Manoeuvre`."""

    min_segment: float = param(5.0, 'shortest time of one manoeuvre', unit='s', above=0, high=1e5)
    max_segment: float = param(30.0, 'longest time of one manoeuvre', unit='s', above=0, high=1e5)
    max_turn_rate: float = param(0.1, 'fastest turn, to either side', unit='rad/s', low=0,
                                 high=100)
    max_acceleration: float = param(1.0, 'strongest acceleration and braking', unit='m/s^2',
                                    low=0, high=1e4)
    turn_share: float = param(0.5, 'share of manoeuvres that turn', low=0, high=1)
    acceleration_share: float = param(0.5, 'share of manoeuvres that change the speed', low=0,
                                      high=1)

    def check(self) -> None:
        """Refuse a shortest manoeuvre that is longer than the longest."""
        super().check()
        if self.min_segment > self.max_segment:
            raise ConfigError(
                f'min_segment: {self.min_segment!r} is not allowed, must be at most max_segment, '
                f'{self.max_segment:g} s'
            )


class Manoeuvre:
    """
    Vehicles that drive one segment of constant turn rate and acceleration after the other.

    The targets that trackers are tried on (Bar-Shalom, Li and Kirubarajan, Estimation with
    Applications to Tracking and Navigation, 2001): each segment has a time, a turn rate, or
    none, and an acceleration, or none, towards a speed between the two, all drawn uniformly.
    The edges of the area mirror the way, as they would a ray of light; this keeps places and
    headings uniform, as they start.

    The way that a seed gives does not depend on how its time is cut into steps.

    Parameters
    ----------
    config : ManoeuvreConfig
    vehicles : int
        V, D = 2.
    rng : numpy.random.Generator
        This object's own.

    """

    duration = math.inf

    def __init__(self, config: ManoeuvreConfig, vehicles: int, rng: np.random.Generator) -> None:
        self._config = config
        self._size = np.array([config.area_x, config.area_y])
        self._draws = Draws(rng, vehicles, 5)
        # Where the segment began, in a plane without edges.
        self._place = rng.random((vehicles, 2)) * self._size
        self._yaw = 2 * math.pi * rng.random(vehicles)
        self._speed = _between(config.min_speed, config.max_speed, rng.random(vehicles))
        self._turn_rate = np.zeros(vehicles)
        self._acceleration = np.zeros(vehicles)
        self._length = np.zeros(vehicles)
        self._since = np.zeros(vehicles)
        self._next_segment(np.arange(vehicles))
        self.state = self._snapshot()

    def step(self, elapsed: float) -> State:
        """
        Move all vehicles on by the elapsed time, through as many segments as it takes.

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
        self._since += elapsed
        rows = np.flatnonzero(self._since >= self._length)
        while rows.size:
            place, yaw, speed = self._after(rows, self._length[rows])
            self._place[rows], self._yaw[rows], self._speed[rows] = place, yaw, speed
            self._since[rows] -= self._length[rows]
            self._next_segment(rows)
            rows = rows[self._since[rows] >= self._length[rows]]
        self.state = self._snapshot()
        return self.state

    def _next_segment(self, rows: Array) -> None:
        """Draw the next manoeuvre of these vehicles."""
        config = self._config
        time, turns, rate, changes, speed = self._draws.take(rows).T
        self._length[rows] = _between(config.min_segment, config.max_segment, time)
        self._turn_rate[rows] = np.where(
            turns < config.turn_share,
            _between(-config.max_turn_rate, config.max_turn_rate, rate), 0.0)
        wanted = _between(config.min_speed, config.max_speed, speed) - self._speed[rows]
        # Reached at the end of the segment, if the strongest acceleration reaches it.
        acceleration = np.clip(wanted / self._length[rows], -config.max_acceleration,
                               config.max_acceleration)
        self._acceleration[rows] = np.where(
            changes < config.acceleration_share, acceleration, 0.0)

    def _after(self, rows: Array, time: Array) -> tuple[Array, Array, Array]:
        """Return places (n, 2), yaws and speeds (n,), so long after the segment began [s]."""
        yaw, speed, acceleration = self._yaw[rows], self._speed[rows], self._acceleration[rows]
        half = self._turn_rate[rows] * time / 2
        # The velocity, integrated: along the mean heading, and across it what the acceleration
        # does in a turn, (sin h / h - cos h) / h, which is h / 3 where that cannot be computed.
        along = np.sinc(half / math.pi)
        small = np.abs(half) < 1e-5
        across = np.where(small, half / 3, (along - np.cos(half)) / np.where(small, 1, half))
        ahead = time * (speed + acceleration * time / 2) * along
        aside = time * time * acceleration / 2 * across
        cos, sin = np.cos(yaw + half), np.sin(yaw + half)
        way = np.stack([ahead * cos - aside * sin, ahead * sin + aside * cos], axis=1)
        return self._place[rows] + way, yaw + 2 * half, speed + acceleration * time

    def _snapshot(self) -> State:
        place, yaw, speed = self._after(np.arange(len(self._yaw)), self._since)
        velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        # Unfolded, the mirrored areas stand side by side: every other one runs backwards.
        place = np.mod(place, 2 * self._size)
        back = place > self._size
        velocity = np.where(back, -velocity, velocity)
        return State(np.where(back, 2 * self._size - place, place), velocity,
                     wrap(np.arctan2(velocity[:, 1], velocity[:, 0])))


def _between(low: float, high: float, share: Array) -> Array:
    return np.asarray(low + (high - low) * share)
