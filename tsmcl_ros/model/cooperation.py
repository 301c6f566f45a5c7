"""
Filters that draw particles from around the references that a vehicle has ranges to.

References are anchors, and neighbours that are localized already; what their covariance makes of
a range is the evidence's to say.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cloud import CloudConfig
from tsmcl_ros.model.density import CloudDensity
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particle_filter import ParticleFilter
from tsmcl_ros.model.particles import normalize, spread
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.ranging import without_ranges
from tsmcl_ros.types import Array, ConfigError, Estimate, Observation

_AT_ONCE = 500_000  # numbers that are worked on at a time, so that they stay in the cache


@dataclass(frozen=True)
class CooperationConfig(CloudConfig):
    """How many samples are drawn."""

    reference_samples: int = param(
        100, 'samples around each reference, M', low=2, high=100_000, live=True)


@dataclass(frozen=True, eq=False)
class Proposal:
    """
    Candidates for the particles of W vehicles, drawn from what they heard.

    Attributes
    ----------
    points : (W, P, 2) float32
        [m].
    valid : (W, P) bool
        False where padded.
    unsettled : (W, 2) float
        How far the estimate moved where the search for them has not come to its end [m].
    grain : (W,) float
        Standard deviation of the kernel that each stands for [m].

    """

    exact: ClassVar[bool] = True  # whether the score is the evidence's own log-likelihood

    points: Array
    valid: Array
    unsettled: Array
    grain: Array

    def score(self, points: Array) -> tuple[Array, Array]:
        """Return log-likelihoods (W, P) of points (W, P, 2), and ln of the density drawn from."""
        raise NotImplementedError


class CooperativeFilter(ParticleFilter):
    """
    What cooperative methods share: everything but what they propose.

    A vehicle's predicted cloud joins the proposal as one source more: candidates of both are
    weighed by belief and evidence over the density that they were drawn with (the balance
    heuristic of Veach and Guibas 1995), so that nothing counts twice. A vehicle without any range
    is localized by what it heard and did not hear, as by a bootstrap filter.

    Attributes
    ----------
    settled : (V,) bool
        Whether the search among the last ranges came to its end. A vehicle placed by ranges alone
        that did not settle is no reference for others yet: its last move adds to its covariance.

    Raises
    ------
    ConfigError
        If the dimension is not 2.

    """

    def __init__(self, config: CooperationConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        if dimension != 2:
            raise ConfigError(
                f'dimension: {dimension} is not allowed for cooperative methods, must be 2')
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config: CooperationConfig = config
        self.settled = np.zeros(vehicles, bool)

    def propose(self, observation: Observation) -> Proposal:
        """Draw candidates for vehicles that all have a range. Methods differ in this."""
        raise NotImplementedError

    def cost(self, references: int) -> int:
        """Return how many numbers a vehicle with so many references takes at a time."""
        samples = references * self.config.reference_samples + self.config.min_particles
        return references * samples

    def update(self, observation: Observation) -> Estimate:
        """Draw the particles from around the references and from the prediction."""
        evidence = self.channel.evidence(observation)
        unsettled, new = np.zeros((len(self.settled), 2)), ~self.cloud.placed
        log_likelihood = np.full(self.cloud.weights.shape, np.nan, np.float32)
        for vehicle in self._portions(observation):
            proposal = self.propose(observation.of(vehicle).trimmed())
            unsettled[vehicle], scored = self.locate(proposal, vehicle)
            if proposal.exact:
                log_likelihood[vehicle] = scored
        self.cloud.place(evidence)
        rest = np.flatnonzero(np.isnan(log_likelihood[:, 0]))
        if len(rest):
            log_likelihood[rest] = self.channel.evidence(
                observation.of(rest)).log_likelihood(self.cloud.particles[rest])
        # Who is placed by this very evidence, however unlikely, has no belief that it excludes.
        self.cloud.weigh(self.cloud.recover(evidence, log_likelihood, spared=new))
        estimate = self.cloud.estimate(observation)
        unranged = np.zeros(len(new), bool)
        unranged[rest] = True
        self.cloud.resample(unranged)
        return replace(estimate, covariance=estimate.covariance
                       + unsettled[:, :, None] * unsettled[:, None, :])

    def locate(self, proposal: Proposal, vehicle: Array) -> tuple[Array, Array]:
        """
        Draw the particles of some vehicles (W,) from a proposal, and from their belief.

        Returns
        -------
        unsettled : (W, 2) float
            How far the estimates of those without a belief moved to the last [m].
        scored : (W, N) float32
            The log-likelihoods that the proposal gave what the particles were drawn from.

        """
        self.settled[vehicle] = ~proposal.unsettled.any(axis=1)
        placed = self.cloud.placed[vehicle]
        target, drawn = proposal.score(proposal.points)
        log_weights = np.where(proposal.valid, target - drawn, -np.inf)
        new = vehicle[~placed]
        weights, _ = normalize(log_weights[~placed])
        index = self.cloud.fill(new, proposal.points[~placed], weights)
        scored = np.empty((len(vehicle), index.shape[1]), np.float32)
        scored[~placed] = np.take_along_axis(target[~placed], index, axis=1)
        shape = (len(new), self.cloud.states.shape[1], 2)
        noise = self.rng.standard_normal(shape, np.float32)
        self.cloud.states[new, :, :2] += proposal.grain[~placed, None, None] * noise
        self.cloud.states[new, :, 2:] = self.cloud.motion.draw(*shape[:2], self.rng)
        if placed.any():
            scored[placed] = self._fuse(proposal, vehicle, placed, target, drawn)
        return np.where(placed[:, None], 0, proposal.unsettled), scored

    def _fuse(self, proposal: Proposal, vehicle: Array, placed: Array, target: Array,
              drawn: Array) -> Array:
        """Draw the particles of the vehicles that are placed from both sources; score them."""
        cloud, old = self.cloud, vehicle[placed]
        # Copies part, as where the filters without a proposal resample.
        particles = cloud.particles[vehicle]
        noise = self.rng.standard_normal(particles.shape, np.float32)
        density = CloudDensity.of(particles[placed], cloud.weights[old], self.rng)
        jitter = np.float32(cloud.config.jitter) * spread(particles)[:, None, None]
        particles = particles + jitter * noise
        own, drawn_own = proposal.score(particles)
        points = np.concatenate([particles, proposal.points], axis=1)[placed]
        target = np.concatenate([own, target], axis=1)[placed]
        drawn = np.concatenate([drawn_own, drawn], axis=1)[placed]
        count = particles.shape[1]
        belief, parent = density.log_density(points)
        proposed = proposal.valid[placed].sum(axis=1, keepdims=True)
        share = count / (count + proposed)
        log_weights = target + belief - np.logaddexp(
            np.log(share) + belief, np.log1p(-share) + drawn)
        # Weighted particles stand for more or less of the belief than their number says.
        log_weights[:, :count] += np.log(count * cloud.weights[old] + np.float32(1e-30))
        log_weights[:, count:][~proposal.valid[placed]] = -np.inf
        weights, _ = normalize(log_weights)
        parent[:, :count] = np.arange(count)
        states = cloud.states[old]
        index = cloud.fill(old, points, weights)
        parent = np.take_along_axis(parent, index, axis=1)
        cloud.states[old, :, 2:] = np.take_along_axis(states, parent[:, :, None], axis=1)[:, :, 2:]
        return np.take_along_axis(target, index, axis=1)

    def _portions(self, observation: Observation) -> Iterator[Array]:
        """
        Yield the indices of the vehicles with ranges, in portions that fit into the cache.

        Those with as many references come together, which makes for little padding.
        """
        ranging, _ = without_ranges(self.channel.evidence(observation))
        if ranging is None:
            return
        references = ranging.used.sum(axis=(1, 2))
        order = np.argsort(-references, kind='stable')[:np.count_nonzero(references)]
        while len(order):
            size = max(_AT_ONCE // self.cost(int(references[order[0]])), 1)
            yield order[:size]
            order = order[size:]
