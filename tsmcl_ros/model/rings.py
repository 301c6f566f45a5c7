"""Positions around references at measured ranges: drawn in arcs, and the density of that."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.geometry import Arcs
from tsmcl_ros.model.ranging import Ranging
from tsmcl_ros.types import Array


@dataclass(frozen=True, eq=False)
class Rings:
    """
    Rings, or sectors of them, around the K references that V vehicles have ranges to.

    Attributes
    ----------
    ranging : Ranging
        The ranges and their error law, in two dimensions.
    arcs : Arcs
        Directions (V, K) from each reference.

    """

    ranging: Ranging
    arcs: Arcs

    @property
    def used(self) -> Array:
        """(V, K) bool: True where there is a range."""
        return np.asarray(self.ranging.used[:, :, 0])

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """
        Return positions around every reference, and their directions from it.

        Directions are uniform in the arcs, distances the range plus an error of its law plus
        what the reference's own covariance makes of them.

        Returns
        -------
        points : (V, K, count, 2) float32
            [m].
        direction : (V, K, count) float32
            [rad].

        """
        references, ranging = self.ranging.references, self.ranging
        direction = self.arcs.draw(count, rng)
        sight = np.stack([np.cos(direction), np.sin(direction)])
        distance = ranging.indicated + ranging.errors.draw(count, rng)
        if references.covariance is not None:
            across, variance = references.uncertainty(
                ranging.indicated * sight, np.square(ranging.indicated))
            distance = distance + np.sqrt(variance) * rng.standard_normal(
                distance.shape, np.float32)
            # What is indicated is the mean distance; see `References.distance`.
            distance = np.sqrt(np.abs(distance * distance - across))
        points = references.position + np.abs(distance) * sight
        return np.moveaxis(points, 0, -1).astype(np.float32), direction

    def log_density(self, points: Array, distance: Array, log_ranging: Array) -> Array:
        """
        Return ln of the density (V, P) [1/m^2] that `draw` gives points (V, P, 2) [m].

        Parameters
        ----------
        points : (V, P, 2) float32
            [m].
        distance : (V, K, P) float32
            Of them, as `References.distance` has it [m].
        log_ranging : (V, K, P) float32
            ln p of the ranges at them, as `Ranging.log_density` has it.

        """
        half = self.arcs.half[:, :, None]
        x, y = (points[:, None, :, axis] - position
                for axis, position in enumerate(self.ranging.references.position))
        cos, sin = (turn(self.arcs.middle)[:, :, None] for turn in (np.cos, np.sin))
        ahead = x * cos + y * sin
        ahead += np.sqrt(x * x + y * y)
        aside = np.abs(y * cos - x * sin)
        # The tangents of half the angles, aside / ahead, which cost less than the angles. A hair
        # more, so that rounding cannot put a sample outside of its own arc.
        widest = np.tan(np.minimum(half * np.float32(0.5005) + np.float32(1e-6), np.pi / 2 - 1e-3))
        inside = (aside <= widest * ahead) | (half > np.float32(np.pi - 2e-3))
        density = np.exp(log_ranging) / (2 * half * np.maximum(distance, np.float32(1e-3)))
        density = np.where(inside & self.ranging.used, density, 0)
        count = np.maximum(self.used.sum(axis=1), 1)[:, None]
        return np.asarray(np.log(density.sum(axis=1) / count + np.float32(1e-30)))
