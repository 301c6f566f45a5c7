"""
Evidence: how likely positions are, given what was heard, split into factors by kind.

Every factor works on arrays laid out (V, E, P), references before points, so that sums over
references run along contiguous memory. All log-likelihoods are relative to their peak: at most 0,
exp() of them in [0, 1].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import ClassVar, Protocol

import numpy as np
from scipy.special import log_ndtr
from tsmcl_ros.model.geometry import Reach
from tsmcl_ros.types import Array


class Factor(Protocol):
    """
    One kind of evidence of V vehicles, E references each (padded ones score 0).

    `measures` tells measurements from who was heard and who was silent.
    """

    measures: ClassVar[bool]

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): the sum over references at points (V, P, D) [m]."""

    def at(self, vehicle: Array) -> Factor:
        """Return the factor for a flat list of points (1, M, D) of the vehicles (M,)."""


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
        position = np.moveaxis(np.asarray(position, np.float32), 2, 0)[..., None]
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
        delta = [points[:, None, :, axis] - position
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

    def at(self, vehicle: Array) -> References:
        """Return the references for a flat list of points of the vehicles (M,)."""
        return References(
            flat(self.position, vehicle),
            None if self.covariance is None else flat(self.covariance, vehicle),
            None if self.least is None else flat(self.least, vehicle),
        )


def flat(column: Array, vehicle: Array) -> Array:
    """Lay out columns (..., V, E, 1) for a flat list of points of M vehicles: (..., 1, E, M)."""
    return np.swapaxes(column[..., 0].take(vehicle, axis=-2), -1, -2)[..., None, :, :]


@dataclass(frozen=True, eq=False)
class DiskBoundary:
    """
    Inside or outside of soft-edged disks: heard, silent and relayed beacons alike.

    log p = -log(1 + exp(side (d - R) / s)), with side 1 for heard and -1 for silent; a relayed
    beacon (R < d <= 2R) is one of each. Columns are (V, E, 1).
    """

    measures: ClassVar[bool] = False

    references: References
    radius: Array
    softness: Array
    side: Array

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        softness = self.softness
        if variance is not None:
            # A logistic curve of width s lies within 0.01 of a Gaussian's of std 1.702 s.
            softness = np.sqrt(softness * softness + variance / np.float32(1.702 ** 2))
        distance -= self.radius
        distance *= self.side / softness
        return -_softplus(distance).sum(axis=1)

    def at(self, vehicle: Array) -> DiskBoundary:
        """Return the factor for a flat list of points: see `Factor`."""
        return DiskBoundary(self.references.at(vehicle), *(
            flat(column, vehicle) for column in (self.radius, self.softness, self.side)))


@dataclass(frozen=True, eq=False)
class ShadowedBoundary:
    """
    Heard or not under log-normal shadowing.

    p = Phi(side 10 n log10(R / d) / sigma_db), with R where the mean rssi meets the sensitivity.
    Columns are (V, E, 1).
    """

    measures: ClassVar[bool] = False

    references: References
    radius: Array
    side: Array
    slope: Array

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        distance = np.maximum(distance, np.float32(1e-3))
        excess = self.side * self.slope * np.log10(self.radius / distance)
        if variance is not None:
            excess = excess / np.sqrt(_power_variance(self.slope, variance, distance))
        return np.asarray(log_ndtr(excess).sum(axis=1))

    def at(self, vehicle: Array) -> ShadowedBoundary:
        """Return the factor for a flat list of points: see `Factor`."""
        return ShadowedBoundary(self.references.at(vehicle), *(
            flat(column, vehicle) for column in (self.radius, self.side, self.slope)))


@dataclass(frozen=True, eq=False)
class Power:
    """
    Received power around the path-loss curve, Gaussian in dB, with a uniform floor.

    Equivalently log-normal in distance, so near references weigh more. Columns are (V, E, 1);
    `weight` is 0 where padded.
    """

    measures: ClassVar[bool] = True

    references: References
    excess: Array
    weight: Array
    slope: Array
    floor: float

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        distance = np.maximum(distance, np.float32(1e-3))
        residual = self.excess + self.slope * np.log10(distance)
        squared = residual * residual
        if variance is not None:
            widened = _power_variance(self.slope, variance, distance)
            squared = squared / widened + np.log(widened)
        return heavy_tailed(np.float32(-0.5) * self.weight * squared, self.floor).sum(axis=1)

    def at(self, vehicle: Array) -> Power:
        """Return the factor for a flat list of points: see `Factor`."""
        return replace(
            self, references=self.references.at(vehicle),
            excess=flat(self.excess, vehicle), weight=flat(self.weight, vehicle),
            slope=flat(self.slope, vehicle))


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
        for factor in self.factors:
            total += factor.log_likelihood(points)
        return total

    @property
    def presence(self) -> Evidence:
        """Only who was heard and who was silent."""
        return replace(self, factors=tuple(
            factor for factor in self.factors if not factor.measures))

    @property
    def measured(self) -> Evidence:
        """Only what was measured: ranges and rssi."""
        return replace(self, factors=tuple(
            factor for factor in self.factors if factor.measures))

    def log_likelihood_of(self, points: Array, vehicle: Array) -> Array:
        """Return (M,) float32 of a flat list of points (M, D) [m] of the vehicles (M,)."""
        total = np.zeros(len(points), np.float32)
        for factor in self.factors:
            listed = factor if len(self.heard) == 1 else factor.at(vehicle)
            total += listed.log_likelihood(points[None])[0]
        return total


def column(values: Array) -> Array:
    """Lay out per-reference values (V, E) against points: (V, E, 1) float32."""
    return np.asarray(values, np.float32)[:, :, None]


def _power_variance(slope: Array, variance: Array, distance: Array) -> Array:
    """
    Return the variance of received power, in sigma_db^2.

    To the shadowing comes what the reference's variance [m^2] along the line of sight makes of
    the path loss at this distance [m].
    """
    return np.asarray(1 + (slope / math.log(10)) ** 2 * variance / distance ** 2)


def _softplus(x: Array) -> Array:
    """Turn x into log(1 + exp(x)), in place, without overflow, by fast float32 functions."""
    positive = np.maximum(x, 0)
    np.abs(x, out=x)
    np.negative(x, out=x)
    np.exp(x, out=x)
    x += 1
    np.log(x, out=x)
    x += positive
    return x


def heavy_tailed(score: Array, floor: float) -> Array:
    """Return log((1 - floor) exp(score) + floor) for log-likelihoods of inliers."""
    if floor == 0:
        return score
    return np.log((1 - np.float32(floor)) * np.exp(score) + np.float32(floor))
