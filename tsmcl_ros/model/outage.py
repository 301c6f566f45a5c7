"""
Where vehicles are while nothing is heard of them, told from how they moved before.

A velocity leads far astray in a long outage, and no assumption on accelerations fits a mower and a
car alike. But a vehicle's own past tells how well its velocity predicts the way ahead: over each
horizon, displacements are regressed on the velocities before them. So a velocity is forgotten as
fast as this vehicle used to lose it, and the uncertainty grows as it did then.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tsmcl_ros.model.history import axis_variance, History, SLOT
from tsmcl_ros.types import Array, Estimate

SLOTS = 512  # of a history
_BASE = 3  # slots that a velocity is measured over
_LEAST = 12  # slots that a history must have to tell anything
# A displacement over a third of the history is the longest of which it holds enough examples.
_SHARE = 3
# Longer ones are off by more, at a rate between those of a random walk, 1/2, and of a straight
# line, 1, which are of the standard deviation: in the variance 1 and 2.
_GROWTH = 1.5


class OutagePredictor:
    """
    The histories of V vehicles, and what they predict.

    Parameters
    ----------
    vehicles, dimension : int
        V and D.
    """

    def __init__(self, vehicles: int, dimension: int):
        self.history = History(vehicles, dimension, SLOTS)
        self._velocity = np.full((vehicles, dimension), np.nan)
        self._grown = np.zeros(vehicles)

    def forget(self, which: Array | int) -> None:
        """Drop the histories of these vehicles, an index or (V,) bool."""
        self.history.forget(which)

    def learn(self, estimate: Estimate, which: Array) -> None:
        """Take in the estimates of these vehicles (V,) bool, who heard something."""
        rows = self.history.learn(estimate.stamp, estimate.mean, estimate.covariance, which)
        self._velocity[rows] = self.history.velocity(rows, _BASE)
        self._grown[rows] = 0

    def ready(self) -> Array:
        """Return which vehicles (V,) bool have a history long enough to predict from."""
        return np.asarray(np.isfinite(self.history.variance).sum(axis=1) >= _LEAST)

    def replace(self, estimate: Estimate, which: Array) -> Estimate:
        """
        Return an estimate in which these vehicles (V,) bool are where their past leads them.

        Those whose past is too short are left as they are.
        """
        self.history.pass_time(estimate.stamp)
        rows = np.flatnonzero(which & self.ready())
        if not len(rows):
            return estimate
        lead, grown = self._ahead(rows, estimate.stamp - self.history.stamp[rows])
        velocity = np.nan_to_num(self._velocity[rows])
        # What is once unknown of a vehicle is not found again by waiting.
        self._grown[rows] = grown = np.maximum(self._grown[rows], grown)
        mean, covariance = estimate.mean.copy(), estimate.covariance.copy()
        mean[rows] = self.history.mean[rows] + lead[:, None] * velocity
        noise = grown[:, None, None] * np.eye(mean.shape[1])
        covariance[rows] = self.history.covariance[rows] + noise
        return replace(estimate, mean=mean, covariance=covariance)

    def _ahead(self, rows: Array, horizon: Array) -> tuple[Array, Array]:
        """
        Return how far a velocity leads, and the variance per axis of where it leads to.

        Parameters
        ----------
        rows : (R,) int
            Vehicles.
        horizon : (R,) float
            [s].

        Returns
        -------
        lead, variance : (R,) float
            Displacement per velocity [s]; [m^2].
        """
        position, variance = self.history.position[rows], self.history.variance[rows]
        dimension = position.shape[2]
        known = np.isfinite(variance)
        span = known.sum(axis=1)
        lag = np.clip(np.round(horizon / SLOT), 1, np.maximum(span // _SHARE, 1)).astype(int)
        now = axis_variance(self.history.covariance[rows])[:, None]
        # Estimates that were less certain than the last one tell less.
        weight = np.where(known, now / np.maximum(variance, np.maximum(now, 1e-12)), 0)
        start, weight_start = position[:, _BASE:], weight[:, _BASE:] * weight[:, :-_BASE]
        velocity = (start - position[:, :-_BASE]) / (_BASE * SLOT)
        ahead = np.arange(start.shape[1]) + lag[:, None]
        inside = ahead < start.shape[1]
        ahead = np.where(inside, ahead, 0)
        weight_end = np.take_along_axis(weight[:, _BASE:], ahead, axis=1)
        weight = np.where(inside, weight_start * weight_end, 0)
        way = np.take_along_axis(start, ahead[:, :, None], axis=1) - start
        total = np.maximum(weight.sum(axis=1), 1e-12)

        def mean(values: Array) -> Array:
            return np.asarray((weight * values.sum(axis=2)).sum(axis=1) / total)

        # Ways that overlap are one example (and Kish's count, as they weigh differently).
        count = total ** 2 / np.maximum(np.square(weight).sum(axis=1), 1e-12)
        examples = np.maximum(count / np.maximum(lag, _BASE), 1)
        pace = np.maximum(mean(velocity * velocity), 1e-12)
        lead = mean(way * velocity) / pace * examples / (examples + 1)
        lead = np.clip(lead, 0, lag * SLOT)
        lead = np.where(np.isnan(self._velocity[rows]).any(axis=1), 0, lead)
        off = mean(np.square(way - lead[:, None, None] * velocity)) / dimension
        # The variance of Student's t, as that of a few examples is not known.
        off *= 1 + 2 / examples
        off *= np.maximum(horizon / (lag * SLOT), 1) ** _GROWTH
        unseen = pace / dimension * _straying(horizon, span * SLOT)
        return lead, np.maximum(off, unseen)


def _straying(horizon: Array, memory: Array) -> Array:
    """
    Return the variance after a time [s] of an Ornstein-Uhlenbeck velocity of 1 m/s [m^2].

    Whoever was never seen to turn may still do so within a time such as that he was seen for.
    """
    ratio = np.minimum(horizon / memory, 1e6)
    return np.asarray(memory ** 2 * np.maximum(
        2 * ratio - 3 + 4 * np.exp(-ratio) - np.exp(-2 * ratio), 0))
