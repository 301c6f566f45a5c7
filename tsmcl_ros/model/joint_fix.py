"""
Where vehicles are and what their ranges are like, from the ranges of one epoch at once.

Ranges whose scale is off contradict each other wherever the vehicle is supposed to be, as lies do.
So scale and offset are unknowns beside the position, and which ranges agree on all of them is
looked for as RANSAC does (Fischler and Bolles 1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.sampling import subsets
from tsmcl_ros.types import Array

_HYPOTHESES = 60
# Gauss-Newton steps; ranges off by a tenth at first take three more than exact ones.
_STEPS = 6
# Standard deviations that a range is off by at most if it agrees.
_LIMIT = 3.0
# Share of each unknown's information that is added, so that there always is a solution.
_DAMPING = 1e-9
# Ranges beyond their references, as the longest of them is, that nobody is further away than.
_BEYOND = 2.0


class JointFix(NamedTuple):
    """
    What the ranges of V vehicles tell of both.

    Attributes
    ----------
    mean, covariance : (V, D + 2), (V, D + 2, D + 2) float64
        Of position [m], scale and offset [m]; of no meaning where not solved.
    solved : (V,) bool
        Where D + 3 ranges and more, the majority, agree on one solution and on no other, nor on
        its mirror image.

    """

    mean: Array
    covariance: Array
    solved: Array


def joint_fix(reference: Array, measured: Array, variance: Array, used: Array,
              known: tuple[Array, Array]) -> JointFix:
    """
    Locate V vehicles by ranges that may be lies, and calibrate these.

    Parameters
    ----------
    reference : (V, K, D) float
        [m].
    measured, variance : (V, K) float
        Ranges, scale * distance + offset + noise, and the variance of the noise [m, m^2].
    used : (V, K) bool
        The rows that count, at least D + 3 of each vehicle.
    known : (V, 2) and (V, 2, 2) float
        Mean and covariance of scale and offset, as far as they are known already.

    """
    size = reference.shape[2]
    data = _Ranges(
        np.where(used[:, :, None], reference, 0).astype(np.float64),
        np.where(used, measured, 0).astype(np.float64),
        np.where(used, 1 / variance, 0).astype(np.float64), *known)
    begin, agreed, alone = _majority(data, used)
    mean, covariance, _, sound = data.fit(begin, agreed)
    image, _, _, mirrored = data.fit(_mirrored(mean, data.reference, agreed), agreed)
    apart = np.linalg.norm(image - mean, axis=1) > 2 * _LIMIT * np.sqrt(
        np.trace(covariance, axis1=1, axis2=2))
    enough = agreed.sum(axis=1) > np.maximum(size + 2, used.sum(axis=1) / 2)
    return JointFix(mean, covariance, sound & alone & enough & ~(mirrored & apart))


@dataclass(frozen=True, eq=False)
class _Ranges:
    """
    Ranges of V vehicles to K references each, and what is known of scale and offset.

    Those that do not count have a weight, 1 / variance, of 0.
    """

    reference: Array
    measured: Array
    weight: Array
    known: Array
    spread: Array

    def repeated(self, count: int) -> _Ranges:
        """Return those of as many hypotheses for each vehicle, (V * count, ...)."""
        return _Ranges(*(np.repeat(part, count, axis=0) for part in (
            self.reference, self.measured, self.weight, self.known, self.spread)))

    def start(self, taken: Array) -> tuple[Array, Array]:
        """Return where to begin by the ranges (V, K) bool that are taken, and if (V,) they do."""
        offset, scale = self.known[:, 1:], self.known[:, :1]
        variance = 1 / np.where(taken, self.weight, 1) / scale ** 2
        fix = gaussian.multilaterate(
            self.reference, (self.measured - offset) / scale, variance, taken)
        return np.concatenate([fix.position, self.known], axis=1), fix.solved

    def fit(self, mean: Array, taken: Array) -> tuple[Array, Array, Array, Array]:
        """
        Return mean and covariance by Gauss-Newton steps from a mean (V, D + 2).

        The third value is by how many standard deviations all the ranges (V, K) are off, the
        fourth whether (V,) those that were taken, and what is known, agree with each other.
        """
        size = self.reference.shape[2]
        prior = np.zeros((len(mean), size + 2, size + 2))
        prior[:, size:, size:] = np.linalg.inv(self.spread)
        used = self.weight * taken
        furthest = _BEYOND * self.measured.max(axis=1, keepdims=True)
        low, high = self.reference.min(axis=1) - furthest, self.reference.max(axis=1) + furthest
        for _ in range(_STEPS):
            residual, design = self.expected(mean)
            covariance = _inverse(prior + np.einsum('vk,vki,vkj->vij', used, design, design))
            slope = np.einsum('vk,vki,vk->vi', used, design, residual)
            slope[:, size:] += np.einsum(
                'vij,vj->vi', prior[:, size:, size:], self.known - mean[:, size:])
            mean = mean + np.einsum('vij,vj->vi', covariance, slope)
            mean[:, :size] = np.clip(mean[:, :size], low, high)
        residual, design = self.expected(mean)
        # What was taken has told the mean, and may be off by its noise alone.
        uncertain = np.where(taken, 0, self.weight * np.einsum(
            'vki,vij,vkj->vk', design, covariance, design))
        off = residual * np.sqrt(self.weight / (1 + uncertain))
        apart = self.known - mean[:, size:]
        likely = np.einsum('vi,vij,vj->v', apart, prior[:, size:, size:], apart) < _LIMIT ** 2
        return mean, covariance, off, likely & ((np.abs(off) < _LIMIT) | ~taken).all(axis=1)

    def expected(self, mean: Array) -> tuple[Array, Array]:
        """Return what ranges are off (V, K) [m], and their gradients by the mean."""
        size = self.reference.shape[2]
        sight = mean[:, None, :size] - self.reference
        length = np.maximum(np.linalg.norm(sight, axis=2), 1e-9)
        scale, offset = mean[:, size, None], mean[:, size + 1, None]
        design = np.concatenate([
            (scale / length)[:, :, None] * sight, length[:, :, None],
            np.ones((*length.shape, 1))], axis=2)
        return self.measured - scale * length - offset, design


def _majority(data: _Ranges, used: Array) -> tuple[Array, Array, Array]:
    """
    Return the mean (V, D + 2) that most of the ranges agree on, and which (V, K) bool do.

    The third value is whether (V,) there is no other one that as many agree on.
    """
    vehicles, rows = used.shape
    some = subsets(used, data.reference.shape[2] + 2, _HYPOTHESES)
    taken = np.concatenate([used[:, None], some], axis=1).reshape(-1, rows)
    count = _HYPOTHESES + 1
    several = data.repeated(count)
    mean, sound = several.start(taken)
    for _ in range(2):
        mean, _, off, fits = several.fit(mean, taken)
        sound = sound & fits
        taken = (several.weight > 0) & (np.abs(off) < _LIMIT) & sound[:, None]
    agreeing = taken.reshape(vehicles, count, rows)
    number = agreeing.sum(axis=2)
    best = np.arange(vehicles), number.argmax(axis=1)
    agreed = agreeing[best]
    alike = (agreeing == agreed[:, None]).all(axis=2) | (number < number[best][:, None])
    return mean.reshape(vehicles, count, -1)[best], agreed, alike.all(axis=1)


def _mirrored(mean: Array, reference: Array, taken: Array) -> Array:
    """Return means with positions behind the line or plane that references nearly lie in."""
    size = reference.shape[2]
    number = np.maximum(taken.sum(axis=1), 1)[:, None]
    centre = (reference * taken[:, :, None]).sum(axis=1) / number
    off = (reference - centre[:, None]) * taken[:, :, None]
    across = np.linalg.eigh(np.einsum('vki,vkj->vij', off, off))[1][:, :, 0]
    height = ((mean[:, :size] - centre) * across).sum(axis=1, keepdims=True)
    return np.concatenate([mean[:, :size] - 2 * height * across, mean[:, size:]], axis=1)


def _inverse(information: Array) -> Array:
    """Return the covariances (V, n, n) of these, damped a little."""
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-12))
    outer = scale[:, :, None] * scale[:, None, :]
    damped = information / outer + _DAMPING * np.eye(scale.shape[1])
    return np.asarray(np.linalg.inv(damped) / outer)
