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
import scipy
from tsmcl_ros.model.evidence import Evidence, log_of_rate
from tsmcl_ros.model.motion import draw, MotionModel
from tsmcl_ros.model.particles import (
    chunks,
    effective_sample_size,
    even_resample,
    moments,
    normalize,
    spread,
    systematic_resample,
)
from tsmcl_ros.types import Array, Estimate, Motion, Prior, Silence

_PARTICLES = 500
# Anchors that a vehicle remembers offsets of, those that it has heard last.
_SLOTS = 16
# Places that the first particles are drawn from, how much of their log-likelihood counts, and of
# how many distances at once.
_CANDIDATES, _PROPOSED, _AT_ONCE = 8000, 0.5, 1 << 19
# Senders that a vehicle must hear at once for its belief to begin.
_ENOUGH = 3
# Epochs in a row of which most rssi are outliers to a belief, before it is begun anew.
_PATIENCE = 5
# Share of its prior that what is common to all anchors forgets in an epoch.
_FORGOTTEN = 1e-5
# Of the cloud's standard deviations: noise on resampled particles, so that copies part.
_JITTER = 0.05
_NEAREST = 0.5  # m, as path loss has no bound
_TYPICAL = 10.0  # m, how far an anchor is that was not heard yet


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
    pose : (V, D), (V, D, D) float64
        Mean and covariance of where vehicles are [m, m^2], once `follow` has begun.

    """

    def __init__(self, std: tuple[float, float], anchor_std: float, anchor_time: float,
                 sigma_share: float, seed: int = 0):
        self._prior = np.diag(np.square(std))
        self._anchor_variance, self._anchor_time = anchor_std ** 2, anchor_time
        # As known as from so many rssi: what n of them tell of sigma errs by 1 / sqrt(2 n).
        self._samples = 1 / (2 * sigma_share ** 2)
        self._squares = self._samples
        self._rng = np.random.Generator(np.random.SFC64(seed))
        self.mean, self.covariance = np.zeros(2), self._prior
        self._slots, self._decade = np.full((2, 0, _SLOTS), -1)
        self._motion: MotionModel | None = None

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
        self._motion, self._dimension, self._floor = motion, dimension, floor
        size = 2 + _SLOTS
        self._states = np.zeros((vehicles, _PARTICLES, dimension + motion.extra), np.float32)
        self._weights = np.full((vehicles, _PARTICLES), 1 / _PARTICLES, np.float32)
        # Each particle's own estimates of what is off, and their common covariance.
        self._off = np.zeros((vehicles, _PARTICLES, size), np.float32)
        self._off[:, :, :2] = self.mean
        self._error = np.zeros((vehicles, size, size))
        self._error[:, :2, :2] = self.covariance
        self._error[:, range(2, size), range(2, size)] = self._anchor_variance
        self._slots = np.full((vehicles, _SLOTS), -1)
        self._decade = np.full((vehicles, _SLOTS), math.log10(_TYPICAL))
        self._last = np.zeros((vehicles, _SLOTS))
        self._epochs = 0
        self._placed = np.zeros(vehicles, bool)
        self._taught = np.zeros(vehicles, bool)
        self._doubts = np.zeros(vehicles, int)
        self._known, self.pose = self._moments(), self._where()

    @property
    def sigma(self) -> float:
        """How large the noise of rssi is beside sigma_db, what stays for a while left aside."""
        return math.sqrt(self._squares / self._samples)

    @property
    def is_taught(self) -> bool:
        """Whether rssi has told anything yet."""
        return bool((self.covariance != self._prior).any())

    @property
    def follows(self) -> bool:
        """Whether there are vehicles to learn from."""
        return self._motion is not None

    def predict(self, motion: Motion) -> None:
        """Move the vehicles, and let anchors forget what they were off."""
        if self._motion is None:
            return
        if self._placed.any():
            self._states = self._motion.predict(self._states, motion, self._rng)
        kept = math.exp(-motion.elapsed / self._anchor_time)
        self._off[:, :, 2:] *= np.float32(kept)
        self._error[:, 2:] *= kept
        self._error[:, :, 2:] *= kept
        each = range(2, 2 + _SLOTS)
        self._error[:, each, each] += (1 - kept ** 2) * self._anchor_variance
        self._error[:, :2, :2] += _FORGOTTEN * (self._prior - self._error[:, :2, :2])
        self._known, self.pose = self._moments(), self._where()

    def start(self, prior: Prior) -> None:
        """Follow a vehicle from a prior belief on."""
        if self._motion is not None:
            self._states[prior.vehicle] = draw(
                prior, self._motion, _PARTICLES, self._rng)
            self._begin(np.array([prior.vehicle]))

    def placed(self, estimate: Estimate) -> Estimate:
        """
        Return an estimate with those vehicles where they are together with what is off.

        An estimate made of rssi alone takes what an anchor is off for news at each epoch; here it
        is told once. Those whose belief does not fit what they measure are left as they are.
        """
        if self._motion is None:
            return estimate
        mean, covariance = self.pose
        sure = self._placed & self._taught & (self._doubts == 0)
        return replace(
            estimate, mean=np.where(sure[:, None], mean, estimate.mean),
            covariance=np.where(sure[:, None, None], covariance, estimate.covariance))

    def of(self, sender: Array) -> Array:
        """Return what P_0 of senders (V, K) is off beside what all are [dB], where it is known."""
        if self._motion is None:
            return np.zeros(sender.shape)
        mean, covariance = self._known
        slot = self._slots[:, None, :] == sender[:, :, None]
        known, slot = slot.any(axis=2), 2 + slot.argmax(axis=2)
        # What a vehicle knows of an anchor goes with what it takes for common to all.
        changed = np.linalg.solve(covariance[:, :2, :2], (self.mean - mean[:, :2])[:, :, None])
        own = mean + (covariance[:, :, :2] @ changed)[:, :, 0]
        return np.where(known, np.take_along_axis(own, slot, axis=1), 0)

    @property
    def variance(self) -> float:
        """What of rssi is unknown as P_0 and n are, at usual distances [dB^2]."""
        known = self._slots >= 0
        decade = self._decade[known].mean() if known.any() else math.log10(_TYPICAL)
        slope = np.array([1, -10 * decade])
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
        if self._motion is None:
            return
        self._epochs += 1
        log_weights = self._place(position, rssi, used, loss)
        used = used & self._placed[:, None]
        log_weights += beside.log_likelihood(self._states[:, :, :self._dimension])
        doubt = np.zeros(len(used))
        for row in np.flatnonzero(used.any(axis=0)).tolist():
            doubt += self._measure(
                used[:, row], sender[:, row], position[:, row], rssi[:, row],
                tuple(part[:, row, None] for part in loss),
                sensitivity if silent is None else -math.inf, log_weights)
        if silent is not None:
            missed, known = np.exp(log_of_rate(silent)), silent.known & self._placed[:, None]
            for row in np.flatnonzero(known.any(axis=0)).tolist():
                self._miss(
                    known[:, row], silent.sender[:, row], silent.position[:, row],
                    tuple(part[:, row, None] for part in silent_loss), sensitivity,
                    missed[:, row], log_weights)
        self._weights, _ = normalize(log_weights.astype(np.float32))
        count = used.sum(axis=1)
        self._taught |= count > 0
        self._doubts = np.where(2 * doubt > count, self._doubts + 1,
                                np.where(count > 0, 0, self._doubts))
        self.forget(self._doubts >= _PATIENCE)
        self._known, self.pose = self._moments(), self._where()
        self._resample()
        self._share(self._taught)

    def forget(self, vehicle: Array) -> None:
        """Begin anew where vehicles (V,) bool are, and not what is off."""
        if self._motion is not None:
            self._placed &= ~vehicle

    def _measure(self, used: Array, sender: Array, position: Array, rssi: Array,
                 loss: tuple[Array, ...], sensitivity: float, log_weights: Array) -> Array:
        """Take in one rssi each (V,), weigh the particles by it, and return who doubts it."""
        sigma, slot = self.sigma * loss[2], self._slot(used, sender)
        vehicle, column = np.arange(len(slot)), slot - 2
        decade = self._decades(position)
        self._decade[vehicle, column] = np.where(
            used, (self._weights * decade).sum(axis=1), self._decade[vehicle, column])
        expected, cross, prior = self._expect(decade, loss, slot, np.ones((len(slot), 1), bool))
        shift, kept = _beyond((expected - sensitivity) / np.sqrt(sigma ** 2 + prior))
        sigma = sigma * np.sqrt(kept)
        variance = kept ** 2 * prior + sigma ** 2
        residual = np.where(used, rssi, 0)[:, None] - expected - shift * sigma / np.sqrt(kept)
        sound = (1 - self._floor) * np.exp(-0.5 * residual ** 2 / variance) * (
            sigma / np.sqrt(variance))
        trust = np.where(used[:, None], sound / np.maximum(sound + self._floor, 1e-30), 0)
        log_weights += np.where(
            used[:, None], np.log(np.maximum(sound + self._floor, 1e-30)), 0)
        gain = trust * kept / variance
        self._correct(cross, gain * residual, gain * kept)
        # What a measurement tells of its own noise (expectation maximization).
        share = self._weights * trust
        squared = ((sigma * residual / variance) ** 2 + kept ** 2 * prior / variance)
        self._samples += float(share.sum())
        self._squares += float((share * squared).sum()) * self.sigma ** 2
        return np.asarray(used & (share.sum(axis=1) < 0.5))

    def _miss(self, used: Array, sender: Array, position: Array, loss: tuple[Array, ...],
              sensitivity: float, missed: Array, log_weights: Array) -> None:
        """Take in that one anchor each (V,) is not heard: its rssi is censored (Tobin 1958)."""
        same = self._slots == sender[:, None]
        known, slot = same.any(axis=1)[:, None], 2 + same.argmax(axis=1)
        expected, cross, prior = self._expect(self._decades(position), loss, slot, known)
        std = np.sqrt((self.sigma * loss[2]) ** 2 + prior
                      + np.where(known, 0, self._anchor_variance))
        excess = (sensitivity - expected) / std
        log_weak = scipy.special.log_ndtr(excess)
        weak = (1 - missed[:, None]) * np.exp(log_weak)
        trust = np.where(used[:, None], weak / np.maximum(weak + missed[:, None], 1e-30), 0)
        log_weights += np.where(
            used[:, None], np.log(np.maximum(weak + missed[:, None], 1e-30)), 0)
        ratio = np.exp(-0.5 * excess ** 2 - log_weak) / math.sqrt(2 * math.pi)
        self._correct(cross, -trust * ratio / std,
                      trust * np.clip(ratio * (ratio + excess), 0, 1) / std ** 2)

    def _decades(self, position: Array) -> Array:
        """Return log10 of the distances [m] of all particles (V, N) to anchors (V, D)."""
        away = self._states[:, :, :self._dimension] - position[:, None].astype(np.float32)
        return np.log10(np.maximum(np.linalg.norm(away, axis=2), _NEAREST))

    def _expect(self, decade: Array, loss: tuple[Array, ...], slot: Array, known: Array
                ) -> tuple[Array, Array, Array]:
        """
        Return the rssi that all particles expect (V, N), and how its error goes with what is off.

        Those are its covariance with everything (V, N, S) and its variance (V, N). Only those
        (V, 1) bool that know the anchor have its own part in it.
        """
        reference, exponent, _ = loss
        vehicle, slope = np.arange(len(slot)), -10 * decade
        # Estimates depend on the distance, and so does what they gain; their error hardly.
        error, off = self._error.astype(np.float32), self._off
        own = known.astype(np.float32)
        cross = (error[:, None, 0] + slope[:, :, None] * error[:, None, 1]
                 + own[:, :, None] * error[vehicle, slot][:, None])
        total = off[:, :, 0] + slope * off[:, :, 1] + own * off[vehicle, :, slot]
        prior = cross[:, :, 0] + slope * cross[:, :, 1] + own * cross[vehicle, :, slot]
        return reference + exponent * slope + total, cross, prior

    def _correct(self, cross: Array, change: Array, told: Array) -> None:
        """Correct what is off by so much (V, N) of its covariance (V, N, S) with what is told."""
        self._off = self._off + (change[:, :, None] * cross).astype(np.float32)
        share = (self._weights * told)[:, :, None] * cross
        self._error = self._error - np.swapaxes(share, 1, 2).astype(float) @ cross

    def _slot(self, used: Array, sender: Array) -> Array:
        """Return where each vehicle remembers a sender (V,), from now on if it did not yet."""
        same = self._slots == sender[:, None]
        slot = np.where(same.any(axis=1), same.argmax(axis=1), self._last.argmin(axis=1))
        new = np.flatnonzero(used & ~same.any(axis=1))
        self._slots[new, slot[new]] = sender[new]
        self._off[new, :, 2 + slot[new]] = 0
        self._error[new, 2 + slot[new]] = 0
        self._error[new, :, 2 + slot[new]] = 0
        self._error[new, 2 + slot[new], 2 + slot[new]] = self._anchor_variance
        heard = np.flatnonzero(used)
        self._last[heard, slot[heard]] = self._epochs
        return 2 + slot

    def _place(self, position: Array, rssi: Array, used: Array, loss: tuple[Array, ...]
               ) -> Array:
        """
        Draw the particles of vehicles without a belief, and return all log-weights (V, N).

        They are drawn around the anchors that are heard, by about how likely they are; their
        weights make up for that.
        """
        assert self._motion is not None
        log_weights = np.log(np.maximum(self._weights, 1e-30))
        vehicle = np.flatnonzero(~self._placed & (used.sum(axis=1) >= _ENOUGH))
        for rows in chunks(len(vehicle), _CANDIDATES * used.shape[1], _AT_ONCE):
            some = vehicle[rows]
            place, counts = position[some], used[some]
            low = np.where(counts[:, :, None], place, np.inf).min(axis=1)[:, None]
            high = np.where(counts[:, :, None], place, -np.inf).max(axis=1)[:, None]
            margin = (high - low).max(axis=2, keepdims=True) / 2
            points = low - margin + (high - low + 2 * margin) * self._rng.random(
                (len(some), _CANDIDATES, self._dimension))
            score = _PROPOSED * self._likely(
                points, place, np.where(counts, rssi[some], 0), counts,
                tuple(part[some] for part in loss))
            index = even_resample(points, normalize(score)[0], _PARTICLES, self._rng)
            drawn = np.take_along_axis(points, index[:, :, None], axis=1)
            apart = margin * _CANDIDATES ** (-1 / self._dimension)
            self._states[some, :, :self._dimension] = drawn + apart * (
                self._rng.standard_normal(drawn.shape))
            self._states[some, :, self._dimension:] = self._motion.draw(
                len(some), _PARTICLES, self._rng)
            self._begin(some)
            log_weights[some] = -np.take_along_axis(score, index, axis=1)
        return log_weights

    def _likely(self, points: Array, place: Array, rssi: Array, used: Array,
                loss: tuple[Array, ...]) -> Array:
        """Return log-likelihoods (V, P) of rssi (V, K) at points (V, P, D), whatever is off."""
        reference, exponent, sigma = (
            part[:, None] for part in (loss[0] + self.mean[0], loss[1] + self.mean[1], loss[2]))
        decade = np.log10(np.maximum(
            np.linalg.norm(points[:, :, None] - place[:, None], axis=3), _NEAREST))
        residual = rssi[:, None] - reference + 10 * exponent * decade
        weight = np.where(used[:, None], 1 / (sigma ** 2 + self._anchor_variance), 0)
        slope = np.stack([np.ones_like(decade), -10 * decade], axis=2)
        told = slope @ (weight * residual)[:, :, :, None]
        # P_0 and n are integrated out.
        joint = np.linalg.inv(self.covariance) + (slope * weight[:, :, None]) @ np.swapaxes(
            slope, 2, 3)
        explained = (told * np.linalg.solve(joint, told)).sum(axis=(2, 3))
        return np.asarray(0.5 * (explained - (weight * residual ** 2).sum(axis=2)
                                 - np.linalg.slogdet(joint)[1]))

    def _begin(self, vehicle: Array) -> None:
        self._weights[vehicle] = 1 / _PARTICLES
        self._placed[vehicle] = True
        self._doubts[vehicle] = 0

    def _resample(self) -> None:
        low = np.flatnonzero(self._placed & (
            effective_sample_size(self._weights) < _PARTICLES / 2))
        if not len(low):
            return
        index = systematic_resample(self._weights[low], _PARTICLES, self._rng)[:, :, None]
        states = np.take_along_axis(self._states[low], index, axis=1)
        place = states[:, :, :self._dimension]
        place += (_JITTER * spread(place))[:, None, None] * self._rng.standard_normal(
            place.shape, np.float32)
        self._states[low] = states
        self._off[low] = np.take_along_axis(self._off[low], index, axis=1)
        self._weights[low] = 1 / _PARTICLES

    def _where(self) -> tuple[Array, Array]:
        """Return mean (V, D) and covariance (V, D, D) of where vehicles are: as of a cloud."""
        return moments(self._states[:, :, :self._dimension], self._weights,
                       error=1 / effective_sample_size(self._weights))

    def _moments(self) -> tuple[Array, Array]:
        """Return mean (V, S) and covariance (V, S, S) of what is off."""
        mean, between = moments(self._off, self._weights)
        return mean, self._error + between

    def _share(self, taught: Array) -> None:
        """Join what the vehicles have learnt in common, each from the same prior."""
        if not taught.any():
            return
        mean, covariance = (part[taught] for part in self._known)
        unit = np.sqrt(np.diag(self._prior))
        values, axes = np.linalg.eigh(covariance[:, :2, :2] / np.outer(unit, unit))
        information = np.einsum('vij,vj,vkj->ik', axes, 1 / np.minimum(values, 1) - 1, axes)
        told = np.einsum('vij,vj,vkj,vk->i', axes, 1 / np.minimum(values, 1), axes,
                         mean[:, :2] / unit)
        joint = np.linalg.inv(np.eye(2) + information)
        self.mean, self.covariance = unit * (joint @ told), np.outer(unit, unit) * joint


def _beyond(excess: Array) -> tuple[Array, Array]:
    """
    Return the mean and variance of a standard normal variable of which more than -excess is seen.

    The variance is also by how much the mean of what is seen follows that of all.
    """
    excess = np.minimum(excess, 30.0)  # beyond, all is seen
    ratio = np.exp(-0.5 * excess ** 2 - scipy.special.log_ndtr(excess)) / math.sqrt(2 * math.pi)
    return ratio, np.clip(1 - ratio * (ratio + excess), 0.05, 1)
