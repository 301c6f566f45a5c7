"""The way that vehicles came: their last positions at even times, for those who predict."""

from __future__ import annotations

import math

import numpy as np
from tsmcl_ros.types import Array

SLOT = 1.0  # s, between two positions of a history
BRIDGED = 30.0  # s, the longest gap across which a history is interpolated
# Slots of the time to come in the tables: moved on all at once, which is cheap if it is seldom.
_SPARE = 128


class History:
    """
    The last positions of V vehicles, interpolated at even times.

    Parameters
    ----------
    vehicles, dimension, slots : int
        V, D and how many positions are kept, S.

    Attributes
    ----------
    position : (V, S, D) float64
        [m]; the last one is of the last whole multiple of `SLOT`.
    variance : (V, S) float64
        Of each, mean of the axes [m^2]; infinite where nothing is known.
    stamp : (V,) float64
        Time of the last position learned [s], -inf if there is none.
    mean, covariance : (V, D), (V, D, D) float64
        What was learned last [m, m^2].

    """

    def __init__(self, vehicles: int, dimension: int, slots: int):
        self._slot = -math.inf
        self._slots = self._end = slots
        self._position = np.zeros((vehicles, slots + _SPARE, dimension))
        self._variance = np.full((vehicles, slots + _SPARE), np.inf)
        self.stamp = np.full(vehicles, -np.inf)
        self.mean = np.zeros((vehicles, dimension))
        self.covariance = np.zeros((vehicles, dimension, dimension))

    @property
    def position(self) -> Array:
        """(V, S, D) float64: see the class."""
        return self._position[:, self._end - self._slots:self._end]

    @property
    def variance(self) -> Array:
        """(V, S) float64: see the class."""
        return self._variance[:, self._end - self._slots:self._end]

    def forget(self, which: Array | int) -> None:
        """Drop what is known of these vehicles, an index or (V,) bool."""
        self.variance[which] = np.inf
        self.stamp[which] = -np.inf

    def learn(self, stamp: float, mean: Array, covariance: Array, which: Array) -> Array:
        """
        Take in where these vehicles (V,) bool are, unless that is not finite.

        Parameters
        ----------
        stamp : float
            [s].
        mean, covariance : (V, D), (V, D, D) float
            [m, m^2].
        which : (V,) bool
            Of whom.

        Returns
        -------
        (R,) int
            The vehicles of whom something was learned.

        """
        self.pass_time(stamp)
        variance = axis_variance(covariance)
        rows = np.flatnonzero(which & np.isfinite(variance))
        if not len(rows):
            return rows
        since = self.stamp[rows]
        # What is not bridged fills but a slot of just this time.
        since = np.where(since < stamp - BRIDGED, np.nextafter(stamp, -np.inf), since)
        # None before the last time that somebody was heard is inside.
        recent = min(max(int(self._slot - since.min() / SLOT) + 1, 1),
                     int(BRIDGED / SLOT) + 1, self._slots)
        time = (self._slot - np.arange(recent)[::-1]) * SLOT
        inside = time > since[:, None]
        passed = np.maximum(stamp - since[:, None], 1e-12)
        share = np.minimum((time - since[:, None]) / passed, 1)
        before = self.mean[rows]
        between = before[:, None] + share[:, :, None] * (mean[rows] - before)[:, None]
        self.position[rows, -recent:] = np.where(
            inside[:, :, None], between, self.position[rows, -recent:])
        self.variance[rows, -recent:] = np.where(
            inside, variance[rows, None], self.variance[rows, -recent:])
        self.stamp[rows], self.mean[rows] = stamp, mean[rows]
        self.covariance[rows] = covariance[rows]
        return rows

    def velocity(self, rows: Array, base: int) -> Array:
        """Return the mean velocity [m/s] (R, D) over the last slots, NaN where unknown."""
        elapsed = self.stamp[rows] - (self._slot - base) * SLOT
        change = self.mean[rows] - self.position[rows, -1 - base]
        known = np.isfinite(self.variance[rows, -1 - base])
        return np.asarray(np.where(known[:, None], change / elapsed[:, None], np.nan))

    def last(self, count: int) -> tuple[Array, Array, Array]:
        """
        Return the last positions that are known.

        Returns
        -------
        position : (V, count, D) float
            [m].
        time : (V,) float
            Of the last of them [s].
        known : (V,) bool
            Who has as many in a row.

        """
        there = np.isfinite(self.variance)
        size = there.shape[1]
        end = size - 1 - there[:, ::-1].argmax(axis=1)
        slot = np.maximum(end[:, None] - np.arange(count)[::-1], 0)
        known = np.take_along_axis(there, slot, axis=1).all(axis=1) & (end >= count - 1)
        position = np.take_along_axis(self.position, slot[:, :, None], axis=1)
        return position, (self._slot + end + 1 - size) * SLOT, known

    def pass_time(self, stamp: float) -> None:
        """Let the last slot be the one of this time [s]."""
        slot = math.floor(stamp / SLOT)
        passed = int(min(slot - self._slot, self._slots))
        if passed > 0:
            if self._end + passed > self._variance.shape[1]:
                kept = self._slots - passed
                for values in (self._position, self._variance):
                    values[:, :kept] = values[:, self._end - kept:self._end]
                self._end = kept
            self._position[:, self._end:self._end + passed] = 0
            self._variance[:, self._end:self._end + passed] = np.inf
            self._end += passed
            self._slot = slot


def axis_variance(covariance: Array) -> Array:
    """Return the mean variance of an axis (V,) [m^2]."""
    return np.asarray(np.trace(covariance, axis1=1, axis2=2) / covariance.shape[1])
