"""Densities of particle clouds: mixtures of Gaussian kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.particles import moments, systematic_resample
from tsmcl_ros.types import Array

_CENTRES = 200  # more say hardly more of a cloud, and cost as much as they are


@dataclass(frozen=True, eq=False)
class CloudDensity:
    """
    Kernel densities of V clouds that keep their mean and covariance.

    Kernels have the cloud's covariance, scaled by the rule of thumb (Silverman 1986); their
    centres are drawn towards the mean by as much as the kernels widen (Liu and West 2001).

    Attributes
    ----------
    mean : (V, 1, D) float32
        [m].
    whitening : (V, D, D) float32
        Turns offsets from the mean into kernel widths.
    centres : (V, C, D) float32
        Whitened.
    parents : (V, C) int
        The particles that the centres come from.

    """

    mean: Array
    whitening: Array
    centres: Array
    parents: Array

    @classmethod
    def of(cls, particles: Array, weights: Array, rng: np.random.Generator) -> CloudDensity:
        """Return the densities of particles (V, N, D) [m] of weights (V, N)."""
        count, dimension = min(particles.shape[1], _CENTRES), particles.shape[2]
        mean, covariance = moments(particles, weights)
        scale = (4 / (count * (dimension + 2))) ** (2 / (dimension + 4))
        # A millimetre, so that a cloud of copies has a density as well, and what rounding takes.
        least = 1e-6 + 1e-9 * np.trace(covariance, axis1=1, axis2=2)
        widths = np.linalg.cholesky(
            scale * covariance + least[:, None, None] * np.eye(dimension))
        whitening = np.swapaxes(np.linalg.inv(widths), 1, 2).astype(np.float32)
        parents = systematic_resample(weights, count, rng)
        chosen = np.take_along_axis(particles, parents[:, :, None], axis=1)
        mean = mean[:, None].astype(np.float32)
        centres = (np.float32(np.sqrt(max(1 - scale, 0))) * (chosen - mean)) @ whitening
        return cls(mean, whitening, centres, parents)

    def log_density(self, points: Array) -> tuple[Array, Array]:
        """
        Return ln of the density [1/m^D] at points, and the particle that each is nearest to.

        Parameters
        ----------
        points : (V, P, D) float32
            [m].

        Returns
        -------
        log_density, parent : (V, P)

        """
        white = (points - self.mean) @ self.whitening
        half = (np.square(white).sum(axis=2)[:, :, None] / 2
                + np.square(self.centres).sum(axis=2)[:, None] / 2
                - white @ np.swapaxes(self.centres, 1, 2))
        nearest = half.argmin(axis=2)
        least = np.take_along_axis(half, nearest[:, :, None], axis=2)
        total = np.exp(least - half).mean(axis=2)
        _, volume = np.linalg.slogdet(self.whitening)
        peak = volume - points.shape[2] / 2 * np.log(2 * np.pi)
        log_density = np.log(total) - least[:, :, 0] + peak[:, None]
        return log_density, np.take_along_axis(self.parents, nearest, axis=1)
