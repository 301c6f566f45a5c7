"""
Try what goes wrong, print what was tried and lost, and write it as a page.

    python test/reliability/run.py [NAME ...] [--out docs/reliability.md]

NAME is one of the modules beside this one that have a `measure`; all of them by default.
"""

from __future__ import annotations

from pathlib import Path
import sys

sys.path.append(str(Path(__file__).resolve().parent.parent / 'benchmark'))

from pages import Page  # noqa: E402

PAGE = Page(
    'Reliability', 'make reliability',
    'What was tried, how often, and what was lost. Simulated worlds and seeds are not those that '
    'anything was tuned on.',
    ('liars', 'lost', 'clocks', 'hostile', 'links', 'long_run', 'speakers', 'determinism',
     'radios'))

if __name__ == '__main__':
    PAGE.run(__doc__)
