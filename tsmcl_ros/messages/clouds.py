"""PointCloud2 messages: rows of named fields in any order and with any padding."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from tsmcl_ros import cdr
from tsmcl_ros.messages.stamps import read_header, write_header
from tsmcl_ros.types import Array, MessageError

POINT_CLOUD = 'sensor_msgs/msg/PointCloud2'

MAX_COORDINATE = 1e5
"""Largest coordinate of a beacon [m]: beyond it FLOAT32 resolves no better than a centimetre."""

MAX_RANGE = 1e6
"""Largest range, and reach of a radio [m]: squares of much larger ones are no FLOAT32."""

MAX_ROWS = 2**16
"""Most rows of a cloud: no radio hears more, and no map of anchors is larger."""

FAR = f'within {MAX_COORDINATE / 1000:g} km of the origin: use a local origin'
"""What a coordinate must be."""

# Values of sensor_msgs/PointField.
_DATATYPES = ('INT8', 'UINT8', 'INT16', 'UINT16', 'INT32', 'UINT32', 'FLOAT32', 'FLOAT64')
_UINT8, _UINT32, _FLOAT32, _FLOAT64 = 2, 6, 7, 8
_FORMATS = {_UINT8: 'u1', _UINT32: '<u4', _FLOAT32: '<f4', _FLOAT64: '<f8'}
_MAX_POINT_STEP = 2**16
_MAX_FIELDS = 256

# Datatypes that a field may have; the first is ours.
BYTE, NUMBER, FLOAT, COORDINATE = (_UINT8,), (_UINT32,), (_FLOAT32,), (_FLOAT32, _FLOAT64)


def read_cloud(
    data: bytes, read_layout: Callable[[cdr.Reader], np.dtype[np.void]],
) -> tuple[float, str, Array]:
    """Return stamp, frame and rows (K,) of a cloud."""
    reader = cdr.Reader(data)
    stamp, frame_id = read_header(reader)
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
    if count > MAX_ROWS:
        raise MessageError(f'has {count} rows, must have at most {MAX_ROWS}')
    return stamp, frame_id, np.frombuffer(data, layout, count, start)


def encode_cloud(stamp: float, frame_id: str, layout: bytes, rows: Array, dense: bool) -> bytes:
    """Return a cloud of rows (K, ...) as they lie in memory."""
    writer = cdr.Writer()
    write_header(writer, stamp, frame_id)
    writer.values('II', 1, len(rows))
    writer.raw(layout)
    data = rows.tobytes()
    writer.values('II', len(data), len(data))
    writer.raw(data)
    writer.values('?', dense)
    return writer.finish()


def encode_layout(rows: np.dtype[np.void], allowed: Mapping[str, tuple[int, ...]]) -> bytes:
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


def parse_layout(
    reader: cdr.Reader, allowed: Mapping[str, tuple[int, ...]], required: Sequence[str],
) -> np.dtype[np.void]:
    """
    Return the dtype of a cloud's rows, from what it says of those fields that are allowed.

    Raises
    ------
    MessageError
        If a required field is missing, or one comes twice, has another datatype than those
        allowed or lies outside of its row, or the rows are big-endian.

    """
    count, = reader.values('I')
    if count > _MAX_FIELDS:
        raise MessageError(f'has {count} fields, must have at most {_MAX_FIELDS}')
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
    return np.dtype({
        'names': list(found),
        'formats': [_FORMATS[datatype] for _, datatype in found.values()],
        'offsets': [offset for offset, _ in found.values()],
        'itemsize': step,
    })


def _datatype(value: int) -> str:
    return _DATATYPES[value - 1] if 1 <= value <= len(_DATATYPES) else str(value)
