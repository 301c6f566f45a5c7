"""
Have libFuzzer choose a target's inputs by the branches that they reach; see `run.py --atheris`.

    python test/fuzz/coverage_guided.py TARGET INPUTS SEED DIR

Wants atheris, which has wheels for Python 3.11 and 3.12: pip install atheris
"""

from __future__ import annotations

from pathlib import Path
from random import Random
import sys
import tempfile
import warnings

import atheris
import numpy as np

with atheris.instrument_imports(include=['tsmcl_ros']):
    from campaign import TARGETS

from harness import mutate, Outcome, try_one  # noqa: E402, I100

SEEDS = 200
LARGEST = 20_000  # bytes


def main() -> None:
    """Fuzz until a crash, which ends the process, or all inputs are tried."""
    name, inputs, seed, out = sys.argv[1:]
    target, rng = TARGETS[name], Random(int(seed))
    warnings.simplefilter('error')

    def try_input(data: bytes) -> None:
        outcome = Outcome()
        try_one(target, data, outcome)
        if outcome.crashes:
            raise RuntimeError(outcome.crashes[0][0])

    def change(data: bytes, largest: int, number: int) -> bytes:
        # What libFuzzer changes by itself knows no forms; what we change knows no branches.
        if number % 2:
            return bytes(atheris.Mutate(data, largest))
        return mutate(Random(number), data, target.tokens)[:largest]

    with tempfile.TemporaryDirectory() as corpus:
        with np.errstate(all='ignore'):
            for number in range(SEEDS):
                Path(corpus, f'{number}').write_bytes(target.make(rng)[:LARGEST])
        atheris.Setup(
            [sys.argv[0], f'-runs={inputs}', f'-seed={int(seed) + 1}', f'-max_len={LARGEST}',
             f'-artifact_prefix={out}/{name}_', corpus],
            try_input, custom_mutator=change)
        atheris.Fuzz()


if __name__ == '__main__':
    main()
