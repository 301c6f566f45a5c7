"""The error of TS-MCL over time, range-free, and what each kind of evidence is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np
from tsmcl_ros.evaluation.experiments.anchor_field import (
    Curve,
    curves_of,
    EVIDENCE,
    exact_grid,
    field,
    has_odometry,
    particle_method,
    RADIO,
    RANGE,
    SHOWN,
)
from tsmcl_ros.evaluation.experiments.common import as_rows, follow, goal, Parked, rmse
from tsmcl_ros.evaluation.metrics import chi_squared_quantile
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    Case,
    Finding,
    Outcome,
    percent,
    ratio_interval,
    Report,
    Result,
    significant,
)
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.types import Array
from tsmcl_ros.world import anchor_table, World, WorldConfig

CLAIMED = 5.0  # m, its error from epoch 100 on


@dataclass(frozen=True)
class TsMclConvergence:
    """
    The error of TS-MCL over time, range-free (Sun, Wang, Zhang 2016: about 5 m from epoch 100 on).

    Vehicles with the papers' random motion among anchors on a jittered grid, first by the beacons
    heard, then with the silence of the map's other anchors, then with odometry; beside it what no
    filter can beat. And between two anchors, which is all that the paper's vehicles hear.

    Attributes
    ----------
    runs, vehicles, epochs : int
        Worlds, vehicles in each, beacon periods of 1 s.
    particles, first_particles : int
        Of TS-MCL.
    bootstrap : tuple of (particles, first particles)
        Of the same code without the search.
    grid_cell : float
        Of the exact filter [m].
    exact_vehicles : int
        Vehicles of each world that the exact filter, which is slow, is run for.
    grid_margin : float
        By which its grid is larger than the vehicles' field, of which no filter knows [m].
    lenses : tuple of float
        Distances of the two anchors [m].
    lens_vehicles, lens_epochs : int
        Vehicles parked between them in each run, and for how long.

    """

    title = 'range-free error of TS-MCL against time, with what each kind of evidence is worth'

    runs: int = 4
    vehicles: int = 40
    epochs: int = 200
    particles: int = 200
    first_particles: int = 2000
    bootstrap: tuple[tuple[int, int], ...] = ((200, 2000), (3000, 20_000), (20_000, 100_000))
    grid_cell: float = 25.0
    grid_margin: float = 500.0
    exact_vehicles: int = 10
    lenses: tuple[float, ...] = (1000.0, 1800.0)
    lens_vehicles: int = 100
    lens_epochs: int = 20

    def cases(self) -> list[Case]:
        """Return what is known, by which filter, with how many particles, at which anchors."""
        def case(evidence: str, method: str, particles: int, apart: float = 0.0) -> Case:
            return {'evidence': evidence, 'filter': method, 'particles': particles,
                    'anchors_apart_m': apart}

        tabu, exact = ('ts_mcl', self.particles), ('exact', 0)
        return [
            *(case('heard', *method, apart) for apart in self.lenses for method in (tabu, exact)),
            *(case(evidence, *method) for evidence in ('heard', 'silence')
              for method in (tabu, exact)),
            case('odometry', *tabu),
            *(case('odometry', 'bootstrap', count) for count, _ in self.bootstrap),
        ]

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Follow the vehicles of one world."""
        world_seed, filter_seed = seed.spawn(2)
        world = self._world(case, np.random.default_rng(world_seed))
        settings = {**EVIDENCE[case['evidence']], **self._method(case),
                    'seed': int(filter_seed.generate_state(1)[0])}
        vehicles = len(world.mobility.state.position)
        if case['filter'] == 'exact' and not case['anchors_apart_m']:
            vehicles = self.exact_vehicles
        track = follow(
            world, Localizer(settings, vehicles),
            self.lens_epochs if case['anchors_apart_m'] else self.epochs,
            odometry=has_odometry(case['evidence']))
        return Outcome(as_rows('epoch', 'vehicle', error_m=track.error, nees=track.nees),
                       track.seconds)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return a table of all curves, and the paper's claim and ours beside them."""
        curves = curves_of(results)
        epochs = f'{self.epochs // 2}-{self.epochs}'
        headings = ['vehicles know', 'filter', 'particles', 'vehicles', f'median {epochs} [m]',
                    f'median at {self.epochs} [m]', f'RMSE {epochs} [m]', 'NEES', 'in 95 %',
                    'ms per update']
        rows = [self._row(curve) for curve in curves if not curve.apart]
        return Report(
            [headings, *rows], 2, [*self._goals(curves), *self._limits(curves)])

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw median and RMSE over the vehicles against the epoch."""
        from tsmcl_ros.evaluation import plots

        curves = [curve for curve in curves_of(results) if not curve.apart]
        figure, (left, right) = plots.panels(2, 12.0, 5.6)
        plots.error_against_epoch(
            left, {curve.label: np.nanmedian(curve.error, axis=1) for curve in curves},
            'median error [m]', {'claimed': CLAIMED})
        plots.error_against_epoch(
            right, {curve.label: rmse(curve.error, axis=1) for curve in curves}, 'RMSE [m]',
            {f'optimum between two anchors {apart:g} m apart': lens_radius(apart, RANGE)
             for apart in self.lenses}, legend=False)
        plots.save_png(figure, path)

    def _world(self, case: Case, rng: np.random.Generator) -> World:
        apart = case['anchors_apart_m']
        if not apart:
            return field(self.vehicles, rng)
        anchors = np.array([[-apart / 2, 0.0], [apart / 2, 0.0]])
        parked = Parked(uniform_in_lens(self.lens_vehicles, apart, RANGE, rng))
        return World(WorldConfig(), Channel(RadioConfig(**RADIO)), parked, anchor_table(anchors),
                     rng)

    def _method(self, case: Case) -> dict[str, Any]:
        if case['filter'] != 'exact':
            first = {self.particles: self.first_particles, **dict(self.bootstrap)}
            return particle_method(case['filter'], case['particles'], first[case['particles']])
        apart = case['anchors_apart_m']
        if not apart:
            return exact_grid(self.grid_cell, self.grid_margin)
        x, y = RANGE - apart / 2, math.sqrt(RANGE ** 2 - apart ** 2 / 4)
        return exact_grid(self.grid_cell, self.grid_margin, (-x, -y), (x, y))

    def _row(self, curve: Curve) -> list[str]:
        late = curve.late
        return [
            SHOWN[curve.evidence], SHOWN[curve.filter], str(curve.particles or '-'),
            str(late.shape[1]), str(bootstrap_interval(np.median, late)),
            str(bootstrap_interval(np.median, late[-1:])), str(bootstrap_interval(rmse, late)),
            significant(float(curve.late_nees.mean())),
            percent(float(np.mean(curve.late_nees < chi_squared_quantile(0.95, 2)))),
            significant(curve.update_ms)]

    def _goals(self, curves: Sequence[Curve]) -> list[Finding]:
        """Compare TS-MCL with odometry and silence with what it is to reach."""
        tabu = _find(curves, 'odometry', 'ts_mcl')
        most = [curve for curve in curves if curve.filter == 'bootstrap'][-1]
        what = f'odometry and silence, TS-MCL with {self.particles} particles: '
        compared = ratio_interval(rmse, tabu.late, most.late)
        return [
            goal(f'{what}median over epochs {self.epochs // 2}-{self.epochs}',
                 bootstrap_interval(np.median, tabu.late), CLAIMED, ' m'),
            goal(f'{what}median at epoch {self.epochs}',
                 bootstrap_interval(np.median, tabu.late[-1:]), 4.0, ' m'),
            goal(f'{what}RMSE over that of a bootstrap filter with {most.particles}',
                 compared, 1.1),
        ]

    def _limits(self, curves: Sequence[Curve]) -> list[Finding]:
        """Compare the paper's claim, which is made without odometry, with what is possible."""
        claim = f'{{}}: the paper has about {CLAIMED:g} m'
        findings = []
        for evidence in ('heard', 'silence'):
            found, limit = (bootstrap_interval(np.median, _find(curves, evidence, name).late)
                            for name in ('ts_mcl', 'exact'))
            findings.append(Finding(
                claim.format(f'{SHOWN[evidence]}, median'), f'{found} m',
                f'exact filter of the same model {limit} m',
                _possible(limit.low, 'the exact filter misses it too')))
        for apart in self.lenses:
            found, limit = (bootstrap_interval(rmse, _find(curves, 'heard', name, apart).late)
                            for name in ('ts_mcl', 'exact'))
            optimum = lens_radius(apart, RANGE)
            findings.append(Finding(
                claim.format(f'two anchors {apart:g} m apart heard all the time, RMSE'),
                f'{found} m', f'{optimum:.0f} m, as they may be anywhere within both ranges; '
                f'exact filter {limit} m',
                _possible(optimum, 'no filter can')))
        return findings


def lens_radius(apart: float, reach: float) -> float:
    """
    Return the RMS distance [m] of the points of a lens from its middle.

    The lens is where two disks of radius `reach` with centres `apart` [m] overlap. Whoever only
    knows that a vehicle is somewhere in it cannot have a smaller RMSE.
    """
    half = reach - apart / 2
    x = (np.arange(10_000) + 0.5) / 10_000 * half
    y = np.sqrt(reach ** 2 - (x + apart / 2) ** 2)
    return float(np.sqrt(np.sum(x ** 2 * y + y ** 3 / 3) / np.sum(y)))


def uniform_in_lens(count: int, apart: float, reach: float, rng: np.random.Generator) -> Array:
    """Return points (count, 2) [m] uniform in the lens of `lens_radius`, about its middle."""
    corner = np.array([reach - apart / 2, math.sqrt(reach ** 2 - apart ** 2 / 4)])
    points = np.empty((0, 2))
    while len(points) < count:
        drawn = corner * rng.uniform(-1, 1, (2 * count, 2))
        inside = np.hypot(np.abs(drawn[:, 0]) + apart / 2, drawn[:, 1]) < reach
        points = np.concatenate([points, drawn[inside]])
    return points[:count]


def _find(curves: Sequence[Curve], evidence: str, method: str, apart: float = 0.0) -> Curve:
    """Return the first curve of this kind."""
    return next(curve for curve in curves
                if (curve.evidence, curve.filter, curve.apart) == (evidence, method, apart))


def _possible(limit: float, reason: str) -> str:
    """Say whether the paper's claim can be true where an error of less than a limit [m] cannot."""
    return f'not reproducible: {reason}' if limit > CLAIMED else 'not excluded'
