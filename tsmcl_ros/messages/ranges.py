"""Measured distances, as common UWB drivers publish them."""

from __future__ import annotations

from dataclasses import dataclass
import math

from tsmcl_ros import cdr
from tsmcl_ros.messages.clouds import MAX_RANGE
from tsmcl_ros.messages.stamps import read_header, write_header
from tsmcl_ros.types import MessageError

RANGE = 'sensor_msgs/msg/Range'


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


def decode_range(data: bytes) -> RangeReading:
    """
    Return one measured distance.

    The variance is absent before ROS 2 Jazzy. A reading of NaN or infinity, or outside the
    radio's limits, is no measurement (REP 117, and the message's own definition).

    Raises
    ------
    MessageError
        If the bytes are not such a reading, or the distance is negative or beyond 1000 km.

    """
    reader = cdr.Reader(data)
    stamp, frame_id = read_header(reader)
    reader.skip(1)
    _, low, high, measured = reader.values('4f')
    variance = reader.values('f')[0] if len(data) - reader.position >= 4 else 0.0
    reader.finish()
    if -math.inf < measured < 0:
        raise MessageError(f'range {measured:g} is not allowed, must be at least 0')
    if MAX_RANGE < measured < math.inf:
        raise MessageError(f'range {measured:g} is not allowed, must be at most {MAX_RANGE:g}')
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
    write_header(writer, reading.stamp, reading.frame_id)
    writer.values('B', 0)
    high, variance = (0.0 if math.isnan(x) else x for x in (reading.max_range, reading.variance))
    writer.values('5f', 0.0, reading.min_range, high, reading.range, variance)
    return writer.finish()
