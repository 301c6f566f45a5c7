"""Anchors that are known: where they must be, and whose silence is evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from tsmcl_ros.types import ANCHOR, Array, MessageError, Observation, Silence

TOLERANCE = 1.0  # m, how far an anchor may claim to be from where it is known to be


@dataclass(frozen=True, eq=False)
class Anchors:
    """
    A table of anchors.

    Attributes
    ----------
    identity : (A,) int64
        Increasing.
    position : (A, D) float32
        [m].
    max_range : (A,) float32
        [m], NaN where unknown.

    """

    identity: Array
    position: Array
    max_range: Array

    @classmethod
    def none(cls, dimension: int) -> Anchors:
        """Return a table without rows."""
        return cls(np.zeros(0, np.int64), np.zeros((0, dimension), np.float32),
                   np.zeros(0, np.float32))

    @classmethod
    def of(cls, observation: Observation, vehicle: Array, row: Array) -> Anchors:
        """Return some rows (A,) of some vehicles (A,), in increasing order of their ids."""
        at = vehicle, row
        return cls(observation.sender[at], observation.position[at], observation.max_range[at])

    def updated(self, news: Anchors) -> Anchors:
        """Return the rows of both; where both have an anchor, the news win."""
        identity, first = np.unique(
            np.concatenate([news.identity, self.identity]), return_index=True)
        return Anchors(
            identity,
            np.concatenate([news.position, self.position])[first].astype(np.float32),
            np.concatenate([news.max_range, self.max_range])[first].astype(np.float32))

    def find(self, identity: Array) -> tuple[Array, Array]:
        """Return the rows of some ids, and whether they are there, both in the ids' shape."""
        if not len(self.identity):
            return np.zeros(identity.shape, int), np.zeros(identity.shape, bool)
        index = np.minimum(np.searchsorted(self.identity, identity), len(self.identity) - 1)
        return index, self.identity[index] == identity


class KnownAnchors:
    """
    The anchors that V vehicles know of, and so can miss.

    Parameters
    ----------
    mode : str
        'map': every vehicle knows the anchors of the map; 'memory': a vehicle knows those it
        has heard before; 'none': nobody knows any.
    vehicles, dimension : int
        V and D.

    Attributes
    ----------
    mapped : Anchors
        Those of the map.
    table : Anchors
        All that somebody knows.
    known : (V, A) bool
        Who knows which.

    """

    def __init__(self, mode: str, vehicles: int, dimension: int):
        self.mode = mode
        self.mapped = self.table = Anchors.none(dimension)
        self.known = np.zeros((vehicles, 0), bool)

    def forget(self) -> None:
        """Forget what was heard, but not the map."""
        if self.mode == 'memory':
            self.known = np.zeros_like(self.known)

    def learn_map(self, anchors: Observation) -> None:
        """
        Take over an anchor map (V = 1), which may be one of several that complete each other.

        Raises
        ------
        MessageError
            If one id stands in it more than once.

        """
        identity, first = np.unique(anchors.sender[0], return_index=True)
        if len(identity) < anchors.sender.shape[1]:
            twice = np.setdiff1d(np.arange(anchors.sender.shape[1]), first)[0]
            raise MessageError(
                f'anchor map: id {anchors.sender[0, twice]} stands in it more than once, must be '
                'there once')
        news = Anchors.of(anchors, np.zeros_like(first), first)
        self.mapped = self.mapped.updated(news)
        if self.mode == 'map':
            self._learn(news, np.ones((len(self.known), len(identity)), bool))

    def check(self, table: Observation, what: str) -> None:
        """
        Hold that every anchor of a table (V = 1) is where the map has it.

        Raises
        ------
        MessageError
            Naming the first one that is not, and what the table is.

        """
        if not len(self.mapped.identity):
            return
        index, there = self.mapped.find(table.sender)
        place = self.mapped.position.take(index, axis=0)
        wrong = there & (np.abs(table.position - place).max(axis=2, initial=0) > TOLERANCE)
        if wrong.any():
            raise MessageError(
                f'{what}: anchor {table.sender[wrong][0]} claims '
                f'{table.position[wrong][0].tolist()} m, must be where the anchor map has '
                f'it, {place[wrong][0].tolist()} m, to {TOLERANCE:g} m')

    def listen(self, observation: Observation, centre: Array, reach: Array) -> Observation:
        """
        Return the observation with the silence of the known anchors that it lacks.

        Only anchors count whose own silence can say something: those within twice their range
        of where the vehicle may be.

        Parameters
        ----------
        observation : Observation
            Of V vehicles.
        centre : (V, D) float
            Where each vehicle was estimated [m]; NaN where it was not.
        reach : (V,) float
            How far from there it may be [m].

        """
        if self.mode == 'none':
            return observation
        if self.mode == 'memory':
            self._remember(observation)
        if not self.known.any():
            return observation
        anchors = self.table
        silent = self.known & ~self._heard(observation)
        distance = np.linalg.norm(centre[:, None] - anchors.position, axis=2)
        # A NaN distance or range compares false: then the anchor stays in.
        silent &= ~(distance > 2 * anchors.max_range + reach[:, None])
        count = int(silent.sum(axis=1).max())
        order = np.argsort(~silent, axis=1, kind='stable')[:, :count]
        return replace(observation, silent=Silence(
            known=np.take_along_axis(silent, order, axis=1), sender=anchors.identity[order],
            position=anchors.position[order], max_range=anchors.max_range[order]))

    def met(self, observation: Observation) -> Array:
        """Return how many of the anchors that it knows each vehicle (V,) hears."""
        return np.asarray((self.known & self._heard(observation)).sum(axis=1))

    def _heard(self, observation: Observation) -> Array:
        """Return which anchors (V, A) bool each vehicle heard, directly or relayed."""
        index, there = self.table.find(observation.sender)
        heard = np.zeros(self.known.shape, bool)
        heard[np.nonzero(there)[0], index[there]] = True
        return heard

    def _remember(self, observation: Observation) -> None:
        """Learn the anchors that somebody hears, each for those who hear it."""
        rows = observation.heard & (observation.kind == ANCHOR) & (observation.hops == 1)
        vehicle, row = np.nonzero(rows)
        identity, first, column = np.unique(
            observation.sender[vehicle, row], return_index=True, return_inverse=True)
        seen = np.zeros((len(self.known), len(identity)), bool)
        seen[vehicle, column.reshape(-1)] = True
        self._learn(Anchors.of(observation, vehicle[first], row[first]), seen)

    def _learn(self, anchors: Anchors, known: Array) -> None:
        """Merge anchors that the vehicles know (V, A) bool into the table."""
        merged = self.table.updated(anchors)
        both = np.zeros((len(self.known), len(merged.identity)), bool)
        both[:, np.searchsorted(merged.identity, self.table.identity)] = self.known
        both[:, np.searchsorted(merged.identity, anchors.identity)] |= known
        self.table, self.known = merged, both
