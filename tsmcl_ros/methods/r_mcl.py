"""
R-MCL: Monte Carlo localization that samples where the received power points to.

Liu: RSSI-calibrated Monte Carlo localization for mobile nodes (R-MCL). Ranges come from rssi,
calibrated by how references hear each other, see model/links.py; particles are drawn in the
circumscribed squares of the ranges of the nearest references, within each particle's motion box,
and weighed by all ranges. Where nothing has an rssi it is MCL, drawn in boxes. Three things go
beyond the paper: squares are of the largest likely range rather than of the range, so that no
noise excludes the truth; draws follow the motion model there; and part of the weight is already
spent on survival, so that few particles are enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import MotionModel, RandomMotion
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.rejection import Redraw, RejectionConfig, RejectionFilter
from tsmcl_ros.types import Array, Estimate, Motion, Observation, Prior

_NOTHING = 1e-12  # mass below which a region counts as empty


@dataclass(frozen=True)
class RMclConfig(RejectionConfig):
    """The sampling region, and how evenly particles are to weigh."""

    region_references: int = param(
        3, 'nearest references whose ranges bound the sampling region', low=1, high=100)
    extrapolate: bool = param(
        False, 'centre the motion boxes of random motion on the linear extrapolation of the last '
        'two estimates')
    acceptance: float = param(
        0.1, 'share of the draws that measurements may reject particles down to, rather than '
        'weigh them', above=0.0, high=1.0)


class RMcl(RejectionFilter):
    """R-MCL of V vehicles: predict, draw in the sampling region, reject by hops, weigh by rssi."""

    Config = RMclConfig

    def __init__(self, config: RMclConfig, channel: Channel, motion: MotionModel, vehicles: int,
                 dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self._settings = config
        self._mean = np.full((vehicles, dimension), np.nan)
        self._step = np.zeros((vehicles, dimension), np.float32)
        self._region = np.zeros((vehicles, dimension)), np.zeros((vehicles, dimension))

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
        if self._settings.extrapolate and isinstance(self.cloud.motion, RandomMotion):
            self.cloud.states = self.cloud.states + self._step[:, None]
        super().predict(motion)

    def update(self, observation: Observation) -> Estimate:
        """Draw particles in the sampling region, and weigh them."""
        estimate = super().update(observation)
        step = np.where(estimate.reinitialized[:, None], np.nan, estimate.mean - self._mean)
        self._step = np.where(np.isfinite(step), step, 0).astype(np.float32)
        self._mean = estimate.mean
        return estimate

    def threshold(self, evidence: Evidence) -> Array:
        """Find the sampling region, and by trial draws there how far measurements may reject."""
        self._region = low, high = self._sampling_region(evidence)
        vehicles, count, dimension = self.particles.shape
        owner = np.repeat(np.arange(vehicles), count)
        states, _, valid = self.redraw_in_boxes(low, high, np.ones(vehicles))(owner)
        trials = states[:, :dimension].reshape(self.particles.shape)
        present = np.exp(evidence.presence.log_likelihood(trials))
        log_likelihood = evidence.measured.log_likelihood(trials)
        absent = present < self.rng.random(present.shape, np.float32)
        log_likelihood[~valid.reshape(vehicles, count) | absent] = -np.inf
        return control_level(log_likelihood, self._settings.acceptance)

    def redraws(self, evidence: Evidence, weights: Array) -> Redraw:
        """Draw what the motion puts into the sampling region."""
        low, high = self._region
        return self.redraw_in_boxes(low, high, weights)

    def _sampling_region(self, evidence: Evidence) -> tuple[Array, Array]:
        """Return the corners (V, D) [m] of the first references' region that the motion meets."""
        reach, kernel = evidence.reach, self.kernel()
        region = np.stack(reach.anchor_box())
        empty = evidence.heard.copy()
        number = self._settings.region_references
        for first in range(max(reach.rows.shape[1] - number, 0) + 1):
            low, high = reach.nearest(first, number)
            met = empty & (kernel.mass(low, high) > _NOTHING).any(axis=1)
            region[:, met] = low[met], high[met]
            empty &= ~met
            if not empty.any():
                break
        return region[0], region[1]


def control_level(log_likelihood: Array, acceptance: float) -> Array:
    """
    Return the highest level (V,) at which rejection control still accepts enough.

    Below a level c a draw survives with probability L / c; of the trials, log L (V, P), at least
    a share `acceptance` is to survive. Where no level lets so many, it is that of the least
    likely trial; where nothing is likely at all it is -inf, and nobody is rejected.
    """
    ordered = np.sort(log_likelihood, axis=1)
    peak = np.maximum(ordered[:, -1:], np.float32(-1e30))
    likelihood = np.exp(ordered - peak)
    count = likelihood.shape[1]
    higher = count - 1 - np.arange(count)
    accepted = np.cumsum(likelihood, axis=1) + higher * likelihood
    enough = accepted >= acceptance * count * likelihood
    possible = np.isfinite(ordered)
    highest = np.where(enough & possible, ordered, -np.inf).max(axis=1)
    lowest = np.where(possible, ordered, np.inf).min(axis=1)
    level = np.where(np.isfinite(highest), highest, lowest)
    return np.where(np.isfinite(level), level, -np.inf).astype(np.float32)
