"""Beacons, one row of a PointCloud2 each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros import cdr
from tsmcl_ros.messages.clouds import (
    BYTE,
    COORDINATE,
    encode_cloud,
    encode_layout,
    FLOAT,
    NUMBER,
    parse_layout,
    read_cloud,
)
from tsmcl_ros.messages.rows import (
    as_words,
    BEACON,
    find_faults,
    full_covariance,
    muted,
    OFFSETS,
    ROW,
    unify,
    UPPER_TRIANGLE,
    WORD,
)
from tsmcl_ros.types import Array, MessageError, Observation

_ALLOWED = {
    **dict.fromkeys(OFFSETS, FLOAT), **dict.fromkeys(('x', 'y', 'z'), COORDINATE),
    'id': NUMBER, 'kind': BYTE, 'hops': BYTE,
}
_REQUIRED = ('x', 'y', 'z', 'id')
_LAYOUT = encode_layout(BEACON, _ALLOWED)
_MAX_LAYOUTS = 16


@dataclass(frozen=True, eq=False)
class Scan:
    """
    What one vehicle heard.

    Attributes
    ----------
    observation : Observation
        V = 1, D = 3. Arrays may be read-only views of the data.
    frame_id : str
        Of the positions.
    untrue : (M,) uint32
        Whose rows cannot be true. Those say nothing but that somebody of kind `UNTRUE` was heard,
        and are left out where another row of the same sender can be true.
    fault : str
        What is wrong with the first of them.

    """

    observation: Observation
    frame_id: str
    untrue: Array
    fault: str


def decode_beacons(data: bytes) -> tuple[Observation, str]:
    """
    Return what `decode_scan` does, observation and frame, of rows that all can be true.

    Raises
    ------
    MessageError
        If the bytes are not a beacon scan, or a row cannot be true.

    """
    scan = decode_scan(data)
    if scan.fault:
        raise MessageError(scan.fault)
    return scan.observation, scan.frame_id


def decode_scan(data: bytes) -> Scan:
    """
    Return what one vehicle heard, of which the rows of some senders may not be true.

    Fields are read by name and offset, in any order and with any padding; beyond x, y, z and id
    they are optional. An absent or NaN covariance is zero, as of a surveyed anchor.

    What cannot be true is a position that is not finite or beyond 100 km, a negative or infinite
    measurement, an unknown kind or number of hops, or a covariance that is none. Anybody in reach
    of a radio can say so, and must not keep a vehicle from hearing the others.

    Raises
    ------
    MessageError
        If the bytes are not a beacon scan, or no row of it can be true.

    """
    stamp, frame_id, cloud = read_cloud(data, _read_layout)
    rows = unify(cloud)
    faulty, fault = find_faults(rows)
    untrue = rows['id'][faulty] if fault else rows['id'][:0]
    if fault:
        if faulty.all():
            raise MessageError(fault)
        rows = muted(rows, faulty)
    return Scan(_observation(stamp, rows), frame_id, untrue, fault)


def _observation(stamp: float, rows: Array) -> Observation:
    scan = rows[np.newaxis]
    return Observation(
        stamp=stamp,
        sender=scan['id'].astype(np.int64),
        kind=scan['kind'],
        hops=scan['hops'],
        position=scan['position'],
        covariance=full_covariance(scan['covariance']),
        max_range=scan['max_range'],
        range=scan['range'],
        range_std=scan['range_std'],
        rssi=scan['rssi'],
    )


def encode_beacons(observation: Observation, frame_id: str) -> list[bytes]:
    """Return one beacon scan a vehicle; a missing third dimension becomes zero."""
    vehicles, references, dimension = observation.position.shape
    rows = np.zeros((vehicles, references), BEACON)
    rows.view(ROW)['position'][..., :dimension] = observation.position
    rows['id'] = observation.sender
    for name in ('kind', 'hops', 'max_range', 'range', 'range_std', 'rssi'):
        rows[name] = getattr(observation, name)
    for row, column, name in UPPER_TRIANGLE:
        if column < dimension:
            rows[name] = observation.covariance[..., row, column]
    # Picked as words: numpy may copy a structured row field by field, and padding stays chance.
    return [
        _encode_scan(observation.stamp, frame_id, scan[heard])
        for scan, heard in zip(as_words(rows), observation.heard, strict=True)
    ]


def _encode_scan(stamp: float, frame_id: str, words: Array) -> bytes:
    dense = not np.isnan(words[:, list(WORD.values())]).any()
    return encode_cloud(stamp, frame_id, _LAYOUT, words, dense)


@dataclass(frozen=True, eq=False)
class _KnownLayout:
    """The bytes of a cloud from its fields to point_step, and the rows that they describe."""

    size: int
    mask: int
    masked: int
    rows: np.dtype[np.void]


_known_layouts: list[_KnownLayout] = []


def _read_layout(reader: cdr.Reader) -> np.dtype[np.void]:
    """
    Return the dtype of a scan's rows: ROW for our own, else those of its fields that are there.

    A publisher sends the same layout with every message, at any position as all in it is aligned
    to four bytes: it is parsed once. Bytes of padding are masked, as Fast DDS leaves them unset.
    """
    start = reader.position
    for known in _known_layouts:
        block = reader.data[start:start + known.size]
        if int.from_bytes(block, 'little') & known.mask == known.masked:
            reader.skip(known.size)
            return known.rows
    rows = parse_layout(reader, _ALLOWED, _REQUIRED)
    rows = ROW if rows == BEACON else rows
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
