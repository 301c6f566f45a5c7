"""
Strangers among the anchors, and nodes that must not run without DDS security.

    python test/reliability/run.py speakers
"""

from __future__ import annotations

from dataclasses import replace
import itertools
import os
from pathlib import Path
import subprocess
import sys

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / 'benchmark'))
from goals import Goal, Section  # noqa: E402, I100
from tsmcl_ros.localizer import Localizer  # noqa: E402
from tsmcl_ros.types import Observation, VEHICLE  # noqa: E402

METHODS = ('ts_mcl', 'mcl', 'r_mcl', 'cooperative', 'ekf')
ANCHORS, STRANGERS = 6, 6
RUNS, EPOCHS = 5, 40
SIDE, NOISE = 100.0, 3.0  # m
LISTS = {'anchor_allowlist': ('map', f'0-{ANCHORS - 1}'), 'vehicle_allowlist': ('7',)}
# What the environment may say of security, short of all that it takes.
ENVIRONMENT = {'ROS_SECURITY_ENABLE': (None, 'false', 'True'),
               'ROS_SECURITY_STRATEGY': (None, 'Permissive', 'Enforce'),
               'ROS_SECURITY_KEYSTORE': (None, '')}
NODES = ('localizer', 'fleet', 'anchor')


class Drive:
    """
    A drive among anchors and strangers.

    Parameters
    ----------
    seed : int
        Of where all are.

    Attributes
    ----------
    map : Observation
        Of the anchors (V = 1).

    """

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng([8, seed])
        self.map = Observation.empty(1, ANCHORS, 2, 0.0)
        self.map.sender[0] = np.arange(ANCHORS)
        self.map.position[0] = self._rng.uniform(0, SIDE, (ANCHORS, 2))
        turn = 2 * np.pi * np.arange(EPOCHS)[:, None] / EPOCHS + [0, -np.pi / 2]
        self.place = SIDE / 2 + SIDE / 4 * np.cos(turn)
        self._scans = [self._heard(float(epoch)) for epoch in range(EPOCHS)]

    def run(self, method: str, strangers: bool, **settings: object
            ) -> tuple[np.ndarray, float, Localizer]:
        """Return all estimates (T, 2) [m], their RMSE [m], and the localizer."""
        localizer = Localizer({'method': method, 'seed': 1, 'range_std': NOISE,
                               'motion_model': 'velocity', 'radio_range': 1.5 * SIDE, **settings})
        localizer.anchor_map(self.map)
        for scan in self._scans:
            rows = np.arange(ANCHORS + STRANGERS if strangers else ANCHORS)
            localizer.beacons(0, scan.columns(rows))
        means = np.array([estimate.mean[0] for estimate in localizer.finish()])
        error = np.linalg.norm(means - self.place, axis=1)[EPOCHS // 4:]
        return means, float(np.sqrt(np.mean(error ** 2))), localizer

    def _heard(self, stamp: float) -> Observation:
        """Return what the anchors say, and then strangers, half of whom say they are vehicles."""
        rng, place = self._rng, self.place[int(stamp)]
        scan = Observation.empty(1, ANCHORS + STRANGERS, 2, stamp)
        scan.sender[0] = [*range(ANCHORS), *rng.integers(100, 2**32, STRANGERS)]
        scan.position[0, :ANCHORS] = self.map.position[0]
        scan.position[0, ANCHORS:] = rng.uniform(0, SIDE, (STRANGERS, 2))
        scan.range[0] = np.linalg.norm(scan.position[0] - place, axis=1)
        scan.range[0, ANCHORS:] = rng.uniform(0, SIDE, STRANGERS)
        scan.range[0] += rng.normal(0, NOISE, ANCHORS + STRANGERS)
        scan.kind[0, ANCHORS + STRANGERS // 2:] = VEHICLE
        scan.covariance[0, scan.kind[0] == VEHICLE] = np.eye(2)
        return replace(scan, range=np.maximum(scan.range, 0))


def _starts(node: str, environment: dict[str, str | None]) -> bool:
    """Tell whether a node that requires security does anything but refuse, in one line."""
    variables = {name: value for name, value in (os.environ | environment).items()
                 if value is not None}
    done = subprocess.run(
        [sys.executable, '-m', f'tsmcl_ros.nodes.{node}', '--ros-args', '-p',
         'require_security:=true'], env=variables, capture_output=True, text=True, timeout=60)
    lines = [line for line in done.stderr.splitlines() if line.startswith(f'{node}: ')]
    return done.returncode != 1 or len(lines) != 1


def measure() -> Section:
    """Drive among strangers with the lists and without, and start nodes without security."""
    table = [['method', 'epochs', 'RMSE without strangers', 'with, listed', 'with, not listed',
              'epochs that strangers changed', 'beacons ignored', 'of']]
    changed, uncounted = 0, 0
    for method in METHODS:
        errors: list[list[float]] = []
        differing, counted = 0, 0
        for run in range(RUNS):
            drive = Drive(run)
            clean, *_ = alone = drive.run(method, strangers=False)
            listed = drive.run(method, strangers=True, **LISTS)
            errors.append([alone[1], listed[1], drive.run(method, strangers=True)[1]])
            pairs = zip(clean, listed[0], strict=True)
            differing += sum((one != other).any() for one, other in pairs)
            counted += int(listed[2].speakers.ignored.sum())
        sent = RUNS * EPOCHS * STRANGERS
        table.append([method, f'{RUNS * EPOCHS}',
                      *(f'{error:.2f} m' for error in np.mean(errors, axis=0)),
                      f'{differing}', f'{counted:,}', f'{sent:,}'])
        changed, uncounted = changed + differing, uncounted + sent - counted
    tried = [(node, dict(zip(ENVIRONMENT, values, strict=True)))
             for node, values in zip(itertools.cycle(NODES), itertools.product(
                 *ENVIRONMENT.values()), strict=False)]
    started = sum(_starts(node, environment) for node, environment in tried)
    return Section(
        'Who may speak',
        f'{ANCHORS} anchors and as many strangers, with other ids in every epoch, who say that '
        'they are anywhere, at any distance, half of them as vehicles. Then nodes that require '
        f'security in {len(tried)} environments that are short of it.',
        [table], [
            Goal('epochs that strangers changed by a bit', changed, 0),
            Goal("strangers' beacons that were not counted", uncounted, 0),
            Goal(f'of {len(tried)} nodes without security, did not refuse in one line', started,
                 0)])


if __name__ == '__main__':
    print(measure().plain())
