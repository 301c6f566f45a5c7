"""
Conversion between the package's values and serialized standard messages.

This is the only place that knows field layouts. It works on serialized bytes, which is what
raw subscriptions deliver, what publishers take as they are, and what bags hold: a node and an
offline run go through the same code.

Stamps are float seconds. They survive a round trip to the nanosecond below 2^22 s (48 days), as
simulated and relative times are; at today's epoch a double resolves 0.24 us.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import groupby
import math

import numpy as np
from tsmcl_ros import cdr
from tsmcl_ros.types import (
    ANCHOR,
    Array,
    Links,
    MAX_PERIOD_FACTOR,
    MessageError,
    Observation,
    Odometry,
    Trajectory,
    VEHICLE,
)

POINT_CLOUD = 'sensor_msgs/msg/PointCloud2'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
RANGE = 'sensor_msgs/msg/Range'
CLOCK = 'rosgraph_msgs/msg/Clock'
UINT32 = 'std_msgs/msg/UInt32'

UNMEASURED = 1e6
"""Variance [m^2, rad^2] that stands for 'not measured' in a pose's covariance."""

MAX_COORDINATE = 1e5
"""Largest coordinate of a beacon [m]: beyond it FLOAT32 resolves no better than a centimetre."""

BEACON = np.dtype(
    [(name, '<f4') for name in ('x', 'y', 'z')]
    + [('id', '<u4'), ('kind', 'u1'), ('hops', 'u1')]
    + [(name, '<f4') for name in ('max_range', 'range', 'range_std', 'rssi')]
    + [(f'cov_{axes}', '<f4') for axes in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')],
    align=True,
)
"""One beacon as a row of a PointCloud2; two bytes of padding keep the floats aligned."""


LINK = np.dtype(
    [(name, '<f4') for name in ('x', 'y', 'z')]
    + [('id', '<u4'), ('peer_id', '<u4'), ('rssi', '<f4')],
)
"""One link as a row of a PointCloud2: anchor `id`, at x, y, z, hears `peer_id` with this rssi."""


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


@dataclass(frozen=True)
class RangeReading:
    """
    One measured distance, as common UWB drivers publish it.

    Attributes
    ----------
    stamp : float
        [s].
    frame_id : str
        Names the anchor.
    range : float
        [m]; NaN where the message says that nothing was measured.
    min_range, max_range : float
        Limits of the radio [m]; max_range is NaN if the driver left both at zero.
    variance : float
        [m^2], NaN where unknown.
    """

    stamp: float
    frame_id: str
    range: float
    min_range: float
    max_range: float
    variance: float


def decode_beacons(data: bytes) -> tuple[Observation, str]:
    """
    Return what one vehicle heard (V = 1, D = 3), and the frame of the positions.

    Fields are read by name and offset, in any order and with any padding; beyond x, y, z and id
    they are optional. An absent or NaN covariance is zero, as of a surveyed anchor. Arrays may be
    read-only views of the data.

    Raises
    ------
    MessageError
        If the bytes are not a beacon scan, or say what cannot be true: a position that is not
        finite or beyond 100 km, a negative or infinite measurement, an unknown kind or number of
        hops, a covariance that is none, or an anchor's id that somebody else claims too.
    """
    stamp, frame_id, cloud = _read_cloud(data, _read_layout)
    rows = _unify(cloud)
    _check_rows(rows)
    scan = rows[np.newaxis]
    return Observation(
        stamp=stamp,
        sender=scan['id'].astype(np.int64),
        kind=scan['kind'],
        hops=scan['hops'],
        position=scan['position'],
        covariance=_full_covariance(scan['covariance']),
        max_range=scan['max_range'],
        range=scan['range'],
        range_std=scan['range_std'],
        rssi=scan['rssi'],
    ), frame_id


def encode_beacons(observation: Observation, frame_id: str) -> list[bytes]:
    """Return one beacon scan a vehicle; a missing third dimension becomes zero."""
    vehicles, references, dimension = observation.position.shape
    rows = np.zeros((vehicles, references), BEACON)
    rows.view(_ROW)['position'][..., :dimension] = observation.position
    rows['id'] = observation.sender
    for name in ('kind', 'hops', 'max_range', 'range', 'range_std', 'rssi'):
        rows[name] = getattr(observation, name)
    for row, column, name in _UPPER_TRIANGLE:
        if column < dimension:
            rows[name] = observation.covariance[..., row, column]
    # Picked as words: numpy may copy a structured row field by field, and padding stays chance.
    return [
        _encode_scan(observation.stamp, frame_id, scan[heard])
        for scan, heard in zip(_words(rows), observation.heard, strict=True)
    ]


def decode_links(data: bytes) -> tuple[Links, str]:
    """
    Return how anchors hear each other (D = 3), and the frame of the positions.

    All fields of `LINK` must be there, read as those of beacons are. A row says where its own
    anchor is, so that every peer needs a row of its own.

    Raises
    ------
    MessageError
        If the bytes are not such links, or say what cannot be true: a position or rssi that is
        not finite, a position beyond 100 km, an anchor that hears itself or has two positions, a
        peer without a position, or a link that comes twice.
    """
    _, frame_id, cloud = _read_cloud(
        data, lambda reader: _parse_layout(reader, _LINK_FIELDS, tuple(_LINK_FIELDS)))
    position = np.stack([cloud[axis] for axis in 'xyz'], axis=1)
    receiver, sender = (cloud[name].astype(np.int64) for name in ('id', 'peer_id'))
    _check_links(receiver, sender, position, cloud['rssi'])
    position = position.astype(np.float32)
    identity, first = np.unique(receiver, return_index=True)
    return Links(
        receiver, sender, position, position[first[np.searchsorted(identity, sender)]],
        cloud['rssi'].astype(np.float32)), frame_id


def encode_links(stamp: float, links: Links, frame_id: str) -> bytes:
    """Return how anchors hear each other; a missing third dimension becomes zero."""
    rows = np.zeros(len(links.rssi), LINK)
    for axis, values in zip('xyz', links.receiver_position.T, strict=False):
        rows[axis] = values
    rows['id'], rows['peer_id'], rows['rssi'] = links.receiver, links.sender, links.rssi
    return _encode_cloud(stamp, frame_id, _LINK_LAYOUT, rows, True)


def decode_odometry(data: bytes) -> Odometry:
    """
    Return one odometry pose.

    Raises
    ------
    MessageError
        If the bytes are not odometry, or the pose is not finite.
    """
    reader = cdr.Reader(data)
    stamp, _ = _read_header(reader)
    reader.string()
    position, yaw = _read_pose(reader)
    reader.skip(8 * (36 + _TWIST))
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
    _write_header(writer, odometry.stamp, frame_id)
    writer.string(child_frame_id)
    writer.values('7d', *_checked(odometry.position), *_quaternion(odometry.yaw))
    writer.values('36d', *_ZEROS[:35], UNMEASURED if math.isnan(odometry.yaw) else 0.0)
    writer.values(f'{_TWIST}d', *velocity, *_ZEROS[:6 - len(velocity)], *_ZEROS)
    return writer.finish()


def decode_pose(data: bytes) -> Pose:
    """
    Return a pose with covariance.

    Raises
    ------
    MessageError
        If the bytes are not such a pose, or a number is not finite, or the covariance none.
    """
    reader = cdr.Reader(data)
    stamp, frame_id = _read_header(reader)
    position, yaw = _read_pose(reader)
    covariance = np.array(reader.values('36d')).reshape(6, 6)
    reader.finish()
    if not _is_covariance(covariance):
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
    dimension = len(mean)
    full = np.diag([UNMEASURED] * 6)
    full[:dimension, :dimension] = covariance
    if not math.isnan(yaw):
        full[5, 5] = yaw_variance
    writer = cdr.Writer()
    _write_header(writer, stamp, frame_id)
    position = [*_checked(mean), *_ZEROS[:3 - dimension]]
    writer.values('7d', *position, *_quaternion(yaw))
    writer.values('36d', *full.ravel().tolist())
    return writer.finish()


def decode_poses(messages: Sequence[bytes]) -> Trajectory:
    """
    Return the trajectory of many poses with covariance at once.

    A message stamped as the one before it adds nothing and is left out.

    Raises
    ------
    MessageError
        Naming the first message that is malformed, in another frame, or goes back in time.
    """
    trajectory, covariance = _decode_trajectory(messages, strings=1, tail=0)
    return replace(trajectory, covariance=covariance[:, :3, :3].copy())


def decode_odometries(messages: Sequence[bytes]) -> Trajectory:
    """
    Return the trajectory of many odometry messages at once, as `decode_poses` does.

    Odometry and ground truth carry no covariance that is worth having: it is None.
    """
    trajectory, _ = _decode_trajectory(messages, strings=2, tail=_TWIST)
    return trajectory


def decode_range(data: bytes) -> RangeReading:
    """
    Return one measured distance.

    The variance is absent before ROS 2 Jazzy. A reading of NaN or infinity, or outside the
    radio's limits, is no measurement (REP 117, and the message's own definition).

    Raises
    ------
    MessageError
        If the bytes are not such a reading, or the distance is negative.
    """
    reader = cdr.Reader(data)
    stamp, frame_id = _read_header(reader)
    reader.skip(1)
    _, low, high, measured = reader.values('4f')
    variance = reader.values('f')[0] if len(data) - reader.position >= 4 else 0.0
    reader.finish()
    if -math.inf < measured < 0:
        raise MessageError(f'range {measured:g} is not allowed, must be at least 0')
    limited = high > low
    known = math.isfinite(measured) and (low <= measured <= high or not limited)
    return RangeReading(
        stamp=stamp,
        frame_id=frame_id,
        range=measured if known else math.nan,
        min_range=low,
        max_range=high if limited else math.nan,
        variance=variance if 0 < variance < math.inf else math.nan,
    )


def encode_range(reading: RangeReading) -> bytes:
    """Return a reading in Jazzy's layout."""
    writer = cdr.Writer()
    _write_header(writer, reading.stamp, reading.frame_id)
    writer.values('B', 0)
    high, variance = (0.0 if math.isnan(x) else x for x in (reading.max_range, reading.variance))
    writer.values('5f', 0.0, reading.min_range, high, reading.range, variance)
    return writer.finish()


def encode_pose_array(stamp: float, frame_id: str, particles: Array) -> bytes:
    """Return particles (N, D) [m] as poses without rotation."""
    count, dimension = particles.shape
    poses = np.zeros((count, 7))
    poses[:, :dimension] = particles
    poses[:, 6] = 1.0
    writer = cdr.Writer()
    _write_header(writer, stamp, frame_id)
    writer.values('I', count)
    if count:
        writer.align(8)
        writer.raw(poses.astype('<f8', copy=False).tobytes())
    return writer.finish()


def encode_clock(stamp: float) -> bytes:
    """Return a clock message."""
    writer = cdr.Writer()
    writer.values('iI', *_split(stamp))
    return writer.finish()


def decode_clock(data: bytes) -> float:
    """Return the time that a clock message shows [s]; raise MessageError if it shows none."""
    reader = cdr.Reader(data)
    stamp = _join(*reader.values('iI'))
    reader.finish()
    return stamp


def encode_period(factor: int) -> bytes:
    """Return a message that asks for a beacon every so many periods."""
    writer = cdr.Writer()
    writer.values('I', factor)
    return writer.finish()


def decode_period(data: bytes) -> int:
    """Return how many periods a vehicle wants between beacons; raise MessageError if none."""
    reader = cdr.Reader(data)
    (factor,) = reader.values('I')
    reader.finish()
    if not 1 <= factor <= MAX_PERIOD_FACTOR:
        raise MessageError(f'period factor {factor} is not allowed, must be from 1 to '
                           f'{MAX_PERIOD_FACTOR}')
    return int(factor)


# --- stamps and headers --------------------------------------------------------------------

_SECOND = 1_000_000_000
_MAX_STAMP = 2**31


def _split(stamp: float) -> tuple[int, int]:
    """Return the seconds and nanoseconds of a stamp."""
    if not 0 <= stamp < _MAX_STAMP:
        raise MessageError(
            f'stamp {stamp!r} is not allowed, must be at least 0 and below {_MAX_STAMP} s'
        )
    whole, part = divmod(stamp, 1)
    return divmod(int(whole) * _SECOND + round(part * _SECOND), _SECOND)


def _join(seconds: int, nanoseconds: int) -> float:
    """Return the double nearest to a stamp."""
    if seconds < 0 or nanoseconds >= _SECOND:
        raise MessageError(
            f'stamp of {seconds} s and {nanoseconds} ns is not allowed, must be at least 0 s and '
            f'from 0 to {_SECOND - 1} ns'
        )
    return (seconds * _SECOND + nanoseconds) / _SECOND


@contextmanager
def _naming(number: int) -> Iterator[None]:
    """Say which of many messages an error is about."""
    try:
        yield
    except MessageError as error:
        raise MessageError(f'message {number}: {error}') from None


def _join_in_order(seconds: Array, nanoseconds: Array) -> Array:
    """Return what `_join` does, bit for bit, of arrays (T,); refuse stamps that go back."""
    total = seconds * _SECOND + nanoseconds
    # Above 2^53 ns the total is no double any more; there the sum is the nearest one.
    stamp = np.where(total < 2**53, total / _SECOND, seconds + nanoseconds / _SECOND)
    impossible = (seconds < 0) | (nanoseconds >= _SECOND)
    wrong = impossible | (np.diff(stamp, prepend=-np.inf) < 0)
    if wrong.any():
        at = int(np.argmax(wrong))
        with _naming(at):
            _join(int(seconds[at]), int(nanoseconds[at]))
            raise MessageError(
                f'stamp {stamp[at]:.9f} s goes back, must be at least that of the one before, '
                f'{stamp[at - 1]:.9f} s'
            )
    return stamp


def _read_header(reader: cdr.Reader) -> tuple[float, str]:
    stamp = _join(*reader.values('iI'))
    return stamp, reader.string()


def _write_header(writer: cdr.Writer, stamp: float, frame_id: str) -> None:
    writer.values('iI', *_split(stamp))
    writer.string(frame_id)


# --- poses -----------------------------------------------------------------------------------

_ZEROS = (0.0,) * 36
_TWIST = 6 + 36  # doubles of a TwistWithCovariance
_STAMPED_POSE = np.dtype([
    ('seconds', '<i4'), ('nanoseconds', '<u4'), ('doubles', '<f8', (43,)),
])
_ROUNDING = 1e-5  # of a correlation; those of FLOAT32 variances are off by 1e-6


def _quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the rotation about z; none where the yaw is not known."""
    if math.isnan(yaw):
        return 0.0, 0.0, 0.0, 1.0
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def _yaw(x: Array, y: Array, z: Array, w: Array) -> Array:
    """Return the heading of quaternions of any length but zero."""
    return np.asarray(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def _checked(position: Array) -> list[float]:
    values: list[float] = position.tolist()
    if not all(map(math.isfinite, values)):
        raise MessageError(f'position {values} is not allowed, must be finite')
    return values


def _read_pose(reader: cdr.Reader) -> tuple[Array, float]:
    values = reader.values('7d')
    _check_pose(values)
    return np.array(values[:3]), float(_yaw(*values[3:]))


def _check_pose(values: Sequence[float]) -> None:
    x, y, z, *quaternion = values
    if not all(map(math.isfinite, (x, y, z))):
        raise MessageError(f'position x {x:g}, y {y:g}, z {z:g} is not allowed, must be finite')
    if not 0 < sum(q * q for q in quaternion) < math.inf:
        shown = ' '.join(f'{q:g}' for q in quaternion)
        raise MessageError(f'orientation {shown} is not allowed, must be a quaternion of length 1')


def _is_covariance(matrix: Array) -> bool:
    """Tell whether matrices (..., D, D) are covariances, but for rounding."""
    variance = np.diagonal(matrix, axis1=-2, axis2=-1)
    if not np.isfinite(matrix).all() or (variance < 0).any():
        return False
    # Of the correlations, so that a large variance does not hide what is wrong with a small one.
    std = np.sqrt(variance)
    scale = std[..., :, np.newaxis] * std[..., np.newaxis, :]
    with np.errstate(over='ignore'):
        correlation = np.divide(matrix, scale, out=np.array(matrix), where=scale > 0)
    if (np.abs(correlation) > 1 + _ROUNDING).any():
        return False
    if (np.abs(correlation - np.swapaxes(correlation, -1, -2)) > _ROUNDING).any():
        return False
    return bool((np.linalg.eigvalsh(correlation) >= -_ROUNDING).all())


def _decode_trajectory(
    messages: Sequence[bytes], strings: int, tail: int,
) -> tuple[Trajectory, Array]:
    """
    Return the trajectory of messages of one layout, and the (T, 6, 6) covariances of its poses.

    Messages hold a stamp, texts (`strings` of them), a pose with its covariance, and a `tail` of
    doubles. As all have the same texts, they differ in what pads their ends at most.
    """
    blocks = [np.empty(0, _STAMPED_POSE)]
    texts = None
    done = 0
    for _, group in groupby(messages, key=len):
        block = list(group)
        with _naming(done):
            reader, found = _read_texts(block[0], strings)
            start = reader.align(8)
            reader.skip(8 * (43 + tail))
            reader.finish()
        texts = texts or found
        data = b''.join(block)
        raw = np.frombuffer(data, np.uint8).reshape(len(block), -1)
        fixed = [0, 1, *(at for at in range(12, start) if at not in reader.padding)]
        differs = (raw[:, fixed] != raw[0, fixed]).any(axis=1) | (found != texts)
        if differs.any():
            at = int(np.argmax(differs))
            _refuse_texts(block[at], done + at, strings, texts)
        view = np.dtype({
            'names': ['seconds', 'nanoseconds', 'doubles'],
            'formats': ['<i4', '<u4', '(43,)<f8'],
            'offsets': [4, 8, start],
            'itemsize': len(block[0]),
        })
        blocks.append(np.frombuffer(data, view).astype(_STAMPED_POSE))
        done += len(block)
    rows = np.concatenate(blocks)
    _check_doubles(rows['doubles'])
    stamp = _join_in_order(rows['seconds'].astype(np.int64), rows['nanoseconds'])
    new = np.diff(stamp, prepend=-1.0) > 0
    doubles = rows['doubles'][new]
    covariance = doubles[:, 7:].reshape(-1, 6, 6)
    yaw = np.where(covariance[:, 5, 5] >= UNMEASURED, np.nan, _yaw(*doubles[:, 3:7].T))
    return Trajectory(stamp[new], doubles[:, :3].copy(), yaw), covariance


def _read_texts(data: bytes, strings: int) -> tuple[cdr.Reader, list[str]]:
    reader = cdr.Reader(data)
    reader.values('iI')
    return reader, [reader.string() for _ in range(strings)]


def _refuse_texts(data: bytes, number: int, strings: int, texts: list[str]) -> None:
    with _naming(number):
        _, found = _read_texts(data, strings)
        raise MessageError(
            f'its frame is {" to ".join(map(repr, found))}, must be as before '
            f'{" to ".join(map(repr, texts))}'
        )


def _check_doubles(doubles: Array) -> None:
    """Refuse poses (T, 43) with their covariances that cannot be true, naming the first."""
    with np.errstate(over='ignore', invalid='ignore'):
        length = (doubles[:, 3:7] ** 2).sum(axis=1)
    wrong = ~(np.isfinite(doubles).all(axis=1) & (length > 0) & np.isfinite(length))
    if wrong.any():
        at = int(np.argmax(wrong))
        with _naming(at):
            _check_pose(doubles[at, :7].tolist())
            raise MessageError('pose.covariance is not allowed, must be finite')


# --- beacon rows -----------------------------------------------------------------------------

_MEASURED = ('max_range', 'range', 'range_std', 'rssi')
_UPPER_TRIANGLE = (
    (0, 0, 'cov_xx'), (0, 1, 'cov_xy'), (0, 2, 'cov_xz'),
    (1, 1, 'cov_yy'), (1, 2, 'cov_yz'), (2, 2, 'cov_zz'),
)
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_OFFSETS = {name: BEACON.fields[name][1] for name in BEACON.names}  # type: ignore[index,union-attr]

# The same row, with position and covariance each in one piece.
_ROW = np.dtype({
    'names': ['position', 'id', 'kind', 'hops', *_MEASURED, 'covariance'],
    'formats': ['(3,)<f4', '<u4', 'u1', 'u1', *['<f4'] * len(_MEASURED), '(6,)<f4'],
    'offsets': [_OFFSETS[name] for name in ('x', 'id', 'kind', 'hops', *_MEASURED, 'cov_xx')],
    'itemsize': BEACON.itemsize,
})

# What a row says in fields that its message does not have.
_UNSAID = np.zeros((), BEACON)
_UNSAID['hops'] = 1
for _name in _MEASURED:
    _UNSAID[_name] = np.nan

# Bounds of the floats; NaN passes, infinity does not.
_MAX, _TINY = float(np.finfo(np.float32).max), float(np.finfo(np.float32).tiny)
_BOUNDS = {
    **dict.fromkeys(('x', 'y', 'z'), (-MAX_COORDINATE, MAX_COORDINATE)),
    'max_range': (_TINY, _MAX),
    **dict.fromkeys(('range', 'range_std', 'cov_xx', 'cov_yy', 'cov_zz'), (0.0, _MAX)),
    **dict.fromkeys(('rssi', 'cov_xy', 'cov_xz', 'cov_yz'), (-_MAX, _MAX)),
}
_MEANINGS = {
    -MAX_COORDINATE: f'within {MAX_COORDINATE / 1000:g} km of the origin: use a local origin',
    _TINY: 'above 0, or NaN where not known',
    0.0: 'finite and at least 0, or NaN where not known',
    -_MAX: 'finite, or NaN where not known',
}
# They are held against a row's words of four bytes at once; what is no float has no bounds.
_WORDS = BEACON.itemsize // 4
_WORD = {name: _OFFSETS[name] // 4 for name in _BOUNDS}
_LOW, _HIGH = np.full(_WORDS, -np.inf, np.float32), np.full(_WORDS, np.inf, np.float32)
for _name, (_low, _high) in _BOUNDS.items():
    _LOW[_WORD[_name]], _HIGH[_WORD[_name]] = _low, _high


def _unify(rows: Array) -> Array:
    """Return rows of any layout as rows of _ROW: a view if they are so already."""
    if rows.dtype is _ROW:
        return rows
    table = np.full(len(rows), _UNSAID)
    # A FLOAT64 beyond FLOAT32 becomes infinite, which is refused later.
    with np.errstate(over='ignore'):
        for name in rows.dtype.names or ():
            table[name] = rows[name]
    return table.view(_ROW)


def _check_rows(rows: Array) -> None:
    """Refuse rows (K,) that cannot be true; `count_nonzero` is far quicker than `any` on few."""
    words = _words(rows)
    low, high = words < _LOW, words > _HIGH
    if np.count_nonzero(low) or np.count_nonzero(high):
        row, word = np.argwhere(low | high)[0]
        name = next(name for name in _WORD if _WORD[name] == word)
        raise MessageError(
            f'{name} {words[row, word]:g} of id {rows["id"][row]} is not allowed, must be '
            f'{_MEANINGS[_BOUNDS[name][0]]}'
        )
    missing = np.isnan(rows['position'])
    if np.count_nonzero(missing):
        row, axis = np.argwhere(missing)[0]
        raise MessageError(
            f'{"xyz"[axis]} nan of id {rows["id"][row]} is not allowed, must be a number'
        )
    for field, known, meaning in (
        ('kind', b'\0\1', '0 (anchor) or 1 (vehicle)'),
        ('hops', b'\1\2', '1 (heard directly) or 2 (relayed by a neighbour)'),
    ):
        unknown = rows[field].tobytes().translate(None, known)
        if unknown:
            raise MessageError(f'{field} {unknown[0]} is not allowed, must be {meaning}')
    ids = rows['id'].tolist()
    if len(set(ids)) < len(ids):
        _check_claims(rows)


def _words(rows: Array) -> Array:
    """Return rows (...) as floats (..., 15), among them the words that are none."""
    return rows.view('<f4').reshape(*rows.shape, _WORDS)


def _encode_scan(stamp: float, frame_id: str, words: Array) -> bytes:
    dense = not np.isnan(words[:, list(_WORD.values())]).any()
    return _encode_cloud(stamp, frame_id, _BEACON_LAYOUT, words, dense)


def _check_claims(rows: Array) -> None:
    """Refuse an anchor's id with two positions, or with a vehicle that claims it too."""
    claims: dict[int, list[float]] = {}
    for row in rows[rows['kind'] == ANCHOR]:
        sender, position = int(row['id']), row['position'].tolist()
        if claims.setdefault(sender, position) != position:
            raise MessageError(
                f'two anchors claim id {sender}, at {claims[sender]} and at {position}: '
                'an id must have one position'
            )
    for sender in rows['id'][rows['kind'] == VEHICLE].tolist():
        if sender in claims:
            raise MessageError(
                f'an anchor and a vehicle claim id {sender}: an id must have one sender')


def _full_covariance(terms: Array) -> Array:
    """Return (..., 3, 3) covariances of (..., 6) upper triangles; unknown terms are zero."""
    if not np.count_nonzero(terms):
        return np.zeros((*terms.shape[:-1], 3, 3), np.float32)
    full = np.where(np.isnan(terms), np.float32(0), terms)[..., _FULL]
    if not _is_covariance(full.astype(np.float64)):
        raise MessageError('cov_xx to cov_zz are not allowed, must be positive semidefinite')
    return full


# --- links -----------------------------------------------------------------------------------


def _check_links(receiver: Array, sender: Array, position: Array, rssi: Array) -> None:
    """Refuse links (L,) that cannot be true, naming the first; see `decode_links`."""
    def first(wrong: Array) -> int:
        return int(np.argmax(wrong)) if wrong.any() else -1

    far = ~(np.abs(position) <= MAX_COORDINATE)
    if (at := first(far.any(axis=1))) >= 0:
        axis = int(np.argmax(far[at]))
        raise MessageError(
            f'{"xyz"[axis]} {position[at, axis]:g} of id {receiver[at]} is not allowed, must be a '
            f'number {_MEANINGS[-MAX_COORDINATE]}')
    if (at := first(~np.isfinite(rssi))) >= 0:
        raise MessageError(
            f'rssi {rssi[at]:g} of the link from id {receiver[at]} to peer_id {sender[at]} is not '
            'allowed, must be finite')
    if (at := first(receiver == sender)) >= 0:
        raise MessageError(
            f'peer_id {sender[at]} of id {receiver[at]} is not allowed, must be another anchor')
    if (at := first(~np.isin(sender, receiver))) >= 0:
        raise MessageError(
            f'peer_id {sender[at]} of id {receiver[at]} is unknown, must have a row of its own, '
            'which says where it is')
    identity, where = np.unique(receiver, return_index=True)
    own = where[np.searchsorted(identity, receiver)]
    if (at := first((position != position[own]).any(axis=1))) >= 0:
        raise MessageError(
            f'id {receiver[at]} stands at {position[own[at]].tolist()} and at '
            f'{position[at].tolist()}: an id must have one position')
    _, kept = np.unique([receiver, sender], axis=1, return_index=True)
    if (at := first(~np.isin(np.arange(len(receiver)), kept))) >= 0:
        raise MessageError(
            f'the link from id {receiver[at]} to peer_id {sender[at]} comes twice, must come once')


# --- layouts of clouds -------------------------------------------------------------------------

# Values of sensor_msgs/PointField.
_DATATYPES = ('INT8', 'UINT8', 'INT16', 'UINT16', 'INT32', 'UINT32', 'FLOAT32', 'FLOAT64')
_UINT8, _UINT32, _FLOAT32, _FLOAT64 = 2, 6, 7, 8
_FORMATS = {_UINT8: 'u1', _UINT32: '<u4', _FLOAT32: '<f4', _FLOAT64: '<f8'}
# Those that a field may have; the first is ours.
_ALLOWED = {
    **dict.fromkeys(_OFFSETS, (_FLOAT32,)),
    **dict.fromkeys(('x', 'y', 'z'), (_FLOAT32, _FLOAT64)),
    'id': (_UINT32,), 'kind': (_UINT8,), 'hops': (_UINT8,),
}
_REQUIRED = ('x', 'y', 'z', 'id')
_LINK_FIELDS = {name: _ALLOWED.get(name, (_UINT32,)) for name in LINK.names or ()}
_MAX_POINT_STEP = 2**16
_MAX_LAYOUTS = 16


@dataclass(frozen=True, eq=False)
class _KnownLayout:
    """The bytes of a cloud from its fields to point_step, and the rows that they describe."""

    size: int
    mask: int
    masked: int
    rows: np.dtype[np.void]


_known_layouts: list[_KnownLayout] = []


def _read_cloud(
    data: bytes, read_layout: Callable[[cdr.Reader], np.dtype[np.void]],
) -> tuple[float, str, Array]:
    """Return stamp, frame and rows (K,) of a cloud."""
    reader = cdr.Reader(data)
    stamp, frame_id = _read_header(reader)
    height, width = reader.values('II')
    layout = read_layout(reader)
    _, size = reader.values('II')
    start = reader.skip(size)
    reader.skip(1)
    reader.finish()
    count = height * width
    if count * layout.itemsize != size:
        raise MessageError(
            f'data has {size} bytes, must be height {height} x width {width} x point_step '
            f'{layout.itemsize} = {count * layout.itemsize}'
        )
    return stamp, frame_id, np.frombuffer(data, layout, count, start)


def _read_layout(reader: cdr.Reader) -> np.dtype[np.void]:
    """
    Return the dtype of a cloud's rows: _ROW for our own, else those of its fields that are there.

    A publisher sends the same layout with every message, at any position as all in it is aligned
    to four bytes: it is parsed once. Bytes of padding are masked, as Fast DDS leaves them unset.
    """
    start = reader.position
    for known in _known_layouts:
        block = reader.data[start:start + known.size]
        if int.from_bytes(block, 'little') & known.mask == known.masked:
            reader.skip(known.size)
            return known.rows
    rows = _parse_layout(reader)
    block = reader.data[start:reader.position]
    mask = bytearray(b'\xff' * len(block))
    for position in reader.padding:
        if position >= start:
            mask[position - start] = 0
    whole = int.from_bytes(mask, 'little')
    if len(_known_layouts) >= _MAX_LAYOUTS:
        _known_layouts.clear()
    _known_layouts.append(
        _KnownLayout(len(block), whole, int.from_bytes(block, 'little') & whole, rows)
    )
    return rows


def _parse_layout(
    reader: cdr.Reader, allowed: Mapping[str, tuple[int, ...]] = _ALLOWED,
    required: Sequence[str] = _REQUIRED,
) -> np.dtype[np.void]:
    count, = reader.values('I')
    found: dict[str, tuple[int, int]] = {}
    for _ in range(count):
        name = reader.string()
        offset, = reader.values('I')
        datatype, = reader.values('B')
        elements, = reader.values('I')
        if name not in allowed:
            continue
        if name in found:
            raise MessageError(f'field {name} comes twice, must come once')
        if datatype not in allowed[name]:
            raise MessageError(
                f'field {name}: datatype {_datatype(datatype)} is not allowed, must be '
                f'{" or ".join(map(_datatype, allowed[name]))}'
            )
        if elements != 1:
            raise MessageError(f'field {name}: count {elements} is not allowed, must be 1')
        found[name] = offset, datatype
    big_endian, = reader.values('B')
    step, = reader.values('I')
    missing = [name for name in required if name not in found]
    if missing:
        raise MessageError(
            f'fields {", ".join(missing)} are missing, must have at least {", ".join(required)}'
        )
    if big_endian:
        raise MessageError('is_bigendian true is not supported, must be false')
    if step > _MAX_POINT_STEP:
        raise MessageError(f'point_step {step} is not allowed, must be at most {_MAX_POINT_STEP}')
    for name, (offset, datatype) in found.items():
        end = offset + np.dtype(_FORMATS[datatype]).itemsize
        if end > step:
            raise MessageError(
                f'field {name}: offset {offset} is not allowed, ends at byte {end} of a row whose '
                f'point_step is {step}'
            )
    layout = np.dtype({
        'names': list(found),
        'formats': [_FORMATS[datatype] for _, datatype in found.values()],
        'offsets': [offset for offset, _ in found.values()],
        'itemsize': step,
    })
    return _ROW if layout == BEACON else layout


def _datatype(value: int) -> str:
    return _DATATYPES[value - 1] if 1 <= value <= len(_DATATYPES) else str(value)


def _encode_layout(rows: np.dtype[np.void], allowed: Mapping[str, tuple[int, ...]]) -> bytes:
    """Return the bytes of our own clouds from the fields to point_step."""
    writer = cdr.Writer()
    offsets = {name: field[1] for name, field in (rows.fields or {}).items()}
    writer.values('I', len(offsets))
    for name, offset in offsets.items():
        writer.string(name)
        writer.values('I', offset)
        writer.values('B', allowed[name][0])
        writer.values('I', 1)
    writer.values('B', False)
    writer.values('I', rows.itemsize)
    return writer.finish()[len(cdr.HEADER):]


_BEACON_LAYOUT = _encode_layout(BEACON, _ALLOWED)
_LINK_LAYOUT = _encode_layout(LINK, _LINK_FIELDS)


def _encode_cloud(stamp: float, frame_id: str, layout: bytes, rows: Array, dense: bool) -> bytes:
    """Return a cloud of rows (K, ...) as they lie in memory."""
    writer = cdr.Writer()
    _write_header(writer, stamp, frame_id)
    writer.values('II', 1, len(rows))
    writer.raw(layout)
    data = rows.tobytes()
    writer.values('II', len(data), len(data))
    writer.raw(data)
    writer.values('?', dense)
    return writer.finish()
