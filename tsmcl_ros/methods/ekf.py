"""
EKF: an extended Kalman filter on ranges, in the plane and in space.

Gao, Wang, Shen: mobile underwater acoustic networks. Placed by linearised least squares, moved by
constant velocity for whatever time has passed (or by odometry), updated in Joseph form; the
residual of the ranges tells when the next beacons are wanted. What goes beyond the paper is told
where it is done, in `gaussian_filter`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.cloud import RecoveryConfig
from tsmcl_ros.model.gaussian_filter import GaussianFilter
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.period import PeriodConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Estimate, Observation


@dataclass(frozen=True)
class EkfConfig(RecoveryConfig, PeriodConfig):
    """When a vehicle is placed anew, and how often it wants beacons."""


class Ekf(GaussianFilter):
    """EKF of V vehicles: predict, update by one reference after the other, ask for a period."""

    Config = EkfConfig

    def __init__(self, config: EkfConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config = config
        self._period_factor = np.ones(vehicles, int)

    def update(self, observation: Observation) -> Estimate:
        """Take in what was heard, and tell how often to be heard."""
        heard = observation.heard.any(axis=1)
        known = self.placed & heard
        residual = np.where(known, self.residual(observation), np.inf)
        lost = self.take_in(observation)
        residual[lost] = np.inf
        # Silence between two beacons is what was asked for.
        self._period_factor = np.where(
            heard, self.config.factor(residual), self._period_factor)
        return self.estimate(
            observation, lost, self._period_factor if self.config.asks else None)

    def residual(self, observation: Observation) -> Array:
        """Return sum |z - z_hat| (V,) [m] over the ranges as predicted, inf if there are none."""
        distance, _, used = self.channel.distances(observation)
        position = self.beliefs.mean[:, None, :self.dimension]
        expected = np.linalg.norm(position - observation.position, axis=2)
        total = np.where(used, np.abs(distance - expected), 0).sum(axis=1)
        return np.where(used.any(axis=1), total, np.inf)
