"""
Gaussian beliefs of a fleet: where ranges place it, how it moves, what a measurement changes.

Shapes: mean (V, n), covariance (V, n, n); a state's first D components are the position.
Measurements are scalars, taken in one after the other. Functions return new arrays, in float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy
from tsmcl_ros.model.motion import VelocityMotion
from tsmcl_ros.types import Array

# Gauss-Newton steps; from the linear solution three reach the rounding of float32 positions.
_STEPS = 5
# The linear solution is the vehicle's and not its mirror image behind the anchors' plane if it is
# this many standard deviations off that plane, or all but that plane's neighbourhood is excluded.
_SIDE = 4.0
_NEAR = 0.05  # of the ranges
# No range surprises by more standard deviations: some that agree are believed, one is not.
_WILD = 4.0


class Fix(NamedTuple):
    """
    Positions of V vehicles from ranges alone.

    Attributes
    ----------
    position, covariance : (V, D), (V, D, D) float64
        [m, m^2]; of no meaning where not solved.
    misfit : (V,) float64
        Sum of the squared normalized residuals.
    solved : (V,) bool
        False where there are less than D + 1 ranges, or the anchors lie so nearly on one line (in
        space: in one plane) that a mirror image would fit as well.

    """

    position: Array
    covariance: Array
    misfit: Array
    solved: Array


def multilaterate(reference: Array, distance: Array, variance: Array, used: Array) -> Fix:
    """
    Locate V vehicles by linearised least squares, polished by Gauss-Newton steps.

    Gao, Wang, Shen (mobile underwater acoustic networks): rows 2 (X_i - X_M)^T, right-hand side
    |X_i|^2 - |X_M|^2 - d_i^2 + d_M^2. Their errors share that of d_M; weighing them by their full
    covariance comes to the same as subtracting the weighted mean of all rows, as is done here.

    Parameters
    ----------
    reference : (V, K, D) float
        [m].
    distance, variance : (V, K) float
        Measured distances [m, m^2].
    used : (V, K) bool
        The rows that count.

    """
    vehicles, rows, dimension = reference.shape
    used = used & np.isfinite(distance) & (variance > 0)
    enough = used.sum(axis=1) > dimension
    if not enough.any():
        return Fix(np.zeros((vehicles, dimension)), np.zeros((vehicles, dimension, dimension)),
                   np.zeros(vehicles), enough)
    reference = np.where(used[:, :, None], reference, 0).astype(np.float64)
    distance = np.where(used, np.maximum(distance, 0), 0).astype(np.float64)
    variance = np.where(used, variance, 1).astype(np.float64)
    weight = used / (4 * distance ** 2 * variance + 2 * variance ** 2)
    share = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    centre = np.einsum('vk,vkd->vd', share, reference)
    design = 2 * np.where(used[:, :, None], reference - centre[:, None], 0)
    rest = np.square(reference - centre[:, None]).sum(axis=2) - distance ** 2
    rest = np.where(used, rest - (share * rest).sum(axis=1, keepdims=True), 0)
    information = np.einsum('vk,vki,vkj->vij', weight, design, design)
    scale, axes = np.linalg.eigh(information)
    enough &= scale[:, 0] > 1e-12 * np.maximum(scale[:, -1], 1e-300)
    inverse = np.where(enough[:, None], 1 / np.where(enough[:, None], scale, 1), 0)
    along = np.einsum('vij,vi->vj', axes, np.einsum('vk,vki,vk->vi', weight, design, rest))
    offset = inverse * along  # from the centre, along the axes, the least certain one first
    typical = np.sqrt((share * distance ** 2).sum(axis=1))
    solved = enough & (np.sqrt(inverse[:, 0]) < np.maximum(
        np.abs(offset[:, 0]) / _SIDE, _NEAR * typical))
    position = centre + np.einsum('vij,vj->vi', axes, offset)
    return _polish(position, reference, distance, used / variance, solved)


def _polish(position: Array, reference: Array, distance: Array, weight: Array, solved: Array
            ) -> Fix:
    """Return the weighted nonlinear least squares solution near a position (V, D) [m]."""
    identity = np.eye(position.shape[1])
    for _ in range(_STEPS):
        sight = position[:, None] - reference
        length = np.maximum(np.linalg.norm(sight, axis=2), 1e-9)
        sight /= length[:, :, None]
        information = np.einsum('vk,vki,vkj->vij', weight, sight, sight)
        solved = solved & (np.linalg.cond(information) < 1e12)
        information = np.where(solved[:, None, None], information, identity)
        slope = np.einsum('vk,vki,vk->vi', weight, sight, distance - length)
        position = position + np.linalg.solve(information, slope[:, :, None])[:, :, 0]
    residual = distance - np.linalg.norm(position[:, None] - reference, axis=2)
    misfit = (weight * residual ** 2).sum(axis=1)
    return Fix(position, np.linalg.inv(information), misfit, solved)


def constant_velocity(motion: VelocityMotion, elapsed: float) -> tuple[Array, Array]:
    """
    Return transition F and noise Q (2 D, 2 D) of [position, velocity] over a time [s].

    Exact however long it is; with `speed_decay` the velocity is an Ornstein-Uhlenbeck process.
    """
    keep, path, change, along, across = motion.transition(elapsed)
    axes = np.eye(motion.extra)
    noise = [[along ** 2 + across ** 2, along * change], [along * change, change ** 2]]
    return np.kron([[1.0, path], [0.0, keep]], axes), np.kron(noise, axes)


def predict(mean: Array, covariance: Array, transition: Array, noise: Array
            ) -> tuple[Array, Array]:
    """Return mean and covariance after x' = F x + N(0, Q); F and Q are (n, n) or (V, n, n)."""
    return (np.einsum('...ij,...j->...i', transition, mean),
            transition @ covariance @ np.swapaxes(transition, -1, -2) + noise)


def update(mean: Array, covariance: Array, gradient: Array, residual: Array, variance: Array,
           trust: Array | float = 1.0) -> tuple[Array, Array]:
    """
    Return mean and covariance after one scalar measurement each, in Joseph form.

    Parameters
    ----------
    mean, covariance : (V, n), (V, n, n) float
        The belief before.
    gradient : (V, n) float
        Of the measurement at the mean, H.
    residual : (V,) float
        Measured minus expected.
    variance : (V,) float
        Of the measurement's noise, R; infinite where there is no measurement.
    trust : (V,) float
        Probability that the measurement is sound. The outcome has the moments of the mixture of
        both beliefs (probabilistic data association, Bar-Shalom and Tse 1975).

    """
    cross = np.einsum('vij,vj->vi', covariance, gradient)
    gain = cross / innovation_variance(covariance, gradient, variance)[:, None]
    noise = np.where(np.isfinite(variance), variance, 0)[:, None, None]
    outer = gain[:, :, None] * gain[:, None, :]
    left = np.eye(mean.shape[1]) - gain[:, :, None] * gradient[:, None, :]
    updated = left @ covariance @ np.swapaxes(left, 1, 2) + noise * outer
    trust = np.broadcast_to(trust, residual.shape)[:, None, None]
    spread = trust * (1 - trust) * np.square(residual)[:, None, None]
    return (mean + trust[:, :, 0] * gain * residual[:, None],
            trust * updated + (1 - trust) * covariance + spread * outer)


def mixed(trust: Array, first: tuple[Array, Array], second: tuple[Array, Array]
          ) -> tuple[Array, Array]:
    """Return mean (V, n) and covariance (V, n, n) of two beliefs, the first with a trust (V,)."""
    apart = first[0] - second[0]
    trust = trust[:, None]
    spread = (trust * (1 - trust) * apart)[:, :, None] * apart[:, None, :]
    share = trust[:, :, None]
    return (second[0] + trust * apart,
            share * first[1] + (1 - share) * second[1] + spread)


def update_by_bound(mean: Array, covariance: Array, gradient: Array, excess: Array,
                    variance: Array) -> tuple[Array, Array, Array]:
    """
    Return mean and covariance after learning that a noisy quantity is positive.

    The likelihood Phi(excess / std) turns a Gaussian into one with the same moments as the exact
    posterior (assumed density filtering, Minka 2001). A bound that was clear before changes
    nothing.

    Parameters
    ----------
    mean, covariance : (V, n), (V, n, n) float
        The belief before.
    gradient : (V, n) float
        Of the quantity at the mean.
    excess : (V,) float
        Its expected value; infinite where there is no bound.
    variance : (V,) float
        Of its noise.

    Returns
    -------
    mean, covariance
    log_likelihood : (V,) float
        Of the bound under the belief before.

    """
    cross = np.einsum('vij,vj->vi', covariance, gradient)
    std = np.sqrt(innovation_variance(covariance, gradient, variance))
    z = np.clip(excess / std, -1e6, 1e6)
    log_likelihood = scipy.special.log_ndtr(z)
    ratio = np.exp(-z * z / 2 - log_likelihood) / np.sqrt(2 * np.pi)
    far = z < -1e3  # where the difference of squares cancels
    ratio = np.where(far, -z, ratio)
    lost = np.where(far, 1, np.clip(ratio * (ratio + z), 0, 1))
    gain = cross / std[:, None]
    return (mean + ratio[:, None] * gain,
            covariance - lost[:, None, None] * gain[:, :, None] * gain[:, None, :],
            log_likelihood)


def innovation_variance(covariance: Array, gradient: Array, variance: Array) -> Array:
    """Return H P H^T + R (V,)."""
    return np.asarray(np.einsum('vi,vij,vj->v', gradient, covariance, gradient) + variance)


def surprise(position: Array, covariance: Array, reference: Array, distance: Array,
             variance: Array, used: Array) -> Array:
    """
    Return by how much ranges contradict where vehicles were expected to be, from 0 on.

    It is d^2 / 2 with the Mahalanobis distance d from the expected position to the one that the
    ranges tell: minus the log of the expected one's likelihood, relative to its peak. Under a
    right prediction 2 * surprise has a chi-square distribution of as many degrees of freedom as
    directions are told, whatever the number of ranges and their noise.

    Parameters
    ----------
    position, covariance : (V, D), (V, D, D) float
        As predicted [m, m^2].
    reference : (V, K, D) float
        [m].
    distance, variance : (V, K) float
        Measured distances [m, m^2].
    used : (V, K) bool
        The rows that count.

    """
    delta = position[:, None] - reference
    expected = np.linalg.norm(delta, axis=2)
    sight = delta / np.maximum(expected, 1e-9)[:, :, None]
    limit = _WILD * np.sqrt(variance + np.einsum('vki,vij,vkj->vk', sight, covariance, sight))
    innovation = np.clip(distance - expected, -limit, limit)
    weight = np.where(used, 1 / variance, 0)
    told = np.einsum('vk,vki,vk->vi', weight, sight, np.where(used, innovation, 0))
    information = np.einsum('vk,vki,vkj->vij', weight, sight, sight)
    # Less than D ranges leave a direction untold: hence no inverse of the information.
    spread = np.linalg.pinv(information + information @ covariance @ information, hermitian=True)
    return np.asarray(np.maximum(np.einsum('vi,vij,vj->v', told, spread, told) / 2, 0))


def range_to(position: Array, covariance: Array, reference: Array
             ) -> tuple[Array, Array, Array]:
    """
    Return what a distance to a reference is expected to be, to second order.

    A position uncertain across the line of sight is on average further away than its mean, and
    how much so is uncertain: without these terms a broad belief would take itself for precise.

    Parameters
    ----------
    position, covariance : (V, D), (V, D, D) float
        The belief [m, m^2]; a covariance of zero gives the plain distance and its gradient.
    reference : (V, D) float
        [m].

    Returns
    -------
    expected : (V,) float
        [m].
    gradient : (V, D) float
        The unit vector from the reference, shortened where second order matters; 0 at the
        reference itself.
    variance : (V,) float
        Of the second-order terms [m^2].

    """
    delta = position - reference
    squared = np.square(delta).sum(axis=1)
    sight = delta / np.sqrt(np.maximum(squared, 1e-18))[:, None]
    across = np.eye(delta.shape[1]) - sight[:, :, None] * sight[:, None, :]
    spread = across @ covariance @ across
    expected = np.sqrt(squared + np.trace(spread, axis1=1, axis2=2))
    floored = np.maximum(expected, 1e-9)
    variance = np.square(spread).sum(axis=(1, 2)) / (2 * floored ** 2)
    return expected, delta / floored[:, None], variance


def azimuth_of(position: Array, station: Array) -> tuple[Array, Array]:
    """
    Return the azimuth of a position as seen from a station, and its gradient.

    Zhuo et al.: theta = atan2(y - y_s, x - x_s), H = [-dy / d^2, dx / d^2].

    Parameters
    ----------
    position, station : (V, D) float
        [m]; heights do not count.

    Returns
    -------
    azimuth : (V,) float
        [rad], from -pi to pi.
    gradient : (V, D) float
        [rad/m]; 0 at the station itself, where there is no azimuth.

    """
    delta = position - station
    x, y = delta[:, 0], delta[:, 1]
    squared = x * x + y * y
    inverse = np.where(squared > 1e-18, 1 / np.maximum(squared, 1e-18), 0)
    gradient = np.zeros(delta.shape)
    gradient[:, 0], gradient[:, 1] = -y * inverse, x * inverse
    return np.arctan2(y, x), gradient
