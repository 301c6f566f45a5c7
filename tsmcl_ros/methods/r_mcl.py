"""
R-MCL: Monte Carlo localization that samples where the received power points to.

Liu: RSSI-calibrated Monte Carlo localization for mobile nodes (R-MCL). Ranges come from rssi,
calibrated by how references hear each other, see model/links.py; candidates are drawn in the
circumscribed squares of the ranges of the nearest references, within each particle's motion box,
and weighed by all that was heard. Where nothing has an rssi it is MCL, drawn in boxes. Four things
go beyond the paper, so that few particles are enough: squares are of the largest likely range
rather than of the range, so that no noise excludes the truth; candidates follow the motion model
there, and are spread evenly; they all count by their weight, rather than be rejected, and the
particles are drawn from them; and where too few of the old particles lead to what was heard, the
motion is taken to be wider, as bandwidths of densities are where there are few samples
(Loftsgaarden and Quesenberry 1965).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.cloud import CloudConfig
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.kernel import Kernel
from tsmcl_ros.model.motion import MotionModel, RandomMotion
from tsmcl_ros.model.particles import (
    best_bandwidth,
    effective_sample_size,
    even_resample,
    normalize,
    spread,
    systematic_resample,
)
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.rejection import RedrawingFilter
from tsmcl_ros.model.sampling import even_shares
from tsmcl_ros.types import Array, Estimate, Motion, Observation, Prior

_NOTHING = 1e-12  # mass below which a region counts as empty


@dataclass(frozen=True)
class RMclConfig(CloudConfig):
    """The sampling region, and how well it is sampled."""

    region_references: int = param(
        3, 'nearest references whose ranges bound the sampling region', low=1, high=100, live=True)
    extrapolate: bool = param(
        False, 'centre the motion boxes of random motion on the linear extrapolation of the last '
        'two estimates')
    candidates: int = param(
        8, 'positions drawn for each particle that is kept of them', low=1, high=1000, live=True)
    least_parents: float = param(
        4.0, 'effective number of old particles that candidates are to come from', low=1.0,
        live=True)
    max_widenings: int = param(
        3, 'times that the motion is taken to be twice as wide where they come from fewer',
        low=0, high=20, live=True)


class RMcl(RedrawingFilter):
    """R-MCL of V vehicles: predict, draw candidates in the sampling region, weigh, resample."""

    Config = RMclConfig

    def __init__(self, config: RMclConfig, channel: Channel, motion: MotionModel, vehicles: int,
                 dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config = config
        self._mean = np.full((vehicles, dimension), np.nan)
        self._step = np.zeros((vehicles, dimension), np.float32)
        self._measured = np.zeros(vehicles, bool)

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior, which nothing is extrapolated to."""
        super().start(prior)
        self._mean[prior.vehicle] = np.nan

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts anew at its next beacon."""
        super().forget(vehicle)
        self._mean[vehicle] = np.nan

    def predict(self, motion: Motion) -> None:
        """Move the particles on as the estimates went, if that is wanted, and then at random."""
        if self.config.extrapolate and isinstance(self.cloud.motion, RandomMotion):
            self.cloud.states = self.cloud.states + self._step[:, None]
        super().predict(motion)

    def update(self, observation: Observation) -> Estimate:
        """Draw particles in the sampling region, from candidates that everything heard weighs."""
        evidence = self.channel.evidence(observation)
        which = self.cloud.placed & evidence.heard & self.predicted
        self.predicted[:] = False
        self.cloud.place(evidence)
        self._measured = self.channel.measured(observation).any(axis=1)
        explained = self.sample(evidence, which)
        starved = which & ~np.isfinite(explained)
        if starved.any():
            self.cloud.place_again(starved, evidence)
        likelihood = self.cloud.recover(
            evidence, evidence.log_likelihood(self.cloud.particles))
        # Particles that are drawn by their weight have none left, but all together.
        drawn = which & ~starved
        likelihood[drawn] = explained[drawn, None]
        self.cloud.weigh(likelihood)
        estimate = self.cloud.estimate(observation)
        self.cloud.resample()
        self._extrapolate(estimate)
        return estimate

    def sample(self, evidence: Evidence, which: Array) -> Array:
        """
        Replace the particles of some vehicles (V,) bool by what is likely of their prediction.

        Returns
        -------
        (V,) float
            Log of the mean likelihood of their candidates; -inf for a vehicle that keeps its
            particles, as nothing of its prediction is likely.

        """
        explained = np.full(len(which), -np.inf)
        self.draws = np.zeros(len(which), np.int64)
        vehicle, kernel, weights = np.flatnonzero(which), self.kernel(), self.cloud.weights.copy()
        region = self._sampling_region(evidence, kernel)
        for _ in range(1 + self.config.max_widenings):
            mass = weights * kernel.mass(*region)
            vehicle = vehicle[mass[vehicle].any(axis=1)]
            if not len(vehicle):
                break
            parent, states, likelihood = self._candidates(evidence, kernel, region, mass, vehicle)
            self.draws[vehicle] += parent.shape[1]
            fits = ~self.config.excludes(likelihood.max(axis=1), evidence.terms[vehicle])
            vehicle, parent = vehicle[fits], parent[fits]
            posterior, total = normalize(likelihood[fits])
            explained[vehicle] = total - np.log(parent.shape[1])
            self._keep(vehicle, states[fits], posterior, parent)
            few = _sources(parent, posterior, weights.shape[1]) < self.config.least_parents
            vehicle, kernel = vehicle[few], kernel.widened(2.0)
        return explained

    def _candidates(self, evidence: Evidence, kernel: Kernel, region: tuple[Array, Array],
                    mass: Array, vehicle: Array) -> tuple[Array, Array, Array]:
        """
        Draw candidates of some vehicles (W,) in the region, as the motion puts them there.

        Returns
        -------
        parent : (W, C) int
            The old particle of each, in order; as often as its mass there (V, N) says.
        states : (W, C, D + extra) float32
        likelihood : (W, C) float32
            Log of it, of all that was heard; -inf where the motion does not lead.

        """
        dimension, count = self.cloud.dimension, mass.shape[1] * self.config.candidates
        # Far from where the motion leads masses are smaller than a float inverts.
        mass = mass[vehicle] / mass[vehicle].max(axis=1, keepdims=True)
        parent = systematic_resample(mass, count, self.rng)
        share = even_shares(np.arange(count), len(vehicle), dimension, self.rng)
        owner = np.repeat(vehicle, count)
        states, valid = kernel.draw(
            owner, parent.ravel(), *region, share.reshape(-1, dimension), self.rng)
        likelihood = np.full(len(owner), -np.inf, np.float32)
        likelihood[valid] = evidence.log_likelihood_of(states[valid, :dimension], owner[valid])
        return (parent, states.reshape(*parent.shape, -1), likelihood.reshape(parent.shape))

    def _keep(self, vehicle: Array, states: Array, posterior: Array, parent: Array) -> None:
        """
        Draw the particles of vehicles (W,) from candidates (W, C, D + extra) by weight.

        Where nothing was measured, candidates lie in clumps around their parents (W, C), cut by
        hard edges. So that no clump dies by chance each gets its share, and siblings part as far
        as is best for the density that they stand for.
        """
        cloud, dimension = self.cloud, self.cloud.dimension
        count = cloud.weights.shape[1]
        index = even_resample(states[:, :, :dimension], posterior, count, self.rng)
        copy = np.diff(index, axis=1, prepend=-1) == 0
        width = np.full(len(vehicle), self.config.jitter)
        clumped = ~self._measured[vehicle]
        if clumped.any():
            index[clumped] = systematic_resample(posterior[clumped], count, self.rng)
            source = np.take_along_axis(parent, index, axis=1)
            copy[clumped] = (np.diff(source, axis=1, prepend=-1) == 0)[clumped]
            width[clumped] = np.maximum(width[clumped], best_bandwidth(count, dimension))
        kept = np.take_along_axis(states, index[:, :, None], axis=1)
        position = kept[:, :, :dimension]
        noise = (width * spread(position))[:, None] * copy
        position += noise[:, :, None] * self.rng.standard_normal(position.shape, np.float32)
        cloud.states[vehicle] = kept
        cloud.weights[vehicle] = 1 / cloud.weights.shape[1]

    def _sampling_region(self, evidence: Evidence, kernel: Kernel) -> tuple[Array, Array]:
        """Return the corners (V, D) [m] of the first references' region that the motion meets."""
        reach = evidence.reach
        region = np.stack(reach.anchor_box())
        empty = evidence.heard.copy()
        number = self.config.region_references
        for first in range(max(reach.rows.shape[1] - number, 0) + 1):
            low, high = reach.nearest(first, number)
            met = empty & (kernel.mass(low, high) > _NOTHING).any(axis=1)
            region[:, met] = low[met], high[met]
            empty &= ~met
            if not empty.any():
                break
        return region[0], region[1]

    def _extrapolate(self, estimate: Estimate) -> None:
        """Take the step between the last two estimates for the next one."""
        step = np.where(estimate.reinitialized[:, None], np.nan, estimate.mean - self._mean)
        self._step = np.where(np.isfinite(step), step, 0).astype(np.float32)
        self._mean = estimate.mean


def _sources(parent: Array, posterior: Array, count: int) -> Array:
    """Return the effective number (W,) of `count` parents, which weights (W, C) are children's."""
    vehicles = len(parent)
    row = np.arange(vehicles)[:, None] * count
    weights = np.bincount((row + parent).ravel(), posterior.ravel(), vehicles * count)
    return effective_sample_size(weights.reshape(vehicles, count))
