"""How the factor of the adaptive beacon period depends on the residual: no randomness in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
from tsmcl_ros.evaluation.monte_carlo import (
    Case,
    Finding,
    Interval,
    Outcome,
    Report,
    Result,
    significant,
)
from tsmcl_ros.model.period import omega
from tsmcl_ros.types import Array


@dataclass(frozen=True)
class PeriodFactor:
    """
    The factor of the beacon period against the residual, for q and alpha.

    Attributes
    ----------
    qs, alphas : tuple of float
        One is varied while the other has the paper's value, 15 or 1e6.
    residuals : int
        Points of each curve, from 0 to 20 m.

    """

    title = 'the factor of the beacon period against the residual, its shape for q and alpha'

    qs: tuple[float, ...] = (10.0, 15.0, 20.0, 25.0)
    alphas: tuple[float, ...] = (1e4, 1e5, 1e6)
    residuals: int = 2001
    runs: int = 1

    def cases(self) -> list[Case]:
        """Return the pairs of q and alpha."""
        return [*({'q': q, 'alpha': 1e6} for q in self.qs),
                *({'q': 15.0, 'alpha': alpha} for alpha in self.alphas)]

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Compute one curve."""
        residual = np.linspace(0, 20, self.residuals)
        return Outcome({'residual_m': residual, 'factor': omega(residual, **case)}, 0.0)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return where each curve begins and is steepest, and whether the paper's shapes hold."""
        rows = [['q', 'alpha', 'largest factor', 'half of it at [m]', 'steepest at [m]',
                 'ln(alpha / q) [m]']]
        for result in results:
            residual, factor = (result.outcome.rows[name] for name in ('residual_m', 'factor'))
            steepest = residual[np.gradient(factor, residual).argmin()]
            half = residual[np.abs(factor - factor[0] / 2).argmin()]
            q, alpha = result.case['q'], result.case['alpha']
            rows.append([f'{q:g}', f'{alpha:g}', *map(significant, (
                float(factor[0]), float(half), float(steepest), math.log(alpha / q)))])
        by_q, by_alpha = (
            np.array([result.outcome.rows['factor'] for result in part])
            for part in (results[:len(self.qs)], results[len(self.qs):]))
        gap = by_alpha[:, 0].max() / by_alpha[:, 0].min() - 1
        return Report(rows, 2, [
            _holds('a larger q raises the factor at any residual', (np.diff(by_q, axis=0) > 0)),
            _holds('a larger alpha raises the factor at any residual',
                   np.diff(by_alpha, axis=0) > 0),
            Finding('alpha leaves the largest factor as it is',
                    f'it differs by {100 * gap:.2g} %', 'q / alpha',
                    'reproduced' if gap < 0.01 else 'not reproduced'),
        ])

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the curves, those of q and those of alpha side by side."""
        from tsmcl_ros.evaluation import plots

        figure, axes = plots.panels(2, 10.0, 4.0)
        for ax, name, part in zip(axes, ('q', 'alpha'), (
                results[:len(self.qs)], results[len(self.qs):]), strict=True):
            plots.intervals_against(ax, {
                f'{name} {result.case[name]:g}': (
                    result.outcome.rows['residual_m'].tolist(),
                    [*map(Interval.exactly, result.outcome.rows['factor'].tolist())])
                for result in part}, 'residual [m]', 'factor')
        plots.save_png(figure, path)


def _holds(claim: str, found: Array) -> Finding:
    share = float(np.mean(found))
    return Finding(claim, f'at {100 * share:.3g} % of all residuals', 'exact',
                   'reproduced' if share == 1 else 'not reproduced')
