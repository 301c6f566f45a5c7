"""What the benchmarks share: medians of repeated timings."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
import time
from typing import Any


def seconds(work: Callable[[], Any], repeat: int = 5) -> float:
    """Return the median time that some work takes [s]."""
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return median(times)
