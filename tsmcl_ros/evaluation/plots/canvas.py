"""Figures that stand in a page or a file, and how everything on them looks."""

from __future__ import annotations

from collections.abc import Sequence
import io
from pathlib import Path
import re
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
import numpy as np
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
# After this many usual periods without an estimate a line breaks and a value is stale.
GAP = 5.0


def panel(width: float = 6.4, height: float = 3.2) -> tuple[Figure, Axes]:
    """Return a new figure of that size [inch] with a transparent background, and its axes."""
    figure, (ax,) = panels(1, width, height)
    return figure, ax


def panels(count: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """Return such a figure with several axes side by side."""
    figure = Figure(figsize=(width, height), facecolor='none', layout='constrained')
    axes = [figure.add_subplot(1, count, index + 1) for index in range(count)]
    for ax in axes:
        _dress(ax)
    return figure, axes


def stack(width: float, heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Return such a figure with axes of these heights [inch] below each other, on one x axis."""
    figure = Figure(figsize=(width, sum(heights)), facecolor='none', layout='constrained')
    axes = figure.subplots(
        len(heights), sharex=True, squeeze=False, height_ratios=heights)[:, 0].tolist()
    for ax in axes:
        _dress(ax)
    return figure, axes


def save_png(figure: Figure, path: str | Path) -> None:
    """Write the figure as a PNG file on white."""
    figure.savefig(path, dpi=150, facecolor='white')


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


def curve_style(index: int) -> dict[str, Any]:
    """Return a colour and line style that tell the curve from the others."""
    return {'color': COLORS[index % len(COLORS)],
            'linestyle': DASHES[index // len(COLORS) % len(DASHES)]}


def shown(name: str) -> str:
    """Return a name that matplotlib takes for neither mathematics nor a hidden legend entry."""
    name = name.replace('$', r'\$')
    return f' {name}' if name.startswith('_') else name


def broken(stamp: Array, values: Array) -> Array:
    """Return values (T, ...) with NaN in front of gaps, across which a line would be invented."""
    steps = np.diff(stamp)
    if not steps.size:
        return values
    shown = values.copy()
    shown[:-1][steps > GAP * np.median(steps)] = np.nan
    return shown


def scale_errors(ax: Axes, error: Array, axis: str = 'y', dwarfed: float = 30.0) -> None:
    """
    Start the axis at no error, or make it logarithmic where some errors dwarf most others.

    That is, where the largest is so many times their median.
    """
    positive = error[error > 0]
    if positive.size and positive.max() > dwarfed * np.median(positive):
        low = float(np.percentile(positive, 1)) / 2
        make_logarithmic(ax, axis, low, 1.2 * float(positive.max()))
    else:
        ax.set(**{f'{axis}lim': (0, None)})


def make_logarithmic(ax: Axes, axis: str, low: float, high: float) -> None:
    """Label the axis with 1, 10, 100 or, on less than two decades, with 1, 2, 5, 10."""
    ax.set(**{f'{axis}scale': 'log', f'{axis}lim': (low, high)})
    steps = (1.0, 2.0, 5.0) if high / low < 100 else (1.0,)
    part = getattr(ax, f'{axis}axis')
    part.set_major_locator(LogLocator(subs=steps))
    part.set_major_formatter('{x:g}')
    part.set_minor_formatter(NullFormatter())


def label_axes(ax: Axes, x: str, y: str) -> None:
    place = ax.get_subplotspec()
    if place is None or place.is_last_row():
        ax.set_xlabel(x, color=INK, fontsize=9)
    ax.set_ylabel(y, color=INK, fontsize=9)


def add_legend(ax: Axes) -> None:
    """Put the legend above the plot, in as many columns as its longest entry lets pass."""
    labels = ax.get_legend_handles_labels()[1]
    characters = 19 * ax.bbox.width / ax.figure.dpi
    columns = int(characters / (max(map(len, labels)) + 8)) if labels else 1
    ax.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncol=max(min(columns, len(labels)), 1),
              frameon=False, fontsize=8, labelcolor=INK, borderaxespad=0.3)


def _dress(ax: Axes) -> None:
    ax.set_facecolor('none')
    ax.tick_params(which='both', colors=INK, labelsize=8)
    for side, spine in ax.spines.items():
        spine.set_color(INK)
        spine.set_visible(side in ('left', 'bottom'))
    ax.grid(color=INK, alpha=0.15, linewidth=0.6)
    ax.set_axisbelow(True)
