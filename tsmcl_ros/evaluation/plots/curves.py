"""Curves side by side: of runs, and of experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
import numpy as np
from tsmcl_ros.evaluation.monte_carlo import Interval
from tsmcl_ros.evaluation.plots.canvas import (
    add_legend,
    curve_style,
    FAINT,
    label_axes,
    make_logarithmic,
    scale_errors,
    shown,
)
from tsmcl_ros.types import Array


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
        ax.step(np.append(0.0, ordered)[kept], share[kept], where='post', label=shown(label),
                linewidth=1.4, **curve_style(index))
    scale_errors(ax, np.concatenate([np.empty(0), *errors.values()]), 'x')
    ax.set_ylim(0, 1.01)
    label_axes(ax, 'position error [m]', 'share of epochs')
    if len(errors) > 1:
        add_legend(ax)


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
        ax.plot(np.arange(len(error)) + 1, error, label=shown(label), linewidth=1.3,
                **curve_style(index))
    for label, level in levels.items():
        ax.axhline(level, color=FAINT, linewidth=1.0, linestyle='--')
        ax.annotate(shown(f'{label}: {level:.0f} m'), (1.0, level), (0, 2), color=FAINT,
                    xycoords=ax.get_yaxis_transform(), textcoords='offset points', ha='right',
                    fontsize=8,
                    bbox={'facecolor': 'white', 'alpha': 0.8, 'linewidth': 0, 'pad': 0})
    drawn = np.concatenate([*curves.values(), list(levels.values())])
    drawn = drawn[drawn > 0]
    make_logarithmic(ax, 'y', float(drawn.min()) / 1.3, 1.3 * float(drawn.max()))
    ax.margins(x=0.01)
    label_axes(ax, epoch, quantity)
    if legend:
        add_legend(ax)


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
        style = curve_style(index)
        ax.plot(x, value, label=shown(label), linewidth=1.3, marker='.' if len(x) < 50 else '',
                **style)
        ax.fill_between(x, low, high, color=style.get('color'), alpha=0.15, linewidth=0)
    if log:
        x = [point for points, _ in curves.values() for point in points]
        y = [bound for _, intervals in curves.values() for each in intervals for bound in each]
        for axis, drawn in (('x', x), ('y', y)):
            make_logarithmic(ax, axis, min(drawn) / 1.1, 1.1 * max(drawn))
    else:
        ax.set_ylim(bottom=0)
    label_axes(ax, x_label, y_label)
    add_legend(ax)
