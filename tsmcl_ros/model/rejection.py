"""
Rejection and redraw: what the filters of the MCL family share, whatever they redraw from.

A particle survives with the probability that its presence evidence gives it. Measurements weigh
the survivors.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cloud import CloudConfig
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.kernel import choose, Kernel
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particle_filter import ParticleFilter
from tsmcl_ros.model.particles import spread
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Estimate, items, Motion, Observation, Prior

# Draws states (M, D + extra) and their weights (M,) for vehicles (M,), and tells which are valid.
Redraw = Callable[[Array], tuple[Array, Array, Array]]


@dataclass(frozen=True)
class RejectionConfig(CloudConfig):
    """The rejection; more redraws find more survivors, for more time."""

    max_redraws: int = param(
        20, 'times that rejected particles are drawn again from the prediction',
        low=0, high=10_000, live=True)


class RedrawingFilter(ParticleFilter):
    """
    A filter of V vehicles that can draw from its last prediction again.

    Attributes
    ----------
    draws : (V,) int
        Positions that the last update has drawn of each vehicle, the prediction included.
    predicted : (V,) bool
        Whose particles are a prediction, from parents that are known.

    """

    def __init__(self, config: CloudConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.draws = np.zeros(vehicles, np.int64)
        self.predicted = np.zeros(vehicles, bool)
        self._motion = Motion(0.0)
        self._parents = self.cloud.states

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior, which redraws cannot be made from."""
        super().start(prior)
        self.predicted[prior.vehicle] = False

    def predict(self, motion: Motion) -> None:
        """Move the particles, keeping their parents for the redraws."""
        self._motion, self._parents = motion, self.cloud.states
        self.predicted[:] = True
        super().predict(motion)

    def kernel(self) -> Kernel:
        """Return where the last motion may have led."""
        return self.cloud.motion.kernel(self._parents, self._motion, self.rng)


class RejectionFilter(RedrawingFilter):
    """A filter that predicts, rejects and redraws, weighs what is measured, and resamples."""

    def __init__(self, config: RejectionConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config = config

    def update(self, observation: Observation) -> Estimate:
        """Keep and redraw particles until enough survive what was heard."""
        evidence = self.channel.evidence(observation)
        old = self.cloud.placed & evidence.heard
        self.cloud.place(evidence)
        starved = self.filter(evidence, old)
        if starved.any():
            self.cloud.place_again(starved, evidence)
        measured = evidence.measured
        log_likelihood = self.cloud.recover(
            measured, measured.log_likelihood(self.cloud.particles))
        self.cloud.weigh(log_likelihood)
        estimate = self.cloud.estimate(observation)
        self.cloud.resample()
        return estimate

    def redraws(self, evidence: Evidence, survived: Array) -> Redraw:
        """
        Return how to redraw the rejected.

        Parameters
        ----------
        evidence : Evidence
            What was heard.
        survived : (V, N) bool
            The particles that are not.

        """
        raise NotImplementedError

    def filter(self, evidence: Evidence, which: Array) -> Array:
        """
        Reject particles and redraw them from their vehicle's prediction.

        What is still rejected after the last redraw becomes a copy of a random survivor.

        Parameters
        ----------
        evidence : Evidence
            What was heard.
        which : (V,) bool
            The vehicles to filter.

        Returns
        -------
        (V,) bool
            The vehicles of which no particle survived; theirs are left as predicted.

        """
        states, weights, dimension = self.cloud.states, self.cloud.weights, self.cloud.dimension
        presence = evidence.presence
        self.draws = np.where(which, weights.shape[1], 0)
        rejected = which[:, None] & ~self._passed(
            presence.log_likelihood(self.cloud.particles))
        redraw: Redraw | None = None
        # Places in one list of all vehicles' particles, which is theirs as long as it is no copy.
        assert states.flags.c_contiguous and weights.flags.c_contiguous
        count, particles = weights.shape[1], items(states.reshape(-1, states.shape[2]))
        place = np.flatnonzero(rejected & self.predicted[:, None])
        for _ in range(self.config.max_redraws):
            if not len(place):
                break
            redraw = redraw or self.redraws(evidence, ~rejected)
            owner = place // count
            drawn, weight, valid = redraw(owner)
            self.draws += np.bincount(owner, minlength=len(which))
            valid[valid] = self._passed(
                presence.log_likelihood_of(drawn[valid, :dimension], owner[valid]))
            kept = np.flatnonzero(valid)
            found = place[kept]
            particles[found] = items(drawn)[kept]
            weights.reshape(-1)[found] = weight[kept]
            rejected.reshape(-1)[found] = False
            place = place[~valid]
        self.predicted[:] = False
        starved = rejected.all(axis=1)
        rejected[starved] = False
        self._copy_survivors(rejected)
        return np.asarray(starved)

    def _copy_survivors(self, rejected: Array) -> None:
        """
        Replace the rejected (V, N) bool by random survivors, of which all have some.

        Copies part by the jitter of resampled particles, else a cloud with one survivor would
        claim to be certain.
        """
        states, weights = self.cloud.states, self.cloud.weights
        owner, index = np.nonzero(rejected)
        if len(owner):
            number = weights.shape[1] - rejected.sum(axis=1)
            rank = (self.rng.random(len(owner)) * number[owner]).astype(np.int64)
            first = np.cumsum(number) - number
            survivor = np.flatnonzero(~rejected)[first[owner] + rank] % weights.shape[1]
            jitter = self.config.jitter * spread(self.cloud.particles)[owner, None]
            states[owner, index] = states[owner, survivor]
            weights[owner, index] = weights[owner, survivor]
            position = self.cloud.particles
            position[owner, index] += jitter * self.rng.standard_normal(
                (len(owner), position.shape[2]), np.float32)

    def _passed(self, log_likelihood: Array) -> Array:
        """Let positions survive at random, as likely as they are; return which do."""
        return np.log(1 - self.rng.random(log_likelihood.shape, np.float32)) < log_likelihood

    def redraw_in_boxes(self, low: Array, high: Array, survived: Array) -> Redraw:
        """
        Return redraws within boxes, exactly as probable as the motion makes them there.

        Parents are chosen by their weight times their kernel's mass in the box.

        Parameters
        ----------
        low, high : (V, D) float
            Corners [m]; without any mass in it a box gives no valid draws.
        survived : (V, N) bool
            The particles that are kept, whose mean weight every draw gets.

        """
        kernel = self.kernel()
        weights = _mean(self.cloud.weights, survived)
        mass = self.cloud.weights * kernel.mass(low, high)
        possible = mass.any(axis=1)
        columns = self.cloud.states.shape[2]

        def redraw(owner: Array) -> tuple[Array, Array, Array]:
            valid = possible[owner]
            states = np.zeros((len(owner), columns), np.float32)
            among = owner[valid]
            states[valid], valid[valid] = kernel.draw(
                among, choose(mass, among, self.rng), low, high,
                self.rng.random((len(among), self.cloud.dimension)), self.rng)
            return states, weights[owner], valid

        return redraw


def _mean(weights: Array, rows: Array) -> Array:
    """Return each vehicle's mean weight (V,) of the chosen (V, N) bool, or of all if none is."""
    rows = rows | ~rows.any(axis=1, keepdims=True)
    return np.asarray((weights * rows).sum(axis=1) / rows.sum(axis=1))
