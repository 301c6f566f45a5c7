"""
Extended Kalman filter on whatever a channel offers: what all methods with Gaussian beliefs share.

Placed by linearised least squares, moved by constant velocity for whatever time has passed (or by
odometry), updated in Joseph form. Ranges are expected to second order, so that broad beliefs are
honest; a measurement counts as much as it is likely to be sound; rssi is a range on a log scale;
and who was merely heard, or was silent, bounds the range, or weighs the belief's points where
nothing is measured. Where ranges cannot place a vehicle, the
moments of all evidence do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.belief import Beliefs
from tsmcl_ros.model.bounds import bounds
from tsmcl_ros.model.cloud import RecoveryConfig
from tsmcl_ros.model.kinematics import kinematics_of, move
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.particles import effective_sample_size, moments, normalize
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.sampling import even_shares
from tsmcl_ros.types import Array, Estimate, Motion, Observation, Prior

# Points at which the evidence that places a vehicle is looked at.
_POINTS = 2048
# How much of a way is news that is known, and that may lead anywhere.
_ALONG, _ASIDE = 0.9, 1.8
_DRAWN = 512  # points of a belief that evidence without a measurement weighs


class GaussianFilter:
    """
    EKF of V vehicles: everything but what a method reports of it.

    Parameters
    ----------
    config : RecoveryConfig
        When a vehicle is placed anew.
    channel : Channel
    motion : MotionModel
    vehicles, dimension : int
        V and D.
    rng : numpy.random.Generator
        Spreads the points at which evidence is looked at.

    Attributes
    ----------
    beliefs : Beliefs
        Position, then what the motion model remembers.
    placed : (V,) bool
        False for a vehicle that never heard a beacon.

    """

    def __init__(self, config: RecoveryConfig, channel: Channel, motion: MotionModel,
                 vehicles: int, dimension: int, rng: np.random.Generator):
        self._recovery = config
        self.channel = channel
        self.dimension = dimension
        self.rng = rng
        self.kinematics = kinematics_of(motion, dimension)
        self.beliefs = Beliefs(vehicles, dimension + self.kinematics.extra, dimension,
                               channel.switches.outlier_fraction)
        self.placed = np.zeros(vehicles, bool)
        self._doubts = np.zeros(vehicles, int)
        self._moved = np.zeros(vehicles)

    @property
    def particles(self) -> Array:
        """(V, 0, D) float32: a Gaussian has none."""
        return np.zeros((len(self.placed), 0, self.dimension), np.float32)

    def moments(self) -> tuple[Array, Array]:
        """Return mean (V, D) [m] and covariance (V, D, D) [m^2], NaN where unplaced."""
        size, unknown = self.dimension, ~self.placed
        return (np.where(unknown[:, None], np.nan, self.beliefs.mean[:, :size]),
                np.where(unknown[:, None, None], np.nan, self.beliefs.covariance[:, :size, :size]))

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior."""
        self._place(np.array([prior.vehicle]), prior.mean, prior.covariance, prior)

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts anew at its next beacon."""
        self.placed[vehicle] = False

    def predict(self, motion: Motion) -> None:
        """Move the beliefs by the motion since the last epoch."""
        beliefs = self.beliefs
        beliefs.mean, beliefs.covariance, way, spread = move(
            self.kinematics, self.dimension, beliefs.mean, beliefs.covariance, motion)
        self._moved += np.sqrt(_ALONG ** 2 * np.square(way).sum(axis=1) + _ASIDE ** 2 * np.maximum(
            np.trace(spread, axis1=1, axis2=2), 0))

    def take_in(self, observation: Observation) -> Array:
        """
        Take in what was heard, one reference after the other; place who is new or lost.

        Returns
        -------
        (V,) bool
            Who was lost.

        """
        heard = observation.heard.any(axis=1)
        known = self.placed & heard
        before = self.beliefs.mean, self.beliefs.covariance
        self.beliefs.begin()
        measured = self.channel.measured(observation)
        vague = known & ~measured.any(axis=1)
        self._measure(observation, known)
        self._bound(observation, known & ~vague, measured)
        if vague.any():
            self._weigh(np.flatnonzero(vague), observation)
        lost = self._lost(known)
        self.beliefs.keep(lost, *before)
        self._locate(np.flatnonzero((heard & ~self.placed) | lost), observation)
        return lost

    def estimate(self, observation: Observation, lost: Array, period_factor: Array | None = None
                 ) -> Estimate:
        """Return the beliefs' positions, and who was lost."""
        beliefs = self.beliefs
        mean, covariance = self.moments()
        heard = observation.heard.sum(axis=1)
        rotation, rotation_variance = self.kinematics.rotation(beliefs.mean, beliefs.covariance)
        unknown = ~self.placed
        return Estimate(
            stamp=observation.stamp,
            mean=mean, covariance=covariance,
            rotation=np.where(unknown, np.nan, rotation),
            rotation_variance=np.where(unknown, np.nan, rotation_variance),
            ess=np.zeros(len(unknown)), particles=0,
            log_likelihood=np.where(heard > 0, beliefs.log_likelihood, np.nan),
            heard=heard, reinitialized=lost, period_factor=period_factor)

    def _measure(self, observation: Observation, known: Array) -> None:
        """Take in ranges and rssi."""
        distance, std, ranged = self.channel.distances(observation)
        powered = self.channel.powered(observation)
        loss = self.channel.path_loss(observation.sender)
        measured = loss.log_distance(observation.rssi)
        for row in range(ranged.shape[1]):
            reference = observation.position[:, row], observation.covariance[:, row]
            if (used := ranged[:, row] & known).any():
                self.beliefs.measure(used, self.beliefs.sight(*reference), distance[:, row],
                                     std[:, row] ** 2)
            if (used := powered[:, row] & known).any():
                self.beliefs.measure(
                    used, self.beliefs.sight(*reference).on_log_scale(self.beliefs.covariance),
                    measured[:, row],
                    (loss.sigma[:, row] / (10 * loss.exponent[:, row])) ** 2)

    def _weigh(self, vehicle: Array, observation: Observation) -> None:
        """
        Take in what vehicles (W,) int heard that measured nothing, as a Gaussian particle filter.

        Beliefs as wide as radios reach know no gradient: what lies beside a disk lies on all its
        sides. So points of the belief are weighed (Kotecha and Djuric 2003).
        """
        beliefs, size = self.beliefs, self.dimension
        evidence = self.channel.evidence(observation)
        mean, covariance = beliefs.mean[vehicle], beliefs.covariance[vehicle]
        known = covariance[:, :size, :size]
        share = even_shares(np.arange(_DRAWN), len(vehicle), size, self.rng)
        drawn = scipy.special.ndtri(np.clip(share, 1e-6, 1 - 1e-6))
        points = (mean[:, None, :size] + drawn @ np.swapaxes(
            np.linalg.cholesky(known), 1, 2)).astype(np.float32)
        likelihood = evidence.log_likelihood_of(
            points.reshape(-1, size), np.repeat(vehicle, _DRAWN))
        likelihood = likelihood.reshape(len(vehicle), -1)
        best, terms = likelihood.max(axis=1), evidence.terms[vehicle]
        weights, total = normalize(likelihood)
        place, spread = moments(points, weights, error=1 / effective_sample_size(weights))
        # What comes with the position follows it as far as they belong together.
        gain = np.swapaxes(np.linalg.solve(known, covariance[:, :size]), 1, 2)
        news = self._news(vehicle)
        place = mean[:, :size] + news * (place - mean[:, :size])
        spread = known + news[:, :, None] * (spread - known)
        beliefs.mean, beliefs.covariance = beliefs.mean.copy(), beliefs.covariance.copy()
        beliefs.mean[vehicle] = mean + np.einsum('wni,wi->wn', gain, place - mean[:, :size])
        beliefs.covariance[vehicle] = covariance + gain @ (spread - known) @ np.swapaxes(
            gain, 1, 2)
        beliefs.count(vehicle, total - np.log(_DRAWN), best, terms)

    def _news(self, vehicle: Array) -> Array:
        """
        Return how much of what vehicles (W,) int hear is news, (W, 1) from 0 to 1.

        A Gaussian forgets where it was cut, and must not be cut by the same edges again. So only
        the way is news that it has gone past the edges since, against the belief's mean width. A
        way that may lead anywhere passes edges on all sides. Of half of it beliefs are too
        careful, of twice of it too certain.
        """
        size = self.dimension
        volume = np.linalg.det(self.beliefs.covariance[vehicle, :size, :size])
        news = np.minimum(self._moved[vehicle] / volume ** (1 / (2 * size)), 1)
        self._moved[vehicle] = 0
        return np.asarray(news[:, None])

    def _bound(self, observation: Observation, known: Array, measured: Array) -> None:
        """Take in who was heard without being measured, and who was silent."""
        bound = bounds(self.channel, observation, measured)
        # Ranges make silence superfluous.
        used = bound.used & known[:, None] & ~(
            bound.silent & measured.any(axis=1, keepdims=True))
        for row in np.flatnonzero(used.any(axis=0)).tolist():
            sight = self.beliefs.sight(bound.position[:, row], bound.covariance[:, row])
            if bound.logarithmic:
                sight = sight.on_log_scale(self.beliefs.covariance)
            self.beliefs.bound(used[:, row], sight, bound.limit[:, row], int(bound.side[row]),
                               bound.std[:, row] ** 2, bound.missed[:, row])

    def _lost(self, known: Array) -> Array:
        """Return which vehicles (V,) bool are not where they are believed to be."""
        beliefs, config = self.beliefs, self._recovery
        self._doubts = np.where(beliefs.doubtful, self._doubts + 1,
                                np.where(known, 0, self._doubts))
        hopeless = config.excludes(beliefs.fit, beliefs.terms)
        return np.asarray(known & (hopeless | (self._doubts >= config.patience)))

    def _locate(self, vehicle: Array, observation: Observation) -> None:
        """Place vehicles (W,) int by their ranges, or else by all evidence."""
        if not len(vehicle):
            return
        distance, std, used = (part[vehicle] for part in self.channel.distances(observation))
        reference, spread = observation.position[vehicle], observation.covariance[vehicle]
        variance = std ** 2 + np.trace(spread, axis1=2, axis2=3) / self.dimension
        fix = gaussian.multilaterate(reference, distance, variance, used)
        spare = np.maximum(used.sum(axis=1) - self.dimension, 0)
        # Three standard deviations of a chi-square distribution: else there are outliers.
        sound = fix.solved & (fix.misfit < spare + 3 * np.sqrt(2 * spare) + 3)
        if sound.any():
            self._place(vehicle[sound], fix.position[sound], fix.covariance[sound])
        if not sound.all():
            self._locate_by_evidence(vehicle[~sound], observation)

    def _locate_by_evidence(self, vehicle: Array, observation: Observation) -> None:
        """Place vehicles (W,) int where the moments of their evidence are."""
        box = self.channel.evidence(observation).box
        side = (box[:, 1] - box[:, 0]).max(axis=1) / _POINTS ** (1 / self.dimension)
        # The peaks of ranges must not fall between the points, however many make one.
        _, std, used = self.channel.distances(observation)
        grain = side * np.sqrt(np.maximum(used.sum(axis=1), 1))
        blurred = np.hypot(std * self.channel.calibration.scale, grain[:, None])
        evidence = self.channel.evidence(replace(observation, range_std=blurred))
        low, high = box[vehicle, :1], box[vehicle, 1:]
        points = low + (high - low) * self.rng.random(
            (len(vehicle), _POINTS, self.dimension), np.float32)
        likelihood = evidence.log_likelihood_of(
            points.reshape(-1, self.dimension), np.repeat(vehicle, _POINTS))
        weights, _ = normalize(likelihood.reshape(len(vehicle), _POINTS))
        mean, covariance = moments(points, weights)
        grain = np.maximum(side[vehicle] ** 2 / 12, 1e-6)[:, None, None]
        self._place(vehicle, mean, covariance + grain * np.eye(self.dimension))

    def _place(self, vehicle: Array, mean: Array, covariance: Array, prior: Prior | None = None
               ) -> None:
        """Give vehicles (W,) int new beliefs."""
        self.beliefs.place(vehicle, mean, covariance, self.kinematics.begin(prior))
        self.placed[vehicle] = True
        self._doubts[vehicle] = self._moved[vehicle] = 0
