"""
TS-MCL: Monte Carlo localization whose particles are repaired by tabu search.

Sun, Wang, Zhang: tabu search Monte Carlo localization, 2016. Two resolutions: the paper prints a
neighbourhood of 1 m, here it is the standard deviation of the predicted cloud, so that the search
matches the uncertainty at every stage; and scores are not normalized over the particles, because
normalized ones are about 1/N and could never pass the aspiration threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cloud import CloudConfig, ParticleFilter, spread
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.radio import Channel, Evidence
from tsmcl_ros.types import Array, Estimate, Observation


@dataclass(frozen=True)
class TsMclConfig(CloudConfig):
    """The tabu search; with `max_iterations` 0 the method is a bootstrap filter."""

    max_iterations: int = param(
        10, "iterations of a particle's tabu search, 0 for none", low=0, high=1000)
    tabu_length: int = param(3, 'neighbours that the tabu list holds', low=1, high=100)
    tabu_radius: float = param(
        0.05, 'a neighbour this near to a tabu entry is drawn once more, in neighbourhood '
        'scales', low=0.0, high=1.0)
    neighbourhood_scale: float = param(
        0.0, 'length of a full step, 0 for the standard deviation of the predicted cloud',
        unit='m', low=0.0)
    neighbourhood_floor: float = param(
        0.5, 'least length of a full step', unit='m', low=0.0)
    aspiration: float = param(
        0.5, 'score above which a particle is good enough', above=0.0, high=1.0)


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
        self.repair(evidence)
        self.cloud.place_again(self.cloud.excluded(evidence), evidence, self.search)
        self.cloud.weigh(evidence)
        estimate = self.cloud.estimate(observation)
        self.cloud.resample()
        return estimate

    def repair(self, evidence: Evidence) -> None:
        """Replace the particles that explain the evidence badly by what a search finds."""
        if self.config.max_iterations == 0:
            return
        particles = self.cloud.particles
        poor = score(evidence.log_likelihood(particles), evidence.terms[:, None])
        owner, index = np.nonzero(
            (poor <= self.config.aspiration) & self.cloud.placed[:, None])
        if len(owner):
            self.cloud.particles[owner, index] = self.search(
                particles[owner, index], owner, spread(particles)[owner], evidence)

    def search(self, points: Array, owner: Array, scale: Array, evidence: Evidence) -> Array:
        """
        Return better positions than the given ones, found by tabu search.

        Parameters
        ----------
        points : (M, D) float32
            Positions [m].
        owner : (M,) int
            The vehicle of each.
        scale : (M,) float32
            Neighbourhood scale h [m], unless the config sets one.
        evidence : Evidence
            What the search's score comes from.

        Returns
        -------
        (M, D) float32
            Positions [m]; those above the aspiration threshold are left alone.
        """
        config, rng = self.config, self.rng
        if config.neighbourhood_scale > 0:
            scale = np.full_like(scale, config.neighbourhood_scale)
        start = score(evidence.log_likelihood_of(points, owner), evidence.terms[owner])
        found = points.copy()
        search = _Search(points, start, np.maximum(scale, config.neighbourhood_floor),
                         config.tabu_length).only(start <= config.aspiration)
        for iteration in range(config.max_iterations):
            if not len(search.index):
                break
            neighbours = search.neighbours(rng, config.tabu_radius)
            two_owners = np.repeat(owner[search.index], 2)
            scores = score(
                evidence.log_likelihood_of(neighbours.reshape(len(two_owners), -1), two_owners),
                evidence.terms[two_owners]).reshape(-1, 2)
            better, reached = search.move(neighbours, scores, iteration)
            accepted = (reached > config.aspiration) | (
                reached > search.start_score
                + (1 - search.start_score) * rng.random(len(reached), np.float32))
            found[search.index[accepted]] = better[accepted]
            search = search.only(~accepted)
        found[search.index] = search.best
        return found


class _Search:
    """The tabu searches still under way, one a row: arrays over particles, no loop over them."""

    def __init__(self, points: Array, start_score: Array, scale: Array, tabu_length: int):
        count, dimension = points.shape
        self.index = np.arange(count)
        self.start, self.start_score, self.scale = points, start_score, scale
        self.best, self.best_score = points.copy(), start_score.copy()
        self.tabu = np.full((count, tabu_length, dimension), np.inf, np.float32)

    def only(self, rows: Array) -> _Search:
        """Keep the searches of these rows (M,) bool."""
        for name, values in vars(self).items():
            setattr(self, name, values[rows])
        return self

    def neighbours(self, rng: np.random.Generator, tabu_radius: float) -> Array:
        """Return two neighbours (M, 2, D) [m] of each start, redrawn once where tabu."""
        shape = (len(self.index), 2, self.start.shape[1])
        step = ((1 - self.start_score) * self.scale)[:, None, None]
        drawn = self.start[:, None] + step * rng.standard_normal(shape, np.float32)
        apart = np.square(drawn[:, :, None] - self.tabu[:, None]).sum(axis=3).min(axis=2)
        tabu = apart < np.square(tabu_radius * self.scale)[:, None]
        if tabu.any():
            again = self.start[:, None] + step * rng.standard_normal(shape, np.float32)
            drawn = np.where(tabu[:, :, None], again, drawn)
        return drawn

    def move(self, neighbours: Array, scores: Array, iteration: int) -> tuple[Array, Array]:
        """Make the better neighbour tabu, and the best so far if it is; return it, its score."""
        rows, pick = np.arange(len(self.index)), scores.argmax(axis=1)
        better, reached = neighbours[rows, pick], scores[rows, pick]
        self.tabu[:, iteration % self.tabu.shape[1]] = better
        improved = reached > self.best_score
        self.best[improved] = better[improved]
        self.best_score[improved] = reached[improved]
        return better, reached


def score(log_likelihood: Array, terms: Array) -> Array:
    """Return omega in [0, 1]: the geometric mean of the evidence's likelihoods."""
    return np.exp(log_likelihood / terms)
