"""
How long an epoch takes by each method, and how far off its estimates are then.

    python test/benchmark/run.py methods

The vehicles drive among six anchors that they range to 2 m, each a reference in every epoch, with
odometry; particle filters have 200 particles. An epoch is all that the localizer does with it.
The grid has cells of 5 m, and one vehicle.
"""

from __future__ import annotations

from statistics import median
import time

from fleets import COMMON, WORLD
from goals import Section
import numpy as np
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.methods import METHODS
from tsmcl_ros.world import make_world

SPECIAL = {'grid': {'grid_cell': 5.0, 'grid_x_max': 3000.0, 'grid_y_max': 2000.0}}
FLEETS = (1, 40)
EPOCHS, SETTLING = 60, 20


def measure() -> Section:
    """Time every method, alone and in a fleet."""
    rows = [['method', *(f'V = {count}' for count in FLEETS), 'median error']]
    for name in METHODS:
        cells, errors = [], []
        for vehicles in FLEETS:
            if name == 'grid' and vehicles > 1:
                cells.append('')
                continue
            each, errors = _run(name, vehicles)
            cells.append(f'{1e3 * each:.2f} ms a vehicle')
        rows.append([name, *cells, f'{median(errors):.1f} m'])
    return Section(
        'Methods',
        'An epoch by each method, by processor time, and the median error then: six anchors, '
        'ranged to 2 m, with odometry; particle filters have 200 particles, the grid cells of '
        '5 m.', [rows])


def _run(method: str, vehicles: int) -> tuple[float, list[float]]:
    """Return the median processor time of an epoch [s] over V, and the errors [m]."""
    world = make_world(
        {**WORLD, 'vehicles': vehicles, 'measure_range': True, 'range_std': 2.0},
        np.random.default_rng(1))
    localizer = Localizer(
        {**COMMON, 'range_std': 2.0, 'method': method, **SPECIAL.get(method, {})}, vehicles)
    localizer.anchor_map(world.anchors)
    times, errors = [], []
    for number in range(EPOCHS):
        epoch = world.step()
        begin = time.process_time()
        estimate = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
        if number >= SETTLING:
            times.append((time.process_time() - begin) / vehicles)
            errors.extend(
                np.linalg.norm(estimate.mean - epoch.position, axis=1).tolist())
    return median(times), errors

