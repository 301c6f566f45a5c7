"""
The positions that evidence is about, and how numbers of theirs are laid out against points.

All is laid out (V, E, P), references before points, so that sums over references run along
contiguous memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types import Array


@dataclass(frozen=True, eq=False)
class References:
    """
    The positions that a factor's evidence is about.

    Attributes
    ----------
    position : (D, V, E, 1) float32
        [m].
    covariance : (D, D, V, E, 1) float32 or None
        [m^2]; None if all are exactly known.
    least : (V, E, 1) float32 or None
        The smallest variance along any line of sight [m^2].

    """

    position: Array
    covariance: Array | None
    least: Array | None

    @classmethod
    def lay_out(cls, position: Array, covariance: Array) -> References:
        """Lay out positions (V, E, D) and covariances (V, E, D, D) against points."""
        position = np.asarray(position, np.float32).transpose(2, 1, 0).copy()
        position = np.swapaxes(position, 1, 2)[..., None]
        if not covariance.any():
            return cls(position, None, None)
        # A hair less, so that rounding cannot find a direction with less variance.
        least = np.maximum(0.999 * np.linalg.eigvalsh(covariance)[:, :, :1], 0)
        return cls(position, np.moveaxis(covariance, (2, 3), (0, 1))[..., None],
                   least.astype(np.float32))

    def distance(self, points: Array) -> tuple[Array, Array | None]:
        """
        Return the mean distances (V, E, P) [m] of points (V, P, D), and what is uncertain of them.

        The second value is their variance (V, E, P) [m^2], or None if all references are exactly
        known. Along the line of sight a reference's variance is u^T S u; what it has across, a,
        makes distances sqrt(d^2 + a) on average, to second order, and spreads them by
        a^2 / (2 d^2).
        """
        # Contiguous coordinates, as each is read once a reference.
        delta = [np.ascontiguousarray(points[:, None, :, axis]) - position
                 for axis, position in enumerate(self.position)]
        known = self.covariance is None
        squared = np.square(delta[0], out=delta[0] if known else None)
        for axis in delta[1:]:
            squared += np.square(axis, out=axis if known else None)
        if known:
            return np.sqrt(squared, out=squared), None
        across, variance = self.uncertainty(delta, squared)
        return np.sqrt(squared + across), variance

    def uncertainty(self, sight: Sequence[Array], squared: Array) -> tuple[Array, Array]:
        """
        Return the references' variance across lines of sight, and that of distances [m^2].

        Parameters
        ----------
        sight : D arrays (V, E, P)
            From the references [m].
        squared : array that broadcasts to (V, E, P)
            Their lengths, squared [m^2].

        """
        covariance, axes = self.covariance, range(len(sight))
        assert covariance is not None
        # Symmetric: what is beside the diagonal counts twice.
        along = sum(sight[i] * sum((1 + (i < j)) * covariance[i, j] * sight[j] for j in axes[i:])
                    for i in axes)
        along = along / np.maximum(squared, np.float32(1e-6))
        across = np.maximum(sum(covariance[i, i] for i in axes) - along, 0)
        # In three dimensions it is spread over two directions.
        spread = across * across / (
            2 * (len(axes) - 1) * np.maximum(squared + across, np.float32(1e-6)))
        return across, np.asarray(along + spread)

    def at(self, vehicle: Array | slice) -> References:
        """Return the references for other points: see `Factor`."""
        return References(
            flat(self.position, vehicle),
            None if self.covariance is None else flat(self.covariance, vehicle),
            None if self.least is None else flat(self.least, vehicle),
        )


def flat(column: Array, vehicle: Array | slice) -> Array:
    """
    Lay out columns (..., V, E, 1) for other points.

    For a flat list of points of M vehicles they become (..., 1, E, M); a slice of the vehicles
    leaves them columns.
    """
    if isinstance(vehicle, slice):
        return column[..., vehicle, :, :]
    # By rows of references, so that what is made of them is contiguous.
    rows = np.ascontiguousarray(np.swapaxes(column[..., 0], -1, -2))
    return rows.take(vehicle, axis=-1, mode='clip')[..., None, :, :]


def column(values: Array) -> Array:
    """
    Lay out per-reference values (V, E) against points: (V, E, 1) float32.

    One reference's values lie together in memory, as `flat` takes them.
    """
    return np.asarray(values, np.float32, order='F')[:, :, None]
