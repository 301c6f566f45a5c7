"""
What an update costs a particle in fleets of 1 to 10 000 vehicles, beside the limit of numpy.

    python test/benchmark/run.py fleets

The vehicles drive among six anchors, with 500 particles each. In `mcl` an anchor is heard within
1000 m or silent, and vehicles move at random, as in the papers; `rssi` measures all six under
shadowing; `ts_mcl` searches for 5 iterations by what `mcl` hears, with odometry.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
import multiprocessing
from statistics import median
import time
from typing import Any
from unittest.mock import patch

from goals import Goal, Section
from limit import limit, PARTICLES
import numpy as np
from timing import seconds
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.methods import METHODS
from tsmcl_ros.world import make_world

WORLD = {
    'anchor_rows': 2, 'anchor_columns': 3, 'area_x': 3000.0, 'area_y': 2000.0,
    'radio_range': 1000.0}
COMMON = {
    'min_particles': 200, 'max_particles': 2000, 'radio_range': 1000.0,
    'edge_softness': 1.0, 'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 0.5,
    'alpha3': 0.0, 'alpha4': 0.0}
SHADOWED = {'radio_model': 'lognormal', 'sensitivity': -130.0}
# By name: what the world has, and the localizer, beside the above.
SCENARIOS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    'mcl': ({}, {'method': 'mcl', 'motion_model': 'random'}),
    'rssi': ({**SHADOWED, 'measure_rssi': True},
             {**SHADOWED, 'method': 'ts_mcl', 'max_iterations': 0, 'motion_model': 'random'}),
    'ts_mcl': ({}, {'method': 'ts_mcl', 'max_iterations': 5}),
}
# Vehicles, and epochs to time after those in which they are placed and first found.
FLEETS = {1: 60, 40: 10, 1000: 3, 10_000: 1}
SETTLING = 3
# ns a particle and update, of the method alone.
BOUNDS = {'mcl': 15.0, 'rssi': 25.0, 'ts_mcl': 150.0}
REASONS = {
    'mcl': 'By cProfile 45 % of an update are redraws, of which there are more than one a '
           'particle (24 % their likelihoods under soft edges, 21 % drawing them), 13 % the first '
           'likelihoods, 10 % the prediction; a tenth of the vehicles, of whose particles hardly '
           'any survives, cause half of the draws.',
    'rssi': 'By cProfile 36 % of an update are the likelihoods, with outliers reckoned in, 20 % '
            'the prediction, 17 % resampling with its jitter, 15 % the covariances.',
    'ts_mcl': 'By cProfile 40 % of an update are the search (18 % its likelihoods, 8 % drawing '
              'neighbours), 20 % the first likelihoods, 16 % the prediction.',
}


def measure() -> Section:
    """Time updates of fleets of several sizes, and in two processes."""
    headings = ['ns a particle and update', *(f'V = {count:,}' for count in FLEETS)]
    costs = {name: [_update(name, *fleet) for fleet in FLEETS.items()] for name in SCENARIOS}
    rows = {f'{name}{what}': [pair[part] for pair in pairs] for name, pairs in costs.items()
            for part, what in enumerate((', the method', ', the whole epoch'))}
    for kind in ('mcl', 'rssi'):
        rows[f'limit of numpy for {kind}'] = [
            _each(limit(kind, *fleet), fleet[0]) for fleet in FLEETS.items()]
    rows['drawing two normal numbers'] = [_each(_floor(count), count) for count in FLEETS]
    limits = {kind: rows[f'limit of numpy for {kind}'][2] for kind in ('mcl', 'rssi')}
    goals = []
    for name, bound in BOUNDS.items():
        methods = [pair[0] for pair in costs[name]]
        beside = (f'The limit, which is less of a filter, took {limits[name]:.0f} ns. '
                  if name in limits else '')
        goals.append(Goal(
            f'{name}, 1000 vehicles with {PARTICLES} particles, a particle and update',
            methods[2], bound, unit='ns', reason=beside + REASONS[name]))
        goals.append(Goal(
            f'{name}, dearest over cheapest of 40, 1000 and 10 000 vehicles',
            max(methods[1:]) / min(methods[1:]), 1.25,
            reason='The calls of numpy cost 40 vehicles as much as 1000.'))
    goals.append(Goal('mcl, two processes, work done over that of one', _scaling(), 1.8,
                      'at least'))
    return Section(
        'Fleets',
        f'An update of {PARTICLES} particles by 6 references, by processor time: predict and '
        'update of the method, and all that the localizer does with an epoch. The limit is the '
        "filter's bare arithmetic in numpy (test/benchmark/limit.py).",
        [[headings, *([name, *(f'{cost:.1f}' for cost in each)] for name, each in rows.items())]],
        goals)


def _update(name: str, vehicles: int, count: int) -> tuple[float, float]:
    """Return the times a particle of the method's update and of the whole epoch [ns]."""
    world_settings, settings = SCENARIOS[name]
    world = make_world({**WORLD, **world_settings, 'vehicles': vehicles},
                       np.random.default_rng(1))
    timed = _timed(METHODS[settings['method']])
    with patch.dict(METHODS, {settings['method']: timed}):
        localizer = Localizer(
            {**COMMON, 'min_particles': PARTICLES, 'max_particles': 2 * PARTICLES, **settings},
            vehicles)
        localizer.anchor_map(world.anchors)
        methods, epochs = [], []
        for _ in range(SETTLING + count):
            epoch = world.step()
            timed.spent, begin = 0.0, time.process_time()
            localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
            epochs.append(time.process_time() - begin)
            methods.append(timed.spent)
    return (_each(median(methods[SETTLING:]), vehicles),
            _each(median(epochs[SETTLING:]), vehicles))


def _timed(method: Any) -> Any:
    """Return a method that adds up the processor time that it has spent [s]."""

    class Timed(method):  # type: ignore[misc]
        spent = 0.0

        def predict(self, motion: Any) -> None:
            begin = time.process_time()
            super().predict(motion)
            Timed.spent += time.process_time() - begin

        def update(self, observation: Any) -> Any:
            begin = time.process_time()
            estimate = super().update(observation)
            Timed.spent += time.process_time() - begin
            return estimate

    return Timed


def _scaling() -> float:
    """Return how much more work two processes do than one, by what an update costs either."""
    with ProcessPoolExecutor(2, multiprocessing.get_context('spawn')) as pool:
        alone = pool.submit(_update, 'mcl', 1000, 5).result()
        both = [pool.submit(_update, 'mcl', 1000, 5) for _ in range(2)]
        return sum(alone[0] / job.result()[0] for job in both)


def _floor(vehicles: int) -> float:
    """Return the time of drawing the prediction's random numbers [s]."""
    rng = np.random.Generator(np.random.SFC64(1))
    shape = vehicles, PARTICLES, 2
    return seconds(lambda: rng.standard_normal(shape, np.float32), 5)


def _each(time_taken: float, vehicles: int) -> float:
    return 1e9 * time_taken / vehicles / PARTICLES
