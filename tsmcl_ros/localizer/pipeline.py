"""The localizer: messages in, estimates out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from tsmcl_ros.config import Config
from tsmcl_ros.localizer.core import Core
from tsmcl_ros.localizer.health import Health
from tsmcl_ros.localizer.schedule import Schedule
from tsmcl_ros.localizer.settings import Settings
from tsmcl_ros.model.echo import certain
from tsmcl_ros.model.learning_channel import LearningChannel
from tsmcl_ros.model.learnt import Learnt
from tsmcl_ros.model.period import PeriodConfig
from tsmcl_ros.model.resume import Last
from tsmcl_ros.model.silence import KnownAnchors
from tsmcl_ros.model.speakers import Speakers
from tsmcl_ros.model.tally import Tally
from tsmcl_ros.types import (
    Array,
    Estimate,
    Links,
    MessageError,
    Observation,
    Odometry,
    Prior,
    UNTRUE,
)

_NOTHING = Learnt()


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
    untrue : Tally
        Whose beacons were left out, as they cannot be true.
    schedule : Schedule
        Whom messages with stamps that come by other ways have to ask.

    Raises
    ------
    ConfigError
        If a value is not allowed or a name is unknown.

    """

    def __init__(self, settings: Mapping[str, Any], vehicles: int = 1):
        self._settings = Settings(settings)
        self.config = self._settings.localizer
        self.motion_config = self._settings.motion
        self.health_config = self._settings.health
        self.vehicles = vehicles
        self.restarts = 0
        self.speakers = Speakers(self._settings.speakers, vehicles)
        self.untrue = Tally(vehicles)
        self.schedule = Schedule(self.config, vehicles, self._restart)
        self._anchors = KnownAnchors(
            self._settings.evidence.silence, vehicles, self.config.dimension)
        self._links = Links.none()
        self._ready: list[Estimate] = []
        self._core = Core(self._settings, self._anchors, self.speakers, vehicles)
        self._learn_links()
        # Where method and motion do not fit, fail now rather than at the first epoch.
        self._core.belief.check()

    @property
    def configs(self) -> tuple[Config, ...]:
        """All that it is configured by."""
        return self._settings.told

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
        self._settings.adjust(settings)
        self.schedule.adjust()
        self._learn_links()

    def reset(self) -> None:
        """Forget all but the configuration, the anchors' map and links, and what `resume` gave."""
        self.schedule.reset()
        self._core = self._core.anew()
        self._learn_links()

    @property
    def now(self) -> float:
        """Latest time that a message or `clock` has told [s], -inf before any has."""
        return self.schedule.now

    def clock(self, stamp: float) -> None:
        """Let time pass [s] without a message; a jump starts anew."""
        self.schedule.clock(stamp)

    def refused(self) -> list[tuple[int, MessageError]]:
        """Return, once, which vehicles' messages were refused after they had been held back."""
        return self.schedule.refused()

    @property
    def channel(self) -> LearningChannel:
        """What tells what measurements mean."""
        return self._core.channel

    @property
    def estimate(self) -> Estimate | None:
        """The last epoch's estimate, None before the first."""
        return self._core.estimate

    @property
    def particles(self) -> Array:
        """(V, N, D) float32: the cloud [m]; (V, 0, D) before the first epoch."""
        return self._core.belief.particles

    @property
    def asks_period(self) -> bool:
        """Whether the method says how often vehicles want beacons."""
        return isinstance(self._settings.method, PeriodConfig) and self._settings.method.asks

    @property
    def status(self) -> Array:
        """(V,) int: OK, STALE or LOST as of the last epoch."""
        return self._core.status

    @property
    def health(self) -> Health:
        """How the localization is doing as of the last epoch."""
        return self._core.health

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
        self._core.credibility.claims.learn_map(self._anchors.mapped)

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

        Vehicles that claim to know their place exactly are left out.

        Raises
        ------
        MessageError
            If it comes too late.

        """
        stamp, latest = observation.stamp, self.schedule.passed[vehicle]
        again = partial(self.beacons, vehicle, observation)
        if not self.schedule.admit('beacons', vehicle, stamp, latest, again):
            return
        if self._core.estimate is not None:
            self.schedule.refuse_late(stamp, self._core.estimate)
        observation = observation.project(self.config.dimension)
        observation = self.speakers.heed(observation, [vehicle])
        exact, fault = certain(observation)
        if fault:
            self.untrue.count(vehicle, observation.sender[exact].tolist(), fault)
            observation = replace(observation, kind=np.where(exact, UNTRUE, observation.kind))
        self.schedule.add(vehicle, observation)

    def odometry(self, vehicle: int, odometry: Odometry) -> None:
        """
        Take in one odometry pose of one vehicle.

        Raises
        ------
        MessageError
            If it comes too late.

        """
        again = partial(self.odometry, vehicle, odometry)
        latest = self._core.odometry.latest[vehicle]
        if self.schedule.admit('odometry', vehicle, odometry.stamp, latest, again):
            self._core.odometry.add(vehicle, odometry)
            self.schedule.note(odometry.stamp)

    def initial_pose(self, prior: Prior) -> None:
        """Replace one vehicle's belief at the next epoch; the yaw is the vehicle's in the map."""
        self._core.priors.append(prior)

    def resume(self, lasts: Sequence[Last], learnt: Learnt = _NOTHING) -> None:
        """Begin, at the first epoch, where another localizer left its vehicles, and as wise."""
        self._core.lasts, self._core.given = list(lasts), learnt

    def last_known(self) -> list[Last]:
        """Return what another localizer can begin with: those vehicles that are not lost."""
        return self._core.last_known()

    @property
    def learnt(self) -> Learnt:
        """What another localizer can begin with of the radio."""
        return self._core.learnt

    def reinitialize(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts from anywhere at its next beacon."""
        self._core.reinitialize(vehicle)

    def due(self) -> list[Estimate]:
        """Return the estimates of the epochs that have become complete, in order of time."""
        estimates, self._ready = self._ready, []
        core = self._core
        while (stamp := self.schedule.due(
                core.last, core.odometry.latest, core.belief.has_begun)) is not None:
            estimates.append(core.epoch(self.schedule.take(stamp)))
        return estimates

    def finish(self) -> list[Estimate]:
        """Return the estimates of the epochs still waiting, as nothing will come any more."""
        self.schedule.end()
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
            self._core.odometry.add_all(observation.stamp, position, yaw)
        return self._core.epoch(self.speakers.heed(
            observation.project(self.config.dimension), range(self.vehicles)))

    def _learn_links(self) -> None:
        """Calibrate by the links between those who are heeded."""
        self._core.channel.learn(self.speakers.heed_links(self._links))

    def _restart(self) -> None:
        """Start anew; epochs that still waited are not lost."""
        self._ready = self.finish()
        self.reset()
        self.restarts += 1
