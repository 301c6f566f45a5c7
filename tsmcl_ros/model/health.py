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
from tsmcl_ros.types import Array, PADDED

OK, STALE, LOST = 0, 1, 2

# Of what a lost vehicle hears, and of what an unsound sender says, half contradicts by chance.
BY_CHANCE = 0.5
# Nobody is surer than this of a vehicle being lost, lest it take long to see it found.
_SUREST = math.log(1e3)
# What is held against a sender fades, lest one that is never met again stays a suspect.
_MEMORY = 0.99
_ID_BITS = 32


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
        self._drop(np.isin(self._pair >> _ID_BITS, vehicle))

    def doubt(self, vehicle: Array) -> None:
        """Take vehicles (V,) bool for lost until beacons confirm them: they were placed anew."""
        if not vehicle.any():
            return
        self.lost[vehicle] = 1 - 1 / (1 + math.exp(_SUREST))
        self._drop(vehicle[self._pair >> _ID_BITS])

    def judge(self, deviations: Deviations, usual: Array | bool = False) -> None:
        """
        Learn from how an epoch's beacons agree with the prediction.

        What is usual, (V, R) bool, does not count against a vehicle, but against the sender.
        """
        suspected = self.suspected(deviations.sender) | usual
        contradicts = deviations.said & (deviations.deviation > self.config.contradiction)
        # The silence of an anchor is no news unless it was expected to be heard.
        counts = deviations.said & ~(deviations.silent & ~contradicts)
        number = (counts & ~suspected).sum(axis=1)
        against = (contradicts & ~suspected).sum(axis=1)
        self._judge_vehicles(number, against)
        outvoted = (2 * against > number)[:, None]
        self._judge_senders(deviations.sender, contradicts, counts & ~outvoted)

    def suspected(self, sender: Array) -> Array:
        """Return which senders, ids (V, R), their vehicles suspect."""
        suspicious = self._suspicious
        if not len(suspicious):
            return np.zeros(sender.shape, bool)
        vehicle = np.arange(len(sender))[:, None]
        found = np.isin((vehicle << _ID_BITS) + sender, suspicious)
        return np.asarray(found & (sender != PADDED))

    def suspects(self) -> list[list[int]]:
        """Return the ids that each vehicle suspects."""
        found: list[list[int]] = [[] for _ in self.lost]
        for pair in self._suspicious.tolist():
            found[pair >> _ID_BITS].append(pair & (1 << _ID_BITS) - 1)
        return found

    @property
    def _suspicious(self) -> Array:
        """The pairs of a vehicle and a sender that it suspects."""
        return self._pair[self._odds >= math.log(self.config.suspicion)]

    def _judge_vehicles(self, number: Array, against: Array) -> None:
        """Weigh what (V,) beacons, and how many against it, say of each vehicle's belief."""
        change = against * self._for + (number - against) * self._against
        prior = self.lost + (1 - self.lost) * np.where(number > 0, self.config.loss_rate, 0)
        with np.errstate(divide='ignore'):
            odds = np.log(prior) - np.log1p(-prior) + change
        self.lost = np.where(number > 0, 1 / (1 + np.exp(-np.minimum(odds, _SUREST))), self.lost)

    def _judge_senders(self, sender: Array, contradicts: Array, counts: Array) -> None:
        """Weigh what the rows (V, R) that count say of their senders."""
        # Most senders always agree, and nothing is held against them.
        if not len(self._pair) and not (contradicts & counts).any():
            return
        vehicle, row = np.nonzero(counts)
        pair = (vehicle << _ID_BITS) + sender[vehicle, row]
        change = np.where(contradicts[vehicle, row], self._for, self._against)
        kept = np.isin(pair, np.union1d(self._pair, pair[change > 0]))
        pairs, place = np.unique(
            np.concatenate([self._pair, pair[kept]]), return_inverse=True)
        total = np.bincount(
            place.reshape(-1), np.concatenate([_MEMORY * self._odds, change[kept]]), len(pairs))
        self._pair, self._odds = pairs, np.minimum(total, 1.5 * math.log(self.config.suspicion))
        self._drop(self._odds <= 0)

    def _drop(self, which: Array) -> None:
        self._pair, self._odds = self._pair[~which], self._odds[~which]
