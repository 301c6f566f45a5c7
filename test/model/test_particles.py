"""Weights against scipy's softmax, resampling against its definition, moments against numpy."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from scipy import special, stats
from tsmcl_ros.model.particles import (
    effective_sample_size,
    kernel_density,
    log_cauchy,
    moments,
    normalize,
    spread,
    systematic_resample,
    z_order,
)

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3

log_weights = arrays(np.float32, st.tuples(st.integers(1, 4), st.integers(1, 30)),
                     elements=st.floats(-1e4, 1e4, width=32))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def copies(index: np.ndarray, size: int) -> np.ndarray:
    """How often each of the particles was drawn (V, N)."""
    return np.array([np.bincount(row, minlength=size) for row in index])


@given(log_weights)
def test_weights_are_the_softmax_of_log_weights(logs: np.ndarray) -> None:
    expected = special.softmax(logs.astype(np.float64), axis=1)
    # A difference of two logs of 1e4 carries their float32 rounding, 1e-3.
    np.testing.assert_allclose(normalize(logs)[0], expected, rtol=2e-3, atol=1e-30)


@given(log_weights)
def test_the_total_is_the_log_of_the_sum_of_weights(logs: np.ndarray) -> None:
    expected = special.logsumexp(logs.astype(np.float64), axis=1)
    np.testing.assert_allclose(normalize(logs)[1], expected, rtol=1e-5, atol=1e-5)


@given(log_weights)
def test_weights_sum_to_one(logs: np.ndarray) -> None:
    np.testing.assert_allclose(normalize(logs)[0].sum(axis=1, dtype=np.float64), 1, rtol=1e-5)


def test_a_cloud_without_any_weight_gets_equal_ones_and_no_total() -> None:
    weights, total = normalize(np.array([[-np.inf] * 4, [0, 0, -np.inf, -np.inf]]))
    np.testing.assert_array_equal(weights, [[0.25] * 4, [0.5, 0.5, 0, 0]])
    np.testing.assert_allclose(total, [-np.inf, np.log(2)])


def test_normalizing_leaves_its_argument_as_it_was() -> None:
    logs = np.array([[-1.0, -2.0]], np.float32)
    normalize(logs)
    np.testing.assert_array_equal(logs, np.array([[-1.0, -2.0]], np.float32))


def test_the_effective_size_of_equal_weights_is_their_number() -> None:
    assert effective_sample_size(np.full((1, 8), 1 / 8))[0] == pytest.approx(8)


def test_the_effective_size_of_one_heavy_particle_is_one() -> None:
    assert effective_sample_size(np.eye(5)[:1])[0] == pytest.approx(1)


@given(log_weights)
def test_the_effective_size_lies_between_one_and_all(logs: np.ndarray) -> None:
    size = effective_sample_size(normalize(logs)[0])
    assert np.all(size > 1 - 1e-5)
    assert np.all(size < logs.shape[1] * (1 + 1e-5))


@given(log_weights, st.integers(1, 60), st.integers(0, 2**32))
def test_each_particle_is_drawn_floor_or_ceil_of_its_share(
        logs: np.ndarray, count: int, seed: int) -> None:
    weights = normalize(logs)[0].astype(np.float64)
    weights /= weights.sum(axis=1, keepdims=True)
    drawn = copies(systematic_resample(weights, count, rng(seed)), weights.shape[1])
    share = count * weights
    # The cumulative sum is rounded at 1e-16 a particle.
    assert np.all(drawn >= np.floor(share - 1e-9))
    assert np.all(drawn <= np.ceil(share + 1e-9))


@given(log_weights, st.integers(1, 60), st.integers(0, 2**32))
def test_resampling_draws_as_many_as_were_asked_for(
        logs: np.ndarray, count: int, seed: int) -> None:
    index = systematic_resample(normalize(logs)[0], count, rng(seed))
    assert index.shape == (len(logs), count)
    assert index.min() >= 0
    assert index.max() < logs.shape[1]


def test_resampling_is_unbiased() -> None:
    weights = rng().dirichlet(np.ones(7))
    vehicles, count = 20_000, 10
    index = systematic_resample(np.tile(weights, (vehicles, 1)), count, rng(2))
    whole, fraction = np.divmod(count * weights, 1)
    extra = copies(index, 7).sum(axis=0) - vehicles * whole
    # Each vehicle draws a particle once more with the probability of its share's fraction.
    for successes, probability in zip(extra, fraction, strict=True):
        test = stats.binomtest(int(successes), vehicles, probability)
        assert test.pvalue > SIGNIFICANCE / 7


def test_resampling_varies_less_than_independent_draws_do() -> None:
    weights = rng().dirichlet(np.ones(50))
    index = systematic_resample(np.tile(weights, (1000, 1)), 200, rng(2))
    statistic = stats.chisquare(copies(index, 50), 200 * weights[None], axis=1).statistic
    # Independent draws have chi2 with 49 degrees of freedom; rounding has at most 1/4 / (N w).
    assert statistic.mean() < (0.25 / (200 * weights)).sum() < stats.chi2(49).mean()


def test_vehicles_are_resampled_by_their_own_weights() -> None:
    weights = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0]], np.float32)
    np.testing.assert_array_equal(
        systematic_resample(weights, 2, rng()), [[0, 0], [2, 2], [1, 1]])


def test_vehicles_are_resampled_independently() -> None:
    drawn = copies(systematic_resample(np.full((4000, 2), [0.25, 0.75]), 1, rng()), 2)
    assert abs(np.corrcoef(drawn[:-1, 0], drawn[1:, 0])[0, 1]) < 4 / np.sqrt(4000)


@given(st.integers(0, 2**32))
def test_a_particle_without_weight_is_never_drawn(seed: int) -> None:
    weights = np.array([[0, 1, 0, 3, 0]], np.float32) / 4
    assert set(systematic_resample(weights, 9, rng(seed))[0]) <= {1, 3}


def test_moments_are_those_of_numpy() -> None:
    particles = rng().normal(size=(3, 50, 2)).astype(np.float32)
    weights = rng(2).dirichlet(np.ones(50), 3)
    mean, covariance = moments(particles, weights)
    for vehicle in range(3):
        np.testing.assert_allclose(
            mean[vehicle], np.average(particles[vehicle], axis=0, weights=weights[vehicle]),
            atol=1e-12)
        np.testing.assert_allclose(
            covariance[vehicle],
            np.cov(particles[vehicle], rowvar=False, aweights=weights[vehicle], ddof=0),
            atol=1e-12)


def test_the_mean_is_not_divided_by_the_number_of_particles() -> None:
    mean, _ = moments(np.full((1, 10, 2), 7.0, np.float32), np.full((1, 10), 0.1))
    np.testing.assert_allclose(mean, [[7.0, 7.0]])


def test_the_covariance_of_a_cloud_far_from_the_origin_is_exact() -> None:
    offsets = np.array([[-0.5, 0.25], [0.5, -0.25]])
    particles = (1e5 + offsets).astype(np.float32)[None]
    _, covariance = moments(particles, np.full((1, 2), 0.5, np.float32))
    np.testing.assert_allclose(covariance[0], [[0.25, -0.125], [-0.125, 0.0625]], atol=1e-9)


# Density


def test_kernel_densities_are_scipys() -> None:
    points, kernels = rng().normal(size=(2, 30, 2)), rng(2).normal(size=(2, 12, 2))
    width = np.array([0.3, 0.7])
    density = kernel_density(points, kernels, width)
    for vehicle in range(2):
        expected = np.mean([
            stats.multivariate_normal(kernel, width[vehicle] ** 2 * np.eye(2)).pdf(points[vehicle])
            for kernel in kernels[vehicle]], axis=0) * 2 * np.pi * width[vehicle] ** 2
        np.testing.assert_allclose(density[vehicle], expected, rtol=1e-6, atol=1e-6)


def test_far_from_all_kernels_a_density_is_small_but_not_zero() -> None:
    density = kernel_density(np.full((1, 1, 2), 1e5), np.zeros((1, 4, 2)), np.ones(1))
    assert 0 < density[0, 0] < 1e-5


@pytest.mark.parametrize('dimension', [2, 3])
def test_cauchy_s_density_is_that_of_student_with_one_degree_of_freedom(dimension: int) -> None:
    rng = np.random.default_rng(3)
    points, mean = rng.normal(0, 50, (2, 30, dimension)), rng.normal(0, 9, (2, dimension))
    root = rng.normal(0, 5, (2, dimension, dimension))
    scale = root @ np.swapaxes(root, 1, 2) + np.eye(dimension)
    found = log_cauchy(points, mean, scale)
    for one in range(2):
        apart = found[one] - stats.multivariate_t(mean[one], scale[one], df=1).logpdf(points[one])
        np.testing.assert_allclose(apart, apart[0], atol=1e-4)


def test_cauchy_s_density_around_a_point_is_finite() -> None:
    assert np.isfinite(log_cauchy(np.ones((1, 5, 2)), np.zeros((1, 2)), np.zeros((1, 2, 2)))).all()


def test_an_error_adds_so_much_of_the_plain_cloud() -> None:
    # Of one particle with all the weight: what the others are off from it.
    particles = np.array([[[0, 0], [3, 0], [0, 6]]], np.float32)
    _, covariance = moments(particles, np.array([[1, 0, 0]], np.float32), np.array([0.5]))
    np.testing.assert_allclose(covariance, [[[1.5, 0], [0, 6]]])


def test_the_order_is_that_of_a_space_filling_curve() -> None:
    # Morton's curve through four cells is a Z, and the same again in each of them.
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    curve = np.concatenate([2 * quarter + corners for quarter in corners]).astype(np.float32)
    mixed = rng().permutation(len(curve))
    np.testing.assert_array_equal(z_order(curve[None, mixed])[0], np.argsort(mixed))


@pytest.mark.parametrize('dimension', [2, 3])
def test_few_points_drawn_in_that_order_come_nearer_to_the_mean_of_all(dimension: int) -> None:
    points = rng().random((200, 1000, dimension), np.float32)
    ordered = np.take_along_axis(points, z_order(points)[:, :, None], axis=1)
    equal = np.full(points.shape[:2], 1e-3)

    def scatter(clouds: np.ndarray) -> float:
        index = systematic_resample(equal, 16, rng())
        few = np.take_along_axis(clouds, index[:, :, None], axis=1)
        return float(np.std(few.mean(axis=1)))

    # Independent draws give sqrt(1 / 12 / 16) = 0.072.
    assert scatter(ordered) < 0.8 * scatter(points)


def test_points_at_one_place_keep_their_order() -> None:
    np.testing.assert_array_equal(z_order(np.ones((1, 5, 2), np.float32)), [np.arange(5)])


def test_spread_is_the_root_mean_square_of_the_axes_standard_deviations() -> None:
    points = rng().normal(0, [3.0, 4.0], (2, 20_000, 2)).astype(np.float32)
    np.testing.assert_allclose(spread(points), math.sqrt((9 + 16) / 2), rtol=0.02)
