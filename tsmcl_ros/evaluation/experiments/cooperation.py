"""Cooperative localization against nonparametric belief propagation, in accuracy and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tsmcl_ros.evaluation.experiments.common import as_rows, by_case, rmse, side_by_side
from tsmcl_ros.evaluation.experiments.network import cooperate, Network
from tsmcl_ros.evaluation.metrics import chi_squared_quantile
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    Case,
    Finding,
    Interval,
    Outcome,
    percent,
    ratio_interval,
    Report,
    Result,
    significant,
)
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.types import Array

SIDE, RANGE = 100.0, 30.0  # m
LAYOUT = (6, 3)
RADIO = RadioConfig(radio_range=RANGE, measure_range=True, range_noise='asymmetric_exponential')
SHOWN = {'cooperative': 'cooperative', 'nbp': 'NBP', 'grid': 'exact grid'}


@dataclass(frozen=True)
class Cooperation:
    """
    A static network of 18 near-uniform anchors and 132 targets in 100 x 100 m, R = 30 m.

    Both methods get the same ranges, error law and rounds. The paper localizes by ranges alone,
    so presence and silence are left out. Beside it the exact filter by anchors alone; none is
    known for the whole network.

    Attributes
    ----------
    runs, targets : int
        Networks, targets in each.
    samples : tuple of int
        Samples of each reference, M.
    rounds : int
        Rounds of localization. Up to the second nothing counts twice; from the third on targets
        hear of each other what they have said themselves, as in all loopy belief propagation;
        covariances reckon with that (`echo.Hearsay`).
    reference_std : float
        Targets with a larger standard deviation are no references [m].
    grid_cell : float
        Of the exact filter [m].

    """

    runs: int = 4
    targets: int = 132
    samples: tuple[int, ...] = (50, 100, 200, 500)
    rounds: int = 3
    reference_std: float = 8.0
    grid_cell: float = 1.0

    def cases(self) -> list[Case]:
        """Return which method, with how many samples."""
        return [{'method': 'grid', 'samples': 0},
                *({'method': method, 'samples': count} for count in self.samples
                  for method in ('cooperative', 'nbp'))]

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Localize the targets of one network."""
        world_seed, filter_seed = seed.spawn(2)
        network = Network.make(
            SIDE, LAYOUT, self.targets, RADIO, np.random.default_rng(world_seed))
        exact = case['method'] == 'grid'
        rounds = cooperate(network, case['method'], self._settings(case), RADIO,
                           1 if exact else self.rounds, self.reference_std, filter_seed)
        heard = np.isfinite(network.ranges[len(network.anchors):, :len(network.anchors)])
        return Outcome(as_rows(
            'round', 'target',
            anchors_heard=np.tile(heard.sum(axis=1), (len(rounds.error), 1)),
            error_m=rounds.error, nees=rounds.nees, localized=rounds.localized.astype(int)),
            rounds.seconds)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return a table of all rounds, and the paper's claims beside what came of them."""
        headings = ['method', 'M', 'round', 'localized', 'RMSE [m]', 'median [m]',
                    '90 % below [m]', 'NEES', 'in 95 %', 'processor time [s]']
        tries = _tries(results)
        rows = [row for each in tries for row in each.table()]
        return Report([headings, *rows], 3, self.findings(tries))

    def findings(self, tries: Sequence[Try]) -> list[Finding]:
        """Return the claims, judged."""
        raise NotImplementedError

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the distributions of errors after the last round, and processor time."""
        from tsmcl_ros.evaluation import plots

        tries = [each for each in _tries(results) if each.method != 'grid']
        figure, (left, right) = plots.panels(2, 12.0, 4.8)
        plots.error_cdf(left, {each.label: each.known for each in tries})
        left.set_ylabel('share of targets')
        curves = {}
        for method in ('cooperative', 'nbp'):
            times = [bootstrap_interval(np.mean, each.seconds)
                     for each in tries if each.method == method]
            curves[SHOWN[method]] = self.samples, times
        plots.intervals_against(
            right, curves, 'samples of a reference', 'processor time of a network [s]')
        plots.save_png(figure, path)

    def _settings(self, case: Case) -> dict[str, Any]:
        if case['method'] != 'grid':
            return {'reference_samples': case['samples']}
        return {'grid_cell': self.grid_cell, 'grid_x_min': -RANGE, 'grid_x_max': SIDE + RANGE,
                'grid_y_min': -RANGE, 'grid_y_max': SIDE + RANGE}


@dataclass(frozen=True)
class CoopSamples(Cooperation):
    """The error of both methods against the number of samples."""

    title = 'cooperative localization against NBP: errors by the number of samples'

    def findings(self, tries: Sequence[Try]) -> list[Finding]:
        """Compare errors after the last round, on the same targets."""
        least, most = min(self.samples), max(self.samples)
        found = {(each.method, each.samples): each for each in tries}
        findings = [
            _smaller(f'M = {count}: RMSE of cooperative below that of NBP',
                     found['cooperative', count], found['nbp', count]) for count in self.samples]
        few, many = found['cooperative', least], found['cooperative', most]
        matters = _ratio(few, many)
        findings += [
            Finding(f'M hardly matters: RMSE of cooperative at M = {least} over that at {most}',
                    str(matters), '',
                    'reproduced' if 0.9 < matters.value < 1.1 else 'not reproduced'),
            _smaller(f'RMSE of cooperative at M = {least} below that of NBP at M = {most}', few,
                     found['nbp', most]),
            *(self._first_round(found[method, most], found['grid', 0])
              for method in ('cooperative', 'nbp')),
        ]
        return findings

    def _first_round(self, tried: Try, exact: Try) -> Finding:
        """Compare the first round, which has anchors alone, with the exact filter."""
        both = (tried.anchors_heard >= 3) & np.isfinite(tried.error[0] + exact.error[0])
        share = ratio_interval(rmse, tried.error[0, both], exact.error[0, both])
        return Finding(
            f'anchors alone, three or more heard: RMSE of {SHOWN[tried.method]} at '
            f'M = {tried.samples} over that of the exact filter', str(share),
            f'exact filter {bootstrap_interval(rmse, exact.error[0, both])} m',
            'as good as possible' if share.value <= 1.05 else 'not as good as possible')


@dataclass(frozen=True)
class CoopTime(Cooperation):
    """The processor time of both methods."""

    title = 'cooperative localization against NBP: processor time'

    runs: int = 2

    def findings(self, tries: Sequence[Try]) -> list[Finding]:
        """Compare processor times in the same networks, at equal M and at equal accuracy."""
        found = {(each.method, each.samples): each for each in tries}
        least, most = min(self.samples), max(self.samples)
        pairs = [(count, count) for count in self.samples]
        return [
            _faster(f'M = {few} for cooperative and {many} for NBP' if few != many
                    else f'M = {few}', found['cooperative', few], found['nbp', many])
            for few, many in [*pairs, (least, most)]]


@dataclass(frozen=True, eq=False)
class Try:
    """All runs of a case: errors [m], NEES and whether localized (T, U) of all their targets."""

    method: str
    samples: int
    error: Array
    nees: Array
    localized: Array
    anchors_heard: Array
    seconds: Array

    @property
    def label(self) -> str:
        """What legends call it."""
        return f'{SHOWN[self.method]} {self.samples}'

    @property
    def known(self) -> Array:
        """Errors [m] after the last round of those that have an estimate at all."""
        return np.asarray(self.error[-1][np.isfinite(self.error[-1])])

    def table(self) -> list[list[str]]:
        """Return a row a round; the time is that of all rounds."""
        rows = []
        for index, (error, nees, localized) in enumerate(
                zip(self.error, self.nees, self.localized, strict=True)):
            known = np.isfinite(error)
            median, most = np.quantile(error[known], [0.5, 0.9])
            rows.append([
                SHOWN[self.method], str(self.samples or '-'), str(index + 1),
                percent(localized.mean()),
                str(bootstrap_interval(rmse, error[known])), significant(float(median)),
                significant(float(most)), significant(float(nees[known].mean())),
                percent(float(np.mean(nees[known] < chi_squared_quantile(0.95, 2)))),
                significant(float(self.seconds.mean()))])
        return rows


def _tries(results: Sequence[Result]) -> list[Try]:
    """Lay the runs of each case side by side."""
    tries = []
    for (method, samples), outcomes in by_case(results).items():
        error, nees, localized, heard = (
            side_by_side(outcomes, 'round', name)
            for name in ('error_m', 'nees', 'localized', 'anchors_heard'))
        seconds = np.array([outcome.seconds for outcome in outcomes])
        tries.append(Try(method, samples, error, nees, localized, heard[0], seconds))
    return tries


def _ratio(one: Try, other: Try) -> Interval:
    """Return the ratio of RMSEs after the last round, on the targets that both have."""
    both = np.isfinite(one.error[-1]) & np.isfinite(other.error[-1])
    return ratio_interval(rmse, one.error[-1, both], other.error[-1, both])


def _smaller(claim: str, one: Try, other: Try) -> Finding:
    """Return whether one method's errors are smaller than the other's."""
    ratio = _ratio(one, other)
    verdict = 'reproduced' if ratio.high < 1 else (
        'not to be told apart' if ratio.low < 1 else 'not reproduced')
    values = f'{significant(rmse(one.known))} m against {significant(rmse(other.known))} m'
    return Finding(claim, f'{values}, ratio {ratio}', '', verdict)


def _faster(setting: str, one: Try, other: Try) -> Finding:
    """Return how many times longer the other method takes."""
    ratio = ratio_interval(np.sum, other.seconds, one.seconds)
    verdict = 'reproduced' if ratio.low > 1 else (
        'not to be told apart' if ratio.high > 1 else 'not reproduced')
    errors = f'at {significant(rmse(one.known))} m against {significant(rmse(other.known))} m'
    return Finding(f'{setting}: processor time far below that of NBP',
                   f'NBP takes {ratio} times as long, {errors} of RMSE', '', verdict)
