"""
What messages cost: this package's view of the bytes beside rclpy's objects.

    python test/benchmark/run.py codec

Without rclpy its column stays empty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from goals import Section
import numpy as np
from timing import seconds
from tsmcl_ros import messages
from tsmcl_ros.types import Observation, Odometry

try:
    from geometry_msgs.msg import PoseWithCovarianceStamped
    from nav_msgs.msg import Odometry as OdometryMessage
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2
    TYPES = {'beacons': PointCloud2, 'odometry': OdometryMessage,
             'pose': PoseWithCovarianceStamped}
except ImportError:
    TYPES = {}

ROWS = 6
COUNT = 2000


def measure() -> Section:
    """Time coding one message of each kind, both ways."""
    scan = Observation.empty(1, ROWS, 3, 1.77e9)
    scan.sender[:] = np.arange(ROWS)
    pose = Odometry(1.77e9, np.array([1.0, 2.0, 0.0]), 0.5)
    covariance = np.eye(2)
    encoders: dict[str, Callable[[], bytes]] = {
        'beacons': lambda: messages.encode_beacons(scan, 'map')[0],
        'odometry': lambda: messages.encode_odometry(pose, 'odom', 'base_link'),
        'pose': lambda: messages.encode_pose(1.77e9, 'map', pose.position[:2], covariance, 0.5,
                                             0.1),
    }
    decoders: dict[str, Callable[[bytes], Any]] = {
        'beacons': messages.decode_beacons,
        'odometry': messages.decode_odometry,
        'pose': messages.decode_pose,
    }
    rows = [['us per message', 'encode', 'decode', 'rclpy serialize', 'rclpy deserialize']]
    for name, encode in encoders.items():
        data = encode()
        cells = [_each(encode), _each(lambda data=data, name=name: decoders[name](data))]
        if name in TYPES:
            kind = TYPES[name]
            message = deserialize_message(data, kind)
            cells += [
                _each(lambda message=message: serialize_message(message)),
                _each(lambda data=data, kind=kind: deserialize_message(data, kind))]
        rows.append([name, *(f'{1e6 * cell:.1f}' for cell in cells),
                     *[''] * (len(rows[0]) - 1 - len(cells))])
    return Section(
        'Codec',
        "Bytes to arrays and back: this package's views beside rclpy's message objects, a message "
        f'at a time, by processor time. Beacons have {ROWS} rows.', [rows])


def _each(work: Callable[[], Any]) -> float:
    """Return the time of one call [s]."""
    return seconds(lambda: [work() for _ in range(COUNT)]) / COUNT

