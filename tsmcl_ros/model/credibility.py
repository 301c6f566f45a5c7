"""
Whom vehicles believe: what is heard is held against all that is known, before it is taken in.

Claims that cannot be true are left out, and so is who is suspected. Ranges are held against the
prediction, which they tell to a fraction of its reach. Radio disks are wide, and a belief that a
lie has misled may fit them for long; so they are held against each other, over all that a vehicle
heard on its way. A vehicle without a prediction holds ranges against each other, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tsmcl_ros.model.absence import Absences
from tsmcl_ros.model.claims import Claims
from tsmcl_ros.model.consensus import (
    outvoted_by_disks,
    outvoted_by_ranges,
    supported_by_ranges,
)
from tsmcl_ros.model.consistency import Deviations, deviations
from tsmcl_ros.model.health import HealthConfig, HealthMonitor
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.recollection import Recollection
from tsmcl_ros.types import Array, Observation, pair, pairs_of, Prior, Silence, split

_TOGETHER = 256  # vehicles
# Epochs after its placing in which a vehicle doubts its place if one who led to it is unmasked.
_PROBATION = 10


class Credibility:
    """
    Watches over whom V vehicles believe.

    Parameters
    ----------
    config : HealthConfig
    miss_rate : float
        Share of beacons that get lost however near their sender is.
    vehicles, dimension : int
        V and D.

    Attributes
    ----------
    claims : Claims
        What anchors said of themselves.
    monitor : HealthMonitor
        Who is lost, and who is suspected.

    """

    def __init__(self, config: HealthConfig, miss_rate: float, vehicles: int, dimension: int):
        self.config = config
        self.claims = Claims(dimension)
        self.monitor = HealthMonitor(config, vehicles)
        self._absences = Absences(config, miss_rate, vehicles)
        self._recollection = Recollection(vehicles, dimension)
        self._age = np.zeros(vehicles, int)
        self._doubtful = np.zeros(vehicles, bool)
        self._lost = np.zeros(vehicles, bool)
        self._told = np.zeros(vehicles, bool)
        self._believed = np.zeros(0, np.int64)

    def move(self, displacement: Array, variance: Array) -> None:
        """Take in an epoch's motion: see `Recollection`."""
        self._recollection.move(displacement, variance)

    def forget(self, vehicle: int) -> None:
        """Begin again with a vehicle whose belief is replaced by what somebody says."""
        self.monitor.forget(vehicle)
        self._absences.forget(vehicle)
        self._told[vehicle] = True
        self._age[vehicle] = 0

    def renew(self, vehicle: Array) -> None:
        """Take vehicles (V,) bool for lost until beacons confirm them: they were placed anew."""
        self.monitor.doubt(vehicle)
        self._absences.renew(vehicle)

    def sift(self, channel: Channel, observation: Observation, mean: Array, covariance: Array,
             met: Array) -> tuple[Observation, list[Prior]]:
        """
        Return what is to be believed of an observation, and what of beliefs that are not.

        Parameters
        ----------
        channel : Channel
            Tells what measurements and their absence mean.
        observation : Observation
            Of V vehicles.
        mean, covariance : (V, D), (V, D, D) float
            The predicted belief [m, m^2]; NaN where there is none.
        met : (V,) int
            How many of the anchors that it knows of a vehicle hears.

        """
        monitor = self.monitor
        disproved = self.claims.disproved(observation)
        observation = observation.without(disproved)
        found = deviations(channel, observation, mean, covariance)
        self._absences.learn(found, observation, met, self._recollection.follows)
        supported = self._supported(channel, observation, found, mean, covariance)
        contradicts, counts = monitor.judge_vehicles(
            found, self._absences.usual(found) | (supported[:, None] & ~found.disk))
        observation = self._absences.weigh(observation, monitor.lost > 0.5, met)
        placed = np.isfinite(mean[:, 0])
        settled = placed & (monitor.lost < 0.5)
        pairs, disks = pairs_of(found.sender), found.said & found.disk
        asked = ~settled | self._doubtful | (contradicts & disks).any(axis=1)
        accused, refused, priors = self._compare_disks(
            channel, observation, asked, settled, mean, np.trace(covariance, axis1=1, axis2=2))
        known = monitor.suspected(pairs)
        contradicts = np.where(disks & ~known, np.isin(pairs, accused), contradicts)
        before = monitor.suspicious
        monitor.judge_senders(pairs, contradicts, counts, disproved)
        number, much = counts.sum(axis=1), contradicts.sum(axis=1)
        alone = contradicts & ~found.silent & (
            disks | (supported | settled & (2 * much < number))[:, None])
        observation = observation.without(pairs[alone]).without(refused).without(
            monitor.shunned(observation))
        unsure = np.flatnonzero(~settled)
        if len(unsure):
            some = observation.of(unsure)
            vehicle, row = np.nonzero(
                outvoted_by_ranges(channel, some, self.config.contradiction))
            observation = observation.without(pair(unsure[vehicle], some.sender[vehicle, row]))
        self._doubt(observation, settled, np.setdiff1d(monitor.suspicious, before))
        self._age[[prior.vehicle for prior in priors]] = 0
        return observation, priors

    def _doubt(self, observation: Observation, settled: Array, unmasked: Array) -> None:
        """Remember who is believed, and doubt the places that the unmasked have led to."""
        self._age = np.where(settled, self._age + 1, 0)
        self._told &= settled & (self._age < _PROBATION)
        young = self._age < _PROBATION
        rows = observation.heard & young[:, None]
        vehicle, _ = split(self._believed)
        self._believed = np.union1d(
            self._believed[young[vehicle]], pairs_of(observation.sender)[rows])
        self._doubtful[:] = False
        self._doubtful[split(np.intersect1d(unmasked, self._believed))[0]] = True

    def _supported(self, channel: Channel, observation: Observation, found: Deviations,
                   mean: Array, covariance: Array) -> Array:
        """Return who (V,) bool stays where it is, though half of what it hears is against it."""
        against = found.contradicts(self.config.contradiction)
        counts = found.counts(self.config.contradiction)
        supported = (against.any(axis=1) & (self.monitor.lost < 0.5)
                     & (2 * against.sum(axis=1) >= counts.sum(axis=1)))
        asked = np.flatnonzero(supported)
        if len(asked):
            supported[asked] = supported_by_ranges(
                channel, observation.of(asked), mean[asked], covariance[asked],
                self.config.contradiction)
        return supported

    def _compare_disks(self, channel: Channel, observation: Observation, asked: Array,
                       settled: Array, mean: Array, variance: Array
                       ) -> tuple[Array, Array, list[Prior]]:
        """
        Hold the disks of those who ask (V,) bool against each other.

        Returns
        -------
        accused, refused : (M,), (P,) int64
            Pairs of vehicles and senders whose disks the majority contradicts; and of those that
            are not to be believed now, by the belief where that is not refuted.
        priors : list of Prior
            Where the majority has vehicles that believe to be elsewhere, or doubt their place.

        """
        # Who gets lost may have been carried away, and what was heard before is of no use then.
        lost = ~settled & np.isfinite(mean[:, 0])
        self._recollection.forget(lost & ~self._lost)
        self._lost = lost
        radius, rows = channel.disks(observation)
        none = np.zeros(0, np.int64)
        if mean.shape[1] != 2 or not rows.any():
            return none, none, []
        vehicle, row = np.nonzero(rows)
        self._recollection.hear(vehicle, observation.sender[vehicle, row],
                                observation.position[vehicle, row], radius[vehicle, row])
        vehicle = np.flatnonzero(asked & rows.any(axis=1))
        accused, refused = [none], [none]
        priors: list[Prior] = []
        for first in range(0, len(vehicle), _TOGETHER):
            some = vehicle[first:first + _TOGETHER]
            recalled = self._recollection.disks(some)
            known = self.monitor.suspected(pair(some[:, None], recalled.sender))
            recalled = replace(recalled, used=recalled.used & ~known)
            verdict = outvoted_by_disks(
                channel, recalled, self._heeded(observation.of(some), some, settled[some]),
                self.config.contradiction, mean[some], variance[some])
            # A belief that has stood for long is not refuted by one sender; nor is one that was
            # told by the few disks of the first epochs, as who is elsewhere is lost soon.
            refuted = ~self._told[some] & (verdict.refutation > (self._age[some] >= _PROBATION))
            anew = settled[some] & (self._doubtful[some] | refuted) & recalled.used.any(axis=1)
            # Without odometry a belief goes where its motion model has it, and tells no lies.
            trusted = settled[some] & ~anew & self._recollection.follows[some]
            pairs = pair(some[:, None], recalled.sender)
            accused.append(pairs[verdict.against])
            refused.append(pairs[np.where(
                trusted[:, None], verdict.missing, verdict.disputed)])
            priors += [
                Prior(int(some[i]), verdict.mean[i], verdict.covariance[i])
                for i in np.flatnonzero(anew).tolist()]
        return np.concatenate(accused), np.concatenate(refused), priors

    def _heeded(self, observation: Observation, vehicle: Array, settled: Array
                ) -> Silence | None:
        """Return the silence of those who are not suspected, to vehicles (W,) in their place."""
        silent = observation.silent
        if silent is None:
            return None
        suspected = self.monitor.suspected(pair(vehicle[:, None], silent.sender))
        return replace(silent, known=silent.known & ~suspected & settled[:, None])
