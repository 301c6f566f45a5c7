"""A fleet's weighted particle clouds, and the steps that every particle filter is composed of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import draw, MotionModel
from tsmcl_ros.model.particles import (
    best_bandwidth,
    chunks,
    effective_sample_size,
    even_resample,
    kernel_density,
    log_cauchy,
    moments,
    normalize,
    spread,
    systematic_resample,
)
from tsmcl_ros.types import Array, ConfigError, Estimate, Motion, Observation, Prior

# Kernels that the density of a cloud is estimated by, and the most that a particle's weight grows
# where it says that too few of them are.
_KERNELS = 128
_MOST_FAVOURED = 20.0
# Candidates drawn at once when vehicles are placed, lest a fleet's first epoch take much memory.
_CANDIDATES = 1 << 17

# Improves points (M, D) [m] and their log-likelihoods (M,), given the vehicles (M,), a length
# scale (M,) [m] and the evidence.
Repair = Callable[[Array, Array, Array, Array, Evidence], tuple[Array, Array]]


@dataclass(frozen=True)
class RecoveryConfig(Config):
    """When a belief has lost its vehicle."""

    exclusion: float = param(
        25.0, 'place a vehicle anew when the log-likelihood of its belief, at its best particle '
        'if it has any, is below minus this and 0.7 a reference', above=0.0, live=True)
    patience: int = param(
        5, 'epochs in a row in which a belief, at its best particle if it has any, takes most '
        'measurements for outliers, before the vehicle is placed anew', low=1, live=True)

    def excludes(self, best: Array, terms: Array) -> Array:
        """Return what (V,) bool evidence of so many terms excludes, at best so likely in log."""
        return np.asarray(best < -self.exclusion - 0.7 * terms)


@dataclass(frozen=True)
class CloudConfig(RecoveryConfig):
    """How many particles a vehicle gets, and when they are resampled or drawn anew."""

    min_particles: int = param(200, 'particles of a vehicle', low=2, high=1_000_000)
    max_particles: int = param(
        2000, "candidates that a vehicle's particles are drawn from when it is first placed",
        low=2, high=10_000_000, live=True)
    resample_threshold: float = param(
        0.5, 'resample when the effective sample size falls below this share of the particles',
        low=0.0, high=1.0, live=True)
    jitter: float = param(
        0.05, 'noise on resampled particles, in standard deviations of the cloud, so that '
        'copies part', low=0.0, high=1.0, live=True)

    def check(self) -> None:
        """Hold that the first epoch has at least as many particles as the later ones."""
        if self.max_particles < self.min_particles:
            raise ConfigError(
                f'max_particles: {self.max_particles} is not allowed, must be at least '
                f'min_particles, {self.min_particles}')


class Cloud:
    """
    Particles of V vehicles, placed when a vehicle first hears a beacon.

    Attributes
    ----------
    states : (V, N, D + extra) float32
        Positions [m], then what the motion model remembers.
    weights : (V, N) float32
        Each vehicle's sum to 1.
    placed : (V,) bool
        False for a vehicle that never heard a beacon.

    """

    def __init__(self, config: CloudConfig, motion: MotionModel, vehicles: int, dimension: int,
                 rng: np.random.Generator):
        self.config = config
        self.motion = motion
        self.dimension = dimension
        self.rng = rng
        count = config.min_particles
        self.states = np.zeros((vehicles, count, dimension + motion.extra), np.float32)
        self.weights = np.full((vehicles, count), 1 / count, np.float32)
        self.placed = np.zeros(vehicles, bool)
        self._log_likelihood = np.full(vehicles, np.nan)
        self._drawn = np.zeros(vehicles, bool)
        self._doubts = np.zeros(vehicles, int)
        self._reinitialized = np.zeros(vehicles, bool)

    @property
    def particles(self) -> Array:
        """(V, N, D) float32: the positions [m]."""
        return self.states[:, :, :self.dimension]

    def predict(self, motion: Motion) -> None:
        """Move the particles by the motion model."""
        self.states = self.motion.predict(self.states, motion, self.rng)

    def start(self, prior: Prior) -> None:
        """Draw one vehicle's particles from a prior belief."""
        index = prior.vehicle
        self.states[index] = draw(prior, self.motion, self.config.min_particles, self.rng)
        self._begin(index)

    def forget(self, vehicle: Array | int) -> None:
        """Place a vehicle, or some (V,) bool, anew at the next beacon."""
        self.placed[vehicle] = False

    def place(self, evidence: Evidence, repair: Repair | None = None) -> None:
        """Draw particles for the vehicles that hear a beacon for the first time."""
        self._reinitialized = np.zeros(len(self.placed), bool)
        self._draw(evidence.heard & ~self.placed, evidence, repair)

    def place_again(self, which: Array, evidence: Evidence, repair: Repair | None = None,
                    nearby: bool = False) -> None:
        """
        Draw the clouds of vehicles anew.

        Parameters
        ----------
        which : (V,) bool
            Theirs.
        evidence : Evidence
            What was heard.
        repair : Repair, optional
            For candidates of whom hardly any is likely.
        nearby : bool
            Whether the old cloud still says something: a density as heavy-tailed as Cauchy's, so
            that it does not matter how far beyond all expectation a vehicle is.

        """
        self._draw(which, evidence, repair, nearby)
        self._reinitialized = self._reinitialized | which

    def excluded(self, evidence: Evidence, log_likelihood: Array) -> Array:
        """
        Return the vehicles (V,) bool of which the evidence excludes even the best particle.

        That is at once where presence says so, and by a row of epochs where measurements do,
        whose likelihood has a floor.
        """
        best = log_likelihood.max(axis=1)
        # One outlier is no news of the vehicle; a row of epochs that are nothing but outliers is.
        self._doubts = np.where(best < evidence.floor / 2, self._doubts + 1,
                                np.where(evidence.heard, 0, self._doubts))
        hopeless = self.config.excludes(best, evidence.terms)
        return np.asarray(self.placed & (hopeless | (self._doubts >= self.config.patience)))

    def recover(self, evidence: Evidence, log_likelihood: Array, repair: Repair | None = None,
                spared: Array | None = None) -> Array:
        """
        Draw the excluded clouds anew; return the log-likelihood (V, N) of all particles.

        Parameters
        ----------
        evidence : Evidence
            What was heard.
        log_likelihood : (V, N) float32
            Of the particles under it.
        repair : Repair, optional
            For those drawn anew.
        spared : (V,) bool, optional
            Vehicles whose clouds are not.

        """
        excluded = self.excluded(evidence, log_likelihood)
        if spared is not None:
            excluded &= ~spared
        if not excluded.any():
            return log_likelihood
        self.place_again(excluded, evidence, repair)
        return evidence.log_likelihood(self.particles)

    def fill(self, vehicle: Array, candidates: Array, weights: Array) -> Array:
        """
        Draw the particles of some vehicles from candidates that the evidence has weighed.

        Parameters
        ----------
        vehicle : (W,) int
            Their indices.
        candidates : (W, P, D) float32
            Positions [m].
        weights : (W, P) float32
            Posterior weights; each vehicle's sum to 1.

        Returns
        -------
        (W, N) int
            Which candidates the particles are.

        """
        index = systematic_resample(weights, self.weights.shape[1], self.rng)
        self.states[vehicle, :, :self.dimension] = np.take_along_axis(
            candidates, index[:, :, None], axis=1)
        self._begin(vehicle)
        self._drawn[vehicle] = True
        return index

    def put(self, vehicle: Array, position: Array) -> None:
        """Put the particles of vehicles (W,) int at positions (W, N, D) [m], all alike likely."""
        count = position.shape[1]
        self.states[vehicle, :, :self.dimension] = position
        self.states[vehicle, :, self.dimension:] = self.motion.draw(
            len(vehicle), count, self.rng)
        self._begin(vehicle)

    def weigh(self, log_likelihood: Array) -> None:
        """Multiply the weights by the likelihood of the evidence (V, N)."""
        with np.errstate(divide='ignore'):
            log_weights = np.log(self.weights) + log_likelihood
        self.weights, self._log_likelihood = normalize(log_weights)
        # Particles drawn from this very evidence would count it twice.
        self._equalize(self._drawn)
        self._drawn[:] = False

    def favour(self, vehicle: Array, predicted: Array, bandwidth: float) -> None:
        """
        Multiply the weights of moved particles by predicted over present density.

        That is importance sampling with the moved cloud as the proposal. Both densities are
        estimated by the same kernels at a part of the particles, drawn by their weights.

        Parameters
        ----------
        vehicle : (U,) int
            Vehicles whose particles were moved.
        predicted : (V, N, D) float32
            Where all particles were before [m].
        bandwidth : float
            Of the kernels, in standard deviations of the predicted cloud.

        """
        before, now, weights = predicted[vehicle], self.particles[vehicle], self.weights[vehicle]
        count = min(_KERNELS, weights.shape[1])
        kernels = systematic_resample(weights, count, self.rng)[:, :, None]
        width = np.maximum(np.float32(bandwidth) * spread(before), np.float32(1e-3))
        ratio = (
            kernel_density(now, np.take_along_axis(before, kernels, axis=1), width)
            / kernel_density(now, np.take_along_axis(now, kernels, axis=1), width))
        # A particle far from all kernels, which the moved cloud has as well, proves nothing.
        weights = weights * np.minimum(ratio, _MOST_FAVOURED)
        self.weights[vehicle] = weights / weights.sum(axis=1, keepdims=True)

    def moments(self) -> tuple[Array, Array]:
        """
        Return the weighted mean (V, D) [m] and covariance (V, D, D) [m^2], NaN where unplaced.

        A mean of few effective particles is off by chance, with about the cloud's covariance over
        their number; it is added, so that a cloud of which one particle is left does not claim
        to be certain.
        """
        mean, covariance = moments(
            self.particles, self.weights, error=1 / effective_sample_size(self.weights))
        mean[~self.placed] = np.nan
        covariance[~self.placed] = np.nan
        return mean, covariance

    def estimate(self, observation: Observation) -> Estimate:
        """Return the moments of every vehicle's cloud, and how it is doing."""
        mean, covariance = self.moments()
        rotation, rotation_variance = self._rotation()
        heard = observation.heard.sum(axis=1)
        return Estimate(
            stamp=observation.stamp, mean=mean, covariance=covariance,
            rotation=rotation, rotation_variance=rotation_variance,
            ess=effective_sample_size(self.weights), particles=self.states.shape[1],
            log_likelihood=np.where(heard > 0, self._log_likelihood, np.nan),
            heard=heard, reinitialized=self._reinitialized)

    def resample(self, broadly: Array | None = None) -> tuple[Array, Array]:
        """
        Resample the clouds whose effective sample size has fallen too low.

        Parameters
        ----------
        broadly : (V,) bool, optional
            Vehicles that nothing but resampling spreads, where hard edges have cut their clouds:
            their copies part as far as is best for the density that they stand for.

        Returns
        -------
        vehicle, index : (W,), (W, N) int
            Whose were resampled, and what their particles are copies of.

        """
        count = self.weights.shape[1]
        low = np.flatnonzero(self.placed & (
            effective_sample_size(self.weights) < self.config.resample_threshold * count))
        if not len(low):
            return low, np.zeros((0, count), int)
        index = systematic_resample(self.weights[low], count, self.rng)
        states = np.take_along_axis(self.states[low], index[:, :, None], axis=1)
        position = states[:, :, :self.dimension]
        noise = self.rng.standard_normal(position.shape, np.float32)
        width = np.full(len(position), self.config.jitter, np.float32)
        if broadly is not None:
            width[broadly[low]] = np.maximum(
                self.config.jitter, best_bandwidth(count, self.dimension))
        position += (width * spread(position))[:, None, None] * noise
        self.states[low] = states
        self._equalize(low)
        return low, index

    def _draw(self, which: Array, evidence: Evidence, repair: Repair | None,
              nearby: bool = False) -> None:
        """Draw candidates in the evidence's box and keep the likely ones as particles."""
        vehicle = np.flatnonzero(which)
        for rows in chunks(len(vehicle), self.config.max_particles, _CANDIDATES):
            self._draw_some(vehicle[rows], evidence, repair, nearby)

    def _draw_some(self, vehicle: Array, evidence: Evidence, repair: Repair | None,
                   nearby: bool) -> None:
        """Draw particles of some vehicles (W,) int."""
        many, few = self.config.max_particles, self.config.min_particles
        shape = (len(vehicle), many, self.dimension)
        low, high = evidence.box[vehicle, :1], evidence.box[vehicle, 1:]
        candidates = low + (high - low) * self.rng.random(shape, np.float32)
        owner = np.repeat(vehicle, many)
        flat = candidates.reshape(-1, self.dimension)
        likelihood = evidence.log_likelihood_of(flat, owner)
        weights, _ = normalize(likelihood.reshape(shape[:2]))
        # Enough candidates that are likely as drawn are uniform; repaired ones crowd at edges.
        scarce = np.repeat(effective_sample_size(weights) < few, many)
        if repair is not None and scarce.any():
            flat[scarce], likelihood[scarce] = repair(
                flat[scarce], likelihood[scarce], owner[scarce],
                np.repeat(spread(candidates), many)[scarce], evidence)
            weights, _ = normalize(likelihood.reshape(shape[:2]))
        points = flat.reshape(shape)
        if nearby:
            weights, _ = normalize(likelihood.reshape(shape[:2]) + log_cauchy(
                points, *moments(self.particles[vehicle], self.weights[vehicle])))
        index = even_resample(points, weights, few, self.rng)
        drawn = np.take_along_axis(points, index[:, :, None], axis=1)
        # A candidate stands for all that is nearer to it than to others. Where hardly any fits,
        # the cloud would else claim to be certain.
        owner, row = np.nonzero(np.diff(index, axis=1, prepend=-1) == 0)
        apart = spread(candidates) * many ** (-1 / self.dimension)
        drawn[owner, row] += apart[owner, None] * self.rng.standard_normal(
            (len(owner), self.dimension), np.float32)
        self.put(vehicle, drawn)
        self._drawn[vehicle] = True
        self._doubts[vehicle] = 0

    def _begin(self, vehicle: Array | int) -> None:
        """Take some vehicles for placed, by particles of equal weights."""
        self._equalize(vehicle)
        self.placed[vehicle] = True

    def _equalize(self, vehicle: Array | int) -> None:
        """Give some vehicles' particles equal weights."""
        self.weights[vehicle] = 1 / self.weights.shape[1]

    def _rotation(self) -> tuple[Array, Array]:
        """Return circular mean and variance (V,) of the headings, NaN where there are none."""
        weights = self.weights
        if not self.motion.heading:
            unknown = np.full(len(weights), np.nan)
            return unknown, unknown
        heading = self.states[:, :, self.dimension]
        cos = (weights * np.cos(heading)).sum(axis=1, dtype=np.float64)
        sin = (weights * np.sin(heading)).sum(axis=1, dtype=np.float64)
        variance = np.minimum(-2 * np.log(np.clip(np.hypot(cos, sin), 1e-9, 1)), math.pi ** 2)
        return (np.where(self.placed, np.arctan2(sin, cos), np.nan),
                np.where(self.placed, variance, np.nan))
