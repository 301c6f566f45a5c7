"""The report: one HTML file with tables and plots that needs nothing but a browser."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.metrics import Metrics, pool
from tsmcl_ros.evaluation.page import (
    columns,
    figure,
    folded,
    metrics_table,
    page,
    parameter_table,
)
from tsmcl_ros.evaluation.recording import OUTAGE, Run
from tsmcl_ros.types import Array, Progress, unshown

# The table of more vehicles than this is folded away on the screen.
UNFOLDED = 12
# Widths of the page's two columns, which their plots are drawn for [inch].
LEFT, RIGHT = 5.6, 6.4
# A sender that fewer diagnoses suspect, in the vehicle that suspects it most, is not named.
SUSPICION = 0.05


def write_report(path: str | Path, runs: Sequence[Run], command: str,
                 parameters: Mapping[str, Any], mean: Metrics | None = None,
                 progress: Progress = unshown) -> None:
    """
    Write the report of one or several runs.

    Parameters
    ----------
    path : str or Path
        The HTML file; overwritten.
    runs : sequence of Run
        One section each, and all in the table on top; several are also compared in plots.
    command : str
        The command line that made the report.
    parameters : mapping
        What else a reader needs to make it again; any names and values.
    mean : Metrics, optional
        Mean over the runs, for the table's last row.
    progress : Progress
        Shows the drawing.

    """
    text = render(runs, command, parameters, mean, progress)
    Path(path).write_text(text, encoding='utf-8')


def render(runs: Sequence[Run], command: str, parameters: Mapping[str, Any],
           mean: Metrics | None = None, progress: Progress = unshown) -> str:
    """Return the text of the report; the parameters are those of `write_report`."""
    title = 'Localization against ground truth'
    names = ', '.join(run.label for run in runs)
    sections = progress(enumerate(runs), len(runs), 'run', 'drawing')
    return page(f'{names}: {title}', '\n'.join([
        f'<h1>{title}</h1>',
        metrics_table('run', {run.label: run.overall for run in runs}, mean),
        _explanation(runs),
        _comparison(runs) if len(runs) > 1 else '',
        *(_section(run, f'run{index}', len(runs) == 1) for index, run in sections),
        '<h2>How this report was made</h2>',
        f'<pre>{escape(command)}</pre>',
        parameter_table(parameters),
    ]))


def _explanation(runs: Iterable[Run]) -> str:
    dimensions = sorted({_dimension(run) for run in runs})
    expected = ' or '.join(map(str, dimensions))
    return (
        '<p class="small">Errors are distances between estimate and interpolated truth, without '
        'alignment. <b>available</b>: share of the time with an estimate that is not too old. '
        f'<b>NEES</b>: mean of e<sup>T</sup>P<sup>&minus;1</sup>e; {expected} for a consistent '
        'estimator, more where the covariance promises too much.</p>')


def _comparison(runs: Sequence[Run]) -> str:
    vehicles = {run.label: run.vehicles for run in runs}
    drawing, ax = plots.panel(RIGHT, 2.9)
    plots.median_error_over_time(ax, vehicles)
    medians = figure(plots.svg(drawing, 'medians'),
                     'Position error over time, median of the vehicles')
    share = _error_cdf(runs, 6.2)
    return f'<h2>All runs</h2>{columns(share, medians + _nees(vehicles, "nees", 2.9))}'


def _section(run: Run, name: str, alone: bool) -> str:
    """Return a run's plots and, of several vehicles, their table."""
    particles = _particles(run, name, RIGHT if alone else LEFT)
    # What makes both columns about as long.
    height = 2.6 if alone == bool(particles) else 3.6
    height += 1.2 if _dimension(run) == 3 else 0
    left = _maps(run, name) + (_error_cdf([run], 2.9) if alone else particles)
    right = (_error(run, name, height)
             + _nees({run.label: run.vehicles}, f'{name}-nees', height)
             + (particles if alone else ''))
    return '\n'.join([
        f'<h2>{escape(run.label)}</h2>',
        f'<p>{escape(_summary(run))}</p>',
        *(f'<p class="note">{escape(note)}</p>' for note in run.notes),
        columns(left, right),
        _vehicle_table(run),
        _origin(run),
    ])


def _maps(run: Run, name: str) -> str:
    """Return the map, and what is seen from aside where height is estimated."""
    places = _suspect_places(run)
    drawing, ax = plots.panel(LEFT, 5.4)
    plots.map_view(ax, run.vehicles, run.anchors, run.radio_range, places)
    shown = figure(plots.svg(drawing, f'{name}-map'),
                   'Where the vehicles were, and where they were taken to be')
    if _dimension(run) == 3:
        drawing, ax = plots.panel(LEFT, 3.0)
        plots.map_view(ax, run.vehicles, run.anchors, None, places, upright=2)
        shown += figure(plots.svg(drawing, f'{name}-aside'), 'The same, seen from aside')
    return shown


def _error(run: Run, name: str, height: float) -> str:
    """Return the error over time, and below it what the vehicles said of themselves."""
    caption = 'Position error over time'
    if not run.conditions:
        drawing, ax = plots.panel(RIGHT, height)
        plots.error_over_time(ax, run.vehicles, run.outages)
    else:
        rows = len(run.conditions)
        strip = 0.85 if rows > plots.DISTINCT else 0.45 + 0.14 * rows
        drawing, (ax, below) = plots.stack(RIGHT, [height, strip])
        plots.error_over_time(ax, run.vehicles, run.outages)
        plots.status_over_time(below, run.conditions, plots.time_origin(run.vehicles))
        caption += '; below, what the localizer took its estimates for'
    return figure(plots.svg(drawing, f'{name}-error'), caption)


def _nees(runs: Mapping[str, Any], name: str, height: float) -> str:
    drawing, ax = plots.panel(RIGHT, height)
    plots.nees_over_time(ax, runs)
    return figure(plots.svg(drawing, name),
                  'Covariance against error: above the band it promises too much, below too '
                  'little')


def _particles(run: Run, name: str, width: float) -> str:
    if not any((part.particles > 1).any() for part in run.conditions.values()):
        return ''
    drawing, (above, below) = plots.stack(width, [1.2, 1.5])
    start = plots.time_origin(run.vehicles)
    plots.particles_over_time(above, run.conditions, start)
    plots.effective_over_time(below, run.conditions, start)
    return figure(plots.svg(drawing, f'{name}-particles'),
                  'Particles, and the share of them that carries the weight (ESS)')


def _error_cdf(runs: Sequence[Run], height: float) -> str:
    drawing, ax = plots.panel(LEFT, height)
    plots.error_cdf(ax, {run.label: run.error for run in runs})
    return figure(plots.svg(drawing, 'cdf'), 'Share of the epochs with at most this error')


def _summary(run: Run) -> str:
    count = len(run.vehicles)
    duration = max(part.duration for part in run.vehicles.values())
    parts = [f'{count} vehicle{"s" if count > 1 else ""}', f'{duration:.0f} s evaluated']
    if len(run.anchors):
        parts.append(f'{len(run.anchors)} anchors')
    if run.outages:
        longest = max(end - begin for begin, end in run.outages)
        count = len(run.outages)
        parts.append(f'{count} outage{"s" if count > 1 else ""} of more than {OUTAGE:g} s without '
                     f'beacons, the longest {longest:.0f} s')
    text = ', '.join(parts) + '.'
    if suspects := _suspects(run):
        alone = len(run.vehicles) == 1
        senders = (f'{identity}' if alone else f'{identity} (by {count} of the vehicles)'
                   for identity, count in suspects.items())
        text += f' Suspected senders: {", ".join(senders)}.'
    return text


def _suspects(run: Run) -> dict[int, int]:
    """Return how many vehicles suspect each sender that is suspected for long enough."""
    worst: dict[int, list[float]] = {}
    for part in run.conditions.values():
        for identity, share in part.suspects.items():
            worst.setdefault(identity, []).append(share)
    return {identity: len(shares) for identity, shares in sorted(worst.items())
            if max(shares) >= SUSPICION}


def _suspect_places(run: Run) -> dict[int, Array]:
    """Return where those suspects are that are anchors."""
    rows = np.flatnonzero(np.isin(run.anchor_ids, list(_suspects(run)))).tolist()
    return {int(run.anchor_ids[row]): run.anchors[row] for row in rows}


def _dimension(run: Run) -> int:
    return max(int(part.truth.position.shape[1]) for part in run.vehicles.values())


def _vehicle_table(run: Run) -> str:
    if len(run.vehicles) == 1:
        return ''
    table = metrics_table('vehicle', {name: pool([part]) for name, part in run.vehicles.items()})
    return folded('Every vehicle', table, len(run.vehicles) <= UNFOLDED)


def _origin(run: Run) -> str:
    """Return what the bag says of how it was made."""
    texts = [(f'<p>{escape(name)}</p>' if name != 'command' else '')
             + f'<pre>{escape(text.rstrip())}</pre>' for name, text in run.about.items()]
    return folded('How this run was made', ''.join(texts)) if texts else ''
