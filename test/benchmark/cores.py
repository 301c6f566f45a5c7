"""An experiment by two processes beside the same by one."""

from __future__ import annotations

import os
from statistics import median
import subprocess
import sys
import time

from goals import Goal, Section
from tsmcl_ros.evaluation.experiments.ts_mcl_samples import TsMclSamples
from tsmcl_ros.evaluation.monte_carlo import run_experiment
from tsmcl_ros.evaluation.pools import Processes

SEED, ROUNDS = 0, 2
# Some 50 s of one core, in pieces of half a second; those of the paper take many minutes.
EXPERIMENT = TsMclSamples(runs=10, vehicles=40, epochs=60, settled=10, first_particles=500,
                          grid_cell=0.1, particles=(4, 8, 12, 20))
# What the machine itself gives to two processes that share nothing, such as a core's two threads.
ALONE = ('import numpy as np, time\n'
         'rng = np.random.default_rng(0)\n'
         'begin = time.monotonic()\n'
         'for _ in range(1500):\n'
         '    np.hypot(*rng.standard_normal((2, 50_000))).sum()\n'
         'print(time.monotonic() - begin)\n')


def measure() -> Section:
    """Return how much faster two processes are, by the clock on the wall."""
    # In turns, as processors are now faster and now slower.
    limits, rounds = [], []
    for _ in range(ROUNDS):
        alone, = _together(1)
        limits.append(2 * alone / max(_together(2)))
        rounds.append([_experiment(workers) for workers in (1, 2)])
    limit = median(limits)
    ratio = median(one / two for (one, _), (two, _) in rounds)
    rows = []
    for workers, times in zip((1, 2), zip(*rounds, strict=True), strict=True):
        wall, processor = (median(each) for each in zip(*times, strict=True))
        rows.append([str(workers), f'{wall:.1f}', f'{processor:.1f}',
                     f'{1 if workers == 1 else ratio:.2f}'])
    return Section(
        'Experiments: two processes beside one',
        f'{len(EXPERIMENT.cases()) * EXPERIMENT.runs} runs of `ts_mcl_samples`, begun with the '
        'longest, with all that starting processes takes. The limit is of two processes of numpy '
        'that share nothing. Medians of '
        f'{ROUNDS} rounds in turn, by the wall, so that whatever else the machine does counts.',
        [[['processes', 'time [s]', 'processor time of all [s]', 'times one'], *rows,
          ['two that share nothing', '', '', f'{limit:.2f}']]],
        [Goal('experiments, two processes over one', ratio, 1.8, 'at least',
              reason=f'two processes that share nothing reach {limit:.2f} here: the machine had '
                     'no two cores for us' if limit < 1.8 else
                     f'two processes that share nothing reach {limit:.2f}; the rest goes to '
                     'starting them, two seconds of imports, and to waiting for the last run')])


def _experiment(workers: int) -> tuple[float, float]:
    """Return the time of the wall, and the processor time of this process and its children [s]."""
    begin, worked = time.monotonic(), sum(os.times()[:4])
    run_experiment(EXPERIMENT, SEED, EXPERIMENT.runs, Processes(workers))
    return time.monotonic() - begin, sum(os.times()[:4]) - worked


def _together(processes: int) -> list[float]:
    """Return how long each of some processes works that run at once [s]."""
    running = [subprocess.Popen([sys.executable, '-c', ALONE], stdout=subprocess.PIPE, text=True)
               for _ in range(processes)]
    return [float(process.communicate()[0]) for process in running]
