"""
Stamps and headers of messages.

Stamps are float seconds. They survive a round trip to the nanosecond below 2^22 s (48 days), as
simulated and relative times are; at today's epoch a double resolves 0.24 us.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from tsmcl_ros import cdr
from tsmcl_ros.types import Array, MessageError

_SECOND = 1_000_000_000
_MAX_STAMP = 2**31


def split(stamp: float) -> tuple[int, int]:
    """Return the seconds and nanoseconds of a stamp."""
    if not 0 <= stamp < _MAX_STAMP:
        raise MessageError(
            f'stamp {stamp!r} is not allowed, must be at least 0 and below {_MAX_STAMP} s'
        )
    whole, part = divmod(stamp, 1)
    return divmod(int(whole) * _SECOND + round(part * _SECOND), _SECOND)


def join(seconds: int, nanoseconds: int) -> float:
    """Return the double nearest to a stamp."""
    if seconds < 0 or nanoseconds >= _SECOND:
        raise MessageError(
            f'stamp of {seconds} s and {nanoseconds} ns is not allowed, must be at least 0 s and '
            f'from 0 to {_SECOND - 1} ns'
        )
    return (seconds * _SECOND + nanoseconds) / _SECOND


@contextmanager
def naming(number: int) -> Iterator[None]:
    """Say which of many messages an error is about."""
    try:
        yield
    except MessageError as error:
        raise MessageError(f'message {number}: {error}') from None


def join_in_order(seconds: Array, nanoseconds: Array) -> Array:
    """Return what `join` does, bit for bit, of arrays (T,); refuse stamps that go back."""
    total = seconds * _SECOND + nanoseconds
    # Above 2^53 ns the total is no double any more; there the sum is the nearest one.
    stamp = np.where(total < 2**53, total / _SECOND, seconds + nanoseconds / _SECOND)
    impossible = (seconds < 0) | (nanoseconds >= _SECOND)
    wrong = impossible | (np.diff(stamp, prepend=-np.inf) < 0)
    if wrong.any():
        at = int(np.argmax(wrong))
        with naming(at):
            join(int(seconds[at]), int(nanoseconds[at]))
            raise MessageError(
                f'stamp {stamp[at]:.9f} s goes back, must be at least that of the one before, '
                f'{stamp[at - 1]:.9f} s'
            )
    return stamp


def read_header(reader: cdr.Reader) -> tuple[float, str]:
    stamp = join(*reader.values('iI'))
    return stamp, reader.string()


def write_header(writer: cdr.Writer, stamp: float, frame_id: str) -> None:
    writer.values('iI', *split(stamp))
    writer.string(frame_id)
