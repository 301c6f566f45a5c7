"""
Positions led on by the azimuth at which a station would see them, while nothing is heard of them.

Zhuo et al.: grey prediction of the azimuth and an extended Kalman filter, for delay-tolerant
networks. The grey model extrapolates the azimuths of the last positions, and the filter takes that
for a measurement, whose variance grows with the horizon.
"""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.gaussian import azimuth_of, innovation_variance, update
from tsmcl_ros.model.grey import predict_azimuth
from tsmcl_ros.model.history import History, SLOT
from tsmcl_ros.model.mobility import wrap
from tsmcl_ros.types import Array

VALUES = 5  # of a series, the paper's n
_SLOTS = 64  # of a history, of which the series is the end
_LEAST = 1e-12  # rad^2, so that no gain is undefined


class AzimuthLead:
    """
    Series of azimuths of V vehicles, and what they do to beliefs of which nothing is heard.

    Parameters
    ----------
    vehicles, dimension : int
        V and D.
    threshold : float
        The azimuth of the filter's position is appended to the series where it differs by more
        than this [rad] from the grey prediction, and is more certain.

    """

    def __init__(self, vehicles: int, dimension: int, threshold: float):
        self.threshold = threshold
        self._history = History(vehicles, dimension, _SLOTS)
        self._station = np.zeros((vehicles, 2))

    def forget(self, which: Array | int) -> None:
        """Drop the series of these vehicles, an index or (V,) bool."""
        self._history.forget(which)

    def observe(self, stamp: float, mean: Array, covariance: Array, station: Array, which: Array
                ) -> None:
        """
        Take in where these vehicles (V,) bool are seen.

        Parameters
        ----------
        stamp : float
            [s].
        mean, covariance : (V, D), (V, D, D) float
            Positions, by whatever was observed [m, m^2].
        station : (V, 2) float
            From where they are seen [m].
        which : (V,) bool
            Of whom.

        """
        rows = self._history.learn(stamp, mean, covariance, which)
        self._station[rows] = station[rows]

    def lead(self, stamp: float, mean: Array, covariance: Array, which: Array
             ) -> tuple[Array, Array]:
        """
        Return beliefs after the grey azimuths of these vehicles (V,) bool.

        The prediction comes from the very past that the belief does, so it is no news: the
        covariance that is returned serves the next steps, but would be overconfident to tell.

        Parameters
        ----------
        stamp : float
            [s].
        mean, covariance : (V, n), (V, n, n) float
            As predicted by the motion; the first D components are the position.
        which : (V,) bool
            Who is not heard.

        """
        predicted, variance = grey_azimuth(self._history, self._station, stamp)
        which = which & np.isfinite(variance)
        if not which.any():
            return mean, covariance
        dimension = self._history.mean.shape[1]
        variance = np.where(which, variance, np.inf)
        azimuth, gradient = self._see(mean)
        certain = innovation_variance(covariance, gradient, np.zeros(len(mean)))
        residual = np.where(which, wrap(predicted - azimuth), 0)
        mean, covariance = update(mean, covariance, gradient, residual, variance)
        azimuth, _ = self._see(mean)
        surprising = np.abs(wrap(predicted - azimuth)) > self.threshold
        self._history.learn(
            stamp, mean[:, :dimension], covariance[:, :dimension, :dimension],
            which & surprising & (certain < variance))
        return mean, covariance

    def _see(self, mean: Array) -> tuple[Array, Array]:
        """Return the azimuths (V,) [rad] of means (V, n), and their gradients (V, n)."""
        azimuth, slope = azimuth_of(mean[:, :2], self._station)
        gradient = np.zeros(mean.shape)
        gradient[:, :2] = slope
        return azimuth, gradient


def grey_azimuth(history: History, station: Array, stamp: float) -> tuple[Array, Array]:
    """
    Return the azimuths (V,) [rad] that GM(1,1) predicts at a time, and their variances.

    Parameters
    ----------
    history : History
        Of V vehicles; the series are the azimuths of its last positions.
    station : (V, 2) float
        From where they are seen [m].
    stamp : float
        [s].

    Returns
    -------
    azimuth, variance : (V,) float
        [rad], not wrapped; [rad^2], above 0, infinite where the history is too short.

    """
    series, time, known = history.last(VALUES)
    seen = series[:, :, :2] - station[:, None]
    steps = np.where(known, np.maximum((stamp - time) / SLOT, 0), 0)
    predicted = predict_azimuth(np.arctan2(seen[:, :, 1], seen[:, :, 0]), steps)
    _, slope = azimuth_of(history.mean[:, :2], station)
    variance = innovation_variance(history.covariance[:, :2, :2], slope, np.zeros(len(slope)))
    variance = np.maximum(variance, _LEAST) * growth(steps)
    return predicted, np.where(known, variance, np.inf)


def farthest(mean: Array, reference: Array, used: Array) -> Array:
    """
    Return the farthest place (V, 2) of the references used (V, K), the origin if none is.

    The farther a station is, the less does an azimuth change within a position's uncertainty, and
    the more slowly along the way.
    """
    if not used.shape[1]:
        return np.zeros((len(mean), 2))
    distance = np.linalg.norm(reference[:, :, :2] - mean[:, None, :2], axis=2)
    row = np.where(used, distance, -1).argmax(axis=1)[:, None, None]
    chosen = np.take_along_axis(reference[:, :, :2], row, axis=1)[:, 0]
    return np.where(used.any(axis=1)[:, None], chosen, 0)


def growth(steps: Array) -> Array:
    """Return the variance, some steps ahead, of a line through the series of variance 1."""
    middle = (VALUES - 1) / 2
    return np.asarray(
        1 + 1 / VALUES + 12 * (steps + middle) ** 2 / (VALUES * (VALUES ** 2 - 1)))
