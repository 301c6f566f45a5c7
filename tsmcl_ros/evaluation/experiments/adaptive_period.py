"""
The adaptive beacon period of underwater networks: what it saves on the air, and what it costs.

Gao, Wang, Shen (mobile underwater acoustic networks): ten anchors and twenty vehicles in a volume,
ranges of variance 3 m^2, an EKF, and a beacon every period, every fifth, or when it is wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np
from tsmcl_ros.evaluation.experiments.adaptive_claims import (
    CLAIMS,
    Found,
    mean,
    PAPER,
    score,
    Setting,
    settings,
)
from tsmcl_ros.evaluation.experiments.common import as_rows, by_case
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    Case,
    Finding,
    Outcome,
    ratio_interval,
    Report,
    Result,
    significant,
    Stopwatch,
)
from tsmcl_ros.methods.ekf import Ekf
from tsmcl_ros.model.mobility import RandomWaypoint, RandomWaypointConfig
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.period import AirCost, Schedule
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Array, Estimate, Motion, Observation

VOLUME = (400.0, 400.0, 200.0)  # m; the paper does not tell its own
SPEED = 0.5, 2.0  # m/s, neither
# m/s^1.5; ways are straight but for turns, which are noticed: less than 0.05 suits every scheme.
ACCELERATION_STD = 0.01
# The paper's two fixed periods, this package's adaptive one, that of the paper's parameters, and
# as a yardstick of what adapting brings a fixed period that costs about as much as ours.
SCHEMES: dict[str, dict[str, Any]] = {
    'omega 1': {'period_factor': 1},
    'omega 5': {'period_factor': 5},
    'adaptive': {'beacon_period': 'adaptive', 'period_residual': 'normalized', 'period_q': 3.0,
                 'period_alpha': 5000.0},
    'adaptive, paper': {'beacon_period': 'adaptive', 'period_residual': 'sum', 'period_q': 15.0,
                        'period_alpha': 1e6},
    'omega 3': {'period_factor': 3},
}
_SETTLING = 5  # periods until all are placed and have a velocity


@dataclass(frozen=True)
class AdaptivePeriod:
    """
    Error and air cost of a fixed and an adaptive beacon period.

    Attributes
    ----------
    title : str
        What is tried.
    shown : str
        Which of the paper's figures: track, error, noise, density, traffic or score.
    variances : tuple of float
        Of the ranges [m^2].
    shares : tuple of float
        Anchors among the nodes.
    runs, worlds, epochs : int
        Seeds, networks computed together in each, base periods of 1 s.
    nodes : int
        Anchors and vehicles of a network.

    """

    title: str
    shown: str
    variances: tuple[float, ...] = (3.0,)
    shares: tuple[float, ...] = (1 / 3,)
    runs: int = 4
    worlds: int = 16
    epochs: int = 200
    nodes: int = 30

    def cases(self) -> list[Case]:
        """Return all schemes at all variances and shares of anchors."""
        return [{'variance_m2': variance, 'anchors': round(share * self.nodes), 'scheme': scheme}
                for variance in self.variances for share in self.shares for scheme in SCHEMES]

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Follow the vehicles of some networks at once; each is localized by itself."""
        networks = Networks(case, self.worlds, self.nodes, seed)
        position, error, sampled = [], [], []
        watch = Stopwatch()
        for _ in range(self.epochs):
            heard = networks.step()
            with watch:
                estimate = networks.localize(heard)
            position.append(networks.position)
            error.append(np.linalg.norm(estimate.mean - networks.position, axis=1))
            sampled.append(np.where(estimate.heard > 0, error[-1], np.nan))
        if self.shown == 'track':
            return Outcome(as_rows('epoch', 'vehicle', error_m=np.array(error),
                                   sampled_error_m=np.array(sampled)), watch.seconds)
        vehicles = self.nodes - case['anchors']
        cost = AirCost(vehicles, case['anchors'])
        schedule = networks.schedule
        return Outcome({
            'vehicle': np.arange(len(networks.position)),
            'error_m': np.mean(error[_SETTLING:], axis=0),
            'sampled_error_m': np.nanmean(sampled[_SETTLING:], axis=0),
            'updates': np.isfinite(sampled).sum(axis=0),
            'bits': (schedule.localizations * cost.localization_bits
                     + schedule.requests * cost.period_bits),
        }, watch.seconds)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return a table of all settings, and what the figure's claim comes to."""
        if self.shown == 'track':
            return self._judge_tracks(_gather(results))
        found = _gather(results)
        headings = ['ranges [m^2]', 'anchors', 'period', 'error at samples [m]',
                    'error at every period [m]', 'updates', 'kbit a vehicle',
                    'score at samples', 'score at every period']
        rows = [self._row(setting, scheme, found) for setting in settings(found)
                for scheme in SCHEMES]
        return Report([headings, *rows], 3, list(CLAIMS[self.shown](found)))

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw what the paper's figure shows."""
        from tsmcl_ros.evaluation import plots

        found = _gather(results)
        if self.shown == 'track':
            figure, (left, right) = plots.panels(2, 12.0, 4.0)
            plots.error_against_epoch(left, {
                scheme: np.bincount(part['epoch'], part['error_m'])[1:]
                / np.bincount(part['epoch'])[1:]
                for (_, _, scheme), part in found.items()}, 'mean error [m]', {})
            plots.error_against_epoch(right, {
                scheme: part['error_m'][part['vehicle'] == 0][:self.epochs]
                for (_, _, scheme), part in found.items()}, 'error of one vehicle [m]', {},
                legend=False)
            plots.save_png(figure, path)
            return
        column = 0 if len(self.variances) > 1 else 1
        x = [setting[column] for setting in settings(found)]
        figure, axes = plots.panels(3, 12.0, 4.0)
        label = ('variance of the ranges [m^2]', f'anchors among {self.nodes} nodes')[column]
        for ax, name, quantity in zip(
            axes, ('sampled_error_m', 'error_m', 'bits'),
            ('error at samples [m]', 'error at every period [m]', 'bits a vehicle'), strict=True,
        ):
            plots.intervals_against(ax, {
                scheme: (x, [mean(found[*setting, scheme][name]) for setting in settings(found)])
                for scheme in SCHEMES}, label, quantity)
        plots.save_png(figure, path)

    def _judge_tracks(self, found: Found) -> Report:
        """Return how far each scheme's vehicles are from their ways."""
        rows = [['period', 'mean error [m]', 'median [m]', '95 % [m]', 'worst [m]']]
        late = {}
        for (_, _, scheme), part in found.items():
            errors = part['error_m'][part['epoch'] > _SETTLING]
            late[scheme] = errors.reshape(-1, int(part['vehicle'].max()) + 1)
            rows.append([scheme, str(bootstrap_interval(np.mean, late[scheme])), *map(
                significant, np.quantile(errors, [0.5, 0.95, 1.0]).tolist())])
        findings = []
        for scheme, called in (('adaptive', 'the adaptive period'),
                               (PAPER, "the paper's adaptive period")):
            ratio = ratio_interval(np.mean, late[scheme], late['omega 1'])
            findings.append(Finding(
                f'the track of {called} is as close as that of omega 1',
                f'{ratio} times its error at every period', '',
                'reproduced' if ratio.low <= 1.1 else
                'not reproduced: a turn between two beacons goes unseen until the next'))
        return Report(rows, 1, findings)

    def _row(self, setting: Setting, scheme: str, found: Found) -> list[str]:
        part = found[*setting, scheme]
        return [
            significant(setting[0]), str(setting[1]), scheme,
            str(mean(part['sampled_error_m'])), str(mean(part['error_m'])),
            significant(float(part['updates'].mean())),
            significant(float(part['bits'].mean()) / 1000),
            str(score(found, setting, scheme, 'sampled_error_m')),
            str(score(found, setting, scheme, 'error_m'))]


class Networks:
    """
    Networks of one kind, whose vehicles are one batch: all of them hear the anchors of their own.

    A seed gives the same ways, anchors and noise whatever the scheme.
    """

    def __init__(self, case: Case, worlds: int, nodes: int, seed: np.random.SeedSequence):
        variance, anchors = case['variance_m2'], case['anchors']
        self._std = math.sqrt(variance)
        count = worlds * (nodes - anchors)
        mobility_rng, anchor_rng, self._rng, filter_rng = map(
            np.random.default_rng, seed.spawn(4))
        x, y, z = VOLUME
        self._mobility = RandomWaypoint(RandomWaypointConfig(
            area_x=x, area_y=y, area_z=z, min_speed=SPEED[0], max_speed=SPEED[1]), count,
            mobility_rng)
        self._anchors = np.repeat(
            anchor_rng.random((worlds, anchors, 3)) * VOLUME, nodes - anchors, axis=0)
        self.position = self._mobility.state.position
        self.schedule = Schedule(count)
        self._ekf = Ekf(
            Ekf.Config(notice_turns=True, **SCHEMES[case['scheme']]),
            Channel(RadioConfig(range_std=self._std), EvidenceConfig(
                outlier_fraction=0.0, range_calibration='off')),
            motion_model(MotionConfig(
                motion_model='velocity', acceleration_std=ACCELERATION_STD,
                max_speed=SPEED[1]), 3, False),
            count, 3, filter_rng)
        self._stamp = 0.0

    def step(self) -> Observation:
        """Let one base period pass, and return what the vehicles hear of their anchors."""
        self.position = self._mobility.step(1.0).position
        self._stamp += 1.0
        vehicles, anchors, dimension = self._anchors.shape
        heard = Observation.empty(vehicles, anchors, dimension, self._stamp)
        heard.sender[:] = np.arange(anchors)
        heard.position[:] = self._anchors
        distance = np.linalg.norm(self.position[:, None] - self._anchors, axis=2)
        heard.range[:] = distance + self._std * self._rng.standard_normal(distance.shape)
        return self.schedule.pass_on(heard)

    def localize(self, heard: Observation) -> Estimate:
        """Return where the vehicles are, which ask for their next beacons."""
        self._ekf.predict(Motion(1.0))
        estimate = self._ekf.update(heard)
        if estimate.period_factor is not None:
            for vehicle in np.flatnonzero(estimate.period_factor != self.schedule.factor).tolist():
                self.schedule.ask(vehicle, int(estimate.period_factor[vehicle]))
        return estimate


def _gather(results: Sequence[Result]) -> dict[tuple[float, int, str], dict[str, Array]]:
    """Return the columns of each case, all its runs one after the other."""
    return {(variance, anchors, scheme): {
        name: np.concatenate([outcome.rows[name] for outcome in outcomes])
        for name in outcomes[0].rows}
        for (variance, anchors, scheme), outcomes in by_case(results).items()}


_SMALL: dict[str, Any] = {'runs': 1, 'worlds': 1, 'epochs': 30}
_NOISE: dict[str, Any] = {'variances': (1.0, 2.0, 3.0, 5.0, 7.0, 10.0)}
_DENSITY: dict[str, Any] = {'shares': (0.2, 0.3, 0.4, 0.5, 0.6)}
_FIGURES: dict[str, tuple[str, dict[str, Any]]] = {
    'track': ('the error of an adaptive beacon period over time', {'runs': 1, 'worlds': 5}),
    'error': ('the error of an adaptive beacon period', {}),
    'noise': ('the error of an adaptive beacon period against the noise of ranges', _NOISE),
    'density': ('the error of an adaptive beacon period against the share of anchors', _DENSITY),
    'traffic': ('the air cost of an adaptive beacon period against the share of anchors',
                _DENSITY),
    'score': ('error and air cost of an adaptive beacon period taken together', _NOISE),
}
# Each figure at full size, and at one that takes seconds.
ADAPTIVE: dict[str, tuple[AdaptivePeriod, AdaptivePeriod]] = {
    f'adaptive_{shown}': (
        AdaptivePeriod(title, shown, **swept),
        AdaptivePeriod(title, shown, **_SMALL, **{
            name: values[::2] for name, values in swept.items() if name not in _SMALL}))
    for shown, (title, swept) in _FIGURES.items()
}
