"""
Gaussian beliefs of a fleet that take in measurements, and keep count of how well these fit.

What `Evidence` is to particles this is to Gaussians: outliers are reckoned with, references may
be uncertain, and all that is learnt is scored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from tsmcl_ros.model import gaussian
from tsmcl_ros.types import Array

_NEAREST = 1e-3  # m, what the log of a range is taken of at least


@dataclass(frozen=True, eq=False)
class Sight:
    """
    What V beliefs expect of a quantity each.

    Attributes
    ----------
    expected : (V,) float
        Its mean.
    gradient : (V, n) float
        Its derivative by the state.
    variance : (V,) float
        What is uncertain of it beside the first order in the state.

    """

    expected: Array
    gradient: Array
    variance: Array

    @classmethod
    def to(cls, mean: Array, covariance: Array, position: Array, known: Array) -> Sight:
        """
        Return what is expected of distances to references.

        Parameters
        ----------
        mean, covariance : (V, D), (V, D, D) float
            The beliefs [m, m^2].
        position, known : (V, D), (V, D, D) float
            The references, and how well their positions are known [m, m^2].

        """
        expected, slope, variance = gaussian.range_to(mean, covariance, position)
        return cls(expected, slope, variance + gaussian.innovation_variance(
            known, slope, np.zeros(len(slope))))

    def on_log_scale(self, covariance: Array) -> Sight:
        """
        Return what is expected of the quantity's log10, given the beliefs' covariance (V, n, n).

        A log bends: its mean is below the log of the mean, by Var / (2 mean^2) to second order,
        and by what a log-normal variable's is where that is much.
        """
        value = np.maximum(self.expected, _NEAREST)
        slope = 1 / (math.log(10) * value)
        spread = gaussian.innovation_variance(covariance, self.gradient, self.variance)
        return Sight(np.log10(value) - 0.5 * np.log10(1 + spread / value ** 2),
                     slope[:, None] * self.gradient, slope ** 2 * self.variance)


class Beliefs:
    """
    Gaussians over the states of V vehicles.

    Parameters
    ----------
    vehicles, size, dimension : int
        V, n and D; the first D components are the position.
    outlier_fraction : float
        Share of measurements that may say anything.

    Attributes
    ----------
    mean, covariance : (V, n), (V, n, n) float64
    log_likelihood : (V,) float64
        Of what was taken in since `begin`, relative to its peak, averaged over the belief.
    fit, terms : (V,) float64
        The same at the belief's best: a broad belief has no worse one; and of how many terms.
    doubtful : (V,) bool
        Whether most measurements were taken for outliers.

    """

    def __init__(self, vehicles: int, size: int, dimension: int, outlier_fraction: float):
        self.dimension = dimension
        self.mean = np.zeros((vehicles, size))
        self.covariance = np.tile(np.eye(size), (vehicles, 1, 1))
        self._floor = outlier_fraction
        self.begin()

    def begin(self) -> None:
        """Begin to keep count of what is taken in."""
        self.log_likelihood, self.fit, self.terms, self._doubt, self._measured = np.zeros(
            (5, len(self.mean)))

    @property
    def doubtful(self) -> Array:
        """(V,) bool: see the class."""
        return np.asarray(2 * self._doubt > self._measured)

    def sight(self, position: Array, covariance: Array) -> Sight:
        """Return what is expected of the distances to references (V, D), known that well."""
        size = self.dimension
        seen = Sight.to(
            self.mean[:, :size], self.covariance[:, :size, :size], position, covariance)
        gradient = np.zeros_like(self.mean)
        gradient[:, :size] = seen.gradient
        return replace(seen, gradient=gradient)

    def measure(self, used: Array, sight: Sight, measured: Array, variance: Array) -> None:
        """
        Take in one measurement each, for as much as it is likely to be sound.

        Parameters
        ----------
        used : (V,) bool
            Who has one.
        sight : Sight
            What was expected.
        measured, variance : (V,) float
            What was measured, and how well.

        """
        residual = np.where(used, measured - sight.expected, 0)
        expected = gaussian.innovation_variance(
            self.covariance, sight.gradient, variance + sight.variance)
        sound = (1 - self._floor) * np.exp(-0.5 * residual ** 2 / expected)
        trust = np.ones_like(sound)
        if self._floor > 0:
            trust = sound / (sound + self._floor)
        self.mean, self.covariance = gaussian.update(
            self.mean, self.covariance, sight.gradient, residual,
            np.where(used, variance + sight.variance, np.inf), trust)
        with np.errstate(divide='ignore'):
            fit = np.log(sound + self._floor)
            average = np.log(sound * np.sqrt(variance / expected) + self._floor)
        if self._floor == 0:  # where the exponential has no bits left, its argument has
            fit = -0.5 * residual ** 2 / expected
            average = fit + 0.5 * np.log(variance / expected)
        self._count(used, average, fit)
        self._measured += used
        self._doubt += used & (trust < 0.5)

    def bound(self, used: Array, sight: Sight, limit: Array, side: int, variance: Array,
              missed: Array) -> None:
        """
        Take in that a quantity of each lies below (side 1) or above (side -1) a limit.

        The limit is soft: a Gaussian of this variance (V,). With a probability `missed` (V,) it
        lies anywhere.
        """
        excess = np.where(used, side * (limit - sight.expected), np.inf)
        mean, covariance, fit = gaussian.update_by_bound(
            self.mean, self.covariance, -side * sight.gradient, excess, variance + sight.variance)
        if (used & (missed > 0)).any():
            bounded = (1 - missed) * np.exp(fit)
            fit = np.where(missed > 0, np.log(np.maximum(bounded + missed, 1e-300)), fit)
            trust = np.where(used, bounded / np.maximum(bounded + missed, 1e-300), 1)
            trust = np.where(missed > 0, trust, 1)
            mean, covariance = gaussian.mixed(
                trust, (mean, covariance), (self.mean, self.covariance))
        self.mean, self.covariance = mean, covariance
        self._count(used, fit, fit)

    def count(self, vehicle: Array, log_likelihood: Array, fit: Array, terms: Array) -> None:
        """Count what vehicles (W,) int have taken in otherwise: see the class (W,)."""
        self.log_likelihood[vehicle] += log_likelihood
        self.fit[vehicle] += fit
        self.terms[vehicle] += terms

    def keep(self, which: Array, mean: Array, covariance: Array) -> None:
        """Give the vehicles (V,) bool these beliefs (V, n), (V, n, n) back."""
        self.mean = np.where(which[:, None], mean, self.mean)
        self.covariance = np.where(which[:, None, None], covariance, self.covariance)

    def place(self, vehicle: Array, mean: Array, covariance: Array, rest: tuple[Array, Array]
              ) -> None:
        """
        Give vehicles new beliefs.

        Parameters
        ----------
        vehicle : (W,) int
            Their indices.
        mean, covariance : (W, D), (W, D, D) float
            Of the position [m, m^2].
        rest : (n - D,) and (n - D, n - D) float
            Mean and covariance of the rest of the state.

        """
        size = self.dimension
        self.mean[vehicle, :size], self.mean[vehicle, size:] = mean, rest[0]
        self.covariance[vehicle] = 0
        self.covariance[vehicle, :size, :size] = covariance
        self.covariance[vehicle, size:, size:] = rest[1]

    def _count(self, used: Array, log_likelihood: Array, fit: Array) -> None:
        self.log_likelihood = self.log_likelihood + np.where(used, log_likelihood, 0)
        self.fit = self.fit + np.where(used, fit, 0)
        self.terms = self.terms + used
