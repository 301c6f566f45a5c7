"""What the papers did not try: error against particles, by what the vehicles know."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
    SHOWN,
)
from tsmcl_ros.evaluation.experiments.common import as_rows, follow, rmse
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

METHODS = ('bootstrap', 'mcb', 'ts_mcl')


@dataclass(frozen=True)
class Beyond:
    """
    Error against particles of three filters, with and without silence and odometry.

    Beside each stands the best that is known: the exact grid where vehicles move at random, and
    a bootstrap filter with very many particles where odometry, of half a metre a second, would
    need a grid of millions of cells.

    Attributes
    ----------
    runs, vehicles, epochs : int
        Worlds, vehicles in each, beacon periods of 1 s.
    particles : tuple of int
        That the filters are tried with.
    most : int
        Particles of the yardstick where there is odometry.
    first : int
        Candidates in the first epoch, in particles.
    grid_cell, grid_margin : float
        Of the exact filter [m].
    yardstick_vehicles : int
        Vehicles of each world that the yardsticks, which are slow, are run for.
    near : float
        How much larger than the yardstick's an RMSE may be to count as reached.

    """

    title = 'range-free error against particles, with and without silence and odometry'

    runs: int = 2
    vehicles: int = 40
    epochs: int = 200
    particles: tuple[int, ...] = (10, 20, 50, 100, 200, 500, 1000, 2000)
    most: int = 20_000
    first: int = 10
    grid_cell: float = 25.0
    grid_margin: float = 500.0
    yardstick_vehicles: int = 20
    near: float = 0.1

    def cases(self) -> list[Case]:
        """Return what is known, by which filter, with how many particles."""
        return [{'evidence': evidence, 'filter': method, 'particles': count}
                for evidence in EVIDENCE
                for method, count in [*((method, count) for method in METHODS
                                        for count in self.particles), self._yardstick(evidence)]]

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Follow the vehicles of one world."""
        world_seed, filter_seed = seed.spawn(2)
        world = field(self.vehicles, np.random.default_rng(world_seed))
        evidence, method, count = case['evidence'], case['filter'], case['particles']
        settings: dict[str, Any] = (
            exact_grid(self.grid_cell, self.grid_margin) if method == 'exact'
            else particle_method(method, count, self.first * count))
        track = follow(
            world, Localizer({**EVIDENCE[evidence], **settings,
                              'seed': int(filter_seed.generate_state(1)[0])},
                             self._vehicles(evidence, method, count)),
            self.epochs, has_odometry(evidence))
        return Outcome(as_rows('epoch', 'vehicle', error_m=track.error, nees=track.nees),
                       track.seconds)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return a table of all cases, and what evidence and search are worth."""
        curves = curves_of(results)
        epochs = f'{self.epochs // 2}-{self.epochs}'
        rows = [[SHOWN[curve.evidence], SHOWN[curve.filter], str(curve.particles or '-'),
                 str(bootstrap_interval(np.median, curve.late)),
                 str(bootstrap_interval(rmse, curve.late)),
                 str(self._over_yardstick(curve, self._best(curves, curve.evidence))),
                 significant(curve.update_ms)] for curve in curves]
        return Report(
            [['vehicles know', 'filter', 'particles', f'median {epochs} [m]',
              f'RMSE {epochs} [m]', 'RMSE over the best', 'ms per update'], *rows], 2,
            [*self._worth(curves), *self._needed(curves)])

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the RMSE against the number of particles, one panel for what vehicles know."""
        from tsmcl_ros.evaluation import plots

        curves = curves_of(results)
        figure, panels = plots.panels(len(EVIDENCE), 15.0, 4.6)
        for ax, evidence in zip(panels, EVIDENCE, strict=True):
            best = self._best(curves, evidence)
            shown = {SHOWN[method]: (self.particles, [
                bootstrap_interval(rmse, curve.late) for curve in curves
                if (curve.evidence, curve.filter) == (evidence, method)
                and curve is not best]) for method in METHODS}
            limit = bootstrap_interval(rmse, best.late)
            shown[best.localizer] = (
                self.particles, [limit] * len(self.particles))
            plots.intervals_against(ax, shown, f'particles ({SHOWN[evidence]})', 'RMSE [m]',
                                    log=True)
        plots.save_png(figure, path)

    def _yardstick(self, evidence: str) -> tuple[str, int]:
        """Return the best filter that is known with this evidence, and its particles."""
        return ('bootstrap', self.most) if has_odometry(evidence) else ('exact', 0)

    def _best(self, curves: Sequence[Curve], evidence: str) -> Curve:
        return next(curve for curve in curves if curve.evidence == evidence
                    and (curve.filter, curve.particles) == self._yardstick(evidence))

    def _over_yardstick(self, curve: Curve, best: Curve) -> Interval:
        """Return the ratio of RMSEs of the vehicles that both filters have followed."""
        return ratio_interval(rmse, self._followed(curve), self._followed(best))

    def _followed(self, curve: Curve) -> Any:
        """Return the late errors (T, U) [m] of those vehicles that yardsticks are run for."""
        followed = self._vehicles(curve.evidence, curve.filter, curve.particles)
        error = curve.late.reshape(len(curve.late), -1, followed)
        return error[:, :, :self.yardstick_vehicles].reshape(len(error), -1)

    def _vehicles(self, evidence: str, method: str, particles: int) -> int:
        """Return how many vehicles of each world a filter is run for."""
        yardstick = (method, particles) == self._yardstick(evidence)
        return self.yardstick_vehicles if yardstick else self.vehicles

    def _worth(self, curves: Sequence[Curve]) -> Iterator[Finding]:
        """Say what silence and odometry take off the best error."""
        plain = self._best(curves, 'heard')
        for evidence in list(EVIDENCE)[1:]:
            best = self._best(curves, evidence)
            share = ratio_interval(rmse, best.late, plain.late)
            yield Finding(
                f'{SHOWN[evidence]}: best RMSE over that of {SHOWN["heard"]}', str(share), '',
                'worth it' if share.high < 1 else 'worth nothing that could be shown')

    def _needed(self, curves: Sequence[Curve]) -> Iterator[Finding]:
        """Say how many particles each filter needs to come near the best."""
        for evidence in EVIDENCE:
            best = self._best(curves, evidence)
            needed = {method: next(
                (curve.particles for curve in curves
                 if (curve.evidence, curve.filter) == (evidence, method) and curve is not best
                 and self._over_yardstick(curve, best).value <= 1 + self.near), None)
                for method in METHODS}
            said = ', '.join(
                f'{SHOWN[method]} ' + (f'{count}' if count else f'more than {self.particles[-1]}')
                for method, count in needed.items())
            tabu, plain = needed['ts_mcl'], needed['bootstrap']
            fewer = tabu is not None and (plain is None or tabu < plain)
            yield Finding(
                f'{SHOWN[evidence]}: particles for an RMSE within {100 * self.near:.0f} % of the '
                f'best', said, f'{best.localizer}, {bootstrap_interval(rmse, best.late)} m',
                'the search saves particles' if fewer else 'the search saves none')
