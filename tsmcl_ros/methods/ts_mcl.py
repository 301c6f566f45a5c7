"""
TS-MCL: Monte Carlo localization whose particles are repaired by tabu search.

Sun, Wang, Zhang: tabu search Monte Carlo localization, 2016. Two resolutions: the paper prints a
neighbourhood of 1 m, here it is the standard deviation of the predicted cloud, so that the search
matches the uncertainty at every stage; and scores are not normalized over the particles, because
normalized ones are about 1/N and could never pass the aspiration threshold.

The search goes wherever the newest evidence is satisfied. That brings vehicles back whose
prediction was wrong, but it also undoes what their way has ruled out; `prior_bandwidth` weighs
repaired clouds by how likely the prediction was where their particles are now, which is worth it
where many weak pieces of evidence have to add up and the models are right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cloud import CloudConfig, ParticleFilter
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particles import spread
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Estimate, Observation


@dataclass(frozen=True)
class TsMclConfig(CloudConfig):
    """The tabu search; with `max_iterations` 0 the method is a bootstrap filter."""

    max_iterations: int = param(
        10, "iterations of a particle's tabu search, 0 for none", low=0, high=1000, live=True)
    tabu_length: int = param(3, 'neighbours that the tabu list holds', low=1, high=100, live=True)
    tabu_radius: float = param(
        0.05, 'a neighbour this near to a tabu entry is drawn once more, in neighbourhood '
        'scales', low=0.0, high=1.0, live=True)
    neighbourhood_scale: float = param(
        0.0, 'length of a full step, 0 for the standard deviation of the predicted cloud',
        unit='m', low=0.0, live=True)
    neighbourhood_floor: float = param(
        0.5, 'least length of a full step', unit='m', low=0.0, live=True)
    aspiration: float = param(
        0.5, 'score above which a particle is good enough', above=0.0, high=1.0, live=True)
    prior_bandwidth: float = param(
        0.0, 'smoothing of the predicted density that repaired clouds are weighed by, in '
        "standard deviations of the cloud; 0 for the paper's way, which asks only what was "
        'heard', low=0.0, high=10.0, live=True)


class TsMcl(ParticleFilter):
    """TS-MCL of V vehicles: predict, repair the particles by tabu search, weigh, resample."""

    Config = TsMclConfig

    def __init__(self, config: TsMclConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config = config

    def update(self, observation: Observation) -> Estimate:
        """Repair and weigh the particles by what was heard."""
        evidence = self.channel.evidence(observation)
        self.cloud.place(evidence, self.search)
        log_likelihood = self.repair(evidence)
        log_likelihood = self.cloud.recover(evidence, log_likelihood, self.search)
        self.cloud.weigh(log_likelihood)
        estimate = self.cloud.estimate(observation)
        self.cloud.resample()
        return estimate

    def repair(self, evidence: Evidence) -> Array:
        """
        Replace the particles that explain the evidence badly by what a search finds.

        Returns
        -------
        (V, N) float32
            The log-likelihood of the repaired particles.

        """
        particles = self.cloud.particles
        log_likelihood = evidence.log_likelihood(particles)
        good = score(log_likelihood, evidence.terms[:, None]) > self.config.aspiration
        owner, index = np.nonzero(~good & self.cloud.placed[:, None])
        if not len(owner) or not self.config.max_iterations:
            return log_likelihood
        predicted = particles.copy() if self.config.prior_bandwidth > 0 else None
        particles[owner, index], log_likelihood[owner, index] = self.search(
            particles[owner, index], log_likelihood[owner, index], owner,
            spread(particles)[owner], evidence)
        if predicted is not None:
            self.cloud.favour(np.unique(owner), predicted, self.config.prior_bandwidth)
        return log_likelihood

    def search(self, points: Array, log_likelihood: Array, owner: Array, scale: Array,
               evidence: Evidence) -> tuple[Array, Array]:
        """
        Return better positions than the given ones, found by tabu search.

        Parameters
        ----------
        points : (M, D) float32
            Positions [m].
        log_likelihood : (M,) float32
            Of each.
        owner : (M,) int
            The vehicle of each.
        scale : (M,) float32
            Neighbourhood scale h [m], unless the config sets one.
        evidence : Evidence
            What the search's score comes from.

        Returns
        -------
        points : (M, D) float32
            Positions [m]; those above the aspiration threshold are left alone.
        log_likelihood : (M,) float32
            Of each.

        """
        config, rng = self.config, self.rng
        if config.neighbourhood_scale > 0:
            scale = np.full_like(scale, config.neighbourhood_scale)
        scale = np.maximum(scale, config.neighbourhood_floor)
        found, reached = points.copy(), log_likelihood.copy()
        start = score(log_likelihood, evidence.terms[owner])
        search = _Search(points, start, scale, log_likelihood, config.tabu_length)
        search.keep(start <= config.aspiration)
        for iteration in range(config.max_iterations):
            if not len(search.index):
                break
            neighbours = search.neighbours(rng, config.tabu_radius, iteration)
            both = np.repeat(owner[search.index], 2)
            likelihoods = evidence.log_likelihood_of(
                neighbours.reshape(len(both), -1), both).reshape(-1, 2)
            better, likelihood = search.move(neighbours, likelihoods, iteration)
            omega = score(likelihood, evidence.terms[owner[search.index]])
            bar = search.score + (1 - search.score) * rng.random(len(omega), np.float32)
            accepted = (omega > config.aspiration) | (omega > bar)
            found[search.index[accepted]] = better[accepted]
            reached[search.index[accepted]] = likelihood[accepted]
            search.keep(~accepted)
        found[search.index], reached[search.index] = search.best, search.best_likelihood
        return found, reached


class _Search:
    """The tabu searches still under way, one a row: arrays over particles, no loop over them."""

    def __init__(self, points: Array, start_score: Array, scale: Array, log_likelihood: Array,
                 tabu_length: int):
        count, dimension = points.shape
        self.index = np.arange(count)
        self.start, self.score, self.scale = points, start_score, scale
        self.best, self.best_likelihood = points, log_likelihood
        self.tabu = np.full((count, tabu_length, dimension), np.inf, np.float32)

    def keep(self, rows: Array) -> None:
        """Go on with the searches of these rows (M,) bool only."""
        for name, values in vars(self).items():
            setattr(self, name, values[rows])

    def neighbours(self, rng: np.random.Generator, tabu_radius: float, iteration: int) -> Array:
        """Return two positions (M, 2, D) [m] near each start, redrawn once where tabu."""
        shape = (len(self.index), 2, self.start.shape[1])
        step = ((1 - self.score) * self.scale)[:, None, None]
        drawn = self.start[:, None] + step * rng.standard_normal(shape, np.float32)
        tabu = np.zeros(shape[:2], bool)
        near = np.square(tabu_radius * self.scale)[:, None]
        # One entry and one axis after the other: sums of two or three numbers are slow.
        for entry in range(min(iteration, self.tabu.shape[1])):
            apart = np.square(drawn - self.tabu[:, None, entry])
            tabu |= sum(apart[:, :, axis] for axis in range(1, shape[2])) + apart[:, :, 0] < near
        if tabu.any():
            again = self.start[:, None] + step * rng.standard_normal(shape, np.float32)
            drawn = np.where(tabu[:, :, None], again, drawn)
        return drawn

    def move(self, neighbours: Array, likelihoods: Array, iteration: int
             ) -> tuple[Array, Array]:
        """Make the better neighbour tabu, and the best so far if it is; return it, its score."""
        rows, pick = np.arange(len(self.index)), likelihoods.argmax(axis=1)
        better, likelihood = neighbours[rows, pick], likelihoods[rows, pick]
        self.tabu[:, iteration % self.tabu.shape[1]] = better
        improved = likelihood > self.best_likelihood
        self.best[improved] = better[improved]
        self.best_likelihood[improved] = likelihood[improved]
        return better, likelihood


def score(log_likelihood: Array, terms: Array) -> Array:
    """Return omega in [0, 1]: the geometric mean of the evidence's likelihoods."""
    return np.exp(log_likelihood / terms)
