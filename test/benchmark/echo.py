"""
The least that a process in the localizer's place can do: take a message raw, publish one pose.

    python test/benchmark/echo.py BEACONS POSE
"""

from __future__ import annotations

import sys

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from tsmcl_ros import messages
from tsmcl_ros.nodes import wire

_STAMPED = 12  # bytes, up to the end of a message's stamp


def main(beacons: str, pose: str) -> None:
    """Answer each message of the topic `beacons` by one on `pose` of the same stamp."""
    rest = messages.encode_pose(0.0, 'map', np.ones(2), np.eye(2), 0.5, 0.1)[_STAMPED:]
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node('echo')
    publisher = node.create_publisher(PoseWithCovarianceStamped, pose, wire.LATCHED)
    node.create_subscription(
        PointCloud2, beacons, lambda data: publisher.publish(data[:_STAMPED] + rest),
        wire.SENSOR_DATA, raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    print('active', flush=True)
    while True:
        executor.spin_once(timeout_sec=0.1)


if __name__ == '__main__':
    main(*sys.argv[1:])
