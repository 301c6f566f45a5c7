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
from tsmcl_ros.model.cloud import CloudConfig
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particle_filter import ParticleFilter
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
        log_likelihood = evidence.log_likelihood(self.cloud.particles)
        # A search finds the nearest edge of a region in all of which who is merely heard may be.
        vague = ~self.channel.measured(observation).any(axis=1)
        surprised = self.cloud.placed & vague & self.config.excludes(
            log_likelihood.max(axis=1), evidence.terms)
        if surprised.any():
            self.cloud.place_again(surprised, evidence, self.search, nearby=True)
            log_likelihood = evidence.log_likelihood(self.cloud.particles)
        log_likelihood = self.repair(evidence, log_likelihood)
        log_likelihood = self.cloud.recover(evidence, log_likelihood, self.search)
        self.cloud.weigh(log_likelihood)
        estimate = self.cloud.estimate(observation)
        self.cloud.resample()
        return estimate

    def repair(self, evidence: Evidence, log_likelihood: Array) -> Array:
        """
        Replace the particles that explain the evidence badly by what a search finds.

        Parameters
        ----------
        evidence : Evidence
            What was heard.
        log_likelihood : (V, N) float32
            Of the particles under it, which is spoiled.

        Returns
        -------
        (V, N) float32
            The log-likelihood of the repaired particles.

        """
        particles = self.cloud.particles
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
        found, reached = points.T.copy(), log_likelihood.copy()
        start = score(log_likelihood, evidence.terms[owner])
        search = _Search(points, start, scale, log_likelihood, config.tabu_length)
        search.keep(start <= config.aspiration)
        for iteration in range(config.max_iterations):
            if not len(search.index):
                break
            neighbours = search.neighbours(rng, config.tabu_radius, iteration)
            own = owner[search.index]
            likelihoods = evidence.log_likelihood_of(
                neighbours.reshape(len(neighbours), -1).T, np.concatenate([own, own]))
            better, likelihood = search.move(neighbours, likelihoods.reshape(2, -1), iteration)
            omega = score(likelihood, evidence.terms[own])
            bar = search.score + (1 - search.score) * rng.random(len(omega), np.float32)
            accepted = (omega > config.aspiration) | (omega > bar)
            found[:, search.index[accepted]] = better[:, accepted]
            reached[search.index[accepted]] = likelihood[accepted]
            search.keep(~accepted)
        found[:, search.index], reached[search.index] = search.best, search.best_likelihood
        return found.T, reached


class _Search:
    """
    The tabu searches still under way: arrays over particles, no loop over them.

    Searches run along the last axis of every array, so that what is reckoned of a coordinate lies
    together in memory.
    """

    def __init__(self, points: Array, start_score: Array, scale: Array, log_likelihood: Array,
                 tabu_length: int):
        count, dimension = points.shape
        self.index = np.arange(count)
        self.start, self.score, self.scale = points.T.copy(), start_score, scale
        self.best, self.best_likelihood = self.start.copy(), log_likelihood.copy()
        self.tabu = np.full((tabu_length, dimension, count), np.inf, np.float32)

    def keep(self, rows: Array) -> None:
        """Go on with these searches (M,) bool only."""
        if rows.all():
            return
        kept = np.flatnonzero(rows)
        for name, values in vars(self).items():
            setattr(self, name, values.take(kept, axis=-1))

    def neighbours(self, rng: np.random.Generator, tabu_radius: float, iteration: int) -> Array:
        """Return two positions (D, 2, M) [m] near each start, redrawn once where tabu."""
        step = (1 - self.score) * self.scale
        noise = rng.standard_normal((len(self.start), 2, len(step)), np.float32)
        drawn = self.start[:, None] + step * noise
        near = np.square(tabu_radius * self.scale)
        tabu = np.zeros(drawn.shape[1:], bool)
        for entry in self.tabu[:iteration]:
            apart = drawn - entry[:, None]
            apart *= apart
            tabu |= apart.sum(axis=0) < near
        which, again = np.nonzero(tabu)
        if len(again):
            noise = rng.standard_normal((len(drawn), len(again)), np.float32)
            drawn[:, which, again] = self.start[:, again] + step[again] * noise
        return drawn

    def move(self, neighbours: Array, likelihoods: Array, iteration: int
             ) -> tuple[Array, Array]:
        """
        Make the better neighbours tabu, and the best so far where they are.

        Neighbours are (D, 2, M) [m], their log-likelihoods (2, M); the better one's are returned.
        """
        first, second = likelihoods
        better = np.where(second > first, neighbours[:, 1], neighbours[:, 0])
        likelihood = np.maximum(first, second)
        self.tabu[iteration % len(self.tabu)] = better
        improved = likelihood > self.best_likelihood
        np.copyto(self.best, better, where=improved)
        np.copyto(self.best_likelihood, likelihood, where=improved)
        return better, likelihood


def score(log_likelihood: Array, terms: Array) -> Array:
    """Return omega in [0, 1]: the geometric mean of the evidence's likelihoods."""
    return np.exp(log_likelihood / terms)
