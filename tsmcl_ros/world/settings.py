"""How vehicles of a simulated world move, and what becomes of what they hear and measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.mobility import (
    Manhattan,
    ManhattanConfig,
    Manoeuvre,
    ManoeuvreConfig,
    Mobility,
    RandomWaypoint,
    RandomWaypointConfig,
)
from tsmcl_ros.traces import FOLLOW, TraceConfig

# Each is made from its config, the number of vehicles, and a random generator of its own.
MOBILITY: dict[str, tuple[type[Config], Callable[[Any, int, np.random.Generator], Mobility]]] = {
    'random_waypoint': (RandomWaypointConfig, RandomWaypoint),
    'manhattan': (ManhattanConfig, Manhattan),
    'manoeuvre': (ManoeuvreConfig, Manoeuvre),
    **{kind: (TraceConfig, follow) for kind, follow in FOLLOW.items()},
}


@dataclass(frozen=True)
class MobilityConfig(RandomWaypointConfig, ManhattanConfig, ManoeuvreConfig, TraceConfig):
    """Parameters of all mobilities, several of which share some."""


@dataclass(frozen=True)
class WorldConfig(Config):
    """The fleet, its odometry, and what becomes of beacons on the air."""

    vehicles: int = param(40, 'number of vehicles', low=1, high=100_000)
    mobility: str = param(
        'random_waypoint', 'how vehicles move: three models, or a trace of a format that is '
        'recognised or named', choices=tuple(MOBILITY))
    beacon_period: float = param(1.0, 'time between two beacons of a sender', unit='s', above=0,
                                 high=3600)
    drop_rate: float = param(0.0, 'share of beacons lost, to collisions say, however near',
                             low=0, high=1)
    odom_noise: float = param(
        0.5, 'standard deviation of the odometry displacement of one period, per axis', unit='m',
        low=0, high=1e4)
    odom_scale_noise: float = param(
        0.0, 'standard deviation of the odometry scale, constant for each vehicle', low=0, high=1)
    odom_yaw_noise: float = param(
        0.0, 'standard deviation of the odometry heading drift of one period', unit='rad', low=0,
        high=math.pi)
    odom_heading: str = param(
        'known', 'the odometry frame has the orientation of the map, or that of the vehicle at '
        'its start', choices=('known', 'unknown'))
