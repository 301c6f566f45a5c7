"""
Vehicles that are kidnapped, misinformed, deaf for a while, or that meet other anchors.

    python test/reliability/run.py lost

A dozen vehicles drive among 16 anchors, in worlds whose seeds nothing was tuned on. An epoch of a
vehicle is good if its estimate is shown as LOST or STALE, or else is consistent: its NEES stays
below the 95 % quantile of its chi-squared distribution. What is more cautious than needed is no
lie; how much is, below the 5 % quantile, is told beside it. Wrong are epochs that are shown as OK
although their NEES is above the 99.9 % quantile, which one in a thousand is by chance. A vehicle
has recovered in the first epoch, after it was given what it needs, in which it is OK and
consistent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from goals import Goal, Section
import numpy as np
from tsmcl_ros.config import load_yaml
from tsmcl_ros.evaluation.metrics import chi_squared_quantile, normalized_error_squared
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.health import OK
from tsmcl_ros.types import Array, Observation, Prior
from tsmcl_ros.world import anchor_table, AnchorConfig, Epoch, lay_out, make_world, World

CONFIG = Path(__file__).resolve().parents[2] / 'config'
SEEDS = (101,)
VEHICLES, SETTLING, SILENCE, AFTER = 12, 40, 60, 30
RECOVERY = 20  # epochs
HIGH, LOW, WRONG = (chi_squared_quantile(share, 2) for share in (0.95, 0.05, 0.999))

RANGES: dict[str, Any] = {'radio_range': 1500.0, 'measure_range': True, 'range_std': 2.0}
SLOW = {'min_speed': 1.0, 'max_speed': 15.0}
CRUISING = {'motion_model': 'velocity', 'acceleration_std': 3.0}
RANGE_FREE = {**load_yaml(CONFIG / 'range_free.yaml'), 'odom_heading': 'known'}
REASONS = {
    'ranges, odometry': '',
    'ranges, odometry of any heading': '',
    'ranges, no odometry': '',
    'range-free, odometry': 'A vehicle or two in 72 hold a place beside theirs that fits who is '
                            'heard and who is silent. 200 particles lie thin there: with 1000 the '
                            'confidently wrong epochs of cooperative among other anchors fall '
                            'from 3.8 to 0 %.',
    'range-free, no odometry': 'Positions known to some 200 m lie along arcs, and velocities not '
                               'at all known, which a Gaussian describes badly.',
}
# By name: what the world has, the localizer, and the methods.
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any], tuple[str, ...]]] = {
    'ranges, odometry': (
        RANGES, {'radio_range': 1500.0, 'odom_std': 0.5, 'odom_heading': 'known'},
        ('ts_mcl', 'r_mcl', 'cooperative', 'ekf')),
    'ranges, odometry of any heading': (
        {**RANGES, 'odom_heading': 'unknown'}, {'radio_range': 1500.0, 'odom_std': 0.5},
        ('ts_mcl', 'r_mcl')),
    'ranges, no odometry': (
        RANGES | SLOW, {'radio_range': 1500.0} | CRUISING,
        ('ts_mcl', 'r_mcl', 'cooperative', 'ekf')),
    'range-free, odometry': (
        {'radio_range': 1000.0}, RANGE_FREE, ('ts_mcl', 'r_mcl', 'cooperative', 'ekf')),
    'range-free, no odometry': (
        {'radio_range': 1000.0} | SLOW, RANGE_FREE | CRUISING, ('ts_mcl', 'ekf')),
}


@dataclass(frozen=True, eq=False)
class Heard:
    """What V vehicles are told in an epoch, and where they are (V, 2) [m]."""

    observation: Observation
    odometry: Array
    yaw: Array
    position: Array


class Scenario:
    """
    What happens to the vehicles.

    Attributes
    ----------
    begin, end : int
        Epochs in which the vehicles have what they need again, and of the run's end.

    """

    begin, end = SETTLING, SETTLING + AFTER

    def tell(self, number: int, epoch: Epoch, world: World, localizer: Localizer) -> Heard:
        """Return what the vehicles are told in an epoch."""
        return Heard(epoch.observation, epoch.odom_position, epoch.odom_yaw, epoch.position)


class Kidnapped(Scenario):
    """Every vehicle is carried to where another one is, which no odometry notices."""

    def tell(self, number: int, epoch: Epoch, world: World, localizer: Localizer) -> Heard:
        """Return what the vehicles are told in an epoch."""
        other = np.roll(np.arange(VEHICLES), VEHICLES // 2)
        told = super().tell(number, epoch, world, localizer)
        if number < SETTLING:
            self._jump = told.odometry - told.odometry[other]
            return told
        return Heard(told.observation.of(other), told.odometry[other] + self._jump,
                     told.yaw[other], told.position[other])


class Misinformed(Scenario):
    """Every vehicle is started where another one is, to within 5 m."""

    begin, end = 0, AFTER

    def tell(self, number: int, epoch: Epoch, world: World, localizer: Localizer) -> Heard:
        """Return what the vehicles are told in an epoch."""
        if number == 0:
            for vehicle, place in enumerate(np.roll(epoch.position, VEHICLES // 2, axis=0)):
                localizer.initial_pose(Prior(vehicle, place, 25.0 * np.eye(2), 0.0, 0.1))
        return super().tell(number, epoch, world, localizer)


class Deaf(Scenario):
    """Nobody hears anything for some epochs."""

    def __init__(self, first: int, count: int):
        self.first, self.begin = first, first + count
        self.end = self.begin + AFTER

    def tell(self, number: int, epoch: Epoch, world: World, localizer: Localizer) -> Heard:
        """Return what the vehicles are told in an epoch."""
        told = super().tell(number, epoch, world, localizer)
        if self.first <= number < self.begin:
            nothing = Observation.empty(VEHICLES, 0, 2, epoch.stamp)
            told = replace(told, observation=nothing)
        return told


class Replaced(Scenario):
    """Other anchors stand elsewhere; the vehicles still have the map of the former ones."""

    def tell(self, number: int, epoch: Epoch, world: World, localizer: Localizer) -> Heard:
        """Return what the vehicles are told in an epoch."""
        if number == SETTLING - 1:
            others = anchor_table(lay_out(AnchorConfig(), 2, np.random.default_rng(number)))
            world.anchors = replace(others, sender=others.sender + 100)
        return super().tell(number, epoch, world, localizer)


SCENARIOS: dict[str, Callable[[], Scenario]] = {
    'nothing happens': lambda: Deaf(0, 0),
    'kidnapped': Kidnapped,
    'wrong initial pose': Misinformed,
    'no beacon at the start': lambda: Deaf(0, SETTLING),
    f'anchors silent for {SILENCE} s': lambda: Deaf(SETTLING, SILENCE),
    'all anchors replaced': Replaced,
}


@dataclass(frozen=True, eq=False)
class Outcome:
    """
    What became of V vehicles in T epochs.

    Attributes
    ----------
    ok : (T, V) bool
        Whether they are shown as OK.
    nees : (T, V) float
        NaN where there is no estimate.
    begin : int
        Epoch from which they have what they need.
    broken : int
        Estimates that turned NaN once there was one, or that were shown as OK without one.

    """

    ok: Array
    nees: Array
    begin: int
    broken: int

    @property
    def good(self) -> float:
        """Share of epochs that are consistent or not shown as OK."""
        return float(np.mean(~self.ok | (self.nees <= HIGH)))

    @property
    def cautious(self) -> float:
        """Share of the epochs shown as OK that are less certain than they could be."""
        return float(np.mean(self.nees[self.ok] < LOW))

    @property
    def wrong(self) -> float:
        """Share of epochs that are shown as OK, and confidently wrong."""
        return float(np.mean(self.ok & (self.nees > WRONG)))

    @property
    def recovery(self) -> Array:
        """Epochs until the vehicles (V,) have recovered, inf where they do not."""
        back = (self.ok & (self.nees <= HIGH))[self.begin:]
        return np.where(back.any(axis=0), back.argmax(axis=0), np.inf)


def measure() -> Section:
    """Let all of it happen to the vehicles of every method."""
    rows, goals = [], []
    for kind, (_, _, methods) in KINDS.items():
        for method in methods:
            found = {name: [run(kind, method, scenario(), seed) for seed in SEEDS]
                     for name, scenario in SCENARIOS.items()}
            rows.append([f'{method}, {kind}', *(_cell(parts) for parts in found.values())])
            worst = min(found, key=lambda name: _mean(found[name], 'good'))
            goals.append(Goal(
                f'{method}, {kind}: good epochs in the worst scenario, {worst}',
                100 * _mean(found[worst], 'good'), 90.0, 'at least', '%', REASONS[kind]))
            late = sum(int((part.recovery >= RECOVERY).sum())
                       for parts in found.values() for part in parts)
            count = len(SEEDS) * len(found) * VEHICLES
            goals.append(Goal(
                f'{method}, {kind}: vehicles recovered within {RECOVERY} epochs',
                100 * (1 - late / count), 100.0, 'at least', '%', REASONS[kind]))
            goals.append(Goal(f'{method}, {kind}: NaN once placed',
                              sum(part.broken for parts in found.values() for part in parts), 0))
    return Section(
        'Lost and found',
        f'{VEHICLES} vehicles a run, seeds {", ".join(map(str, SEEDS))}, a beacon a second. Cells '
        'hold the share of good epochs, of confidently wrong ones, and of those OK that are more '
        'cautious than needed; and in how many epochs the median vehicle and the 95th of 100 '
        'recovered. Good are epochs that are shown as LOST or STALE, or whose NEES is below its '
        '95 % quantile; wrong those shown as OK with a NEES above its 99.9 % quantile; cautious '
        'those below the 5 % quantile. Vehicles without odometry turn at waypoints at up to '
        '15 m/s.',
        [[['% good / wrong / cautious; epochs', *SCENARIOS], *rows]], goals)


def run(kind: str, method: str, scenario: Scenario, seed: int) -> Outcome:
    """Let something happen to the vehicles of a method."""
    outside, inside, _ = KINDS[kind]
    world = make_world({'vehicles': VEHICLES, 'odom_noise': 0.5, **outside},
                       np.random.default_rng(seed))
    localizer = Localizer({**inside, 'method': method, 'seed': seed}, VEHICLES)
    localizer.anchor_map(world.anchors)
    odometry = inside.get('motion_model') != 'velocity'
    ok, nees = np.zeros((2, scenario.end, VEHICLES))
    for number in range(scenario.end):
        told = scenario.tell(number, world.step(), world, localizer)
        estimate = localizer.epoch(
            told.observation, told.odometry if odometry else None,
            told.yaw if odometry else None)
        ok[number] = localizer.status == OK
        known = np.isfinite(estimate.mean).all(axis=1)
        nees[number] = np.nan
        nees[number, known] = normalized_error_squared(
            (estimate.mean - told.position)[known], estimate.covariance[known])
    placed = np.logical_or.accumulate(np.isfinite(nees))
    broken = int((np.isnan(nees) & (placed | (ok > 0))).sum())
    return Outcome(ok > 0, nees, scenario.begin, broken)


def _mean(parts: list[Outcome], name: str) -> float:
    return float(np.mean([getattr(part, name) for part in parts]))


def _cell(parts: list[Outcome]) -> str:
    shares = ' / '.join(f'{100 * _mean(parts, name):.1f}'
                        for name in ('good', 'wrong', 'cautious'))
    epochs = np.concatenate([part.recovery for part in parts])
    return f'{shares}; {np.median(epochs):.0f}, {_rank(epochs, 0.95):.0f}'


def _rank(values: Array, share: float) -> float:
    """Return the value that so large a share does not exceed; it may be inf."""
    return float(np.sort(values)[int(np.ceil(share * len(values))) - 1])
