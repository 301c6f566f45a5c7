"""
Weighted particle clouds: log-weights, effective sample size, resampling, moments.

Shapes: particles (V, N, D), log_weights (V, N). Functions return new arrays.
"""

from __future__ import annotations

import math

import numpy as np
from tsmcl_ros.types import Array

# Points reckoned at once, so that what is made of them on the way stays in the cache.
_CHUNK = 8192
_SHARPEST = 1e-6  # m^2, lest a cloud be a point


def chunks(count: int, size: int = 1, most: int = _CHUNK) -> list[slice]:
    """Return slices of rows of a size, of at most so many points: by default a cache's fill."""
    step = max(most // max(size, 1), 1)
    return [slice(first, first + step) for first in range(0, count, step)]


def normalize(log_weights: Array) -> tuple[Array, Array]:
    """
    Return weights (V, N) that sum to 1, and the log of each cloud's total weight (V,).

    A cloud without any weight left gets equal weights and a total of -inf.
    """
    peak = log_weights.max(axis=1, keepdims=True)
    empty = np.isneginf(peak)
    weights = log_weights - np.where(empty, 0, peak)
    np.exp(weights, out=weights)
    total = weights.sum(axis=1, keepdims=True)
    if empty.any():
        weights[empty[:, 0]], total[empty] = 1, log_weights.shape[1]
    weights /= total
    return weights, np.where(empty, peak, np.log(total) + peak)[:, 0]


def effective_sample_size(weights: Array) -> Array:
    """Return 1 / sum w^2 (V,) of normalized weights (V, N)."""
    return np.asarray(1 / np.einsum('vn,vn->v', weights, weights).astype(np.float64))


def coordinates(points: Array) -> Array:
    """Return the coordinates of points (V, N, D) axis by axis in memory: a copy (D, V, N)."""
    return np.moveaxis(points, 2, 0).copy()


def spread(points: Array) -> Array:
    """Return the standard deviation per axis [m] (V,) of clouds of points (V, N, D)."""
    axes = coordinates(points)
    axes -= axes.mean(axis=2, keepdims=True)
    squared = np.einsum('dvn,dvn->v', axes, axes)
    return np.asarray(np.sqrt(squared / squared.dtype.type(math.prod(points.shape[1:]))))


def systematic_resample(weights: Array, count: int, rng: np.random.Generator) -> Array:
    """
    Return indices (V, count) of particles drawn by systematic resampling.

    Every particle is drawn floor or ceil of count * weight times (Kitagawa 1996).
    """
    vehicles, size = weights.shape
    edges = np.cumsum(weights, axis=1, dtype=np.float64)
    edges *= count / edges[:, -1:]
    ticks = np.ceil(edges - rng.random((vehicles, 1))).astype(np.int64)
    np.minimum(np.maximum(ticks, 0, out=ticks), count, out=ticks)
    ticks[:, -1] = count
    ticks[:, 1:] -= ticks[:, :-1]
    particle = np.arange(size)[None].repeat(vehicles, axis=0)
    return particle.ravel().repeat(ticks.ravel()).reshape(vehicles, count)


def z_order(points: Array) -> Array:
    """
    Return indices (V, P) that put points (V, P, D) in the order of a space-filling curve.

    Systematic resampling of points in this order draws neighbours together instead of by chance,
    so that a few particles spread evenly over what they stand for (Gerber, Chopin, Whiteley:
    Negative association, ordering and convergence of resampling methods, 2019). The curve is
    Morton's, with 1024 cells along each axis of each cloud's own box.
    """
    low, high = points.min(axis=1, keepdims=True), points.max(axis=1, keepdims=True)
    cell = ((points - low) / np.maximum(high - low, 1e-9) * 1023).astype(np.int32)
    dimension, number = points.shape[2], np.arange(1024)
    apart = sum(((number >> bit) & 1) << (bit * dimension) for bit in range(10))
    key = sum(np.take(apart, cell[:, :, axis]) << axis for axis in range(dimension))
    return np.argsort(key, axis=1, kind='stable')


def even_resample(points: Array, weights: Array, count: int, rng: np.random.Generator) -> Array:
    """
    Return indices (V, count) of points (V, P, D) resampled systematically in their `z_order`.

    Weights are (V, P).
    """
    order = z_order(points)
    index = systematic_resample(np.take_along_axis(weights, order, axis=1), count, rng)
    return np.take_along_axis(order, index, axis=1)


def best_bandwidth(count: int, dimension: int) -> float:
    """
    Return the width of kernels that best estimate a normal density from so many particles.

    In standard deviations of the cloud; as regularized particle filters spread what they resample
    (Silverman 1986; Musso, Oudjane, Le Gland 2001).
    """
    return float((4 / (count * (dimension + 2))) ** (1 / (dimension + 4)))


def kernel_density(points: Array, kernels: Array, width: Array) -> Array:
    """
    Return the mean of Gaussian kernels at points (V, P, D), (V, P) float32 above 0.

    The kernels stand at (V, S, D) [m] and have peaks of 1 and standard deviations `width` (V,)
    [m]. What is nearly 0 becomes 1e-6 of a kernel, so that ratios of densities stay finite.
    """
    scale = (1 / width)[:, None, None]
    middle = kernels.mean(axis=1, keepdims=True)
    points, kernels = (points - middle) * scale, (kernels - middle) * scale
    exponent = points @ np.swapaxes(kernels, 1, 2)
    exponent -= 0.5 * np.square(points).sum(axis=2)[:, :, None]
    exponent -= 0.5 * np.square(kernels).sum(axis=2)[:, None, :]
    count = kernels.shape[1]
    return np.asarray((np.exp(exponent).sum(axis=2) + np.float32(1e-6)) / count)


def log_cauchy(points: Array, mean: Array, covariance: Array) -> Array:
    """
    Return the log of Cauchy's density at points (V, P, D), (V, P) float32, but for a constant.

    It has a place (V, D) [m] and, in place of a covariance, a scale (V, D, D) [m^2]: Student's t
    with one degree of freedom.
    """
    dimension = points.shape[2]
    away = points - mean[:, None]
    scale = covariance + _SHARPEST * np.eye(dimension)
    squared = np.einsum('vpi,vip->vp', away, np.linalg.solve(scale, np.swapaxes(away, 1, 2)))
    return np.asarray(-(1 + dimension) / 2 * np.log1p(squared), np.float32)


def moments(particles: Array, weights: Array, error: Array | None = None) -> tuple[Array, Array]:
    """
    Return the weighted mean (V, D) [m] and covariance (V, D, D) [m^2], in float64.

    The printed formula (1/N) sum w x of the TS-MCL paper (Sun, Wang, Zhang 2016), with weights
    that sum to 1, divides by N twice; this is sum w x. With an `error` (V,), so much of the
    unweighted cloud's mean square about the mean is added to the covariance.
    """
    vehicles, count, dimension = particles.shape
    mean, covariance = np.zeros((vehicles, dimension)), np.zeros((vehicles, dimension, dimension))
    for rows in chunks(vehicles, count):
        axes, share = coordinates(particles[rows]), weights[rows]
        # Twice, as float32 resolves what is left about a mean far better than the mean.
        rough = np.einsum('vn,dvn->dv', share, axes)
        deviation = axes - rough[:, :, None]
        rest = np.einsum('vn,dvn->dv', share, deviation)
        deviation -= rest[:, :, None]
        share = share.astype(np.float64)
        if error is not None:
            share += (error[rows] / count)[:, None]
        # Half of the weights on either side, so that a flat cloud's is not negative by rounding.
        halves = deviation * np.sqrt(share)
        mean[rows] = (rough.astype(np.float64) + rest).T
        np.einsum('ivn,jvn->vij', halves, halves, out=covariance[rows])
    return mean, covariance
