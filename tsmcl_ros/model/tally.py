"""What was left out of what vehicles heard, counted by sender."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

# Who makes up ids can make up four billion: so many are kept by name.
_MOST_NAMED = 100


class Tally:
    """
    Counts what V vehicles heard in vain.

    Attributes
    ----------
    ignored : (V,) int
        How many beacons and ranges each vehicle has heard in vain.
    senders : Counter of int
        How many there were of each sender, of the first hundred senders.
    reason : str
        Why, of the last sender that came new.

    """

    def __init__(self, vehicles: int):
        self.ignored = np.zeros(vehicles, int)
        self.senders: Counter[int] = Counter()
        self.reason = ''
        self._told: set[int] = set()

    def count(self, vehicle: int, senders: list[int], reason: str = '') -> None:
        """Count what a vehicle heard of some senders, for a reason."""
        self.ignored[vehicle] += len(senders)
        named = len(self.senders)
        self.senders.update(sender for sender in senders
                            if sender in self.senders or len(self.senders) < _MOST_NAMED)
        if len(self.senders) > named:
            self.reason = reason

    def news(self) -> dict[int, int]:
        """Return the counts of the senders that were not told of by this method yet."""
        fresh = {sender: count for sender, count in self.senders.items()
                 if sender not in self._told}
        self._told.update(fresh)
        return fresh


def listed(counts: Mapping[int, int]) -> str:
    """Return how many there are of each sender, as a text."""
    return ', '.join(f'{count} of id {sender}' for sender, count in sorted(counts.items()))


def untrue_note(counts: Mapping[int, int], reason: str) -> str:
    """Say whose beacons, and how many of each sender, were left out, and why."""
    return f'left out beacons that cannot be true, {listed(counts)}, such as: {reason}'
