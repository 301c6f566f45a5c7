"""The page that sets the papers' claims beside what experiments measured, from their files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import os
from pathlib import Path
from typing import Any

from tsmcl_ros.evaluation.results import read_document
from tsmcl_ros.types import TsmclError

_INTRODUCTION = """# What the papers say, and what we measure

Every row is measured by `experiment NAME`, at the papers' conditions, and judged by what came out;
the limit is what an exact filter, or a proof, allows with the same information. Intervals hold
95 %. This page is written by `experiment report` from the files that the experiments leave.
"""


def write_reproduction(folder: Path, names: Sequence[str], page: Path) -> list[str]:
    """
    Write a Markdown page of all experiments of which a folder holds results.

    Parameters
    ----------
    folder : Path
        Where NAME.json and NAME.png are.
    names : sequence of str
        The experiments, in the page's order; those without results are left out.
    page : Path
        The page; it shows the figures from where they are.

    Returns
    -------
    list of str
        The experiments that the folder has no results of.

    Raises
    ------
    TsmclError
        If there are no results at all, or a file is not one of an experiment.

    """
    documents = {name: read_document(folder / f'{name}.json') for name in names
                 if (folder / f'{name}.json').is_file()}
    if not documents:
        raise TsmclError(f'{folder}: holds no results of experiments, must hold at least one '
                         'NAME.json: run `experiment NAME` first')
    lines = [_INTRODUCTION, *_summary(documents)]
    for name, document in documents.items():
        figure = folder / f'{name}.png'
        lines += _section(name, document, os.path.relpath(figure, page.parent)
                          if figure.is_file() else None)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text('\n'.join(lines), encoding='utf-8')
    return [name for name in names if name not in documents]


def _summary(documents: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield one table of all findings."""
    rows = [['experiment', 'claim or goal', 'we measure', 'limit', 'verdict']]
    for name, document in documents.items():
        for finding in document['findings']:
            rows.append([f'[{name}](#{name})', finding['claim'], finding['measured'],
                         finding['limit'] or '-', finding['verdict']])
    yield from _table(rows)


def _section(name: str, document: dict[str, Any], figure: str | None) -> Iterator[str]:
    """Yield what there is to say of one experiment."""
    quick = ' --quick' if document['quick'] else ''
    yield f'\n## {name}\n'
    yield f'{document["title"][:1].upper()}{document["title"][1:]}.\n'
    yield (f'`experiment {name}{quick} --seed {document["seed"]} --runs {document["runs"]}`'
           + (', a quick run, too small to judge by\n' if quick else '\n'))
    if figure is not None:
        yield f'![{document["title"]}]({Path(figure).as_posix()})\n'
    yield from _table(document['table'])


def _table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a Markdown table."""
    heading, *body = [[str(cell).replace('|', '\\|') for cell in row] for row in rows]
    yield f'| {" | ".join(heading)} |'
    yield f'|{"---|" * len(heading)}'
    for row in body:
        yield f'| {" | ".join(row)} |'
