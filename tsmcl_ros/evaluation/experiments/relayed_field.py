"""
Vehicles among few anchors in a circle, whose neighbours relay: what the R-MCL experiments share.

Liu, R-MCL: nodes in a circle of radius 200 m, T = 1 s, 50 samples, n = 2.6, one anchor and ten
nodes to a radio disk, errors in units of R. What the paper leaves open is as the prototype had it
that found MCL at 0.34 R and the exact filter at 0.30 to 0.32 R: R = 50 m, v <= R / 5 a second,
random waypoints, anchors near to uniform, and neighbours that relay the anchors they hear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from tsmcl_ros.evaluation.experiments.common import as_rows, by_case, follow, side_by_side
from tsmcl_ros.evaluation.monte_carlo import (
    bootstrap_interval,
    Case,
    Interval,
    Outcome,
    ratio_interval,
    Result,
)
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.mobility import State
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.relay import RelayConfig
from tsmcl_ros.types import Array
from tsmcl_ros.world import anchor_table, hear_each_other, World, WorldConfig

RANGE = 50.0  # m, R
SPEED = 10.0  # m/s, at most

ODOMETRY: dict[str, Any] = {'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 0.5,
                            'alpha3': 0.0, 'alpha4': 0.0}
# What a vehicle makes use of beside the anchors that it hears, directly or relayed.
KNOWLEDGE: dict[str, dict[str, Any]] = {
    'anchors': {},
    'silence': {'silence': 'map'},
    'neighbours': {},
    'velocity': {'motion_model': 'velocity', 'acceleration_std': 2.0, 'speed_decay': 10.0},
    'odometry': ODOMETRY,
    'silence + odometry': {'silence': 'map', **ODOMETRY},
    'silence + neighbours': {'silence': 'map'},
    'all': {'silence': 'map', **ODOMETRY},
}
COOPERATIVE = ('neighbours', 'silence + neighbours', 'all')


@dataclass(frozen=True)
class Field:
    """
    What the experiments on R-MCL share.

    Attributes
    ----------
    runs, vehicles, epochs : int
        Fields, vehicles localized in each, beacon periods; errors count from the third epoch of
        ten on.
    particles : int
        Of all filters that have some.
    grid_cell : float
        Of the exact filter [m]; 5 m make its errors 0.8 % less than 2.5 m do.
    grid_margin : float
        By which its grid is larger than the field, of whose edge no filter knows [m].
    radius : float
        Of the field [m].

    """

    runs: int = 6
    vehicles: int = 40
    epochs: int = 40
    particles: int = 50
    grid_cell: float = 5.0
    grid_margin: float = 75.0
    radius: float = 200.0

    def work(self, case: Case, seed: np.random.SeedSequence) -> Outcome:
        """Follow the vehicles of one field."""
        world_seed, links_seed, filter_seed = seed.spawn(3)
        cooperative = case['knows'] in COOPERATIVE
        world = make_field(case, self.radius, np.random.default_rng(world_seed))
        settings = {**radio(case), 'motion_model': 'random', 'max_speed': SPEED,
                    'silence': 'none', **KNOWLEDGE[case['knows']], **self._method(case),
                    'seed': int(filter_seed.generate_state(1)[0])}
        nodes = len(world.mobility.state.position)
        localizer = Localizer(settings, nodes if cooperative else min(self.vehicles, nodes))
        if case['calibrated']:
            # Who runs the radio knows neither P_0 nor n; the anchors' links tell.
            wrong = {**settings, 'rssi_at_reference': -30.0, 'path_loss_exponent': 3.2}
            localizer = Localizer(wrong, localizer.vehicles)
            localizer.anchor_links(hear_each_other(
                Channel(RadioConfig(**radio(case))), world.anchors,
                np.random.default_rng(links_seed)))
        track = follow(world, localizer, self.epochs, 'odom_heading' in settings, cooperative)
        error = track.error[:, :self.vehicles] / RANGE
        return Outcome(as_rows('epoch', 'vehicle', error_r=error),
                       track.seconds * error.size / track.error.size)

    def _method(self, case: Case) -> dict[str, Any]:
        if case['filter'] == 'exact':
            edge = self.radius + self.grid_margin
            # Between cells a motion is interpolated, which spreads it by cell^2 / 6 along each
            # axis; a disk's own r^2 / 4 is as much smaller.
            speed = math.sqrt(max(SPEED ** 2 - 2 / 3 * self.grid_cell ** 2, 1.0))
            return {'method': 'grid', 'grid_cell': self.grid_cell, 'grid_x_min': -edge,
                    'grid_x_max': edge, 'grid_y_min': -edge, 'grid_y_max': edge,
                    'max_speed': speed}
        return {'method': case['filter'], 'min_particles': self.particles,
                'max_particles': 20 * self.particles}


SHOWN = {'mcl': 'MCL', 'mcb': 'MCB', 'r_mcl': 'R-MCL', 'exact': 'exact grid'}


def field_case(name: str, sigma_db: float = 0.0, knows: str = 'anchors', calibrated: bool = False
               ) -> dict[str, Any]:
    """Return a case at the paper's densities; without noise nobody measures rssi."""
    return {'filter': name, 'knows': knows, 'sigma_db': sigma_db, 'calibrated': calibrated,
            'anchor_density': 1.0, 'node_density': 10.0}


def radio(case: Case) -> dict[str, Any]:
    """Return the radio of a case, by which filters score it as well."""
    settings: dict[str, Any] = {'radio_model': 'disk', 'radio_range': RANGE}
    if case['sigma_db']:
        settings |= {'measure_rssi': True, 'sigma_db': case['sigma_db'],
                     'path_loss_exponent': 2.6}
    return settings


def make_field(case: Case, radius: float, rng: np.random.Generator) -> World:
    """Return vehicles among near-uniform anchors in a circle [m], who relay those they hear."""
    mobility_rng, anchor_rng, rng = rng.spawn(3)
    share = (radius / RANGE) ** 2
    nodes = round(case['node_density'] * share)
    anchors = near_uniform(round(case['anchor_density'] * share), radius, anchor_rng)
    return World(WorldConfig(vehicles=nodes, odom_noise=0.5), Channel(RadioConfig(**radio(case))),
                 Wanderers(nodes, radius, SPEED, mobility_rng), anchor_table(anchors), rng,
                 relaying=RelayConfig(relay_hops=2, pose_max_spread=1.0))


class Wanderers:
    """A mobility of random waypoints in a circle (V, 2), radius and speeds in m and m/s."""

    duration = math.inf

    def __init__(self, vehicles: int, radius: float, max_speed: float, rng: np.random.Generator):
        self._radius, self._max_speed, self._rng = radius, max_speed, rng
        self._position = uniform_in_disk(vehicles, radius, rng)
        self._target = uniform_in_disk(vehicles, radius, rng)
        self._speed = self._speeds(vehicles)
        self.state = State(self._position, np.zeros((vehicles, 2)), np.zeros(vehicles))

    def step(self, elapsed: float) -> State:
        """Go on towards the waypoints; who reaches one stops there for the rest of the time."""
        way = self._target - self._position
        length = np.linalg.norm(way, axis=1)
        share = np.minimum(self._speed * elapsed / np.maximum(length, 1e-9), 1)[:, None]
        self._position = self._position + share * way
        arrived = share[:, 0] == 1
        vehicles = len(length)
        # Drawn for all, so that who arrives makes no difference to the others.
        target, speed = uniform_in_disk(vehicles, self._radius, self._rng), self._speeds(vehicles)
        self._target = np.where(arrived[:, None], target, self._target)
        self._speed = np.where(arrived, speed, self._speed)
        self.state = State(self._position, share * way / elapsed, np.arctan2(way[:, 1], way[:, 0]))
        return self.state

    def _speeds(self, vehicles: int) -> Array:
        return self._rng.uniform(0.1 * self._max_speed, self._max_speed, vehicles)


def uniform_in_disk(count: int, radius: float, rng: np.random.Generator) -> Array:
    """Return points (count, 2) [m] uniform in a disk around the origin."""
    angle, reach = rng.uniform(0, 2 * math.pi, count), radius * np.sqrt(rng.random(count))
    return np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)


def near_uniform(count: int, radius: float, rng: np.random.Generator) -> Array:
    """Return points (count, 2) [m] of a jittered square grid, those nearest to the origin."""
    spacing = radius * math.sqrt(math.pi / count)
    steps = np.arange(-math.ceil(radius / spacing) - 1, math.ceil(radius / spacing) + 2)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2) + rng.random(2)
    points = spacing * (grid + rng.uniform(-0.2, 0.2, grid.shape))
    return np.asarray(points[np.argsort(np.linalg.norm(points, axis=1))[:count]])


@dataclass(frozen=True, eq=False)
class Curve:
    """All runs of a case: errors [R] (T, U) of all their vehicles, and ms per update."""

    case: Case
    error: Array
    update_ms: float

    @property
    def late(self) -> Array:
        """Errors [R] once the start is forgotten; having no estimate counts as one of R."""
        late = self.error[3 * len(self.error) // 10:]
        return np.where(np.isnan(late), 1.0, late)

    @property
    def mean(self) -> Interval:
        """Mean error [R]."""
        return bootstrap_interval(lambda late: float(np.mean(late)), self.late)

    @property
    def over_time(self) -> Array:
        """Mean errors [R] (T,)."""
        return np.asarray(np.nanmean(self.error, axis=1))

    @property
    def label(self) -> str:
        """What legends call it."""
        known = '' if self.case['knows'] == 'anchors' else f', {self.case["knows"]}'
        by = ', by links' if self.case['calibrated'] else ''
        return f'{SHOWN[self.case["filter"]]}, {noise(self.case)}{known}{by}'


def noise(case: Case) -> str:
    """Return what rssi is like in a case."""
    return f'{case["sigma_db"]:g} dB' if case['sigma_db'] else 'no rssi'


def ratio(curve: Curve, other: Curve) -> Interval:
    """Return one mean error over another, of the same vehicles."""
    return ratio_interval(np.mean, curve.late, other.late)


def gather(results: Sequence[Result]) -> list[Curve]:
    """Lay the runs of each case side by side."""
    names = list(results[0].case)
    curves = []
    for case, outcomes in by_case(results).items():
        error = side_by_side(outcomes, 'epoch', 'error_r')
        seconds = sum(outcome.seconds for outcome in outcomes)
        curves.append(Curve(
            dict(zip(names, case, strict=True)), error, 1000 * seconds / error.size))
    return curves


def find(curves: Sequence[Curve], case: Case) -> Curve | None:
    """Return the curve of a case, if there is one."""
    return next((curve for curve in curves if curve.case == case), None)


def known(curves: Sequence[Curve], case: Case) -> Curve:
    """Return the curve of a case that there is."""
    found = find(curves, case)
    assert found is not None
    return found
