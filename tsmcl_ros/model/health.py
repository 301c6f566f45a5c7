"""
Whether vehicles are where they are believed to be, and who says otherwise.

Before an epoch's beacons are taken in they are held against the prediction. A right belief is
contradicted by a beacon now and then; a vehicle that is somewhere else is contradicted by most of
them, and a sender that lies, or whose radio is broken, contradicts again and again what all others
agree on. Two hidden Markov models weigh that, one for each vehicle (at its place or lost), one for
each sender that a vehicle hears (sound or not). Suspects do not speak against a belief, and whom
the majority of an epoch's beacons contradicts has nobody to suspect.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.consistency import Deviations
from tsmcl_ros.types import Array, Observation, pairs_of, split

OK, STALE, LOST = 0, 1, 2

# Of what a lost vehicle hears, and of what an unsound sender says, half contradicts by chance.
BY_CHANCE = 0.5
# Nobody is surer than this of a vehicle being lost, lest it take long to see it found.
_SUREST = math.log(1e3)
# What is held against a sender fades, lest one that is never met again stays a suspect.
_MEMORY = 0.99
# Log odds below which nothing is held against it any more.
_FORGOTTEN = 0.01


@dataclass(frozen=True)
class HealthConfig(Config):
    """When an estimate is stale, when a vehicle is lost, and whom it suspects."""

    stale_after: float = param(
        1.5, 'call an estimate stale when no beacon was heard for this long',
        unit='s', above=0.0, live=True)
    contradiction: float = param(
        3.0, 'a beacon contradicts a prediction that it is this far from, in standard deviations '
        'of all that is uncertain', above=0.0, high=100.0, live=True)
    contradiction_rate: float = param(
        0.05, 'share of sound beacons that contradict a right prediction', above=0.0, high=0.4)
    loss_rate: float = param(
        0.001, 'how probable it is that a vehicle gets lost from one epoch to the next',
        above=0.0, high=0.4, live=True)
    suspicion: float = param(
        10_000.0, 'a sender is suspected when what it says is this many times more likely of '
        'one that is not sound', above=1.0, high=1e12, live=True)


class HealthMonitor:
    """
    Watches over V vehicles.

    Parameters
    ----------
    config : HealthConfig
    vehicles : int
        V.

    Attributes
    ----------
    lost : (V,) float64
        Probability that a vehicle is not where it is believed to be.

    """

    def __init__(self, config: HealthConfig, vehicles: int):
        self.config = config
        self.lost = np.zeros(vehicles)
        self._pair = np.zeros(0, np.int64)
        self._odds = np.zeros(0)
        share = config.contradiction_rate
        self._for, self._against = (math.log(BY_CHANCE / share),
                                    math.log(BY_CHANCE / (1 - share)))

    def forget(self, vehicle: Array | int) -> None:
        """Begin again with some vehicles, whose beliefs are replaced by what somebody says."""
        self.lost[vehicle] = 0
        self._drop(np.isin(split(self._pair)[0], vehicle))

    def doubt(self, vehicle: Array) -> None:
        """Take vehicles (V,) bool for lost until beacons confirm them: they were placed anew."""
        if not vehicle.any():
            return
        self.lost[vehicle] = 1 - 1 / (1 + math.exp(_SUREST))
        self._drop(vehicle[split(self._pair)[0]])

    def judge_vehicles(self, deviations: Deviations, usual: Array | bool = False
                       ) -> tuple[Array, Array]:
        """
        Learn from how an epoch's beacons agree with the prediction whether vehicles are lost.

        What is usual, (V, R) bool, does not count against a vehicle, but against the sender.

        Returns
        -------
        contradicts, counts : (V, R) bool
            What contradicts the prediction, and what says anything.

        """
        contradicts = deviations.contradicts(self.config.contradiction)
        counts = deviations.counts(self.config.contradiction)
        heeded = counts & ~(self.suspected(pairs_of(deviations.sender)) | usual)
        self._judge_vehicles(heeded.sum(axis=1), (contradicts & heeded).sum(axis=1))
        return contradicts, counts

    def judge_senders(self, pairs: Array, contradicts: Array, counts: Array, disproved: Array
                      ) -> None:
        """
        Learn of senders.

        Parameters
        ----------
        pairs : (V, R) int64
            Of vehicle and sender.
        contradicts, counts : (V, R) bool
            Who contradicts what is known of the vehicle, and who says anything.
        disproved : (M,) int64
            Pairs whose sender contradicts itself or the map.

        """
        heeded = counts & ~self.suspected(pairs)
        outvoted = 2 * (contradicts & heeded).sum(axis=1) > heeded.sum(axis=1)
        counts = counts & ~outvoted[:, None]
        self._judge_senders(np.concatenate([pairs[counts], disproved]), np.concatenate(
            [contradicts[counts], np.ones(len(disproved), bool)]))

    def shunned(self, observation: Observation) -> Array:
        """Return the pairs (M,) of vehicles and those that they suspect, if not most of them."""
        suspected = self.suspected(pairs_of(observation.sender)) & observation.heard
        most = 2 * suspected.sum(axis=1) > observation.heard.sum(axis=1)
        vehicle, _ = split(self.suspicious)
        return self.suspicious[~most[vehicle]]

    def suspected(self, pairs: Array) -> Array:
        """Return which of these pairs of a vehicle and a sender are of one that it suspects."""
        return np.isin(pairs, self.suspicious)

    def suspects(self) -> list[list[int]]:
        """Return the ids that each vehicle suspects."""
        found: list[list[int]] = [[] for _ in self.lost]
        vehicle, sender = split(self.suspicious)
        for index, identity in zip(vehicle.tolist(), sender.tolist(), strict=True):
            found[index].append(identity)
        return found

    @property
    def suspicious(self) -> Array:
        """(M,) int64: pairs of a vehicle and a sender that it suspects."""
        return self._pair[self._odds >= math.log(self.config.suspicion)]

    def _judge_vehicles(self, number: Array, against: Array) -> None:
        """Weigh what (V,) beacons, and how many against it, say of each vehicle's belief."""
        change = against * self._for + (number - against) * self._against
        prior = self.lost + (1 - self.lost) * np.where(number > 0, self.config.loss_rate, 0)
        with np.errstate(divide='ignore'):
            odds = np.log(prior) - np.log1p(-prior) + change
        self.lost = np.where(number > 0, 1 / (1 + np.exp(-np.minimum(odds, _SUREST))), self.lost)

    def _judge_senders(self, pairs: Array, contradicts: Array) -> None:
        """Weigh what was heard (M,) of the senders of pairs (M,)."""
        # Most senders always agree, and nothing is held against them.
        if not len(self._pair) and not contradicts.any():
            return
        change = np.where(contradicts, self._for, self._against)
        kept = np.isin(pairs, np.union1d(self._pair, pairs[contradicts]))
        merged, place = np.unique(
            np.concatenate([self._pair, pairs[kept]]), return_inverse=True)
        total = np.bincount(
            place.reshape(-1), np.concatenate([_MEMORY * self._odds, change[kept]]), len(merged))
        self._pair, self._odds = merged, np.minimum(total, 1.5 * math.log(self.config.suspicion))
        self._drop(self._odds < _FORGOTTEN)

    def _drop(self, which: Array) -> None:
        self._pair, self._odds = self._pair[~which], self._odds[~which]
