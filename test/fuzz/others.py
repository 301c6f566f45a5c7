"""Ranges, clocks, diagnostics, and CDR itself."""

from __future__ import annotations

from random import Random

from harness import number, Target, text
from tsmcl_ros import cdr, messages
from tsmcl_ros.evaluation.condition import read_conditions
from tsmcl_ros.messages import Diagnosis


def _range(rng: Random) -> bytes:
    writer = cdr.Writer()
    writer.values('iI', rng.randrange(2**31), rng.randrange(10**9))
    writer.string(text(rng, f'anchor_{rng.randrange(9)}'))
    writer.values('B', rng.randrange(3))
    writer.values('5f', *(max(min(number(rng, -1, 50), 3e38), -3e38) for _ in range(5)))
    return writer.finish()


def _diagnosed(data: bytes) -> None:
    """Evaluate what a vehicle said of itself."""
    messages.decode_diagnostics(data)
    read_conditions([data], 0.0, 1e9)


def _diagnostics(rng: Random) -> bytes:
    return messages.encode_diagnostics(rng.uniform(0, 100), [
        Diagnosis(rng.randrange(4), text(rng), text(rng), text(rng),
                  {rng.choice(_KEYS): text(rng, rng.choice(('7', '3, 12')))
                   for _ in range(rng.randrange(4))})
        for _ in range(rng.randrange(4))])


_KEYS = ('suspects', 'particles', 'effective particles', 'x')
_FORMS = ('B', 'I', 'd', 'iI', '3f', '7d', '?', 'Q')


def _read(data: bytes) -> None:
    """Read a message as its first bytes say, which are no part of it."""
    reader = cdr.Reader(data[8:])
    for way in data[:8]:
        if way < 160:
            reader.values(_FORMS[way % len(_FORMS)])
        elif way < 220:
            reader.string()
        else:
            reader.align(1 << way % 4)
    reader.finish()


def _plain(rng: Random) -> bytes:
    writer = cdr.Writer()
    for _ in range(rng.randrange(6)):
        writer.string(text(rng))
        writer.values('d', number(rng))
    return rng.randbytes(8) + writer.finish()


TARGETS = (
    Target('range', messages.decode_range, _range, share=6),
    Target('clock', messages.decode_clock,
           lambda rng: messages.encode_clock(rng.uniform(0, 1e9)), share=4),
    Target('period', messages.decode_period,
           lambda rng: messages.encode_period(rng.randrange(2**32)), share=3),
    Target('diagnostics', _diagnosed, _diagnostics, share=5),
    Target('cdr', _read, _plain, share=6),
)
