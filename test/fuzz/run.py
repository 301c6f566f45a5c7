"""
Try what the package reads with hostile inputs, and print what came of it.

    python test/fuzz/run.py [TARGET ...] [--inputs N] [--seed S] [--out DIR] [--atheris]

Inputs that crash a target are saved in DIR, to be tried again by `--again FILE`. With --atheris,
which has to be installed, libFuzzer chooses the inputs by the branches that they reach.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import subprocess
import sys
import time

from campaign import run, table, TARGETS
from harness import Outcome, try_one
from tsmcl_ros.scripts.cli import align


def main() -> int:
    """Fuzz from the command line; the exit code is 1 if anything crashed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('targets', nargs='*', metavar='TARGET',
                        help=f'one of {", ".join(TARGETS)} (default: all)')
    parser.add_argument('--inputs', type=int, default=100_000, help='altogether (100000)')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--out', type=Path, help='folder for inputs that crash a target')
    parser.add_argument('--again', type=Path, help='an input for the one target that is named')
    parser.add_argument('--messages', action='store_true', help='list how errors read')
    parser.add_argument('--atheris', action='store_true', help='let libFuzzer choose the inputs')
    options = parser.parse_args()
    for name in options.targets:
        if name not in TARGETS:
            parser.error(f'{name} is not allowed, must be one of {", ".join(TARGETS)}')
    names = options.targets or list(TARGETS)
    if options.again:
        outcome = Outcome()
        try_one(TARGETS[names[0]], options.again.read_bytes(), outcome)
        outcomes = {names[0]: outcome}
    elif options.atheris:
        return by_coverage(names, options.inputs, options.seed, options.out or Path())
    else:
        outcomes = run(names, options.inputs, options.seed)
    print(align(table(outcomes)))
    for name, outcome in outcomes.items():
        for number, (what, data) in enumerate(outcome.crashes):
            if number < 5:
                print(f'\n{name}: {what}\n{data[:300]!r}')
            if options.out:
                options.out.mkdir(parents=True, exist_ok=True)
                (options.out / f'{name}_{number}').write_bytes(data)
        if options.messages:
            print(f'\n{name}')
            for message, count in outcome.messages.most_common():
                print(f'{count:8} {message}')
    return int(any(outcome.crashes for outcome in outcomes.values()))


def by_coverage(names: Sequence[str], inputs: int, seed: int, out: Path) -> int:
    """Have libFuzzer run each target so often; it stops at the first crash, and says so."""
    code = 0
    for name in names:
        begin = time.monotonic()
        found = subprocess.run(
            [sys.executable, Path(__file__).parent / 'coverage_guided.py', name, str(inputs),
             str(seed), str(out)], stderr=subprocess.PIPE, encoding='utf-8', errors='replace')
        last = [line for line in found.stderr.splitlines() if ' cov: ' in line][-1:]
        print(f'{name}: {"fine" if found.returncode == 0 else found.stderr[-3000:]}, '
              f'{time.monotonic() - begin:.0f} s {"".join(last)}', flush=True)
        code |= found.returncode
    return int(code != 0)


if __name__ == '__main__':
    sys.exit(main())
