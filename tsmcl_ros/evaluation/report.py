"""The report: one HTML file with tables and plots that needs nothing but a browser."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from tsmcl_ros.evaluation import plots
from tsmcl_ros.evaluation.metrics import COLUMNS, Metrics, pool
from tsmcl_ros.evaluation.recording import OUTAGE, Run

# The table of more vehicles than this is folded away on the screen.
UNFOLDED = 12


def write_report(path: str | Path, runs: Sequence[Run], command: str,
                 parameters: Mapping[str, Any], mean: Metrics | None = None) -> None:
    """
    Write the report of one or several runs.

    Parameters
    ----------
    path : str or Path
        The HTML file; overwritten.
    runs : sequence of Run
        One section each, and all in the table on top; several are also compared in one plot.
    command : str
        The command line that made the report.
    parameters : mapping
        What else a reader needs to make it again; any names and values.
    mean : Metrics, optional
        Mean over the runs, for the table's last row.
    """
    Path(path).write_text(render(runs, command, parameters, mean), encoding='utf-8')


def render(runs: Sequence[Run], command: str, parameters: Mapping[str, Any],
           mean: Metrics | None = None) -> str:
    """Return the text of the report; the parameters are those of `write_report`."""
    title = 'Localization against ground truth'
    body = [
        f'<h1>{title}</h1>',
        _table('run', {run.label: run.overall for run in runs}, mean),
        _explanation(runs),
        _comparison(runs) if len(runs) > 1 else '',
        *(_section(run, f'run{index}', len(runs) == 1) for index, run in enumerate(runs)),
        '<h2>How this was made</h2>',
        f'<pre>{escape(command)}</pre>',
        _parameters(parameters),
    ]
    names = ', '.join(run.label for run in runs)
    return _PAGE.format(title=f'{escape(names)}: {title}', style=_STYLE, body='\n'.join(body))


def _table(heading: str, rows: Mapping[str, Metrics], mean: Metrics | None = None) -> str:
    head = ''.join(f'<th scope="col">{escape(text)}</th>'
                   for text in (heading, *(text for _, text, _ in COLUMNS)))
    body = ''.join(_row(label, metrics) for label, metrics in rows.items())
    foot = f'<tfoot>{_row("mean", mean)}</tfoot>' if mean else ''
    return ('<div class="wide"><table class="metrics">'
            f'<thead><tr>{head}</tr></thead><tbody>{body}</tbody>{foot}</table></div>')


def _row(label: str, metrics: Metrics) -> str:
    cells = ''.join(f'<td>{escape(cell)}</td>' for cell in metrics.cells())
    return f'<tr><th scope="row">{escape(label)}</th>{cells}</tr>'


def _explanation(runs: Iterable[Run]) -> str:
    dimensions = sorted({part.truth.position.shape[1]
                         for run in runs for part in run.vehicles.values() if len(part.error)})
    expected = ' or '.join(map(str, dimensions))
    return (
        '<p class="small">Errors are distances between estimate and interpolated truth, without '
        'alignment. <b>available</b>: share of the time with an estimate that is not too old. '
        f'<b>NEES</b>: mean of e<sup>T</sup>P<sup>&minus;1</sup>e; {expected} for a consistent '
        'estimator, more where the covariance promises too much.</p>')


def _comparison(runs: Sequence[Run]) -> str:
    figure, ax = plots.panel(6.4, 3.4)
    plots.median_error_over_time(ax, {run.label: run.vehicles for run in runs})
    medians = _figure(plots.svg(figure, 'medians'),
                      'Position error over time, median of the vehicles')
    return f'<h2>All runs</h2>{_columns(_error_cdf(runs, 5.6, 3.4), medians)}'


def _section(run: Run, name: str, alone: bool) -> str:
    """Return a run's plots and, of several vehicles, their table."""
    figure, ax = plots.panel(5.6, 5.4)
    plots.map_view(ax, run.vehicles, run.anchors, run.radio_range)
    where = _figure(plots.svg(figure, f'{name}-map'),
                    'Where the vehicles were, and where they were taken to be')
    height = 3.7 if alone else 2.6
    figure, ax = plots.panel(6.4, height)
    plots.error_over_time(ax, run.vehicles, run.outages)
    error = _figure(plots.svg(figure, f'{name}-error'), 'Position error over time')
    figure, ax = plots.panel(6.4, height)
    plots.nees_over_time(ax, run.vehicles)
    nees = _figure(plots.svg(figure, f'{name}-nees'),
                   'Covariance against error: above the band it promises too much, below too '
                   'little')
    share = _error_cdf([run], 5.6, 2.3) if alone else ''
    return '\n'.join([
        f'<h2>{escape(run.label)}</h2>',
        f'<p>{escape(_summary(run))}</p>',
        *(f'<p class="note">{escape(note)}</p>' for note in run.notes),
        _columns(where + share, error + nees),
        _vehicle_table(run),
    ])


def _error_cdf(runs: Sequence[Run], width: float, height: float) -> str:
    figure, ax = plots.panel(width, height)
    plots.error_cdf(ax, {run.label: run.error for run in runs})
    return _figure(plots.svg(figure, 'cdf'), 'Share of the epochs with at most this error')


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
    return ', '.join(parts) + '.'


def _vehicle_table(run: Run) -> str:
    if len(run.vehicles) == 1:
        return ''
    table = _table('vehicle', {name: pool([part]) for name, part in run.vehicles.items()})
    unfolded = ' open' if len(run.vehicles) <= UNFOLDED else ''
    return f'<details{unfolded}><summary>Every vehicle</summary>{table}</details>'


def _columns(left: str, right: str) -> str:
    return f'<div class="plots"><div>{left}</div><div>{right}</div></div>'


def _figure(svg: str, caption: str) -> str:
    return f'<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>'


def _parameters(parameters: Mapping[str, Any]) -> str:
    rows = ''.join(
        f'<tr><th scope="row">{escape(str(name))}</th><td>{escape(str(value))}</td></tr>'
        for name, value in parameters.items())
    return f'<table>{rows}</table>' if rows else ''


# The policy lets a browser hold that the report loads nothing from anywhere.
_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy"
  content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
{body}
</body>
</html>
"""

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1f; --page: #fff; --faint: #5c5f66;
  --line: #d5d8dd; --shade: #f4f5f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e7ea; --page: #16181c; --faint: #a2a6ae; --line: #3a3e45; --shade: #202329;
    --first: #3d9fe0; }
}
body { color: var(--ink); background: var(--page); font: 15px/1.5 system-ui, sans-serif;
  max-width: 76rem; margin: 2rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.6rem; font-weight: 600; margin: 0 0 1rem; }
h2 { font-size: 1.2rem; font-weight: 600; margin: 2.5rem 0 .5rem; overflow-wrap: anywhere; }
p { margin: .5rem 0; max-width: 60rem; }
.small, .note, figcaption { color: var(--faint); font-size: .87rem; }
.note { border-left: 3px solid #e69f00; padding-left: .7rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .93rem; }
th, td { padding: .3rem .8rem; border-bottom: 1px solid var(--line); text-align: left; }
th[scope=row] { font-weight: 400; overflow-wrap: break-word; }
thead th { font-weight: 600; white-space: nowrap; border-bottom: 2px solid var(--ink); }
.metrics td, .metrics thead th + th { text-align: right; font-variant-numeric: tabular-nums; }
.metrics tbody tr:hover { background: var(--shade); }
tfoot th[scope=row], tfoot td { font-weight: 600; border-top: 1px solid var(--ink); }
pre { background: var(--shade); padding: .7rem .9rem; overflow-x: auto; white-space: pre-wrap;
  overflow-wrap: anywhere; }
figure { margin: .75rem 0 1.25rem; break-inside: avoid; }
figure svg { display: block; width: 100%; height: auto; color: var(--ink); }
sup { line-height: 0; }
details { margin: .5rem 0; }
summary { cursor: pointer; }
.plots { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1.15fr); gap: 0 2rem; }
@media (max-width: 56rem), print { .plots { grid-template-columns: minmax(0, 1fr); } }
@media print {
  :root { color-scheme: light; --ink: #000; --page: #fff; --faint: #444; --line: #bbb;
    --shade: #fff; --first: #0072b2; }
  body { margin: 0; max-width: none; font-size: 10pt; }
  h2, h2 + p, .note, summary { break-after: avoid; }
  .wide { overflow-x: visible; }
  table { font-size: 8.5pt; }
  th, td { padding: .2rem .45rem; }
  figure svg { max-width: 5.4in; }
  details::details-content { content-visibility: visible; height: auto; }
  tr { break-inside: avoid; }
  pre { border: 1px solid var(--line); }
}
"""
