"""Pages of sections, and the command that measures and writes them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
import datetime
import importlib
import os
from pathlib import Path
import platform

from goals import as_markdown, GOAL_HEADINGS, Section
import numpy as np


@dataclass(frozen=True)
class Page:
    """
    A page that a command writes.

    Parameters
    ----------
    title : str
        Of the page.
    command : str
        Which writes all of it.
    text : str
        How its figures are to be read.
    names : sequence of str
        Modules with a `measure`, a section each.

    """

    title: str
    command: str
    text: str
    names: Sequence[str]

    def run(self, doc: str) -> None:
        """Print every section as it comes, then write the page, as the command line asks."""
        parser = argparse.ArgumentParser(description=doc.splitlines()[1])
        parser.add_argument('names', nargs='*', metavar='NAME',
                            help=f'which sections: {", ".join(self.names)} (default: all)')
        parser.add_argument('--out', type=Path, help='page to write')
        options = parser.parse_args()
        for name in options.names:
            if name not in self.names:
                parser.error(f'{name} is not allowed, must be one of {", ".join(self.names)}')
        sections = []
        for name in options.names or self.names:
            section = importlib.import_module(name).measure()
            sections.append(section)
            print(f'{section.plain()}\n', flush=True)
        if options.out:
            options.out.write_text(self.markdown(sections))

    def markdown(self, sections: Sequence[Section]) -> str:
        """Return the page of these sections."""
        goals = [goal for section in sections for goal in section.goals]
        reached = sum(goal.is_reached for goal in goals)
        return '\n\n'.join([
            f'# {self.title}',
            f'Written by `{self.command}`, which anybody can run again, on '
            f'{datetime.date.today()}: {os.cpu_count()} cores ({platform.machine()}), Python '
            f'{platform.python_version()}, numpy {np.__version__}. {self.text}',
            f'{reached} of {len(goals)} goals are reached. What is missed, and why, stands in the '
            'chapters below.',
            as_markdown([GOAL_HEADINGS, *(goal.row() for goal in goals)]),
            *(section.markdown() for section in sections),
        ]) + '\n'
