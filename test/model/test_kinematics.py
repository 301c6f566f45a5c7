"""Kinematics of Gaussians against the particles that they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tsmcl_ros.model.kinematics import Cruising, Kinematics, kinematics_of, move
from tsmcl_ros.model.motion import motion_model, MotionConfig, MotionModel
from tsmcl_ros.types import Motion, Prior

MANY = 40_000


def sample(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.random.default_rng(1).multivariate_normal(mean, covariance, MANY)


MODELS = [
    ('random', {'max_speed': 7.0}),
    ('velocity', {'acceleration_std': 0.8}),
    ('velocity', {'acceleration_std': 0.8, 'speed_decay': 2.0}),
    ('odometry', {'odom_heading': 'known', 'odom_std': 0.3, 'alpha3': 0.2, 'alpha4': 0.1}),
]


def drive(name: str, settings: dict[str, object], dimension: int
          ) -> tuple[MotionModel, Kinematics, Motion]:
    """Return a motion model, what it is to Gaussians, and a motion."""
    model = motion_model(MotionConfig(motion_model=name, **settings),  # type: ignore[arg-type]
                         dimension, True)
    return model, kinematics_of(model, dimension), Motion(
        1.5, np.array([[3.0, -1.0, 0.5]])[:, :dimension], np.array([0.4]))


def some_belief(size: int) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(size) * 1.0, np.eye(size) + 0.2


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize(('name', 'settings'), MODELS)
def test_a_belief_moves_as_its_particles_do(
        name: str, settings: dict[str, object], dimension: int) -> None:
    model, kinematics, motion = drive(name, settings, dimension)
    mean, covariance = some_belief(dimension + kinematics.extra)
    moved = model.predict(sample(mean, covariance)[None].astype(np.float32), motion,
                          np.random.default_rng(2))[0]
    after, spread = kinematics.predict(mean[None], covariance[None], motion)
    std = np.sqrt(np.diagonal(spread[0]))
    np.testing.assert_allclose(after[0], moved.mean(axis=0), atol=0.03 * std.max())
    np.testing.assert_allclose(spread[0], np.cov(moved.T), atol=0.04 * std.max() ** 2)


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize(('name', 'settings'), MODELS)
def test_the_way_of_a_belief_is_that_of_its_particles(
        name: str, settings: dict[str, object], dimension: int) -> None:
    model, kinematics, motion = drive(name, settings, dimension)
    # Positions that are known worse than velocities, and go with them.
    mean, covariance = some_belief(dimension + kinematics.extra)
    covariance[:dimension, :dimension] *= 9.0
    before = sample(mean, covariance).astype(np.float32)
    way = (model.predict(before[None], motion, np.random.default_rng(2))[0] - before)[
        :, :dimension]
    after, spread, along, aside = move(
        kinematics, dimension, mean[None], covariance[None], motion)
    for moved, plain in zip((after, spread), kinematics.predict(
            mean[None], covariance[None], motion), strict=True):
        np.testing.assert_allclose(moved, plain)
    std = np.sqrt(np.diagonal(aside[0]))
    np.testing.assert_allclose(along[0], way.mean(axis=0), atol=0.03 * std.max())
    np.testing.assert_allclose(aside[0], np.cov(way.T), atol=0.04 * std.max() ** 2)


def test_a_heading_known_well_moves_a_belief_as_its_particles() -> None:
    config = MotionConfig(motion_model='odometry', odom_std=0.0, alpha1=0.0, alpha2=0.0,
                          alpha3=0.0, alpha4=0.0)
    model = motion_model(config, 2, True)
    kinematics = kinematics_of(model, 2)
    prior = Prior(0, np.zeros(2), np.eye(2), yaw=0.7, yaw_std=0.3)
    unit, spread = kinematics.begin(prior)
    heading = sample(np.array([0.0, 0.0, 0.7]), np.diag([1.0, 1.0, 0.09]))
    np.testing.assert_allclose(
        unit, [np.cos(heading[:, 2]).mean(), np.sin(heading[:, 2]).mean()], atol=5e-3)
    np.testing.assert_allclose(
        spread, np.cov(np.cos(heading[:, 2]), np.sin(heading[:, 2])), atol=5e-3)
    motion = Motion(1.0, np.array([[10.0, 0.0]]), np.zeros(1))
    moved = model.predict(heading[None].astype(np.float32), motion, np.random.default_rng(2))[0]
    mean, covariance = kinematics.predict(
        np.concatenate([np.zeros(2), unit])[None],
        np.block([[np.eye(2), np.zeros((2, 2))], [np.zeros((2, 2)), spread]])[None], motion)
    # What the unit vector learns of its length moves it by a tenth of a standard deviation.
    np.testing.assert_allclose(mean[0, :2], moved[:, :2].mean(axis=0), atol=0.4)
    np.testing.assert_allclose(covariance[0, :2, :2], np.cov(moved[:, :2].T), atol=1.2)
    rotation, variance = kinematics.rotation(mean, covariance)
    assert rotation[0] == pytest.approx(0.7, abs=0.02)
    assert math.sqrt(variance[0]) == pytest.approx(0.3, abs=0.05)


def test_an_unknown_heading_is_learnt_from_positions() -> None:
    model = motion_model(MotionConfig(motion_model='odometry'), 2, True)
    kinematics = kinematics_of(model, 2)
    unit, spread = kinematics.begin()
    mean = np.concatenate([np.zeros(2), unit])[None]
    covariance = np.block([[0.01 * np.eye(2), np.zeros((2, 2))],
                           [np.zeros((2, 2)), spread]])[None]
    assert kinematics.rotation(mean, covariance)[1][0] == pytest.approx(math.pi ** 2)
    for step in range(1, 4):
        mean, covariance = kinematics.predict(
            mean, covariance, Motion(1.0, np.array([[2.0, 0.0]]), np.zeros(1)))
        design = np.eye(2, 4)  # the position, which went north
        gain = covariance[0] @ design.T @ np.linalg.inv(
            design @ covariance[0] @ design.T + 0.01 * np.eye(2))
        mean = mean + gain @ (np.array([0.0, 2.0 * step]) - mean[0, :2])
        covariance = covariance - (gain @ design @ covariance[0])[None]
    rotation, variance = kinematics.rotation(mean, covariance)
    assert rotation[0] == pytest.approx(math.pi / 2, abs=0.1)
    assert variance[0] < 0.1 ** 2


@pytest.mark.parametrize('name', ['random', 'velocity'])
def test_without_odometry_there_is_no_rotation(name: str) -> None:
    kinematics = kinematics_of(motion_model(MotionConfig(motion_model=name), 2, False), 2)
    size = 2 + kinematics.extra
    for part in kinematics.rotation(np.zeros((3, size)), np.tile(np.eye(size), (3, 1, 1))):
        assert np.isnan(part).all()


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_turn_adds_what_a_new_velocity_since_some_time_does(dimension: int) -> None:
    model = motion_model(MotionConfig(motion_model='velocity', max_speed=3.0), dimension, True)
    kinematics = kinematics_of(model, dimension)
    assert isinstance(kinematics, Cruising)
    change = sample(*kinematics.begin())
    for elapsed, added in zip((1.0, 6.0), kinematics.turn(np.array([1.0, 6.0])), strict=True):
        since = np.random.default_rng(2).uniform(0, elapsed, (MANY, 1))
        drawn = np.hstack([since * change, change])
        scale = np.sqrt(np.diagonal(added))
        np.testing.assert_allclose(
            np.cov(drawn.T) / np.outer(scale, scale), added / np.outer(scale, scale), atol=0.03)
