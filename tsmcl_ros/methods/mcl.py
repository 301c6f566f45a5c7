"""
MCL: Monte Carlo localization by rejection and redraw, the baseline.

Hu and Evans: Localization for mobile sensor networks, MobiCom 2004, with N = 50 and the `random`
motion model. A particle survives with the probability that its presence evidence gives it: with
hard disks that is the paper's filter, d <= R for hops 1 and R < d <= 2R for hops 2. Ranges and
rssi, which the paper does not have, weigh the survivors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cloud import CloudConfig, ParticleFilter
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Estimate, Motion, Observation, Prior


@dataclass(frozen=True)
class MclConfig(CloudConfig):
    """The rejection; more redraws find more survivors, for more time."""

    max_redraws: int = param(
        20, 'times that rejected particles are drawn again from the prediction',
        low=0, high=10_000)


class Mcl(ParticleFilter):
    """MCL of V vehicles: predict, reject and redraw, weigh what is measured, resample."""

    Config = MclConfig

    def __init__(self, config: MclConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config = config
        self._motion = Motion(0.0)
        self._parents = self.cloud.states
        self._predicted = np.zeros(vehicles, bool)

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior, which redraws cannot be made from."""
        super().start(prior)
        self._predicted[prior.vehicle] = False

    def predict(self, motion: Motion) -> None:
        """Move the particles, keeping their parents for the redraws."""
        self._motion, self._parents = motion, self.cloud.states
        self._predicted[:] = True
        super().predict(motion)

    def update(self, observation: Observation) -> Estimate:
        """Keep and redraw particles until enough survive what was heard."""
        evidence = self.channel.evidence(observation)
        new = evidence.heard & ~self.cloud.placed
        self.cloud.place(evidence)
        starved = self.filter(evidence.presence, self.cloud.placed & ~new)
        if starved.any():
            self.cloud.place_again(starved, evidence)
        measured = evidence.measured
        log_likelihood = measured.log_likelihood(self.cloud.particles)
        self.cloud.weigh(self.cloud.recover(measured, log_likelihood))
        estimate = self.cloud.estimate(observation)
        self.cloud.resample()
        return estimate

    def filter(self, presence: Evidence, which: Array) -> Array:
        """
        Reject particles and redraw them from their vehicle's prediction.

        What is still rejected after the last redraw becomes a copy of a random survivor.

        Parameters
        ----------
        presence : Evidence
            Who was heard and who was silent.
        which : (V,) bool
            The vehicles to filter.

        Returns
        -------
        (V,) bool
            The vehicles of which no particle survived; theirs are left as predicted.
        """
        states, weights = self.cloud.states, self.cloud.weights
        inherited = weights.copy()
        size = states.shape[1]
        rejected = which[:, None] & ~self._survives(
            presence.log_likelihood(self.cloud.particles))
        for _ in range(self.config.max_redraws):
            owner, index = np.nonzero(rejected & self._predicted[:, None])
            if not len(owner):
                break
            parent = self.rng.integers(size, size=len(owner))
            drawn = self._redraw(owner, parent)
            survives = self._survives(
                presence.log_likelihood_of(drawn[:, :self.cloud.dimension], owner))
            owner, index, parent = owner[survives], index[survives], parent[survives]
            states[owner, index] = drawn[survives]
            weights[owner, index] = inherited[owner, parent]
            rejected[owner, index] = False
        self._predicted[:] = False
        starved = rejected.all(axis=1)
        rejected[starved] = False
        owner, index = np.nonzero(rejected)
        if len(owner):
            # Survivors first in each vehicle's order, so that a random rank picks one.
            survivors = np.argsort(rejected, axis=1, kind='stable')
            number = size - rejected.sum(axis=1)
            rank = (self.rng.random(len(owner)) * number[owner]).astype(np.int64)
            survivor = survivors[owner, rank]
            states[owner, index] = states[owner, survivor]
            weights[owner, index] = weights[owner, survivor]
        return np.asarray(starved)

    def _redraw(self, owner: Array, parent: Array) -> Array:
        """Return new states (M, D + extra), predicted from parents (M,) of the vehicles (M,)."""
        motion = self._motion
        if motion.displacement is not None and motion.turn is not None:
            motion = Motion(motion.elapsed, motion.displacement[owner], motion.turn[owner])
        return self.cloud.motion.predict(
            self._parents[owner, parent][:, None], motion, self.rng)[:, 0]

    def _survives(self, log_likelihood: Array) -> Array:
        """Return which particles survive, each with its own likelihood."""
        return np.log(1 - self.rng.random(log_likelihood.shape, np.float32)) < log_likelihood
