"""Vehicles in the streets of a grid city."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.mobility.base import AreaConfig, steady_speed
from tsmcl_ros.model.mobility.legs import Legs
from tsmcl_ros.types import Array


@dataclass(frozen=True)
class ManhattanConfig(AreaConfig):
    """Parameters of `Manhattan`."""

    blocks_x: int = param(10, 'blocks of houses along x, with streets around each', low=1,
                          high=10_000)
    blocks_y: int = param(10, 'see blocks_x', low=1, high=10_000)
    turn_probability: float = param(
        0.5, 'probability to turn at a crossing, to either side alike; else straight on', low=0,
        high=1)


class Manhattan(Legs):
    """
    Vehicles that drive along the streets between the blocks of a city, and turn at crossings.

    At a crossing a vehicle goes straight on, left or right, by 0.5, 0.25 and 0.25 (Bai, Sadagopan
    and Helmy, IMPORTANT: a framework to systematically analyze the impact of mobility on
    performance of routing protocols for ad hoc networks, 2003). At the edge of the city it does
    as BonnMotion's: where there is no street to one side it turns to the other as often, and
    where none leads on it turns. Nobody turns back. Speeds are uniform, drawn anew in each
    street that a vehicle turns into.

    Vehicles start as if long under way: with a `turn_probability` of 0.5 as many enter each
    direction of a street's block as leave it, so that all are driven equally often; with
    another, at the edges, that is not quite so.

    Parameters
    ----------
    config : ManhattanConfig
    vehicles : int
        V, D = 2.
    rng : numpy.random.Generator
        This object's own.

    """

    def __init__(self, config: ManhattanConfig, vehicles: int, rng: np.random.Generator) -> None:
        self._config = config
        self._blocks = np.array([config.blocks_x, config.blocks_y])
        self._block = np.array([config.area_x, config.area_y]) / self._blocks
        # The crossing that each vehicle drives to, and its direction, in blocks.
        self._crossing = np.zeros((vehicles, 2), np.intp)
        self._direction = np.zeros((vehicles, 2), np.intp)
        super().__init__(vehicles, 2, rng, 3)

    def _choose(self, rows: Array, drawn: Array) -> None:
        turn, side, speed = drawn.T
        crossing, ahead = self._crossing[rows], self._direction[rows]
        left = ahead[:, ::-1] * [-1, 1]
        must = ~self._is_inside(crossing + ahead)
        can_left, can_right = self._is_inside(crossing + left), self._is_inside(crossing - left)
        turns = must | (turn < self._config.turn_probability)
        goes_left = can_left & (~can_right | (side < 0.5))
        aside = np.where(goes_left[:, None], left, -left)
        self._direction[rows] = np.where(turns[:, None], aside, ahead)
        self._crossing[rows] += self._direction[rows]
        self._target[rows] = self._crossing[rows] * self._block
        low, high = self._config.min_speed, self._config.max_speed
        self._speed[rows] = np.where(turns, low + (high - low) * speed, self._speed[rows])

    def _is_inside(self, crossing: Array) -> Array:
        return np.all((crossing >= 0) & (crossing <= self._blocks), axis=1)

    def _start(self, rng: np.random.Generator) -> None:
        """Put vehicles on all streets alike, by length."""
        rows = np.arange(len(self._crossing))
        streets = self._blocks[::-1] + 1  # that lead along x, along y
        lengths = streets * self._blocks * self._block
        axis = (rng.random(rows.size) * lengths.sum() >= lengths[0]).astype(np.intp)
        street = (rng.random(rows.size) * streets[axis]).astype(np.intp)
        place = rng.random(rows.size) * self._blocks[axis]
        onward = rng.random(rows.size) < 0.5
        self._direction[rows, axis] = np.where(onward, 1, -1)
        self._crossing[rows, axis] = np.floor(place) + onward
        self._crossing[rows, 1 - axis] = street
        self._position[rows, axis] = place * self._block[axis]
        self._position[rows, 1 - axis] = street * self._block[1 - axis]
        self._target[:] = self._crossing * self._block
        self._speed[:] = steady_speed(
            self._config.min_speed, self._config.max_speed, rng.random(rows.size))
        self._aim(rows)
        self._face(rows)
