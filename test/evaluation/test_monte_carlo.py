"""Parallel runs, their seeds, and bootstrap intervals."""

from contextlib import suppress
import os
from pathlib import Path
import signal
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import norm
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    run_experiment,
    significant,
)
from tsmcl_ros.evaluation.pools import Processes
from tsmcl_ros.types import TsmclError

sys.path.append(str(Path(__file__).parent))
from draws import Dies, Draws  # noqa: E402, I100


def values(results):
    return [result.outcome.rows['value'].tolist() for result in results]


def test_results_do_not_depend_on_the_number_of_processes():
    alone, together = (run_experiment(Draws(), 7, 3, Processes(workers)) for workers in (1, 2))

    assert values(alone) == values(together)
    assert [(result.case, result.run) for result in alone] == [
        (result.case, result.run) for result in together]


def test_results_come_in_order_of_cases_and_runs():
    results = run_experiment(Draws(), 0, 2)

    assert [(result.case['name'], result.run) for result in results] == [
        ('a', 0), ('a', 1), ('b', 0), ('b', 1)]


def test_runs_of_one_number_share_their_seed_over_cases():
    first, _, second, _ = values(run_experiment(Draws(), 0, 2))

    assert (2 * np.array(first)).tolist() == second


def test_seeds_and_runs_differ():
    numbers = [tuple(value) for seed in (0, 1)
               for value in values(run_experiment(Draws(), seed, 2))]

    assert len(set(numbers)) == len(numbers)


def test_more_runs_leave_the_first_ones_as_they_are():
    few, many = (run_experiment(Draws(), 5, runs) for runs in (1, 3))

    assert values(few)[0] == values(many)[0]


def test_a_killed_process_is_one_clear_error():
    with pytest.raises(TsmclError, match='killed.* fewer workers'):
        run_experiment(Dies(), 0, 1, Processes(2))


def test_the_interval_of_a_mean_is_that_of_the_central_limit_theorem():
    samples = np.random.default_rng(1).exponential(size=2000)

    interval = bootstrap_interval(np.mean, samples, draws=2000)

    reach = norm.ppf(0.975) * samples.std() / np.sqrt(samples.size)
    assert interval.value == samples.mean()
    assert interval.value - interval.low == pytest.approx(reach, rel=0.1)
    assert interval.high - interval.value == pytest.approx(reach, rel=0.1)


def test_what_depends_on_each_other_does_not_narrow_an_interval():
    units = np.random.default_rng(2).standard_normal(50)

    once, often = (bootstrap_interval(np.mean, np.tile(units, (copies, 1))) for copies in (1, 9))

    assert once.low == pytest.approx(often.low)
    assert once.high == pytest.approx(often.high)


@pytest.mark.parametrize(('value', 'text'), [
    (0.0, '0'), (4.7321, '4.73'), (47.321, '47.3'), (473.21, '473'), (4732.1, '4732'),
    (0.047321, '0.0473'), (4.7e9, '4.7e+09'), (-4.7321, '-4.73'),
    (float('inf'), 'inf'), (float('nan'), 'nan'),
])
def test_numbers_are_shown_to_three_digits(value, text):
    assert significant(value) == text


def test_an_interrupt_ends_the_processes():
    code = ('import multiprocessing\n'
            'from draws import Endless\n'
            'from tsmcl_ros.evaluation.monte_carlo import run_experiment\n'
            'from tsmcl_ros.evaluation.pools import Processes\n'
            'try:\n'
            '    run_experiment(Endless(), 0, 2, Processes(2))\n'
            'except KeyboardInterrupt:\n'
            '    for process in multiprocessing.active_children():\n'
            '        process.join()\n'
            '    print("ended")\n')
    process = subprocess.Popen(
        [sys.executable, '-c', code], cwd=Path(__file__).parent, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    try:
        assert process.stdout.read(5) == 'begun'
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)

    assert output.endswith('ended\n')
    assert process.returncode == 0
    assert 'Traceback' not in errors
