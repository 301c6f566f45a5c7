"""
Clocks that are wrong, late, or start over, tried on the pipeline of the node and of localize_bag.

    python test/reliability/run.py clocks

What each scenario does to the messages of a drive, test/test_clocks.py shows; here it is done
again and again, with other moments and offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
import sys
from typing import Any

import numpy as np

sys.path += [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / 'benchmark')]
from goals import Goal, Section  # noqa: E402, I100
import test_clocks as clocks  # noqa: E402

RUNS = 10
SECONDS = 40
JUMP = 10.0  # s, time_jump as it comes

Rows = list[tuple[float, str, int, float]]
Scenario = Callable[[np.random.Generator], Rows]


@dataclass(frozen=True)
class Case:
    """
    A scenario.

    Parameters
    ----------
    name : str
    make : callable
        Returns its messages.
    vehicles : int
        V.
    right : sequence of int
        The vehicles with nothing wrong about their clocks, of which nothing may be lost; without
        any, how long the one is not served counts.

    """

    name: str
    make: Scenario
    vehicles: int = 3
    right: Sequence[int] = ()


@dataclass
class Tally:
    """What became of all runs of a scenario."""

    epochs: int = 0
    lost: int = 0
    restarts: int = 0
    refused: int = 0
    stall: float = 0.0
    crashes: int = 0


def offset(rng: np.random.Generator) -> float:
    """Return how wrong a clock is [s]: anything from 15 s to 30 years, either way."""
    return float(rng.choice([-1, 1]) * 10 ** rng.uniform(1.2, 9))


def one_wrong(rng: np.random.Generator) -> Rows:
    """Return a fleet of which one vehicle's clock is wrong all the time."""
    return clocks.wrong(clocks.drive(SECONDS, 3, start=2e9), 1, offset(rng) / 2)


def blips(rng: np.random.Generator, vehicles: int, vehicle: int) -> Rows:
    """Return a drive with ten wrong stamps of one vehicle."""
    rows = clocks.drive(SECONDS, vehicles, start=2e9)
    for moment in rng.uniform(0, SECONDS, 10):
        rows = clocks.wrong(rows, vehicle, offset(rng) / 2, 2e9 + moment, 2e9 + moment + 0.1,
                            [str(rng.choice(['beacons', 'odometry']))])
    return rows


def unset(rng: np.random.Generator) -> Rows:
    """Return a drive in which a fifth of the stamps are zero."""
    return [(*row[:3], 0.0 if rng.random() < 0.2 else row[3])
            for row in clocks.drive(SECONDS, start=2e9)]


def disordered(rng: np.random.Generator) -> Rows:
    """Return a fleet's drive in which a fifth of the messages come again, or late."""
    rows = clocks.drive(SECONDS, 3)
    return [row for number, one in enumerate(rows) for row in (
        [one, rows[max(number - int(rng.integers(0, 100)), 0)]] if rng.random() < 0.2 else [one])]


def late(rng: np.random.Generator) -> Rows:
    """Return a drive whose beacons come up to 5 s late, all by the same."""
    delay = rng.uniform(1, 5)
    rows = clocks.drive(SECONDS)
    return [row for _, row in sorted(
        (row[0] + delay * (row[1] == 'beacons'), row) for row in rows)]


def jumping(rng: np.random.Generator) -> Rows:
    """Return a fleet whose time jumps back and forth as a whole, five times."""
    starts = 2e9 + np.cumsum(rng.choice([-1, 1], 5) * 10 ** rng.uniform(2, 8, 5))
    return [row for start in starts for row in clocks.drive(10, 3, start=float(np.floor(start)))]


def looped(rng: np.random.Generator) -> Rows:
    """Return a fleet's bag five times over, from some time on."""
    rows = clocks.drive(20, 3, start=float(rng.integers(0, 1000)))
    return rows * 5


def any_rate(rng: np.random.Generator) -> Rows:
    """Return beacons at 1 to 50 Hz that come with a jitter of 0.2 s."""
    rows = clocks.drive(8, rate=float(rng.integers(1, 51)), wheels=float(rng.integers(10, 51)))
    arrival = np.array([row[0] for row in rows]) + rng.uniform(0, 0.2, len(rows))
    for what in ('beacons', 'odometry'):
        own = [index for index, row in enumerate(rows) if row[1] == what]
        arrival[own] = np.maximum.accumulate(arrival[own])
    return [rows[index] for index in np.argsort(arrival, kind='stable')]


CASES = (
    Case('one clock of three wrong all the time', one_wrong, right=(0, 2)),
    Case('ten wrong stamps of one of three', lambda rng: blips(rng, 3, 1), right=(0, 2)),
    Case('ten wrong stamps, a vehicle alone', lambda rng: blips(rng, 1, 0), 1),
    Case('a fifth of the stamps zero', unset, 1),
    Case('a fifth again, or up to 3 s late', disordered, right=(0, 1, 2)),
    Case('beacons 1 to 5 s late', late, 1),
    Case('time jumps back and forth', jumping, right=(0, 1, 2)),
    Case('a bag looped five times', looped, right=(0, 1, 2)),
    Case('beacons at 1 to 50 Hz, jitter 0.2 s', any_rate, 1, right=(0,)),
)


def judge(case: Case, rows: Rows, tally: Tally) -> None:
    """Run the messages, and count what became of them."""
    try:
        told: Any = clocks.run(rows, case.vehicles, outage_period=2.0)
    except Exception as error:  # whatever it is, it is a crash
        print(f'{case.name}: {type(error).__name__}: {error}', file=sys.stderr)
        tally.crashes += 1
        return
    tally.restarts += told.localizer.restarts
    tally.refused += len(told.refused)
    for vehicle in case.right or (0,):
        sent = [row[0] for row in rows if row[1:3] == ('beacons', vehicle)]
        heard = clocks.served(told, vehicle)
        tally.epochs += len(set(sent)) if case.make is disordered else len(sent)
        tally.lost += (len(set(sent)) if case.make is disordered else len(sent)) - len(heard)
        if not case.right:
            # By the time that a right clock shows.
            right = set(sent)
            served = [stamp for stamp in heard if stamp in right]
            tally.stall = max(tally.stall, *np.diff([min(sent), *served, max(sent)]))


def measure() -> Section:
    """Try every scenario many times."""
    table = [['scenario', 'runs', 'epochs', 'lost', 'messages refused', 'restarts',
              'longest stall']]
    crashes, lost, stall = 0, 0, 0.0
    for number, case in enumerate(CASES):
        tally = Tally()
        for run in range(RUNS):
            judge(case, case.make(np.random.default_rng([6, number, run])), tally)
        table.append([case.name, f'{RUNS}', f'{tally.epochs:,}', f'{tally.lost:,}',
                      f'{tally.refused:,}', f'{tally.restarts:,}',
                      '' if case.right else f'{tally.stall:.0f} s'])
        crashes += tally.crashes
        lost += tally.lost if case.right else 0
        stall = max(stall, tally.stall)
    return Section(
        'Time',
        'Beacons at 1 Hz and odometry at 10 Hz unless said otherwise, by ekf, with messages whose '
        'stamps are wrong by 8 s to 15 years either way. Epochs are those in which a vehicle '
        'heard beacons: of fleets those of the vehicles whose own clocks are right count, of a '
        'vehicle alone all. A stall is the time from one epoch with beacons to the next.',
        [table], [
            Goal('crashes', crashes, 0),
            Goal('epochs lost of vehicles whose clocks are right', lost, 0),
            Goal('longest stall of a vehicle whose own stamps are wrong', stall, JUMP + 5,
                 unit='s')])


if __name__ == '__main__':
    print(measure().plain())
