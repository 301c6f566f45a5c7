"""
Whose time to believe, where the messages of a fleet tell different ones.

A clock that is wrong looks like a bag that starts over: stamps far from all others. What most of
the vehicles tell is the time. Messages of the others are held back: if most follow, as in a bag
that is looped, nothing has been lost, and if not, they are given up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Again = Callable[[], None]

# So many messages of a vehicle that tells another time are held back at most.
_MOST_HELD = 1000


@dataclass
class _Stray:
    """A vehicle that tells another time: at first, since others spoke, and by now [s]."""

    begin: float
    since: float
    stamp: float
    spoken: int


@dataclass(frozen=True)
class Held:
    """A message held back: what it is, whose, of when [s], and what hands it over again."""

    what: str
    vehicle: int
    stamp: float
    again: Again


class Timeline:
    """
    The time that V vehicles tell.

    Parameters
    ----------
    vehicles : int
        V.

    Attributes
    ----------
    span : float
        What is further away is another time, and who was silent for longer has no say [s].
    given_up : list of Held
        Messages of vehicles that told another time than most, for somebody to report.

    """

    def __init__(self, vehicles: int, span: float):
        self.given_up: list[Held] = []
        self.span = span
        self._latest = np.full(vehicles, -np.inf)
        self._strays: dict[int, _Stray] = {}
        self._held: list[Held] = []
        self._spoken = 0

    def accept(self, vehicle: int, stamp: float) -> None:
        """Take note of a vehicle's message that is in time."""
        self._spoken += 1
        self._latest[vehicle] = max(self._latest[vehicle], stamp)
        if self._strays.pop(vehicle, None):
            self._give_up(vehicle)

    def wins(self, vehicle: int, stamp: float, now: float, leaps: bool) -> bool:
        """
        Return whether another time that a vehicle tells has become that of most.

        Parameters
        ----------
        vehicle, stamp : int, float
            Who, and what it tells [s].
        now : float
            What is taken to be the time [s].
        leaps : bool
            Its time has jumped, so that it does not stand by the old one any more; otherwise it
            has always told another one.

        """
        stray = self._strays.get(vehicle)
        if stray is None or abs(stamp - stray.stamp) > self.span:
            self._give_up(vehicle)
            stray = self._strays[vehicle] = _Stray(stamp, stamp, stamp, self._spoken)
        if stray.spoken != self._spoken:
            stray.spoken, stray.since = self._spoken, stamp
        stray.stamp = stamp
        followers = self._followers(stamp)
        stands = self._latest >= now - self.span
        if leaps:
            stands[followers] = False
        return bool(len(followers) > stands.sum() or stamp - stray.since > self.span)

    def hold(self, held: Held) -> bool:
        """Hold a stray's message back; return False if it has strayed for too long."""
        own = sum(other.vehicle == held.vehicle for other in self._held)
        if abs(held.stamp - self._strays[held.vehicle].begin) > self.span or own >= _MOST_HELD:
            self._give_up(held.vehicle)
            return False
        self._held.append(held)
        return True

    def follow(self, stamp: float) -> tuple[float, list[Held]]:
        """Return when those began who tell this time, and what was held back of them."""
        followers = self._followers(stamp)
        begin = min(self._strays[vehicle].begin for vehicle in followers)
        held = [one for one in self._held if one.vehicle in followers]
        self._held = [one for one in self._held if one.vehicle not in followers]
        for vehicle in list(self._strays):
            self._give_up(vehicle)
        self._strays = {}
        return begin, held

    def _followers(self, stamp: float) -> list[int]:
        return [vehicle for vehicle, stray in self._strays.items()
                if abs(stray.stamp - stamp) <= self.span]

    def _give_up(self, vehicle: int) -> None:
        self.given_up += [held for held in self._held if held.vehicle == vehicle]
        self._held = [held for held in self._held if held.vehicle != vehicle]
