"""Whether the machine stood still, for tests of how long something takes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
import os
import threading
import time

import pytest

STALL = 0.25  # s, after which a process that ought to run no longer keeps any time
ARREARS = 20.0  # s, in which a node has long caught up with what it has got
_TICK = 0.02  # s
_TRIES = 3


class Stalls(AbstractContextManager['Stalls']):
    """
    Watches each processor for times in which it runs nobody who wants to; a context manager.

    Attributes
    ----------
    longest : float
        The longest such time so far [s].

    """

    def __init__(self) -> None:
        self.longest = 0.0
        self._over = threading.Event()
        self._threads = [threading.Thread(target=self._watch, args=(processor,), daemon=True)
                         for processor in os.sched_getaffinity(0)]

    def _watch(self, processor: int) -> None:
        os.sched_setaffinity(0, {processor})  # of this thread alone
        before = time.monotonic()
        while not self._over.is_set():
            time.sleep(_TICK)
            now = time.monotonic()
            self.longest = max(self.longest, now - before - _TICK)
            before = now

    def __enter__(self) -> Stalls:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()


def calmly(act: Callable[[int], None]) -> None:
    """
    Do something, and again if it failed while the machine stood still.

    On a machine that runs it is done once, and its failure counts.

    Parameters
    ----------
    act : callable
        Takes the number of the try, from 0.

    """
    for number in range(_TRIES):
        with Stalls() as stalls:
            try:
                return act(number)
            except (AssertionError, pytest.fail.Exception):
                if stalls.longest < STALL or number == _TRIES - 1:
                    raise
