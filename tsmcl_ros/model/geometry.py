"""Regions: boxes around references, and their intersection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types import Array


@dataclass(frozen=True, eq=False)
class Reach:
    """
    How far from its K references an observation leaves V vehicles.

    Attributes
    ----------
    position : (V, K, D) float32
        Of the references [m].
    rows : (V, K) bool
        False where padded.
    presence, measured : (V, K, D) float
        By being heard, and by what was measured, along each axis [m]; inf where nothing says so.
    """

    position: Array
    rows: Array
    presence: Array
    measured: Array

    def box(self) -> Array:
        """Return boxes (V, 2, D) [m] that hold all likely positions; see `intersect_boxes`."""
        return intersect_boxes(
            self.position, np.minimum(self.presence, self.measured), self.rows)

    def anchor_box(self) -> tuple[Array, Array]:
        """Return the corners (V, D) [m] of what being heard leaves, be it unbounded or empty."""
        return _corners(self.position, self.presence, self.rows)

    def nearest(self, first: int, count: int) -> tuple[Array, Array]:
        """
        Return the corners (V, D) [m] of what some references leave of the anchor box.

        These are, of those in order of how near they were measured, `count` from `first` on.
        """
        reach = np.where(self.rows, self.measured.max(axis=2), np.inf)
        order = np.argsort(reach, axis=1, kind='stable')[:, first:first + count]
        chosen = np.zeros(self.rows.shape, bool)
        np.put_along_axis(chosen, order, True, axis=1)
        measured = np.where(chosen[:, :, None], self.measured, np.inf)
        return _corners(self.position, np.minimum(self.presence, measured), self.rows)


def intersect_boxes(position: Array, reach: Array, rows: Array) -> Array:
    """
    Intersect the boxes position +- reach (V, K, D) [m] of the rows used (V, K).

    Where they contradict each other the smallest one is taken; where none is bounded, the box
    around the references themselves, grown by its own size.
    """
    if not rows.shape[1]:
        return np.zeros((rows.shape[0], 2, position.shape[2]), np.float32)
    used = rows[:, :, None]
    low, high = _corners(position, reach, rows)
    smallest = np.where(used, reach, np.inf).min(axis=2).argmin(axis=1)
    single = np.arange(len(rows)), smallest
    empty = (low > high).any(axis=1, keepdims=True)
    low = np.where(empty, position[single] - reach[single], low)
    high = np.where(empty, position[single] + reach[single], high)
    outer_low = np.where(used, position, np.inf).min(axis=1)
    outer_high = np.where(used, position, -np.inf).max(axis=1)
    size = np.maximum((outer_high - outer_low).max(axis=1, keepdims=True), 1)
    unbounded = ~(np.isfinite(low) & np.isfinite(high)).all(axis=1, keepdims=True)
    low = np.where(unbounded, outer_low - size, low)
    high = np.where(unbounded, outer_high + size, high)
    box = np.stack([low, high], axis=1)
    return np.where(rows.any(axis=1)[:, None, None], box, 0).astype(np.float32)


def _corners(position: Array, reach: Array, rows: Array) -> tuple[Array, Array]:
    """Return the lower and upper corners (V, D) [m] of the boxes' intersection, if it is one."""
    used = rows[:, :, None]
    low = np.where(used, position - reach, -np.inf).max(axis=1, initial=-np.inf)
    high = np.where(used, position + reach, np.inf).min(axis=1, initial=np.inf)
    return low, high
