"""
How much the silence of anchors says, which may be out of order, gone, or just not received.

An anchor in range that is not heard is no proof that it is far: beacons get lost, and anchors are
switched off, carried away or replaced. A silence that contradicts where a vehicle is says little
at first. If it lasts, either the vehicle is elsewhere, which is likely where several anchors are
missed at once or beacons that are heard contradict, too; or else the anchor is missed, and the
more often it was, the less its silence says, until it is heard again. So a map of anchors of which
none is left holds no vehicle hostage. As long as nothing is missed, silence says all that the
radio model makes of it.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from tsmcl_ros.model.consistency import Deviations
from tsmcl_ros.model.health import BY_CHANCE, HealthConfig
from tsmcl_ros.types import ANCHOR, Array, Observation, pair, pairs_of, split

# Epochs of hearing an anchor that are taken for granted when it is missed for the first time.
_GRANTED = 20.0
# What is left of the times that an anchor was missed whenever it is heard, and the most of them.
_FORGIVEN, _MOST = 0.9, 40.0
_FORGOTTEN = 0.02
_MISSING = 0.5  # times missed, from which on an anchor counts as missing
# Share of anchors that are missed for no reason that is known.
_SELDOM = 0.001
# What is missed at least so often is missed for a reason that lasts, and so no news each time.
_LASTING = 0.1
# Whoever hears none of the anchors that it knows, but others, has a map that no longer holds.
_STRANGE = 0.5
# Silence says little when it contradicts for the first time, as one beacon may get lost; and to a
# vehicle that does not know its place, as it may have been misled by it.
_FIRST_RATE, _LOST_RATE = 0.05, 0.1
# Epochs after a vehicle was placed anew in which it is not taken to be elsewhere once more.
_NEW = 20


class Absences:
    """
    Keeps count of the anchors that V vehicles should hear and do not.

    Parameters
    ----------
    config : HealthConfig
        When a silence contradicts.
    miss_rate : float
        Share of beacons that get lost however near their sender is.
    vehicles : int
        V.

    """

    def __init__(self, config: HealthConfig, miss_rate: float, vehicles: int):
        self.config = config
        self.miss_rate = miss_rate
        # Pairs of a vehicle and an anchor, increasing, and how often it was missed of late.
        self._pair = np.zeros(0, np.int64)
        self._missed = np.zeros(0)
        # Those that were missed in this epoch and not in the one before.
        self._last = self._first = self._pair
        self._renewed = np.zeros(vehicles, int)

    def forget(self, vehicle: int) -> None:
        """Hold nothing against the anchors that one vehicle misses."""
        self._keep(split(self._pair)[0] != vehicle)

    def learn(self, deviations: Deviations, observation: Observation, met: Array,
              follows: Array) -> None:
        """
        Learn from how an epoch's silence agrees with the prediction, and who was heard.

        Parameters
        ----------
        deviations : Deviations
            From the prediction.
        observation : Observation
            What deviates so.
        met : (V,) int
            How many of the anchors that it knows of a vehicle hears.
        follows : (V,) bool
            Whose belief odometry carries. Others, if they measure nothing either, are off too
            often to say who is missing.

        """
        self._renewed -= self._renewed > 0
        contradicts = deviations.contradicts(self.config.contradiction)
        loud = deviations.said & ~deviations.silent
        missed = contradicts & deviations.silent & loud.any(axis=1, keepdims=True)
        if not len(self._pair) and not missed.any():
            self._last = self._first = self._pair
            return
        heard = np.where(observation.heard, pairs_of(observation.sender), -1)
        self._missed = np.where(
            np.isin(self._pair, heard), _FORGIVEN * self._missed, self._missed)
        surprising = missed & (self._times(deviations.sender) < _MISSING)
        surprising &= (self._renewed == 0)[:, None] & ~self._strange(observation, met)[:, None]
        vehicle, row = np.nonzero(missed)
        pairs = pair(vehicle, deviations.sender[vehicle, row])
        self._first, self._last = np.setdiff1d(pairs, self._last), pairs
        weight = self._in_place(
            loud & ~contradicts, loud & contradicts, surprising)
        led = follows | (loud & ~deviations.disk).any(axis=1)
        weight = np.where(led, weight, 0)[vehicle]
        self._pair, place = np.unique(
            np.concatenate([self._pair, pairs]), return_inverse=True)
        self._missed = np.minimum(_MOST, np.bincount(
            place.reshape(-1), np.concatenate([self._missed, weight]), len(self._pair)))
        self._keep(self._missed > _FORGOTTEN)

    def renew(self, vehicle: Array) -> None:
        """Learn that vehicles (V,) bool were placed anew."""
        self._renewed[vehicle] = _NEW

    def usual(self, deviations: Deviations) -> Array:
        """Return which of what was said (V, R) bool is a silence that contradicts often."""
        if not len(self._pair) and self.miss_rate <= self.config.contradiction_rate:
            return np.zeros(deviations.said.shape, bool)
        return np.asarray(deviations.silent & (
            self._rate(deviations.sender) > self.config.contradiction_rate))

    def weigh(self, observation: Observation, lost: Array, met: Array) -> Observation:
        """
        Return the observation with what its silence is worth.

        Parameters
        ----------
        observation : Observation
            Of V vehicles.
        lost : (V,) bool
            Who does not know its place.
        met : (V,) int
            How many of the anchors that it knows of a vehicle hears.

        """
        silent, strange = observation.silent, self._strange(observation, met)
        if silent is None or not (len(self._pair) or len(self._first) or self.miss_rate
                                  or (lost | strange).any()):
            return observation
        outdated = np.where(strange, _STRANGE, self._outdated(met))
        rate = np.maximum(self._rate(silent.sender), outdated[:, None])
        known = silent.known & (rate <= max(_LASTING, self.miss_rate))
        rate = np.where(lost[:, None], np.maximum(rate, _LOST_RATE), rate)
        first = np.isin(pairs_of(silent.sender), self._first)
        rate = np.where(first, np.maximum(rate, _FIRST_RATE), rate)
        return replace(observation, silent=replace(
            silent, known=known, miss_rate=rate.astype(np.float32)))

    def _rate(self, sender: Array) -> Array:
        """Return how often the beacons of senders, ids (V, S), are missed."""
        missed = self._times(sender)
        return np.asarray((_GRANTED * self.miss_rate + missed) / (_GRANTED + missed))

    def _times(self, sender: Array) -> Array:
        """Return how often senders, ids (V, S), were missed of late."""
        if not len(self._pair):
            return np.zeros(sender.shape)
        pairs = pairs_of(sender)
        index = np.minimum(np.searchsorted(self._pair, pairs), len(self._pair) - 1)
        return np.where(self._pair[index] == pairs, self._missed[index], 0)

    def _strange(self, observation: Observation, met: Array) -> Array:
        """Return which vehicles (V,) bool hear anchors, but none that they know."""
        anchors = observation.heard & (observation.kind == ANCHOR)
        return np.asarray((met == 0) & anchors.any(axis=1))

    def _outdated(self, met: Array) -> Array:
        """Return how probable it is that what a vehicle knows of an anchor does not hold (V,)."""
        vehicle, _ = split(self._pair[self._missed >= _MISSING])
        missing = np.bincount(vehicle, minlength=len(met))
        # One alone may be broken.
        return np.asarray(np.maximum(missing - 1, 0) / np.maximum(missing + met, 1))

    def _in_place(self, agree: Array, contradict: Array, missed: Array) -> Array:
        """
        Return how probable it is that vehicles (V,) are in place, and miss who is there.

        Parameters
        ----------
        agree, contradict : (V, R) bool
            Beacons heard that do.
        missed : (V, R) bool
            Anchors that were not heard although they should be, for no reason that is known.

        """
        share = self.config.contradiction_rate
        odds = (agree.sum(axis=1) * math.log((1 - share) / BY_CHANCE)
                + contradict.sum(axis=1) * math.log(share / BY_CHANCE)
                + missed.sum(axis=1) * math.log(_SELDOM / BY_CHANCE)
                - math.log(self.config.loss_rate))
        return np.asarray(1 / (1 + np.exp(-odds)))

    def _keep(self, which: Array) -> None:
        self._pair, self._missed = self._pair[which], self._missed[which]
