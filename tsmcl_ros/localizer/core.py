"""What happens in an epoch: predict, update, and judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tsmcl_ros.localizer.belief import Belief
from tsmcl_ros.localizer.health import Health
from tsmcl_ros.localizer.settings import Settings
from tsmcl_ros.model.credibility import Credibility
from tsmcl_ros.model.echo import guard
from tsmcl_ros.model.health import LOST, OK, STALE
from tsmcl_ros.model.learning_channel import LearningChannel
from tsmcl_ros.model.learnt import Learnt
from tsmcl_ros.model.odometry import OdometryBuffer
from tsmcl_ros.model.resume import Bridges, Last, last_known, resumed
from tsmcl_ros.model.silence import KnownAnchors
from tsmcl_ros.model.speakers import Speakers
from tsmcl_ros.types import Array, Estimate, Motion, Observation, PADDED, Prior, VEHICLE

# Odometry tells of the way in the map where its frame's rotation is known this well [rad].
_WELL_ORIENTED = 0.1


class Core:
    """
    Localizers of V vehicles, from one start to the next; the core that every path runs through.

    Parameters
    ----------
    settings : Settings
        Read at every use, as they may change.
    anchors : KnownAnchors
    speakers : Speakers
        Both outlive it.
    vehicles : int
        V.

    Attributes
    ----------
    channel : LearningChannel
        Tells what measurements mean.
    odometry : OdometryBuffer
        Of all vehicles.
    belief : Belief
        What the vehicles believe.
    credibility : Credibility
        Whom they believe.
    priors : list of Prior
        Where vehicles are at the next epoch, as somebody says.
    lasts : list of Last
        Where another localizer left them, for the first epoch.
    given : Learnt
        What that one has learnt of the radio, for the first epoch.
    estimate : Estimate or None
        That of the last epoch.

    """

    def __init__(self, settings: Settings, anchors: KnownAnchors, speakers: Speakers,
                 vehicles: int):
        dimension = settings.localizer.dimension
        self._settings, self._vehicles = settings, vehicles
        self._anchors, self._speakers = anchors, speakers
        anchors.forget()
        self.channel = LearningChannel(settings.radio, settings.evidence, settings.localizer.seed)
        self.odometry = OdometryBuffer(vehicles)
        self.belief = Belief(settings, self.channel, vehicles)
        self.credibility = Credibility(
            settings.health, settings.evidence.miss_rate, vehicles, dimension)
        self.credibility.claims.learn_map(anchors.mapped)
        self.priors: list[Prior] = []
        self.lasts: list[Last] = []
        self.given = Learnt()
        self.estimate: Estimate | None = None
        self._heard_at = np.full(vehicles, -np.inf)
        self._reinitializations = np.zeros(vehicles, int)
        self._speed = np.full(vehicles, np.nan)
        self._bridges = Bridges(settings.motion.max_speed, self.channel.radio_range)

    def anew(self) -> Core:
        """Return what it was at its start, where no vehicle has begun yet."""
        core = Core(self._settings, self._anchors, self._speakers, self._vehicles)
        core.lasts, core.given = self.lasts, self.given
        return core

    @property
    def last(self) -> float | None:
        """Stamp of the last epoch [s]."""
        return None if self.estimate is None else self.estimate.stamp

    @property
    def status(self) -> Array:
        """(V,) int: OK, STALE or LOST as of the last epoch."""
        stale = (self._age > self._settings.health.stale_after) | self._circling
        return np.where(self._lost > 0.5, LOST, np.where(stale, STALE, OK))

    @property
    def health(self) -> Health:
        """How the localization is doing as of the last epoch."""
        return Health(self.status, self._lost, self.credibility.monitor.suspects(), self._age,
                      self._reinitializations.copy())

    def last_known(self) -> list[Last]:
        """Return what another localizer can begin with: those vehicles that are not lost."""
        if self.estimate is None:
            return []
        return last_known(self.estimate, self._speed, self.status != LOST)

    @property
    def learnt(self) -> Learnt:
        """What another localizer can begin with: of what is not learnt yet, what is given."""
        return self.channel.learnt.beside(self.given)

    def reinitialize(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts from anywhere at its next beacon."""
        self.belief.forget(vehicle)
        self.credibility.forget(vehicle)

    def epoch(self, observation: Observation) -> Estimate:
        """Predict, update and judge: the core that every path runs through."""
        stamp = observation.stamp
        motion = self.odometry.motion(self.last, stamp, self._settings.localizer.dimension)
        if motion is not None and motion.displacement is not None and motion.elapsed > 0:
            speed = np.linalg.norm(motion.displacement, axis=1) / motion.elapsed
            self._speed = np.where(np.isnan(speed), self._speed, speed)
        if not self.belief.has_begun:
            self.belief.begin(motion is not None)
            self._start(stamp)
        elif self.estimate is not None:
            if self.belief.awaits_odometry and motion is not None:
                self.belief.adopt_odometry(self.estimate)
            moved = motion or Motion(stamp - self.estimate.stamp)
            self.belief.method.predict(moved)
            self.channel.predict(moved)
        for prior in self.belief.outage.resume(stamp, observation.heard.any(axis=1)):
            self.belief.resume(prior)
        bridged = self._bridged(stamp)
        for prior in [*bridged, *self.priors]:
            self.belief.replace(self._rotated(prior))
            self.credibility.forget(prior.vehicle)
        self.priors = []
        claimed = self.channel.corrected(
            self._speakers.heed_silence(self._listen(observation)))
        observation = self._guarded(claimed)
        self.channel.locate(observation)
        observation = self._sifted(observation, motion)
        astray = self.belief.drop_astray(observation, self.credibility.monitor.lost > 0.5)
        estimate = self._oriented(self.belief.method.update(observation))
        estimate = replace(estimate, reinitialized=estimate.reinitialized | astray)
        for prior in self.channel.calibrate(observation, estimate):
            self.belief.method.start(prior)
        estimate = self.channel.placed(estimate)
        if self._settings.evidence.echo_guard > 0 and (
                self.belief.hearsay.covariance.any() or (observation.kind == VEHICLE).any()):
            estimate = self.belief.hearsay.add(
                estimate, claimed, observation, *self.channel.resolution(observation))
        estimate = self.belief.through_outage(estimate, observation, motion, bridged)
        self._bridges.forget(estimate.heard > 0)
        if self._settings.localizer.hold_circles:
            self.belief.settling.judge(observation, estimate, self.channel.distances(observation))
            estimate = replace(estimate, mean=self.belief.settling.placed(estimate))
        self.estimate = estimate
        self._heard_at[estimate.heard > 0] = stamp
        self.credibility.renew(estimate.reinitialized)
        self._reinitializations += estimate.reinitialized
        return estimate

    @property
    def _lost(self) -> Array:
        """(V,) float: probability of being lost, 1 before a vehicle is placed."""
        if self.estimate is None:
            return np.ones(self._vehicles)
        known = np.isfinite(self.estimate.mean[:, 0]) | self._circling
        return np.where(known, self.credibility.monitor.lost, 1)

    @property
    def _circling(self) -> Array:
        """(V,) bool: who is placed, but on circles."""
        if self.estimate is None:
            return np.zeros(self._vehicles, bool)
        return np.asarray(np.isfinite(self.estimate.covariance[:, 0, 0])
                          & np.isnan(self.estimate.mean[:, 0]))

    @property
    def _age(self) -> Array:
        """(V,) float: time since the last beacon [s]."""
        return (self.last if self.last is not None else 0.0) - self._heard_at

    def _sifted(self, observation: Observation, motion: Motion | None) -> Observation:
        """Return what is to be believed, as held against the prediction and against itself."""
        mean, covariance = self.belief.method.moments()
        self.credibility.move(*self._displacement(motion))
        observation, priors = self.credibility.sift(
            self.channel, observation, mean, covariance + self.belief.hearsay.covariance,
            self._anchors.met(observation))
        for prior in priors:
            turned = None if self.estimate is None else self.estimate.rotation[prior.vehicle]
            self.belief.replace(replace(
                prior, yaw=None if turned is None or np.isnan(turned) else turned))
        return observation

    def _displacement(self, motion: Motion | None) -> tuple[Array, Array]:
        """Return how vehicles moved in the map (V, D) [m], NaN if unknown, and variances (V,)."""
        unknown = np.full((self._vehicles, self._settings.localizer.dimension), np.nan)
        estimate = self.estimate
        if motion is None or motion.displacement is None or estimate is None:
            return unknown, np.zeros(self._vehicles)
        config, moved = self._settings.motion, motion.displacement.copy()
        oriented = estimate.rotation_variance < _WELL_ORIENTED ** 2
        angle = np.where(oriented, estimate.rotation, np.nan)
        x, y = motion.displacement[:, 0], motion.displacement[:, 1]
        moved[:, 0] = np.cos(angle) * x - np.sin(angle) * y
        moved[:, 1] = np.sin(angle) * x + np.cos(angle) * y
        errs = config.alpha3 ** 2 + estimate.rotation_variance
        return moved, config.odom_std ** 2 * motion.elapsed + errs * np.square(moved).sum(axis=1)

    def _bridged(self, stamp: float) -> list[Prior]:
        """Return where those vehicles are whose odometry is back; drop beliefs of no more use."""
        odometry = self.odometry.at_epoch
        if self.estimate is None:
            return []
        self._bridges.leave(self.estimate, self._speed, self.status != LOST, odometry)
        arrived = self._bridges.arrive(stamp, odometry)
        for vehicle, prior in arrived.items():
            if prior is None:
                self.reinitialize(vehicle)
        return [prior for prior in arrived.values() if prior is not None]

    def _listen(self, observation: Observation) -> Observation:
        """Add the silence of the known anchors around where the vehicles may be."""
        nowhere = np.full((self._vehicles, self._settings.localizer.dimension), np.nan)
        if self.estimate is None:
            return self._anchors.listen(observation, nowhere, np.zeros(self._vehicles))
        spread = np.sqrt(np.trace(self.estimate.covariance, axis1=1, axis2=2))
        moved = self._settings.motion.max_speed * (observation.stamp - self.estimate.stamp)
        return self._anchors.listen(observation, self.estimate.mean, 4 * spread + moved)

    def _guarded(self, observation: Observation) -> Observation:
        """Believe no more of other vehicles than they can know without this one."""
        if not self._settings.evidence.use_vehicles:
            vehicles = observation.kind == VEHICLE
            return replace(observation, sender=np.where(vehicles, PADDED, observation.sender))
        if self.estimate is None:
            return observation
        return guard(observation, self.estimate.mean, self.estimate.covariance,
                     self._settings.evidence.echo_guard)

    def _oriented(self, estimate: Estimate) -> Estimate:
        """Add the odometry, from which the yaw follows where the rotation is known."""
        known = self._settings.motion.odom_heading == 'known'
        unestimated = known & np.isnan(estimate.rotation)
        return replace(
            estimate, odometry=self.odometry.at_epoch,
            rotation=np.where(unestimated, 0, estimate.rotation),
            rotation_variance=np.where(unestimated, 0, estimate.rotation_variance))

    def _rotated(self, prior: Prior) -> Prior:
        """Return the prior with the odometry frame's rotation in place of the vehicle's yaw."""
        turned = self.odometry.at_epoch[prior.vehicle, 3]
        if prior.yaw is None or np.isnan(turned):
            return prior
        return replace(prior, yaw=prior.yaw - float(turned))

    def _start(self, stamp: float) -> None:
        """Give every vehicle what it is to start from, ahead of what messages brought."""
        config = self._settings.localizer
        self.channel.resume(self.given)
        priors = [resumed(last, stamp, self.odometry.at_epoch[last.vehicle],
                          self._settings.motion.max_speed, self.channel.radio_range)
                  for last in self.lasts]
        self.priors[:0] = [prior for prior in priors if prior is not None]
        self.lasts = []
        if not config.set_initial_pose:
            return
        place = [config.initial_pose_x, config.initial_pose_y, config.initial_pose_z]
        mean = np.array(place[:config.dimension])
        covariance = config.initial_pose_std ** 2 * np.eye(config.dimension)
        self.priors[:0] = [
            Prior(vehicle, mean, covariance, config.initial_pose_yaw,
                  config.initial_pose_yaw_std)
            for vehicle in range(self._vehicles)]
