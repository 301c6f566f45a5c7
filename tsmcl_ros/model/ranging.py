"""
Measured ranges: how they err, and how likely they make positions.

An error is true minus indicated distance, e = d - r [m]; indicated is what is measured, less its
bias and scale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar, Protocol

import numpy as np
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.factors import heavy_tailed
from tsmcl_ros.model.references import flat, References
from tsmcl_ros.types import Array

_ERFC = (-1.26551223, 1.00002368, 0.37409196, 0.09678418, -0.18628806, 0.27886807, -1.13520398,
         1.48851587, -0.82215223, 0.17087277)


class RangeErrors(Protocol):
    """The error law of V vehicles' ranges to E references each, in columns (V, E, 1)."""

    def log_density(self, error: Array, variance: Array | None) -> Array:
        """
        Return ln p(e) (V, E, P), e in m, relative to 1 / m.

        Parameters
        ----------
        error : (V, E, P) float32
            [m].
        variance : (V, E, P) float32 or None
            Of the true distance [m^2], as the reference's position is uncertain.

        """

    def bound(self, least: Array | None) -> Array:
        """Return what ln p cannot exceed (V, E, 1), where the variance is at least this."""

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return errors (V, E, count) [m]; zero where padded."""

    def widened(self, variance: Array) -> RangeErrors:
        """Return the law with this variance more (V, E, 1) [m^2], roughly."""

    def at(self, vehicle: Array | slice) -> RangeErrors:
        """Return the law for other points: see `Factor`."""


@dataclass(frozen=True, eq=False)
class GaussianErrors:
    """
    Normal errors.

    Attributes
    ----------
    std : (V, E, 1) float32
        [m], inf where padded.
    peak : (V, E, 1) float32
        The most that ln p can be.

    """

    std: Array
    peak: Array

    @classmethod
    def of(cls, std: Array) -> GaussianErrors:
        """Return normal errors of these standard deviations (V, E, 1) [m], inf where padded."""
        known = np.where(np.isfinite(std), std, 1)
        return cls(std, np.asarray(-np.log(math.sqrt(2 * math.pi) * known), np.float32))

    def log_density(self, error: Array, variance: Array | None) -> Array:
        """Return ln p(e): see `RangeErrors`."""
        if variance is None:
            score = error / self.std
            score *= score
            score *= np.float32(-0.5)
            score += self.peak
            return score
        precision = 1 / (self.std * self.std)
        widened = 1 + precision * variance
        squared = precision * error * error / widened
        return np.asarray(np.float32(-0.5) * (squared + np.log(widened)) + self.peak)

    def bound(self, least: Array | None) -> Array:
        """Return the most that ln p can be: see `RangeErrors`."""
        if least is None:
            return self.peak
        return np.asarray(self.peak - np.log1p(least / (self.std * self.std)) / 2)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return errors: see `RangeErrors`."""
        std = np.where(np.isfinite(self.std), self.std, 0)
        return std * rng.standard_normal((*std.shape[:2], count), np.float32)

    def widened(self, variance: Array) -> GaussianErrors:
        """Return a wider law: see `RangeErrors`."""
        return GaussianErrors.of(np.sqrt(self.std * self.std + variance))

    def at(self, vehicle: Array | slice) -> GaussianErrors:
        """Return the law for other points: see `RangeErrors`."""
        return GaussianErrors(flat(self.std, vehicle), flat(self.peak, vehicle))


@dataclass(frozen=True, eq=False)
class AsymmetricErrors:
    """
    Double exponential errors: ranges are seldom much too short, but often too long.

    p(e) = exp(e / long) / (short + long) for e <= 0 and exp(-e / short) / (short + long) for
    e > 0 (Li, Hedley, Collings 2015). An uncertain reference convolves it with a Gaussian, in
    closed form: two exponentially modified Gaussians.

    Attributes
    ----------
    short, long : (V, E, 1) float32
        Mean of the errors of each sign [m], inf where padded.
    peak : (V, E, 1) float32
        The most that ln p can be.

    """

    short: Array
    long: Array
    peak: Array

    @classmethod
    def of(cls, short: Array, long: Array) -> AsymmetricErrors:
        """Return errors of these means (V, E, 1) [m], inf where padded."""
        total = short + long
        return cls(short, long, np.asarray(-np.log(np.where(np.isfinite(total), total, 1))))

    def log_density(self, error: Array, variance: Array | None) -> Array:
        """Return ln p(e): see `RangeErrors`."""
        if variance is None:
            decay = error * (1 / self.long)
            np.minimum(decay, error * (-1 / self.short), out=decay)
            decay += self.peak
            return np.asarray(decay)
        std = np.sqrt(np.maximum(variance, np.float32(1e-6)))
        positive, negative = (_one_sided(error, std, self.short),
                              _one_sided(-error, std, self.long))
        larger = np.maximum(positive, negative)
        rest = np.exp(np.minimum(positive, negative) - larger)
        return np.asarray(larger + np.log(1 + rest) + self.peak)

    def bound(self, least: Array | None) -> Array:
        """Return the most that ln p can be: see `RangeErrors`."""
        if least is None:
            return self.peak
        # Neither density can be exceeded by their convolution; a padded one stays at 1.
        gaussian = -0.5 * np.log(2 * np.pi * np.maximum(least, np.float32(1e-12)))
        return np.where(
            np.isfinite(self.short + self.long), np.minimum(self.peak, gaussian), 0)

    def draw(self, count: int, rng: np.random.Generator) -> Array:
        """Return errors: see `RangeErrors`."""
        short, long = (np.where(np.isfinite(scale), scale, 0)
                       for scale in (self.short, self.long))
        return draw_asymmetric(short, long, (*short.shape[:2], count), rng)

    def widened(self, variance: Array) -> AsymmetricErrors:
        """Return a wider law: see `RangeErrors`."""
        return AsymmetricErrors.of(
            *(np.sqrt(scale * scale + variance / 2) for scale in (self.short, self.long)))

    def at(self, vehicle: Array | slice) -> AsymmetricErrors:
        """Return the law for other points: see `RangeErrors`."""
        return AsymmetricErrors(*(
            flat(each, vehicle) for each in (self.short, self.long, self.peak)))


@dataclass(frozen=True, eq=False)
class Ranging:
    """
    Measured ranges under an error law, with a uniform floor.

    Attributes
    ----------
    references : References
        Measured to.
    indicated : (V, E, 1) float32
        Distances [m].
    errors : RangeErrors
        Of them.
    used : (V, E, 1) bool
        False where padded.
    floor : float
        Share of ranges that may say anything.

    """

    measures: ClassVar[bool] = True

    references: References
    indicated: Array
    errors: RangeErrors
    used: Array
    floor: float

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        return self.scores(self.log_density(points)).sum(axis=1)

    def log_density(self, points: Array) -> Array:
        """Return ln p(d - r) (V, E, P) of the distances at points (V, P, D) [m], no outliers."""
        distance, variance = self.references.distance(points)
        return self.errors.log_density(distance - self.indicated, variance)

    def scores(self, log_density: Array) -> Array:
        """Return log-likelihoods (V, E, P) relative to their peak, with outliers reckoned in."""
        relative = log_density - self.errors.bound(self.references.least)
        np.minimum(relative, 0, out=relative)
        np.copyto(relative, 0, where=~self.used)
        return heavy_tailed(relative, self.floor)

    def simplified(self) -> Ranging:
        """
        Return the same ranges to exactly known references, by errors as much wider.

        This takes a fifth of the time, and the references' covariances for circles.
        """
        covariance = self.references.covariance
        if covariance is None:
            return self
        axes = range(len(covariance))
        variance = sum(covariance[i, i] for i in axes) / len(covariance)
        return replace(self, references=References(self.references.position, None, None),
                       errors=self.errors.widened(variance))

    def at(self, vehicle: Array | slice) -> Ranging:
        """Return the factor for other points: see `Factor`."""
        return replace(
            self, references=self.references.at(vehicle), errors=self.errors.at(vehicle),
            indicated=flat(self.indicated, vehicle), used=flat(self.used, vehicle))


def without_ranges(evidence: Evidence) -> tuple[Ranging | None, Evidence]:
    """Return the ranges of the evidence, None if there are none, and the rest of it."""
    ranges = [factor for factor in evidence.factors if isinstance(factor, Ranging)]
    rest = tuple(factor for factor in evidence.factors if not isinstance(factor, Ranging))
    return ranges[0] if ranges else None, replace(evidence, factors=rest)


def draw_asymmetric(short: Array, long: Array, shape: tuple[int, ...],
                    rng: np.random.Generator) -> Array:
    """Return errors [m] of the law of `AsymmetricErrors`, of scales that broadcast to a shape."""
    size = rng.standard_exponential(shape, np.float32)
    positive = rng.random(shape, np.float32) * (short + long) < short
    return np.where(positive, short * size, -long * size)


def _one_sided(error: Array, std: Array, scale: Array) -> Array:
    """
    Return ln of the average of [e' > 0] exp(-e' / scale) over e' ~ N(error, std^2).

    An exponentially modified Gaussian, in a form whose factors do not overflow.
    """
    steepness, ratio = std / scale, error / std
    lag = (steepness - ratio) * np.float32(math.sqrt(0.5))
    tail = _log_erfcx(np.abs(lag)) - np.float32(math.log(2)) - np.float32(0.5) * ratio * ratio
    # To the right, where the error is likely to be positive, by what is missing from 1.
    sure = steepness * (np.float32(0.5) * steepness - ratio)
    missing = np.exp(np.minimum(tail - sure, np.float32(-math.log(2))))
    return np.where(lag > 0, tail, sure + np.log(1 - missing))


def _log_erfcx(x: Array) -> Array:
    """
    Return ln erfcx(x) for x >= 0, to seven digits.

    The Chebyshev fit of erfc in Press et al., Numerical Recipes (1992, section 6.2), whose factor
    exp(-x^2) is what makes erfc of erfcx; scipy's has more digits and takes four times as long.
    """
    t = 1 / (1 + np.float32(0.5) * x)
    total = np.full_like(t, _ERFC[-1])
    for coefficient in _ERFC[-2::-1]:
        total *= t
        total += np.float32(coefficient)
    return np.log(t) + total
