"""Motion models against the distributions that they promise and an exact discretization."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import linalg, stats
from tsmcl_ros.config import parameters
from tsmcl_ros.model.motion import (
    motion_model,
    MotionConfig,
    OdometryMotion,
    RandomMotion,
    uniform_ball,
    VelocityMotion,
)
from tsmcl_ros.types import ConfigError, Motion

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
MANY = 20_000
QUIET = {'odom_std': 0.0, 'alpha1': 0.0, 'alpha2': 0.0, 'alpha3': 0.0, 'alpha4': 0.0}


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def config(**settings: object) -> MotionConfig:
    return MotionConfig(**settings)  # type: ignore[arg-type]


def odometry(**settings: object) -> OdometryMotion:
    """Odometry without any noise but that of the settings."""
    return OdometryMotion(config(**{**QUIET, 'odom_heading': 'known', **settings}))


def drive(x: float = 0.0, y: float = 0.0, turn: float = 0.0, elapsed: float = 1.0) -> Motion:
    """One vehicle's measured motion."""
    return Motion(elapsed, np.array([[x, y]]), np.array([turn]))


def still(columns: int = 2, vehicles: int = 1, count: int = MANY) -> np.ndarray:
    return np.zeros((vehicles, count, columns), np.float32)


def assert_std(values: np.ndarray, std: float) -> None:
    """Hold that zero-mean Gaussian values have this standard deviation."""
    total = np.square(values / std).sum(dtype=np.float64)
    assert SIGNIFICANCE / 2 < stats.chi2(values.size).cdf(total) < 1 - SIGNIFICANCE / 2


# Uniform in a disk


@pytest.mark.parametrize('dimension', [2, 3])
def test_random_motion_is_uniform_over_the_radius_of_the_ball(dimension: int) -> None:
    moved = RandomMotion(config(max_speed=20.0)).predict(
        still(dimension), Motion(1.5), rng())[0]
    share = (np.linalg.norm(moved, axis=1) / 30.0) ** dimension
    assert stats.kstest(share, 'uniform').pvalue > SIGNIFICANCE


def test_random_motion_is_uniform_over_all_directions() -> None:
    moved = RandomMotion(config()).predict(still(), Motion(1.0), rng())[0]
    angle = np.arctan2(moved[:, 1], moved[:, 0])
    assert stats.kstest(angle, stats.uniform(-math.pi, 2 * math.pi).cdf).pvalue > SIGNIFICANCE


def test_random_motion_in_space_is_uniform_over_all_heights() -> None:
    moved = uniform_ball((MANY, 3), 1.0, rng())
    height = moved[:, 2] / np.linalg.norm(moved, axis=1)  # Archimedes
    assert stats.kstest(height, stats.uniform(-1, 2).cdf).pvalue > SIGNIFICANCE


def test_random_motion_in_space_has_even_heights() -> None:
    moved = RandomMotion(config()).predict(still(3), Motion(1.0), rng())[0]
    height = moved[:, 2] / np.linalg.norm(moved, axis=1)
    assert stats.kstest(height, stats.uniform(-1, 2).cdf).pvalue > SIGNIFICANCE


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_single_particle_moves_at_random_all_the_same(dimension: int) -> None:
    # One particle of each of many vehicles, whose draws do not depend on each other.
    start = np.zeros((MANY, 1, dimension), np.float32)
    moved = RandomMotion(config(max_speed=20.0)).predict(start, Motion(1.5), rng())[:, 0]
    share = (np.linalg.norm(moved, axis=1) / 30.0) ** dimension
    assert stats.kstest(share, 'uniform').pvalue > SIGNIFICANCE


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_mean_of_a_cloud_that_moves_at_random_hardly_moves(dimension: int) -> None:
    clouds = np.zeros((500, 50, dimension), np.float32)
    even = RandomMotion(config(max_speed=20.0)).predict(clouds, Motion(1.0), rng())
    independent = uniform_ball(clouds.shape, 20.0, rng())
    assert np.std(even.mean(axis=1)) < 0.4 * np.std(independent.mean(axis=1))


def test_random_motion_forgets_the_last_one() -> None:
    # In two steps the square of the way is that of independent steps, 2 r^2 / 2.
    model = RandomMotion(config(max_speed=20.0))
    draw, clouds = rng(), np.zeros((200, 50, 2), np.float32)
    for _ in range(2):
        clouds = model.predict(clouds, Motion(1.0), draw)
    squares = np.square(clouds).sum(axis=2).mean(axis=1)
    assert stats.ttest_1samp(squares, 400.0).pvalue > SIGNIFICANCE
    assert np.std(squares) < 100


def test_random_motion_is_never_faster_than_the_maximum() -> None:
    moved = RandomMotion(config(max_speed=20.0)).predict(still(), Motion(2.0), rng())
    assert np.linalg.norm(moved, axis=2).max() <= 40.0 * (1 + 1e-6)


def test_random_motion_in_no_time_is_none() -> None:
    states = rng().normal(size=(2, 5, 2)).astype(np.float32)
    np.testing.assert_array_equal(
        RandomMotion(config()).predict(states, Motion(0.0), rng()), states)


def test_random_motion_remembers_nothing() -> None:
    model = RandomMotion(config())
    assert model.draw(3, 4, rng()).shape == (3, 4, model.extra) == (3, 4, 0)


# Odometry


def test_odometry_moves_all_particles_by_the_displacement() -> None:
    moved = odometry().predict(still(count=3), drive(3.0, -4.0), rng())
    np.testing.assert_array_equal(moved, np.broadcast_to([3.0, -4.0], (1, 3, 2)))


def test_odometry_leaves_its_argument_as_it_was() -> None:
    states = still(count=3)
    odometry().predict(states, drive(3.0, -4.0), rng())
    assert not states.any()


@pytest.mark.parametrize(('settings', 'motion', 'std'), [
    ({'odom_std': 0.3}, drive(elapsed=4.0), 0.6),
    ({'alpha3': 0.1}, drive(3.0, 4.0), 0.5),
    ({'alpha4': 0.2}, drive(turn=0.5), 0.1),
    ({'alpha4': 0.2}, drive(turn=-0.5), 0.1),
    ({'odom_std': 0.3, 'alpha3': 0.08, 'alpha4': 2.4}, drive(3.0, 4.0, 0.5), 1.3),
])
def test_odometry_noise_grows_with_time_distance_and_turning(
        settings: dict[str, float], motion: Motion, std: float) -> None:
    assert motion.displacement is not None
    moved = odometry(**settings).predict(still(), motion, rng())
    assert_std(moved - motion.displacement.astype(np.float32), std)


@pytest.mark.parametrize('dimension', [2, 3])
def test_without_its_odometry_a_vehicle_spreads_as_random_motion_does(dimension: int) -> None:
    settings = config(max_speed=10.0, odom_heading='known')
    missing = Motion(2.0, np.full((1, dimension), np.nan), np.full(1, np.nan))
    by_odometry = OdometryMotion(settings).predict(still(dimension), missing, rng(1))
    by_chance = RandomMotion(settings).predict(still(dimension), missing, rng(2))
    # The standard error of a standard deviation is at most its 1 / sqrt(2 n): 0.5 % here.
    np.testing.assert_allclose(by_odometry.std(), by_chance.std(), rtol=0.02)


def test_one_vehicle_s_missing_odometry_is_no_other_s() -> None:
    motion = Motion(1.0, np.array([[np.nan, np.nan], [3.0, -4.0]]), np.array([np.nan, 0.0]))
    moved = odometry(max_speed=10.0).predict(still(vehicles=2, count=50), motion, rng())
    np.testing.assert_array_equal(moved[1], np.broadcast_to([3.0, -4.0], (50, 2)))
    assert moved[0].std() > 1.0


def test_an_outage_of_all_odometry_spreads_every_vehicle() -> None:
    moved = odometry(max_speed=10.0).predict(still(vehicles=2), Motion(1.0), rng())
    assert_std(moved, 5.0)


def test_a_known_heading_is_not_remembered() -> None:
    model = odometry()
    assert not model.heading
    assert model.draw(2, 3, rng()).shape == (2, 3, model.extra) == (2, 3, 0)


def test_unknown_headings_start_uniform() -> None:
    heading = odometry(odom_heading='unknown').draw(1, MANY, rng())
    uniform = stats.uniform(-math.pi, 2 * math.pi)
    assert stats.kstest(heading.ravel(), uniform.cdf).pvalue > SIGNIFICANCE


def test_each_particle_s_heading_rotates_its_displacement() -> None:
    states = still(3, count=4)
    states[0, :, 2] = [0.0, math.pi / 2, math.pi, -math.pi / 2]
    moved = odometry(odom_heading='unknown').predict(states, drive(3.0, 1.0), rng())
    np.testing.assert_allclose(
        moved[0, :, :2], [[3, 1], [-1, 3], [-3, -1], [1, -3]], atol=1e-6)


def test_a_heading_leaves_the_height_alone() -> None:
    states = still(4, count=1)
    states[0, 0, 3] = math.pi / 2
    motion = Motion(1.0, np.array([[3.0, 1.0, 2.0]]), np.zeros(1))
    moved = odometry(odom_heading='unknown').predict(states, motion, rng())
    np.testing.assert_allclose(moved[0, 0], [-1.0, 3.0, 2.0, math.pi / 2], atol=1e-6)


@pytest.mark.parametrize(('settings', 'motion', 'std'), [
    ({'alpha1': 0.2}, drive(turn=-0.5), 0.1),
    ({'alpha2': 0.01}, drive(3.0, 4.0), 0.05),
    ({'alpha1': 0.1, 'alpha2': 0.024}, drive(3.0, 4.0, 0.5), 0.13),
])
def test_headings_drift_with_turning_and_distance(
        settings: dict[str, float], motion: Motion, std: float) -> None:
    moved = odometry(odom_heading='unknown', **settings).predict(still(3), motion, rng())
    assert_std(moved[:, :, 2], std)


# Correlated velocity


def exact(model: VelocityMotion, elapsed: float) -> tuple[np.ndarray, np.ndarray]:
    """
    Transition and noise covariance of one axis' position and velocity.

    By the matrix exponential of Van Loan: Computing integrals involving the matrix
    exponential, 1978.
    """
    decay = 1 / model.config.speed_decay if model.config.speed_decay else 0.0
    drift = np.array([[0.0, 1.0], [0.0, -decay]])
    noise = np.diag([0.0, model.config.acceleration_std ** 2])
    block = linalg.expm(elapsed * np.block([[-drift, noise], [np.zeros((2, 2)), drift.T]]))
    transition = block[2:, 2:].T
    return transition, transition @ block[:2, 2:]


def velocity(speed_decay: float = 0.0, **settings: object) -> VelocityMotion:
    return VelocityMotion(
        config(speed_decay=speed_decay, **{'acceleration_std': 0.7, **settings}), 2)


DECAYS = [0.0, 2.0, 5.0, 1e6]


@pytest.mark.parametrize('decay', DECAYS)
@pytest.mark.parametrize('elapsed', [0.5, 20.0])
def test_velocities_carry_on_and_decay_as_the_exact_model_has_it(
        decay: float, elapsed: float) -> None:
    model = velocity(decay, acceleration_std=1e-9)
    states = still(4, count=1)
    states[0, 0] = [1.0, 2.0, 3.0, -4.0]
    transition, _ = exact(model, elapsed)
    moved = model.predict(states, Motion(elapsed), rng())[0, 0].reshape(2, 2)
    np.testing.assert_allclose(moved, transition @ states.reshape(2, 2), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize('decay', DECAYS)
@pytest.mark.parametrize('elapsed', [0.5, 20.0])
def test_the_noise_of_velocity_and_position_is_that_of_the_exact_model(
        decay: float, elapsed: float) -> None:
    model = velocity(decay)
    _, covariance = exact(model, elapsed)
    moved = model.predict(still(4), Motion(elapsed), rng())[0].reshape(MANY, 2, 2)
    white = linalg.solve_triangular(
        np.linalg.cholesky(covariance), moved.transpose(1, 2, 0).reshape(2, -1), lower=True)
    # Whitened by the exact covariance: standard deviation 1 each, and uncorrelated.
    assert_std(white[0], 1.0)
    assert_std(white[1], 1.0)
    assert stats.pearsonr(white[0], white[1]).pvalue > SIGNIFICANCE


def test_no_time_changes_no_velocity_and_no_position() -> None:
    states = rng().normal(size=(1, 5, 4)).astype(np.float32)
    np.testing.assert_array_equal(velocity(2.0).predict(states, Motion(0.0), rng()), states)


def test_the_axes_of_a_velocity_are_independent() -> None:
    moved = velocity().predict(still(4), Motion(1.0), rng())[0]
    assert stats.pearsonr(moved[:, 2], moved[:, 3]).pvalue > SIGNIFICANCE


def test_first_velocities_that_decay_are_those_of_the_long_run() -> None:
    model = velocity(8.0)
    long_run = model.predict(still(4), Motion(1000.0), rng(1))[:, :, 2:]
    assert_std(long_run, 0.7 * math.sqrt(8.0 / 2))
    assert_std(model.draw(1, MANY, rng(2)), 0.7 * math.sqrt(8.0 / 2))


def test_first_velocities_without_decay_are_anything_up_to_the_maximum() -> None:
    speed = np.linalg.norm(velocity(max_speed=20.0).draw(1, MANY, rng()), axis=2).ravel()
    assert stats.kstest((speed / 20.0) ** 2, 'uniform').pvalue > SIGNIFICANCE


def test_a_velocity_in_space_has_three_axes() -> None:
    model = VelocityMotion(config(), 3)
    states = np.concatenate([still(3, count=5), model.draw(1, 5, rng())], axis=2)
    assert model.predict(states, Motion(1.0), rng()).shape == (1, 5, 6)


# Choosing


@pytest.mark.parametrize(('name', 'has_odometry', 'kind'), [
    ('auto', True, OdometryMotion),
    ('auto', False, VelocityMotion),
    ('random', True, RandomMotion),
    ('odometry', True, OdometryMotion),
    ('velocity', True, VelocityMotion),
])
def test_the_config_names_the_model_and_auto_goes_by_what_there_is(
        name: str, has_odometry: bool, kind: type) -> None:
    assert type(motion_model(config(motion_model=name), 2, has_odometry)) is kind


def test_an_unknown_model_is_refused_with_those_there_are() -> None:
    with pytest.raises(ConfigError, match='auto, random, odometry, velocity'):
        config(motion_model='teleport')


@pytest.mark.parametrize('name', [
    choice for item in parameters(MotionConfig) if item.name == 'motion_model'
    for choice in item.choices])
def test_every_model_keeps_to_float32_and_to_its_seed(name: str) -> None:
    model = motion_model(config(motion_model=name), 2, True)
    states = np.concatenate([still(count=50), model.draw(1, 50, rng())], axis=2)
    one, other = (model.predict(states, drive(3.0, 4.0, 0.1), rng(3)) for _ in range(2))
    assert one.dtype == np.float32
    np.testing.assert_array_equal(one, other)
