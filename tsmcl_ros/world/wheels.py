"""What the wheels of vehicles tell them of their way."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.mobility import State, wrap
from tsmcl_ros.types import Array
from tsmcl_ros.world.settings import WorldConfig


class WheelOdometry:
    """
    What V vehicles believe of their own movement; it starts at 0 and drifts.

    Each period's displacement is rotated by a heading error that walks randomly, scaled by a
    factor constant for each vehicle, and has noise added along each axis.

    Parameters
    ----------
    config : WorldConfig
        Its `odom_` parameters.
    state : State
        Where the vehicles start.
    rng : numpy.random.Generator

    """

    def __init__(self, config: WorldConfig, state: State, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._true = state.position
        self._scale = 1 + config.odom_scale_noise * rng.standard_normal((state.yaw.size, 1))
        # Rotation from the map to what each vehicle takes for its odometry frame.
        self._rotation = np.zeros_like(state.yaw) if config.odom_heading == 'known' else -state.yaw
        self.position = np.zeros_like(state.position)
        self.yaw = wrap(state.yaw + self._rotation)

    def step(self, state: State) -> tuple[Array, Array]:
        """Return position (V, D) [m] and yaw (V,) [rad] after one period that led to a state."""
        config, rng = self._config, self._rng
        self._rotation = self._rotation + config.odom_yaw_noise * rng.standard_normal(
            state.yaw.shape)
        moved = self._scale * (state.position - self._true)
        cos, sin = np.cos(self._rotation), np.sin(self._rotation)
        x, y = moved[:, 0].copy(), moved[:, 1].copy()
        moved[:, 0], moved[:, 1] = cos * x - sin * y, sin * x + cos * y
        self._true = state.position
        self.position = self.position + moved + config.odom_noise * rng.standard_normal(
            moved.shape)
        self.yaw = wrap(state.yaw + self._rotation)
        return self.position, self.yaw
