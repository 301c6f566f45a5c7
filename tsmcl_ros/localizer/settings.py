"""What a localizer is configured by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tsmcl_ros.config import adjust, build, Config, param, refuse_unknown
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.health import HealthConfig
from tsmcl_ros.model.motion import MotionConfig
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.model.speakers import SpeakerConfig
from tsmcl_ros.types import ConfigError


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


class Settings:
    """
    The parameters of a localizer; live ones change in their places.

    Parameters
    ----------
    values : Mapping
        Values of the parameters of `CONFIGS` by name; what is absent has its default.

    Raises
    ------
    ConfigError
        If a value is not allowed or a name is unknown.

    """

    def __init__(self, values: Mapping[str, Any]):
        refuse_unknown(values, CONFIGS, 'localizer')
        self.localizer = build(LocalizerConfig, values)
        self.speakers = build(SpeakerConfig, values)
        self.motion = build(MotionConfig, values)
        self.method = build(METHODS[self.localizer.method].Config, values)
        self.radio = build(RadioConfig, values)
        self.evidence = build(EvidenceConfig, values)
        self.health = build(HealthConfig, values)

    @property
    def told(self) -> tuple[Config, ...]:
        """What bags that it has made tell."""
        return (self.localizer, self.speakers, self.radio, self.evidence, self.motion,
                self.method)

    def adjust(self, values: Mapping[str, Any]) -> None:
        """Take over other values of live parameters; see `Localizer.reconfigure`."""
        refuse_unknown(values, CONFIGS, 'localizer')
        adjust((*self.told, self.health), values)
