"""The files of an experiment: rows as CSV, what made them and what they show as JSON, a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import csv
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from itertools import groupby
import json
import math
from pathlib import Path
import platform
import tempfile
from typing import Any

import numpy as np
from tsmcl_ros.evaluation.monte_carlo import Case, Experiment, Outcome, Report, Result
from tsmcl_ros.types import Array, TsmclError

# What the JSON file says of the run, beside what follows from the experiment and its results.
RECORD = ('quick', 'seed', 'runs', 'workers', 'duration_s')


def write_results(folder: Path, name: str, experiment: Experiment, results: Sequence[Result],
                  report: Report, record: Mapping[str, Any]) -> list[str]:
    """
    Write NAME.csv with the rows, NAME.json with what made them and what they show, and NAME.png.

    Parameters
    ----------
    folder : Path
        It exists; files of the same names are overwritten.
    name : str
        Of the experiment.
    experiment, results, report
        What was tried, what came of it, and what it shows.
    record : mapping
        What else belongs into the JSON file, such as the seed.

    Returns
    -------
    list of str
        Names of the files; the figure is missing where matplotlib is.

    """
    _write_rows(folder / f'{name}.csv', results)
    document = {
        'experiment': name,
        'title': experiment.title,
        **record,
        'versions': {'tsmcl_ros': _version(), 'numpy': np.__version__,
                     'python': platform.python_version()},
        'config': _config(experiment),
        'cases': [dict(case) for case in experiment.cases()],
        'seconds': [result.outcome.seconds for result in results],
        'table': report.table,
        'findings': [asdict(finding) for finding in report.findings],
    }
    (folder / f'{name}.json').write_text(json.dumps(document, indent=2) + '\n', encoding='utf-8')
    written = [f'{name}.csv', f'{name}.json']
    try:
        experiment.draw(results, folder / f'{name}.png')
    except ModuleNotFoundError as error:
        if (error.name or '').partition('.')[0] != 'matplotlib':
            raise
        return written
    return [*written, f'{name}.png']


def read_results(folder: Path, name: str, experiment: Experiment
                 ) -> tuple[list[Result], dict[str, Any]]:
    """
    Return the results that `write_results` has written, and the record beside them.

    Floats have the six digits of the CSV file.

    Raises
    ------
    TsmclError
        If there are none, none of this experiment at this size, or not the rows of all runs.

    """
    path = folder / f'{name}.json'
    document = read_document(path)
    tasks = [(case, run) for case in experiment.cases() for run in range(document['runs'])]
    seconds = document.get('seconds', [])
    if document.get('config') != _config(experiment) or len(seconds) != len(tasks):
        raise TsmclError(f'{path}: was made with other settings or by another version; run the '
                         'experiment again')
    rows = _read_rows(folder / f'{name}.csv', [_lead(case, run) for case, run in tasks])
    return (
        [Result(case, run, Outcome(columns, each))
         for (case, run), columns, each in zip(tasks, rows, seconds, strict=True)],
        {name: document[name] for name in RECORD})


def read_document(path: Path) -> dict[str, Any]:
    """
    Return what a JSON file of an experiment says.

    Raises
    ------
    TsmclError
        If it is not one.

    """
    try:
        document = json.loads(path.read_text(encoding='utf-8'))
        found = {'title', 'findings', 'table', 'seed', 'runs', 'quick'} <= document.keys()
    except FileNotFoundError:
        raise TsmclError(f'{path}: is missing; run the experiment first') from None
    except (ValueError, AttributeError):
        found = False
    if not found:
        raise TsmclError(f'{path}: is not what `experiment` writes; remove it or run the '
                         'experiment again')
    return dict(document)


def prepare_folder(folder: Path) -> None:
    """
    Make a folder and hold that files can be written there, before hours are spent.

    Raises
    ------
    OSError
        If they cannot.

    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        pass


def _write_rows(path: Path, results: Sequence[Result]) -> None:
    """Write the rows of all results as CSV, each led by its case and run."""
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow([*results[0].case, 'run', *results[0].outcome.rows])
        for result in results:
            lead = _lead(result.case, result.run)
            columns = [_texts(column) for column in result.outcome.rows.values()]
            writer.writerows([*lead, *cells] for cells in zip(*columns, strict=True))


def _read_rows(path: Path, leads: Sequence[list[str]]) -> list[dict[str, Array]]:
    """
    Return the columns of each result from a CSV file, whose rows begin with these leads.

    Raises
    ------
    TsmclError
        If they are others, or not such rows.

    """
    try:
        with path.open(encoding='utf-8', newline='') as file:
            heading, *rows = csv.reader(file)
        lead = heading.index('run') + 1
        found = [
            (key, {name: _values(cells) for name, cells in zip(
                heading[lead:], zip(*(row[lead:] for row in group), strict=True), strict=True)})
            for key, group in groupby(rows, key=lambda row: row[:lead])]
    except (ValueError, csv.Error):
        raise TsmclError(f'{path}: does not hold rows of results; run the experiment again'
                         ) from None
    if [key for key, _ in found] != list(leads):
        raise TsmclError(f'{path}: holds rows of {len(found)} runs, must hold those of '
                         f'{len(leads)} that {path.stem}.json tells of; run the experiment again')
    return [columns for _, columns in found]


def _lead(case: Case, run: int) -> list[str]:
    """Return the cells that the rows of a result begin with."""
    return [*map(str, case.values()), str(run)]


def _version() -> str:
    """Return the package's version; sources that were never installed do not know it."""
    try:
        return version('tsmcl_ros')
    except PackageNotFoundError:
        return 'not installed'


def _texts(column: Array) -> list[str]:
    """Return a column's cells: floats to six digits, nothing where they are not known."""
    if column.dtype.kind == 'f':
        return ['' if math.isnan(value) else f'{value:.6g}' for value in column.tolist()]
    return [str(value) for value in column.tolist()]


def _config(experiment: Experiment) -> Any:
    """Return the sizes of an experiment as JSON has them."""
    return json.loads(json.dumps(asdict(experiment)))  # type: ignore[call-overload]


def _values(cells: Sequence[str]) -> Array:
    """Return a column from its cells: whole numbers, or floats with NaN where nothing is known."""
    try:
        return np.array([int(cell) for cell in cells])
    except ValueError:
        return np.array([float(cell) if cell else math.nan for cell in cells])
