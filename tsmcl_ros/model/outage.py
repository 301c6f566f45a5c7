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
from tsmcl_ros.model.azimuth import farthest, grey_azimuth
from tsmcl_ros.model.gaussian import azimuth_of, innovation_variance, update
from tsmcl_ros.model.history import axis_variance, History, SLOT
from tsmcl_ros.model.mobility import wrap
from tsmcl_ros.types import Array, Estimate, Observation, Prior

SLOTS = 512  # of a history
_BASE = 3  # slots that a velocity is measured over
_LEAST = 12  # slots that a history must have to tell anything
# A displacement over a third of the history is the longest of which it holds enough examples.
_SHARE = 3
# Longer ones are off by more, at a rate between those of a random walk, 1/2, and of a straight
# line, 1, which are of the standard deviation: in the variance 1 and 2.
_GROWTH = 1.5
# A method whose variance is this many times that of the prediction may learn from it.
_WIDER = 4.0


class OutagePredictor:
    """
    The histories of V vehicles, and what they predict.

    Parameters
    ----------
    vehicles, dimension : int
        V and D.
    grey : bool
        Whether positions are led on by their grey azimuths as well (Zhuo et al.), seen from the
        farthest reference that was heard last.

    """

    def __init__(self, vehicles: int, dimension: int, grey: bool = False):
        self.grey = grey
        self._station = np.zeros((vehicles, 2))
        self.history = History(vehicles, dimension, SLOTS)
        self._velocity = np.full((vehicles, dimension), np.nan)
        self._grown = np.zeros(vehicles)
        self._adrift = np.zeros(vehicles, bool)

    def forget(self, which: Array | int) -> None:
        """Drop the histories of these vehicles, an index or (V,) bool."""
        self.history.forget(which)
        self._adrift[which] = False

    def learn(self, estimate: Estimate, observation: Observation) -> None:
        """Take in the estimates of those who heard something."""
        which = observation.heard.any(axis=1)
        if self.grey:
            seen_from = farthest(estimate.mean, observation.position, observation.heard)
            self._station[which] = seen_from[which]
        rows = self.history.learn(estimate.stamp, estimate.mean, estimate.covariance, which)
        self._velocity[rows] = self.history.velocity(rows, _BASE)
        self._grown[rows] = 0
        self._adrift[rows] = False

    def ready(self) -> Array:
        """Return which vehicles (V,) bool have a history long enough to predict from."""
        return np.asarray(np.isfinite(self.history.variance).sum(axis=1) >= _LEAST)

    def replace(self, estimate: Estimate, which: Array) -> Estimate:
        """
        Return an estimate in which these vehicles (V,) bool are where their past leads them.

        Those whose past is too short are left as they are.
        """
        rows = np.flatnonzero(which & self.ready())
        if not len(rows):
            return estimate
        own = axis_variance(estimate.covariance[rows])
        mean, covariance = estimate.mean.copy(), estimate.covariance.copy()
        mean[rows], covariance[rows], (lead, _) = self._predict(rows, estimate.stamp)
        wider = own > _WIDER * axis_variance(covariance[rows])
        forgotten = lead < (estimate.stamp - self.history.stamp[rows]) / 2
        self._adrift[rows] = wider & forgotten
        return replace(estimate, mean=mean, covariance=covariance)

    def resume(self, stamp: float, which: Array) -> list[Prior]:
        """
        Return what to tell a method of those vehicles (V,) bool that are heard again [s].

        They are those whose velocity is forgotten, and of whom it has become far less certain
        than their past warrants: after a long outage a cloud lies so thin that it takes long to
        gather where the vehicle is.
        """
        rows = np.flatnonzero(which & self._adrift)
        if not len(rows):
            return []
        mean, covariance, (_, pace) = self._predict(rows, stamp)
        return [Prior(vehicle, mean[row], covariance[row], velocity_std=float(pace[row]))
                for row, vehicle in enumerate(rows.tolist())]

    def _predict(self, rows: Array, stamp: float
                 ) -> tuple[Array, Array, tuple[Array, Array]]:
        """
        Return where vehicles (R,) int are at a time [s].

        Returns
        -------
        mean, covariance : (R, D), (R, D, D) float
            [m, m^2].
        lead, pace : (R,) float
            How far their velocity leads [s]; standard deviation of an axis of it [m/s].

        """
        history = self.history
        lead, grown, pace = self._ahead(rows, stamp - history.stamp[rows])
        # What is once unknown of a vehicle is not found again by waiting.
        self._grown[rows] = grown = np.maximum(self._grown[rows], grown)
        mean = history.mean[rows] + lead[:, None] * np.nan_to_num(self._velocity[rows])
        noise = grown[:, None, None] * np.eye(mean.shape[1])
        covariance = history.covariance[rows] + noise
        if self.grey:
            mean = self._turned(rows, mean, covariance, stamp)
        return mean, covariance, (lead, pace)

    def _turned(self, rows: Array, mean: Array, covariance: Array, stamp: float) -> Array:
        """
        Return the means (R, D) after the grey azimuths.

        The same past tells these, so they are no news and leave the covariance as it is; and over
        a long time they go astray like an exponential, so what contradicts it is not believed.
        """
        azimuth, variance = (part[rows] for part in grey_azimuth(
            self.history, self._station, stamp))
        expected, gradient = azimuth_of(mean, self._station[rows])
        residual = wrap(azimuth - expected)
        # The vehicle strays from its azimuth as it does from its velocity.
        certain = innovation_variance(covariance, gradient, np.zeros(len(rows)))
        variance = variance + certain
        sound = residual ** 2 < certain + variance
        led, _ = update(mean, covariance, gradient, residual, np.where(sound, variance, np.inf))
        return led

    def _ahead(self, rows: Array, horizon: Array) -> tuple[Array, Array, Array]:
        """
        Return how far a velocity leads, the variance of an axis of where to, and the pace.

        Parameters
        ----------
        rows : (R,) int
            Vehicles.
        horizon : (R,) float
            [s].

        Returns
        -------
        lead, variance, pace : (R,) float
            Displacement per velocity [s]; [m^2]; standard deviation of velocities [m/s].

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
        pace = pace / dimension
        unseen = pace * _straying(horizon, span * SLOT)
        return lead, np.maximum(off, unseen), np.sqrt(pace)


def _straying(horizon: Array, memory: Array) -> Array:
    """
    Return the variance after a time [s] of an Ornstein-Uhlenbeck velocity of 1 m/s [m^2].

    Whoever was never seen to turn may still do so within a time such as that he was seen for.
    """
    ratio = np.minimum(horizon / memory, 1e6)
    return np.asarray(memory ** 2 * np.maximum(
        2 * ratio - 3 + 4 * np.exp(-ratio) - np.exp(-2 * ratio), 0))
