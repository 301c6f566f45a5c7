"""How vehicles said that they were doing, over time."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
import numpy as np
from tsmcl_ros.evaluation.condition import Condition
from tsmcl_ros.evaluation.plots.canvas import (
    add_legend,
    broken,
    COLORS,
    DISTINCT,
    GAP,
    INK,
    label_axes,
    shown,
)
from tsmcl_ros.evaluation.plots.series import common_series, draw_spread
from tsmcl_ros.types import Array

# Each status has a shade of its own as well, for who tells no colours apart.
STATUSES = (('OK', '#009E73', 0.35), ('STALE', '#E69F00', 0.75), ('LOST', '#D55E00', 1.0))


def status_over_time(ax: Axes, conditions: Mapping[str, Condition], start: float) -> None:
    """
    Draw who was OK, STALE or LOST: a row a vehicle, of a fleet the share of its vehicles.

    Parameters
    ----------
    ax : Axes
        Where to draw.
    conditions : mapping of name to Condition
        Of V vehicles.
    start : float
        From which the time axis counts [s].

    """
    if len(conditions) > DISTINCT:
        _draw_shares(ax, conditions, start)
    else:
        _draw_rows(ax, conditions, start)
    label_axes(ax, 'time [s]', 'vehicles [%]' if len(conditions) > DISTINCT else '')
    ax.grid(visible=False)
    ax.margins(x=0.01)
    add_legend(ax)


def particles_over_time(ax: Axes, conditions: Mapping[str, Condition], start: float) -> None:
    """Draw how many particles there were; the parameters are those of `status_over_time`."""
    _draw(ax, {name: (part.stamp, part.particles) for name, part in conditions.items()}, start)
    ax.set_ylim(bottom=0)
    label_axes(ax, 'time [s]', 'particles')


def effective_over_time(ax: Axes, conditions: Mapping[str, Condition], start: float) -> None:
    """Draw which share of the particles counted; the parameters are as above."""
    _draw(ax, {name: (part.stamp, 100 * part.effective) for name, part in conditions.items()},
          start)
    ax.set_ylim(0, 105)
    label_axes(ax, 'time [s]', 'effective [%]')
    if len(conditions) > 1:
        add_legend(ax)


def _draw(ax: Axes, series: Mapping[str, tuple[Array, Array]], start: float) -> None:
    if len(series) > DISTINCT:
        stamp, values = common_series(list(series.values()), _oldest)
        draw_spread(ax, stamp - start, values)
    else:
        for (name, (stamp, values)), color in zip(series.items(), COLORS, strict=False):
            # Until the next diagnosis says otherwise.
            ax.step(stamp - start, broken(stamp, values), where='post', color=color,
                    linewidth=0.9, label=shown(name))
    ax.margins(x=0.01)


def _draw_rows(ax: Axes, conditions: Mapping[str, Condition], start: float) -> None:
    for row, part in enumerate(conditions.values()):
        until = np.minimum(
            np.append(part.stamp[1:], np.inf), part.stamp + _oldest(part.stamp))
        until[-1:] = part.stamp[-1:]
        for status, (_, color, alpha) in enumerate(STATUSES):
            spans = _spans(part.stamp, until, part.level == status)
            ax.broken_barh([(begin - start, end - begin) for begin, end in spans],
                           (row - 0.4, 0.8), color=color, alpha=alpha, linewidth=0)
    for label, color, alpha in STATUSES:
        ax.fill_between([], [], color=color, alpha=alpha, linewidth=0, label=label)
    names = [shown(name) for name in conditions]
    ax.set_yticks(range(len(names)), names if len(names) > 1 else [''] * len(names))
    ax.tick_params(axis='y', length=0)
    ax.set_ylim(len(names) - 0.5, -0.5)


def _draw_shares(ax: Axes, conditions: Mapping[str, Condition], start: float) -> None:
    stamp, level = common_series(
        [(part.stamp, part.level) for part in conditions.values()], _oldest)
    known = np.maximum(np.isfinite(level).sum(axis=0), 1)
    base = np.zeros(len(stamp))
    # What is worst at the bottom, where it is seen against the axis.
    for status in reversed(range(len(STATUSES))):
        label, color, alpha = STATUSES[status]
        top = base + 100 * (level == status).sum(axis=0) / known
        ax.fill_between(stamp - start, base, top, step='post', color=color, alpha=alpha,
                        linewidth=0, label=label)
        base = top
    ax.set_ylim(0, 100)
    ax.set_yticks([0, 50, 100])
    ax.tick_params(axis='y', colors=INK)


def _spans(begin: Array, end: Array, chosen: Array) -> list[tuple[float, float]]:
    """Return the chosen intervals (T,), those that touch joined."""
    begin, end = begin[chosen], end[chosen]
    if not len(begin):
        return []
    apart = begin[1:] > end[:-1]
    return list(zip(begin[np.append(True, apart)].tolist(),
                    end[np.append(apart, True)].tolist(), strict=True))


def _oldest(stamp: Array) -> float:
    """Return how long a diagnosis counts [s]; those of changes come between the regular ones."""
    return GAP * float(np.percentile(np.diff(stamp), 90)) if len(stamp) > 1 else 0.0
