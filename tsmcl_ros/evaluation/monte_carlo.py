"""
Experiments: cases x runs side by side, with the same results wherever they are worked on.

An experiment is a frozen dataclass of its sizes that lists cases, works one of them with one
seed, and judges what came of all. Runs of one number share their seed over all cases, so that
cases are compared on the same worlds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
import math
from pathlib import Path
import time
from typing import Any, NamedTuple, Protocol

import numpy as np
from tsmcl_ros.evaluation.pools import Pool, Processes
from tsmcl_ros.types import Array, Progress, unshown

# What tells a case from the others, JSON scalars by name; they become columns of the CSV file.
Case = Mapping[str, Any]
IN_THIS_PROCESS = Processes(1)


class Outcome(NamedTuple):
    """
    What one run of one case gave.

    Attributes
    ----------
    rows : mapping of name to (L,) array
        Columns of the CSV file, the same for any number of processes.
    seconds : float
        Processor time of what is to be timed [s].

    """

    rows: Mapping[str, Array]
    seconds: float


@dataclass(frozen=True, eq=False)
class Result:
    """The outcome of one run of one case."""

    case: Case
    run: int
    outcome: Outcome


class Interval(NamedTuple):
    """A value and its confidence interval."""

    value: float
    low: float
    high: float

    @classmethod
    def exactly(cls, value: float) -> Interval:
        """Return a value that is known without error."""
        return cls(value, value, value)

    def __str__(self) -> str:
        value, low, high = map(significant, self)
        return f'{value} ({low} to {high})'


@dataclass(frozen=True)
class Finding:
    """
    One claim beside what was measured.

    Attributes
    ----------
    claim : str
        What is said to hold.
    measured : str
        With its interval and unit.
    limit : str
        What mathematics allows, empty where it is not known.
    verdict : str
        Such as 'reached', or why not.

    """

    claim: str
    measured: str
    limit: str
    verdict: str


@dataclass(frozen=True)
class Report:
    """
    What an experiment has shown.

    Attributes
    ----------
    table : list of rows
        Headings, then cells.
    labels : int
        How many columns say what a row is about.
    findings : list of Finding
        The claims, judged.

    """

    table: list[list[str]]
    labels: int
    findings: list[Finding]


class Experiment(Protocol):
    """
    A claim to be tried; a frozen dataclass, so that processes can be handed copies.

    `title` is one line, `runs` the number of runs that a case gets if nobody says another.
    """

    @property
    def title(self) -> str:
        """Say in one line what is tried."""

    @property
    def runs(self) -> int:
        """Return the number of runs of every case."""

    def cases(self) -> Sequence[Case]:
        """Return the cases, those that take long towards the end: they are begun from there."""

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Work one case with the seed of one run."""

    def judge(self, results: Sequence[Result]) -> Report:
        """Return what the results, in order of cases and runs, show."""

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the results into a PNG file; needs matplotlib."""


def run_experiment(experiment: Experiment, seed: int, runs: int, pool: Pool = IN_THIS_PROCESS,
                   progress: Progress = unshown) -> list[Result]:
    """
    Work all cases of an experiment.

    Parameters
    ----------
    experiment : Experiment
        What is tried.
    seed : int
        Run i has the i-th child of its seed sequence, in every case.
    runs : int
        Of each case.
    pool : Pool
        Who works on them; this process by default.
    progress : Progress
        Shows how many runs are done.

    Returns
    -------
    list of Result
        In order of cases, then of runs; the same for any pool but for times.

    Raises
    ------
    TsmclError
        If the pool cannot do it.

    """
    cases = experiment.cases()
    tasks = [(case, run) for case in range(len(cases)) for run in range(runs)]
    calls = {task: (experiment, cases[task[0]], seed, task[1]) for task in reversed(tasks)}
    # Closed however the loop ends, so that no process outlives it.
    with closing(pool(_work, calls)) as outcomes_as_they_come:
        outcomes = dict(progress(outcomes_as_they_come, len(tasks), 'run'))
    return [Result(cases[case], run, outcomes[case, run]) for case, run in tasks]


def bootstrap_interval(statistic: Callable[[Array], float], samples: Array,
                       confidence: float = 0.95, draws: int = 400) -> Interval:
    """
    Return a statistic and its bootstrap percentile interval (Efron 1979).

    Parameters
    ----------
    statistic
        Of an array such as the samples.
    samples : (..., U) float
        The last axis counts independent units, vehicles say, which are drawn with replacement;
        whatever depends on each other, such as a vehicle's epochs, lies along the others.
    confidence : float
        Between 0 and 1.
    draws : int
        Resamplings.

    """
    rng = np.random.default_rng(0)
    units = samples.shape[-1]
    values = [statistic(samples[..., rng.integers(units, size=units)]) for _ in range(draws)]
    low, high = np.quantile(values, [(1 - confidence) / 2, (1 + confidence) / 2])
    return Interval(statistic(samples), float(low), float(high))


def ratio_interval(statistic: Callable[[Array], float], ours: Array, theirs: Array) -> Interval:
    """
    Return a statistic of ours over that of theirs; see `bootstrap_interval`.

    Units of the same number, vehicles of the same worlds say, are drawn together.
    """
    return bootstrap_interval(
        lambda pair: float(statistic(pair[0]) / statistic(pair[1])), np.stack([ours, theirs]))


def percent(share: float) -> str:
    """Return a share as whole percent."""
    return f'{share:.0%}'.replace('%', ' %')


def significant(value: float) -> str:
    """Return a value to three significant digits, without an exponent where that is readable."""
    if not math.isfinite(value) or value == 0 or not 1e-3 <= abs(value) < 1e6:
        return f'{value:.3g}'
    return f'{value:.{max(2 - math.floor(math.log10(abs(value))), 0)}f}'


def _work(experiment: Experiment, case: Case, seed: int, run: int) -> Outcome:
    # Built here, not handed over: spawning from one that is shared would depend on the order.
    return experiment.work(case, np.random.SeedSequence(seed, spawn_key=(run,)))


class Stopwatch:
    """Adds up the processor time of all that is done inside of it; a context manager."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def __enter__(self) -> None:
        self._begin = time.process_time()

    def __exit__(self, *_: object) -> None:
        self.seconds += time.process_time() - self._begin
