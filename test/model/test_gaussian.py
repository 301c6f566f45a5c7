"""Gaussian beliefs against scipy, textbook filters, finite differences and sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import linalg, optimize, stats
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.motion import MotionConfig, VelocityMotion


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def field(vehicles: int, anchors: int, dimension: int, std: float = 1.0, seed: int = 1
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return anchors (V, A, D), true positions (V, D) and measured ranges (V, A)."""
    draw = rng(seed)
    anchors_at = draw.uniform(0, 500, (vehicles, anchors, dimension))
    truth = draw.uniform(0, 500, (vehicles, dimension))
    distance = np.linalg.norm(anchors_at - truth[:, None], axis=2)
    return anchors_at, truth, distance + std * draw.standard_normal(distance.shape)


def spd(vehicles: int, size: int, seed: int = 3) -> np.ndarray:
    """Return random covariances (V, size, size)."""
    root = rng(seed).standard_normal((vehicles, size, size))
    return root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(size)


# Placing by ranges


@pytest.mark.parametrize('dimension', [2, 3])
def test_exact_ranges_give_the_exact_position(dimension: int) -> None:
    anchors, truth, distance = field(20, dimension + 3, dimension, std=0.0)
    fix = gaussian.multilaterate(
        anchors, distance, np.ones(distance.shape), np.ones(distance.shape, bool))
    assert fix.solved.sum() >= 18  # a few of the random fields have a mirror image
    np.testing.assert_allclose(fix.position[fix.solved], truth[fix.solved], atol=1e-6)


@pytest.mark.parametrize('dimension', [2, 3])
def test_noisy_ranges_give_the_least_squares_solution_of_scipy(dimension: int) -> None:
    anchors, truth, distance = field(10, 8, dimension)
    std = rng(5).uniform(0.5, 2.0, distance.shape)
    fix = gaussian.multilaterate(anchors, distance, std ** 2, np.ones(std.shape, bool))
    assert fix.solved.all()
    for row in range(10):
        def residual(x: np.ndarray, row: int = row) -> np.ndarray:
            return (np.linalg.norm(anchors[row] - x, axis=1) - distance[row]) / std[row]

        best = optimize.least_squares(residual, truth[row], xtol=1e-14, gtol=1e-14)
        np.testing.assert_allclose(fix.position[row], best.x, atol=1e-4)
        assert fix.misfit[row] == pytest.approx(2 * best.cost, rel=1e-6)
        np.testing.assert_allclose(
            fix.covariance[row], np.linalg.inv(best.jac.T @ best.jac), rtol=1e-4, atol=1e-4)


def test_the_linear_part_is_that_of_the_papers_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gaussian, '_STEPS', 1)
    started = []
    polish = gaussian._polish
    monkeypatch.setattr(
        gaussian, '_polish', lambda position, *rest: started.append(position) or polish(
            position, *rest))
    anchors, _, distance = field(1, 6, 3)
    gaussian.multilaterate(anchors, distance, np.full((1, 6), 1.0), np.ones((1, 6), bool))
    x, d = anchors[0], distance[0]
    rows = 2 * (x[:-1] - x[-1])
    right = (x[:-1] ** 2).sum(1) - (x[-1] ** 2).sum() - d[:-1] ** 2 + d[-1] ** 2
    variance = 4 * d ** 2 + 2
    weight = np.linalg.inv(np.diag(variance[:-1]) + variance[-1])
    expected = np.linalg.solve(rows.T @ weight @ rows, rows.T @ weight @ right)
    np.testing.assert_allclose(started[0][0], expected, rtol=1e-8)


def test_the_covariance_is_that_of_the_errors() -> None:
    anchors, truth, distance = field(1, 8, 3, std=0.0)
    many = 4000
    noisy = distance + 1.5 * rng(2).standard_normal((many, 8))
    fix = gaussian.multilaterate(
        np.repeat(anchors, many, axis=0), noisy, np.full(noisy.shape, 2.25),
        np.ones(noisy.shape, bool))
    error = fix.position - truth
    nees = np.einsum('vi,vij,vj->v', error, np.linalg.inv(fix.covariance), error)
    assert stats.kstest(nees, stats.chi2(3).cdf).statistic < 0.03
    assert stats.kstest(fix.misfit, stats.chi2(5).cdf).statistic < 0.03


def test_rows_that_do_not_count_change_nothing() -> None:
    anchors, _, distance = field(3, 6, 2)
    padded = np.concatenate([anchors, np.full((3, 2, 2), 1e5)], axis=1)
    ranges = np.concatenate([distance, np.full((3, 2), np.nan)], axis=1)
    used = np.arange(8) < 6
    alone = gaussian.multilaterate(
        anchors, distance, np.ones((3, 6)), np.ones((3, 6), bool))
    fix = gaussian.multilaterate(padded, ranges, np.ones((3, 8)), np.tile(used, (3, 1)))
    for one, other in zip(alone, fix, strict=True):
        np.testing.assert_allclose(one, other)


@pytest.mark.parametrize(('dimension', 'flat'), [(2, 1e-3), (3, 1e-3), (2, 0.0), (3, 0.0)])
def test_anchors_on_a_line_or_plane_leave_two_mirror_images(dimension: int, flat: float) -> None:
    anchors, truth, _ = field(10, 7, dimension)
    anchors[:, :, -1] *= flat
    distance = np.linalg.norm(anchors - truth[:, None], axis=2)
    fix = gaussian.multilaterate(
        anchors, distance, np.ones(distance.shape), np.ones(distance.shape, bool))
    assert not fix.solved.any()


@pytest.mark.parametrize('dimension', [2, 3])
def test_as_many_ranges_as_dimensions_are_too_few(dimension: int) -> None:
    anchors, _, distance = field(5, dimension, dimension)
    fix = gaussian.multilaterate(
        anchors, distance, np.ones(distance.shape), np.ones(distance.shape, bool))
    assert not fix.solved.any()
    assert all(np.isfinite(part).all() for part in fix)


def test_anchors_at_one_place_solve_nothing() -> None:
    fix = gaussian.multilaterate(
        np.zeros((2, 5, 3)), np.zeros((2, 5)), np.ones((2, 5)), np.ones((2, 5), bool))
    assert not fix.solved.any()
    assert np.isfinite(fix.position).all()


# Moving


@pytest.mark.parametrize('decay', [0.0, 3.0])
@pytest.mark.parametrize('elapsed', [0.1, 2.5])
def test_constant_velocity_is_the_exact_discretization(decay: float, elapsed: float) -> None:
    motion = VelocityMotion(MotionConfig(acceleration_std=0.7, speed_decay=decay), 2)
    rate = 1 / decay if decay else 0.0
    drift = np.kron([[0.0, 1.0], [0.0, -rate]], np.eye(2))
    density = np.kron([[0.0, 0.0], [0.0, 0.49]], np.eye(2))
    # Van Loan 1978.
    block = linalg.expm(elapsed * np.block([[-drift, density], [np.zeros((4, 4)), drift.T]]))
    transition, noise = gaussian.constant_velocity(motion, elapsed)
    np.testing.assert_allclose(transition, block[4:, 4:].T, atol=1e-12)
    np.testing.assert_allclose(noise, block[4:, 4:].T @ block[:4, 4:], atol=1e-9)


def test_prediction_and_update_are_those_of_a_kalman_filter() -> None:
    covariance, noise = spd(4, 4), spd(1, 4, 9)[0]
    mean, gradient = rng(7).standard_normal((2, 4, 4))
    transition = rng(8).standard_normal((4, 4))
    variance, measured = np.array([0.1, 1.0, 5.0, 50.0]), np.array([1.0, -2.0, 3.0, 0.5])
    ahead, spread = gaussian.predict(mean, covariance, transition, noise)
    after, left = gaussian.update(
        ahead, spread, gradient, measured - (gradient * ahead).sum(axis=1), variance)
    for v in range(4):
        x = transition @ mean[v]
        p = transition @ covariance[v] @ transition.T + noise
        gain = p @ gradient[v] / (gradient[v] @ p @ gradient[v] + variance[v])
        np.testing.assert_allclose(after[v], x + gain * (measured[v] - gradient[v] @ x))
        np.testing.assert_allclose(left[v], p - np.outer(gain, gradient[v]) @ p, atol=1e-12)


def test_an_infinite_variance_leaves_the_belief_as_it_is() -> None:
    mean, covariance = np.ones((2, 3)), spd(2, 3)
    after, left = gaussian.update(
        mean, covariance, np.ones((2, 3)), np.zeros(2), np.full(2, np.inf))
    np.testing.assert_array_equal(after, mean)
    np.testing.assert_allclose(left, covariance)


def test_the_covariance_stays_one_when_a_measurement_is_all_but_exact() -> None:
    mean, covariance = np.zeros((1, 2)), 1e10 * spd(1, 2)
    for step in range(200):
        angle = 0.1 * step
        mean, covariance = gaussian.update(
            mean, covariance, np.array([[math.cos(angle), math.sin(angle)]]), np.zeros(1),
            np.array([1e-8]))
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), rtol=1e-12)
    assert (np.linalg.eigvalsh(covariance[0]) > 0).all()


def test_a_measurement_half_trusted_gives_the_moments_of_the_mixture() -> None:
    mean, covariance = np.zeros((1, 1)), np.full((1, 1, 1), 4.0)
    after, left = gaussian.update(
        mean, covariance, np.ones((1, 1)), np.array([3.0]), np.array([4.0]), np.array([0.5]))
    sound, variance = 1.5, 2.0
    assert after[0, 0] == pytest.approx(0.5 * sound)
    second = 0.5 * (variance + sound ** 2) + 0.5 * 4.0
    assert left[0, 0, 0] == pytest.approx(second - (0.5 * sound) ** 2)


@pytest.mark.parametrize('excess', [-3.0, 0.0, 2.0])
def test_a_bound_gives_the_moments_of_the_exact_posterior(excess: float) -> None:
    x = np.linspace(-20, 20, 400_001)
    weight = stats.norm(excess, 1.5).pdf(x) * stats.norm.cdf(x / 0.5)
    total = weight.sum()
    centre = (weight * x).sum() / total
    variance = (weight * (x - centre) ** 2).sum() / total
    after, left, log_likelihood = gaussian.update_by_bound(
        np.full((1, 1), excess), np.full((1, 1, 1), 2.25), np.ones((1, 1)), np.array([excess]),
        np.array([0.25]))
    assert after[0, 0] == pytest.approx(centre, rel=1e-6)
    assert left[0, 0, 0] == pytest.approx(variance, rel=1e-6)
    assert math.exp(log_likelihood[0]) == pytest.approx(total * (x[1] - x[0]), rel=1e-6)


@pytest.mark.parametrize('excess', [-1e9, -1e4, -50.0, 50.0, 1e9, math.inf])
def test_a_bound_is_total(excess: float) -> None:
    after, left, log_likelihood = gaussian.update_by_bound(
        np.zeros((1, 2)), np.eye(2)[None], np.array([[1.0, 0.0]]), np.array([excess]),
        np.array([0.0]))
    assert np.isfinite(after).all()
    assert (np.linalg.eigvalsh(left[0]) > -1e-12).all()
    assert log_likelihood[0] <= 0


# Measuring


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_gradient_of_the_range_is_that_of_finite_differences(dimension: int) -> None:
    position, reference = rng().standard_normal((2, 5, dimension)) * 100
    exact = np.zeros((5, dimension, dimension))
    expected, gradient, variance = gaussian.range_to(position, exact, reference)
    np.testing.assert_allclose(expected, np.linalg.norm(position - reference, axis=1))
    np.testing.assert_array_equal(variance, 0)
    for axis in range(dimension):
        step = 1e-4 * np.eye(dimension)[axis]
        ahead, behind = (gaussian.range_to(position + side * step, exact, reference)[0]
                         for side in (1, -1))
        np.testing.assert_allclose(gradient[:, axis], (ahead - behind) / 2e-4, atol=1e-7)


@pytest.mark.parametrize(('dimension', 'off'), [(2, 0.0), (2, 5.0), (3, 3.0), (3, 30.0)])
def test_the_range_of_a_broad_belief_is_that_of_its_samples(dimension: int, off: float) -> None:
    position = np.full((1, dimension), off)
    covariance = 9.0 * np.eye(dimension)[None]
    expected, gradient, extra = gaussian.range_to(
        position, covariance, np.zeros((1, dimension)))
    drawn = np.linalg.norm(
        rng().multivariate_normal(position[0], covariance[0], 100_000), axis=1)
    # Gaussian moments of a curved quantity: within a sixth of its standard deviation.
    assert expected[0] == pytest.approx(drawn.mean(), abs=0.5)
    total = gaussian.innovation_variance(covariance, gradient, extra)[0]
    assert 0.8 < total / np.mean((drawn - expected[0]) ** 2) < 2.5


def test_at_the_reference_itself_range_and_azimuth_have_no_gradient() -> None:
    here = np.ones((1, 3))
    for gradient in (gaussian.range_to(here, np.zeros((1, 3, 3)), here)[1],
                     gaussian.azimuth_of(here, here)[1]):
        np.testing.assert_array_equal(gradient, 0)


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_gradient_of_the_azimuth_is_that_of_finite_differences(dimension: int) -> None:
    position, station = rng(2).standard_normal((2, 5, dimension)) * 100
    azimuth, gradient = gaussian.azimuth_of(position, station)
    delta = position - station
    np.testing.assert_allclose(np.tan(azimuth), delta[:, 1] / delta[:, 0])
    np.testing.assert_array_equal(np.sign(np.cos(azimuth)), np.sign(delta[:, 0]))
    for axis in range(dimension):
        step = 1e-4 * np.eye(dimension)[axis]
        ahead, behind = (gaussian.azimuth_of(position + side * step, station)[0]
                         for side in (1, -1))
        np.testing.assert_allclose(gradient[:, axis], (ahead - behind) / 2e-4, atol=1e-7)


# Doubting predictions


@pytest.mark.parametrize(('dimension', 'anchors', 'std'), [
    (2, 1, 1.0), (2, 6, 5.0), (3, 2, 1.0), (3, 4, 0.3), (3, 18, 3.0),
])
def test_a_right_prediction_surprises_alike_whatever_the_ranges(
        dimension: int, anchors: int, std: float) -> None:
    draw, vehicles = rng(5), 2000
    reference = 1e5 * draw.standard_normal((vehicles, anchors, dimension))
    covariance = spd(vehicles, dimension)
    offset = np.einsum('vij,vj->vi', np.linalg.cholesky(covariance),
                       draw.standard_normal((vehicles, dimension)))
    distance = np.linalg.norm(offset[:, None] - reference, axis=2)
    distance += std * draw.standard_normal(distance.shape)
    found = gaussian.surprise(np.zeros_like(offset), covariance, reference, distance,
                              np.full(distance.shape, std ** 2), np.ones(distance.shape, bool))
    told = stats.chi2(min(anchors, dimension))
    assert stats.kstest(2 * found, told.cdf).pvalue > 1e-3


def test_one_wild_range_surprises_little_and_many_that_agree_do() -> None:
    anchors, truth, distance = field(20, 8, 3, std=0.0)
    wild = distance.copy()
    wild[:, 3] += 300.0
    arguments = np.ones(distance.shape), np.ones(distance.shape, bool)
    spread = np.tile(np.eye(3), (20, 1, 1))
    single = gaussian.surprise(truth, spread, anchors, wild, *arguments)
    moved = gaussian.surprise(truth + 10.0, spread, anchors, distance, *arguments)
    assert single.max() < 8.0 < moved.min()


def test_no_range_surprises_nobody() -> None:
    anchors, truth, distance = field(3, 4, 3)
    np.testing.assert_array_equal(gaussian.surprise(
        truth + 1e4, np.tile(np.eye(3), (3, 1, 1)), anchors, distance, np.ones((3, 4)),
        np.zeros((3, 4), bool)), 0.0)
