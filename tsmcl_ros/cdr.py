"""
Reading and writing the bytes of a serialized ROS 2 message: little-endian CDR (XCDR1).

Four bytes of encapsulation header precede the body; within the body every value lies at a
multiple of its own size. See OMG's "DDS Interoperability Wire Protocol", section 10.
"""

from __future__ import annotations

from functools import cache
import struct
from typing import Any

from tsmcl_ros.types import MessageError

HEADER = b'\x00\x01\x00\x00'
_BIG_ENDIAN = b'\x00\x00'
_MAX_PADDING = 3


@cache
def _compiled(form: str) -> tuple[struct.Struct, int]:
    """Return the layout of some values, and the size that they are aligned to."""
    return struct.Struct('<' + form), struct.calcsize(form[-1])


class Reader:
    """
    Reads a serialized message from front to back; every method raises MessageError if it ends.

    Attributes
    ----------
    data : bytes
        The whole message, encapsulation header included.
    position : int
        Where in the data the next value is looked for, before alignment.
    padding : list of int
        Positions that alignment passed over; senders leave there whatever the memory held.

    """

    __slots__ = ('data', 'padding', 'position')

    def __init__(self, data: bytes) -> None:
        """Check the encapsulation header; raise MessageError if it is not little-endian CDR."""
        if data[:2] != HEADER[:2] or len(data) < len(HEADER):
            if data[:2] == _BIG_ENDIAN:
                raise MessageError('big-endian CDR is not supported, must be little-endian')
            raise MessageError(
                f'starts with the bytes {bytes(data[:4]).hex(" ")!r}, which is not little-endian '
                f'CDR: must be {HEADER.hex(" ")!r}'
            )
        self.data = data
        self.position = len(HEADER)
        self.padding: list[int] = []

    def align(self, size: int) -> int:
        """Move to the next multiple of a value's size, and return that position."""
        gap = -(self.position - len(HEADER)) % size
        if gap:
            self.padding.extend(range(self.position, self.position + gap))
            self.position += gap
        return self.position

    def skip(self, size: int) -> int:
        """Move past some bytes, and return the position of the first of them."""
        start = self.position
        if start + size > len(self.data):
            raise self._truncated(size)
        self.position = start + size
        return start

    def values(self, form: str) -> tuple[Any, ...]:
        """Return values of one common size, named by a `struct` format such as '7d' or 'iI'."""
        layout, size = _compiled(form)
        start = self.align(size)
        try:
            found = layout.unpack_from(self.data, start)
        except struct.error:
            raise self._truncated(layout.size) from None
        self.position = start + layout.size
        return found

    def string(self) -> str:
        """Return a text; its length on the wire counts the terminating zero."""
        size, = self.values('I')
        start = self.skip(size)
        try:
            return str(self.data[start:start + max(size - 1, 0)], 'utf-8')
        except UnicodeDecodeError as error:
            raise MessageError(f'text at byte {start} is not UTF-8: {error.reason}') from None

    def finish(self) -> None:
        """Hold that nothing but padding follows; raise MessageError otherwise."""
        left = len(self.data) - self.position
        if left > _MAX_PADDING:
            raise MessageError(
                f'{left} bytes follow the last field at byte {self.position}, '
                f'at most {_MAX_PADDING} of padding are allowed'
            )

    def _truncated(self, size: int) -> MessageError:
        return MessageError(
            f'truncated: {len(self.data)} bytes, must be at least {self.position + size}'
        )


class Writer:
    """Writes a message front to back."""

    __slots__ = ('_body',)

    def __init__(self) -> None:
        """Start a little-endian message."""
        self._body = bytearray()

    def align(self, size: int) -> None:
        """Pad to the next multiple of a value's size."""
        gap = -len(self._body) % size
        if gap:
            self._body += bytes(gap)

    def values(self, form: str, *values: Any) -> None:
        """Add values of one common size, named by a `struct` format such as '7d' or 'iI'."""
        layout, size = _compiled(form)
        self.align(size)
        self._body += layout.pack(*values)

    def string(self, text: str) -> None:
        """Add a text."""
        encoded = text.encode() + b'\0'
        self.values('I', len(encoded))
        self._body += encoded

    def raw(self, data: bytes) -> None:
        """Add bytes that are laid out already."""
        self._body += data

    def finish(self) -> bytes:
        """Return the whole message."""
        return HEADER + self._body
