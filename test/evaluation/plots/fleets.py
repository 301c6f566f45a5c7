"""Vehicles to be drawn, and what can be read back from the axes they were drawn on."""

from functools import cache

import numpy as np
from tsmcl_ros.evaluation.condition import Condition
from tsmcl_ros.evaluation.metrics import compare
from tsmcl_ros.types import Trajectory

CLOCK = 1.77e9


def vehicle(seed, stamp=None, scale=1.0, dimension=2):
    """Return one vehicle's comparison with random errors, by default of 100 s on a real clock."""
    rng = np.random.default_rng(seed)
    truth_stamp = CLOCK + np.arange(101.0)
    stamp = truth_stamp if stamp is None else CLOCK + np.asarray(stamp, float)
    path = np.cumsum(rng.normal(0, 5, (101, dimension)), axis=0)
    found = np.column_stack([np.interp(stamp, truth_stamp, column) for column in path.T])
    found += rng.normal(0, scale, found.shape)
    covariance = np.tile(scale**2 * np.eye(dimension), (len(stamp), 1, 1))
    return compare(
        Trajectory(stamp, found, np.full(len(stamp), np.nan), covariance),
        Trajectory(truth_stamp, path, np.zeros(101)))


@cache
def fleet(count, dimension=2):
    return {f'veh_{index}': vehicle(index, dimension=dimension) for index in range(count)}


def condition(levels, stamp=None, particles=200.0):
    """Return a vehicle's condition at each second, or at these seconds, half its ESS."""
    stamp = np.arange(len(levels)) if stamp is None else stamp
    every = np.full(len(levels), particles)
    return Condition(CLOCK + np.asarray(stamp, float), np.array(levels), every, every / 2, {})


def conditions(count):
    """Return conditions of that many vehicles, STALE and LOST among them."""
    return {f'veh_{index}': condition([0] * 50 + [1] * 30 + [index % 3] * 21)
            for index in range(count)}


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}
