"""Broadcast of what localizers estimate as TF, where tf2_ros is installed."""

from __future__ import annotations

from importlib import import_module
import math
from typing import Any

from geometry_msgs.msg import TransformStamped
import numpy as np
from rclpy.node import Node
from rclpy.time import Time
from tsmcl_ros.endpoint import OutputConfig
from tsmcl_ros.types import Array, ConfigError, Estimate


class Broadcaster:
    """
    Tells TF where vehicles are.

    It does so by the transform from the map to the odometry frame, or to the vehicle itself where
    there is no odometry.

    Parameters
    ----------
    node
        Whose broadcaster it is.
    output : OutputConfig
        Names the frames, and says how far into the future a transform holds.
    prefixes : list of str
        Of each vehicle, '' for none; odometry frame and the vehicle's own follow it.

    Raises
    ------
    ConfigError
        If tf2_ros is not installed.

    """

    def __init__(self, node: Node, output: OutputConfig, prefixes: list[str]) -> None:
        try:
            self._broadcaster: Any = import_module('tf2_ros').TransformBroadcaster(node)
        except ImportError:
            raise ConfigError(
                'tf_broadcast: true is not allowed, tf2_ros is not installed') from None
        self._output = output
        self._odom_frames = [prefix + output.odom_frame_id for prefix in prefixes]
        self._base_frames = [prefix + output.base_frame_id for prefix in prefixes]

    def send(self, estimate: Estimate) -> None:
        """Broadcast one transform for each localized vehicle."""
        time = estimate.stamp + self._output.transform_tolerance
        stamp = Time(nanoseconds=round(time * 1e9)).to_msg()
        transforms = []
        for vehicle in np.flatnonzero(np.isfinite(estimate.mean).all(axis=1)).tolist():
            place, turn, has_odometry = map_to_odom(estimate, vehicle)
            transform = TransformStamped()
            transform.header.stamp = stamp
            transform.header.frame_id = self._output.global_frame_id
            frames = self._odom_frames if has_odometry else self._base_frames
            transform.child_frame_id = frames[vehicle]
            moved, turned = transform.transform.translation, transform.transform.rotation
            moved.x, moved.y, moved.z = place.tolist()
            turned.z, turned.w = math.sin(turn / 2), math.cos(turn / 2)
            transforms.append(transform)
        self._broadcaster.sendTransform(transforms)


def map_to_odom(estimate: Estimate, vehicle: int) -> tuple[Array, float, bool]:
    """
    Return where a vehicle's odometry frame lies in the map.

    Returns
    -------
    translation : (3,) float
        [m].
    rotation : float
        About the vertical [rad].
    has_odometry : bool
        If not, translation is that of the vehicle itself, and nothing is known of its rotation.

    """
    mean = np.append(estimate.mean[vehicle], 0.0)[:3]
    turn = float(estimate.rotation[vehicle])
    odometry = None if estimate.odometry is None else estimate.odometry[vehicle]
    if odometry is None or math.isnan(turn) or not np.isfinite(odometry[:3]).all():
        return mean, 0.0, False
    cos, sin = math.cos(turn), math.sin(turn)
    x, y, z = odometry[:3]
    height = z if len(estimate.mean[vehicle]) == 3 else 0.0
    return mean - [cos * x - sin * y, sin * x + cos * y, height], turn, True
