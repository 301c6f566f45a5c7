"""What localizers show to people: markers for RViz and Foxglove."""

from __future__ import annotations

from collections.abc import Collection, Sequence
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
_RED = ColorRGBA(r=0.84, g=0.1, b=0.0, a=1.0)
_GREY = ColorRGBA(r=0.5, g=0.5, b=0.5, a=1.0)  # seen on black as on white


def markers(
    estimate: Estimate, anchors: Observation | None, suspects: Collection[int],
    radio_range: float, frame_id: str,
) -> MarkerArray:
    """
    Return the anchors with the disks in which they are heard, and where vehicles are with 95 %.

    They replace all that were shown before.

    Parameters
    ----------
    estimate
        Of V vehicles.
    anchors
        The anchor map (V = 1), if there is one.
    suspects
        Ids of the senders that are suspected, which another colour tells.
    radio_range
        Of anchors that do not tell theirs [m]; 0 if unknown.
    frame_id
        Of all positions.

    """
    header = Header(stamp=_time(estimate.stamp), frame_id=frame_id)
    shown = [Marker(header=header, action=Marker.DELETEALL)]
    if anchors is not None:
        shown += _anchors(header, anchors, suspects, radio_range)
    for vehicle in np.flatnonzero(np.isfinite(estimate.mean).all(axis=1)).tolist():
        value, vector = np.linalg.eigh(estimate.covariance[vehicle, :2, :2])
        # The chi-squared distribution of two degrees of freedom has 95 % below 5.99.
        length = 2 * np.sqrt(5.99 * np.maximum(value, 0))
        ellipse = _marker(
            header, 'covariance', vehicle, Marker.CYLINDER, _ORANGE, length,
            estimate.mean[vehicle])
        turn = math.atan2(vector[1, 0], vector[0, 0])
        ellipse.pose.orientation.z = math.sin(turn / 2)
        ellipse.pose.orientation.w = math.cos(turn / 2)
        shown.append(ellipse)
    return MarkerArray(markers=shown)


def _anchors(
    header: Header, anchors: Observation, suspects: Collection[int], radio_range: float,
) -> list[Marker]:
    told = anchors.max_range[0].astype(float)
    reach = np.where(np.isfinite(told), told, radio_range)
    extent = float(np.ptp(anchors.position[0], axis=0).max(initial=0.0))
    size = 0.03 * (float(reach.max(initial=0.0)) or extent) or 1.0
    shown = []
    # Ids of markers hold less than those of senders do.
    for number, (identity, position, radius) in enumerate(zip(
        anchors.sender[0].tolist(), anchors.position[0], reach.tolist(), strict=True,
    )):
        suspected = identity in suspects
        color = _RED if suspected else _BLUE
        shown.append(_marker(
            header, 'anchors', number, Marker.SPHERE, color, [size, size], position))
        label = _marker(
            header, 'anchor_ids', number, Marker.TEXT_VIEW_FACING, _RED if suspected else _GREY,
            [size, size], position)
        label.text = f'{identity}: suspect' if suspected else str(identity)
        label.pose.position.z += 1.2 * size  # above the sphere
        shown.append(label)
        if radius:
            shown.append(_marker(
                header, 'radio_range', number, Marker.CYLINDER, _PALE,
                [2 * radius, 2 * radius], position))
    return shown


def _marker(
    header: Header, namespace: str, number: int, shape: int, color: ColorRGBA,
    size: Sequence[float], position: Array,
) -> Marker:
    """Return a marker at a position (2,) or (3,); a cylinder is a flat disk."""
    marker = Marker(header=header, ns=namespace, id=number, type=shape, color=color)
    place = marker.pose.position
    place.x, place.y, place.z = (*position.tolist(), 0.0)[:3]
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y = (max(float(length), _THIN) for length in size)
    marker.scale.z = _THIN if shape == Marker.CYLINDER else marker.scale.x
    return marker


def _time(stamp: float) -> Any:
    return Time(nanoseconds=round(stamp * 1e9)).to_msg()
