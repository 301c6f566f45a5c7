"""
What the benchmarks share: medians of repeated timings.

They are of processor time, which other work on the machine disturbs less; none of what is timed
waits for anything.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
import time
from typing import Any


def seconds(work: Callable[[], Any], repeat: int = 5) -> float:
    """Return the median processor time that some work takes [s]."""
    times = []
    for _ in range(repeat):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return median(times)
