"""
Evidence: how likely positions are, given what was heard, split into factors by kind.

Every factor works on arrays laid out (V, E, P), references before points, so that sums over
references run along contiguous memory. All log-likelihoods are relative to their peak: at most 0,
exp() of them in [0, 1].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from tsmcl_ros.model.geometry import Reach
from tsmcl_ros.model.particles import chunks
from tsmcl_ros.types import Array


class Factor(Protocol):
    """
    One kind of evidence of V vehicles, E references each (padded ones score 0).

    `measures` tells measurements from who was heard and who was silent.
    """

    measures: ClassVar[bool]

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): the sum over references at points (V, P, D) [m]."""

    def at(self, vehicle: Array | slice) -> Factor:
        """
        Return the factor for other points.

        Those are a flat list (1, M, D) of the vehicles (M,), or the (V', P, D) of a slice of them.
        """


@dataclass(frozen=True, eq=False)
class Evidence:
    """
    All that an observation says of V vehicles' positions.

    Attributes
    ----------
    factors : tuple of Factor
        Their log-likelihoods add up.
    terms : (V,) float32
        Number of terms in that sum, at least 1.
    floor : (V,) float32
        What the log-likelihood comes to where every measurement is an outlier; -inf if nothing
        was measured, or outliers are not reckoned with.
    heard : (V,) bool
        False for a vehicle that heard nothing; its likelihood is 1 everywhere.
    region : callable
        Returns `reach`; it is seldom asked for.

    """

    factors: tuple[Factor, ...]
    terms: Array
    floor: Array
    heard: Array
    region: Callable[[], Reach]

    @cached_property
    def reach(self) -> Reach:
        """How far from the references the vehicles may be."""
        return self.region()

    @cached_property
    def box(self) -> Array:
        """(V, 2, D) float32: corners [m] of a region that holds all likely positions."""
        return self.reach.box()

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P) float32 at points (V, P, D) or shared ones (1, P, D) [m]."""
        total = np.zeros((len(self.heard), points.shape[1]), np.float32)
        for rows in chunks(len(total), points.shape[1]):
            some = points if len(points) == 1 else points[rows]
            for factor in self.factors:
                total[rows] += factor.at(rows).log_likelihood(some)
        return total

    @property
    def presence(self) -> Evidence:
        """Only who was heard and who was silent."""
        return replace(self, factors=tuple(
            factor for factor in self.factors if not factor.measures))

    def without(self, *kinds: type[Factor]) -> Evidence:
        """Return all but some kinds."""
        return replace(self, factors=tuple(
            factor for factor in self.factors if not isinstance(factor, kinds)))

    @property
    def measured(self) -> Evidence:
        """Only what was measured: ranges and rssi."""
        return replace(self, factors=tuple(
            factor for factor in self.factors if factor.measures))

    def log_likelihood_of(self, points: Array, vehicle: Array) -> Array:
        """Return (M,) float32 of a flat list of points (M, D) [m] of the vehicles (M,)."""
        total = np.zeros(len(points), np.float32)
        single = len(self.heard) == 1
        for rows in chunks(len(points)):
            for factor in self.factors:
                listed = factor if single else factor.at(vehicle[rows])
                total[rows] += listed.log_likelihood(points[None, rows])[0]
        return total
