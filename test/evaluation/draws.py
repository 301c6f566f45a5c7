"""Experiments to try the Monte Carlo with, in a module that spawned processes can import."""

from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import signal
import time

import numpy as np
from tsmcl_ros.evaluation.monte_carlo import Finding, Outcome, Report


@dataclass(frozen=True)
class Draws:
    """An experiment that draws numbers."""

    title = 'numbers'
    runs: int = 2
    rows: int = 3

    def cases(self):
        return [{'scale': 1.0, 'name': 'a'}, {'scale': 2.0, 'name': 'b'}]

    def work(self, case, seed):
        # Several generators, like any real experiment.
        rng = np.random.default_rng(seed.spawn(2)[1])
        return Outcome({'index': np.arange(self.rows),
                        'value': case['scale'] * rng.standard_normal(self.rows)}, 0.0)

    def judge(self, results):
        return Report([['name'], ['a']], 1, [Finding('claim', '1 m', '', 'reached')])

    def draw(self, results, path):
        path.write_bytes(b'figure')


class Dies(Draws):
    """An experiment whose processes are killed."""

    def work(self, case, seed):
        os.kill(os.getpid(), signal.SIGKILL)


class Endless(Draws):
    """An experiment that nobody can wait for."""

    def work(self, case, seed):
        os.write(1, b'begun')
        time.sleep(600)


@dataclass(frozen=True)
class Mortal(Draws):
    """An experiment whose seventh run kills its process, the first time that it is worked."""

    grave: str = ''

    def work(self, case, seed):
        if seed.spawn_key == (6,):
            with suppress(FileExistsError), Path(self.grave).open('x'):
                os.kill(os.getpid(), signal.SIGKILL)
        return super().work(case, seed)


def once(value):
    """Return a value, after a moment."""
    time.sleep(0.1)
    return value
