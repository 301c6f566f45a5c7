"""
Motion models for Gaussian beliefs: what `motion.py` does to particles, in closed form.

A state is the position (D components) followed by what the motion model remembers: a velocity, the
heading of the odometry frame, or nothing; what comes after that stays as it is. Shapes: mean
(V, n), covariance (V, n, n).
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.motion import MotionModel, OdometryMotion, RandomMotion, VelocityMotion
from tsmcl_ros.types import Array, Motion, Prior

# How far the length of the heading's unit vector may be off 1, which keeps its update from being
# all but exact.
_UNIT_STD = 0.05


class Kinematics(Protocol):
    """What every kinematics offers; `extra` is the number of components that it remembers."""

    extra: int

    def begin(self, prior: Prior | None = None) -> tuple[Array, Array]:
        """Return mean (extra,) and covariance of what is remembered, of a vehicle just placed."""

    def predict(self, mean: Array, covariance: Array, motion: Motion) -> tuple[Array, Array]:
        """Return the belief after the motion."""

    def rotation(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Return rotation from the odometry frame to the map and variance (V,), NaN if none."""


class Wandering:
    """Uniform in a ball around the last position, as `RandomMotion`."""

    extra = 0

    def __init__(self, motion: RandomMotion, dimension: int):
        self._motion = motion
        self._dimension = dimension

    def begin(self, prior: Prior | None = None) -> tuple[Array, Array]:
        """Remember nothing."""
        return np.zeros(0), np.zeros((0, 0))

    def predict(self, mean: Array, covariance: Array, motion: Motion) -> tuple[Array, Array]:
        """Return the belief after the motion: see `Kinematics`."""
        variance = self._motion.reach(motion.elapsed) ** 2 / (self._dimension + 2)
        place = np.arange(self._dimension)
        covariance = covariance.copy()
        covariance[:, place, place] += variance
        return mean, covariance

    def rotation(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Return that there is none."""
        return _no_rotation(mean)


class Cruising:
    """Correlated velocity, as `VelocityMotion`."""

    def __init__(self, motion: VelocityMotion):
        self._motion = motion
        self.extra = motion.extra

    def begin(self, prior: Prior | None = None) -> tuple[Array, Array]:
        """Return a velocity [m/s] known as well as the prior does, or not at all."""
        config = self._motion.config
        variance = config.max_speed ** 2 / (self.extra + 2)
        if config.speed_decay > 0:
            variance = config.acceleration_std ** 2 * config.speed_decay / 2
        if prior is not None and prior.velocity_std is not None:
            variance = prior.velocity_std ** 2
        return np.zeros(self.extra), variance * np.eye(self.extra)

    def turn(self, elapsed: Array) -> Array:
        """
        Return the covariance (W, n, n) that a new velocity at some time of these (W,) [s] adds.

        It is one as `begin` has it; the way since then is as uncertain as the time.
        """
        velocity = self.begin()[1]
        parts = np.array([[elapsed ** 2 / 3, elapsed / 2], [elapsed / 2, np.ones(len(elapsed))]])
        size = 2 * self.extra
        return np.asarray(np.einsum('abw,ij->waibj', parts, velocity).reshape(-1, size, size))

    def predict(self, mean: Array, covariance: Array, motion: Motion) -> tuple[Array, Array]:
        """Return the belief after the motion: see `Kinematics`."""
        size = 2 * self.extra
        transition, noise = np.eye(mean.shape[1]), np.zeros(covariance.shape[1:])
        transition[:size, :size], noise[:size, :size] = gaussian.constant_velocity(
            self._motion, motion.elapsed)
        return gaussian.predict(mean, covariance, transition, noise)

    def rotation(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Return that there is none."""
        return _no_rotation(mean)


class Driving:
    """
    The displacement measured by odometry, as `OdometryMotion`.

    An unknown heading is remembered as its unit vector [cos, sin]: the displacement in the map is
    linear in it, so that it can be estimated from knowing nothing of it, which the angle cannot.
    """

    def __init__(self, motion: OdometryMotion, dimension: int):
        self._motion = motion
        self._dimension = dimension
        self._unit = slice(dimension, dimension + 2)
        self.extra = 2 if motion.heading else 0

    def begin(self, prior: Prior | None = None) -> tuple[Array, Array]:
        """Return the moments of the unit vector of a heading known that well, or not at all."""
        if not self.extra or prior is None or prior.yaw is None:
            return np.zeros(self.extra), 0.5 * np.eye(self.extra)
        kept = math.exp(-prior.yaw_std ** 2 / 2)
        axes = np.array([[math.cos(prior.yaw), -math.sin(prior.yaw)],
                         [math.sin(prior.yaw), math.cos(prior.yaw)]])
        spread = np.diag([(1 - kept ** 2) ** 2, 1 - kept ** 4]) / 2
        return kept * axes[:, 0], axes @ spread @ axes.T

    def predict(self, mean: Array, covariance: Array, motion: Motion) -> tuple[Array, Array]:
        """Return the belief after the motion: see `Kinematics`."""
        config, size = self._motion.config, mean.shape[1]
        displacement, turn, std = self._motion.measured(motion, len(mean), self._dimension)
        transition = np.tile(np.eye(size), (len(mean), 1, 1))
        noise = np.zeros_like(transition)
        place = np.arange(self._dimension)
        noise[:, place, place] = np.square(std, dtype=np.float64)[:, None]
        control = displacement.astype(np.float64)
        if self.extra:
            cos, sin = self._dimension, self._dimension + 1
            transition[:, 0, cos] = transition[:, 1, sin] = control[:, 0]
            transition[:, 0, sin], transition[:, 1, cos] = -control[:, 1], control[:, 1]
            path = np.linalg.norm(control, axis=1)
            drift = (config.alpha1 * turn) ** 2 + (config.alpha2 * path) ** 2
            noise[:, cos, cos] = noise[:, sin, sin] = drift
            control[:, :2] = 0
        mean, covariance = gaussian.predict(mean, covariance, transition, noise)
        mean[:, place] += control
        return self._normalized(mean, covariance) if self.extra else (mean, covariance)

    def rotation(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the direction of the unit vector, and the variance across it."""
        if not self.extra:
            return _no_rotation(mean)
        unit, spread = mean[:, self._unit], covariance[:, self._unit, self._unit]
        squared = np.maximum(np.square(unit).sum(axis=1), 1e-12)
        across = np.stack([-unit[:, 1], unit[:, 0]], axis=1) / squared[:, None]
        # Who points nowhere has no side to be uncertain across: that is as bad as can be.
        variance = gaussian.innovation_variance(spread, across, np.zeros(len(mean)))
        variance = np.where(squared > 1e-6, np.minimum(variance, math.pi ** 2), math.pi ** 2)
        return np.arctan2(unit[:, 1], unit[:, 0]), variance

    def _normalized(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Let the unit vector know its length."""
        length, slope, variance = gaussian.range_to(
            mean[:, self._unit], covariance[:, self._unit, self._unit], np.zeros((1, 2)))
        gradient = np.zeros_like(mean)
        gradient[:, self._unit] = slope
        return gaussian.update(
            mean, covariance, gradient, 1 - length, variance + _UNIT_STD ** 2)


def kinematics_of(motion: MotionModel, dimension: int) -> Kinematics:
    """Return the kinematics of a motion model in D dimensions."""
    if isinstance(motion, OdometryMotion):
        return Driving(motion, dimension)
    if isinstance(motion, VelocityMotion):
        return Cruising(motion)
    assert isinstance(motion, RandomMotion)
    return Wandering(motion, dimension)


def move(kinematics: Kinematics, dimension: int, mean: Array, covariance: Array, motion: Motion
         ) -> tuple[Array, Array, Array, Array]:
    """
    Return beliefs (V, n), (V, n, n) after a motion, and the way: mean (V, D), covariance [m^2].

    A copy of the position that stays behind tells it, as all that comes after a state does.
    """
    size = mean.shape[1]
    then = np.r_[:size, :dimension]
    mean, covariance = kinematics.predict(
        mean[:, then], covariance[:, then[:, None], then], motion)
    way = np.zeros((dimension, size + dimension))
    way[:, :dimension], way[:, size:] = np.eye(dimension), -np.eye(dimension)
    return (mean[:, :size].copy(), covariance[:, :size, :size].copy(),
            mean @ way.T, way @ covariance @ way.T)


def _no_rotation(mean: Array) -> tuple[Array, Array]:
    unknown = np.full(len(mean), np.nan)
    return unknown, unknown
