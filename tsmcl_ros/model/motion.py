"""
Motion models: how particles move between two epochs.

A particle's state is its position (D columns) followed by what its motion model remembers: the
heading of the odometry frame, a velocity, or nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Protocol

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.kernel import BallKernel, GaussianKernel, Kernel
from tsmcl_ros.model.particles import chunks
from tsmcl_ros.model.sampling import even_shares
from tsmcl_ros.types import Array, Motion, Prior


@dataclass(frozen=True)
class MotionConfig(Config):
    """How vehicles may move, and how far their odometry is to be trusted."""

    motion_model: str = param(
        'auto', 'how particles move; auto: by odometry if there is any, else by velocity',
        choices=('auto', 'random', 'odometry', 'velocity'))
    max_speed: float = param(
        50.0, 'v_max, bounds the random motion model and the first velocities',
        unit='m/s', above=0.0, live=True)
    acceleration_std: float = param(
        0.5, 'acceleration noise of the velocity model, white noise density',
        unit='m/s^1.5', above=0.0, live=True)
    speed_decay: float = param(
        0.0, 'time constant in which the velocity model forgets, 0 for never', unit='s', low=0.0,
        live=True)
    odom_heading: str = param(
        'unknown', 'whether the odometry frame has the orientation of the map',
        choices=('known', 'unknown'))
    odom_std: float = param(
        0.05, 'odometry position noise per square root of a second', unit='m', low=0.0, live=True)
    alpha1: float = param(
        0.05, 'rotation noise of odometry per rotation', unit='rad/rad', low=0.0, live=True)
    alpha2: float = param(
        0.005, 'rotation noise of odometry per distance', unit='rad/m', low=0.0, live=True)
    alpha3: float = param(
        0.1, 'position noise of odometry per distance', unit='m/m', low=0.0, live=True)
    alpha4: float = param(
        0.05, 'position noise of odometry per rotation', unit='m/rad', low=0.0, live=True)


class MotionModel(Protocol):
    """
    What every motion model offers.

    `extra` is the number of columns that it remembers; `heading` says that the first of them is
    the rotation from the odometry frame to the map [rad], else they are the velocity [m/s].
    """

    extra: int
    heading: bool

    def draw(self, vehicles: int, count: int, rng: np.random.Generator) -> Array:
        """Return (V, count, extra) float32: what particles remember before the first epoch."""

    def predict(self, states: Array, motion: Motion, rng: np.random.Generator) -> Array:
        """Return the states (V, N, D + extra) after the motion."""

    def kernel(self, states: Array, motion: Motion, rng: np.random.Generator) -> Kernel:
        """Return where `predict` may put the states (V, N, D + extra), to draw it in boxes."""


class RandomMotion:
    """
    Uniform in the disk or ball of radius v_max T around each particle.

    The model of Hu and Evans (MobiCom 2004).
    """

    extra = 0
    heading = False

    def __init__(self, config: MotionConfig):
        self.config = config

    def draw(self, vehicles: int, count: int, rng: np.random.Generator) -> Array:
        """Remember nothing."""
        return np.zeros((vehicles, count, 0), np.float32)

    def predict(self, states: Array, motion: Motion, rng: np.random.Generator) -> Array:
        """Return the states (V, N, D) after the motion, each vehicle's evenly spread."""
        moved = even_ball(states.shape, self.reach(motion.elapsed), rng)
        moved += states
        return moved

    def kernel(self, states: Array, motion: Motion, rng: np.random.Generator) -> BallKernel:
        """Return the balls around the states (V, N, D)."""
        return BallKernel(states.astype(np.float64), self.reach(motion.elapsed))

    def reach(self, elapsed: float) -> float:
        """Return the radius [m] of the disk after this time [s]."""
        return self.config.max_speed * elapsed


class OdometryMotion:
    """
    The displacement measured by odometry, plus noise that grows with distance and turning.

    Unless the odometry frame is known to have the map's orientation, each particle remembers
    its own hypothesis of the rotation between them, which drifts with the gyro. A vehicle whose
    odometry is missing spreads as the random motion model does.
    """

    def __init__(self, config: MotionConfig):
        self.config = config
        self.heading = config.odom_heading == 'unknown'
        self.extra = int(self.heading)

    def draw(self, vehicles: int, count: int, rng: np.random.Generator) -> Array:
        """Return headings (V, count, extra), uniform."""
        turns = rng.random((vehicles, count, self.extra), np.float32)
        return (turns * 2 - 1) * np.float32(math.pi)

    def predict(self, states: Array, motion: Motion, rng: np.random.Generator) -> Array:
        """Return the states (V, N, D + extra) after the motion."""
        dimension = states.shape[2] - self.extra
        displacement, turn, std = self.measured(motion, len(states), dimension)
        moved = states.copy()
        position = moved[:, :, :dimension]
        for rows in chunks(*states.shape[:2]):
            some = position[rows]
            some += std[rows, None, None] * rng.standard_normal(some.shape, np.float32)
        self._drive(moved, displacement, turn, rng)
        return moved

    def kernel(self, states: Array, motion: Motion, rng: np.random.Generator) -> GaussianKernel:
        """Return the noise around the states (V, N, D + extra) driven, their headings drawn."""
        dimension = states.shape[2] - self.extra
        displacement, turn, std = self.measured(motion, len(states), dimension)
        driven = states.copy()
        self._drive(driven, displacement, turn, rng)
        return GaussianKernel(driven[:, :, :dimension].astype(np.float64),
                              std.astype(np.float64), driven[:, :, dimension:])

    def _drive(self, states: Array, displacement: Array, turn: Array, rng: np.random.Generator
               ) -> None:
        """Displace states (V, N, D + extra), each along a heading that drifts on the way."""
        position = states[:, :, :displacement.shape[1]]
        if self.heading:
            heading = states[:, :, displacement.shape[1]]
            path = np.linalg.norm(displacement, axis=1)
            drift = np.sqrt((self.config.alpha1 * turn) ** 2 + (self.config.alpha2 * path) ** 2)
            change = drift.astype(np.float32)[:, None] * rng.standard_normal(
                heading.shape, np.float32)
            # The displacement was driven, on average, with half of the step's drift.
            cos, sin = np.cos(heading + change / 2), np.sin(heading + change / 2)
            x, y = displacement[:, None, 0], displacement[:, None, 1]
            position[:, :, 0] += cos * x - sin * y
            position[:, :, 1] += sin * x + cos * y
            position[:, :, 2:] += displacement[:, None, 2:]
            heading += change
        else:
            position += displacement[:, None, :]

    def measured(self, motion: Motion, vehicles: int, dimension: int
                 ) -> tuple[Array, Array, Array]:
        """
        Return displacement (V, D) [m], turn (V,) [rad] and position noise std (V,) [m].

        A vehicle whose odometry is missing has no displacement, and the standard deviation of
        the random motion model.
        """
        config = self.config
        if motion.displacement is None or motion.turn is None:
            displacement, turn = np.full((vehicles, dimension), np.nan), np.zeros(vehicles)
        else:
            displacement, turn = motion.displacement[:, :dimension], np.abs(motion.turn)
        missing = np.isnan(displacement).any(axis=1)
        displacement = np.where(missing[:, None], 0, displacement).astype(np.float32)
        turn = np.where(missing, 0, turn)
        path = np.linalg.norm(displacement, axis=1)
        variance = (config.odom_std ** 2 * motion.elapsed + (config.alpha3 * path) ** 2
                    + (config.alpha4 * turn) ** 2)
        disk = (config.max_speed * motion.elapsed) ** 2 / (dimension + 2)
        std = np.sqrt(np.where(missing, disk, variance))
        return displacement, turn, std.astype(np.float32)


class VelocityMotion:
    """
    Correlated velocity with white acceleration noise, for what has no odometry.

    Each particle remembers its velocity. With a decay time tau the velocity is an
    Ornstein-Uhlenbeck process, whose speed stays bounded by acceleration_std sqrt(tau / 2).
    """

    heading = False

    def __init__(self, config: MotionConfig, dimension: int):
        self.config = config
        self.extra = dimension

    def draw(self, vehicles: int, count: int, rng: np.random.Generator) -> Array:
        """Return velocities (V, count, D) [m/s]."""
        shape = (vehicles, count, self.extra)
        config = self.config
        if config.speed_decay > 0:
            std = config.acceleration_std * math.sqrt(config.speed_decay / 2)
            return np.float32(std) * rng.standard_normal(shape, np.float32)
        return uniform_ball(shape, config.max_speed, rng)

    def predict(self, states: Array, motion: Motion, rng: np.random.Generator) -> Array:
        """Return the states (V, N, 2 D) after the motion."""
        position, velocity = states[:, :, :self.extra], states[:, :, self.extra:]
        keep, path, change, along, across = map(np.float32, self.transition(motion.elapsed))
        first, second = rng.standard_normal((2, *velocity.shape), np.float32)
        return np.concatenate([
            position + path * velocity + along * first + across * second,
            keep * velocity + change * first], axis=2)

    def kernel(self, states: Array, motion: Motion, rng: np.random.Generator) -> GaussianKernel:
        """Return where the states (V, N, 2 D) lead, and the velocities that come with noise."""
        position, velocity = states[:, :, :self.extra], states[:, :, self.extra:]
        keep, path, change, along, across = self.transition(motion.elapsed)
        variance = along ** 2 + across ** 2
        return GaussianKernel(
            position + path * velocity.astype(np.float64),
            np.full(len(states), math.sqrt(variance)), keep * velocity,
            coupling=change * along / variance if variance > 0 else 0.0,
            remembered_std=change * across / math.sqrt(variance) if variance > 0 else change)

    def transition(self, elapsed: float) -> tuple[float, float, float, float, float]:
        """
        Return what this time [s] does to each axis, exactly however long it is.

        Returns
        -------
        keep, path : float
            What is left of a velocity of 1 m/s [m/s], and how far it leads [m].
        change, along, across : float
            Standard deviation of the velocity's noise [m/s], of the position's noise that comes
            with it, and of the rest of the position's noise [m].

        """
        tau, std = self.config.speed_decay, self.config.acceleration_std
        forgotten = elapsed / tau if tau > 0 else 0.0
        if forgotten < 1e-4:  # where the formulas below would cancel
            change = std * math.sqrt(elapsed)
            return 1.0, elapsed, change, change * elapsed / 2, change * elapsed / math.sqrt(12)
        lost, std = -math.expm1(-forgotten), std * math.sqrt(tau)
        change = std * math.sqrt(lost * (2 - lost) / 2)
        along = (std * lost) ** 2 / (2 * change)
        variance = std ** 2 * (forgotten - lost - lost ** 2 / 2)
        across = math.sqrt(max(variance - along ** 2, 0.0))
        return 1 - lost, tau * lost, change, tau * along, tau * across


def draw(prior: Prior, motion: MotionModel, count: int, rng: np.random.Generator) -> Array:
    """Return states (count, D + extra) float32 of a vehicle, drawn from a prior belief."""
    size = len(prior.mean)
    states = np.empty((count, size + motion.extra), np.float32)
    states[:, :size] = rng.multivariate_normal(prior.mean, prior.covariance, count, method='eigh')
    states[:, size:] = motion.draw(1, count, rng)[0]
    if motion.heading and prior.yaw is not None:
        states[:, size] = prior.yaw + prior.yaw_std * rng.standard_normal(count)
    elif motion.extra and prior.velocity_std is not None:
        states[:, size:] = prior.velocity_std * rng.standard_normal((count, motion.extra))
    return states


def uniform_ball(shape: tuple[int, ...], radius: float, rng: np.random.Generator) -> Array:
    """Return float32 points of this shape (..., D), uniform in the ball of this radius [m]."""
    dimension = shape[-1]
    direction = rng.standard_normal(shape, np.float32)
    direction /= np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-20)
    fraction = rng.random((*shape[:-1], 1), np.float32) ** np.float32(1 / dimension)
    return direction * (np.float32(radius) * fraction)


def even_ball(shape: tuple[int, int, int], radius: float, rng: np.random.Generator) -> Array:
    """
    Return float32 points (V, N, D), each uniform in the ball of this radius [m], evenly spread.

    So the cloud's mean hardly moves by chance. The order of a vehicle's points is random, lest a
    particle's next displacement follow from its last.
    """
    vehicles, count, dimension = shape
    number, points = rng.permutation(count), np.empty(shape, np.float32)
    for rows in chunks(vehicles, count):
        some = points[rows]
        even = even_shares(number, len(some), dimension, rng)
        distance = np.float32(radius) * (
            np.sqrt(even[:, :, 0]) if dimension == 2 else np.cbrt(even[:, :, 0]))
        azimuth = np.float32(2 * math.pi) * even[:, :, 1]
        if dimension == 3:
            height = 2 * even[:, :, 2] - 1
            np.multiply(distance, height, out=some[:, :, 2])
            distance *= np.sqrt(1 - np.square(height))
        np.multiply(distance, np.cos(azimuth), out=some[:, :, 0])
        np.multiply(distance, np.sin(azimuth), out=some[:, :, 1])
    return points


def motion_model(config: MotionConfig, dimension: int, odometry: bool) -> MotionModel:
    """
    Return the motion model that a config names.

    Parameters
    ----------
    config : MotionConfig
        Names it, and holds its parameters.
    dimension : int
        D.
    odometry : bool
        Whether there is odometry, which is what `auto` goes by.

    """
    name = config.motion_model
    if name == 'auto':
        name = 'odometry' if odometry else 'velocity'
    if name == 'odometry':
        return OdometryMotion(config)
    if name == 'velocity':
        return VelocityMotion(config, dimension)
    return RandomMotion(config)
