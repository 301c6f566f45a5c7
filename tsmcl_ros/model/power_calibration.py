"""
Online calibration of rssi: P_0 and n, one pair for a fleet, and what each anchor's P_0 is off.

Rssi is linear in all of them once its distance is known, so every particle of a belief of its own,
moved by the vehicle's motion, has a Kalman filter of them (Rao-Blackwellized: Doucet et al. 2000).
A Gaussian belief of all together would not do: it takes for a P_0 how log d bends over what rssi
leaves open. Shadowing that stays for a while (Gudmundson 1991) is an offset of the anchor that is
forgotten again. Anchors that are silent are rssi censored by the sensitivity (Tobin 1958): else a
P_0 that is wrong would drive vehicles away from them.

Where these beliefs have vehicles is told in place of what a method has found: one that takes each
epoch's shadowing for news is too certain, and goes where the shadows are.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from tsmcl_ros.model.cloud import Cloud, CloudConfig
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.factors import log_of_rate
from tsmcl_ros.model.learnt import aged, LearntRssi
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particles import chunks
from tsmcl_ros.model.power_filters import Anchor, PowerFilters
from tsmcl_ros.model.power_places import CANDIDATES, decades, draw_places
from tsmcl_ros.types import Array, Estimate, Motion, Prior, Silence

_CLOUD = CloudConfig(min_particles=500, max_particles=CANDIDATES)
# Distances of places to anchors that are reckoned at once.
_AT_ONCE = 1 << 19
# Senders that a vehicle must hear at once for its belief to begin.
_ENOUGH = 3
# Epochs in a row of which most rssi are outliers to a belief, before it is begun anew.
_PATIENCE = 5


class PowerCalibration:
    """
    What the path losses of anchors are off, estimated together with where the vehicles are.

    Parameters
    ----------
    std : (2,) float
        How far P_0 [dB] and n, as they are taken to be, may be off for all anchors alike.
    anchor_std, anchor_time : float
        How far the P_0 of each one is off beside that [dB], and how long it stays so [s].
    sigma_share : float
        How far sigma_db, as it is taken to be, may be off, as a share of it.
    seed : int
        Of the draws that the beliefs are made of.

    Attributes
    ----------
    mean, covariance : (2,), (2, 2) float64
        What P_0 [dB] and n are off, for all anchors alike.
    follows : bool
        Whether there are vehicles to learn from.
    pose : (V, D), (V, D, D) float64
        Mean and covariance of where vehicles are [m, m^2], once `follow` has begun.

    """

    def __init__(self, std: tuple[float, float], anchor_std: float, anchor_time: float,
                 sigma_share: float, seed: int = 0):
        self._begin = np.zeros(2)
        self._prior = self._configured = np.diag(np.square(std))
        self._anchor_variance, self._anchor_time = anchor_std ** 2, anchor_time
        # As known as from so many rssi: what n of them tell of sigma errs by 1 / sqrt(2 n).
        self._samples = self._squares = self._supposed = 1 / (2 * sigma_share ** 2)
        self._rng = np.random.Generator(np.random.SFC64(seed))
        self.mean, self.covariance = self._begin, self._prior
        self.follows = False
        self._filters = PowerFilters(0, 0, self.mean, self.covariance, self._anchor_variance)

    def follow(self, motion: MotionModel, vehicles: int, dimension: int, floor: float) -> None:
        """
        Begin to follow vehicles.

        Parameters
        ----------
        motion : MotionModel
            How they move.
        vehicles, dimension : int
            V and D.
        floor : float
            Share of rssi that may say anything.

        """
        if self.learnt is not None:
            self.resume(self.learnt)
        self.follows, self._floor = True, floor
        self._cloud = Cloud(_CLOUD, motion, vehicles, dimension, self._rng)
        self._filters = PowerFilters(
            vehicles, _CLOUD.min_particles, self.mean, self.covariance, self._anchor_variance)
        self._taught = np.zeros(vehicles, bool)
        self._doubts = np.zeros(vehicles, int)
        self._look()

    @property
    def sigma(self) -> float:
        """How large the noise of rssi is beside sigma_db, what stays for a while left aside."""
        return math.sqrt(self._squares / self._samples)

    @property
    def is_taught(self) -> bool:
        """Whether rssi has told anything yet."""
        return bool((self.covariance != self._prior).any())

    @property
    def learnt(self) -> LearntRssi | None:
        """What another one can begin with, None if rssi has told nothing yet."""
        if not self.is_taught:
            return None
        return LearntRssi(self.mean, self.covariance, self.sigma, self._samples)

    def resume(self, learnt: LearntRssi) -> None:
        """Begin, before vehicles are followed, with what another one has learnt."""
        self._begin, self._prior = learnt.mean, aged(learnt.covariance, self._configured)
        self.mean, self.covariance = self._begin, self._prior
        self._samples = 1 / aged(1 / learnt.samples, 1 / self._supposed)
        self._squares = learnt.sigma ** 2 * self._samples

    def predict(self, motion: Motion) -> None:
        """Move the vehicles, and let anchors forget what they were off."""
        if not self.follows:
            return
        if self._cloud.placed.any():
            self._cloud.predict(motion)
        self._filters.forget(math.exp(-motion.elapsed / self._anchor_time), self._prior)
        self._look()

    def start(self, prior: Prior) -> None:
        """Follow a vehicle from a prior belief on."""
        if self.follows:
            self._cloud.start(prior)
            self._doubts[prior.vehicle] = 0

    def placed(self, estimate: Estimate) -> Estimate:
        """
        Return an estimate with those vehicles where they are together with what is off.

        An estimate made of rssi alone takes what an anchor is off for news at each epoch; here it
        is told once. Those whose belief does not fit what they measure are left as they are.
        """
        if not self.follows:
            return estimate
        mean, covariance = self.pose
        sure = self._cloud.placed & self._taught & (self._doubts == 0)
        return replace(
            estimate, mean=np.where(sure[:, None], mean, estimate.mean),
            covariance=np.where(sure[:, None, None], covariance, estimate.covariance))

    def of(self, sender: Array) -> Array:
        """Return what P_0 of senders (V, K) is off beside what all are [dB], where it is known."""
        if not self.follows:
            return np.zeros(sender.shape)
        mean, covariance = self._known
        known, state = self._filters.find(sender)
        # What a vehicle knows of an anchor goes with what it takes for common to all.
        changed = np.linalg.solve(covariance[:, :2, :2], (self.mean - mean[:, :2])[:, :, None])
        own = mean + (covariance[:, :, :2] @ changed)[:, :, 0]
        return np.where(known, np.take_along_axis(own, state, axis=1), 0)

    @property
    def variance(self) -> float:
        """What of rssi is unknown as P_0 and n are, at usual distances [dB^2]."""
        slope = np.array([1, -10 * self._filters.decade])
        return float(slope @ self.covariance @ slope)

    def learn(self, sender: Array, position: Array, rssi: Array, used: Array,
              loss: tuple[Array, ...], sensitivity: float, beside: Evidence,
              silent: Silence | None = None, silent_loss: tuple[Array, ...] = ()) -> None:
        """
        Take in the rssi of an epoch.

        Parameters
        ----------
        sender : (V, K) int
            Anchors.
        position : (V, K, D) float
            Theirs [m].
        rssi : (V, K) float
            [dBm].
        used : (V, K) bool
            What counts.
        loss : three arrays (V, K)
            P_0 at 1 m [dBm], n and sigma_db [dB] of each, as they are taken to be.
        sensitivity : float
            Weaker ones are not heard [dBm], so that who is far is louder than on average; -inf if
            nobody knows.
        beside : Evidence
            All else that was heard.
        silent, silent_loss : Silence and three arrays (V, S), optional
            Who was not heard, and their path losses.

        """
        if not self.follows:
            return
        log_likelihood = self._place(position, rssi, used, loss)
        used = used & self._cloud.placed[:, None]
        log_likelihood += beside.log_likelihood(self._cloud.particles)
        doubt = np.zeros(len(used))
        for row in np.flatnonzero(used.any(axis=0)).tolist():
            likely, trust = self._measure(
                self._anchor(row, used, sender, position, loss), rssi[:, row],
                sensitivity if silent is None else -math.inf)
            log_likelihood += likely
            doubt += used[:, row] & (trust < 0.5)
        if silent is not None:
            missed, known = np.exp(log_of_rate(silent)), silent.known & self._cloud.placed[:, None]
            for row in np.flatnonzero(known.any(axis=0)).tolist():
                log_likelihood += self._filters.miss(
                    self._anchor(row, known, silent.sender, silent.position, silent_loss),
                    sensitivity, missed[:, row], self._cloud.weights)
        self._cloud.weigh(log_likelihood)
        count = used.sum(axis=1)
        self._taught |= count > 0
        self._doubts = np.where(2 * doubt > count, self._doubts + 1,
                                np.where(count > 0, 0, self._doubts))
        self.forget(self._doubts >= _PATIENCE)
        self._look()
        self._filters.resample(*self._cloud.resample())
        self._share(self._taught)

    def forget(self, vehicle: Array) -> None:
        """Begin anew where vehicles (V,) bool are, and not what is off."""
        if self.follows:
            self._cloud.forget(vehicle)

    def _anchor(self, row: int, used: Array, sender: Array, position: Array,
                loss: tuple[Array, ...]) -> Anchor:
        """Return what the particles expect of the anchors in one row (V,)."""
        decade = decades(self._cloud.particles - position[:, row, None].astype(np.float32))
        reference, exponent, sigma = (part[:, row, None] for part in loss)
        return Anchor(used[:, row], sender[:, row], decade, reference + exponent * (-10 * decade),
                      self.sigma * sigma)

    def _measure(self, anchor: Anchor, rssi: Array, sensitivity: float) -> tuple[Array, Array]:
        """Take in one rssi each (V,); return its log-likelihood (V, N) and how trusted it is."""
        weights = self._cloud.weights
        log_likelihood, trust, squared = self._filters.measure(
            anchor, rssi, sensitivity, self._floor, weights)
        # What a measurement tells of its own noise (expectation maximization).
        share = weights * trust
        self._samples += float(share.sum())
        self._squares += float((share * squared).sum()) * self.sigma ** 2
        return log_likelihood, share.sum(axis=1)

    def _place(self, position: Array, rssi: Array, used: Array, loss: tuple[Array, ...]
               ) -> Array:
        """Draw the particles of vehicles without a belief; return (V, N) what makes up for how."""
        cloud = self._cloud
        made_up = np.zeros_like(cloud.weights)
        vehicle = np.flatnonzero(~cloud.placed & (used.sum(axis=1) >= _ENOUGH))
        off = *self.mean, 0
        for rows in chunks(len(vehicle), CANDIDATES * used.shape[1], _AT_ONCE):
            some = vehicle[rows]
            places, made_up[some] = draw_places(
                position[some], rssi[some], used[some],
                tuple(part[some] + more for part, more in zip(loss, off, strict=True)),
                self.covariance, self._anchor_variance, cloud.weights.shape[1], self._rng)
            cloud.put(some, places)
            self._doubts[some] = 0
        return made_up

    def _look(self) -> None:
        """Tell where vehicles are, and what is off."""
        self._known = self._filters.moments(self._cloud.weights)
        self.pose = self._cloud.moments()

    def _share(self, taught: Array) -> None:
        """Join what the vehicles have learnt in common, each from the same prior."""
        if not taught.any():
            return
        mean, covariance = (part[taught] for part in self._known)
        # In units of the prior, of which all are sure alike.
        unit = np.linalg.cholesky(self._prior)
        white = np.linalg.inv(unit)
        values, axes = np.linalg.eigh(white @ covariance[:, :2, :2] @ white.T)
        information = np.einsum('vij,vj,vkj->ik', axes, 1 / np.minimum(values, 1) - 1, axes)
        told = np.einsum('vij,vj,vkj,vk->i', axes, 1 / np.minimum(values, 1), axes,
                         (mean[:, :2] - self._begin) @ white.T)
        joint = np.linalg.inv(np.eye(2) + information)
        self.mean = self._begin + unit @ (joint @ told)
        self.covariance = unit @ joint @ unit.T
