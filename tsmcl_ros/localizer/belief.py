"""What vehicles believe, with all that must be forgotten with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tsmcl_ros.localizer.settings import Settings
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.cloud import RecoveryConfig
from tsmcl_ros.model.echo import Hearsay
from tsmcl_ros.model.learning_channel import LearningChannel
from tsmcl_ros.model.motion import motion_model
from tsmcl_ros.model.outage import OutagePredictor
from tsmcl_ros.model.settling import Settling
from tsmcl_ros.types import Array, Estimate, Estimator, Motion, Observation, Prior

# Methods that are made for outages, and so predict through them on their own.
_PREDICTS_OUTAGES = ('grey_ekf',)


class Belief:
    """
    The beliefs of V vehicles.

    Parameters
    ----------
    settings : Settings
        Read at every use, as they may change.
    channel : LearningChannel
        Tells what measurements mean.
    vehicles : int
        V.

    Attributes
    ----------
    awaits_odometry : bool
        Whether odometry that begins late is to be adopted.
    hearsay : Hearsay
        What the estimates owe to others.
    outage : OutagePredictor
        Predicts those who hear nothing.
    settling : Settling
        Whose place is not one of several yet.

    """

    def __init__(self, settings: Settings, channel: LearningChannel, vehicles: int):
        config = settings.localizer
        self._settings, self._channel, self._vehicles = settings, channel, vehicles
        self._rng = np.random.Generator(np.random.SFC64(config.seed))
        self._method: Estimator | None = None
        self._astray = np.zeros(vehicles, int)
        self.awaits_odometry = False
        self.hearsay = Hearsay(vehicles, config.dimension)
        self.outage = OutagePredictor(
            vehicles, config.dimension, config.outage_predictor == 'grey_ekf')
        self.settling = Settling(vehicles)

    @property
    def has_begun(self) -> bool:
        """Whether there is a method already."""
        return self._method is not None

    @property
    def particles(self) -> Array:
        """(V, N, D) float32: the cloud [m]; (V, 0, D) before it has begun."""
        if self._method is None:
            return np.zeros((self._vehicles, 0, self._settings.localizer.dimension), np.float32)
        return self._method.particles

    @property
    def method(self) -> Estimator:
        """The method, once it has begun."""
        assert self._method is not None
        return self._method

    def check(self) -> None:
        """Hold that method and motion fit, where the motion is not to be seen first."""
        if self._settings.motion.motion_model != 'auto':
            self._make_method(False)

    def begin(self, odometry: bool) -> None:
        """Begin from anywhere, by odometry or without."""
        self._method = self._make_method(odometry)
        self.awaits_odometry = self._settings.motion.motion_model == 'auto' and not odometry

    def adopt_odometry(self, estimate: Estimate) -> None:
        """Go on by odometry that began late, from where the vehicles are."""
        self.awaits_odometry = False
        self._method = self._make_method(True)
        for vehicle in np.flatnonzero(np.isfinite(estimate.mean).all(axis=1)).tolist():
            self.resume(Prior(vehicle, estimate.mean[vehicle], estimate.covariance[vehicle]))

    def resume(self, prior: Prior) -> None:
        """Replace a vehicle's belief by what its own has become."""
        self._take(prior)
        self.hearsay.forget(prior.vehicle)

    def replace(self, prior: Prior) -> None:
        """Replace a vehicle's belief by one that rests on nothing that was heard before."""
        self._take(prior)
        self.settling.done[prior.vehicle] = True
        self.hearsay.forget(prior.vehicle)
        self.outage.forget(prior.vehicle)

    def forget(self, vehicle: int) -> None:
        """Drop a vehicle's belief."""
        self.outage.forget(vehicle)
        self.settling.done[vehicle] = False
        self.hearsay.forget(vehicle)
        if self._method is not None:
            self._method.forget(vehicle)
            self._channel.forget(vehicle)

    def drop_astray(self, observation: Observation, lost: Array) -> Array:
        """
        Drop the beliefs that were lost (V,) bool for long, and return whose (V,) bool.

        Methods notice by themselves when measurements contradict for long. Who is heard and who
        is silent contradicts softly where beacons may get lost, and so must be counted.
        """
        config, heard = self._settings.method, observation.heard.any(axis=1)
        if lost.any():
            lost = lost & ~self._channel.measured(observation).any(axis=1)
        self._astray = np.where(heard, np.where(lost, self._astray + 1, 0), self._astray)
        # Methods without a patience are exact, and lose nothing.
        if not isinstance(config, RecoveryConfig):
            return np.zeros(self._vehicles, bool)
        astray = heard & (self._astray > config.patience)
        for vehicle in np.flatnonzero(astray).tolist():
            self.method.forget(vehicle)
            self.hearsay.forget(vehicle)
        self._astray[astray] = 0
        return astray

    def through_outage(self, estimate: Estimate, observation: Observation, motion: Motion | None,
                        bridged: Sequence[Prior] = ()) -> Estimate:
        """
        Return the estimate with those vehicles predicted that hear nothing.

        Odometry measures what a predictor only supposes, so where there is any the method's own
        prediction stays; and so it does for vehicles that are said to move at random.
        """
        if (self._settings.localizer.outage_predictor == 'none'
                or self._settings.localizer.method in _PREDICTS_OUTAGES
                or self._settings.motion.motion_model == 'random'):
            return estimate
        self.outage.forget(estimate.reinitialized)
        self.outage.learn(estimate, observation)
        heard = estimate.heard > 0
        if motion is not None and motion.displacement is not None:
            heard = heard | np.isfinite(motion.displacement).all(axis=1)
        heard[[prior.vehicle for prior in bridged]] = True
        return self.outage.replace(estimate, ~heard)

    def _take(self, prior: Prior) -> None:
        self.method.start(prior)
        self._channel.start(prior)

    def _make_method(self, odometry: bool) -> Estimator:
        config = self._settings.localizer
        motion = motion_model(self._settings.motion, config.dimension, odometry)
        self._channel.follow(motion, self._vehicles, config.dimension)
        method: Estimator = METHODS[config.method](
            self._settings.method, self._channel, motion, self._vehicles, config.dimension,
            self._rng)
        return method
