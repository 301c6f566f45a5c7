"""Rejected messages, told of without flooding the log."""

from __future__ import annotations

from collections.abc import Callable
import math
import time
from typing import Any


class Rejections:
    """
    Reports of rejected messages, at most one in five seconds a topic, with a count.

    Parameters
    ----------
    log
        Takes a line.
    clock
        Returns seconds that never go back.

    """

    interval = 5.0

    def __init__(
        self, log: Callable[[str], Any], clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._log = log
        self._clock = clock
        self._pending: dict[str, tuple[int, Exception]] = {}
        self._reported: dict[str, float] = {}

    def add(self, topic: str, error: Exception) -> None:
        """Count a rejected message; the first of a topic is reported at once."""
        count, _ = self._pending.get(topic, (0, error))
        self._pending[topic] = count + 1, error
        self.report()

    def report(self, at_once: bool = False) -> None:
        """Report what has waited for long enough, or everything."""
        if not self._pending:
            return
        now = self._clock()
        for topic, (count, error) in list(self._pending.items()):
            if at_once or now - self._reported.get(topic, -math.inf) >= self.interval:
                more = f' ({count} messages rejected since the last report)' if count > 1 else ''
                self._log(f'{topic}: message rejected: {error}{more}')
                self._reported[topic] = now
                del self._pending[topic]
