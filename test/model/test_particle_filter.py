"""What all methods with a cloud of particles share."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.cloud import CloudConfig
from tsmcl_ros.model.motion import MotionConfig, OdometryMotion
from tsmcl_ros.model.particle_filter import ParticleFilter
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.types import Motion, Prior


def test_a_filter_passes_priors_motion_and_forgetting_on_to_its_cloud() -> None:
    motion = OdometryMotion(MotionConfig(odom_heading='known', odom_std=0.0, alpha3=0.0))
    blind = ParticleFilter(
        CloudConfig(), Channel(RadioConfig()), motion, 1, 2, np.random.default_rng(1))
    blind.start(Prior(0, np.zeros(2), np.zeros((2, 2))))
    blind.predict(Motion(1.0, np.array([[3.0, 4.0]]), np.zeros(1)))
    np.testing.assert_array_equal(blind.particles, np.broadcast_to([3.0, 4.0], (1, 200, 2)))
    blind.forget(0)
    assert not blind.cloud.placed[0]
