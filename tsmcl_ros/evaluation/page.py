"""The page that a report stands on: its frame, its style, and its tables."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from tsmcl_ros.evaluation.metrics import COLUMNS, Metrics


def page(title: str, body: str) -> str:
    """Return an HTML page; the title is text, the body HTML."""
    return _PAGE.format(title=escape(title), style=_STYLE, body=body)


def metrics_table(heading: str, rows: Mapping[str, Metrics], mean: Metrics | None = None) -> str:
    """Return a table of metrics by label, with the mean as its last row if there is one."""
    head = ''.join(f'<th scope="col">{escape(text)}</th>'
                   for text in (heading, *(text for _, text, _ in COLUMNS)))
    body = ''.join(_row(label, metrics) for label, metrics in rows.items())
    foot = f'<tfoot>{_row("mean", mean)}</tfoot>' if mean else ''
    return ('<div class="wide"><table class="metrics">'
            f'<thead><tr>{head}</tr></thead><tbody>{body}</tbody>{foot}</table></div>')


def parameter_table(parameters: Mapping[str, Any]) -> str:
    """Return a table of names and values, nothing without any."""
    rows = ''.join(
        f'<tr><th scope="row">{escape(str(name))}</th><td>{escape(str(value))}</td></tr>'
        for name, value in parameters.items())
    return f'<table>{rows}</table>' if rows else ''


def folded(summary: str, content: str, unfolded: bool = False) -> str:
    """Return what is seen at a click, and printed always; the summary is text."""
    opened = ' open' if unfolded else ''
    return f'<details{opened}><summary>{escape(summary)}</summary>{content}</details>'


def figure(svg: str, caption: str) -> str:
    """Return a figure with its caption, which is text."""
    return f'<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>'


def columns(left: str, right: str) -> str:
    """Return two columns, below each other where the page is narrow."""
    return f'<div class="plots"><div>{left}</div><div>{right}</div></div>'


def _row(label: str, metrics: Metrics) -> str:
    cells = ''.join(f'<td>{escape(cell)}</td>' for cell in metrics.cells())
    return f'<tr><th scope="row">{escape(label)}</th>{cells}</tr>'


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
