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
    FAR,
    FLOAT,
    MAX_COORDINATE,
    MAX_RANGE,
    NUMBER,
    parse_layout,
    read_cloud,
)
from tsmcl_ros.messages.covariances import is_covariance
from tsmcl_ros.types import Array, MessageError, Observation

BEACON = np.dtype(
    [(name, '<f4') for name in ('x', 'y', 'z')]
    + [('id', '<u4'), ('kind', 'u1'), ('hops', 'u1')]
    + [(name, '<f4') for name in ('max_range', 'range', 'range_std', 'rssi')]
    + [(f'cov_{axes}', '<f4') for axes in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')],
    align=True,
)
"""One beacon as a row of a PointCloud2; two bytes of padding keep the floats aligned."""

_MEASURED = ('max_range', 'range', 'range_std', 'rssi')
_UPPER_TRIANGLE = (
    (0, 0, 'cov_xx'), (0, 1, 'cov_xy'), (0, 2, 'cov_xz'),
    (1, 1, 'cov_yy'), (1, 2, 'cov_yz'), (2, 2, 'cov_zz'),
)
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_OFFSETS = {name: field[1] for name, field in (BEACON.fields or {}).items()}

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
    'max_range': (_TINY, MAX_RANGE),
    **dict.fromkeys(('range', 'range_std'), (0.0, MAX_RANGE)),
    **dict.fromkeys(('cov_xx', 'cov_yy', 'cov_zz'), (0.0, MAX_RANGE**2)),
    **dict.fromkeys(('rssi', 'cov_xy', 'cov_xz', 'cov_yz'), (-_MAX, _MAX)),
}
_MEANINGS = {
    -MAX_COORDINATE: FAR,
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

_ALLOWED = {
    **dict.fromkeys(_OFFSETS, FLOAT), **dict.fromkeys(('x', 'y', 'z'), COORDINATE),
    'id': NUMBER, 'kind': BYTE, 'hops': BYTE,
}
_REQUIRED = ('x', 'y', 'z', 'id')
_LAYOUT = encode_layout(BEACON, _ALLOWED)
_MAX_LAYOUTS = 16


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
        hops, or a covariance that is none.

    """
    stamp, frame_id, cloud = read_cloud(data, _read_layout)
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
        value, (least, most) = words[row, word], _BOUNDS[name]
        large = most < value < np.inf and least != -most
        raise MessageError(
            f'{name} {value:g} of id {rows["id"][row]} is not allowed, must be '
            f'{f"at most {most:g}" if large else _MEANINGS[least]}'
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


def _words(rows: Array) -> Array:
    """Return rows (...) as floats (..., 15), among them the words that are none."""
    return rows.view('<f4').reshape(*rows.shape, _WORDS)


def _encode_scan(stamp: float, frame_id: str, words: Array) -> bytes:
    dense = not np.isnan(words[:, list(_WORD.values())]).any()
    return encode_cloud(stamp, frame_id, _LAYOUT, words, dense)


def _full_covariance(terms: Array) -> Array:
    """Return (..., 3, 3) covariances of (..., 6) upper triangles; unknown terms are zero."""
    if not np.count_nonzero(terms):
        return np.zeros((*terms.shape[:-1], 3, 3), np.float32)
    full = np.where(np.isnan(terms), np.float32(0), terms)[..., _FULL]
    if not is_covariance(full.astype(np.float64)):
        raise MessageError('cov_xx to cov_zz are not allowed, must be positive semidefinite')
    return full


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
    Return the dtype of a scan's rows: _ROW for our own, else those of its fields that are there.

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
    rows = _ROW if rows == BEACON else rows
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
