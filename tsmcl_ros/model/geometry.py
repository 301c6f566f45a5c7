"""Regions: boxes around references and their intersection, arcs of directions."""

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


@dataclass(frozen=True, eq=False)
class Arcs:
    """
    Circular arcs of directions.

    Attributes
    ----------
    middle, half : float32 arrays of one shape
        Direction of the middle and half of the width [rad]; a half of pi is the whole circle.

    """

    middle: Array
    half: Array

    @classmethod
    def circles(cls, shape: tuple[int, ...]) -> Arcs:
        """Return arcs of all directions."""
        return cls(np.zeros(shape, np.float32), np.full(shape, np.pi, np.float32))

    @classmethod
    def cover(cls, direction: Array, kept: Array) -> Arcs:
        """
        Return the smallest arcs (...) that cover those kept of directions (..., M) [rad].

        Unlike an interval [min, max], an arc does not break across 0 and 2 pi. At least one
        direction of each has to be kept.
        """
        some = np.take_along_axis(direction, kept.argmax(axis=-1)[..., None], axis=-1)
        direction = np.sort(np.where(kept, direction, some) % (2 * np.pi), axis=-1)
        gap = np.diff(direction, axis=-1, append=direction[..., :1] + 2 * np.pi)
        widest = gap.argmax(axis=-1)[..., None]
        half = np.pi - np.take_along_axis(gap, widest, axis=-1) / 2
        # The arc begins behind the widest gap.
        begin = np.take_along_axis(direction, (widest + 1) % direction.shape[-1], axis=-1)
        return cls((begin + half)[..., 0].astype(np.float32), half[..., 0].astype(np.float32))

    def at(self, index: Array) -> Arcs:
        """Return the arcs of these rows of the first axis."""
        return Arcs(self.middle[index], self.half[index])

    def wider(self, margin: Array) -> Arcs:
        """Return arcs that reach further on both sides [rad], at most to the whole circle."""
        return Arcs(self.middle, np.minimum(self.half + margin, np.float32(np.pi)))

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return directions (..., count) [rad], uniform in each, one in every part of it."""
        uniform = rng.random((*self.middle.shape, count), np.float32)
        uniform = (np.arange(count, dtype=np.float32) + uniform) * np.float32(2 / count) - 1
        return self.middle[..., None] + self.half[..., None] * uniform
