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
import scipy
from tsmcl_ros.model.geometry import Reach
from tsmcl_ros.model.particles import chunks
from tsmcl_ros.types import Array, Silence

# Numbers of at most 2 whose product a float32 holds.
_FACTORS = 100
# A radius that everything is inside of [m].
ENDLESS = 1e30
# The logarithm of no probability at all, with which one can still reckon.
NEVER = -1e9
# What is nearer than this counts as this far, as path loss has no bound [m].
_NEAREST = 1e-3


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


def _flat_or_none(column: Array | None, vehicle: Array | slice) -> Array | None:
    return None if column is None else flat(column, vehicle)


@dataclass(frozen=True, eq=False)
class DiskBoundary:
    """
    Inside or outside of soft-edged disks: heard, silent and relayed beacons alike.

    log p = -log(1 + exp((d - R) / s)), with a width s > 0 for heard and < 0 for silent; a relayed
    beacon (R < d <= 2R) is one of each. Columns are (V, E, 1); `steepness` is 1 / s. Where beacons
    get lost anyway with a probability m, of which `missed` is the logarithm, p becomes
    p + m (1 - p); it is None where none does.
    """

    measures: ClassVar[bool] = False

    references: References
    radius: Array
    steepness: Array
    missed: Array | None = None

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        steepness = self.steepness
        if variance is not None:
            # A logistic curve of width s lies within 0.01 of a Gaussian's of std 1.702 s.
            steepness = steepness / np.sqrt(
                1 + steepness * steepness * variance / np.float32(1.702 ** 2))
        distance -= self.radius
        distance *= steepness
        if self.missed is None:
            return -_softplus_sum(distance)
        return np.asarray(_softplus_sum(distance + self.missed) - _softplus_sum(distance))

    def at(self, vehicle: Array | slice) -> DiskBoundary:
        """Return the factor for other points: see `Factor`."""
        return DiskBoundary(
            self.references.at(vehicle), flat(self.radius, vehicle),
            flat(self.steepness, vehicle), _flat_or_none(self.missed, vehicle))


@dataclass(frozen=True, eq=False)
class ShadowedBoundary:
    """
    Heard or not under log-normal shadowing.

    p = Phi(side 10 n log10(R / d) / sigma_db), with R where the mean rssi meets the sensitivity.
    Columns are (V, E, 1); for `missed` see `DiskBoundary`.
    """

    measures: ClassVar[bool] = False

    references: References
    radius: Array
    side: Array
    slope: Array
    missed: Array | None = None

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        distance = np.maximum(distance, np.float32(_NEAREST))
        excess = self.side * self.slope * np.log10(self.radius / distance)
        if variance is not None:
            excess = excess / np.sqrt(_power_variance(self.slope, variance, distance))
        log_likelihood = scipy.special.log_ndtr(excess)
        if self.missed is not None:
            log_likelihood = np.logaddexp(
                log_likelihood, self.missed + scipy.special.log_ndtr(-excess))
        return np.asarray(log_likelihood.sum(axis=1))

    def at(self, vehicle: Array | slice) -> ShadowedBoundary:
        """Return the factor for other points: see `Factor`."""
        return ShadowedBoundary(
            self.references.at(vehicle), flat(self.radius, vehicle), flat(self.side, vehicle),
            flat(self.slope, vehicle), _flat_or_none(self.missed, vehicle))


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
        np.clip(distance, _NEAREST, ENDLESS, out=distance)
        widened = None if variance is None else _power_variance(self.slope, variance, distance)
        squared = np.log10(distance, out=distance)
        squared *= self.slope
        squared += self.excess
        squared *= squared
        if widened is not None:
            squared /= widened
            squared += np.log(widened)
        squared *= np.float32(-0.5) * self.weight
        return np.asarray(heavy_tailed(squared, self.floor).sum(axis=1))

    def at(self, vehicle: Array | slice) -> Power:
        """Return the factor for other points: see `Factor`."""
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


def column(values: Array) -> Array:
    """
    Lay out per-reference values (V, E) against points: (V, E, 1) float32.

    One reference's values lie together in memory, as `flat` takes them.
    """
    return np.asarray(values, np.float32, order='F')[:, :, None]


def log_of_rate(silent: Silence) -> Array:
    """Return ln (V, S) of how probable it is that anchors are missed however near they are."""
    if silent.miss_rate is None:
        return np.full(silent.known.shape, NEVER)
    return np.log(silent.miss_rate, out=np.full(silent.known.shape, NEVER),
                  where=silent.miss_rate > 0)


def _power_variance(slope: Array, variance: Array, distance: Array) -> Array:
    """
    Return the variance of received power, in sigma_db^2.

    To the shadowing comes what the reference's variance [m^2] along the line of sight makes of
    the path loss at this distance [m].
    """
    return np.asarray(1 + (slope / math.log(10)) ** 2 * variance / distance ** 2)


def _softplus_sum(x: Array) -> Array:
    """
    Return the sum (V, P) over E of log(1 + exp(x)) of x (V, E, P) float32, which is spoiled.

    That is max(x, 0) + log(1 + exp(-|x|)), without overflow; one logarithm of a product serves
    all references, each of whose factors is at most 2.
    """
    size = np.abs(x)
    x += size
    linear = x.sum(axis=1)
    # What is beyond adds nothing to 1 in float32, but takes long where it underflows.
    np.clip(size, 0, 20, out=size)
    np.negative(size, out=size)
    np.exp(size, out=size)
    size += 1
    linear *= np.float32(0.5)
    for first in range(0, size.shape[1], _FACTORS):
        linear += np.log(size[:, first:first + _FACTORS].prod(axis=1))
    return np.asarray(linear)


def heavy_tailed(score: Array, floor: float) -> Array:
    """Return log((1 - floor) exp(score) + floor) for log-likelihoods of inliers."""
    if floor == 0:
        return score
    likelihood = np.exp(score)
    likelihood *= 1 - np.float32(floor)
    likelihood += np.float32(floor)
    return np.log(likelihood, out=likelihood)
