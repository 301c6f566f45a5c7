"""What a beacon's row holds, and what of it can be true."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.messages.clouds import FAR, MAX_COORDINATE, MAX_RANGE
from tsmcl_ros.messages.covariances import is_covariance
from tsmcl_ros.types import Array, UNTRUE

BEACON = np.dtype(
    [(name, '<f4') for name in ('x', 'y', 'z')]
    + [('id', '<u4'), ('kind', 'u1'), ('hops', 'u1')]
    + [(name, '<f4') for name in ('max_range', 'range', 'range_std', 'rssi')]
    + [(f'cov_{axes}', '<f4') for axes in ('xx', 'xy', 'xz', 'yy', 'yz', 'zz')],
    align=True,
)
"""One beacon as a row of a PointCloud2; two bytes of padding keep the floats aligned."""

_MEASURED = ('max_range', 'range', 'range_std', 'rssi')
UPPER_TRIANGLE = (
    (0, 0, 'cov_xx'), (0, 1, 'cov_xy'), (0, 2, 'cov_xz'),
    (1, 1, 'cov_yy'), (1, 2, 'cov_yz'), (2, 2, 'cov_zz'),
)
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
OFFSETS = {name: field[1] for name, field in (BEACON.fields or {}).items()}

# The same row, with position and covariance each in one piece.
ROW = np.dtype({
    'names': ['position', 'id', 'kind', 'hops', *_MEASURED, 'covariance'],
    'formats': ['(3,)<f4', '<u4', 'u1', 'u1', *['<f4'] * len(_MEASURED), '(6,)<f4'],
    'offsets': [OFFSETS[name] for name in ('x', 'id', 'kind', 'hops', *_MEASURED, 'cov_xx')],
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
WORD = {name: OFFSETS[name] // 4 for name in _BOUNDS}
_LOW, _HIGH = np.full(_WORDS, -np.inf, np.float32), np.full(_WORDS, np.inf, np.float32)
for _name, (_low, _high) in _BOUNDS.items():
    _LOW[WORD[_name]], _HIGH[WORD[_name]] = _low, _high


def unify(rows: Array) -> Array:
    """Return rows of any layout as rows of ROW: a view if they are so already."""
    if rows.dtype is ROW:
        return rows
    table = np.full(len(rows), _UNSAID)
    # A FLOAT64 beyond FLOAT32 becomes infinite, which is refused later; NaN may signal, too.
    with np.errstate(over='ignore', invalid='ignore'):
        for name in rows.dtype.names or ():
            table[name] = rows[name]
    return table.view(ROW)


def find_faults(rows: Array) -> tuple[Array, str]:
    """
    Return which rows (K,) bool cannot be true, and what is wrong with one of them, '' if none is.

    Of all but one nothing is said, as they may be many; `count_nonzero` is far quicker than `any`
    on few.
    """
    faulty, fault = np.zeros(len(rows), bool), ''
    words = as_words(rows)
    low, high = words < _LOW, words > _HIGH
    if np.count_nonzero(low) or np.count_nonzero(high):
        beyond = low | high
        faulty |= beyond.any(axis=1)
        row, word = np.argwhere(beyond)[0]
        fault = _out_of_bounds(rows['id'][row], int(word), words[row, word])
    missing = np.isnan(rows['position'])
    if np.count_nonzero(missing):
        faulty |= missing.any(axis=1)
        row, axis = np.argwhere(missing)[0]
        fault = fault or (
            f'{"xyz"[axis]} nan of id {rows["id"][row]} is not allowed, must be a number')
    for field, known, meaning in (
        ('kind', b'\0\1', '0 (anchor) or 1 (vehicle)'),
        ('hops', b'\1\2', '1 (heard directly) or 2 (relayed by a neighbour)'),
    ):
        unknown = rows[field].tobytes().translate(None, known)
        if unknown:
            faulty |= ~np.isin(rows[field], list(known))
            fault = fault or f'{field} {unknown[0]} is not allowed, must be {meaning}'
    if np.count_nonzero(rows['covariance']):
        none = ~is_covariance(full_covariance(rows['covariance']).astype(np.float64))
        if np.count_nonzero(none):
            faulty |= none
            fault = fault or (
                'cov_xx to cov_zz are not allowed, must be positive semidefinite, of id '
                f'{rows["id"][none][0]}')
    return faulty, fault


def _out_of_bounds(identity: int, word: int, value: float) -> str:
    """Say what is wrong with a word's value."""
    name = next(name for name in WORD if WORD[name] == word)
    least, most = _BOUNDS[name]
    large = most < value < np.inf and least != -most
    return (f'{name} {value:g} of id {identity} is not allowed, must be '
            f'{f"at most {most:g}" if large else _MEANINGS[least]}')


def muted(rows: Array, faulty: Array) -> Array:
    """Return rows (K', ), of which the faulty ones say nothing but who was heard."""
    mute = np.full(len(rows), _UNSAID).view(ROW)
    mute['id'], mute['kind'] = rows['id'], UNTRUE
    mute[~faulty] = rows[~faulty]
    return mute[~faulty | ~np.isin(rows['id'], rows['id'][~faulty])]


def as_words(rows: Array) -> Array:
    """Return rows (...) as floats (..., 15), among them the words that are none."""
    return rows.view('<f4').reshape(*rows.shape, _WORDS)


def full_covariance(terms: Array) -> Array:
    """Return (..., 3, 3) covariances of (..., 6) upper triangles; unknown terms are zero."""
    if not np.count_nonzero(terms):
        return np.zeros((*terms.shape[:-1], 3, 3), np.float32)
    return np.asarray(np.where(np.isnan(terms), np.float32(0), terms)[..., _FULL])
