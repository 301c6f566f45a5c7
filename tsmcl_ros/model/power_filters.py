"""
Kalman filters of what path losses are off: one a particle, as rssi is linear given its distance.

States are what P_0 [dB] and n are off for all anchors alike, and then what the P_0 of each of
`SLOTS` anchors is off beside that [dB], which is forgotten again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from tsmcl_ros.model.censoring import hazard, seen_beyond
from tsmcl_ros.model.particles import moments
from tsmcl_ros.types import Array

# Anchors that a vehicle remembers offsets of, those that it has heard last.
SLOTS = 16
# Share of its prior that what is common to all anchors forgets in an epoch.
_FORGOTTEN = 1e-5
_TYPICAL = 10.0  # m, how far an anchor is that was not heard yet


class Anchor(NamedTuple):
    """
    One anchor of each of V vehicles, and what N particles expect of it.

    Attributes
    ----------
    used : (V,) bool
        Whether it counts.
    sender : (V,) int
        Who it is.
    decade : (V, N) float
        log10 of the distances to it [m].
    rssi : (V, N) float
        As path losses are taken to be [dBm].
    sigma : (V, 1) float
        Standard deviation of their noise [dB].

    """

    used: Array
    sender: Array
    decade: Array
    rssi: Array
    sigma: Array


class PowerFilters:
    """
    What path losses are off, as N particles of each of V vehicles have it; S states each.

    Parameters
    ----------
    vehicles, particles : int
        V and N.
    mean, covariance : (2,), (2, 2) float
        What is common to all anchors.
    anchor_variance : float
        Of what each one is off beside that [dB^2].

    """

    def __init__(self, vehicles: int, particles: int, mean: Array, covariance: Array,
                 anchor_variance: float):
        size = 2 + SLOTS
        self._anchor_variance = anchor_variance
        # Estimates depend on the distance, and so does what they gain; their error hardly.
        self._off = np.zeros((vehicles, particles, size), np.float32)
        self._off[:, :, :2] = mean
        self._error = np.zeros((vehicles, size, size))
        self._error[:, :2, :2] = covariance
        self._error[:, range(2, size), range(2, size)] = anchor_variance
        self._sender = np.full((vehicles, SLOTS), -1)
        self._decade = np.full((vehicles, SLOTS), math.log10(_TYPICAL))
        self._heard, self._count = np.zeros((vehicles, SLOTS), int), 0

    @property
    def decade(self) -> float:
        """How far anchors usually are: log10 of a distance [m]."""
        known = self._sender >= 0
        return float(self._decade[known].mean()) if known.any() else math.log10(_TYPICAL)

    def moments(self, weights: Array) -> tuple[Array, Array]:
        """Return mean (V, S) and covariance (V, S, S) of particles with weights (V, N)."""
        mean, between = moments(self._off, weights)
        return mean, self._error + between

    def forget(self, kept: float, prior: Array) -> None:
        """Keep so much of what anchors are off, and nearly all of what is common to them."""
        self._off[:, :, 2:] *= np.float32(kept)
        self._error[:, 2:] *= kept
        self._error[:, :, 2:] *= kept
        each = range(2, 2 + SLOTS)
        self._error[:, each, each] += (1 - kept ** 2) * self._anchor_variance
        self._error[:, :2, :2] += _FORGOTTEN * (prior - self._error[:, :2, :2])

    def find(self, sender: Array) -> tuple[Array, Array]:
        """Return which senders (V, K) are remembered (V, K) bool, and as which state (V, K)."""
        same = self._sender[:, None, :] == sender[:, :, None]
        return same.any(axis=2), 2 + same.argmax(axis=2)

    def measure(self, anchor: Anchor, rssi: Array, sensitivity: float, floor: float,
                weights: Array) -> tuple[Array, Array, Array]:
        """
        Take in one rssi of each vehicle.

        Parameters
        ----------
        anchor : Anchor
            Whose.
        rssi : (V,) float
            [dBm].
        sensitivity : float
            Weaker ones are not heard [dBm], so that who is far is louder than on average.
        floor : float
            Share of rssi that may say anything.
        weights : (V, N) float
            Of the particles.

        Returns
        -------
        log_likelihood, trust, squared : (V, N) float
            How likely it is, by how much it is believed, and what is left of it, squared, over the
            variance of its noise.

        """
        used, sigma = anchor.used[:, None], anchor.sigma
        state = self._remember(anchor, weights)
        off, cross, prior = self._expect(anchor.decade, state, np.ones((len(state), 1), bool))
        expected = anchor.rssi + off
        shift, kept = seen_beyond((expected - sensitivity) / np.sqrt(sigma ** 2 + prior))
        sigma = sigma * np.sqrt(kept)
        variance = kept ** 2 * prior + sigma ** 2
        residual = np.where(anchor.used, rssi, 0)[:, None] - expected - (
            shift * sigma / np.sqrt(kept))
        sound = (1 - floor) * np.exp(-0.5 * residual ** 2 / variance) * (
            sigma / np.sqrt(variance))
        log_likelihood, trust = _mixed(sound, floor, used)
        gain = trust * kept / variance
        self._correct(cross, gain * residual, weights * (gain * kept))
        return log_likelihood, trust, (
            (sigma * residual / variance) ** 2 + kept ** 2 * prior / variance)

    def miss(self, anchor: Anchor, sensitivity: float, missed: Array, weights: Array) -> Array:
        """
        Take in that one anchor of each vehicle is not heard: its rssi is censored (Tobin 1958).

        Parameters
        ----------
        anchor, sensitivity, weights
            As for `measure`.
        missed : (V,) float
            Share of beacons that are lost however near they are.

        Returns
        -------
        (V, N) float
            The log-likelihood.

        """
        known, state = self.find(anchor.sender[:, None])
        off, cross, prior = self._expect(anchor.decade, state[:, 0], known)
        std = np.sqrt(anchor.sigma ** 2 + prior + np.where(known, 0, self._anchor_variance))
        excess = (sensitivity - (anchor.rssi + off)) / std
        ratio, log_weak = hazard(excess)
        lost = missed[:, None]
        log_likelihood, trust = _mixed(
            (1 - lost) * np.exp(log_weak), lost, anchor.used[:, None])
        self._correct(cross, -trust * ratio / std, weights * (
            trust * np.clip(ratio * (ratio + excess), 0, 1) / std ** 2))
        return log_likelihood

    def _remember(self, anchor: Anchor, weights: Array) -> Array:
        """Return which state (V,) an anchor is, by now in place of that heard longest ago."""
        known, state = (found[:, 0] for found in self.find(anchor.sender[:, None]))
        state = np.where(known, state, 2 + self._heard.argmin(axis=1))
        new, heard = np.flatnonzero(anchor.used & ~known), np.flatnonzero(anchor.used)
        column = state[new]
        self._off[new, :, column] = 0
        self._error[new, column] = 0
        self._error[new, :, column] = 0
        self._error[new, column, column] = self._anchor_variance
        self._sender[new, column - 2] = anchor.sender[new]
        self._count += 1
        self._heard[heard, state[heard] - 2] = self._count
        self._decade[heard, state[heard] - 2] = (weights * anchor.decade).sum(axis=1)[heard]
        return state

    def _expect(self, decade: Array, state: Array, known: Array) -> tuple[Array, Array, Array]:
        """
        Return what an anchor's rssi are off (V, N) [dB], and how its error goes with the states.

        Those are its covariance with all (V, N, S), and its variance (V, N). Only those (V, 1)
        bool that know the anchor's state (V,) have its own part in it.
        """
        vehicle, slope = np.arange(len(state)), -10 * decade
        error, own = self._error.astype(np.float32), known.astype(np.float32)
        cross = (error[:, None, 0] + slope[:, :, None] * error[:, None, 1]
                 + own[:, :, None] * error[vehicle, state][:, None])
        total, variance = (
            of[:, :, 0] + slope * of[:, :, 1] + own * of[vehicle, :, state]
            for of in (self._off, cross))
        return total, cross, variance

    def _correct(self, cross: Array, change: Array, told: Array) -> None:
        """Correct by so much (V, N) of covariances (V, N, S), with what is told (V, N)."""
        self._off = self._off + (change[:, :, None] * cross).astype(np.float32)
        share = told[:, :, None] * cross
        self._error = self._error - np.swapaxes(share, 1, 2).astype(float) @ cross

    def resample(self, vehicle: Array, index: Array) -> None:
        """Make the particles of vehicles (W,) copies of those that (W, N) indices say."""
        self._off[vehicle] = np.take_along_axis(self._off[vehicle], index[:, :, None], axis=1)


def _mixed(likelihood: Array, floor: Array | float, used: Array) -> tuple[Array, Array]:
    """Return the logarithm of a likelihood (V, N) with a floor, and its share in that."""
    total = np.maximum(likelihood + floor, 1e-30)
    return np.where(used, np.log(total), 0), np.where(used, likelihood / total, 0)
