"""How far what is heard contradicts where vehicles were expected to be, reference by reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.belief import Sight
from tsmcl_ros.model.bounds import Bounds, bounds
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Observation


@dataclass(frozen=True, eq=False)
class Deviations:
    """
    What V vehicles heard, and did not hear, against what they expected.

    Attributes
    ----------
    sender : (V, R) int
        Identities; a sender may stand in several columns.
    said : (V, R) bool
        False where nothing is said, or nothing was expected.
    silent : (V, R) bool
        True where it is an anchor's silence that says something.
    disk : (V, R) bool
        True where it is that a sender was heard, rather than a measurement.
    deviation : (V, R) float
        By how many standard deviations it contradicts, of all that is uncertain: belief,
        reference and measurement; 0 where it agrees.

    """

    sender: Array
    said: Array
    silent: Array
    disk: Array
    deviation: Array

    def contradicts(self, limit: float) -> Array:
        """Return what (V, R) bool is further off than so many standard deviations."""
        return np.asarray(self.said & (self.deviation > limit))

    def counts(self, limit: float) -> Array:
        """Return what (V, R) bool says anything: a silence is no news unless it contradicts."""
        return np.asarray(self.said & (~self.silent | self.contradicts(limit)))


def deviations(channel: Channel, observation: Observation, mean: Array, covariance: Array
               ) -> Deviations:
    """
    Compare an observation with a belief, taken to be Gaussian, from before it was known.

    Parameters
    ----------
    channel : Channel
        Tells what measurements and their absence mean.
    observation : Observation
        Of V vehicles.
    mean, covariance : (V, D), (V, D, D) float
        The predicted belief [m, m^2]; NaN where there is none.

    """
    known = np.isfinite(mean).all(axis=1)
    belief = (np.where(known[:, None], mean, 0),
              np.where(known[:, None, None], covariance, np.eye(mean.shape[1])))
    distance, std, ranged = channel.distances(observation)
    powered = channel.powered(observation)
    measured = ranged | powered
    bound, columns = bounds(channel, observation, measured), []
    if bound.used.any() or not measured.any():
        columns.append((bound.sender, bound.used, bound.silent, ~bound.silent,
                        _of_bounds(belief, bound)))
    if measured.any():
        no = np.zeros(measured.shape[1], bool)
        columns.append((observation.sender, measured, no, no, np.maximum(
            _of_ranges(belief, observation, distance, std, ranged),
            _of_powers(channel, belief, observation, powered))))
    sender, used, silence, heard, deviation = zip(*columns, strict=True)
    said = np.concatenate(used, axis=1) & known[:, None]
    return Deviations(
        np.concatenate(sender, axis=1), said,
        np.broadcast_to(np.concatenate(silence), said.shape),
        np.broadcast_to(np.concatenate(heard), said.shape),
        np.where(said, np.concatenate(deviation, axis=1), 0))


def _of_ranges(belief: tuple[Array, Array], observation: Observation, distance: Array,
               std: Array, ranged: Array) -> Array:
    """Return by how many standard deviations ranges (V, K) are off."""
    if not ranged.any():
        return np.zeros(ranged.shape)
    expected, variance = _expected(belief, observation.position, observation.covariance)
    return np.where(ranged, np.abs(distance - expected) / np.sqrt(std ** 2 + variance), 0)


def _of_powers(channel: Channel, belief: tuple[Array, Array], observation: Observation,
               powered: Array) -> Array:
    """Return by how many standard deviations rssi (V, K) is off."""
    if not powered.any():
        return np.zeros(powered.shape)
    loss = channel.path_loss(observation.sender)
    measured = loss.log_distance(np.where(powered, observation.rssi, 0))
    expected, variance = _expected(
        belief, observation.position, observation.covariance, logarithmic=True)
    std = 1 / loss.slope
    return np.where(powered, np.abs(measured - expected) / np.sqrt(std ** 2 + variance), 0)


def _of_bounds(belief: tuple[Array, Array], bound: Bounds) -> Array:
    """Return by how many standard deviations distances (V, B) are on the wrong side."""
    expected, variance = _expected(belief, bound.position, bound.covariance, bound.logarithmic)
    wrong = bound.side * (expected - bound.limit)
    return np.asarray(np.maximum(wrong, 0) / np.sqrt(bound.std ** 2 + variance))


def _expected(belief: tuple[Array, Array], position: Array, known: Array,
              logarithmic: bool = False) -> tuple[Array, Array]:
    """Return mean and variance (V, K) of distances, or of their log10, to (V, K, D) [m]."""
    mean, covariance = belief
    rows, size = position.shape[:2], position.shape[2]
    covariance = np.repeat(covariance, rows[1], axis=0)
    sight = Sight.to(np.repeat(mean, rows[1], axis=0), covariance,
                     position.reshape(-1, size), known.reshape(-1, size, size))
    if logarithmic:
        sight = sight.on_log_scale(covariance)
    variance = gaussian.innovation_variance(covariance, sight.gradient, sight.variance)
    return sight.expected.reshape(rows), variance.reshape(rows)
