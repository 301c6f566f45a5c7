"""
Plots of runs against ground truth; the only module that imports matplotlib.

The functions draw on the axes they are given. Nothing here touches pyplot or matplotlib's global
settings, so a program that plots things of its own may call them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import io
from pathlib import Path
import re
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
import numpy as np
from tsmcl_ros.evaluation.metrics import Comparison, nees_band
from tsmcl_ros.evaluation.monte_carlo import Interval
from tsmcl_ros.types import Array

# The colour-blind-safe palette of Okabe and Ito (2008) without its black, which is the ink's part,
# and its yellow, which is lost on white.
COLORS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')
DASHES = ('-', '--', ':', '-.')
# What is neither data nor background; `svg` turns it into the surrounding text's colour.
INK = '#1b1b1f'
# Seen on white and on black alike.
FAINT = '#808288'
# More vehicles than this are drawn as a fleet: one colour, and percentiles over time.
DISTINCT = len(COLORS)
# More anchors than this are drawn without their radio disks, which would only blacken the map.
DISKS = 16
# Tracks of more points than this are drawn as an image, which keeps the file small.
VECTOR = 40_000
# After this many usual periods without an estimate a line breaks and a value is stale.
GAP = 5.0


def panel(width: float = 6.4, height: float = 3.2) -> tuple[Figure, Axes]:
    """Return a new figure of that size [inch] with a transparent background, and its axes."""
    figure, (ax,) = panels(1, width, height)
    return figure, ax


def panels(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """Return such a figure with several axes side by side."""
    figure = Figure(figsize=(width, height), facecolor='none', layout='constrained')
    axes = [figure.add_subplot(1, count, index + 1, facecolor='none') for index in range(count)]
    for ax in axes:
        ax.tick_params(which='both', colors=INK, labelsize=8)
        for side, spine in ax.spines.items():
            spine.set_color(INK)
            spine.set_visible(side in ('left', 'bottom'))
        ax.grid(color=INK, alpha=0.15, linewidth=0.6)
        ax.set_axisbelow(True)
    return figure, axes


def map_view(ax: Axes, vehicles: Mapping[str, Comparison], anchors: Array | None = None,
             radio_range: Array | None = None) -> None:
    """
    Draw where the vehicles were and where they were taken to be, seen from above.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    vehicles : mapping of name to Comparison
        Up to `DISTINCT` get a colour and a name each; of a larger fleet the last positions are
        marked and joined to their truths.
    anchors : (A, D) or None
        Positions [m].
    radio_range : (A,) or None
        Radii of the disks around them [m]; none is drawn where NaN.
    """
    fleet = len(vehicles) > DISTINCT
    rasterized = sum(len(part.path.stamp) for part in vehicles.values()) > VECTOR
    ink = FAINT if fleet or rasterized else INK
    style: dict[str, Any] = {'rasterized': rasterized, 'linewidth': 1.2, 'alpha': 0.85}
    if fleet:
        style.update(linewidth=0.7, alpha=0.55)
    alike = fleet or len(vehicles) == 1
    for index, (name, part) in enumerate(vehicles.items()):
        first = index == 0
        truth = _broken(part.path.stamp, part.path.position)
        ax.plot(*truth.T[:2], color=ink, label='truth' if first else None, **style)
        estimate = _broken(part.estimate.stamp, part.estimate.position)
        ax.plot(*estimate.T[:2], color=COLORS[0 if alike else index], **style,
                label=('estimate' if first else None) if alike else _shown(name))
    if fleet:
        _draw_last_positions(ax, vehicles)
    if anchors is not None and len(anchors):
        _draw_anchors(ax, anchors, radio_range)
    ax.set_aspect('equal', adjustable='datalim')
    ax.margins(0.04)
    _label(ax, 'x [m]', 'y [m]')
    _legend(ax)


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
    start = _start(vehicles)
    if len(vehicles) > DISTINCT:
        stamp, error = fleet_series(vehicles, 'error')
        low, median, high = _broken(stamp, _percentiles(error, [5, 50, 95]).T).T
        ax.fill_between(stamp - start, low, high, color=COLORS[0], alpha=0.25, linewidth=0,
                        label='5 to 95 % of the vehicles')
        ax.plot(stamp - start, median, color=COLORS[0], linewidth=1.3, label='median')
    else:
        for (name, part), color in zip(vehicles.items(), COLORS, strict=False):
            label = 'error' if len(vehicles) == 1 else _shown(name)
            _draw_series(ax, part, part.error, start, color=color, linewidth=1.0, label=label)
        if len(vehicles) == 1 and np.isfinite(part.spread).any():
            _draw_series(ax, part, part.spread, start, color=COLORS[1], linewidth=1.0,
                         linestyle='--', label='claimed by the covariance')
    for index, (begin, end) in enumerate(outages):
        ax.axvspan(begin - start, end - start, color=COLORS[4], alpha=0.25, linewidth=0,
                   label='no beacons' if index == 0 else None)
    _scale_errors(ax, np.concatenate([part.error for part in vehicles.values()]))
    ax.margins(x=0.01)
    _label(ax, 'time [s]', 'position error [m]')
    _legend(ax)


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
        ax.plot(stamp - _start(vehicles), _broken(stamp, drawn[-1]), label=_shown(label),
                linewidth=1.2, **_curve(index))
    _scale_errors(ax, np.concatenate([np.empty(0), *drawn]))
    ax.margins(x=0.01)
    _label(ax, 'time [s]', 'position error [m]')
    _legend(ax)


def error_cdf(ax: Axes, errors: Mapping[str, Array]) -> None:
    """
    Draw which share of the epochs has at most which error, one curve a method or bag.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    errors : mapping of label to (E,)
        [m].
    """
    for index, (label, error) in enumerate(errors.items()):
        ordered = np.sort(error)
        share = np.arange(len(ordered) + 1) / max(len(ordered), 1)
        # A step function of thousands of epochs looks no different with a thousand steps.
        kept = np.unique(np.linspace(0, len(ordered), 1001).astype(int))
        ax.step(np.append(0.0, ordered)[kept], share[kept], where='post', label=_shown(label),
                linewidth=1.4, **_curve(index))
    _scale_errors(ax, np.concatenate([np.empty(0), *errors.values()]), 'x')
    ax.set_ylim(0, 1.01)
    _label(ax, 'position error [m]', 'share of epochs')
    if len(errors) > 1:
        _legend(ax)


def nees_over_time(ax: Axes, vehicles: Mapping[str, Comparison]) -> None:
    """
    Draw the NEES, averaged over the vehicles, and the band in which 95 % of it should lie.

    Above the band the covariance promises too much, below it too little.
    """
    start = _start(vehicles)
    stamp, nees = fleet_series(vehicles, 'nees')
    known = np.isfinite(nees)
    count = known.sum(axis=0)
    mean = np.where(known, nees, 0.0).sum(axis=0) / np.where(count, count, np.nan)
    dimension = max((part.truth.position.shape[1] for part in vehicles.values()), default=2)
    low, high = nees_band(dimension, max(int(count.max(initial=0)), 1))
    ax.axhspan(low, high, color=COLORS[2], alpha=0.2, linewidth=0, label='95 % band')
    ax.axhline(dimension, color=COLORS[2], linewidth=1.0, linestyle='--',
               label=f'expected: {dimension}')
    ax.plot(stamp - start, _broken(stamp, mean), color=COLORS[0], linewidth=1.0,
            label='NEES' if len(vehicles) == 1 else 'mean over the vehicles')
    # What lies far below the band is as good as zero, and would squeeze the rest.
    highest = np.max(mean[np.isfinite(mean)], initial=high)
    _make_logarithmic(ax, 'y', low / 5, 1.5 * float(highest))
    ax.margins(x=0.01)
    _label(ax, 'time [s]', 'NEES')
    _legend(ax)


def error_against_epoch(ax: Axes, curves: Mapping[str, Array], quantity: str,
                        levels: Mapping[str, float], legend: bool = True, epoch: str = 'epoch'
                        ) -> None:
    """
    Draw errors of an experiment against the epoch, on a logarithmic axis.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    curves : mapping of label to (T,)
        [m], the first one at epoch 1.
    quantity : str
        What they are, for the axis.
    levels : mapping of label to float
        Errors [m] to be marked across.
    legend : bool
        Off where another plot beside it has the same.
    epoch : str
        What an epoch is, for the axis.
    """
    for index, (label, error) in enumerate(curves.items()):
        ax.plot(np.arange(len(error)) + 1, error, label=_shown(label), linewidth=1.3,
                **_curve(index))
    for label, level in levels.items():
        ax.axhline(level, color=FAINT, linewidth=1.0, linestyle='--')
        ax.annotate(_shown(f'{label}: {level:.0f} m'), (1.0, level), (0, 2), color=FAINT,
                    xycoords=ax.get_yaxis_transform(), textcoords='offset points', ha='right',
                    fontsize=8,
                    bbox={'facecolor': 'white', 'alpha': 0.8, 'linewidth': 0, 'pad': 0})
    drawn = np.concatenate([*curves.values(), list(levels.values())])
    drawn = drawn[drawn > 0]
    _make_logarithmic(ax, 'y', float(drawn.min()) / 1.3, 1.3 * float(drawn.max()))
    ax.margins(x=0.01)
    _label(ax, epoch, quantity)
    if legend:
        _legend(ax)


def intervals_against(
    ax: Axes, curves: Mapping[str, tuple[Sequence[float], Sequence[Interval]]], x_label: str,
    y_label: str, log: bool = False,
) -> None:
    """
    Draw quantities with their intervals against what was varied.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    curves : mapping of label to (x, intervals)
        Of the same length.
    x_label, y_label : str
        With units.
    log : bool
        Both axes are logarithmic; else what is drawn begins at 0.
    """
    for index, (label, (x, intervals)) in enumerate(curves.items()):
        value, low, high = np.array(intervals).T
        style = _curve(index)
        ax.plot(x, value, label=_shown(label), linewidth=1.3, marker='.' if len(x) < 50 else '',
                **style)
        ax.fill_between(x, low, high, color=style.get('color'), alpha=0.15, linewidth=0)
    if log:
        x = [point for points, _ in curves.values() for point in points]
        y = [bound for _, intervals in curves.values() for each in intervals for bound in each]
        for axis, drawn in (('x', x), ('y', y)):
            _make_logarithmic(ax, axis, min(drawn) / 1.1, 1.1 * max(drawn))
    else:
        ax.set_ylim(bottom=0)
    _label(ax, x_label, y_label)
    _legend(ax)


def save_png(figure: Figure, path: str | Path) -> None:
    """Write the figure as a PNG file on white."""
    figure.savefig(path, dpi=150, facecolor='white')


def fleet_series(vehicles: Mapping[str, Comparison], quantity: str) -> tuple[Array, Array]:
    """
    Return a quantity of all vehicles at common stamps.

    The stamps are those of the vehicle with the most epochs. At each of them every other vehicle
    contributes its last value, unless that is older than `GAP` usual periods.

    Parameters
    ----------
    vehicles : mapping of name to Comparison
        V vehicles.
    quantity : str
        `error`, `nees` or `spread`.

    Returns
    -------
    stamp : (T,) float64
        [s].
    values : (V, T) float64
        NaN where a vehicle has nothing to contribute.
    """
    parts = list(vehicles.values())
    stamp = max((part.truth.stamp for part in parts), key=len, default=np.empty(0))
    values = np.full((len(parts), len(stamp)), np.nan)
    oldest = GAP * float(np.median(np.diff(stamp))) if len(stamp) > 1 else 0.0
    for row, part in zip(values, parts, strict=True):
        last = np.searchsorted(part.truth.stamp, stamp, side='right') - 1
        if len(part.truth.stamp):
            fresh = (last >= 0) & (stamp - part.truth.stamp[last] <= oldest)
            row[fresh] = getattr(part, quantity)[last[fresh]]
    return stamp, values


def svg(figure: Figure, name: str) -> str:
    """
    Return the figure as an `<svg>` element to stand inside an HTML page.

    It takes its ink from the text's colour around it, and its first colour from the CSS variable
    `--first` if there is one, so it suits a dark page as a light one. Its ids start with the name,
    so figures with different names do not meet in one page, and the same plot gives the same text
    every time.
    """
    buffer = io.StringIO()
    figure.savefig(buffer, format='svg', dpi=200,
                   metadata=dict.fromkeys(('Creator', 'Date', 'Format', 'Type')))
    text = buffer.getvalue()
    text = text[text.index('<svg'):].replace(INK, 'currentColor')
    text = text.replace(COLORS[0].lower(), f'var(--first, {COLORS[0]})')
    ids = {old: f'{name}-{number}'
           for number, old in enumerate(dict.fromkeys(re.findall(r'\bid="([^"]+)"', text)))}

    def renamed(match: re.Match[str]) -> str:
        return match[1] + ids.get(match[2], match[2]) + match[3]

    return re.sub(r'(\bid="|="#|url\(#)([^")]+)(["\)])', renamed, text)


def _draw_last_positions(ax: Axes, vehicles: Mapping[str, Comparison]) -> None:
    ends = np.array([
        (part.truth.position[-1, :2], part.estimate.position[-1, :2])
        for part in vehicles.values() if len(part.error)])
    if not len(ends):
        return
    ax.add_collection(LineCollection(list(ends), colors=COLORS[1], linewidths=1.2))
    ax.plot(*ends[:, 0].T, 'o', color=INK, markersize=3.5, label='truth at the end')
    ax.plot(*ends[:, 1].T, 'x', color=COLORS[1], markersize=4.5, label='estimate at the end')


def _draw_anchors(ax: Axes, anchors: Array, radio_range: Array | None) -> None:
    ax.plot(*anchors.T[:2], '^', color=COLORS[2], markersize=6 if len(anchors) <= DISKS else 4,
            linestyle='none', label='anchor')
    if radio_range is None or len(anchors) > DISKS:
        return
    known = np.isfinite(radio_range)
    diameter = 2 * radio_range[known]
    if known.any():
        # A collection on the data's offsets leaves the view to what lies inside the disks.
        disks = EllipseCollection(
            diameter, diameter, np.zeros(len(diameter)), units='xy', offsets=anchors[known, :2],
            offset_transform=ax.transData, facecolors='none', edgecolors=COLORS[2], alpha=0.45,
            linewidths=0.8, linestyles=':')
        ax.add_collection(disks, autolim=False)
        ax.plot([], [], color=COLORS[2], alpha=0.6, linewidth=0.8, linestyle=':',
                label='radio range')


def _draw_series(ax: Axes, part: Comparison, values: Array, start: float, **style: Any) -> None:
    ax.plot(part.truth.stamp - start, _broken(part.truth.stamp, values), **style)


def _broken(stamp: Array, values: Array) -> Array:
    """Return values (T, ...) with NaN in front of gaps, across which a line would be invented."""
    steps = np.diff(stamp)
    if not steps.size:
        return values
    shown = values.copy()
    shown[:-1][steps > GAP * np.median(steps)] = np.nan
    return shown


def _curve(index: int) -> dict[str, Any]:
    """Return a colour and line style that tell the curve from the others."""
    return {'color': COLORS[index % len(COLORS)],
            'linestyle': DASHES[index // len(COLORS) % len(DASHES)]}


def _shown(name: str) -> str:
    """Return a name that matplotlib takes for neither mathematics nor a hidden legend entry."""
    name = name.replace('$', r'\$')
    return f' {name}' if name.startswith('_') else name


def _percentiles(values: Array, percents: Sequence[float]) -> Array:
    """Return percentiles over the vehicles (P, T), NaN at stamps where no vehicle has a value."""
    result = np.full((len(percents), values.shape[1]), np.nan)
    known = np.isfinite(values).any(axis=0)
    if known.any():
        result[:, known] = np.nanpercentile(values[:, known], percents, axis=0)
    return result


def _start(vehicles: Mapping[str, Comparison]) -> float:
    """Return the first stamp of all truths, from which the time axes count."""
    return min((part.start for part in vehicles.values()), default=0.0)


def _scale_errors(ax: Axes, error: Array, axis: str = 'y') -> None:
    """Start the axis at no error, or make it logarithmic where a few errors dwarf all others."""
    positive = error[error > 0]
    if positive.size and positive.max() > 30 * np.median(positive):
        low = float(np.percentile(positive, 1)) / 2
        _make_logarithmic(ax, axis, low, 1.2 * float(positive.max()))
    else:
        ax.set(**{f'{axis}lim': (0, None)})


def _make_logarithmic(ax: Axes, axis: str, low: float, high: float) -> None:
    """Label the axis with 1, 10, 100 or, on less than two decades, with 1, 2, 5, 10."""
    ax.set(**{f'{axis}scale': 'log', f'{axis}lim': (low, high)})
    steps = (1.0, 2.0, 5.0) if high / low < 100 else (1.0,)
    part = getattr(ax, f'{axis}axis')
    part.set_major_locator(LogLocator(subs=steps))
    part.set_major_formatter('{x:g}')
    part.set_minor_formatter(NullFormatter())


def _label(ax: Axes, x: str, y: str) -> None:
    ax.set_xlabel(x, color=INK, fontsize=9)
    ax.set_ylabel(y, color=INK, fontsize=9)


def _legend(ax: Axes) -> None:
    """Put the legend above the plot, in as many columns as its longest entry lets pass."""
    labels = ax.get_legend_handles_labels()[1]
    characters = 19 * ax.bbox.width / ax.figure.dpi
    columns = int(characters / (max(map(len, labels)) + 8)) if labels else 1
    ax.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncol=max(min(columns, len(labels)), 1),
              frameon=False, fontsize=8, labelcolor=INK, borderaxespad=0.3)
