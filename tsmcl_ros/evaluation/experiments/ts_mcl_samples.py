"""
TS-MCL beside MCL in the paper's own setting: only beacons heard, only random motion.

Sun, Wang, Zhang 2016, their figures of error against samples, of time against iterations, and of
error against radio range.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from tsmcl_ros.evaluation.experiments.common import follow, goal
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    Case,
    Finding,
    Interval,
    Outcome,
    ratio_interval,
    Report,
    Result,
    significant,
)
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.types import Array
from tsmcl_ros.world import make_world

SHOWN = {'ts_mcl': 'TS-MCL', 'mcl': 'MCL', 'exact': 'exact grid'}
SPEED = 50.0  # m/s, at most
PAPER_ITERATIONS = 10


@dataclass(frozen=True)
class HeardOnly:
    """
    Vehicles that only know which anchors they hear, followed by TS-MCL and by MCL.

    Attributes
    ----------
    runs, vehicles, epochs : int
        Worlds, vehicles in each, beacon periods of 1 s.
    settled : int
        Epochs that are left out at the beginning.
    first_particles : int
        Candidates of either filter in the first epoch.
    spacing : float
        Of the anchors, in radio ranges: 1 lets a vehicle hear three of them.
    grid_cell : float
        Of the exact filter, in radio ranges.

    """

    title: ClassVar[str]

    runs: int = 8
    vehicles: int = 40
    epochs: int = 100
    settled: int = 20
    first_particles: int = 1000
    spacing: float = 1.0
    grid_cell: float = 0.025

    @abstractmethod
    def cases(self) -> list[Case]:
        """Return filters, particles, iterations of the search, and radio ranges [m]."""

    @abstractmethod
    def findings(self, outcomes: Outcomes) -> list[Finding]:
        """Judge the errors."""

    @abstractmethod
    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the results."""

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Follow the vehicles of one world."""
        world_seed, filter_seed = seed.spawn(2)
        reach = case['radio_range_m']
        radio = {'radio_model': 'disk', 'radio_range': reach}
        side = 4 * self.spacing * reach
        world = make_world(
            {**radio, 'vehicles': self.vehicles, 'max_speed': SPEED, 'area_x': side,
             'area_y': side, 'anchor_spacing': self.spacing * reach,
             'anchor_jitter': 0.2 * self.spacing * reach}, np.random.default_rng(world_seed))
        localizer = Localizer(
            {**radio, 'motion_model': 'random', 'max_speed': SPEED, 'silence': 'none',
             'edge_softness': 0.001 * reach, **self._method(case, side),
             'seed': int(filter_seed.generate_state(1)[0])}, self.vehicles)
        track = follow(world, localizer, self.epochs, odometry=False)
        # Of each vehicle the mean over its epochs, which depend on each other.
        return Outcome(
            {'vehicle': np.arange(self.vehicles),
             'error_m': np.nanmean(track.error[self.settled:], axis=0)},
            track.seconds)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return a table of all cases, and the paper's claims beside them."""
        outcomes = Outcomes(results)
        steps = self.vehicles * self.epochs * len({result.run for result in results})
        rows = [
            [SHOWN[case['filter']], str(case['particles'] or '-'),
             str(case['iterations']) if case['filter'] == 'ts_mcl' else '-',
             significant(case['radio_range_m']), str(outcomes.mean(**case)),
             str(outcomes.mean(per=case['radio_range_m'], **case)),
             significant(1e3 * outcomes.seconds(**case) / steps)]
            for case in self.cases()]
        return Report(
            [['filter', 'particles', 'iterations', 'R [m]', 'mean error [m]', 'error / R',
              'ms per update'], *rows], 1, self.findings(outcomes))

    def _method(self, case: Case, side: float) -> dict[str, Any]:
        if case['filter'] == 'exact':
            return {'method': 'grid', 'grid_cell': self.grid_cell * case['radio_range_m'],
                    'grid_x_max': side, 'grid_y_max': side}
        cloud = {'min_particles': case['particles'],
                 'max_particles': max(self.first_particles, case['particles'])}
        if case['filter'] == 'mcl':
            return {'method': 'mcl', **cloud}
        return {'method': 'ts_mcl', 'max_iterations': case['iterations'], **cloud}


def case(method: str, particles: int, radio_range: float = 1000.0,
         iterations: int = PAPER_ITERATIONS) -> Case:
    """Return a case of the experiments below."""
    return {'filter': method, 'particles': particles, 'iterations': iterations,
            'radio_range_m': radio_range}


@dataclass(frozen=True)
class TsMclSamples(HeardOnly):
    """Error against the number of particles, to which TS-MCL is to be less sensitive."""

    title: ClassVar[str] = 'error of TS-MCL and MCL against the number of particles, heard only'

    particles: tuple[int, ...] = (2, 4, 6, 8, 10, 20, 50)

    def cases(self) -> list[Case]:
        """Return both filters with every number of particles, and the exact filter."""
        return [*(case(method, count) for count in self.particles for method in ('mcl', 'ts_mcl')),
                case('exact', 0)]

    def findings(self, outcomes: Outcomes) -> list[Finding]:
        """Compare few particles with the search to many without."""
        few, many = self.particles[-3], self.particles[-1]
        limit = outcomes.mean(filter='exact')
        share = outcomes.ratio({'filter': 'ts_mcl', 'particles': few},
                               {'filter': 'mcl', 'particles': many})
        fall = outcomes.ratio({'filter': 'ts_mcl', 'particles': self.particles[-4]},
                              {'filter': 'ts_mcl', 'particles': many})
        return [
            goal(f'error of TS-MCL with {few} particles over that of MCL with {many}', share, 1.0,
                 limit=f'exact filter {limit} m'),
            Finding(f'error falls sharply to {self.particles[-4]} samples, hardly after: '
                    f'error there over that with {many}', str(fall), '',
                    'reproduced' if fall.value < 1.1 else 'not reproduced'),
        ]

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the error against the number of particles."""
        outcomes = Outcomes(results)
        _draw(path, {SHOWN[method]: (
            self.particles,
            [outcomes.mean(filter=method, particles=count) for count in self.particles])
            for method in ('mcl', 'ts_mcl')}, 'particles', 'mean error [m]')


@dataclass(frozen=True)
class TsMclTime(HeardOnly):
    """Time against iterations: the search costs time, but needs fewer particles."""

    title: ClassVar[str] = 'time of TS-MCL against its iterations, beside MCL as accurate as it'

    iterations: tuple[int, ...] = (1, 2, 5, 10, 20)
    particles: int = 50
    fewer: int = 10

    def cases(self) -> list[Case]:
        """Return TS-MCL with few and with equally many particles, and MCL."""
        return [case('mcl', self.particles),
                *(case('ts_mcl', count, iterations=number)
                  for count in (self.fewer, self.particles) for number in self.iterations)]

    def findings(self, outcomes: Outcomes) -> list[Finding]:
        """
        Compare the time at N / 5 particles, which are as accurate as N of MCL, and at N.

        With the paper's number of iterations, and with as few as leave the error below MCL's.
        """
        mcl = {'filter': 'mcl'}
        findings = []
        for count in (self.fewer, self.particles):
            tabu = {number: {'filter': 'ts_mcl', 'particles': count, 'iterations': number}
                    for number in self.iterations}
            errors = {number: outcomes.ratio(what, mcl) for number, what in tabu.items()}
            enough = next((number for number, error in errors.items() if error.value <= 1), None)
            for number in sorted({PAPER_ITERATIONS, enough or PAPER_ITERATIONS}):
                time = outcomes.seconds(**tabu[number]) / outcomes.seconds(**mcl)
                accurate = '' if errors[number].value <= 1 else ', though less accurate'
                findings.append(Finding(
                    f'at least 30 % less time: TS-MCL with {count} particles and {number} '
                    f'iterations over MCL with {self.particles}',
                    f'{significant(time)} of the time at {errors[number]} of the error', '',
                    ('reached' if time <= 0.7 else 'missed') + accurate))
        return findings

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the time of a run against the iterations."""
        outcomes = Outcomes(results)

        def seconds(**what: Any) -> Interval:
            return Interval.exactly(outcomes.seconds(**what))

        curves = {f'TS-MCL, {count} particles': (
            self.iterations, [seconds(filter='ts_mcl', particles=count, iterations=number)
                              for number in self.iterations])
                  for count in (self.fewer, self.particles)}
        curves[f'MCL, {self.particles} particles'] = (
            self.iterations, [seconds(filter='mcl')] * len(self.iterations))
        _draw(path, curves, 'most iterations', 'processor time of all runs [s]')


@dataclass(frozen=True)
class TsMclRadius(HeardOnly):
    """Error against radio range, at few and at the paper's number of particles."""

    title: ClassVar[str] = 'error of TS-MCL and MCL against the radio range, heard only'

    ranges: tuple[float, ...] = (500.0, 750.0, 1000.0, 1500.0, 2000.0)
    particles: tuple[int, ...] = (10, 50)

    def cases(self) -> list[Case]:
        """Return both filters at every radio range, and the exact filter."""
        return [*(case(method, count, reach) for count in self.particles for reach in self.ranges
                  for method in ('mcl', 'ts_mcl')),
                *(case('exact', 0, reach) for reach in self.ranges)]

    def findings(self, outcomes: Outcomes) -> list[Finding]:
        """Compare the errors at each range."""
        findings = []
        for count in self.particles:
            for reach in self.ranges:
                there = {'particles': count, 'radio_range_m': reach}
                mcl = {'filter': 'mcl', **there}
                limit = outcomes.ratio({'filter': 'exact', 'radio_range_m': reach}, mcl)
                findings.append(goal(
                    f'N = {count}, R = {reach:g} m: error of TS-MCL over that of MCL',
                    outcomes.ratio({'filter': 'ts_mcl', **there}, mcl), 0.9,
                    limit=f'exact filter over MCL {limit}', best=limit))
        return findings

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the error against the radio range."""
        outcomes = Outcomes(results)
        _draw(path, {f'{SHOWN[method]}, {count} particles': (
            self.ranges, [outcomes.mean(filter=method, particles=count, radio_range_m=reach)
                          for reach in self.ranges])
                     for count in self.particles for method in ('mcl', 'ts_mcl')},
              'radio range [m]', 'mean error [m]')


class Outcomes:
    """Errors of vehicles and times of runs, by what their cases say."""

    def __init__(self, results: Sequence[Result]):
        self._results = results

    def errors(self, **what: Any) -> Array:
        """Return how far off (U,) [m] all vehicles of the cases that say this are."""
        return np.concatenate(
            [result.outcome.rows['error_m'] for result in self._select(what)])

    def mean(self, per: float = 1.0, **what: Any) -> Interval:
        """Return the mean error, in units of `per` [m]."""
        return bootstrap_interval(np.mean, self.errors(**what) / per)

    def ratio(self, ours: Case, theirs: Case) -> Interval:
        """Return a mean error over another one of the same vehicles."""
        return ratio_interval(np.mean, self.errors(**ours), self.errors(**theirs))

    def seconds(self, **what: Any) -> float:
        """Return the processor time [s] of all runs of the cases that say this."""
        return sum(result.outcome.seconds for result in self._select(what))

    def _select(self, what: Case) -> list[Result]:
        return [result for result in self._results
                if all(result.case[name] == value for name, value in what.items())]


def _draw(path: Path, curves: Mapping[str, tuple[Sequence[float], Sequence[Interval]]],
          x_label: str, y_label: str) -> None:
    from tsmcl_ros.evaluation import plots

    figure, (ax,) = plots.panels(1, 8.0, 5.0)
    plots.intervals_against(ax, curves, x_label, y_label)
    plots.save_png(figure, path)
