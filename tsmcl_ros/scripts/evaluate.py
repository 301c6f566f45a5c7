"""Compare the poses in bags with ground truth: table, metrics.json, trajectories, report."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
import json
from pathlib import Path
import re
import sys
from typing import Any

from tsmcl_ros.evaluation.metrics import (
    COLUMNS,
    MAX_AGE,
    mean_of,
    Metrics,
    metrics_document,
    pool,
    write_tum,
)
from tsmcl_ros.evaluation.recording import read_runs, Run
from tsmcl_ros.scripts.cli import a_number, add_quiet, align, command_line, progress, run_script
from tsmcl_ros.types import BagError, Progress, unshown


def main(arguments: Sequence[str] | None = None) -> int:
    """Evaluate bags from the command line and return the exit code."""
    return run_script(_evaluate, arguments)


def summarize(bags: Sequence[str | Path], labels: Sequence[str] = (), skip: float = 0.0,
              max_age: float = MAX_AGE) -> str:
    """
    Return the table of all runs in some bags, as `evaluate` prints it.

    The parameters and errors are those of `read_all`.
    """
    return format_table(read_all(bags, labels, skip, max_age))


def read_all(bags: Sequence[str | Path], labels: Sequence[str] = (), skip: float = 0.0,
             max_age: float = MAX_AGE, show: Progress = unshown) -> list[Run]:
    """
    Compare the poses of several bags with their ground truth.

    Parameters
    ----------
    bags : sequence of str or Path
        The bags' folders.
    labels : sequence of str
        A name for each; by default that of its folder, or its path where two folders share one.
    skip, max_age : float
        See `compare` [s].
    show : Progress
        Shows the reading.

    Raises
    ------
    BagError
        If a bag holds nothing to evaluate, or the files of two runs would have the same name.
    MessageError
        If a pose or a ground truth is malformed.

    """
    names = list(labels) or [Path(bag).resolve().name for bag in bags]
    if len(set(names)) < len(names) and not labels:
        names = [str(bag) for bag in bags]
    runs = [run for bag, name in zip(bags, names, strict=True)
            for run in read_runs(bag, name, skip, max_age, show)]
    taken: dict[str, str] = {}
    for run in runs:
        if _folder(run) in taken:
            raise BagError(f'two runs are called {taken[_folder(run)]!r} and {run.label!r}: give '
                           'each bag a --label of its own')
        taken[_folder(run)] = run.label
    return runs


def format_table(runs: Iterable[Run], mean: Metrics | None = None) -> str:
    """
    Return the runs' metrics as lines of text, one a run, and the mean if there is one.

    The last column counts the vehicles that had a pose at all.
    """
    rows = [('', *(heading for _, heading, _ in COLUMNS), 'localized')]
    rows += [(run.label, *run.overall.cells(), _localized(run)) for run in runs]
    if mean:
        rows.append(('mean', *mean.cells(), ''))
    return align(rows)


def write_evaluation(folder: str | Path, runs: Sequence[Run], command: str,
                     parameters: Mapping[str, Any], mean: Metrics | None = None,
                     show: Progress = unshown) -> list[str]:
    """
    Write metrics.json, the trajectories and the report.

    One run's metrics.json holds `overall` and `vehicles`, that of several runs holds the same for
    each of them under `bags`, and `mean` if given. Beside each vehicle's estimates, NAME.tum, lies
    the truth at the same stamps, NAME.truth.tum.

    Parameters
    ----------
    folder : str or Path
        Made if missing; files of the same names are overwritten.
    runs, command, parameters, mean
        See `write_report`.
    show : Progress
        Shows the drawing.

    Returns
    -------
    list of str
        What was written: names of files and folders in `folder`. The report is missing where
        matplotlib is.

    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    document = json.dumps(_document(runs, mean), indent=2, allow_nan=False)
    (folder / 'metrics.json').write_text(document + '\n', encoding='utf-8')
    for run in runs:
        place = folder / 'tum' / (_folder(run) if len(runs) > 1 else '')
        place.mkdir(parents=True, exist_ok=True)
        for name, part in run.vehicles.items():
            # Names of topics hold no dots, so no vehicle's truth meets another one's estimates.
            write_tum(place / f'{name.replace("/", ".")}.tum', part.estimate)
            write_tum(place / f'{name.replace("/", ".")}.truth.tum', part.truth)
    written = ['metrics.json', 'tum']
    try:
        from tsmcl_ros.evaluation.report import write_report
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] != 'matplotlib':
            raise
        return written
    write_report(folder / 'report.html', runs, command, parameters, mean, show)
    return [*written, 'report.html']


def _evaluate(arguments: Sequence[str] | None) -> None:
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.label and len(options.label) != len(options.bags):
        parser.error(f'--label: {len(options.label)} labels are given for {len(options.bags)} '
                     'bags, must be one a bag')
    show = progress(options.quiet)
    runs = read_all(options.bags, options.label, options.skip, options.max_age, show)
    mean = mean_of([run.overall for run in runs]) if options.mean else None
    for run in runs:
        for note in run.notes:
            print(f'note: {run.label}: {note}', file=sys.stderr)
    print(format_table(runs, mean))
    folder = options.out or _default_folder(options.bags)
    parameters = {
        'bags': ', '.join(options.bags),
        'left out at the start (--skip)': f'{options.skip:g} s',
        'an estimate is available up to an age of (--max-age)': f'{options.max_age:g} s',
    }
    command = command_line('evaluate', arguments)
    written = write_evaluation(folder, runs, command, parameters, mean, show)
    if 'report.html' not in written:
        print('note: no report.html, as matplotlib is missing: pip install tsmcl_ros[plot]',
              file=sys.stderr)
    print(f'{", ".join(written)} are in {folder}')


def _localized(run: Run) -> str:
    found = sum(len(part.error) > 0 for part in run.vehicles.values())
    return f'{found} of {len(run.vehicles)}'


def _document(runs: Sequence[Run], mean: Metrics | None) -> dict[str, Any]:
    documents = {
        run.label: metrics_document(
            run.overall, {name: pool([part]) for name, part in run.vehicles.items()})
        for run in runs
    }
    document = documents[runs[0].label] if len(runs) == 1 else {'bags': documents}
    return {**document, 'mean': mean.as_json()} if mean else document


def _folder(run: Run) -> str:
    """Return the run's label as the name of a folder."""
    return re.sub(r'[^\w+-]', '_', run.label)


def _default_folder(bags: Sequence[str]) -> Path:
    first = Path(bags[0]).resolve()
    shown = Path(bags[0]).parent if Path(bags[0]).name else first.parent
    return shown / (f'{first.name}_eval' if len(bags) == 1 else 'comparison_eval')


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='evaluate',
        description='Compare the poses in bags (topics NAMESPACE/pose) with the ground truth '
                    'beside them (NAMESPACE/ground_truth): print a table, and write '
                    'metrics.json, trajectories for other tools and report.html.',
    )
    parser.add_argument('bags', nargs='+', metavar='BAG', help="a bag's folder")
    parser.add_argument('--label', nargs='+', default=[], metavar='NAME',
                        help="a name for each bag (default: its folder's)")
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='folder for the results (default: BAG_eval, or comparison_eval '
                             'beside the first of several bags)')
    parser.add_argument('--skip', type=a_number(0, unit='s'), default=0.0, metavar='S',
                        help="leave out the ground truth's first seconds (default: 0)")
    parser.add_argument('--max-age', type=a_number(0, unit='s'), default=MAX_AGE, metavar='S',
                        help='an estimate counts as available up to this age '
                             f'(default: {MAX_AGE:g})')
    parser.add_argument('--mean', action='store_true',
                        help='end the table with the mean over the bags')
    add_quiet(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
