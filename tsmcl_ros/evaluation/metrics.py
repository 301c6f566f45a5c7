"""
How far an estimate is from ground truth, and whether its covariance says so.

The position error is the distance between the estimate and the truth interpolated linearly at the
estimate's stamp, without any alignment; evo calls its root mean square the APE of the translation
part.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import gammaincinv
from tsmcl_ros.messages import UNMEASURED
from tsmcl_ros.types import Array, Trajectory

MAX_AGE = 2.0

# How tables show the metrics: attribute, heading, format.
COLUMNS = (
    ('rmse_m', 'RMSE [m]', '{:.3f}'),
    ('mean_m', 'mean [m]', '{:.3f}'),
    ('median_m', 'median [m]', '{:.3f}'),
    ('p95_m', '95 % [m]', '{:.3f}'),
    ('max_m', 'max [m]', '{:.3f}'),
    ('availability', 'available', '{:.1%}'),
    ('nees', 'NEES', '{:.2f}'),
    ('epochs', 'epochs', '{:d}'),
)


@dataclass(frozen=True)
class Metrics:
    """
    How good one vehicle's estimates are, or those of several vehicles pooled.

    Attributes
    ----------
    rmse_m, mean_m, median_m, p95_m, max_m : float
        Root mean square, mean, median, 95th percentile and maximum of the position error [m];
        NaN where there is no epoch.
    nees : float
        Mean of the normalised estimation error squared e^T P^-1 e over the epochs. A consistent
        estimator has D (2 or 3), an over-confident one more; `nees_band` says how far it may
        stray by chance. Infinite if a covariance is singular, NaN if there is none.
    availability : float
        Fraction of the evaluated time in which the newest estimate was at most `max_age` old. An
        estimator that predicts through an outage stays available (its error and NEES tell how
        well), one that falls silent does not; the time before the first estimate counts as well.
    epochs : int
        Number of estimates that were compared.

    """

    rmse_m: float
    mean_m: float
    median_m: float
    p95_m: float
    max_m: float
    nees: float
    availability: float
    epochs: int

    def as_json(self) -> dict[str, float | int | None]:
        """Return the metrics as JSON can hold them: null where a value is not finite."""
        return {name: value if math.isfinite(value) else None
                for name, value in asdict(self).items()}

    def cells(self) -> list[str]:
        """Return the metrics as the texts of a table's row, in the order of `COLUMNS`."""
        values = ((getattr(self, name), form) for name, _, form in COLUMNS)
        return ['-' if math.isnan(value) else form.format(value).replace('%', ' %')
                for value, form in values]


@dataclass(frozen=True, eq=False)
class Comparison:
    """
    One vehicle's estimates beside the truth at the same stamps.

    D is 2 where height is not estimated or its truth is not known, else 3.

    Attributes
    ----------
    estimate : Trajectory
        The estimates compared, E epochs, D coordinates.
    truth : Trajectory
        The truth interpolated at their stamps.
    path : Trajectory
        The truth itself in the evaluated time, with its own stamps.
    error : (E,) float64
        Distance between the two [m].
    nees : (E,) float64
        e^T P^-1 e of every epoch.
    spread : (E,) float64
        Root of the covariance's trace [m]: the RMSE that the estimator claims to have; NaN
        without a covariance.
    start, end : float
        Stamps of the truth's first and last row, before anything was skipped [s].
    duration : float
        Evaluated time, that is the truth's span without what was skipped [s].
    available : float
        How much of it had an estimate not too old [s].
    left_out : int
        Estimates before the truth's start, after its end, or not finite; what was skipped does
        not count.

    """

    estimate: Trajectory
    truth: Trajectory
    path: Trajectory
    error: Array
    nees: Array
    spread: Array
    start: float
    end: float
    duration: float
    available: float
    left_out: int


def evaluate(estimate: Trajectory, truth: Trajectory, skip: float = 0.0,
             max_age: float = MAX_AGE) -> Metrics:
    """Return the metrics of one vehicle; the parameters are those of `compare`."""
    return pool([compare(estimate, truth, skip, max_age)])


def compare(estimate: Trajectory, truth: Trajectory, skip: float = 0.0,
            max_age: float = MAX_AGE) -> Comparison:
    """
    Lay estimates beside the truth at their stamps.

    Parameters
    ----------
    estimate : Trajectory
        D = 2 or 3 coordinates [m]; a height whose variance is never below `UNMEASURED` is not
        estimated and not compared.
    truth : Trajectory
        D = 2 or 3 coordinates [m]; rows with NaN in x or y are ignored, a z that is NaN anywhere
        is not compared.
    skip : float
        Time left out from the truth's start [s].
    max_age : float
        Age up to which an estimate counts as available [s].

    Returns
    -------
    Comparison
        Without epochs if no estimate falls into the evaluated time.

    """
    dimension = _common_dimension(estimate, truth)
    known = np.isfinite(truth.position[:, :dimension]).all(axis=1)
    truth_stamp, truth_position = truth.stamp[known], truth.position[known, :dimension]
    first, end = (truth_stamp[0], truth_stamp[-1]) if known.any() else (np.inf, -np.inf)
    start = first + skip

    finite = np.isfinite(estimate.position[:, :dimension]).all(axis=1)
    rows = finite & (estimate.stamp >= start) & (estimate.stamp <= end)
    compared = _cut(estimate, rows, dimension)
    if rows.any():
        position = np.column_stack([
            np.interp(compared.stamp, truth_stamp, column) for column in truth_position.T])
        yaw = _interpolate_angle(compared.stamp, truth.stamp, truth.yaw)
    else:
        position, yaw = np.empty((0, dimension)), np.empty(0)
    difference = compared.position - position
    duration = max(float(end - start), 0.0)
    return Comparison(
        estimate=compared,
        truth=Trajectory(compared.stamp, position, yaw),
        path=_cut(truth, known & (truth.stamp >= start), dimension),
        error=np.linalg.norm(difference, axis=1),
        nees=normalized_error_squared(difference, compared.covariance),
        spread=_spread(compared),
        start=float(first),
        end=float(end),
        duration=duration,
        available=_covered(estimate.stamp[finite], start, end, max_age) if duration else 0.0,
        left_out=int(np.sum(~finite | (estimate.stamp < first) | (estimate.stamp > end))),
    )


def pool(comparisons: Iterable[Comparison]) -> Metrics:
    """Return the metrics over the epochs, and the time, of all vehicles together."""
    parts = list(comparisons)
    error = np.concatenate([np.empty(0), *(part.error for part in parts)])
    nees = np.concatenate([np.empty(0), *(part.nees for part in parts)])
    duration = sum(part.duration for part in parts)
    if not error.size:
        rmse = mean = median = p95 = largest = math.nan
    else:
        rmse = math.sqrt(np.mean(error**2))
        mean, largest = float(error.mean()), float(error.max())
        median, p95 = map(float, np.percentile(error, [50, 95]))
    return Metrics(
        rmse_m=rmse,
        mean_m=mean,
        median_m=median,
        p95_m=p95,
        max_m=largest,
        nees=float(nees.mean()) if nees.size else math.nan,
        availability=sum(part.available for part in parts) / duration if duration else math.nan,
        epochs=int(error.size),
    )


def mean_of(runs: Sequence[Metrics]) -> Metrics:
    """Return the mean of each metric over several runs, that of their epochs rounded."""
    means = {name: sum(getattr(run, name) for run in runs) / len(runs) for name, _, _ in COLUMNS}
    return Metrics(**{**means, 'epochs': round(means['epochs'])})


def chi_squared_quantile(probability: float, freedom: float) -> float:
    """Return what a chi-squared variable stays below so probably; scipy.stats loads long."""
    return float(2 * gammaincinv(freedom / 2, probability))


def normalized_error_squared(difference: Array, covariance: Array | None) -> Array:
    """
    Return the NEES, e^T P^-1 e (E,), infinite where P is not positive definite.

    Parameters
    ----------
    difference : (E, D) float
        Estimate minus truth [m].
    covariance : (E, D, D) float or None
        P [m^2]; without it the NEES is NaN.

    """
    if covariance is None:
        return np.full(len(difference), np.nan)
    finite = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    values, vectors = np.linalg.eigh(np.where(finite, covariance, 0.0))
    along = np.einsum('eij,ei->ej', vectors, difference)
    smallest = np.finfo(np.float64).eps * np.abs(values).max(axis=1, initial=0.0)
    definite = values[:, 0] > smallest
    squared = np.full(len(difference), np.inf)
    squared[definite] = np.sum(along[definite]**2 / values[definite], axis=1)
    return squared


def nees_band(dimension: int, samples: int, confidence: float = 0.95) -> tuple[float, float]:
    """
    Return the interval in which the mean NEES of a consistent estimator lies.

    The sum of n independent NEES values is chi-square distributed with n D degrees of freedom
    (Bar-Shalom, Li, Kirubarajan 2001, section 5.4). Successive epochs of one vehicle are
    correlated, so `samples` is the number of vehicles or runs averaged, not that of epochs.
    """
    low, high = (chi_squared_quantile((1 + side * confidence) / 2, samples * dimension)
                 for side in (-1, 1))
    return low / samples, high / samples


def metrics_document(overall: Metrics, vehicles: Mapping[str, Metrics]) -> dict[str, Any]:
    """Return what metrics.json holds for one bag."""
    return {
        'overall': overall.as_json(),
        'vehicles': {name: metrics.as_json() for name, metrics in vehicles.items()},
    }


def write_tum(path: str | Path, trajectory: Trajectory) -> None:
    """
    Write `stamp x y z qx qy qz qw` rows, the trajectory format of the TUM RGB-D benchmark.

    Stamps and metres carry nine decimals; z is 0 where D = 2, the orientation is the identity
    where yaw is unknown.
    """
    epochs, dimension = trajectory.position.shape
    half = np.nan_to_num(trajectory.yaw) / 2
    table = np.zeros((epochs, 8))
    table[:, 0] = trajectory.stamp
    table[:, 1:1 + dimension] = trajectory.position
    table[:, 6], table[:, 7] = np.sin(half), np.cos(half)
    np.savetxt(path, table, fmt='%.9f')


def _common_dimension(estimate: Trajectory, truth: Trajectory) -> int:
    """Return 3 if both know the height, else 2."""
    if min(estimate.position.shape[1], truth.position.shape[1]) < 3:
        return 2
    if estimate.covariance is not None and (estimate.covariance[:, 2, 2] >= UNMEASURED).all():
        return 2
    return 3 if np.isfinite(truth.position[:, 2]).all() else 2


def _cut(trajectory: Trajectory, rows: Array, dimension: int) -> Trajectory:
    covariance = trajectory.covariance
    return Trajectory(
        trajectory.stamp[rows],
        trajectory.position[rows, :dimension],
        trajectory.yaw[rows],
        None if covariance is None else covariance[rows, :dimension, :dimension],
    )


def _interpolate_angle(stamp: Array, known_stamp: Array, yaw: Array) -> Array:
    """Interpolate on the circle, NaN where yaw is not known at all."""
    known = np.isfinite(yaw)
    if not known.any():
        return np.full(len(stamp), np.nan)
    angle: Array = np.interp(stamp, known_stamp[known], np.unwrap(yaw[known]))
    return angle


def _spread(trajectory: Trajectory) -> Array:
    if trajectory.covariance is None:
        return np.full(len(trajectory.stamp), np.nan)
    variance: Array = np.trace(trajectory.covariance, axis1=1, axis2=2)
    return np.sqrt(np.maximum(variance, 0.0))


def _covered(stamp: Array, start: float, end: float, max_age: float) -> float:
    """Return how long in [start, end] the newest stamp was at most `max_age` old [s]."""
    until = np.minimum(stamp + max_age, np.append(stamp[1:], np.inf))
    return float(np.sum(np.maximum(np.minimum(until, end) - np.maximum(stamp, start), 0.0)))
