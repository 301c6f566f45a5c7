"""
Online calibration of range measurements: their scale and offset, one pair for a fleet.

Ranges alone say neither: a vehicle that takes its own estimates for the truth learns what it has
supposed. So each vehicle has a second, Gaussian belief, of where it is and of the calibration
together, moved by the same motion. In its covariance stands how much a wrong scale would have
moved the vehicle; what then contradicts ranges all around, or odometry, is news of the scale.
"""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.belief import Beliefs, Sight
from tsmcl_ros.model.joint_fix import joint_fix
from tsmcl_ros.model.kinematics import Kinematics
from tsmcl_ros.model.learnt import aged, LearntRanges
from tsmcl_ros.model.settling import settled
from tsmcl_ros.types import Array, Estimate, Motion, Observation, Prior

# Share of its prior that a calibration forgets in an epoch, so that it never quite freezes.
_FORGOTTEN = 1e-6
# Epochs in a row of which most ranges are outliers to a belief, before it is begun anew.
_PATIENCE = 5
# Squared distance from an estimate, in standard deviations of both, at which it is begun anew.
_ASTRAY = 25.0
# The estimate that a belief begins with has used ranges of the same calibration, which is not in
# its covariance.
_INFLATION = 4.0
# Vehicles that are located and calibrated in an epoch: few tell a fleet's calibration well.
_TOGETHER = 32
# How sure [rad] of its heading a belief is, and how many times more so than a cloud, or how many
# standard deviations of both away, to be put in the cloud's place.
_SURE, _BETTER, _AGAINST = 0.1, 3.0, 4.0


class RangeCalibration:
    """
    Scale and offset of ranges, estimated together with where the vehicles are.

    Parameters
    ----------
    scale : float
        Initial scale.
    bias : float
        Initial offset [m].
    std : (2,) float
        How far off both may be.

    Attributes
    ----------
    scale : float
        Measured over true range.
    bias : float
        Measured minus scaled true range [m].
    covariance : (2, 2) float
        Of both, as far as it is estimated: 0 before `follow`.

    """

    def __init__(self, scale: float, bias: float, std: tuple[float, float]):
        self._begin = np.array([scale, bias])
        self._prior = self._configured = np.diag(np.square(std))
        self.scale, self.bias, self.covariance = scale, bias, np.zeros((2, 2))
        self._beliefs: Beliefs | None = None

    def follow(self, kinematics: Kinematics, vehicles: int, dimension: int, floor: float) -> None:
        """
        Begin to follow vehicles.

        Parameters
        ----------
        kinematics : Kinematics
            How they move.
        vehicles, dimension : int
            V and D.
        floor : float
            Share of ranges that may say anything.

        """
        learnt = self.learnt
        self._kinematics, self.covariance = kinematics, self._prior
        self._scale = dimension + kinematics.extra
        self._known = slice(self._scale, self._scale + 2)
        self._beliefs = Beliefs(vehicles, self._scale + 2, dimension, floor)
        self._beliefs.mean[:, self._known] = self._begin
        self._beliefs.covariance[:, self._known, self._known] = self._prior
        self._placed = np.zeros(vehicles, bool)
        self._taught = np.zeros(vehicles, bool)
        self._fresh = np.zeros(vehicles, bool)
        self._doubts = np.zeros(vehicles, int)
        if learnt is not None:
            self.resume(learnt)

    @property
    def learnt(self) -> LearntRanges | None:
        """What another one can begin with, None if ranges have told nothing yet."""
        if not self.is_taught:
            return None
        return LearntRanges(np.array([self.scale, self.bias]), self.covariance)

    def resume(self, learnt: LearntRanges) -> None:
        """Begin, as soon as vehicles are followed, with what another one has learnt."""
        beliefs = self._beliefs
        assert beliefs is not None
        self._begin = learnt.mean
        self._prior = aged(learnt.covariance, self._configured)
        self.scale, self.bias = map(float, self._begin)
        self.covariance = self._prior
        beliefs.mean[:, self._known] = self._begin
        beliefs.covariance[:, self._known, self._known] = self._prior

    @property
    def is_taught(self) -> bool:
        """Whether ranges have told anything yet."""
        return self._beliefs is not None and bool((self.covariance != self._prior).any())

    def variance(self, distance: Array) -> Array:
        """Return the variance [m^2] that the calibration leaves ranges of these distances [m]."""
        (scale, both), (_, bias) = self.covariance
        return np.asarray((scale * distance + 2 * both) * distance + bias)

    def predict(self, motion: Motion) -> None:
        """Move the vehicles."""
        beliefs = self._beliefs
        if beliefs is not None and self._placed.any():
            beliefs.mean, beliefs.covariance = self._kinematics.predict(
                beliefs.mean, beliefs.covariance, motion)

    def locate(self, observation: Observation, std: Array, used: Array) -> None:
        """
        Begin with vehicles that an epoch's ranges locate and calibrate at once.

        That is before anybody judges these ranges. As long as the calibration leaves them further
        off than their noise does, sound ones contradict each other as lies do.

        Parameters
        ----------
        observation, std, used
            As for `learn`; only ranges to anchors.

        """
        beliefs = self._beliefs
        if beliefs is None or self._placed.all():
            return
        size = beliefs.dimension
        variance = std ** 2 + np.trace(observation.covariance, axis1=2, axis2=3) / size
        rough = (used & (self.variance(observation.range) > variance)).any(axis=1)
        enough = used.sum(axis=1) > size + 2
        vehicle = np.flatnonzero(~self._placed & rough & enough)[:_TOGETHER]
        if not len(vehicle):
            return
        fix = joint_fix(
            observation.position[vehicle], observation.range[vehicle], variance[vehicle],
            used[vehicle], (beliefs.mean[vehicle, self._known],
                            beliefs.covariance[vehicle, self._known, self._known]))
        vehicle = vehicle[fix.solved]
        self._begin_at(vehicle, fix.mean[fix.solved], fix.covariance[fix.solved])
        self._taught[vehicle] = self._fresh[vehicle] = True
        self._share()

    def learn(self, observation: Observation, estimate: Estimate, std: Array, used: Array,
              anchors: Array) -> None:
        """
        Take in the ranges of an epoch.

        Parameters
        ----------
        observation : Observation
            Of V vehicles.
        estimate : Estimate
            Made from it.
        std : (V, K) float
            Standard deviation of each range [m].
        used : (V, K) bool
            The ranges that count.
        anchors : (V, K) bool
            Which are to anchors. Vehicles, whose positions may have been made with the same
            calibration, are no reason to begin.

        """
        beliefs = self._beliefs
        if beliefs is None:
            return
        self._placed &= self._narrow(observation, std, used)
        beliefs.begin()
        learns, self._fresh = self._placed & ~self._fresh, np.zeros_like(self._fresh)
        for row in np.flatnonzero((used & learns[:, None]).any(axis=0)).tolist():
            self._measure(used[:, row] & learns, observation, row, std[:, row] ** 2)
        self._judge(estimate)
        self._place(observation, estimate, std, used & anchors)
        self._share()

    def opinions(self, estimate: Estimate) -> list[Prior]:
        """
        Return better beliefs of vehicles whose heading has gone astray.

        A heading that no way has told yet is lost by chance from a cloud of few particles that is
        resampled while its vehicle stands; the Gaussian beliefs keep it open.

        Parameters
        ----------
        estimate : Estimate
            Of the cloud.

        """
        beliefs, told = self._beliefs, estimate.rotation_variance
        if beliefs is None or not (self._placed & (told > 0)).any():
            return []
        size = beliefs.dimension
        yaw, variance = self._kinematics.rotation(
            beliefs.mean[:, :self._scale], beliefs.covariance[:, :self._scale, :self._scale])
        off = np.remainder(estimate.rotation - yaw + np.pi, 2 * np.pi) - np.pi
        better = _BETTER ** 2 * variance < told
        against = off ** 2 > _AGAINST ** 2 * (told + variance)
        sure = self._placed & (self._doubts == 0) & (variance < _SURE ** 2)
        return [Prior(vehicle, beliefs.mean[vehicle, :size],
                      beliefs.covariance[vehicle, :size, :size], float(yaw[vehicle]),
                      float(np.sqrt(variance[vehicle])))
                for vehicle in np.flatnonzero(sure & (better | against)).tolist()]

    def _measure(self, used: Array, observation: Observation, row: int, variance: Array) -> None:
        beliefs = self._beliefs
        assert beliefs is not None
        sight = beliefs.sight(observation.position[:, row], observation.covariance[:, row])
        mean, covariance, at = beliefs.mean, beliefs.covariance, self._scale
        cross = np.einsum('vi,vi->v', sight.gradient, covariance[:, :, at])
        along = np.einsum('vi,vij,vj->v', sight.gradient, covariance, sight.gradient)
        gradient = mean[:, at, None] * sight.gradient
        gradient[:, at], gradient[:, at + 1] = sight.expected, 1
        expected = mean[:, at] * sight.expected + mean[:, at + 1] + cross
        # To second order: of the product of two uncertain factors.
        product = Sight(
            expected, gradient, mean[:, at] ** 2 * sight.variance
            + covariance[:, at, at] * along + cross ** 2)
        beliefs.measure(used, product, observation.range[:, row], variance)
        self._taught |= used

    def _narrow(self, observation: Observation, std: Array, used: Array) -> Array:
        """Return whose belief (V,) bool is not far too broad for ranges to be linear in it."""
        beliefs = self._beliefs
        assert beliefs is not None
        size = beliefs.dimension
        spread = np.trace(beliefs.covariance[:, :size, :size], axis1=1, axis2=2)[:, None]
        distance = np.maximum(observation.range, std)
        bent = used & (spread > np.maximum(16 * std * distance, distance ** 2 / 4))
        return np.asarray(~bent.any(axis=1))

    def _judge(self, estimate: Estimate) -> None:
        """Give up the beliefs that are not where their vehicle is."""
        beliefs = self._beliefs
        assert beliefs is not None
        size = beliefs.dimension
        self._doubts = np.where(
            beliefs.doubtful, self._doubts + 1, np.where(estimate.heard > 0, 0, self._doubts))
        off = estimate.mean - beliefs.mean[:, :size]
        spread = estimate.covariance + beliefs.covariance[:, :size, :size]
        known = self._placed & np.isfinite(off).all(axis=1)
        off, spread = np.where(known[:, None], off, 0), np.where(
            known[:, None, None], spread, np.eye(size))
        far = np.einsum('vi,vi->v', off, np.linalg.solve(spread, off[:, :, None])[:, :, 0])
        self._placed &= ~(estimate.reinitialized | (far > _ASTRAY) | (self._doubts >= _PATIENCE))

    def _place(self, observation: Observation, estimate: Estimate, std: Array, used: Array
               ) -> None:
        """Begin the beliefs of vehicles whose estimates are good for it."""
        beliefs = self._beliefs
        assert beliefs is not None
        size = beliefs.dimension
        distance = np.where(used, observation.range, np.nan)
        supposed = np.where(used, self.variance(distance), 0).sum(axis=1) / np.maximum(
            used.sum(axis=1), 1)
        covariance = (_INFLATION * estimate.covariance
                      + supposed[:, None, None] * np.eye(size))
        new = ~self._placed & used.any(axis=1) & settled(
            observation, estimate, (observation.range, std, used))
        if not new.any():
            return
        vehicle = np.flatnonzero(new)
        learnt = beliefs.covariance[vehicle, self._known, self._known]
        joint = np.zeros((len(vehicle), size + 2, size + 2))
        joint[:, :size, :size], joint[:, size:, size:] = covariance[vehicle], learnt
        self._begin_at(vehicle, np.concatenate(
            [estimate.mean[vehicle], beliefs.mean[vehicle, self._known]], axis=1), joint)

    def _begin_at(self, vehicle: Array, mean: Array, covariance: Array) -> None:
        """Begin the beliefs of vehicles (W,) int with position, scale and offset (W, D + 2)."""
        beliefs = self._beliefs
        assert beliefs is not None
        told = np.r_[:beliefs.dimension, self._known]
        rest = np.arange(beliefs.dimension, self._scale)
        beliefs.mean[np.ix_(vehicle, told)] = mean
        beliefs.covariance[vehicle] = 0
        beliefs.covariance[np.ix_(vehicle, told, told)] = covariance
        beliefs.mean[np.ix_(vehicle, rest)], beliefs.covariance[
            np.ix_(vehicle, rest, rest)] = self._kinematics.begin()
        self._placed[vehicle] = True
        self._doubts[vehicle] = 0

    def _share(self) -> None:
        """Join what the vehicles have learnt, each from the same prior and ranges of its own."""
        beliefs = self._beliefs
        assert beliefs is not None
        taught = np.flatnonzero(self._taught)
        if not len(taught):
            return
        mean = beliefs.mean[taught, self._known]
        covariance = beliefs.covariance[taught, self._known, self._known]
        prior = np.linalg.inv(self._prior)
        information = np.linalg.inv(covariance)
        joint = prior + (information - prior).sum(axis=0)
        self.covariance = np.linalg.inv(joint)
        self.scale, self.bias = map(float, self._begin + self.covariance @ np.einsum(
            'vij,vj->i', information, mean - self._begin))
        covariance += _FORGOTTEN * (self._prior - covariance)
        beliefs.covariance[taught, self._known, self._known] = covariance
