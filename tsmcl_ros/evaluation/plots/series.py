"""What changes over a run's time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
import numpy as np
from tsmcl_ros.evaluation.metrics import Comparison, nees_band
from tsmcl_ros.evaluation.plots.canvas import (
    add_legend,
    broken,
    COLORS,
    curve_style,
    DISTINCT,
    FAINT,
    GAP,
    label_axes,
    make_logarithmic,
    scale_errors,
    shown,
)
from tsmcl_ros.types import Array


def error_over_time(ax: Axes, vehicles: Mapping[str, Comparison],
                    outages: Sequence[tuple[float, float]] = ()) -> None:
    """
    Draw the position error over time, of a fleet its median and its 5 to 95 % range.

    A single vehicle's error is drawn beside the RMSE that its covariance claims.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    vehicles : mapping of name to Comparison
        Up to `DISTINCT` get a curve each.
    outages : sequence of (from, to)
        Times [s] without beacons, shaded.

    """
    start = time_origin(vehicles)
    if len(vehicles) > DISTINCT:
        stamp, error = fleet_series(vehicles, 'error')
        draw_spread(ax, stamp - start, error)
    else:
        for (name, part), color in zip(vehicles.items(), COLORS, strict=False):
            label = 'error' if len(vehicles) == 1 else shown(name)
            _draw_series(ax, part, part.error, start, color=color, linewidth=1.0, label=label)
        if len(vehicles) == 1 and np.isfinite(part.spread).any():
            _draw_series(ax, part, part.spread, start, color=COLORS[1], linewidth=1.0,
                         linestyle='--', label='claimed by the covariance')
    for index, (begin, end) in enumerate(outages):
        ax.axvspan(begin - start, end - start, color=COLORS[4], alpha=0.25, linewidth=0,
                   label='no beacons' if index == 0 else None)
    scale_errors(ax, np.concatenate([part.error for part in vehicles.values()]))
    ax.margins(x=0.01)
    label_axes(ax, 'time [s]', 'position error [m]')
    add_legend(ax)


def median_error_over_time(ax: Axes, runs: Mapping[str, Mapping[str, Comparison]]) -> None:
    """
    Draw each run's median error over its vehicles, each from its own start.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    runs : mapping of label to the run's vehicles
        One curve each.

    """
    drawn = []
    for index, (label, vehicles) in enumerate(runs.items()):
        stamp, error = fleet_series(vehicles, 'error')
        drawn.append(_percentiles(error, [50])[0])
        ax.plot(stamp - time_origin(vehicles), broken(stamp, drawn[-1]), label=shown(label),
                linewidth=1.2, **curve_style(index))
    # Medians hardly differ in themselves, so it takes less for one run to dwarf the others.
    scale_errors(ax, np.concatenate([np.empty(0), *drawn]), dwarfed=8.0)
    ax.margins(x=0.01)
    label_axes(ax, 'time [s]', 'position error [m]')
    add_legend(ax)


def nees_over_time(ax: Axes, runs: Mapping[str, Mapping[str, Comparison]]) -> None:
    """
    Draw the NEES, averaged over the vehicles, and the band in which 95 % of it should lie.

    Above the band the covariance promises too much, below it too little.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    runs : mapping of label to the run's vehicles
        One curve each, each from its own start; runs of fleets of different sizes have no band
        in common.

    """
    bands: dict[tuple[float, float], int] = {}
    highest = 0.0
    for index, (label, vehicles) in enumerate(runs.items()):
        stamp, nees = fleet_series(vehicles, 'nees')
        known = np.isfinite(nees)
        count = known.sum(axis=0)
        mean = np.where(known, nees, 0.0).sum(axis=0) / np.where(count, count, np.nan)
        dimension = max((part.truth.position.shape[1] for part in vehicles.values()), default=2)
        bands[nees_band(dimension, max(int(count.max(initial=0)), 1))] = dimension
        if len(runs) == 1:
            label = 'NEES' if len(vehicles) == 1 else 'mean over the vehicles'
        ax.plot(stamp - time_origin(vehicles), broken(stamp, mean), linewidth=1.0,
                label=shown(label), **curve_style(index))
        highest = float(np.max(mean[np.isfinite(mean)], initial=highest))
    if len(bands) == 1:
        ax.axhspan(*next(iter(bands)), color=FAINT, alpha=0.2, linewidth=0, label='95 % band')
    for dimension in sorted(set(bands.values())):
        ax.axhline(dimension, color=FAINT, linewidth=1.0, linestyle='--',
                   label=f'expected: {dimension}')
    # What lies far below the band is as good as zero, and what lies far above as good as infinite;
    # both would squeeze the rest.
    lowest, top = min(low for low, _ in bands), max(high for _, high in bands)
    make_logarithmic(ax, 'y', lowest / 5, min(max(1.5 * highest, 1.5 * top), 1000 * top))
    ax.margins(x=0.01)
    label_axes(ax, 'time [s]', 'NEES')
    add_legend(ax)


def fleet_series(vehicles: Mapping[str, Comparison], quantity: str) -> tuple[Array, Array]:
    """
    Return a quantity of all vehicles at common stamps, see `common_series`.

    Parameters
    ----------
    vehicles : mapping of name to Comparison
        V vehicles.
    quantity : str
        `error`, `nees` or `spread`.

    """
    return common_series(
        [(part.truth.stamp, getattr(part, quantity)) for part in vehicles.values()],
        lambda stamp: GAP * float(np.median(np.diff(stamp))) if len(stamp) > 1 else 0.0)


def common_series(
    series: Sequence[tuple[Array, Array]], oldest: Callable[[Array], float],
) -> tuple[Array, Array]:
    """
    Return several series at common stamps, those of the longest one.

    At each of them every other one contributes its last value, unless that is too old.

    Parameters
    ----------
    series : V of (stamp, values)
        Each of a length of its own; stamps [s] increase.
    oldest : callable
        Takes the common stamps and returns up to which age a value counts [s].

    Returns
    -------
    stamp : (T,) float64
        [s].
    values : (V, T) float64
        NaN where a series has nothing to contribute.

    """
    stamp = max((each for each, _ in series), key=len, default=np.empty(0))
    common = np.full((len(series), len(stamp)), np.nan)
    limit = oldest(stamp)
    for row, (own, values) in zip(common, series, strict=True):
        last = np.searchsorted(own, stamp, side='right') - 1
        if len(own):
            fresh = (last >= 0) & (stamp - own[last] <= limit)
            row[fresh] = values[last[fresh]]
    return stamp, common


def draw_spread(ax: Axes, time: Array, values: Array) -> None:
    """Draw the median of values (V, T) over the vehicles and their 5 to 95 % range."""
    low, median, high = broken(time, _percentiles(values, [5, 50, 95]).T).T
    ax.fill_between(time, low, high, color=COLORS[0], alpha=0.25, linewidth=0,
                    label='5 to 95 % of the vehicles')
    ax.plot(time, median, color=COLORS[0], linewidth=1.3, label='median')


def _draw_series(ax: Axes, part: Comparison, values: Array, start: float, **style: Any) -> None:
    ax.plot(part.truth.stamp - start, broken(part.truth.stamp, values), **style)


def _percentiles(values: Array, percents: Sequence[float]) -> Array:
    """Return percentiles over the vehicles (P, T), NaN at stamps where no vehicle has a value."""
    result = np.full((len(percents), values.shape[1]), np.nan)
    known = np.isfinite(values).any(axis=0)
    if known.any():
        result[:, known] = np.nanpercentile(values[:, known], percents, axis=0)
    return result


def time_origin(vehicles: Mapping[str, Comparison]) -> float:
    """Return the first stamp of all truths, from which the time axes count."""
    return min((part.start for part in vehicles.values()), default=0.0)
