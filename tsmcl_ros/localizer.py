"""
The one pipeline from messages to estimates: input gate, method, health. There is no ROS in it.

The node, the offline bag run and the experiments all drive this class. Its estimates depend on
the messages' stamps and on their order within each topic, never on how topics interleave: an
epoch is worked on once every vehicle's beacons and odometry have passed its stamp, or once
`max_wait` has passed on the messages' own clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tsmcl_ros.config import build, Config, param, refuse_unknown
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.odometry import OdometryBuffer
from tsmcl_ros.model.radio import Channel, EvidenceConfig, RadioConfig
from tsmcl_ros.model.silence import KnownAnchors
from tsmcl_ros.types import (
    Array,
    Estimate,
    Estimator,
    MessageError,
    Motion,
    Observation,
    Odometry,
    Prior,
)

OK, STALE, LOST = 0, 1, 2


@dataclass(frozen=True)
class LocalizerConfig(Config):
    """Which method runs, where it starts, and how it treats time."""

    method: str = param('ts_mcl', 'localization method', choices=tuple(METHODS), read_only=True)
    dimension: int = param(2, 'coordinates to estimate', choices=(2, 3), read_only=True)
    seed: int = param(0, 'seed of all randomness: same bag and seed, same bits',
                      low=0, read_only=True)
    max_wait: float = param(
        0.5, 'how long an epoch waits for odometry and for other vehicles of a fleet',
        unit='s', low=0.0)
    outage_period: float = param(
        2.0, 'without beacons, predict this often; 0 for never', unit='s', low=0.0)
    stale_after: float = param(
        5.0, 'call an estimate stale when no beacon was heard for this long',
        unit='s', above=0.0)
    time_jump: float = param(
        10.0, 'start anew when stamps go back by more than this, as in a looped bag; reject '
        'messages that are less late', unit='s', low=0.0)
    set_initial_pose: bool = param(False, 'start from initial_pose instead of anywhere')
    initial_pose_x: float = param(0.0, 'initial position', unit='m', name='initial_pose.x')
    initial_pose_y: float = param(0.0, 'initial position', unit='m', name='initial_pose.y')
    initial_pose_z: float = param(0.0, 'initial position', unit='m', name='initial_pose.z')
    initial_pose_yaw: float = param(
        0.0, 'initial rotation from the odometry frame to the map', unit='rad',
        name='initial_pose.yaw')
    initial_pose_std: float = param(
        1.0, 'standard deviation of the initial position', unit='m', above=0.0,
        name='initial_pose.std')
    initial_pose_yaw_std: float = param(
        0.2, 'standard deviation of the initial yaw', unit='rad', above=0.0,
        name='initial_pose.yaw_std')


CONFIGS: tuple[type[Config], ...] = (
    LocalizerConfig, RadioConfig, EvidenceConfig, MotionConfig,
    *(method.Config for method in METHODS.values()))


@dataclass(frozen=True, eq=False)
class Health:
    """
    How V vehicles' localization is doing.

    Attributes
    ----------
    status : (V,) int
        OK, STALE (predicting through an outage) or LOST.
    age : (V,) float
        Time since the last beacon [s], inf before the first.
    reinitializations : (V,) int
        Times that no particle explained what was heard.
    """

    status: Array
    age: Array
    reinitializations: Array


class Localizer:
    """
    Localizers of V vehicles that share parameters, one random generator and one clock.

    Parameters
    ----------
    settings : Mapping
        Values of the parameters of `CONFIGS` by name; what is absent has its default.
    vehicles : int
        V.

    Raises
    ------
    ConfigError
        If a value is not allowed or a name is unknown.
    """

    def __init__(self, settings: Mapping[str, Any], vehicles: int = 1):
        refuse_unknown(settings, CONFIGS, 'localizer')
        self.config = build(LocalizerConfig, settings)
        self.motion_config = build(MotionConfig, settings)
        self.method_config = build(METHODS[self.config.method].Config, settings)
        self.radio_config = build(RadioConfig, settings)
        self.evidence_config = build(EvidenceConfig, settings)
        self.vehicles = vehicles
        self._anchor_map: Observation | None = None
        self.reset()
        if self.motion_config.motion_model != 'auto':
            # Where method and motion do not fit, fail now rather than at the first epoch.
            self._make_method(False)

    def reset(self) -> None:
        """Forget everything but the configuration and the anchor map."""
        self._rng = np.random.Generator(np.random.SFC64(self.config.seed))
        self.channel = Channel(self.radio_config, self.evidence_config)
        self._anchors = KnownAnchors(
            self.evidence_config.silence, self.vehicles, self.config.dimension)
        if self._anchor_map is not None:
            self._anchors.learn_map(self._anchor_map)
        self._odometry = OdometryBuffer(self.vehicles)
        self._method: Estimator | None = None
        self._pending: dict[float, dict[int, Observation]] = {}
        self._priors: list[Prior] = []
        self._passed = np.full(self.vehicles, -np.inf)
        self._heard_at = np.full(self.vehicles, -np.inf)
        self._reinitializations = np.zeros(self.vehicles, int)
        self._now = -np.inf
        self._last: float | None = None
        self._estimate: Estimate | None = None

    @property
    def now(self) -> float:
        """Latest time that a message or `clock` has told [s], -inf before any has."""
        return self._now

    @property
    def particles(self) -> Array:
        """(V, N, D) float32: the cloud [m]; (V, 0, D) before the first epoch."""
        if self._method is None:
            return np.zeros((self.vehicles, 0, self.config.dimension), np.float32)
        return self._method.particles

    @property
    def health(self) -> Health:
        """How the localization is doing as of the last epoch."""
        placed = np.zeros(self.vehicles, bool)
        if self._estimate is not None:
            placed = np.isfinite(self._estimate.mean[:, 0])
        age = (self._last if self._last is not None else 0.0) - self._heard_at
        status = np.where(~placed, LOST, np.where(age > self.config.stale_after, STALE, OK))
        return Health(status, age, self._reinitializations.copy())

    def anchor_map(self, anchors: Observation) -> None:
        """
        Take over the map of all anchors (V = 1).

        Raises
        ------
        MessageError
            If one id stands in it more than once.
        """
        anchors = anchors.project(self.config.dimension)
        self._anchors.learn_map(anchors)
        self._anchor_map = anchors

    def beacons(self, vehicle: int, observation: Observation) -> None:
        """
        Take in what one vehicle's radio heard in one epoch (V = 1).

        Raises
        ------
        MessageError
            If its stamp is not after the last epoch's, or an anchor is not where the map has
            it.
        """
        stamp = observation.stamp
        self._check_stamp(stamp, self._passed[vehicle], 'beacons')
        observation = observation.project(self.config.dimension)
        self._check_positions(observation)
        self._passed[vehicle] = stamp
        self._now = max(self._now, stamp)
        self._pending.setdefault(stamp, {})[vehicle] = observation

    def odometry(self, vehicle: int, odometry: Odometry) -> None:
        """
        Take in one odometry pose of one vehicle.

        Raises
        ------
        MessageError
            If its stamp is not after the last one's.
        """
        self._check_stamp(odometry.stamp, self._odometry.latest[vehicle], 'odometry')
        self._odometry.add(vehicle, odometry)
        self._now = max(self._now, odometry.stamp)

    def initial_pose(self, prior: Prior) -> None:
        """Replace one vehicle's belief, before the next epoch."""
        self._priors.append(prior)

    def reinitialize(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts from anywhere at its next beacon."""
        if self._method is not None:
            self._method.forget(vehicle)

    def clock(self, stamp: float) -> None:
        """Let time pass [s] without a message; a jump back starts anew."""
        if stamp < self._now - self.config.time_jump:
            self.reset()
        self._now = max(self._now, stamp)

    def due(self) -> list[Estimate]:
        """Return the estimates of the epochs that have become complete, in order of time."""
        estimates = []
        while (stamp := self._next_stamp()) is not None and self._settled(stamp):
            heard = self._pending.pop(stamp, {})
            nothing = Observation.empty(1, 0, self.config.dimension, stamp)
            observation = Observation.stack(
                [heard.get(vehicle, nothing) for vehicle in range(self.vehicles)], stamp)
            estimates.append(self._epoch(observation))
        return estimates

    def finish(self) -> list[Estimate]:
        """Return the estimates of the epochs still waiting, as nothing will come any more."""
        last = max(self._pending, default=None)
        if last is None:
            return []
        # Not beyond the last epoch: an outage after it is no news.
        self._now = max(self._now, last + self.config.max_wait)
        return self.due()

    def epoch(self, observation: Observation, position: Array | None = None,
              yaw: Array | None = None) -> Estimate:
        """
        Take in one epoch of all V vehicles at once, as simulations have it.

        Parameters
        ----------
        observation : Observation
            Of V vehicles.
        position : (V, D) float or None
            Odometry positions [m] at its stamp.
        yaw : (V,) float or None
            Odometry yaws [rad].
        """
        if position is not None:
            self._odometry.add_all(observation.stamp, position, yaw)
        return self._epoch(observation.project(self.config.dimension))

    def _epoch(self, observation: Observation) -> Estimate:
        """Predict, update and judge: the core that every path runs through."""
        stamp = observation.stamp
        motion = self._odometry.motion(self._last, stamp, self.config.dimension)
        if self._method is None:
            self._method = self._make_method(motion is not None)
            self._start()
        elif self._last is not None:
            self._method.predict(motion or Motion(stamp - self._last))
        for prior in self._priors:
            self._method.start(prior)
        self._priors = []
        estimate = self._oriented(self._method.update(self._listen(observation)))
        self.channel.calibrate(observation, estimate)
        self._last, self._estimate = stamp, estimate
        self._heard_at[estimate.heard > 0] = stamp
        self._reinitializations += estimate.reinitialized
        return estimate

    def _listen(self, observation: Observation) -> Observation:
        """Add the silence of the known anchors around where the vehicles may be."""
        nowhere = np.full((self.vehicles, self.config.dimension), np.nan)
        if self._estimate is None or self._last is None:
            return self._anchors.listen(observation, nowhere, np.zeros(self.vehicles))
        spread = np.sqrt(np.trace(self._estimate.covariance, axis1=1, axis2=2))
        moved = self.motion_config.max_speed * (observation.stamp - self._last)
        return self._anchors.listen(observation, self._estimate.mean, 4 * spread + moved)

    def _oriented(self, estimate: Estimate) -> Estimate:
        """Add the odometry, from which the yaw follows where the rotation is known."""
        known = self.motion_config.odom_heading == 'known'
        unestimated = known & np.isnan(estimate.rotation)
        return replace(
            estimate, odometry=self._odometry.at_epoch,
            rotation=np.where(unestimated, 0, estimate.rotation),
            rotation_variance=np.where(unestimated, 0, estimate.rotation_variance))

    def _make_method(self, odometry: bool) -> Estimator:
        config = self.config
        motion = motion_model(
            self.motion_config, config.dimension,
            odometry or self.motion_config.motion_model == 'odometry')
        method: Estimator = METHODS[config.method](
            self.method_config, self.channel, motion, self.vehicles, config.dimension, self._rng)
        return method

    def _start(self) -> None:
        """Give every vehicle the configured initial pose, ahead of what messages brought."""
        config = self.config
        if not config.set_initial_pose:
            return
        place = [config.initial_pose_x, config.initial_pose_y, config.initial_pose_z]
        mean = np.array(place[:config.dimension])
        covariance = config.initial_pose_std ** 2 * np.eye(config.dimension)
        self._priors[:0] = [
            Prior(vehicle, mean, covariance, config.initial_pose_yaw,
                  config.initial_pose_yaw_std)
            for vehicle in range(self.vehicles)]

    def _next_stamp(self) -> float | None:
        """Return the stamp of the next epoch, or of the next prediction in an outage."""
        pending = min(self._pending, default=None)
        if self._last is None or self.config.outage_period == 0:
            return pending
        outage = self._last + self.config.outage_period
        return outage if pending is None or outage < pending else pending

    def _settled(self, stamp: float) -> bool:
        """Return whether all that belongs to an epoch is there, or has been waited for."""
        if self._now >= stamp + self.config.max_wait:
            return True
        if (self._passed < stamp).any():
            return False
        if self.motion_config.motion_model not in ('auto', 'odometry'):
            return True
        expected = self._odometry.latest > -np.inf
        if self._method is None:
            # Nobody knows yet who has odometry.
            expected[:] = True
        return bool((self._odometry.latest[expected] >= stamp).all())

    def _check_stamp(self, stamp: float, latest: float, what: str) -> None:
        """Refuse a message that comes late; start anew where time has jumped back."""
        if stamp < self._now - self.config.time_jump:
            self.reset()
            return
        if self._last is not None and what == 'beacons':
            latest = max(latest, self._last)
        if stamp <= latest:
            raise MessageError(
                f'{what}: stamp {stamp:.6f} s is not allowed, must be after the last one, '
                f'{latest:.6f} s')

    def _check_positions(self, observation: Observation) -> None:
        """Refuse beacons of an anchor that the map has elsewhere."""
        if self._anchor_map is None:
            return
        same = observation.sender[0][:, None] == self._anchor_map.sender[0]
        apart = np.abs(observation.position[0][:, None] - self._anchor_map.position[0]).max(axis=2)
        wrong = np.argwhere(same & (apart > 1.0))
        if len(wrong):
            row, anchor = wrong[0]
            raise MessageError(
                f'beacons: anchor {observation.sender[0, row]} claims '
                f'{observation.position[0, row].tolist()} m, must be where the anchor map has '
                f'it, {self._anchor_map.position[0, anchor].tolist()} m, to 1 m')
