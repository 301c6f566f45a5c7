"""The error of a UAV that is no longer observed: grey azimuth and EKF, against extrapolations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tsmcl_ros.evaluation.experiments.common import as_rows, by_case, rmse, side_by_side
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
    Stopwatch,
)
from tsmcl_ros.model.azimuth import AzimuthLead, VALUES
from tsmcl_ros.model.gaussian import azimuth_of, constant_velocity, predict, update
from tsmcl_ros.model.grey import predict_grey
from tsmcl_ros.model.mobility import wrap
from tsmcl_ros.model.motion import MotionConfig, VelocityMotion
from tsmcl_ros.types import Array

START = np.array([170.4157, 125.6284])  # m, seen from a station at the origin
HEADING = math.radians(55)
SPEED = 8.0  # m/s
AZIMUTH_STD = math.radians(2)
# What is known of the UAV when it is seen first, standard deviations [m], [m/s].
KNOWN = np.array([5.0, 5.0, 1.0, 1.0])
THRESHOLD = AZIMUTH_STD
SHOWN = {
    'grey_ekf': 'grey azimuth and EKF',
    'grey_coordinates': 'grey coordinates',
    'grey_smoothed': 'grey coordinates, smoothed',
    'constant_velocity': 'constant velocity',
    'seen': 'seen all the time',
}
BASELINES = ('grey_coordinates', 'grey_smoothed', 'constant_velocity')


class Belief(NamedTuple):
    """Mean (V, 4) and covariance (V, 4, 4) of position and velocity."""

    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Grey:
    """
    The error of a UAV against the time for which it is not observed (Zhuo et al.).

    It flies straight, turns at A or does not, and is lost at B. A station at the origin observes
    its azimuth each second, so that nothing is ever measured along the line of sight.

    Attributes
    ----------
    turn : float
        At A [deg].
    runs, vehicles : int
        Runs, and UAVs in each, which are as many Monte-Carlo runs.
    turned_at, lost_at, horizon : int
        A, B and the time after B that is looked at [s].
    disturbed : int
        Time around A in which each second displaces the UAV by Rayleigh(1) metres [s].
    acceleration_std : float
        Of the EKF [m/s^1.5].

    """

    turn: float
    runs: int = 10
    vehicles: int = 500
    turned_at: int = 15
    lost_at: int = 20
    horizon: int = 20
    disturbed: int = 5
    acceleration_std: float = 0.5

    @property
    def title(self) -> str:
        """Say in one line what is tried."""
        way = f'that has turned by {self.turn:g} deg' if self.turn else 'on a straight way'
        return f'error of a UAV {way} against the time for which its azimuth is not observed'

    def cases(self) -> list[Case]:
        """Return who predicts."""
        return [{'predictor': name} for name in SHOWN]

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Let UAVs fly, follow them until they are lost, and predict where they go."""
        rng = np.random.default_rng(seed)
        truth = self._fly(rng)
        azimuth = np.arctan2(truth[:, :, 1], truth[:, :, 0])
        azimuth = azimuth + AZIMUTH_STD * rng.standard_normal(azimuth.shape)
        start = np.tile([*START, *SPEED * _direction(HEADING)], (self.vehicles, 1))
        start += KNOWN * rng.standard_normal(start.shape)
        watch = Stopwatch()
        with watch:
            predicted = self._predict(case['predictor'], azimuth, start)
        off = predicted - truth[self.lost_at + 1:]
        sight = truth[self.lost_at + 1:]
        sight = sight / np.linalg.norm(sight, axis=2, keepdims=True)
        across = off[:, :, 1] * sight[:, :, 0] - off[:, :, 0] * sight[:, :, 1]
        return Outcome(as_rows(
            'horizon_s', 'vehicle', error_m=np.linalg.norm(off, axis=2),
            along_m=(off * sight).sum(axis=2), across_m=across), watch.seconds)

    def judge(self, results: Sequence[Result]) -> Report:
        """Return a table of the errors, and the paper's claim and ours beside them."""
        curves = {name: self._curve(results, name, 'error_m') for name in SHOWN}
        half = self.horizon // 2
        headings = ['predictor', f'mean error 1-{self.horizon} s [m]', f'at {half} s [m]',
                    f'at {self.horizon} s [m]', f'along the sight at {self.horizon} s [m]',
                    'across [m]']
        rows = [[
            SHOWN[name], str(bootstrap_interval(np.mean, error)),
            str(bootstrap_interval(np.mean, error[half - 1:half])),
            str(bootstrap_interval(np.mean, error[-1:])),
            *(significant(float(rmse(self._curve(results, name, part)[-1])))
              for part in ('along_m', 'across_m'))] for name, error in curves.items()]
        return Report([headings, *rows], 1, [
            *(self._compared(curves, other) for other in BASELINES), self._unseen(results)])

    def draw(self, results: Sequence[Result], path: Path) -> None:
        """Draw the errors against the horizon, in all and along and across the line of sight."""
        from tsmcl_ros.evaluation import plots

        figure, axes = plots.panels(3, 14.0, 4.6)
        for ax, name, quantity in zip(
                axes, ('error_m', 'along_m', 'across_m'),
                ('RMSE [m]', 'RMSE along the line of sight [m]', 'RMSE across [m]'), strict=True):
            plots.error_against_epoch(
                ax, {SHOWN[case]: rmse(self._curve(results, case, name), axis=1)
                     for case in SHOWN}, quantity, {}, legend=name == 'error_m',
                epoch='time since the last observation [s]')
        plots.save_png(figure, path)

    def _fly(self, rng: np.random.Generator) -> Array:
        """Return positions (T, V, 2) [m], a second apart."""
        time = np.arange(self.lost_at + self.horizon)
        heading = HEADING + math.radians(self.turn) * (time >= self.turned_at)
        steps = np.tile(SPEED * _direction(heading).T[:, None], (1, self.vehicles, 1))
        near = np.abs(time - self.turned_at) <= self.disturbed / 2
        shape = int(near.sum()), self.vehicles
        steps[near] += rng.rayleigh(1.0, shape)[:, :, None] * np.moveaxis(
            _direction(rng.uniform(0, 2 * math.pi, shape)), 0, 2)
        begin = np.broadcast_to(START, (1, self.vehicles, 2))
        return np.concatenate([begin, START + np.cumsum(steps, axis=0)])

    def _predict(self, predictor: str, azimuth: Array, start: Array) -> Array:
        """Return the positions (horizon, V, 2) that are predicted from the azimuths until B."""
        covariance = np.tile(np.diag(KNOWN ** 2), (self.vehicles, 1, 1))
        beliefs = [_observe(Belief(start, covariance), azimuth[0])]
        end = self.lost_at if predictor != 'seen' else self.lost_at + self.horizon
        for measured in azimuth[1:end + 1]:
            beliefs.append(_observe(self._move(beliefs[-1]), measured))
        if predictor == 'seen':
            return np.array([belief.mean[:, :2] for belief in beliefs[self.lost_at + 1:]])
        if predictor in ('grey_coordinates', 'grey_smoothed'):
            if predictor == 'grey_smoothed':
                beliefs = self._smoothed(beliefs)
            series = np.stack([belief.mean[:, :2] for belief in beliefs[-VALUES:]], axis=2)
            return np.array([predict_grey(series, step + 1) for step in range(self.horizon)])
        return self._led(beliefs, predictor == 'grey_ekf')

    def _led(self, beliefs: list[Belief], grey: bool) -> Array:
        """Return the positions (horizon, V, 2) by velocity, led by grey azimuths or not."""
        lead, everybody = AzimuthLead(self.vehicles, 2, THRESHOLD), np.ones(self.vehicles, bool)
        station = np.zeros((self.vehicles, 2))
        for stamp, belief in enumerate(beliefs):
            lead.observe(float(stamp), belief.mean[:, :2], belief.covariance[:, :2, :2], station,
                         everybody)
        belief, positions = beliefs[-1], []
        for step in range(self.horizon):
            belief = self._move(belief)
            if grey:
                belief = Belief(*lead.lead(
                    float(len(beliefs) + step), belief.mean, belief.covariance, everybody))
            positions.append(belief.mean[:, :2])
        return np.array(positions)

    def _smoothed(self, beliefs: list[Belief]) -> list[Belief]:
        """Return what is believed of each moment at the end (Rauch, Tung, Striebel 1965)."""
        transition, _ = self._motion()
        later = beliefs[-1]
        smoothed = [later]
        for belief in reversed(beliefs[:-1]):
            ahead = self._move(belief)
            gain = belief.covariance @ transition.T @ np.linalg.inv(ahead.covariance)
            later = Belief(
                belief.mean + np.einsum('vij,vj->vi', gain, later.mean - ahead.mean),
                belief.covariance + gain @ (later.covariance - ahead.covariance)
                @ np.swapaxes(gain, 1, 2))
            smoothed.append(later)
        return smoothed[::-1]

    def _move(self, belief: Belief) -> Belief:
        return Belief(*predict(*belief, *self._motion()))

    def _motion(self) -> tuple[Array, Array]:
        config = MotionConfig(motion_model='velocity', acceleration_std=self.acceleration_std)
        return constant_velocity(VelocityMotion(config, 2), 1.0)

    def _curve(self, results: Sequence[Result], predictor: str, column: str) -> Array:
        """Return a column (horizon, UAVs) of all runs of a predictor."""
        return side_by_side(by_case(results)[predictor,], 'horizon_s', column)

    def _compared(self, curves: dict[str, Array], other: str) -> Finding:
        """Compare the mean error over the horizon with a baseline's, on the same flights."""
        ratio = ratio_interval(np.mean, curves['grey_ekf'], curves[other])
        claim = 'paper: ' if other == 'grey_coordinates' else 'beyond the paper: '
        return Finding(
            f'{claim}error of grey azimuth and EKF below that of {SHOWN[other]}',
            f'{ratio} of it', '', _verdict(ratio))

    def _unseen(self, results: Sequence[Result]) -> Finding:
        """Say what is left along the line of sight, where one station measures nothing."""
        def interval(name: str, part: str) -> Interval:
            return bootstrap_interval(rmse, self._curve(results, name, part)[-1:])

        return Finding(
            f'one station observes no range: RMSE along the sight after {self.horizon} s',
            f'{interval("grey_ekf", "along_m")} m, across it '
            f'{interval("grey_ekf", "across_m")} m',
            f'with azimuths all the time {interval("seen", "along_m")} m along, '
            f'{interval("seen", "across_m")} m across',
            'no prediction of azimuths can mend it')


def _observe(belief: Belief, azimuth: Array) -> Belief:
    """Return the belief after the station at the origin measured azimuths (V,) [rad]."""
    expected, slope = azimuth_of(belief.mean[:, :2], np.zeros((len(azimuth), 2)))
    gradient = np.concatenate([slope, np.zeros_like(slope)], axis=1)
    return Belief(*update(*belief, gradient, wrap(azimuth - expected),
                          np.full(len(azimuth), AZIMUTH_STD ** 2)))


def _direction(heading: Array | float) -> Array:
    """Return unit vectors (2, ...) of headings [rad]."""
    return np.stack([np.cos(heading), np.sin(heading)])


def _verdict(ratio: Interval) -> str:
    if ratio.high < 1:
        return 'reproduced'
    return 'not distinguishable' if ratio.low <= 1 else 'not reproduced'
