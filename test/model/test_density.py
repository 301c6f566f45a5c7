"""Kernel densities of clouds, against scipy's."""

from __future__ import annotations

import numpy as np
from scipy import stats
from tsmcl_ros.model.density import CloudDensity


def density(particles: np.ndarray, weights: np.ndarray | None = None) -> CloudDensity:
    if weights is None:
        weights = np.full(particles.shape[:2], 1 / particles.shape[1])
    return CloudDensity.of(particles.astype(np.float32), weights, np.random.default_rng(2))


def test_a_gaussian_cloud_s_density_is_the_gaussian() -> None:
    covariance = np.array([[9.0, 3.0], [3.0, 4.0]])
    truth = stats.multivariate_normal([50.0, -20.0], covariance)
    draw = np.random.default_rng(1)
    particles = truth.rvs(1000, draw)
    points = truth.rvs(200, draw)
    found, _ = density(particles[None]).log_density(points[None].astype(np.float32))
    # 200 centres tell a density to within a fifth or so, without bias.
    assert abs(np.mean(found[0] - truth.logpdf(points))) < 0.1
    assert np.std(found[0] - truth.logpdf(points)) < 0.35


def test_a_density_keeps_the_mean_and_covariance_of_its_cloud() -> None:
    draw = np.random.default_rng(1)
    particles = np.concatenate([draw.normal(-20, 1, (100, 2)), draw.normal(20, 1, (100, 2))])
    axis = np.arange(-80.0, 80.0, 0.5)
    raster = np.stack(np.meshgrid(axis, axis, indexing='ij'), axis=-1).reshape(1, -1, 2)
    found, _ = density(particles[None]).log_density(raster.astype(np.float32))
    mass = np.exp(found[0]) * 0.25
    mean = mass @ raster[0]
    np.testing.assert_allclose(mass.sum(), 1.0, atol=1e-3)
    np.testing.assert_allclose(mean, particles.mean(axis=0), atol=0.05)
    spread = (mass * (raster[0] - mean).T) @ (raster[0] - mean)
    np.testing.assert_allclose(spread, np.cov(particles.T, bias=True), rtol=0.01)


def test_heavy_particles_are_where_the_density_is_and_parents_are_the_nearest() -> None:
    particles = np.array([[[0.0, 0.0], [0.1, 0.0], [50.0, 0.0]]])
    cloud = density(particles, np.array([[0.45, 0.45, 0.1]]))
    (at, off), (first, second) = (values[0] for values in cloud.log_density(
        np.array([[[0.0, 0.0], [0.0, 60.0]]], np.float32)))
    assert at > off
    assert first in (0, 1)
    assert second in (0, 1, 2)


def test_copies_of_one_particle_have_a_density() -> None:
    found, _ = density(np.full((1, 50, 2), 7.0)).log_density(
        np.array([[[7.0, 7.0], [8.0, 7.0]]], np.float32))
    assert np.isfinite(found).all()
    assert found[0, 0] > found[0, 1]


def test_a_cloud_on_a_line_far_away_has_a_density() -> None:
    along = np.random.default_rng(1).uniform(-1e5, 1e5, (100, 1))
    particles = np.concatenate([along, along], axis=1)[None]
    found, _ = density(particles).log_density(particles.astype(np.float32))
    assert np.isfinite(found).all()
