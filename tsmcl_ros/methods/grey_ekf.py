"""
Grey EKF: an extended Kalman filter that a grey prediction of the azimuth leads through outages.

Zhuo et al., delay-tolerant networks: state [x, y, vx, vy], constant velocity. The paper measures
azimuths from one station; beacons hold none, so while they are heard this is the filter on
whatever the channel offers. While they are not, the azimuth of the position, seen from the
farthest reference heard last, is predicted by GM(1,1) and taken for a measurement, with a variance
that grows with the horizon. What the paper does not say: the prediction is no news, so it moves
the belief and does not narrow it; and where there is odometry, that leads better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.config import param
from tsmcl_ros.model.azimuth import AzimuthLead, farthest
from tsmcl_ros.model.cloud import RecoveryConfig
from tsmcl_ros.model.gaussian_filter import GaussianFilter
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Estimate, Motion, Observation, Prior


@dataclass(frozen=True)
class GreyEkfConfig(RecoveryConfig):
    """When a vehicle is placed anew, and when the grey series goes on by the filter."""

    azimuth_threshold: float = param(
        0.035, "append the filter's azimuth to the grey series where it differs from the "
        'prediction by more', unit='rad', low=0.0)


class GreyEkf(GaussianFilter):
    """Grey EKF of V vehicles: predict, update by what is heard, or else by the grey azimuth."""

    Config = GreyEkfConfig

    def __init__(self, config: GreyEkfConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        super().__init__(config, channel, motion, vehicles, dimension, rng)
        self._lead = AzimuthLead(vehicles, dimension, config.azimuth_threshold)
        # What the paper's filter believes of its covariance, which is too good to be told.
        self._led = self.beliefs.covariance.copy()
        self._measured = np.zeros(vehicles, bool)

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior."""
        super().start(prior)
        self._led[prior.vehicle] = self.beliefs.covariance[prior.vehicle]
        self._lead.forget(prior.vehicle)

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts anew at its next beacon."""
        super().forget(vehicle)
        self._lead.forget(vehicle)

    def predict(self, motion: Motion) -> None:
        """Move the beliefs by the motion since the last epoch."""
        _, self._led = self.kinematics.predict(self.beliefs.mean, self._led, motion)
        super().predict(motion)
        self._measured[:] = False
        if motion.displacement is not None:
            self._measured = np.isfinite(motion.displacement).all(axis=1)

    def update(self, observation: Observation) -> Estimate:
        """Take in what was heard, or the grey azimuth where nothing was."""
        lost = self.take_in(observation)
        self._lead.forget(lost)
        heard = observation.heard.any(axis=1)
        self._remember(observation, heard)
        self.beliefs.mean, self._led = self._lead.lead(
            observation.stamp, self.beliefs.mean, self._led,
            self.placed & ~heard & ~self._measured)
        return self.estimate(observation, lost)

    def _remember(self, observation: Observation, heard: Array) -> None:
        """Append the positions of those who heard something to their series."""
        size = self.dimension
        mean, covariance = self.beliefs.mean, self.beliefs.covariance
        self._led[heard] = covariance[heard]
        station = farthest(mean, observation.position, observation.heard)
        self._lead.observe(observation.stamp, mean[:, :size], covariance[:, :size, :size], station,
                           heard & self.placed)
