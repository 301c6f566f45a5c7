"""Regions: the intersection of boxes."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array


def intersect_boxes(position: Array, reach: Array, rows: Array) -> Array:
    """
    Intersect the boxes position +- reach (V, K, D) [m] of the rows used (V, K).

    Where they contradict each other the smallest one is taken; where none is bounded, the box
    around the references themselves, grown by its own size.
    """
    if not rows.shape[1]:
        return np.zeros((rows.shape[0], 2, position.shape[2]), np.float32)
    used = rows[:, :, None]
    low = np.where(used, position - reach, -np.inf).max(axis=1)
    high = np.where(used, position + reach, np.inf).min(axis=1)
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
