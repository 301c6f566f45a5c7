"""What recurs with time, on whatever clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

_ROUNDING = 1e-6  # s, more than a stamp of today loses as a float


@dataclass
class Recurring:
    """Meets each multiple of a period [s] once."""

    period: float
    act: Callable[[float], None]
    count: int | None = None

    @property
    def next(self) -> float:
        """Stamp of the next multiple [s]."""
        return 0.0 if self.count is None else (self.count + 1) * self.period

    def begin(self, now: float) -> None:
        """Wait for the multiple after this time."""
        self.count = self._latest(now)

    def pass_time(self, now: float) -> None:
        """Act on the last multiple that has been reached, if it is not the one acted on."""
        count = self._latest(now)
        # The first time seen may lie anywhere between two multiples: the past one is gone.
        late = self.count is None and now - count * self.period > _ROUNDING
        if count != self.count:
            self.count = count
            if not late:
                self.act(count * self.period)

    def _latest(self, now: float) -> int:
        return math.floor((now + _ROUNDING) / self.period)
