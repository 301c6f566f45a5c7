"""What all methods with a cloud of particles share: everything but how they update it."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.cloud import Cloud, CloudConfig
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Motion, Prior


class ParticleFilter:
    """
    What all methods with a cloud share: everything but how they update it.

    Parameters
    ----------
    config : CloudConfig
    channel : Channel
        Scores positions against observations.
    motion : MotionModel
    vehicles, dimension : int
        V and D.
    rng : numpy.random.Generator

    """

    def __init__(self, config: CloudConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        self.channel = channel
        self.rng = rng
        self.cloud = Cloud(config, motion, vehicles, dimension, rng)

    @property
    def particles(self) -> Array:
        """(V, N, D) float32: the positions [m]."""
        return self.cloud.particles

    def moments(self) -> tuple[Array, Array]:
        """Return mean (V, D) [m] and covariance (V, D, D) [m^2], NaN where unplaced."""
        return self.cloud.moments()

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior."""
        self.cloud.start(prior)

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts anew at its next beacon."""
        self.cloud.forget(vehicle)

    def predict(self, motion: Motion) -> None:
        """Move the particles by the motion since the last epoch."""
        self.cloud.predict(motion)
