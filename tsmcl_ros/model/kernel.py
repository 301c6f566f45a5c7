"""
Motion kernels: where each particle may be after a motion, and how to draw within a box of that.

A kernel that is confined to a box is not normalized any more: its mass there is what a particle's
weight has to be multiplied by, for draws from boxes to follow the same distribution as those from
the motion model that survive in the boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy
from tsmcl_ros.types import Array

_LEAST = 1e-6  # m, so that a motion without noise has a width


class Kernel(Protocol):
    """Where the particles (V, N) of V vehicles may be after a motion."""

    def mass(self, low: Array, high: Array) -> Array:
        """Return (V, N) float64: the mass within the vehicles' boxes, corners (V, D) [m]."""

    def draw(self, owner: Array, index: Array, low: Array, high: Array, share: Array,
             rng: np.random.Generator) -> tuple[Array, Array]:
        """
        Return states (M, D + extra) float32 of these vehicles and particles (M,) int each.

        Each is drawn in its vehicle's box, where its mass is positive, at the quantiles that the
        shares (M, D), uniform in [0, 1), say; the second value (M,) bool is False for those that
        missed the kernel.
        """

    def widened(self, factor: float) -> Kernel:
        """Return kernels that are so many times as wide along each axis."""


@dataclass(frozen=True, eq=False)
class BallKernel:
    """
    Uniform in balls: drawn in the box around the ball, and valid within it.

    Attributes
    ----------
    centre : (V, N, D) float64
        [m].
    radius : float
        [m].

    """

    centre: Array
    radius: float

    def mass(self, low: Array, high: Array) -> Array:
        """Return (V, N) float64: see `Kernel`; of the boxes around the balls."""
        sides = (np.minimum(self.centre + self.radius, high[:, None])
                 - np.maximum(self.centre - self.radius, low[:, None]))
        return np.asarray(np.maximum(sides, 0).prod(axis=2))

    def draw(self, owner: Array, index: Array, low: Array, high: Array, share: Array,
             rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw in boxes: see `Kernel`."""
        centre = self.centre[owner, index]
        lower = np.maximum(centre - self.radius, low[owner])
        upper = np.minimum(centre + self.radius, high[owner])
        drawn = lower + (upper - lower) * share
        valid = np.square(drawn - centre).sum(axis=1) <= self.radius ** 2
        return drawn.astype(np.float32), valid

    def widened(self, factor: float) -> BallKernel:
        """Return larger balls: see `Kernel`."""
        return replace(self, radius=factor * self.radius)


@dataclass(frozen=True, eq=False)
class GaussianKernel:
    """
    Gaussian along each axis, and what a particle remembers given where it is drawn.

    Attributes
    ----------
    centre : (V, N, D) float64
        [m].
    std : (V,) float64
        [m].
    remembered : (V, N, extra) float
        What the motion model remembers where a draw meets the centre.
    coupling, remembered_std : float
        What is added per metre off the centre, where extra is D, and the deviation from that.

    """

    centre: Array
    std: Array
    remembered: Array
    coupling: float = 0.0
    remembered_std: float = 0.0

    def mass(self, low: Array, high: Array) -> Array:
        """Return (V, N) float64: see `Kernel`."""
        std = np.maximum(self.std, _LEAST)[:, None, None]
        lower, upper, _ = _towards_tail((low[:, None] - self.centre) / std,
                                        (high[:, None] - self.centre) / std)
        share = scipy.special.ndtr(upper) - scipy.special.ndtr(lower)
        return np.asarray(np.maximum(share, 0).prod(axis=2))

    def draw(self, owner: Array, index: Array, low: Array, high: Array, share: Array,
             rng: np.random.Generator) -> tuple[Array, Array]:
        """Draw in boxes: see `Kernel`."""
        centre, std = self.centre[owner, index], np.maximum(self.std, _LEAST)[owner, None]
        lower, upper, side = _towards_tail((low[owner] - centre) / std,
                                           (high[owner] - centre) / std)
        begin, end = scipy.special.ndtr(lower), scipy.special.ndtr(upper)
        # A draw of exactly 0 or 1 would be infinitely far away.
        quantile = np.clip(begin + (end - begin) * share, 1e-300, 1 - 1e-16)
        off = side * std * scipy.special.ndtri(quantile)
        extra = self.remembered[owner, index]
        if self.coupling or self.remembered_std:
            extra = (extra + self.coupling * off
                     + self.remembered_std * rng.standard_normal(extra.shape))
        states = np.concatenate([centre + off, extra], axis=1).astype(np.float32)
        return states, np.ones(len(owner), bool)

    def widened(self, factor: float) -> GaussianKernel:
        """Return wider Gaussians, which remember as much as before: see `Kernel`."""
        return replace(self, std=factor * self.std, coupling=self.coupling / factor)


def choose(weights: Array, owner: Array, rng: np.random.Generator) -> Array:
    """Return one index (M,) a draw, as probable as its weight among its owner's (V, N)."""
    vehicles, count = weights.shape
    shares = np.cumsum(weights, axis=1)
    shares /= np.maximum(shares[:, -1:], 1e-300)
    shares += np.arange(vehicles)[:, None]
    found = np.searchsorted(shares.ravel(), owner + rng.random(len(owner)), side='right')
    return np.asarray(np.clip(found - owner * count, 0, count - 1))


def _towards_tail(low: Array, high: Array) -> tuple[Array, Array, Array]:
    """Mirror intervals above 0, where a Gaussian's integral resolves nothing; return the sides."""
    above = low > 0
    return (np.where(above, -high, low), np.where(above, -low, high), np.where(above, -1.0, 1.0))
