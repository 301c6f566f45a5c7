"""Sampling: numbers that fill a box more evenly than random ones, and subsets of rows."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array

# The steps of the additive recurrence that leaves the smallest gaps in 2 and 3 dimensions: powers
# of 1/g, g^(D+1) = g + 1, the golden ratio's kin (Roberts 2018).
_RECURRENCE = {2: (0.7548776662466927, 0.5698402909980532),
               3: (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)}


def even_shares(number: Array, vehicles: int, dimension: int, rng: np.random.Generator) -> Array:
    """
    Return points (V, P, D) float32 in [0, 1) that fill each vehicle's unit box evenly.

    They are terms of an additive recurrence, those with these numbers (P,), with a random shift
    that makes each of them uniform on its own (Cranley and Patterson 1976).
    """
    even = ((number[:, None] * np.asarray(_RECURRENCE[dimension])) % 1).astype(np.float32)
    shift = rng.random((vehicles, 1, dimension), np.float32)
    # Axis by axis in memory, as they are used.
    points = even.T[:, None] + np.moveaxis(shift, 2, 0)
    points -= np.floor(points)
    return np.moveaxis(points, 0, 2)


def subsets(rows: Array, size: int, count: int) -> Array:
    """
    Return random subsets of rows, always the same ones, so that nothing random depends on them.

    Parameters
    ----------
    rows : (V, K) bool
        At least `size` of each vehicle, and K above it.
    size, count : int
        Of how many rows each, and how many.

    Returns
    -------
    (V, count, K) bool

    """
    order = np.random.default_rng(0).random((count, rows.shape[1]))
    order = np.where(rows[:, None], order, np.inf)
    chosen = np.zeros(order.shape, bool)
    np.put_along_axis(chosen, np.argpartition(order, size, axis=2)[:, :, :size], True, axis=2)
    return chosen
