"""What anchors say of themselves, held against the map and against what they said before."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.silence import Anchors, TOLERANCE
from tsmcl_ros.types import ANCHOR, Array, Observation, pair, UNTRUE


class Claims:
    """
    Where anchors are, or last claimed to be: they are surveyed, and stay where they are.

    Parameters
    ----------
    dimension : int
        D.

    """

    def __init__(self, dimension: int):
        self._map = self._last = Anchors.none(dimension)

    def learn_map(self, anchors: Anchors) -> None:
        """Take over where some anchors are."""
        self._map = anchors

    def forget(self) -> None:
        """Forget what was claimed, but not the map."""
        self._last = Anchors.none(self._map.position.shape[1])

    def disproved(self, observation: Observation) -> Array:
        """
        Return the pairs (M,) of vehicle and sender whose claims cannot be true.

        These are anchors that are not where the map has them, or where they claimed to be when
        last heard, or that claim two places; vehicles with the id of an anchor; and whose rows
        alone show it. What is claimed now is what later claims are held against.
        """
        vehicle, row = np.nonzero(observation.heard)
        sender = observation.sender[vehicle, row]
        position = observation.position[vehicle, row]
        anchor = observation.kind[vehicle, row] == ANCHOR
        index, mapped = self._map.find(sender)
        false = mapped & ~anchor
        false[mapped] |= _apart(position[mapped], self._map.position[index[mapped]])
        told = anchor & ~mapped & (observation.hops[vehicle, row] == 1)
        false[told] = self._changed(sender[told], position[told])
        false |= ~anchor & self._last.find(sender)[1]
        false |= observation.kind[vehicle, row] == UNTRUE
        return np.unique(pair(vehicle[false], sender[false]))

    def _changed(self, sender: Array, position: Array) -> Array:
        """Return which claims (M,) differ from the last ones, which they replace."""
        identity, first, which = np.unique(sender, return_index=True, return_inverse=True)
        index, known = self._last.find(sender)
        # Of two senders with one id nobody knows which is the right one.
        twice = np.bincount(which, _apart(position, position[first][which]), len(first)) > 0
        changed = twice[which]
        changed[known] |= _apart(position[known], self._last.position[index[known]])
        news = Anchors(identity, position[first], np.full(len(first), np.nan, np.float32))
        self._last = self._last.updated(news)
        return np.asarray(changed)


def _apart(position: Array, place: Array) -> Array:
    """Return which positions (M, D) are not at a place (M, D)."""
    return np.asarray(~(np.abs(position - place).max(axis=1, initial=0) <= TOLERANCE))
