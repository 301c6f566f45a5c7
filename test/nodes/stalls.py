"""Whether the machine stood still, for tests of how long something takes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
import os
import threading
import time
from typing import TypeVar

T = TypeVar('T')
STALL = 0.25  # s, after which a process that ought to run no longer keeps any time
_TICK = 0.02  # s
_TRIES = 4


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


def calmly(act: Callable[[int], T]) -> T:
    """
    Do something, and again if the machine stood still meanwhile, and return what came of it.

    That is no judgement of what came of it: on a machine that runs it is done once.

    Parameters
    ----------
    act : callable
        Takes the number of the try, from 0.

    """
    for number in range(_TRIES):
        with Stalls() as stalls:
            result = act(number)
        if stalls.longest < STALL:
            break
    return result
