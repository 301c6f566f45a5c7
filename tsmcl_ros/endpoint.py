"""
A localizer's wire side: serialized messages in, serialized poses out.

The node and the offline bag run share it, so that what one rejects or publishes the other does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.config import Config, param
from tsmcl_ros.inputs import InputConfig, RangeInput
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.topics import absolute
from tsmcl_ros.types import Estimate, MessageError, Prior

_MUCH = 1.0  # s, between a message's stamp and the time of its recording or arrival


@dataclass(frozen=True)
class OutputConfig(Config):
    """What a localizer publishes beside poses, and in which frames."""

    global_frame_id: str = param('map', 'frame of anchors and poses')
    odom_frame_id: str = param('odom', 'odometry frame, for TF')
    base_frame_id: str = param('base_link', "the vehicle's frame, for TF")
    tf_broadcast: bool = param(
        False, 'broadcast the transform from map to odom, or to base_link without odometry; '
        'needs tf2_ros')
    transform_tolerance: float = param(
        1.0, 'how far into the future a transform holds', unit='s', low=0, live=True)
    cloud_period: float = param(
        1.0, 'shortest time between two particle clouds, 0 for none', unit='s', low=0, live=True)
    marker_period: float = param(
        1.0, 'shortest time between two sets of markers, 0 for none', unit='s', low=0, live=True)
    resume_from: str = param(
        '', 'file that the last poses and what was learnt of ranges and rssi are kept in, and '
        'taken from by a localizer that is started again; none for no such file')
    save_pose_rate: float = param(
        0.5, 'how often the last poses are written there at most', unit='Hz', above=0, live=True)


class Endpoint:
    """
    Feeds serialized messages to a localizer of named vehicles.

    Parameters
    ----------
    localizer : Localizer
        Of V vehicles.
    names : sequence of str
        Namespace of each vehicle, such as '/veh_0'; '' for relative names.
    frame_id : str
        The map's frame, which beacons must be given in and poses are.
    inputs : InputConfig
        What is listened to beside.

    Attributes
    ----------
    inputs : dict of str to (str, callable)
        Type and handler of each topic listened to. A handler takes the serialized message and
        raises MessageError if it has to be rejected.
    outputs : list of str
        Topic of each vehicle's pose.
    period_outputs : list of str
        Topic of each vehicle's wanted beacon period; none if nobody wants any.
    ranges : RangeInput
        Whose topics come to the inputs once they are discovered.

    Raises
    ------
    ConfigError
        If the inputs and the localizer do not fit.

    """

    def __init__(self, localizer: Localizer, names: Sequence[str], frame_id: str = 'map',
                 inputs: InputConfig | None = None):
        self.localizer = localizer
        self.ranges = RangeInput(inputs or InputConfig(), localizer, names, frame_id)
        self.frame_id = frame_id
        self.outputs = [_topic(name, 'pose') for name in names]
        self.period_outputs = [
            _topic(name, 'beacon_period') for name in names if localizer.asks_period]
        self._periods = np.zeros(len(names), int)
        self.inputs: dict[str, tuple[str, Callable[[bytes], None]]] = {
            '/anchor_map': (messages.POINT_CLOUD, self._anchor_map),
            '/anchor_links': (messages.POINT_CLOUD, self._anchor_links)}
        for vehicle, name in enumerate(names):
            for topic, kind, handler in (
                ('beacons', messages.POINT_CLOUD, self._beacons),
                ('odom', messages.ODOMETRY, self._odometry),
                ('initialpose', messages.POSE, self._initial_pose),
            ):
                self.inputs[_topic(name, topic)] = kind, _for_vehicle(handler, vehicle)

    def due(self) -> list[Estimate]:
        """Return the estimates of the epochs that have become complete, in order of time."""
        self.ranges.gather()
        return self.localizer.due()

    def poses(self, estimate: Estimate) -> Iterator[tuple[int, bytes]]:
        """Yield each localized vehicle's index and its serialized pose."""
        placed = np.flatnonzero(np.isfinite(estimate.mean).all(axis=1))
        data = messages.encode_poses(
            estimate.stamp, self.frame_id, estimate.mean[placed], estimate.covariance[placed],
            estimate.yaw[placed], estimate.rotation_variance[placed])
        yield from zip(placed.tolist(), data, strict=True)

    def periods(self, estimate: Estimate) -> Iterator[tuple[int, bytes]]:
        """Yield the index of each vehicle that wants another beacon period now, and which."""
        if estimate.period_factor is None:
            return
        changed = estimate.period_factor != self._periods
        self._periods = estimate.period_factor
        for vehicle in np.flatnonzero(changed).tolist():
            yield vehicle, messages.encode_period(int(estimate.period_factor[vehicle]))

    def _anchor_map(self, data: bytes) -> None:
        anchors, frame_id = messages.decode_beacons(data)
        self._check_frame('anchor map', frame_id)
        self.localizer.anchor_map(anchors)
        self.ranges.learn_map(anchors)

    def _anchor_links(self, data: bytes) -> None:
        links, frame_id = messages.decode_links(data)
        self._check_frame('anchor links', frame_id)
        self.localizer.anchor_links(links)

    def _beacons(self, vehicle: int, data: bytes) -> None:
        scan = messages.decode_scan(data)
        self._check_frame('beacons', scan.frame_id)
        if scan.fault:
            self.localizer.untrue.count(vehicle, scan.untrue.tolist(), scan.fault)
        self.localizer.beacons(vehicle, scan.observation)
        self.ranges.gather()

    def _odometry(self, vehicle: int, data: bytes) -> None:
        self.localizer.odometry(vehicle, messages.decode_odometry(data))
        self.ranges.gather()

    def _initial_pose(self, vehicle: int, data: bytes) -> None:
        pose = messages.decode_pose(data)
        self._check_frame('initial pose', pose.frame_id)
        dimension = self.localizer.config.dimension
        self.localizer.initial_pose(Prior(
            vehicle, pose.position[:dimension], pose.covariance[:dimension, :dimension],
            pose.yaw if np.isfinite(pose.yaw) else None, float(np.sqrt(pose.covariance[5, 5]))))

    def _check_frame(self, what: str, frame_id: str) -> None:
        if frame_id != self.frame_id:
            raise MessageError(
                f'{what}: frame_id {frame_id!r} is not allowed, must be {self.frame_id!r}')


class Rest:
    """A time of rest between two publications."""

    def __init__(self) -> None:
        self._begin = -math.inf

    def is_over(self, stamp: float, period: float) -> bool:
        """Tell whether it is over, and if so begin anew; a period [s] of 0 never ends."""
        # Time may have gone back.
        over = period > 0 and not 0 <= stamp - self._begin < period - 1e-6
        if over:
            self._begin = stamp
        return over

    def end(self) -> None:
        """Let it be over."""
        self._begin = -math.inf


def lag_note(lag: float) -> str:
    """Say what it means that stamps are before the time of recording or arrival [s], if much."""
    if not abs(lag) > _MUCH:
        return ''
    return (f'header stamps are {abs(lag):.1f} s {"before" if lag > 0 else "after"} the time of '
            'recording or arrival: epochs and poses go by the header stamps')


def _topic(namespace: str, name: str) -> str:
    return absolute(name, namespace) if namespace else name


def _for_vehicle(handler: Callable[[int, bytes], None], vehicle: int) -> Callable[[bytes], None]:
    return lambda data: handler(vehicle, data)
