"""One vehicle's localizer as a node; `fleet` runs many in one process."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
import math
import sys
import time

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.publisher import Publisher
from std_srvs.srv import Empty
from tsmcl_ros import messages
from tsmcl_ros.config import adjust, build
from tsmcl_ros.diagnosis import diagnose, DIAGNOSTICS_PERIOD, NAMES
from tsmcl_ros.endpoint import Endpoint, lag_note, OutputConfig, Rest
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.localizer import CONFIGS, Localizer, LONGEST_LEAP
from tsmcl_ros.model.health import LOST, STALE
from tsmcl_ros.model.speakers import ignored_note
from tsmcl_ros.model.tally import untrue_note
from tsmcl_ros.nodes import discovery, runtime, views, wire
from tsmcl_ros.nodes.managed import LifecycleConfig, ManagedNode
from tsmcl_ros.nodes.parameters import live, select
from tsmcl_ros.nodes.resume import Memory
from tsmcl_ros.nodes.security import SecurityConfig
from tsmcl_ros.nodes.transforms import Broadcaster
from tsmcl_ros.types import Estimate, MessageError, Observation
from visualization_msgs.msg import MarkerArray

_QOS = {
    'anchor_map': wire.LATCHED_INPUT,
    'anchor_links': wire.LATCHED_INPUT,
    'beacons': wire.SENSOR_DATA,
    'odom': wire.SENSOR_DATA,
    'initialpose': wire.RELIABLE,
}

_LOOKING_PERIOD = 0.25  # s, between two looks whether messages have ceased
_WARNING_PERIOD = 5.0  # s, between two warnings of senders that are ignored


class LocalizerNode(ManagedNode):
    """
    Localizer: tells where a vehicle is, from the beacons that it hears and its odometry.

    Listens to beacons, odom and initialpose in its namespace, to /anchor_map and /anchor_links,
    and to the topics that ranges and references name, as they appear; publishes pose,
    particle_cloud, markers and /diagnostics, and beacon_period if it is to be adaptive.
    """

    default_name = 'localizer'
    configs = (LifecycleConfig, SecurityConfig, OutputConfig, InputConfig, *CONFIGS)
    adjustable = live(configs)

    def set_up(self) -> None:
        """Build the localizer from the settings, and connect it."""
        names = self.vehicle_names()
        self._vehicles = [name or self.get_namespace() for name in names]
        self._output = build(OutputConfig, self.settings)
        self._localizer = Localizer(select(self.settings, CONFIGS), len(names))
        inputs = build(InputConfig, self.settings)
        self._endpoint = Endpoint(self._localizer, names, self._output.global_frame_id, inputs)
        self._transforms = self._broadcaster(names) if self._output.tf_broadcast else None
        self._anchors: Observation | None = None
        self._estimate: Estimate | None = None
        self._status = np.full(len(names), LOST)
        self._latency = math.nan
        self._memory = self._recalled() if self._output.resume_from else None
        self._offer()
        self._subscribe()
        if inputs.ranges or inputs.references:
            search = discovery.Discovery(self, self._endpoint.ranges, self._heed)
            search.look()
            self.create_timer(
                discovery.PERIOD, search.look, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(
            f'{len(names)} vehicles, method {self._localizer.config.method}, '
            f'seed {self._localizer.config.seed}')

    def begin(self) -> None:
        """Wait for messages; those of what went on meanwhile are missing, as in an outage."""
        self._arrival = time.monotonic()
        self._diagnosed = -math.inf
        # What the localizer's time was at the last message, and what /clock showed next.
        self._told: float | None = None
        self._told_at: float | None = None

    def vehicle_names(self) -> list[str]:
        """Return the namespaces of the vehicles; here one, whose topics are relative."""
        return ['']

    def adjust(self) -> None:
        """Take over live parameters, if there is a localizer to do so."""
        if self.state in ('inactive', 'active'):
            adjust([self._output], self.settings)
            self._localizer.reconfigure(select(self.settings, CONFIGS))
            self._offer_clouds()

    def pass_time(self, now: float) -> None:
        """Let the localizer know of time that passes without messages."""
        super().pass_time(now)
        if not self.follows_clock or self.state != 'active' or self._told is None:
            return
        # Messages have clocks of their own: what counts is for how long none came. It counts from
        # the first /clock after the last one, as the one before may be older by a whole step.
        if self._told_at is None:
            self._told_at = now
        self._localizer.clock(self._told + now - self._told_at)
        self._publish_due()

    def _offer(self) -> None:
        """Create publishers, services, and the timer of the diagnostics."""
        outputs = self._endpoint.outputs
        self._poses = [self.talk(topic, messages.POSE, wire.LATCHED) for topic in outputs]
        self._periods = [self.talk(topic, messages.UINT32, wire.LATCHED)
                         for topic in self._endpoint.period_outputs]
        self._clouds: list[Publisher] = []
        self._offer_clouds()
        self._cloud_rest = Rest()
        # Made for who looks at them only; who comes later gets the last ones then.
        self._markers = self.create_lifecycle_publisher(
            MarkerArray, 'markers', wire.LATCHED,
            event_callbacks=PublisherEventCallbacks(matched=self._show))
        self._marker_rest = Rest()
        self._diagnosis_rest = Rest()
        self._diagnostics = self.talk('/diagnostics', messages.DIAGNOSTICS, wire.RELIABLE)
        # By the wall clock: it also tells when nothing comes any more, be it the time.
        self.create_timer(
            _LOOKING_PERIOD, self._diagnose_anyway,
            clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_timer(
            _WARNING_PERIOD, self._warn_of_others, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_service(Empty, 'reinitialize_global_localization', self._reinitialize)
        self.create_service(Empty, 'request_nomotion_update', self._publish_again)

    def _offer_clouds(self) -> None:
        """Create publishers of particle clouds, which are many, if they are wanted."""
        if self._output.cloud_period and not self._clouds:
            self._clouds = [
                self.talk(f'{topic.removesuffix("pose")}particle_cloud', messages.POSE_ARRAY,
                          wire.SENSOR_DATA)
                for topic in self._endpoint.outputs]

    def _subscribe(self) -> None:
        heeds = {'anchor_map': self._heed_map, 'anchor_links': self._heed_links,
                 'initialpose': self._heed_initial_pose}
        for topic, (kind, handler) in self._endpoint.inputs.items():
            name = topic.rpartition('/')[2]
            self.listen(topic, kind, partial(heeds.get(name, self._heed), handler), _QOS[name])

    def _heed(self, handler: Callable[[bytes], None], data: bytes) -> None:
        """Hand a message to the localizer, and publish what has become due by it."""
        if self.state != 'active':
            return
        self._arrival = time.monotonic()
        before = self._localizer.now
        handler(data)
        for vehicle, error in self._localizer.refused():
            self.reject(self._vehicles[vehicle], error)
        if self._localizer.now > before:
            self._told, self._told_at = self._localizer.now, None
        self._publish_due()

    # What is told once counts as soon as the node is configured.

    def _heed_map(self, handler: Callable[[bytes], None], data: bytes) -> None:
        handler(data)
        anchors, _ = messages.decode_beacons(data)
        if self._anchors is None or not np.array_equal(self._anchors.sender, anchors.sender):
            self.get_logger().info(f'{anchors.heard.sum()} anchors on the map')
        self._anchors = anchors

    def _heed_links(self, handler: Callable[[bytes], None], data: bytes) -> None:
        handler(data)

    def _heed_initial_pose(self, handler: Callable[[bytes], None], data: bytes) -> None:
        try:
            handler(data)
        except MessageError as error:
            self.get_logger().warning(f'initial pose ignored: {error}')

    def _publish_due(self) -> None:
        estimates = self._endpoint.due()
        if not estimates:
            return
        if self._estimate is None and (note := lag_note(self.now - estimates[0].stamp)):
            self.get_logger().info(note)
        for estimate in estimates:
            self._publish_poses(estimate)
            self._note_jump(self._estimate, estimate)
            self._estimate = estimate
        self._latency = time.monotonic() - self._arrival
        assert self._estimate is not None
        self._publish_views(self._estimate)
        self._note_status(self._estimate.stamp)
        if self._memory is not None:
            self._memory.save()

    def _note_jump(self, before: Estimate | None, after: Estimate) -> None:
        """Log it where time has jumped from one epoch to the next."""
        if before is None or 0 <= after.stamp - before.stamp <= LONGEST_LEAP:
            return
        begin = 'time went back from ' if after.stamp < before.stamp else 'time leapt from '
        self.get_logger().info(
            f'{begin}{before.stamp:.3f} s to {after.stamp:.3f} s: started anew')

    def _publish_poses(self, estimate: Estimate) -> None:
        wire.publish_all(
            (self._poses[vehicle], data) for vehicle, data in self._endpoint.poses(estimate))
        for vehicle, data in self._endpoint.periods(estimate):
            self._periods[vehicle].publish(data)
        if self._transforms is not None:
            self._transforms.send(estimate)

    def _publish_views(self, estimate: Estimate) -> None:
        """Publish, not too often, what people look at."""
        if self._cloud_rest.is_over(estimate.stamp, self._output.cloud_period):
            for publisher, particles in zip(
                self._clouds, self._localizer.particles, strict=True,
            ):
                if publisher.get_subscription_count():
                    publisher.publish(messages.encode_pose_array(
                        estimate.stamp, self._output.global_frame_id, particles))
        if self._marker_rest.is_over(estimate.stamp, self._output.marker_period):
            self._publish_markers(estimate)

    def _publish_markers(self, estimate: Estimate) -> None:
        if self._markers.get_subscription_count():
            suspects = {
                each for known in self._localizer.health.suspects for each in known}
            self._markers.publish(views.markers(
                estimate, self._anchors, suspects, self._localizer.channel.radio_range,
                self._output.global_frame_id))

    def _show(self, _: QoSPublisherMatchedInfo) -> None:
        """Publish the latest markers to somebody who has just begun to listen."""
        if self._estimate is not None and self._output.marker_period and self.state == 'active':
            self._publish_markers(self._estimate)

    def _note_status(self, stamp: float) -> None:
        """Log changes of the vehicles' status, one line for all that change alike."""
        status = self._localizer.status
        changed = status != self._status
        has_changed = changed.any()
        if has_changed:
            for value in np.unique(status[changed]).tolist():
                rows = np.flatnonzero(changed & (status == value)).tolist()
                self.get_logger().info(f'{NAMES[value]}: {_enumerate(self._vehicles, rows)}')
        self._status = status
        if self._diagnosis_rest.is_over(stamp, DIAGNOSTICS_PERIOD) or has_changed:
            self._diagnose(stamp)

    def _diagnose_anyway(self) -> None:
        """Publish how it is going where no epoch has had it published."""
        now = time.monotonic()
        stale = self._arrival + self._localizer.health_config.stale_after
        if self.state == 'active' and (
                now - self._diagnosed > 0.9 * DIAGNOSTICS_PERIOD
                or self._diagnosed <= stale < now):
            # By the messages' clock, as poses are stamped, once there are any.
            stamp = self._localizer.now
            if not self.follows_clock:
                stamp += now - self._arrival
            self._diagnose(
                stamp if math.isfinite(stamp) else self.get_clock().now().nanoseconds / 1e9)

    def _diagnose(self, stamp: float) -> None:
        """Publish how each vehicle's localization is doing at a time [s]."""
        self._diagnosed = time.monotonic()
        if not self._diagnostics.get_subscription_count():
            return
        silence = self._diagnosed - self._arrival
        status = self._localizer.status
        if silence > self._localizer.health_config.stale_after:
            status = np.maximum(status, STALE)
        diagnoses = diagnose(
            self._localizer, self._vehicles, self.get_name(), status,
            {'latency [s]': self._latency, 'time since the last message [s]': silence})
        self._diagnostics.publish(messages.encode_diagnostics(stamp, diagnoses))

    def _warn_of_others(self) -> None:
        """Name those who are ignored, and those who say what cannot be true, each once."""
        if news := self._localizer.speakers.news():
            self.get_logger().warning(ignored_note(news))
        if news := self._localizer.untrue.news():
            self.get_logger().warning(untrue_note(news, self._localizer.untrue.reason))

    def _reinitialize(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        for vehicle in range(len(self._vehicles)):
            self._localizer.reinitialize(vehicle)
        self.get_logger().info('re-initialised as asked for')
        return response

    def _publish_again(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        """Publish the latest estimate again: updates do not wait for motion here."""
        if self._estimate is not None and self.state == 'active':
            self._publish_poses(self._estimate)
            self._cloud_rest.end()
            self._marker_rest.end()
            self._publish_views(self._estimate)
        return response

    def _recalled(self) -> Memory:
        """Return what keeps the last poses, after those of an earlier localizer were taken."""
        memory = Memory(self._localizer, self._vehicles, self._output, self.get_logger().error)
        if found := memory.recall():
            self.get_logger().info(f'{found} vehicles resume from {self._output.resume_from}')
        return memory

    def _broadcaster(self, names: list[str]) -> Broadcaster:
        return Broadcaster(
            self, self._output, [f'{name[1:]}/' if name else '' for name in names])


def _enumerate(vehicles: list[str], rows: list[int], most: int = 5) -> str:
    """Return some vehicles' names, and how many more there are."""
    named = ', '.join(vehicles[row] for row in rows[:most])
    return named if len(rows) <= most else f'{named} and {len(rows) - most} more'


def main() -> int:
    """Run the node and return the exit code."""
    return runtime.main(LocalizerNode)


if __name__ == '__main__':
    sys.exit(main())
