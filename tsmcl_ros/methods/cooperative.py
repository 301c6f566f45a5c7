"""
Cooperative localization by ranges to anchors and to neighbours that are localized already.

Efficient cooperative localization in mobile ad-hoc networks (patent, steps A to D): samples are
drawn around every reference at the measured range and weighed by the other references; the
directions of the heaviest tell where to draw the next. Three resolutions. A direction interval
[min, max] breaks across 0 and 2 pi: here it is the smallest arc that covers the directions. Of
each reference's samples not only the heaviest floor(M / n) are kept, but as many as hold nearly
all of its weight, or arcs would shrink on and on, the faster the more references there are, to
less than what is uncertain. And the samples in the last arcs are weighed by all references over
the density that they were drawn with, so that their covariance is that of the posterior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cooperation import CooperationConfig, CooperativeFilter, Proposal
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.geometry import Arcs
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particles import normalize
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.ranging import without_ranges
from tsmcl_ros.model.rings import Rings
from tsmcl_ros.types import Array, Observation

_HELD = 0.99  # share of a reference's weight that its kept samples hold
_CANDIDATES = 2  # for each particle of the cloud, so that most of these differ


@dataclass(frozen=True)
class CooperativeConfig(CooperationConfig):
    """The search for the directions in which a vehicle may be seen."""

    direction_iterations: int = param(
        10, 'iterations in which arcs of directions shrink, at most, L', low=1, high=1000,
        live=True)
    convergence: float = param(
        1.0, 'the arcs have settled when the estimate moves by no more than this, epsilon',
        unit='m', above=0.0, live=True)


class Cooperative(CooperativeFilter):
    """Cooperative localization of V vehicles: draw around references, weigh by the others."""

    Config = CooperativeConfig

    def __init__(self, config: CooperativeConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config: CooperativeConfig = config

    def propose(self, observation: Observation) -> Sectors:
        """Draw candidates in the arcs that the search ends with."""
        arcs, unsettled = self.search(observation)
        rings, rest = self._rings(observation, arcs)
        # The more references there are, the fewer samples of each make a cloud.
        enough = math.ceil(_CANDIDATES * self.config.min_particles / rings.used.shape[1])
        count = max(min(self.config.reference_samples, enough), 2)
        samples, _ = rings.draw(count, self.rng)
        return Sectors(
            samples.reshape(len(samples), -1, 2), np.repeat(rings.used, count, axis=1),
            unsettled, np.zeros(len(samples)), rings, rest)

    def search(self, observation: Observation) -> tuple[Arcs, Array]:
        """
        Return the arcs (V, K) in which each reference may see the vehicle (steps A to D).

        The second value is how far estimates moved in the last iteration (V, 2) [m], 0 where that
        is no more than `convergence`.
        """
        config = self.config
        arcs = Arcs.circles(observation.sender.shape)
        used = self._rings(observation, arcs)[0].used[:, :, None]
        mean = (observation.position * used).sum(axis=1) / used.sum(axis=1)
        move = np.zeros_like(mean)
        moving = np.arange(len(mean))
        for iteration in range(config.direction_iterations):
            rings, rest = self._rings(observation.of(moving), arcs.at(moving))
            rings = replace(rings, ranging=rings.ranging.simplified())
            shrunk, estimate = self.iterate(rings, rest)
            arcs.middle[moving], arcs.half[moving] = shrunk.middle, shrunk.half
            move[moving], mean[moving] = estimate - mean[moving], estimate
            if iteration:
                moving = moving[np.linalg.norm(move[moving], axis=1) > config.convergence]
            if not len(moving):
                break
        settled = np.linalg.norm(move, axis=1, keepdims=True) <= config.convergence
        return arcs, np.where(settled, 0, move)

    def iterate(self, rings: Rings, rest: Evidence) -> tuple[Arcs, Array]:
        """
        Draw once around every reference and weigh by the others (steps B and C).

        Returns
        -------
        arcs : Arcs
            Of the kept samples (V, K).
        mean : (V, 2) float64
            Of the kept samples [m].

        """
        ranging, count = rings.ranging, self.config.reference_samples
        vehicles, references = rings.used.shape
        points, direction = rings.draw(count, self.rng)
        listed = points.reshape(vehicles, -1, 2)
        scores = ranging.scores(ranging.log_density(listed))
        total = scores.sum(axis=1) + rest.log_likelihood(listed)
        own = np.einsum('vkkm->vkm', scores.reshape(vehicles, references, references, count))
        log_weights = total.reshape(own.shape) - own
        kept = heaviest(log_weights, rings.used)
        arcs = Arcs.cover(direction, kept).wider(2 * rings.arcs.half / count)
        weights, _ = normalize(np.where(
            kept & rings.used[:, :, None], log_weights, -np.inf).reshape(vehicles, -1))
        return (Arcs(arcs.middle, np.where(rings.used, arcs.half, np.float32(np.pi))),
                np.einsum('vp,vpd->vd', weights, listed, dtype=np.float64))

    def _rings(self, observation: Observation, arcs: Arcs) -> tuple[Rings, Evidence]:
        """Return the ranges in these arcs, and what else was heard."""
        ranging, rest = without_ranges(self.channel.evidence(observation))
        assert ranging is not None
        return Rings(ranging, arcs), rest


@dataclass(frozen=True, eq=False)
class Sectors(Proposal):
    """Candidates in the arcs that a search has ended with."""

    rings: Rings
    rest: Evidence

    def score(self, points: Array) -> tuple[Array, Array]:
        """Return log-likelihoods (W, P) of points (W, P, 2), and ln of the density drawn from."""
        ranging = self.rings.ranging
        distance, variance = ranging.references.distance(points)
        log_ranging = ranging.errors.log_density(distance - ranging.indicated, variance)
        return (ranging.scores(log_ranging).sum(axis=1) + self.rest.log_likelihood(points),
                self.rings.log_density(points, distance, log_ranging))


def heaviest(log_weights: Array, used: Array) -> Array:
    """
    Return which samples (V, K, M) bool to keep of those of the references used (V, K).

    They are the floor(M / n) heaviest of each of n references, the first one's with the
    remainder, and as many more as hold nearly all of the reference's weight.
    """
    count = log_weights.shape[2]
    number = np.maximum(used.sum(axis=1), 1)[:, None]
    first = np.arange(used.shape[1]) == used.argmax(axis=1)[:, None]
    quota = count // number + np.where(first, count % number, 0)
    order = np.argsort(-log_weights, axis=2)
    falling = np.take_along_axis(log_weights, order, axis=2)
    weight = np.exp(falling - falling[:, :, :1])
    before = np.cumsum(weight, axis=2) - weight
    keep = before < _HELD * weight.sum(axis=2, keepdims=True)
    keep |= np.arange(count) < quota[:, :, None]
    kept: Array = np.empty_like(keep)
    np.put_along_axis(kept, order, keep, axis=2)
    return kept
