"""
The simulated world: where vehicles truly are, what their wheels tell them and their radios hear.

The parts serve on their own too: the simulator node moves vehicles here and lets them `receive`
what anchors really transmitted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from scipy.spatial import KDTree
from tsmcl_ros.config import build, Config, param
from tsmcl_ros.model.mobility import (
    Manhattan,
    ManhattanConfig,
    Manoeuvre,
    ManoeuvreConfig,
    Mobility,
    RandomWaypoint,
    RandomWaypointConfig,
    State,
    wrap,
)
from tsmcl_ros.model.period import Schedule
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.relay import Poses, relay, RelayConfig, vehicle_beacons
from tsmcl_ros.traces import FOLLOW, TraceConfig
from tsmcl_ros.types import Array, ConfigError, Links, Observation, Rows

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
    WorldConfig, AnchorConfig, RadioConfig, RelayConfig, MobilityConfig,
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

    Movement, odometry, the radio of anchors and that of vehicles draw from generators of their
    own: a seed gives the same ways, odometry, and beacons of anchors whatever the others do.

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
    relaying : RelayConfig, optional
        What vehicles transmit themselves.

    Attributes
    ----------
    schedule : Schedule
        How often each vehicle gets beacons of anchors.

    """

    def __init__(
        self,
        config: WorldConfig,
        channel: Channel,
        mobility: Mobility,
        anchors: Observation,
        rng: np.random.Generator,
        stamp: float = 0.0,
        relaying: RelayConfig | None = None,
    ) -> None:
        self.mobility = mobility
        self.anchors = anchors
        self._config = config
        self._channel = channel
        self._relaying = relaying or RelayConfig()
        odometry_rng, self._radio_rng, self._peer_rng = rng.spawn(3)
        self._odometry = WheelOdometry(config, mobility.state, odometry_rng)
        self._odometry_since = deque(
            [self._odometry.position], math.ceil(self._relaying.pose_max_age) + 1)
        self.schedule = Schedule(len(mobility.state.yaw))
        self._begin = stamp
        self._periods = 0

    def step(self, senders: Observation | None = None, poses: Poses | None = None) -> Epoch:
        """
        Let one beacon period pass.

        Parameters
        ----------
        senders : Observation or None
            V = 1: what was transmitted in this period, if not what all anchors do.
        poses : Poses or None
            Where the vehicles last took themselves to be, which they broadcast: from where they
            truly are, if it is neither too old nor too uncertain. None if they keep it to
            themselves.

        Returns
        -------
        Epoch

        Raises
        ------
        LogError
            If the vehicles replay a trace and it has ended.
        ConfigError
            If the channel has no radio range, or an anchor has the identity of a vehicle.

        """
        truth = self.mobility.step(self._config.beacon_period)
        self._periods += 1
        stamp = self._begin + self._periods * self._config.beacon_period
        odom_position, odom_yaw = self._odometry.step(truth)
        self._odometry_since.append(odom_position)
        senders = self.anchors if senders is None else senders
        observation = receive(self._channel, truth.position, senders, self._radio_rng, stamp,
                              self._config.drop_rate)
        observation = self.schedule.pass_on(observation)
        if poses is not None or self._relaying.relay_hops > 1:
            self._relaying.refuse_anchors(senders, len(truth.yaw))
            observation = self._exchange(observation, truth.position, poses)
        return Epoch(stamp, truth.position, truth.velocity, truth.yaw, odom_position, odom_yaw,
                     observation)

    def _exchange(self, heard: Observation, position: Array, poses: Poses | None) -> Observation:
        """Add what the vehicles at these positions (V, D) [m] hear of each other."""
        vehicles, dimension = position.shape
        now = Poses.unknown(vehicles, dimension) if poses is None else self._up_to_date(
            poses, heard.stamp)
        beacons = vehicle_beacons(self._relaying, now)
        pairs = _apart(self._channel.reach, position)
        listener, neighbour, rows = _hear(
            self._channel, pairs, beacons, self._peer_rng, self._config.drop_rate)
        # Who is lost is a neighbour too, but says nothing of where it is.
        reliable = now.within(self._relaying.pose_max_spread * self._channel.radio_range)
        placed = np.flatnonzero(reliable[neighbour])
        parts: list[Rows] = [
            (listener[placed],
             {name: values.take(placed, axis=0) for name, values in rows.items()})]
        if self._relaying.relay_hops > 1:
            parts.append(relay(heard, listener, neighbour, self._channel.radio_range))
        return heard.followed_by(parts)

    def _up_to_date(self, poses: Poses, stamp: float) -> Poses:
        """
        Return the poses as of now [s], without those that are too old.

        A pose is a period old when it is broadcast, as it was made from the last beacons. Where
        the odometry frame has the map's orientation it is moved by the vehicle's odometry since,
        and its covariance grows by what that errs: the noise, and by the way driven the scale
        noise and the heading drift since the start. Else it stays, and its covariance grows as
        if the vehicle were anywhere within `pose_max_speed` times its age.
        """
        config, dimension = self._config, poses.mean.shape[1]
        age = (stamp - poses.stamp) / config.beacon_period
        usable = (age > -1e-6) & (age < self._relaying.pose_max_age + 1e-6)
        age = np.where(usable, np.maximum(age, 0), 0)
        if config.odom_heading == 'known':
            displacement = self._way(age)
            drift = config.odom_scale_noise ** 2 + config.odom_yaw_noise ** 2 * self._periods
            variance = (config.odom_noise ** 2 * age
                        + drift * np.square(displacement).sum(axis=1))
        else:
            displacement = np.zeros_like(poses.mean)
            reach = self._relaying.pose_max_speed * config.beacon_period * age
            variance = reach ** 2 / (dimension + 2)
        variance = np.where(usable, variance, np.nan)
        return poses.moved(displacement, variance)

    def _way(self, age: Array) -> Array:
        """Return the displacement (V, D) [m] that odometry tells of the last so many periods."""
        ways = np.stack(self._odometry_since)
        last, vehicle = len(ways) - 1, np.arange(len(age))
        before = np.maximum(last - age, 0)
        low = np.floor(before).astype(int)
        share = (before - low)[:, None]
        then = (1 - share) * ways[low, vehicle] + share * ways[np.minimum(low + 1, last), vehicle]
        return np.asarray(ways[last] - then)


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
        V = 1: the K transmitted rows; each is sent from the position that it claims, of which
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
    pairs = _within(channel.reach, position, sent.position[0])
    vehicle, _, rows = _hear(channel, pairs, sent, rng, drop_rate)
    return Observation.tabulate(vehicle, rows, vehicles, dimension, stamp)


def hear_each_other(channel: Channel, anchors: Observation, rng: np.random.Generator) -> Links:
    """
    Return with which rssi anchors hear each other, of those of which both hear the other.

    Parameters
    ----------
    channel : Channel
        A radio that measures rssi.
    anchors : Observation
        V = 1: see `anchor_table`.
    rng : numpy.random.Generator
        For what the channel draws.

    Raises
    ------
    ConfigError
        If the channel has no radio range.

    """
    position, identity = anchors.position[0], anchors.sender[0]
    receiver, sender, distance = _apart(channel.reach, position)
    measured = channel.hear(distance[None], rng, identity[None, sender])
    mask = measured.mask[0]
    there, back = receiver * len(identity) + sender, sender * len(identity) + receiver
    both = mask & np.isin(there, back[mask])
    receiver, sender = receiver[both], sender[both]
    return Links(identity[receiver], identity[sender], position[receiver], position[sender],
                 measured.rssi[0, both])


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
    return World(build(WorldConfig, settings), channel, mobility, anchors, rng,
                 relaying=build(RelayConfig, settings))


def _hear(channel: Channel, pairs: tuple[Array, Array, Array], sent: Observation,
          rng: np.random.Generator, drop_rate: float) -> tuple[Array, Array, dict[str, Array]]:
    """
    Return who hears whom, of the pairs that `_within` found, as what rows of an observation.

    `sent` (V = 1) has no padding; vehicle and sender are indices (M,), rows (M, ...) by field.
    """
    vehicle, sender, distance = pairs
    measured = channel.hear(distance[None], rng, sent.sender[:, sender])
    mask = measured.mask[0]
    if drop_rate > 0:
        mask = mask & (rng.random(mask.shape) >= drop_rate)
    vehicle, sender = vehicle[mask], sender[mask]
    measures = (['range', 'range_std'] * channel.radio.measure_range
                + ['rssi'] * channel.radio.measure_rssi)
    return vehicle, sender, {
        'max_range': np.full(len(vehicle), channel.radio_range),
        **{name: getattr(sent, name)[0].take(sender, axis=0)
           for name in ('sender', 'kind', 'hops', 'position', 'covariance')},
        **{name: getattr(measured, name)[0, mask] for name in measures},
    }


def _within(reach: float, vehicles: Array, senders: Array) -> tuple[Array, Array, Array]:
    """
    Find the pairs of a vehicle (V, D) and a sender (A, D) that are within reach [m].

    Returns indices of vehicles and of senders, and distances [m], sorted in that order.
    """
    pairs = _tree(vehicles).sparse_distance_matrix(
        _tree(senders), _beyond(reach), output_type='ndarray')
    return _measured(pairs['i'] * len(senders) + pairs['j'], vehicles, senders)


def _apart(reach: float, vehicles: Array) -> tuple[Array, Array, Array]:
    """Find, as `_within` does, the pairs of two vehicles (V, D), either of them first."""
    one, other = _tree(vehicles).query_pairs(_beyond(reach), output_type='ndarray').T
    count = len(vehicles)
    return _measured(
        np.concatenate([one * count + other, other * count + one]), vehicles, vehicles)


def _tree(points: Array) -> KDTree:
    """Return a tree that serves one search: to balance it would cost more than it saves."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)


def _beyond(reach: float) -> float:
    """Return a little more than the reach: its very edge is the channel's to judge."""
    return reach * (1 + 1e-9)


def _measured(pairs: Array, vehicles: Array, senders: Array) -> tuple[Array, Array, Array]:
    """Sort pairs, numbered row by row, into indices and distances: see `_within`."""
    vehicle, sender = np.divmod(np.sort(pairs), len(senders))
    return vehicle, sender, np.linalg.norm(
        vehicles.take(vehicle, axis=0) - senders.take(sender, axis=0), axis=1)


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
