"""
What fuzzing is made of: inputs that are nearly right, and what must hold of every one of them.

An input is either taken or refused by one of the package's own errors, whose text is one short
line; it costs less than a second, and little memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
import re
import resource
import signal
import struct
import tempfile
import time
import traceback
import warnings

import numpy as np
from tsmcl_ros.types import TsmclError

SLOW = 1.0  # s of the processor
MEMORY = 100.0  # MB
LONGEST = 2500  # characters of an error
WARM_UP = 30  # inputs, in which libraries load what they need

# Numbers at which arithmetic breaks: the ends of types, and what floats have beside numbers.
WORDS = tuple(
    struct.pack(form, value)
    for form, values in (
        ('<B', (0, 1, 2, 127, 128, 255)),
        ('<I', (0, 1, 2, 7, 16, 999_999_999, 10**9, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1)),
        ('<Q', (0, 1, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1)),
        ('<f', (-0.0, 1.0, -1.0, 1e-45, 3e38, -3e38, float('nan'), float('inf'), -float('inf'))),
        ('<d', (-0.0, 1.0, -1.0, 5e-324, 1e-160, 1e154, 1.7e308, -1.7e308, 1e6, float('nan'),
                float('inf'), -float('inf'))),
    )
    for value in values)

# What texts may hold that somebody downstream stumbles over.
TEXTS = (
    '', 'map', '\0', '\n', '\r\n[ERROR] forged', '\x1b[2J', '\u202e', '%s%n', '{0}', "'", '"',
    '../../etc/passwd', '/etc/passwd', '<script>alert(1)</script>', '$x^{$', 'x' * 5000,
    '9' * 5000, '0x' + 'f' * 5000, '-0', '1e400', 'nan', '-inf', '1_000', '\u0663', '\ufeff',
    '&a;', ']]>',
)


class Slow(BaseException):
    """An input takes longer than it may; no `except Exception` swallows it."""


@dataclass(frozen=True)
class Target:
    """
    What is fuzzed.

    Parameters
    ----------
    name : str
    run : callable
        Does with an input what the package does with what comes from outside.
    make : callable
        Returns an input that is right, or wrong in what it says rather than in its form.
    tokens : sequence of bytes
        What such inputs are written with, to be strewn in.
    share : float
        Of all inputs, relative to the other targets.

    """

    name: str
    run: Callable[[bytes], object]
    make: Callable[[Random], bytes]
    tokens: Sequence[bytes] = ()
    share: float = 1.0


@dataclass
class Outcome:
    """What came of a target's inputs."""

    inputs: int = 0
    accepted: int = 0
    rejected: int = 0
    slowest: float = 0.0
    memory: float = 0.0
    messages: Counter[str] = field(default_factory=Counter)
    crashes: list[tuple[str, bytes]] = field(default_factory=list)

    def row(self, name: str) -> list[str]:
        """Return what a table says of it."""
        return [name, f'{self.inputs}', f'{self.accepted}', f'{self.rejected}',
                f'{len(self.messages)}', f'{len(self.crashes)}', f'{self.slowest * 1e3:.1f}',
                f'{self.memory:.1f}']


HEADINGS = ['target', 'inputs', 'accepted', 'rejected', 'messages', 'crashes', 'slowest [ms]',
            'memory [MB]']


def fuzz(target: Target, inputs: int, seed: int) -> Outcome:
    """Try a target; the process should be fresh, as its memory is measured."""
    rng, outcome = Random(f'{target.name} {seed}'), Outcome()
    warnings.simplefilter('error')
    previous = signal.signal(signal.SIGPROF, _interrupt)
    before = 0.0
    for number in range(inputs):
        if number == min(WARM_UP, inputs - 1):
            before = _peak()
        with np.errstate(all='ignore'):
            data = target.make(rng)
        if rng.random() < 0.7:
            data = mutate(rng, data, target.tokens)
        try_one(target, data, outcome)
    signal.signal(signal.SIGPROF, previous)
    outcome.memory = _peak() - before
    return outcome


def try_one(target: Target, data: bytes, outcome: Outcome) -> None:
    """Hand one input to a target, and note what came of it."""
    outcome.inputs += 1
    begin = time.process_time()
    wrong = ''
    signal.setitimer(signal.ITIMER_PROF, 3 * SLOW)
    try:
        target.run(data)
        outcome.accepted += 1
    except TsmclError as error:
        outcome.rejected += 1
        wrong = unclear(str(error))
        outcome.messages[skeleton(str(error))] += 1
    except (Exception, Slow):
        wrong = traceback.format_exc(limit=-6)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    spent = time.process_time() - begin
    outcome.slowest = max(outcome.slowest, spent)
    if not wrong and spent > SLOW:
        wrong = f'took {spent:.1f} s'
    if wrong:
        outcome.crashes.append((wrong, data))


def unclear(text: str) -> str:
    """Return what is wrong with an error's text, '' if nothing is."""
    if len(text) > LONGEST:
        return f'an error of {len(text)} characters: {text[:200]!r}'
    if not text.isprintable():
        return f'an error with characters that are not printable: {text[:500]!r}'
    if len(re.findall(r'[a-zA-Z]{2,}', text)) < 3:
        return f'an error that does not say what is wrong: {text!r}'
    return ''


def skeleton(text: str) -> str:
    """Return an error's text without what it quotes."""
    text = re.sub(r"""(["']).*\1""", "''", text)
    text = re.sub(r'(?<!\w)[-+]?(\d[\d.e+-]*|nan|inf)\b', '0', text)
    return re.sub(r'/\S*?(?=[:, ])', '/', text)[:120]


def mutate(rng: Random, data: bytes, tokens: Sequence[bytes] = ()) -> bytes:
    """Return some bytes with a few things wrong."""
    changed = bytearray(data)
    for _ in range(1 + min(int(rng.expovariate(0.7)), 8)):
        _CHANGES[rng.randrange(len(_CHANGES))](rng, changed, tokens)
    return bytes(changed)


def _flip(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _overwrite(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    """Put a number where one of its size may be: at a multiple of it."""
    word = rng.choice(WORDS)
    at = rng.randrange(len(data) // len(word) + 1) * len(word)
    # CDR aligns to four bytes what follows its header of four.
    at += 4 if len(word) == 8 and rng.random() < 0.5 else 0
    if at + len(word) <= len(data):
        data[at:at + len(word)] = word


def _cut(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    del data[rng.randrange(len(data) + 1):]


def _remove(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    at = rng.randrange(len(data) + 1)
    del data[at:at + rng.randrange(1, 65)]


def _repeat(rng: Random, data: bytearray, _: Sequence[bytes]) -> None:
    at = rng.randrange(len(data) + 1)
    data[at:at] = bytes(data[at:at + rng.randrange(1, 129)]) * rng.randrange(1, 9)


def _insert(rng: Random, data: bytearray, tokens: Sequence[bytes]) -> None:
    at = rng.randrange(len(data) + 1)
    kind = rng.randrange(4)
    if kind == 0:
        text = rng.randbytes(rng.randrange(1, 17))
    elif kind == 1:
        text = rng.choice(TEXTS).encode()
    else:
        text = rng.choice(tokens or WORDS)
    data[at:at + (len(text) if rng.random() < 0.5 else 0)] = text


_CHANGES = (_flip, _overwrite, _overwrite, _cut, _remove, _repeat, _insert, _insert)


def text(rng: Random, usual: str = 'map') -> str:
    """Return a text that is mostly the usual one."""
    return rng.choice(TEXTS) if rng.random() < 0.1 else usual


def number(rng: Random, low: float = -1e3, high: float = 1e3) -> float:
    """Return a number that is mostly a plain one."""
    if rng.random() < 0.05:
        return rng.choice((0.0, -0.0, 1e-300, 1e5, -1e5, 1e12, 1e300, -1e300, 3e38,
                           float('nan'), float('inf'), -float('inf')))
    return rng.uniform(low, high)


def joined(parts: Sequence[bytes]) -> bytes:
    """Return several inputs as one, each after its length."""
    return b''.join(struct.pack('<I', len(part)) + part for part in parts)


def split(data: bytes) -> list[bytes]:
    """Return the inputs that one is made of; it may claim any lengths."""
    parts = []
    while data:
        end = 4 + int.from_bytes(data[:4], 'little')
        parts.append(data[4:end])
        data = data[end:]
    return parts


class Scratch:
    """A folder for inputs that have to be files; it goes with the process that made it."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def __truediv__(self, name: str) -> Path:
        if self._folder is None:
            self._folder = tempfile.TemporaryDirectory(prefix='tsmcl_ros_fuzz_')
        return Path(self._folder.name, name)


def _interrupt(*_: object) -> None:
    raise Slow(f'takes longer than {3 * SLOW:g} s')


def _peak() -> float:
    """Return the most memory that this process has had so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
