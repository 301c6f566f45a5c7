"""Where vehicles were, and where they took themselves to be."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
import numpy as np
from tsmcl_ros.evaluation.metrics import Comparison
from tsmcl_ros.evaluation.plots.canvas import (
    add_legend,
    broken,
    COLORS,
    DISTINCT,
    FAINT,
    INK,
    label_axes,
    shown,
)
from tsmcl_ros.types import Array

# More anchors than this are drawn without their radio disks, which would only blacken the map.
DISKS = 16
# Tracks of more points than this are drawn as an image, which keeps the file small.
VECTOR = 40_000


def map_view(ax: Axes, vehicles: Mapping[str, Comparison], anchors: Array | None = None,
             radio_range: Array | None = None, suspects: Mapping[int, Array] | None = None,
             upright: int = 1) -> None:
    """
    Draw where the vehicles were and where they were taken to be, seen from above or from aside.

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
    suspects : mapping of id to (D,), optional
        Positions [m] of the anchors that are under suspicion.
    upright : int
        Which coordinate goes up: 1 for y, 2 for z, without disks.

    """
    plane = [0, upright]
    fleet = len(vehicles) > DISTINCT
    rasterized = sum(len(part.path.stamp) for part in vehicles.values()) > VECTOR
    ink = FAINT if fleet or rasterized else INK
    style: dict[str, Any] = {'rasterized': rasterized, 'linewidth': 1.2, 'alpha': 0.85}
    if fleet:
        style.update(linewidth=0.7, alpha=0.55)
    alike = fleet or len(vehicles) == 1
    for index, (name, part) in enumerate(vehicles.items()):
        first = index == 0
        truth = broken(part.path.stamp, part.path.position)
        ax.plot(*truth.T[plane], color=ink, label='truth' if first else None, **style)
        estimate = broken(part.estimate.stamp, part.estimate.position)
        ax.plot(*estimate.T[plane], color=COLORS[0 if alike else index], **style,
                label=('estimate' if first else None) if alike else shown(name))
    if fleet:
        _draw_last_positions(ax, vehicles, plane)
    if anchors is not None and len(anchors):
        _draw_anchors(ax, anchors[:, plane], radio_range if upright == 1 else None)
    if suspects:
        _draw_suspects(ax, {identity: place[plane] for identity, place in suspects.items()})
    ax.set_aspect('equal', adjustable='datalim')
    ax.margins(0.04)
    label_axes(ax, 'x [m]', f'{"xyz"[upright]} [m]')
    add_legend(ax)


def _draw_last_positions(ax: Axes, vehicles: Mapping[str, Comparison], plane: list[int]) -> None:
    ends = np.array([
        (part.truth.position[-1, plane], part.estimate.position[-1, plane])
        for part in vehicles.values() if len(part.error)])
    if not len(ends):
        return
    ax.add_collection(LineCollection(list(ends), colors=COLORS[1], linewidths=1.2))
    ax.plot(*ends[:, 0].T, 'o', color=INK, markersize=3.5, label='truth at the end')
    ax.plot(*ends[:, 1].T, 'x', color=COLORS[1], markersize=4.5, label='estimate at the end')


def _draw_anchors(ax: Axes, anchors: Array, radio_range: Array | None) -> None:
    ax.plot(*anchors.T, '^', color=COLORS[2], markersize=6 if len(anchors) <= DISKS else 4,
            linestyle='none', label='anchor')
    if radio_range is None or len(anchors) > DISKS:
        return
    known = np.isfinite(radio_range)
    diameter = 2 * radio_range[known]
    if known.any():
        # A collection on the data's offsets leaves the view to what lies inside the disks.
        disks = EllipseCollection(
            diameter, diameter, np.zeros(len(diameter)), units='xy', offsets=anchors[known],
            offset_transform=ax.transData, facecolors='none', edgecolors=COLORS[2], alpha=0.45,
            linewidths=0.8, linestyles=':')
        ax.add_collection(disks, autolim=False)
        ax.plot([], [], color=COLORS[2], alpha=0.6, linewidth=0.8, linestyle=':',
                label='radio range')


def _draw_suspects(ax: Axes, suspects: Mapping[int, Array]) -> None:
    ax.plot(*np.array(list(suspects.values())).T, 's', color=COLORS[1], markersize=11,
            markerfacecolor='none', markeredgewidth=1.8, linestyle='none', label='suspect')
    for identity, place in suspects.items():
        ax.annotate(str(identity), tuple(place.tolist()), (8, 5), textcoords='offset points',
                    color=COLORS[1], fontsize=9, fontweight='bold')
