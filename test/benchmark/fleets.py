"""
How long an update takes: one vehicle with 200 particles and 6 references, and fleets.

    python test/benchmark/run.py fleets

The vehicles drive among six anchors; each is a reference in every epoch, heard or silent. An
update is all that the localizer does with an epoch: silence, odometry, prediction, the method.
Trust the ratios rather than the times: the floor is what drawing the prediction's two random
numbers a particle takes on the same machine.
"""

from __future__ import annotations

from statistics import median
import time

from goals import Section
import numpy as np
from timing import seconds
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.world import Epoch, make_world

PARTICLES = 200
WORLD = {
    'anchor_rows': 2, 'anchor_columns': 3, 'area_x': 3000.0, 'area_y': 2000.0,
    'radio_range': 1000.0}
COMMON = {
    'min_particles': PARTICLES, 'max_particles': 2000, 'radio_range': 1000.0,
    'edge_softness': 1.0, 'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 0.5,
    'alpha3': 0.0, 'alpha4': 0.0}
METHODS = {
    'ts_mcl': {'method': 'ts_mcl'},
    'ts_mcl, search off': {'method': 'ts_mcl', 'max_iterations': 0},
    'mcl': {'method': 'mcl'},
}
# Vehicles, and epochs to time after those in which they are placed and first found.
FLEETS = {1: 300, 40: 100, 1000: 10}
SETTLING = 30


def measure() -> Section:
    """Time updates of fleets of several sizes."""
    headings = ['an update, and of it a particle', *(f'V = {count}' for count in FLEETS)]
    cells: dict[str, list[str]] = {name: [] for name in [*METHODS, 'random numbers']}
    for vehicles, count in FLEETS.items():
        world = make_world({**WORLD, 'vehicles': vehicles}, np.random.default_rng(1))
        anchors, epochs = world.anchors, [world.step() for _ in range(SETTLING + count)]
        for name, settings in METHODS.items():
            localizer = Localizer({**COMMON, **settings}, vehicles)
            localizer.anchor_map(anchors)
            cells[name].append(_cell(_update(localizer, epochs), vehicles))
        cells['random numbers'].append(_cell(_floor(vehicles), vehicles))
    return Section(
        'Fleets',
        f'An update of {PARTICLES} particles by 6 references, by processor time: all that the '
        "localizer does with an epoch. The floor is drawing the prediction's two random numbers.",
        [[headings, *([name, *texts] for name, texts in cells.items())]])


def _update(localizer: Localizer, epochs: list[Epoch]) -> float:
    """Return the median processor time of an update [s]."""
    times = []
    for epoch in epochs:
        begin = time.process_time()
        localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
        times.append(time.process_time() - begin)
    return median(times[SETTLING:])


def _floor(vehicles: int) -> float:
    """Return the time of drawing the prediction's random numbers [s]."""
    rng = np.random.Generator(np.random.SFC64(1))
    shape = vehicles, PARTICLES, 2
    return seconds(lambda: rng.standard_normal(shape, np.float32), 100)


def _cell(time_taken: float, vehicles: int) -> str:
    each = 1e9 * time_taken / vehicles / PARTICLES
    return f'{1e3 * time_taken:.3f} ms {each:7.1f} ns'

