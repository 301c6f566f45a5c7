"""
Run the benchmarks, print what they find, and write it as a page.

    python test/benchmark/run.py [NAME ...] [--out docs/performance.md]

NAME is one of the modules beside this one that have a `measure`; all of them by default.
"""

from __future__ import annotations

from pages import Page

PAGE = Page(
    'Performance', 'make bench',
    'Figures are medians. Peers, limits and this package ran side by side in one run, so trust '
    'the ratios more than the times.',
    ('fleets', 'peers', 'search', 'methods', 'codec', 'latency', 'bag', 'medium', 'cores',
     'network'))

if __name__ == '__main__':
    PAGE.run(__doc__)
