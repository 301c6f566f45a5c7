"""What experiments share: following vehicles through a world, and judging the errors."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any, NamedTuple

import numpy as np
from tsmcl_ros.evaluation.metrics import normalized_error_squared
from tsmcl_ros.evaluation.monte_carlo import Finding, Interval, Outcome, Result, Stopwatch
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.mobility import State
from tsmcl_ros.model.relay import Poses
from tsmcl_ros.types import Array, Observation
from tsmcl_ros.world import World


class Track(NamedTuple):
    """Error [m] and NEES of V vehicles in T epochs (T, V), and what localizing took [s]."""

    error: Array
    nees: Array
    seconds: float


def follow(world: World, localizer: Localizer, epochs: int, odometry: bool,
           cooperate: bool = False) -> Track:
    """
    Localize a world's vehicles, or the first of them, through some beacon periods.

    Parameters
    ----------
    world : World
        It moves on.
    localizer : Localizer
        Of as many vehicles as are to be localized.
    epochs : int
        T.
    odometry : bool
        Whether the vehicles have it.
    cooperate : bool
        Whether they broadcast where they take themselves to be; all are to be localized then.

    """
    shape = epochs, localizer.vehicles
    error, nees = np.full(shape, np.nan), np.full(shape, np.nan)
    watch = Stopwatch()
    localizer.anchor_map(world.anchors)
    poses: Poses | None = None
    for row in range(epochs):
        epoch = world.step(poses=poses)
        observation = first_vehicles(epoch.observation, localizer.vehicles)
        with watch:
            estimate = localizer.epoch(
                observation, epoch.odom_position[:shape[1]] if odometry else None,
                epoch.odom_yaw[:shape[1]] if odometry else None)
        if cooperate:
            poses = Poses.of(estimate)
        known = np.isfinite(estimate.mean).all(axis=1)
        off = estimate.mean[known] - epoch.position[:shape[1]][known]
        error[row, known] = np.linalg.norm(off, axis=1)
        nees[row, known] = normalized_error_squared(off, estimate.covariance[known])
    return Track(error, nees, watch.seconds)


class Parked:
    """A mobility whose vehicles stay where they are, at positions (V, 2) [m]."""

    duration = math.inf

    def __init__(self, position: Array):
        self.state = State(position, np.zeros_like(position), np.zeros(len(position)))

    def step(self, elapsed: float) -> State:
        """Stay."""
        return self.state


def rmse(error: Array, axis: int | None = None) -> Any:
    """Return the root mean square of what is known of the errors."""
    return np.sqrt(np.nanmean(np.square(error), axis=axis))


def goal(claim: str, measured: Interval, goal: float, unit: str = '', limit: str = '',
         best: Interval | None = None) -> Finding:
    """Return whether a value is as small as it should be, and as the best filter's is."""
    verdict = 'reached' if measured.value <= goal else (
        'missed, though within the interval' if measured.low <= goal else 'missed')
    if verdict == 'missed' and best is not None and best.low > goal:
        verdict = 'not reproducible: the exact filter misses it too'
    return Finding(f'{claim} <= {goal:g}{unit}', f'{measured}{unit}', limit, verdict)


def as_rows(step: str, unit: str, **columns: Array) -> dict[str, Array]:
    """Return values (T, U) as columns of rows, beside which step, from 1, and unit they are of."""
    steps, units = np.indices(next(iter(columns.values())).shape)
    return {step: steps.ravel() + 1, unit: units.ravel(),
            **{name: values.ravel() for name, values in columns.items()}}


def side_by_side(outcomes: Sequence[Outcome], step: str, name: str) -> Array:
    """Return a column of `as_rows` as values (T, U) again, the units of all outcomes."""
    return np.concatenate([
        outcome.rows[name].reshape(outcome.rows[step][-1], -1) for outcome in outcomes], axis=1)


def by_case(results: Sequence[Result]) -> dict[tuple[Any, ...], list[Outcome]]:
    """Return the outcomes of all runs of each case, by what the case says."""
    cases: dict[tuple[Any, ...], list[Outcome]] = {}
    for result in results:
        cases.setdefault(tuple(result.case.values()), []).append(result.outcome)
    return cases


def first_vehicles(observation: Observation, vehicles: int) -> Observation:
    """Return what the first vehicles heard."""
    if vehicles == len(observation.sender):
        return observation
    return Observation.stack(
        [observation.vehicle(index) for index in range(vehicles)], observation.stamp)
