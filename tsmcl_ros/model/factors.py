"""Evidence by kind: who is heard and who is silent, and with which power."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
import scipy
from tsmcl_ros.model.references import flat, References
from tsmcl_ros.types import Array, Silence

# Numbers of at most 2 whose product a float32 holds.
_FACTORS = 100
# A radius that everything is inside of [m].
ENDLESS = 1e30
# The logarithm of no probability at all, with which one can still reckon.
NEVER = -1e9
# What is nearer than this counts as this far, as path loss has no bound [m].
_NEAREST = 1e-3


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
