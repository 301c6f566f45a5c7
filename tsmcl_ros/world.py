"""
The simulated world: where vehicles truly are, what their wheels tell them and their radios hear.

The parts serve on their own too: the simulator node moves vehicles here and lets them `receive`
what anchors really transmitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from tsmcl_ros.config import build, Config, param
from tsmcl_ros.fcd import FcdConfig, replay_fcd
from tsmcl_ros.model.mobility import (
    Mobility,
    RandomWaypoint,
    RandomWaypointConfig,
    State,
    wrap,
)
from tsmcl_ros.model.radio import Channel, RadioConfig
from tsmcl_ros.types import Array, ConfigError, Observation

# Each is made from its config, the number of vehicles, and a random generator of its own.
MOBILITY: dict[str, tuple[type[Config], Callable[[Any, int, np.random.Generator], Mobility]]] = {
    'random_waypoint': (RandomWaypointConfig, RandomWaypoint),
    'fcd': (FcdConfig, replay_fcd),
}


@dataclass(frozen=True)
class WorldConfig(Config):
    """The fleet, its odometry, and what becomes of beacons on the air."""

    vehicles: int = param(40, 'number of vehicles', low=1, high=100_000)
    mobility: str = param('random_waypoint', 'how vehicles move', choices=tuple(MOBILITY))
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


@dataclass(frozen=True)
class AnchorConfig(Config):
    """Where anchors stand."""

    anchor_layout: str = param(
        'grid', 'on a jittered grid, anywhere in the rectangle of that grid, or as listed',
        choices=('grid', 'uniform', 'list'))
    anchor_rows: int = param(4, 'anchors along y', low=1, high=10_000)
    anchor_columns: int = param(4, 'anchors along x', low=1, high=10_000)
    anchor_spacing: float = param(1000.0, 'side of a grid cell, in which one anchor stands',
                                  unit='m', above=0, high=1e5)
    anchor_jitter: float = param(
        200.0, 'furthest that an anchor is off the middle of its cell, along each axis', unit='m',
        low=0, high=1e5)
    anchor_origin_x: float = param(0.0, 'lower left corner of the grid', unit='m', low=-1e5,
                                   high=1e5)
    anchor_origin_y: float = param(0.0, 'see anchor_origin_x', unit='m', low=-1e5, high=1e5)
    anchor_height: float = param(
        0.0, 'in three dimensions anchors stand anywhere between 0 and this height', unit='m',
        low=0, high=1e5)
    anchor_positions: tuple[str, ...] = param((), 'the listed anchors: "x y" or "x y z" each [m]')


# All that `make_world` reads its settings into.
CONFIGS: tuple[type[Config], ...] = (
    WorldConfig, AnchorConfig, RadioConfig, *(config for config, _ in MOBILITY.values()),
)


@dataclass(frozen=True, eq=False)
class Epoch:
    """
    The world at the end of one beacon period.

    Attributes
    ----------
    stamp : float
        [s].
    position, velocity : (V, D) float64
        The truth [m], [m/s].
    yaw : (V,) float64
        The truth [rad].
    odom_position : (V, D) float64
        In each vehicle's odometry frame, which begins where the vehicle did [m].
    odom_yaw : (V,) float64
        In the odometry frame [rad].
    observation : Observation
        What the V radios heard.
    """

    stamp: float
    position: Array
    velocity: Array
    yaw: Array
    odom_position: Array
    odom_yaw: Array
    observation: Observation


class World:
    """
    Vehicles under way among anchors, from one beacon period to the next.

    Movement, odometry and radio draw from generators of their own: a seed gives the same ways
    and the same odometry whatever the radio does.

    Parameters
    ----------
    config : WorldConfig
    channel : Channel
    mobility : Mobility
        V vehicles in D dimensions.
    anchors : Observation
        V = 1: what all anchors transmit each period; see `anchor_table`.
    rng : numpy.random.Generator
    stamp : float
        The time now [s]; the first epoch is one period later.
    """

    def __init__(
        self,
        config: WorldConfig,
        channel: Channel,
        mobility: Mobility,
        anchors: Observation,
        rng: np.random.Generator,
        stamp: float = 0.0,
    ) -> None:
        self.mobility = mobility
        self.anchors = anchors
        self._config = config
        self._channel = channel
        odometry_rng, self._radio_rng = rng.spawn(2)
        self._odometry = WheelOdometry(config, mobility.state, odometry_rng)
        self._begin = stamp
        self._periods = 0

    def step(self, senders: Observation | None = None) -> Epoch:
        """
        Let one beacon period pass.

        Parameters
        ----------
        senders : Observation or None
            V = 1: what was transmitted in this period, if not what all anchors do.

        Returns
        -------
        Epoch

        Raises
        ------
        LogError
            If the vehicles replay a trace and it has ended.
        ConfigError
            If the channel has no radio range.
        """
        truth = self.mobility.step(self._config.beacon_period)
        self._periods += 1
        stamp = self._begin + self._periods * self._config.beacon_period
        odom_position, odom_yaw = self._odometry.step(truth)
        observation = receive(
            self._channel, truth.position, self.anchors if senders is None else senders,
            self._radio_rng, stamp, self._config.drop_rate)
        return Epoch(stamp, truth.position, truth.velocity, truth.yaw, odom_position, odom_yaw,
                     observation)


class WheelOdometry:
    """
    What V vehicles believe of their own movement; it starts at 0 and drifts.

    Each period's displacement is rotated by a heading error that walks randomly, scaled by a
    factor constant for each vehicle, and has noise added along each axis.

    Parameters
    ----------
    config : WorldConfig
        Its `odom_` parameters.
    state : State
        Where the vehicles start.
    rng : numpy.random.Generator
    """

    def __init__(self, config: WorldConfig, state: State, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._true = state.position
        self._scale = 1 + config.odom_scale_noise * rng.standard_normal((state.yaw.size, 1))
        # Rotation from the map to what each vehicle takes for its odometry frame.
        self._rotation = np.zeros_like(state.yaw) if config.odom_heading == 'known' else -state.yaw
        self.position = np.zeros_like(state.position)
        self.yaw = wrap(state.yaw + self._rotation)

    def step(self, state: State) -> tuple[Array, Array]:
        """Return position (V, D) [m] and yaw (V,) [rad] after one period that led to a state."""
        config, rng = self._config, self._rng
        self._rotation = self._rotation + config.odom_yaw_noise * rng.standard_normal(
            state.yaw.shape)
        moved = self._scale * (state.position - self._true)
        cos, sin = np.cos(self._rotation), np.sin(self._rotation)
        x, y = moved[:, 0].copy(), moved[:, 1].copy()
        moved[:, 0], moved[:, 1] = cos * x - sin * y, sin * x + cos * y
        self._true = state.position
        self.position = self.position + moved + config.odom_noise * rng.standard_normal(
            moved.shape)
        self.yaw = wrap(state.yaw + self._rotation)
        return self.position, self.yaw


def receive(
    channel: Channel,
    position: Array,
    senders: Observation,
    rng: np.random.Generator,
    stamp: float,
    drop_rate: float = 0.0,
) -> Observation:
    """
    Return what vehicles hear of what was transmitted.

    Parameters
    ----------
    channel : Channel
        The radio.
    position : (V, D) float
        Where the vehicles are [m].
    senders : Observation
        V = 1: the transmitted rows; each is sent from the position that it claims, of which
        the first D coordinates count.
    rng : numpy.random.Generator
        For what the channel and losses draw.
    stamp : float
        Reception time [s].
    drop_rate : float
        Share of beacons lost however near they are.

    Returns
    -------
    Observation
        V vehicles, padded to the most that one of them heard; each one's rows in the order of
        `senders`. Max_range, range, range_std and rssi are the channel's.

    Raises
    ------
    ConfigError
        If the channel has no radio range.
    """
    vehicles, dimension = position.shape
    sent = senders.vehicle(0).project(dimension)
    vehicle, sender, distance = _within(channel.reach, position, sent.position[0])
    measured = channel.hear(distance[None], rng, sent.sender[:, sender])
    mask = measured.mask[0]
    if drop_rate > 0:
        mask = mask & (rng.random(mask.shape) >= drop_rate)
    count = np.bincount(vehicle[mask], minlength=vehicles)
    sender = sender[mask]
    received = Observation.empty(vehicles, int(count.max(initial=0)), dimension, stamp)
    # Pairs are sorted by vehicle, so they fill the table's rows in its own order.
    rows = np.arange(received.sender.shape[1]) < count[:, None]
    for name in ('sender', 'kind', 'hops', 'position', 'covariance'):
        getattr(received, name)[rows] = getattr(sent, name)[0].take(sender, axis=0)
    for name in ('range', 'range_std', 'rssi'):
        getattr(received, name)[rows] = getattr(measured, name)[0, mask]
    received.max_range[rows] = channel.radio_range
    return received


def anchor_table(position: Array, identity: Array | None = None) -> Observation:
    """
    Return what anchors transmit.

    Parameters
    ----------
    position : (A, D) float
        [m].
    identity : (A,) int or None
        By default 0, 1, 2 and so on.

    Returns
    -------
    Observation
        V = 1, K = A, at stamp 0.
    """
    anchors, dimension = position.shape
    table = Observation.empty(1, anchors, dimension, stamp=0.0)
    table.position[0] = position
    table.sender[0] = np.arange(anchors) if identity is None else identity
    return table


def lay_out(config: AnchorConfig, dimension: int, rng: np.random.Generator) -> Array:
    """
    Return positions (A, D) [m] of anchors in 2 or 3 dimensions, row by row.

    Raises
    ------
    ConfigError
        If anchors are to be listed, and the list is empty or holds what is no position.
    """
    if config.anchor_layout == 'list':
        if not config.anchor_positions:
            raise ConfigError('anchor_positions: () is not allowed with anchor_layout list, must '
                              'be a list of "x y" or "x y z"')
        return np.array([_listed(text, dimension) for text in config.anchor_positions])
    rows, columns = config.anchor_rows, config.anchor_columns
    if config.anchor_layout == 'grid':
        cell = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        plane = (cell + 0.5) * config.anchor_spacing
        plane += config.anchor_jitter * rng.uniform(-1, 1, plane.shape)
    else:
        plane = rng.random((rows * columns, 2)) * [columns, rows] * config.anchor_spacing
    plane += [config.anchor_origin_x, config.anchor_origin_y]
    height = rng.uniform(0, config.anchor_height, (len(plane), dimension - 2))
    return np.concatenate([plane, height], axis=1)


def make_mobility(settings: Mapping[str, Any], rng: np.random.Generator) -> Mobility:
    """
    Return the mobility that the settings, flat parameters by name, describe.

    Raises
    ------
    ConfigError, LogError
        If a parameter is not allowed; if a trace cannot be read.
    """
    world = build(WorldConfig, settings)
    config, make = MOBILITY[world.mobility]
    return make(build(config, settings), world.vehicles, rng)


def make_world(settings: Mapping[str, Any], rng: np.random.Generator) -> World:
    """
    Return the world that the settings, flat parameters by name, describe; see `CONFIGS`.

    Raises
    ------
    ConfigError, LogError
        If a parameter is not allowed; if a trace cannot be read.
    """
    mobility_rng, anchor_rng, rng = rng.spawn(3)
    mobility = make_mobility(settings, mobility_rng)
    dimension = mobility.state.position.shape[1]
    anchors = anchor_table(lay_out(build(AnchorConfig, settings), dimension, anchor_rng))
    channel = Channel(build(RadioConfig, settings))
    return World(build(WorldConfig, settings), channel, mobility, anchors, rng)


def _within(reach: float, vehicles: Array, senders: Array) -> tuple[Array, Array, Array]:
    """
    Find the pairs of a vehicle (V, D) and a sender (A, D) that are within reach [m].

    Returns indices of vehicles and of senders, and distances [m], sorted in that order.
    """
    # A little more than the reach: whether the very edge belongs to it is the channel's to say.
    pairs = KDTree(vehicles).sparse_distance_matrix(
        KDTree(senders), reach * (1 + 1e-9), output_type='ndarray')
    pairs = pairs[np.argsort(pairs['i'] * len(senders) + pairs['j'])]
    return pairs['i'], pairs['j'], pairs['v']


def _listed(text: str, dimension: int) -> list[float]:
    """Return the coordinates of a listed anchor; a height left out is 0."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise ConfigError(f'anchor_positions: {text!r} is not allowed, must be "x y" or "x y z" '
                          'in m')
    return [*values, 0.0][:dimension]
