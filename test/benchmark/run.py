"""
Run the benchmarks, print what they find, and write it as a page.

    python test/benchmark/run.py [NAME ...] [--out docs/performance.md]

NAME is one of the modules beside this one that have a `measure`; all of them by default.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import os
from pathlib import Path
import platform

from goals import as_markdown, GOAL_HEADINGS, Section
import numpy as np

NAMES = (
    'fleets',
    'peers',
    'search',
    'methods',
    'codec',
    'latency',
    'bag',
    'medium',
    'cores',
    'network',
)
COMMAND = 'make bench'


def main() -> None:
    """Print every section as it comes, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help=f'which benchmarks: {", ".join(NAMES)} (default: all)')
    parser.add_argument('--out', type=Path, help='page to write')
    options = parser.parse_args()
    for name in options.names:
        if name not in NAMES:
            parser.error(f'{name} is not allowed, must be one of {", ".join(NAMES)}')
    sections = []
    for name in options.names or NAMES:
        section = importlib.import_module(name).measure()
        sections.append(section)
        print(f'{section.plain()}\n', flush=True)
    if options.out:
        options.out.write_text(_page(sections))


def _page(sections: list[Section]) -> str:
    """Return the page of all sections."""
    goals = [goal for section in sections for goal in section.goals]
    reached = sum(goal.is_reached for goal in goals)
    return '\n\n'.join([
        '# Performance',
        f'Written by `{COMMAND}`, which anybody can run again, on {datetime.date.today()}: '
        f'{os.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}, '
        f'numpy {np.__version__}. Figures are medians. Peers, limits and this package ran side '
        'by side in one run, so trust the ratios more than the times.',
        f'{reached} of {len(goals)} goals are reached. What is missed, and why, stands in the '
        'chapters below.',
        as_markdown([GOAL_HEADINGS, *(goal.row() for goal in goals)]),
        *(section.markdown() for section in sections),
    ]) + '\n'


if __name__ == '__main__':
    main()
