"""Silence as evidence: which known anchors were not heard, though they might have been."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tsmcl_ros.types import ANCHOR, Array, MessageError, Observation, Silence


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
    """

    def __init__(self, mode: str, vehicles: int, dimension: int):
        self.mode = mode
        self.identity = np.zeros(0, np.int64)
        self.position = np.zeros((0, dimension), np.float32)
        self.max_range = np.zeros(0, np.float32)
        self.known = np.zeros((vehicles, 0), bool)

    def learn_map(self, anchors: Observation) -> None:
        """
        Take over an anchor map (V = 1), replacing what is known of its anchors.

        Raises
        ------
        MessageError
            If one id stands in it at two positions.
        """
        identity, first = np.unique(anchors.sender[0], return_index=True)
        if len(identity) < anchors.sender.shape[1]:
            twice = np.setdiff1d(np.arange(anchors.sender.shape[1]), first)[0]
            raise MessageError(
                f'anchor map: id {anchors.sender[0, twice]} stands in it more than once, must be '
                'there once')
        if self.mode == 'map':
            self._learn(anchors, np.ones((len(self.known), len(identity)), bool))

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
        if not len(self.identity):
            return observation
        silent = self.known & ~self._heard(observation)
        distance = np.linalg.norm(centre[:, None] - self.position, axis=2)
        # A NaN distance or range compares false: then the anchor stays in.
        silent &= ~(distance > 2 * self.max_range + reach[:, None])
        count = int(silent.sum(axis=1).max())
        order = np.argsort(~silent, axis=1, kind='stable')[:, :count]
        return replace(observation, silent=Silence(
            known=np.take_along_axis(silent, order, axis=1), sender=self.identity[order],
            position=self.position[order], max_range=self.max_range[order]))

    def _heard(self, observation: Observation) -> Array:
        """Return which anchors (V, A) bool each vehicle heard, directly or relayed."""
        vehicle, row = np.nonzero(observation.heard)
        sender = observation.sender[vehicle, row]
        index = np.searchsorted(self.identity, sender)
        index[index == len(self.identity)] = 0
        match = self.identity[index] == sender
        heard = np.zeros(self.known.shape, bool)
        heard[vehicle[match], index[match]] = True
        return heard

    def _remember(self, observation: Observation) -> None:
        """Learn the anchors that somebody hears, each for those who hear it."""
        rows = observation.heard & (observation.kind == ANCHOR) & (observation.hops == 1)
        vehicle, row = np.nonzero(rows)
        identity, first, column = np.unique(
            observation.sender[vehicle, row], return_index=True, return_inverse=True)
        if not len(identity):
            return
        seen = np.zeros((len(self.known), len(identity)), bool)
        seen[vehicle, column.reshape(-1)] = True
        at = vehicle[first], row[first]
        self._learn(replace(
            Observation.empty(1, 0, 2, observation.stamp), sender=identity[None],
            position=observation.position[at][None], max_range=observation.max_range[at][None],
        ), seen)

    def _learn(self, anchors: Observation, known: Array) -> None:
        """Merge anchors (V = 1) that the vehicles know (V, A) bool; the new positions win."""
        identity = np.concatenate([anchors.sender[0], self.identity])
        position = np.concatenate([anchors.position[0], self.position])
        max_range = np.concatenate([anchors.max_range[0], self.max_range])
        merged, first = np.unique(identity, return_index=True)
        both = np.zeros((len(self.known), len(merged)), bool)
        both[:, np.searchsorted(merged, self.identity)] = self.known
        both[:, np.searchsorted(merged, anchors.sender[0])] |= known
        self.identity, self.known = merged, both
        self.position = position[first].astype(np.float32)
        self.max_range = max_range[first].astype(np.float32)
