"""Vehicles under way among anchors, from one beacon period to the next."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.model.mobility import Mobility
from tsmcl_ros.model.period import Schedule
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.relay import Poses, relay, RelayConfig, vehicle_beacons
from tsmcl_ros.types import Array, Observation, Rows
from tsmcl_ros.world.hearing import apart, hear, receive
from tsmcl_ros.world.settings import WorldConfig
from tsmcl_ros.world.wheels import WheelOdometry


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
        pairs = apart(self._channel.reach, position)
        listener, neighbour, rows = hear(
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
