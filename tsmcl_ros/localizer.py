"""
The one pipeline from messages to estimates: input gate, method, health. There is no ROS in it.

The node, the offline bag run and the experiments all drive this class. Its estimates depend on
the messages' stamps and on their order within each topic, not on how topics interleave: an epoch
is worked on once every vehicle's beacons and odometry have passed its stamp, or once `max_wait`
has passed on the messages' own clock. So topics may lag each other by `max_wait`, less the time
between two odometry poses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from tsmcl_ros.config import adjust, build, Config, param, refuse_unknown
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.cloud import RecoveryConfig
from tsmcl_ros.model.credibility import Credibility
from tsmcl_ros.model.echo import guard, Hearsay, refuse_certainty
from tsmcl_ros.model.health import HealthConfig, LOST, OK, STALE
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.odometry import OdometryBuffer
from tsmcl_ros.model.outage import OutagePredictor
from tsmcl_ros.model.period import PeriodConfig
from tsmcl_ros.model.radio import Channel, EvidenceConfig, RadioConfig
from tsmcl_ros.model.resume import Bridges, Last, last_known, resumed
from tsmcl_ros.model.settling import Settling
from tsmcl_ros.model.silence import KnownAnchors
from tsmcl_ros.model.speakers import SpeakerConfig, Speakers
from tsmcl_ros.model.timeline import Again, Held, Timeline
from tsmcl_ros.types import (
    Array,
    ConfigError,
    Estimate,
    Estimator,
    Links,
    MessageError,
    Motion,
    Observation,
    Odometry,
    PADDED,
    Prior,
    VEHICLE,
)

# Methods that are made for outages, and so predict through them on their own.
_PREDICTS_OUTAGES = ('grey_ekf',)
# Who is not told of any time for this long [s] cannot say where its vehicles have gone.
LONGEST_LEAP = 3600.0
# Stamps that are further apart [s], or than time_jump, do not tell the same time.
_SPAN = 10.0
# Nobody is this far ahead [s] of a fleet that speaks every second or so; others are asked first.
_AHEAD = 2.0
# Odometry tells of the way in the map where its frame's rotation is known this well [rad].
_WELL_ORIENTED = 0.1


@dataclass(frozen=True)
class LocalizerConfig(Config):
    """Which method runs, where it starts, and how it treats time."""

    method: str = param('ts_mcl', 'localization method', choices=tuple(METHODS))
    dimension: int = param(2, 'coordinates to estimate', choices=(2, 3))
    seed: int = param(0, 'seed of all randomness: same bag and seed, same bits', low=0)
    max_wait: float = param(
        0.5, 'how long an epoch waits for odometry, topics of ranges, and other vehicles of a '
        'fleet', unit='s', low=0.0, live=True)
    outage_period: float = param(
        2.0, 'without beacons, predict this often; 0 for never', unit='s', low=0.0, live=True)
    outage_predictor: str = param(
        'velocity', 'what predicts a vehicle that hears nothing and has no odometry: the way its '
        'velocity used to be kept or lost; that and a grey prediction of its azimuth; or none, '
        "the method's own motion model", choices=('velocity', 'grey_ekf', 'none'))
    hold_circles: bool = param(
        True, 'say nothing of vehicles that ranges leave on circles around anchors, in whose '
        'middle they are not', live=True)
    time_jump: float = param(
        10.0, "start anew when a topic's stamps go back by more than this, as in a looped bag; "
        'reject messages that are less late', unit='s', low=0.0, live=True)
    set_initial_pose: bool = param(False, 'start from initial_pose instead of anywhere')
    initial_pose_x: float = param(0.0, 'initial position', unit='m', name='initial_pose.x')
    initial_pose_y: float = param(0.0, 'initial position', unit='m', name='initial_pose.y')
    initial_pose_z: float = param(0.0, 'initial position', unit='m', name='initial_pose.z')
    initial_pose_yaw: float = param(
        0.0, 'initial yaw', unit='rad', name='initial_pose.yaw')
    initial_pose_std: float = param(
        1.0, 'standard deviation of the initial position', unit='m', above=0.0,
        name='initial_pose.std')
    initial_pose_yaw_std: float = param(
        0.2, 'standard deviation of the initial yaw', unit='rad', above=0.0,
        name='initial_pose.yaw_std')

    def check(self) -> None:
        """Hold that predictions do not come without end."""
        if 0 < self.outage_period < 0.01:
            raise ConfigError(
                f'outage_period: {self.outage_period:g} is not allowed, must be 0 or at least '
                '0.01 s')


CONFIGS: tuple[type[Config], ...] = (
    LocalizerConfig, SpeakerConfig, HealthConfig, RadioConfig, EvidenceConfig, MotionConfig,
    *(method.Config for method in METHODS.values()))


@dataclass(frozen=True, eq=False)
class Health:
    """
    How V vehicles' localization is doing.

    Attributes
    ----------
    status : (V,) int
        OK, STALE (predicting through an outage) or LOST (not placed, or not where it is believed
        to be).
    lost : (V,) float
        Probability that what was heard contradicts the estimate because the vehicle is elsewhere.
    suspects : list of V lists of int
        Senders that contradict what all others agree on.
    age : (V,) float
        Time since the last beacon [s], inf before the first.
    reinitializations : (V,) int
        Times that no particle explained what was heard.

    """

    status: Array
    lost: Array
    suspects: list[list[int]]
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

    Attributes
    ----------
    restarts : int
        How often time has jumped, and everything started anew.
    speakers : Speakers
        Who is heeded, and what others said.

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
        self.health_config = build(HealthConfig, settings)
        self.vehicles = vehicles
        self.restarts = 0
        self.speakers = Speakers(build(SpeakerConfig, settings), vehicles)
        self._anchors = KnownAnchors(
            self.evidence_config.silence, vehicles, self.config.dimension)
        self._links = Links.none()
        self._ready: list[Estimate] = []
        self._lasts: list[Last] = []
        self._refused: list[tuple[int, MessageError]] = []
        self.reset()
        if self.motion_config.motion_model != 'auto':
            # Where method and motion do not fit, fail now rather than at the first epoch.
            self._make_method(False)

    @property
    def configs(self) -> tuple[Config, ...]:
        """All that it is configured by."""
        return (self.config, self.speakers.config, self.radio_config, self.evidence_config,
                self.motion_config, self.method_config)

    def reconfigure(self, settings: Mapping[str, Any]) -> None:
        """
        Take over other values of live parameters, which hold from the next epoch on.

        Parameters
        ----------
        settings : Mapping
            By name; those of methods that do not run have no effect.

        Raises
        ------
        ConfigError
            If a value is not allowed, a name is unknown, or a parameter that is not live would
            change; then nothing does.

        """
        refuse_unknown(settings, CONFIGS, 'localizer')
        adjust((self.config, self.speakers.config, self.motion_config, self.method_config,
                self.radio_config, self.evidence_config, self.health_config), settings)
        self._timeline.span = self._span
        self._learn_links()

    def reset(self) -> None:
        """Forget everything but the configuration, the anchor map, and the anchors' links."""
        self._rng = np.random.Generator(np.random.SFC64(self.config.seed))
        self.channel = Channel(self.radio_config, self.evidence_config)
        self._learn_links()
        self._anchors.forget()
        self._odometry = OdometryBuffer(self.vehicles)
        self._outage = OutagePredictor(
            self.vehicles, self.config.dimension, self.config.outage_predictor == 'grey_ekf')
        self._awaits_odometry = False
        self._method: Estimator | None = None
        self._pending: dict[float, dict[int, Observation]] = {}
        self._priors: list[Prior] = []
        self._hearsay = Hearsay(self.vehicles, self.config.dimension)
        self._settling = Settling(self.vehicles)
        self._credibility = Credibility(
            self.health_config, self.evidence_config.miss_rate, self.vehicles,
            self.config.dimension)
        self._credibility.claims.learn_map(self._anchors.mapped)
        self._monitor = self._credibility.monitor
        self._astray = np.zeros(self.vehicles, int)
        self._passed = np.full(self.vehicles, -np.inf)
        self._heard_at = np.full(self.vehicles, -np.inf)
        self._reinitializations = np.zeros(self.vehicles, int)
        self._now = -np.inf
        self._timeline = Timeline(self.vehicles, self._span)
        self._lag = 0.0
        self._last: float | None = None
        self._estimate: Estimate | None = None
        self._speed = np.full(self.vehicles, np.nan)
        self._bridges = Bridges(self.motion_config.max_speed, self.channel.radio_range)

    @property
    def now(self) -> float:
        """Latest time that a message or `clock` has told [s], -inf before any has."""
        return self._now

    @property
    def estimate(self) -> Estimate | None:
        """The last epoch's estimate, None before the first."""
        return self._estimate

    @property
    def particles(self) -> Array:
        """(V, N, D) float32: the cloud [m]; (V, 0, D) before the first epoch."""
        if self._method is None:
            return np.zeros((self.vehicles, 0, self.config.dimension), np.float32)
        return self._method.particles

    @property
    def asks_period(self) -> bool:
        """Whether the method says how often vehicles want beacons."""
        return isinstance(self.method_config, PeriodConfig) and self.method_config.asks

    @property
    def status(self) -> Array:
        """(V,) int: OK, STALE or LOST as of the last epoch."""
        stale = (self._age > self.health_config.stale_after) | self._circling
        return np.where(self._lost > 0.5, LOST, np.where(stale, STALE, OK))

    @property
    def health(self) -> Health:
        """How the localization is doing as of the last epoch."""
        return Health(self.status, self._lost, self._monitor.suspects(), self._age,
                      self._reinitializations.copy())

    @property
    def _lost(self) -> Array:
        """(V,) float: probability of being lost, 1 before a vehicle is placed."""
        if self._estimate is None:
            return np.ones(self.vehicles)
        known = np.isfinite(self._estimate.mean[:, 0]) | self._circling
        return np.where(known, self._monitor.lost, 1)

    @property
    def _circling(self) -> Array:
        """(V,) bool: who is placed, but on circles."""
        if self._estimate is None:
            return np.zeros(self.vehicles, bool)
        return np.asarray(np.isfinite(self._estimate.covariance[:, 0, 0])
                          & np.isnan(self._estimate.mean[:, 0]))

    @property
    def _age(self) -> Array:
        """(V,) float: time since the last beacon [s]."""
        return (self._last if self._last is not None else 0.0) - self._heard_at

    def anchor_map(self, anchors: Observation) -> None:
        """
        Take over a map of anchors (V = 1); several complete each other.

        Raises
        ------
        MessageError
            If one id stands in it more than once.

        """
        self._anchors.learn_map(anchors.project(self.config.dimension))
        self.speakers.learn_map(anchors)
        if not self.speakers.heed_all:
            self._learn_links()
        self._credibility.claims.learn_map(self._anchors.mapped)

    def ignore_silence(self) -> None:
        """Take no anchor's silence for evidence, as who is heard is not all who are near."""
        self._anchors.mode = 'none'

    def anchor_links(self, links: Links) -> None:
        """
        Take over how anchors hear each other, by which rssi is calibrated.

        Links of several messages complete each other; a link told again replaces what it was.

        Raises
        ------
        MessageError
            If an anchor is not where the map has it.

        """
        table = Observation.empty(1, len(links.receiver), links.receiver_position.shape[1], 0.0)
        table.sender[0], table.position[0] = links.receiver, links.receiver_position
        self._anchors.check(table.project(self.config.dimension), 'anchor links')
        self._links = self._links.updated(links)
        self._learn_links()

    def beacons(self, vehicle: int, observation: Observation) -> None:
        """
        Take in what one vehicle's radio heard in one epoch (V = 1).

        Raises
        ------
        MessageError
            If it comes too late, an anchor is not where the map has it, or a vehicle claims to
            be one or to know its place exactly.

        """
        stamp = observation.stamp
        again = partial(self.beacons, vehicle, observation)
        if not self.admit('beacons', vehicle, stamp, self._passed[vehicle], again):
            return
        if self._last is not None and stamp <= self._last:
            if self._estimate is not None and not self._estimate.heard.any():
                # Only predicted, while these were on their way.
                self._lag = max(self._lag, self._now - stamp)
            raise MessageError(
                f'beacons: stamp {stamp:.6f} s is not allowed, must be after the last epoch, '
                f'{self._last:.6f} s')
        observation = self.speakers.heed(
            observation.project(self.config.dimension), [vehicle])
        refuse_certainty(observation)
        self._passed[vehicle] = stamp
        self._now = max(self._now, stamp)
        self._pending.setdefault(stamp, {})[vehicle] = observation

    def odometry(self, vehicle: int, odometry: Odometry) -> None:
        """
        Take in one odometry pose of one vehicle.

        Raises
        ------
        MessageError
            If it comes too late.

        """
        again = partial(self.odometry, vehicle, odometry)
        if self.admit('odometry', vehicle, odometry.stamp, self._odometry.latest[vehicle], again):
            self._odometry.add(vehicle, odometry)
            self._now = max(self._now, odometry.stamp)

    def admit(self, what: str, vehicle: int, stamp: float, latest: float, again: Again) -> bool:
        """
        Tell whether a message is to be taken in now, as every one with a stamp must have asked.

        Where time has jumped, for most vehicles that say anything, everything starts anew.

        Parameters
        ----------
        what : str
            Names the messages in an error.
        vehicle : int
            Whose it is.
        stamp, latest : float
            Of the message, and of the last one on its topic, -inf if there was none [s].
        again : callable
            Hands it over again, and so asks again.

        Returns
        -------
        bool
            False if it was held back until it is clear what the time is, or handed over again.

        Raises
        ------
        MessageError
            If it comes too late, or tells another time than most vehicles.

        """
        if stamp == 0 and self._now > LONGEST_LEAP:
            raise MessageError(
                f'{what}: stamp 0 is not allowed, as the time is {self._now:.6f} s: who sends it '
                'leaves it unset')
        late = stamp < self._now - self.config.time_jump
        back = stamp < latest - self.config.time_jump
        if not back and stamp <= latest:
            raise MessageError(
                f'{what}: stamp {stamp:.6f} s is not allowed, must be after the last one, '
                f'{latest:.6f} s')
        ahead = -np.inf < self._now < stamp - (_AHEAD if self.vehicles > 1 else self._span)
        if not (late or ahead):
            self._timeline.accept(vehicle, stamp)
            return True
        if self._timeline.wins(vehicle, stamp, self._now, leaps=back or ahead):
            self._follow(stamp)
            again()
        elif late and not back:
            raise MessageError(
                f'{what}: stamp {stamp:.6f} s is not allowed, must be at most '
                f'{self.config.time_jump:g} s before the newest of all messages, '
                f'{self._now:.6f} s')
        elif not self._timeline.hold(Held(what, vehicle, stamp, again)):
            raise self._stray(what, stamp)
        return False

    def refused(self) -> list[tuple[int, MessageError]]:
        """Return, once, which vehicles' messages were refused after they had been held back."""
        refused, self._refused = self._refused, []
        refused += [(held.vehicle, self._stray(held.what, held.stamp))
                    for held in self._timeline.given_up]
        self._timeline.given_up = []
        return refused

    def initial_pose(self, prior: Prior) -> None:
        """Replace one vehicle's belief at the next epoch; the yaw is the vehicle's in the map."""
        self._priors.append(prior)

    def resume(self, lasts: Sequence[Last]) -> None:
        """Begin, at the first epoch, where another localizer left its vehicles."""
        self._lasts = list(lasts)

    def last_known(self) -> list[Last]:
        """Return what another localizer can begin with: those vehicles that are not lost."""
        if self._estimate is None:
            return []
        return last_known(self._estimate, self._speed, self.status != LOST)

    def reinitialize(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts from anywhere at its next beacon."""
        self._outage.forget(vehicle)
        self._settling.done[vehicle] = False
        self._hearsay.forget(vehicle)
        self._credibility.forget(vehicle)
        if self._method is not None:
            self._method.forget(vehicle)

    def clock(self, stamp: float) -> None:
        """Let time pass [s] without a message; a jump starts anew."""
        if stamp < self._now - self.config.time_jump or self._is_far_ahead(stamp):
            self._restart()
        self._now = max(self._now, stamp)

    def due(self) -> list[Estimate]:
        """Return the estimates of the epochs that have become complete, in order of time."""
        estimates, self._ready = self._ready, []
        while (stamp := self._next_stamp()) is not None and self._settled(stamp):
            heard = self._pending.pop(stamp, {})
            if len(heard) < self.vehicles:
                nothing = Observation.empty(1, 0, self.config.dimension, stamp)
                heard = dict.fromkeys(range(self.vehicles), nothing) | heard
            observation = Observation.stack(
                [heard[vehicle] for vehicle in range(self.vehicles)], stamp)
            estimates.append(self._epoch(observation))
        return estimates

    def finish(self) -> list[Estimate]:
        """Return the estimates of the epochs still waiting, as nothing will come any more."""
        if self._pending:
            # Not beyond the last epoch: an outage after it is no news.
            self._now = max(self._now, max(self._pending) + self.config.max_wait)
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
        return self._epoch(self.speakers.heed(
            observation.project(self.config.dimension), range(self.vehicles)))

    def _epoch(self, observation: Observation) -> Estimate:
        """Predict, update and judge: the core that every path runs through."""
        stamp = observation.stamp
        motion = self._odometry.motion(self._last, stamp, self.config.dimension)
        if motion is not None and motion.displacement is not None and motion.elapsed > 0:
            speed = np.linalg.norm(motion.displacement, axis=1) / motion.elapsed
            self._speed = np.where(np.isnan(speed), self._speed, speed)
        if self._method is None:
            self._method = self._make_method(motion is not None)
            self._awaits_odometry = self.motion_config.motion_model == 'auto' and motion is None
            self._start(stamp)
        elif self._estimate is not None:
            if self._awaits_odometry and motion is not None:
                self._adopt_odometry(self._estimate)
            moved = motion or Motion(stamp - self._estimate.stamp)
            self._method.predict(moved)
            self.channel.calibration.predict(moved)
        for prior in self._outage.resume(stamp, observation.heard.any(axis=1)):
            self._method.start(prior)
            self._hearsay.forget(prior.vehicle)
        bridged = self._bridged(stamp)
        for prior in [*bridged, *self._priors]:
            self._begin(self._rotated(prior))
            self._credibility.forget(prior.vehicle)
        self._priors = []
        claimed = self.speakers.heed_silence(self._listen(observation))
        observation = self._guarded(claimed)
        observation = self._sifted(observation, motion)
        astray = self._drop_astray(observation)
        estimate = self._oriented(self._method.update(observation))
        estimate = replace(estimate, reinitialized=estimate.reinitialized | astray)
        for prior in self.channel.calibrate(observation, estimate):
            self._method.start(prior)
        if self.evidence_config.echo_guard > 0 and (
                self._hearsay.covariance.any() or (observation.kind == VEHICLE).any()):
            estimate = self._hearsay.add(
                estimate, claimed, observation, *self.channel.resolution(observation))
        estimate = self._through_outage(estimate, observation, motion, bridged)
        self._bridges.forget(estimate.heard > 0)
        if self.config.hold_circles:
            self._settling.judge(observation, estimate, self.channel.distances(observation))
            estimate = replace(estimate, mean=self._settling.placed(estimate))
        self._last, self._estimate = stamp, estimate
        self._heard_at[estimate.heard > 0] = stamp
        self._credibility.renew(estimate.reinitialized)
        self._reinitializations += estimate.reinitialized
        return estimate

    def _sifted(self, observation: Observation, motion: Motion | None) -> Observation:
        """Return what is to be believed, as held against the prediction and against itself."""
        assert self._method is not None
        mean, covariance = self._method.moments()
        self._credibility.move(*self._displacement(motion))
        observation, priors = self._credibility.sift(
            self.channel, observation, mean, covariance + self._hearsay.covariance,
            self._anchors.met(observation))
        for prior in priors:
            turned = None if self._estimate is None else self._estimate.rotation[prior.vehicle]
            self._begin(replace(prior, yaw=None if turned is None or np.isnan(turned) else turned))
        return observation

    def _begin(self, prior: Prior) -> None:
        """Replace a vehicle's belief by one that rests on nothing that was heard before."""
        assert self._method is not None
        self._method.start(prior)
        self._settling.done[prior.vehicle] = True
        self._hearsay.forget(prior.vehicle)
        self._outage.forget(prior.vehicle)

    def _displacement(self, motion: Motion | None) -> tuple[Array, Array]:
        """Return how vehicles moved in the map (V, D) [m], NaN if unknown, and variances (V,)."""
        unknown = np.full((self.vehicles, self.config.dimension), np.nan)
        estimate = self._estimate
        if motion is None or motion.displacement is None or estimate is None:
            return unknown, np.zeros(self.vehicles)
        config, moved = self.motion_config, motion.displacement.copy()
        oriented = estimate.rotation_variance < _WELL_ORIENTED ** 2
        angle = np.where(oriented, estimate.rotation, np.nan)
        x, y = motion.displacement[:, 0], motion.displacement[:, 1]
        moved[:, 0] = np.cos(angle) * x - np.sin(angle) * y
        moved[:, 1] = np.sin(angle) * x + np.cos(angle) * y
        errs = config.alpha3 ** 2 + estimate.rotation_variance
        return moved, config.odom_std ** 2 * motion.elapsed + errs * np.square(moved).sum(axis=1)

    def _drop_astray(self, observation: Observation) -> Array:
        """
        Drop the beliefs that were lost for long, and return whose (V,) bool.

        Methods notice by themselves when measurements contradict for long. Who is heard and who
        is silent contradicts softly where beacons may get lost, and so must be counted.
        """
        assert self._method is not None
        config, heard = self.method_config, observation.heard.any(axis=1)
        lost = self._monitor.lost > 0.5
        if lost.any():
            lost &= ~self.channel.measured(observation).any(axis=1)
        self._astray = np.where(heard, np.where(lost, self._astray + 1, 0), self._astray)
        # Methods without a patience are exact, and lose nothing.
        if not isinstance(config, RecoveryConfig):
            return np.zeros(self.vehicles, bool)
        astray = heard & (self._astray > config.patience)
        for vehicle in np.flatnonzero(astray).tolist():
            self._method.forget(vehicle)
            self._hearsay.forget(vehicle)
        self._astray[astray] = 0
        return astray

    def _bridged(self, stamp: float) -> list[Prior]:
        """Return where those vehicles are whose odometry is back; drop beliefs of no more use."""
        odometry = self._odometry.at_epoch
        if self._estimate is None:
            return []
        self._bridges.leave(self._estimate, self._speed, self.status != LOST, odometry)
        arrived = self._bridges.arrive(stamp, odometry)
        for vehicle, prior in arrived.items():
            if prior is None:
                self.reinitialize(vehicle)
        return [prior for prior in arrived.values() if prior is not None]

    def _through_outage(self, estimate: Estimate, observation: Observation, motion: Motion | None,
                        bridged: Sequence[Prior] = ()) -> Estimate:
        """
        Return the estimate with those vehicles predicted that hear nothing.

        Odometry measures what a predictor only supposes, so where there is any the method's own
        prediction stays; and so it does for vehicles that are said to move at random.
        """
        if (self.config.outage_predictor == 'none'
                or self.config.method in _PREDICTS_OUTAGES
                or self.motion_config.motion_model == 'random'):
            return estimate
        self._outage.forget(estimate.reinitialized)
        self._outage.learn(estimate, observation)
        heard = estimate.heard > 0
        if motion is not None and motion.displacement is not None:
            heard = heard | np.isfinite(motion.displacement).all(axis=1)
        heard[[prior.vehicle for prior in bridged]] = True
        return self._outage.replace(estimate, ~heard)

    def _listen(self, observation: Observation) -> Observation:
        """Add the silence of the known anchors around where the vehicles may be."""
        nowhere = np.full((self.vehicles, self.config.dimension), np.nan)
        if self._estimate is None or self._last is None:
            return self._anchors.listen(observation, nowhere, np.zeros(self.vehicles))
        spread = np.sqrt(np.trace(self._estimate.covariance, axis1=1, axis2=2))
        moved = self.motion_config.max_speed * (observation.stamp - self._last)
        return self._anchors.listen(observation, self._estimate.mean, 4 * spread + moved)

    def _learn_links(self) -> None:
        """Calibrate by the links between those who are heeded."""
        links = self._links
        if not self.speakers.heed_all:
            heeds = self.speakers.heeds
            links = links.picked(heeds(links.receiver) & heeds(links.sender))
        self.channel.learn(links)

    def _guarded(self, observation: Observation) -> Observation:
        """Believe no more of other vehicles than they can know without this one."""
        if not self.evidence_config.use_vehicles:
            vehicles = observation.kind == VEHICLE
            return replace(observation, sender=np.where(vehicles, PADDED, observation.sender))
        if self._estimate is None:
            return observation
        return guard(observation, self._estimate.mean, self._estimate.covariance,
                     self.evidence_config.echo_guard)

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
        motion = motion_model(self.motion_config, config.dimension, odometry)
        self.channel.follow(motion, self.vehicles, config.dimension)
        method: Estimator = METHODS[config.method](
            self.method_config, self.channel, motion, self.vehicles, config.dimension, self._rng)
        return method

    def _adopt_odometry(self, estimate: Estimate) -> None:
        """Go on by odometry that began late, from where the vehicles are."""
        self._awaits_odometry = False
        self._method = self._make_method(True)
        for vehicle in np.flatnonzero(np.isfinite(estimate.mean).all(axis=1)).tolist():
            self._method.start(
                Prior(vehicle, estimate.mean[vehicle], estimate.covariance[vehicle]))
            self._hearsay.forget(vehicle)

    def _rotated(self, prior: Prior) -> Prior:
        """Return the prior with the odometry frame's rotation in place of the vehicle's yaw."""
        turned = self._odometry.at_epoch[prior.vehicle, 3]
        if prior.yaw is None or np.isnan(turned):
            return prior
        return replace(prior, yaw=prior.yaw - float(turned))

    def _start(self, stamp: float) -> None:
        """Give every vehicle what it is to start from, ahead of what messages brought."""
        config = self.config
        priors = [resumed(last, stamp, self._odometry.at_epoch[last.vehicle],
                          self.motion_config.max_speed, self.channel.radio_range)
                  for last in self._lasts]
        self._priors[:0] = [prior for prior in priors if prior is not None]
        self._lasts = []
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
        wait = self.config.max_wait + (0.0 if stamp in self._pending else self._lag)
        if self._now >= stamp + wait:
            return True
        if (self._passed < stamp).any():
            return False
        expected = self._odometry.latest > -np.inf
        if self._method is None:
            # Nobody knows yet who has odometry.
            expected[:] = True
        return bool((self._odometry.latest[expected] >= stamp).all())

    @property
    def _span(self) -> float:
        """How far apart stamps may be that tell the same time [s]."""
        return max(self.config.time_jump, _SPAN)

    def _stray(self, what: str, stamp: float) -> MessageError:
        return MessageError(
            f'{what}: stamp {stamp:.6f} s is not allowed, must be within {self._span:g} s of what '
            f'most vehicles tell, {self._now:.6f} s')

    def _follow(self, stamp: float) -> None:
        """Take up the time that most vehicles tell, and what was held back of them."""
        begin, held = self._timeline.follow(stamp)
        if begin < self._now or self._is_far_ahead(begin):
            self._restart()
        else:
            self._now = begin
        for one in held:
            try:
                one.again()
            except MessageError as error:
                self._refused.append((one.vehicle, error))

    def _is_far_ahead(self, stamp: float) -> bool:
        """Tell whether a stamp is so far ahead that nobody can say what has happened since."""
        return -np.inf < self._now < stamp - LONGEST_LEAP

    def _restart(self) -> None:
        """Start anew; epochs that still waited are not lost."""
        self._ready = self.finish()
        given_up = self._timeline.given_up
        self.reset()
        self._timeline.given_up = given_up
        self.restarts += 1
