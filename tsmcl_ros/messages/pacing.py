"""What paces: the clock, and how often a vehicle wants beacons."""

from __future__ import annotations

from tsmcl_ros import cdr
from tsmcl_ros.messages.stamps import join, split
from tsmcl_ros.types import MAX_PERIOD_FACTOR, MessageError

CLOCK = 'rosgraph_msgs/msg/Clock'
UINT32 = 'std_msgs/msg/UInt32'


def encode_clock(stamp: float) -> bytes:
    """Return a clock message."""
    writer = cdr.Writer()
    writer.values('iI', *split(stamp))
    return writer.finish()


def decode_clock(data: bytes) -> float:
    """Return the time that a clock message shows [s]; raise MessageError if it shows none."""
    reader = cdr.Reader(data)
    stamp = join(*reader.values('iI'))
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
