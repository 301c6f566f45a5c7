"""What localizers show to people: markers for RViz and Foxglove."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np
from rclpy.time import Time
from std_msgs.msg import ColorRGBA, Header
from tsmcl_ros.types import Array, Estimate, Observation
from visualization_msgs.msg import Marker, MarkerArray

_THIN = 0.01  # m
_BLUE = ColorRGBA(r=0.1, g=0.4, b=0.9, a=1.0)
_PALE = ColorRGBA(r=0.1, g=0.4, b=0.9, a=0.05)
_ORANGE = ColorRGBA(r=1.0, g=0.5, b=0.0, a=0.6)


def markers(
    estimate: Estimate, anchors: Observation | None, radio_range: float, frame_id: str,
) -> MarkerArray:
    """
    Return the anchors with the disks in which they are heard, and where vehicles are with 95 %.

    Parameters
    ----------
    estimate
        Of V vehicles.
    anchors
        The anchor map (V = 1), if there is one.
    radio_range
        Of anchors that do not tell theirs [m]; 0 if unknown.
    frame_id
        Of all positions.
    """
    header = Header(stamp=_time(estimate.stamp), frame_id=frame_id)
    shown = [] if anchors is None else _anchors(header, anchors, radio_range)
    for vehicle in np.flatnonzero(np.isfinite(estimate.mean).all(axis=1)).tolist():
        value, vector = np.linalg.eigh(estimate.covariance[vehicle, :2, :2])
        # The chi-squared distribution of two degrees of freedom has 95 % below 5.99.
        length = 2 * np.sqrt(5.99 * np.maximum(value, 0))
        ellipse = _marker(header, 'covariance', vehicle, Marker.CYLINDER, _ORANGE, length)
        _place(ellipse, estimate.mean[vehicle])
        turn = math.atan2(vector[1, 0], vector[0, 0])
        ellipse.pose.orientation.z = math.sin(turn / 2)
        ellipse.pose.orientation.w = math.cos(turn / 2)
        shown.append(ellipse)
    return MarkerArray(markers=shown)


def _anchors(header: Header, anchors: Observation, radio_range: float) -> list[Marker]:
    told = anchors.max_range[0].astype(float)
    reach = np.where(np.isfinite(told), told, radio_range)
    size = 0.03 * float(reach.max(initial=0.0)) or 1.0
    shown = []
    for identity, position, radius in zip(
        anchors.sender[0].tolist(), anchors.position[0], reach.tolist(), strict=True,
    ):
        shown.append(_marker(header, 'anchors', identity, Marker.SPHERE, _BLUE, [size, size]))
        if radius:
            shown.append(_marker(
                header, 'radio_range', identity, Marker.CYLINDER, _PALE,
                [2 * radius, 2 * radius]))
        for marker in shown[-2:]:
            _place(marker, position)
    return shown


def _marker(
    header: Header, namespace: str, number: int, shape: int, color: ColorRGBA,
    size: Sequence[float],
) -> Marker:
    """Return a marker; a cylinder is a flat disk."""
    marker = Marker(header=header, ns=namespace, id=number, type=shape, color=color)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y = (max(float(length), _THIN) for length in size)
    marker.scale.z = _THIN if shape == Marker.CYLINDER else marker.scale.x
    return marker


def _place(marker: Marker, position: Array) -> None:
    place = marker.pose.position
    place.x, place.y, place.z = (*position.tolist(), 0.0)[:3]


def _time(stamp: float) -> Any:
    return Time(nanoseconds=round(stamp * 1e9)).to_msg()
