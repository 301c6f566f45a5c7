"""
EKF: an extended Kalman filter on ranges, in the plane and in space.

Gao, Wang, Shen: mobile underwater acoustic networks. Placed by linearised least squares, moved by
constant velocity for whatever time has passed (or by odometry), updated in Joseph form; the
residual of the ranges tells when the next beacons are wanted. What goes beyond the paper is told
where it is done, here and in `gaussian_filter`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.cloud import RecoveryConfig
from tsmcl_ros.model.gaussian_filter import GaussianFilter
from tsmcl_ros.model.kinematics import Cruising
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.period import PeriodConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, ConfigError, Estimate, Motion, Observation

# Surprise from which on a vehicle has turned: by chance one prediction in 340 is that bad in
# space, one in 1100 in the plane.
_TURNED = 7.0


@dataclass(frozen=True)
class EkfConfig(RecoveryConfig, PeriodConfig):
    """When a vehicle is placed anew, and how often it wants beacons."""

    notice_turns: bool = param(
        False, 'forget the velocity of who is not where it led to, beyond what acceleration_std '
        'explains (motion_model velocity)')


class Ekf(GaussianFilter):
    """EKF of V vehicles: predict, update by one reference after the other, ask for a period."""

    Config = EkfConfig

    def __init__(self, config: EkfConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self.config = config
        if config.notice_turns and not isinstance(self.kinematics, Cruising):
            raise ConfigError('notice_turns: True is not allowed, must be False unless '
                              'motion_model is velocity')
        self._period_factor = np.ones(vehicles, int)
        self._unheard = np.zeros(vehicles)

    def predict(self, motion: Motion) -> None:
        """Move the beliefs by the motion since the last epoch."""
        super().predict(motion)
        self._unheard = self._unheard + motion.elapsed

    def update(self, observation: Observation) -> Estimate:
        """Take in what was heard, and tell how often to be heard."""
        heard = observation.heard.any(axis=1)
        distance, std, used = self.channel.distances(observation)
        ranged = self.placed & used.any(axis=1)
        normalized = self.config.period_residual == 'normalized'
        if normalized or self.config.notice_turns:
            surprise = self.surprise(observation, distance, std, used)
        residual = np.where(
            ranged, surprise if normalized else self.residual(observation, distance, used), np.inf)
        if self.config.notice_turns:
            self._turn(ranged & (surprise > _TURNED))
        lost = self.take_in(observation)
        residual[lost] = np.inf
        self._unheard = np.where(heard, 0, self._unheard)
        # Silence between two beacons is what was asked for.
        self._period_factor = np.where(
            heard, self.config.factor(residual), self._period_factor)
        return self.estimate(
            observation, lost, self._period_factor if self.config.asks else None)

    def residual(self, observation: Observation, distance: Array, used: Array) -> Array:
        """Return sum |z - z_hat| (V,) [m] over the ranges (V, K) that are used, as predicted."""
        position = self.beliefs.mean[:, None, :self.dimension]
        expected = np.linalg.norm(position - observation.position, axis=2)
        return np.asarray(np.where(used, np.abs(distance - expected), 0).sum(axis=1))

    def surprise(self, observation: Observation, distance: Array, std: Array, used: Array
                 ) -> Array:
        """Return by how much the ranges (V, K) contradict the predictions (V,), as minus a log."""
        size = self.dimension
        spread = np.trace(observation.covariance, axis1=2, axis2=3) / size
        return gaussian.surprise(
            self.beliefs.mean[:, :size], self.beliefs.covariance[:, :size, :size],
            observation.position, distance, std ** 2 + spread, used)

    def _turn(self, turned: Array) -> None:
        """Let vehicles (V,) bool have got a new velocity since they were heard."""
        assert isinstance(self.kinematics, Cruising)
        self.beliefs.covariance[turned] += self.kinematics.turn(self._unheard[turned])
