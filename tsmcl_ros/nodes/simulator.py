"""The simulated world over DDS: moving vehicles, and the radio medium between them and anchors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count
import math
import sys

import numpy as np
from rclpy.publisher import Publisher
from tsmcl_ros import messages
from tsmcl_ros.config import build, Config, param
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.relay import Poses, RelayConfig
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.nodes.reports import Reports
from tsmcl_ros.types import Array, MessageError, Observation, Odometry
from tsmcl_ros.world import anchor_table, CONFIGS, Epoch, make_mobility, World, WorldConfig

_SHOWN_AGAIN = 0.1  # s, from one message of the same time to the next


@dataclass(frozen=True)
class SimulatorConfig(Config):
    """How the simulation runs."""

    rate: float = param(1.0, 'simulated time against real time', above=0, high=1e4)
    duration: float = param(0.0, 'simulated time after which it ends, 0 for never', unit='s',
                            low=0)
    wait_for: int = param(
        0, "start when so many subscriptions listen to each vehicle's beacons and odometry",
        low=0)
    beacon_timeout: float = param(
        0.5, 'longest wait for the beacon of an anchor of the map, in real time', unit='s',
        above=0, high=60)
    cooperation: bool = param(
        False, 'vehicles broadcast the poses that their localizers publish, as references of kind '
        'vehicle for others')
    lockstep: bool = param(
        False, "wait for the vehicles' poses before each period, as with cooperation: a "
        'simulation then goes as fast as they are localized, and loses none of their epochs')
    pose_timeout: float = param(
        10.0, 'longest wait for the pose of a vehicle that hears beacons, in real time', unit='s',
        above=0, high=60)
    global_frame_id: str = param('map', 'frame of the ground truth and of the poses')
    seed: int = param(1, 'of movement, odometry and radio', low=0)


@dataclass(frozen=True)
class SimulatedRadioConfig(RadioConfig):
    """The radio of all vehicles; a simulated one must know its range."""

    radio_range: float = param(1000.0, 'range of beacons (disk model)', unit='m', above=0)


class Simulator(runtime.Node):
    """
    Simulated world: moves vehicles and passes on to them the beacons that anchors transmit.

    Publishes /clock and for each vehicle ground_truth, beacons and odom. Starts when it knows an
    /anchor_map. In lockstep it listens to each vehicle's pose; with cooperation it passes that on,
    too. A vehicle that asks for another beacon_period hears no anchor until it is over: its
    beacons come empty, so that nobody waits for them.
    """

    default_name = 'simulator'
    configs = (
        SimulatorConfig,
        *(SimulatedRadioConfig if config is RadioConfig else config for config in CONFIGS),
    )
    adjustable = ('rate',)

    def __init__(self) -> None:
        super().__init__()
        self._config = build(SimulatorConfig, self.settings)
        world = build(WorldConfig, self.settings)
        self._period = world.beacon_period
        # As make_world spawns them: a seed means the same there, anchors included.
        mobility_rng, _, rng = np.random.default_rng(self._config.seed).spawn(3)
        mobility = make_mobility(self.settings, mobility_rng)
        relaying = build(RelayConfig, self.settings)
        self._world = World(
            world, Channel(build(SimulatedRadioConfig, self.settings)), mobility,
            anchor_table(np.empty((0, 3))), rng, relaying=relaying,
        )
        self._duration = min(self._config.duration or math.inf, mobility.duration)
        exchange = self._config.cooperation or relaying.relay_hops > 1
        self._air = Air(relaying.identities(world.vehicles) if exchange else range(0))
        self._reports = Reports(world.vehicles, self._config.global_frame_id)
        # Discovery keeps this order, and anchors keep the same: who has sent us its map will be
        # heard from its first beacon on.
        self.listen('/beacons', messages.POINT_CLOUD, self._air.beacon, wire.SENSOR_DATA)
        self.listen('/anchor_map', messages.POINT_CLOUD, self._air.map, wire.LATCHED_INPUT)
        for i in range(world.vehicles):
            self.listen(f'/veh_{i}/beacon_period', messages.UINT32, partial(self._ask, i),
                        wire.LATCHED_INPUT)
        self._clock_out = self.talk('/clock', messages.CLOCK, wire.RELIABLE)
        # Odometry comes last: who sees that topic sees the others.
        self._ground_truth, self._beacons, self._odom = zip(*(
            (
                self.talk(f'/veh_{i}/ground_truth', messages.ODOMETRY, wire.SENSOR_DATA),
                self.talk(f'/veh_{i}/beacons', messages.POINT_CLOUD, wire.SENSOR_DATA),
                self.talk(f'/veh_{i}/odom', messages.ODOMETRY, wire.SENSOR_DATA),
            )
            for i in range(world.vehicles)
        ), strict=True)

        self._awaits_poses = self._config.cooperation or self._config.lockstep
        if self._awaits_poses:
            for i in range(world.vehicles):
                self.listen(f'/veh_{i}/pose', messages.POSE, partial(self._reports.take, i),
                            wire.LATCHED_INPUT)

    def run(self) -> None:
        """Simulate one beacon period after the other, each at its time."""
        self._gather()
        self.get_logger().info(
            f'{len(self._odom)} vehicles among {len(self._air.anchors)} anchors are under way'
        )
        pace = runtime.Pace(self)
        for epoch in count(1):
            stamp = epoch * self._period
            if stamp > self._duration + 1e-6:
                break
            self._simulate(stamp)
            pace.wait(self._period / self.settings['rate'])
        schedule = self._world.schedule
        bits = schedule.bits(len(self._air.anchors))
        self.get_logger().info(
            f'on the air were {schedule.localizations.sum()} localization messages and '
            f'{schedule.requests.sum()} period messages, {bits} bits')
        # What was said last would be lost on who is busy.
        self.settle()
        self.get_logger().info('the simulation is over')

    def _ask(self, vehicle: int, data: bytes) -> None:
        """Give a vehicle the beacon period that it asks for."""
        self._world.schedule.ask(vehicle, messages.decode_period(data))

    def _gather(self) -> None:
        """Wait for the anchors, and for as many listeners as wanted."""
        listeners = (*self._beacons, *self._odom)
        if not self.spin(self._air.is_known, timeout=2.0):
            self.get_logger().info('waiting for an /anchor_map')
        self.spin(self._air.is_known)
        if self._config.wait_for:
            self.spin(lambda: all(
                publisher.get_subscription_count() >= self._config.wait_for
                for publisher in listeners
            ))
            self.settle()

    def _simulate(self, stamp: float) -> None:
        """
        Let one period pass, in step with the anchors, which transmit when the clock says so.

        Waiting for them, and in lockstep for the poses of the last period, keeps a simulation the
        same at any rate and under any load.
        """
        self._air.clear(stamp)
        if not self._await_beacons(messages.encode_clock(stamp)):
            silent = ', '.join(map(str, self._air.give_up()))
            self.get_logger().warning(
                f'anchors {silent} did not transmit at {stamp:g} s and are no longer waited for'
            )
        epoch = self._world.step(self._air.senders(), self._await_poses())
        self._reports.expect(epoch.stamp, epoch.observation.heard.any(axis=1))
        wire.publish_all(self._messages(epoch))

    def _await_poses(self) -> Poses | None:
        """Return the poses of the last period, once they have come; None if nobody is to know."""
        if not self._awaits_poses:
            return None
        if not self.spin(self._reports.is_complete, self._config.pose_timeout):
            silent = self._reports.give_up()
            self.get_logger().warning(
                f'{len(silent)} vehicles, from {silent[0]} on, have sent no pose and are no '
                'longer waited for')
        if not self._config.cooperation:
            return None
        return self._reports.poses(self._world.mobility.state.position.shape[1])

    def _await_beacons(self, clock: bytes) -> bool:
        """Show the time until all anchors have transmitted; who came late may have missed it."""
        for _ in range(math.ceil(self._config.beacon_timeout / _SHOWN_AGAIN)):
            self._clock_out.publish(clock)
            if self.spin(self._air.is_complete, _SHOWN_AGAIN):
                return True
        return False

    def _messages(self, epoch: Epoch) -> Iterator[tuple[Publisher, bytes]]:
        """Yield what there is to tell of an epoch, and by which publisher."""
        frame = self._config.global_frame_id
        for i, scan in enumerate(messages.encode_beacons(epoch.observation, frame)):
            truth = Odometry(epoch.stamp, _in_space(epoch.position[i]), float(epoch.yaw[i]))
            odometry = Odometry(
                epoch.stamp, _in_space(epoch.odom_position[i]), float(epoch.odom_yaw[i]))
            yield self._ground_truth[i], messages.encode_odometry(
                truth, frame, f'veh_{i}/base_link', _ahead(epoch.velocity[i], truth.yaw))
            yield self._odom[i], messages.encode_odometry(
                odometry, f'veh_{i}/odom', f'veh_{i}/base_link')
            yield self._beacons[i], scan


class Air:
    """
    What is on the air in one beacon period, and what is expected to be.

    Parameters
    ----------
    reserved : range
        Identities that anchors may not have, as vehicles have them.

    """

    def __init__(self, reserved: range) -> None:
        self._reserved = reserved
        self.anchors: set[int] = set()
        self._awaited: set[int] = set()
        self._beacons: list[Observation] = []
        self._stamp = math.nan

    def map(self, data: bytes) -> None:
        """Expect the anchors of an anchor map."""
        table, _ = messages.decode_beacons(data)
        found = set(table.sender[0].tolist())
        self._refuse_reserved(found)
        self.anchors |= found
        self._awaited |= found

    def beacon(self, data: bytes) -> None:
        """Take a beacon of this period; those of others have died away."""
        beacon, _ = messages.decode_beacons(data)
        if beacon.sender.size != 1:
            raise MessageError(f'{beacon.sender.size} rows are not allowed, a beacon has one')
        self._refuse_reserved(beacon.sender[0].tolist())
        if abs(beacon.stamp - self._stamp) < 1e-6:
            self._beacons.append(beacon)

    def clear(self, stamp: float) -> None:
        """Begin a period [s]."""
        self._stamp = stamp
        self._beacons = []

    def is_known(self) -> bool:
        """Tell whether any anchor is expected."""
        return bool(self.anchors)

    def is_complete(self) -> bool:
        """Tell whether all anchors that are waited for have transmitted."""
        return not self._missing()

    def give_up(self) -> list[int]:
        """Wait no longer for those that have not transmitted, and return them."""
        missing = self._missing()
        self._awaited -= missing
        return sorted(missing)

    def senders(self) -> Observation:
        """Return what was transmitted (V = 1), in an order that does not depend on arrival."""
        beacons = sorted(self._beacons, key=lambda beacon: int(beacon.sender[0, 0]))
        table = Observation.empty(1, len(beacons), 3, self._stamp)
        for k, beacon in enumerate(beacons):
            for name in ('sender', 'kind', 'hops', 'position', 'covariance'):
                getattr(table, name)[0, k] = getattr(beacon, name)[0, 0]
        return table

    def _refuse_reserved(self, identities: Iterable[int]) -> None:
        taken = [identity for identity in identities if identity in self._reserved]
        if taken:
            raise MessageError(
                f'anchor id {min(taken)} is not allowed, vehicles have {self._reserved[0]} to '
                f'{self._reserved[-1]} by vehicle_id_offset')

    def _missing(self) -> set[int]:
        return self._awaited - {int(beacon.sender[0, 0]) for beacon in self._beacons}


def _in_space(position: Array) -> Array:
    """Return a position (D,) with height 0 if it has none."""
    return np.append(position, 0.0)[:3]


def _ahead(velocity: Array, yaw: float) -> list[float]:
    """Return a velocity (D,) in the map as one along and across the heading."""
    x, y, *z = velocity.tolist()
    cos, sin = math.cos(yaw), math.sin(yaw)
    return [cos * x + sin * y, cos * y - sin * x, *z]


def main() -> int:
    """Run the node and return the exit code."""
    return runtime.main(Simulator)


if __name__ == '__main__':
    sys.exit(main())
