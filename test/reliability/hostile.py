"""
Hostile bytes: a million inputs for everything that reads what others wrote.

It takes about ten minutes of one quiet core. From the command line, for another number:

    python test/reliability/hostile.py [INPUTS]
"""

from __future__ import annotations

from pathlib import Path
import sys
import time

sys.path += [str(Path(__file__).parents[1] / name) for name in ('benchmark', 'fuzz')]
from campaign import run, table, TARGETS  # noqa: E402, I100
from goals import Goal, Section  # noqa: E402, I100
from harness import MEMORY, SLOW  # noqa: E402, I100

INPUTS, SEED = 1_000_000, 2026


def measure(inputs: int = INPUTS) -> Section:
    """Fuzz all targets, each in a process of its own."""
    begin = time.monotonic()
    outcomes = run(list(TARGETS), inputs, SEED)
    spent = (time.monotonic() - begin) / 60
    found = outcomes.values()
    return Section(
        'Hostile bytes',
        f'`python test/fuzz/run.py --inputs {inputs} --seed {SEED}`, {spent:.0f} minutes: '
        'messages, logs, traces, parameters and bags that are nearly right, and a localizer that '
        'takes such messages. An input is accepted, or rejected by one line that says why; '
        'anything else is a crash: another exception, a warning of numpy, an error of several '
        'lines, of characters that cannot be printed or without words, or more than '
        f'{SLOW:g} s of the processor. Memory is what the process grew by; "messages" counts how '
        'differently rejections read. What grows in unpacking, computes in reading, or names a '
        'place outside of its bag has tests of its own (test/test_bag_checks.py, test/traces).',
        tables=[table(outcomes)],
        goals=[
            Goal('hostile inputs', sum(outcome.inputs for outcome in found), INPUTS, 'at least'),
            Goal('hostile inputs that crash something or are refused unclearly',
                 sum(len(outcome.crashes) for outcome in found), 0),
            Goal('the slowest hostile input', max(outcome.slowest for outcome in found), SLOW,
                 unit='s'),
            Goal('memory that hostile inputs take', max(outcome.memory for outcome in found),
                 MEMORY, unit='MB'),
        ])


if __name__ == '__main__':
    print(measure(*map(int, sys.argv[1:])).plain())
