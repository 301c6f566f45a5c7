"""
What an epoch of the radio medium costs as the world grows, beside all pairs of distances.

    python test/benchmark/run.py medium

Anchors stand one to a square kilometre and vehicles drive four to one, with a radio range of 1 km,
so that each vehicle hears a handful of anchors in a world of any size. An epoch is all that
`World.step` does: movement, odometry, and who hears whom; the medium is `receive` alone. All pairs
are reckoned for blocks of vehicles, as the whole would not fit into memory.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
import time
from typing import Any

from goals import Goal, Section
import numpy as np
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.relay import Poses
from tsmcl_ros.types import Observation
from tsmcl_ros.world import make_world, receive

# Vehicles and anchors; the goals are for the third.
SIZES = ((625, 156), (2500, 625), (10_000, 2500), (40_000, 10_000))
FULL = SIZES[2]
RANGE = 1000.0
BLOCK = 500
REPEAT = 5


class Drive:
    """A world that remembers its last epoch."""

    def __init__(self, vehicles: int, anchors: int) -> None:
        """Make a world as wide as its anchors want."""
        rows = round(anchors ** 0.5)
        side = 1000.0 * rows
        self.world = make_world({
            'vehicles': vehicles, 'anchor_rows': rows, 'anchor_columns': anchors // rows,
            'anchor_spacing': 1000.0, 'area_x': side, 'area_y': side, 'radio_range': RANGE,
        }, np.random.default_rng(1))
        self.epoch = self.world.step()
        self._channel = Channel(RadioConfig(radio_range=RANGE))
        self._rng = np.random.default_rng(1)

    def medium(self) -> Observation:
        """Let vehicles hear anchors."""
        return receive(self._channel, self.epoch.position, self.world.anchors, self._rng, 0.0)

    def alone(self) -> Observation:
        """Let a period pass in which vehicles hear anchors."""
        self.epoch = self.world.step()
        return self.epoch.observation

    def together(self) -> Observation:
        """Let a period pass in which vehicles hear each other, too."""
        position = self.epoch.position
        self.epoch = self.world.step(poses=Poses(
            np.full(len(position), self.epoch.stamp), position,
            np.broadcast_to(np.eye(2), (len(position), 2, 2))))
        return self.epoch.observation

    def all_pairs(self) -> int:
        """Return how many pairs of vehicle and anchor are in range, by all distances."""
        position, place = self.epoch.position, self.world.anchors.position[0]
        return sum(
            int((np.square(position[begin:begin + BLOCK, None] - place).sum(axis=2)
                 <= RANGE ** 2).sum())
            for begin in range(0, len(position), BLOCK))


def measure() -> Section:
    """Time epochs of worlds of several sizes."""
    rows = [['vehicles', 'anchors', 'medium', 'epoch', 'heard by each', 'and vehicles',
             'heard by each', 'all pairs']]
    epochs, cooperative = [], []
    for vehicles, anchors in SIZES:
        drive = Drive(vehicles, anchors)
        jobs: list[Callable[[], Any]] = [drive.medium, drive.alone, drive.together]
        if vehicles <= FULL[0]:
            jobs.append(drive.all_pairs)
        medium, alone, together, *pairs = _in_turns(jobs)
        epochs.append(alone)
        cooperative.append(together)
        rows.append([
            f'{vehicles}', f'{drive.world.anchors.sender.size}', f'{1e3 * medium:.1f} ms',
            f'{1e3 * alone:.1f} ms', _heard(drive.alone()),
            f'{1e3 * together:.1f} ms', _heard(drive.together()),
            *(f'{1e3 * each:.0f} ms' for each in pairs or [])])
        rows[-1] += [''] * (len(rows[0]) - len(rows[-1]))
    full = SIZES.index(FULL)
    size = f'{FULL[0]} vehicles and {FULL[1]} anchors'
    return Section(
        'Radio medium',
        'What an epoch of the simulated world costs, by processor time: the medium alone, the '
        'epoch, and that with vehicles that hear each other, too. Anchors stand one to a square '
        'kilometre, vehicles drive four to one, and the radio reaches 1 km. All pairs: the '
        'distances alone, in blocks.', [rows], [
            Goal(f'an epoch of {size}', 1e3 * epochs[full], 100, unit='ms'),
            Goal('the same where vehicles hear each other, too', 1e3 * cooperative[full], 100,
                 unit='ms',
                 reason='Each vehicle hears 17 others, and up to 45 in the middle, to which the '
                 'tables are padded: to fill them takes 28 % of the time, the search for 170 000 '
                 'pairs 26 %.'),
            Goal('exponent of growth of an epoch, from 2500 vehicles to 40 000',
                 _exponent(epochs[1:]), 1.15),
            Goal('the same where vehicles hear each other, too', _exponent(cooperative[1:]),
                 1.15),
        ])


def _in_turns(jobs: list[Callable[[], Any]]) -> list[float]:
    """Return the median processor time of each job [s]."""
    times: list[list[float]] = [[] for _ in jobs]
    for _ in range(REPEAT):
        for work, found in zip(jobs, times, strict=True):
            begin = time.process_time()
            work()
            found.append(time.process_time() - begin)
    return [median(found) for found in times]


def _exponent(times: list[float]) -> float:
    """Return by which power of the vehicles the time grows, up to the largest world."""
    vehicles = [count for count, _ in SIZES[-len(times):]]
    return float(np.polyfit(np.log(vehicles), np.log(times), 1)[0])


def _heard(observation: Observation) -> str:
    count = observation.heard.sum(axis=1)
    return f'{count.mean():.1f}, at most {count.max()}'
