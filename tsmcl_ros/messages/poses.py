"""Poses, odometry and particles, one message at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
import math
import struct

import numpy as np
from tsmcl_ros import cdr
from tsmcl_ros.messages.covariances import is_covariance
from tsmcl_ros.messages.stamps import read_header, split, write_header
from tsmcl_ros.types import Array, MessageError, Odometry

ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'

POSES = (POSE, POSE_STAMPED, ODOMETRY)
"""Types that hold one pose with a stamp."""

UNMEASURED = 1e6
"""Variance [m^2, rad^2] that stands for 'not measured' in a pose's covariance."""

FURTHEST = 1e8
"""Largest coordinate of a pose [m]: it may be of any frame on Earth, such as UTM or ECEF."""

TWIST = 6 + 36
"""Doubles of a TwistWithCovariance."""

_ZEROS = (0.0,) * 36

_STAMP = struct.Struct('<iI')
# The 43 doubles of a pose with covariance: position, quaternion, covariance.
_UNKNOWN_POSE = np.array([*_ZEROS[:6], 1.0, *np.diag([UNMEASURED] * 6).ravel()], '<f8')


@dataclass(frozen=True, eq=False)
class Pose:
    """
    One pose with its covariance.

    Attributes
    ----------
    stamp : float
        [s].
    frame_id : str
        Frame that the pose is given in.
    position : (3,) float64
        [m].
    yaw : float
        [rad]; NaN if its variance says that it was not measured.
    covariance : (6, 6) float64
        Of x, y, z and the rotations about them [m^2, m rad, rad^2].

    """

    stamp: float
    frame_id: str
    position: Array
    yaw: float
    covariance: Array


def decode_odometry(data: bytes) -> Odometry:
    """
    Return one odometry pose.

    Raises
    ------
    MessageError
        If the bytes are not odometry, or the pose is not finite.

    """
    reader = cdr.Reader(data)
    stamp, _ = read_header(reader)
    reader.string()
    position, yaw = _read_pose(reader)
    reader.skip(8 * (36 + TWIST))
    reader.finish()
    return Odometry(stamp, position, yaw)


def encode_odometry(
    odometry: Odometry, frame_id: str, child_frame_id: str, velocity: Sequence[float] = (),
) -> bytes:
    """
    Return an odometry message.

    Parameters
    ----------
    odometry
        The pose; a yaw of NaN is not measured, and gets a large variance.
    frame_id, child_frame_id
        The pose is that of the child in the frame.
    velocity
        In the child frame, up to three axes [m/s].

    """
    writer = cdr.Writer()
    write_header(writer, odometry.stamp, frame_id)
    writer.string(child_frame_id)
    writer.values('7d', *_checked(odometry.position), *_quaternion(odometry.yaw))
    writer.values('36d', *_ZEROS[:35], UNMEASURED if math.isnan(odometry.yaw) else 0.0)
    writer.values(f'{TWIST}d', *velocity, *_ZEROS[:6 - len(velocity)], *_ZEROS)
    return writer.finish()


def decode_pose(data: bytes) -> Pose:
    """
    Return a pose with covariance.

    Raises
    ------
    MessageError
        If the bytes are not such a pose, or a number is not finite, or the covariance none.

    """
    return decode_any_pose(POSE, data)


def decode_any_pose(kind: str, data: bytes) -> Pose:
    """Return the pose of a message of a type in `POSES`; the covariance may be zero."""
    reader = cdr.Reader(data)
    stamp, frame_id = read_header(reader)
    if kind == ODOMETRY:
        reader.string()
    position, yaw = _read_pose(reader)
    covariance = np.zeros((6, 6))
    if kind != POSE_STAMPED:
        covariance = np.array(reader.values('36d')).reshape(6, 6)
    reader.skip(8 * TWIST if kind == ODOMETRY else 0)
    reader.finish()
    if not is_covariance(covariance).all():
        raise MessageError(
            'pose.covariance is not allowed, must be finite, symmetric and positive semidefinite'
        )
    return Pose(
        stamp, frame_id, position, math.nan if covariance[5, 5] >= UNMEASURED else yaw, covariance
    )


def encode_pose(
    stamp: float, frame_id: str, mean: Array, covariance: Array, yaw: float, yaw_variance: float,
) -> bytes:
    """
    Return a pose with covariance; what was not measured gets a large variance, not zero.

    Parameters
    ----------
    stamp
        [s].
    frame_id
        Frame of the pose.
    mean : (D,) float
        Position [m]; a missing third dimension is not measured.
    covariance : (D, D) float
        [m^2].
    yaw, yaw_variance
        [rad, rad^2]; NaN if not measured.

    """
    data, = encode_poses(
        stamp, frame_id, mean[np.newaxis], covariance[np.newaxis], np.array([yaw]),
        np.array([yaw_variance]))
    return data


def encode_poses(
    stamp: float, frame_id: str, mean: Array, covariance: Array, yaw: Array, yaw_variance: Array,
) -> list[bytes]:
    """
    Return poses of V vehicles at one time, as `encode_pose` does one.

    Parameters
    ----------
    stamp
        [s].
    frame_id
        Frame of the poses.
    mean : (V, D) float
        Positions [m].
    covariance : (V, D, D) float
        [m^2].
    yaw, yaw_variance : (V,) float
        [rad, rad^2]; NaN if not measured.

    """
    head = cdr.HEADER + _STAMP.pack(*split(stamp)) + _after_stamp(frame_id)
    count, dimension = mean.shape
    if not np.isfinite(mean).all():
        for place in mean:
            _checked(place)
    doubles = np.empty((count, len(_UNKNOWN_POSE)), '<f8')
    doubles[:] = _UNKNOWN_POSE
    doubles[:, :dimension] = mean
    full = doubles[:, 7:].reshape(count, 6, 6)
    full[:, :dimension, :dimension] = covariance
    for row, angle in enumerate(yaw.tolist()):
        if not math.isnan(angle):
            doubles[row, 3:7] = _quaternion(angle)
            full[row, 5, 5] = yaw_variance[row]
    return [head + row.tobytes() for row in doubles]


def encode_pose_array(stamp: float, frame_id: str, particles: Array) -> bytes:
    """Return particles (N, D) [m] as poses without rotation."""
    count, dimension = particles.shape
    poses = np.zeros((count, 7))
    poses[:, :dimension] = particles
    poses[:, 6] = 1.0
    writer = cdr.Writer()
    write_header(writer, stamp, frame_id)
    writer.values('I', count)
    if count:
        writer.align(8)
        writer.raw(poses.astype('<f8', copy=False).tobytes())
    return writer.finish()


def check_pose(values: Sequence[float]) -> None:
    x, y, z, *quaternion = values
    if not (abs(x) <= FURTHEST and abs(y) <= FURTHEST and abs(z) <= FURTHEST):
        raise MessageError(
            f'position x {x:g}, y {y:g}, z {z:g} is not allowed, must be finite and within '
            f'{FURTHEST:g} m')
    if not 0 < sum(q * q for q in quaternion) < math.inf:
        shown = ' '.join(f'{q:g}' for q in quaternion)
        raise MessageError(f'orientation {shown} is not allowed, must be a quaternion of length 1')


def yaw_of(x: Array, y: Array, z: Array, w: Array) -> Array:
    """Return the heading of quaternions of any length but zero."""
    return np.asarray(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def _quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the rotation about z; none where the yaw is not known."""
    if math.isnan(yaw):
        return 0.0, 0.0, 0.0, 1.0
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


@lru_cache(maxsize=16)
def _after_stamp(frame_id: str) -> bytes:
    """Return what follows the stamp of a message before its first double."""
    writer = cdr.Writer()
    write_header(writer, 0.0, frame_id)
    writer.align(8)
    return writer.finish()[len(cdr.HEADER) + _STAMP.size:]


def _checked(position: Array) -> list[float]:
    values: list[float] = position.tolist()
    if not all(map(math.isfinite, values)):
        raise MessageError(f'position {values} is not allowed, must be finite')
    return values


def _read_pose(reader: cdr.Reader) -> tuple[Array, float]:
    values = reader.values('7d')
    check_pose(values)
    return np.array(values[:3]), float(yaw_of(*values[3:]))
