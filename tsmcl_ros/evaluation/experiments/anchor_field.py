"""The field that the range-free experiments share, and what its vehicles may know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from tsmcl_ros.evaluation.experiments.common import by_case, side_by_side
from tsmcl_ros.evaluation.monte_carlo import Result
from tsmcl_ros.types import Array
from tsmcl_ros.world import make_world, World

RANGE = 1000.0  # m, of all radios of the TS-MCL paper
SPEED = 50.0  # m/s, at most
SIDE = 4000.0  # m, of the field

RADIO: dict[str, Any] = {'radio_model': 'disk', 'radio_range': RANGE}
_SCORING = {**RADIO, 'edge_softness': 1.0}
_RANDOM = {**_SCORING, 'motion_model': 'random', 'max_speed': SPEED}
_DRIVEN = {
    **_SCORING, 'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 0.5,
    'alpha3': 0.0, 'alpha4': 0.0, 'aspiration': 0.9, 'prior_bandwidth': 0.2}

# What a vehicle knows of its own movement and of the anchors that it does not hear. The last one
# is config/range_free.yaml without its method.
EVIDENCE: dict[str, dict[str, Any]] = {
    'heard': {**_RANDOM, 'silence': 'none'},
    'silence': {**_RANDOM, 'silence': 'map'},
    'heard_odometry': {**_DRIVEN, 'silence': 'none'},
    'odometry': {**_DRIVEN, 'silence': 'map'},
}
SHOWN = {
    'heard': 'heard only', 'silence': '+ silence', 'heard_odometry': '+ odometry',
    'odometry': '+ silence, odometry', 'ts_mcl': 'TS-MCL', 'bootstrap': 'bootstrap', 'mcb': 'MCB',
    'exact': 'exact grid',
}


def field(vehicles: int, rng: np.random.Generator) -> World:
    """
    Return vehicles at random waypoints among anchors on a jittered grid.

    Legs begin when the run does. In the model's steady state most vehicles are slow, cross few
    edges of radio disks in the time, and all medians are a metre higher.
    """
    return make_world({**RADIO, 'vehicles': vehicles, 'odom_noise': 0.5, 'max_speed': SPEED,
                       'area_x': SIDE, 'area_y': SIDE, 'start_distribution': 'uniform'}, rng)


def has_odometry(evidence: str) -> bool:
    """Return whether vehicles that know this have odometry."""
    return bool(EVIDENCE[evidence]['motion_model'] == 'odometry')


def exact_grid(cell: float, margin: float, low: tuple[float, float] = (0.0, 0.0),
               high: tuple[float, float] = (SIDE, SIDE)) -> dict[str, Any]:
    """Return settings of the exact filter on cells [m] of a box and a margin about it [m]."""
    return {'method': 'grid', 'grid_cell': cell,
            'grid_x_min': low[0] - margin, 'grid_x_max': high[0] + margin,
            'grid_y_min': low[1] - margin, 'grid_y_max': high[1] + margin}


def particle_method(method: str, particles: int, first_particles: int) -> dict[str, Any]:
    """Return settings of a particle filter; the bootstrap filter is TS-MCL without its search."""
    cloud = {'min_particles': particles, 'max_particles': first_particles}
    if method == 'bootstrap':
        return {'method': 'ts_mcl', 'max_iterations': 0, **cloud}
    return {'method': method, **cloud}


@dataclass(frozen=True, eq=False)
class Curve:
    """
    All runs of a case: errors [m] and NEES (T, U) of all their vehicles, ms per update.

    `apart` is how far two anchors are from each other [m] where they are all that there is.
    """

    evidence: str
    filter: str
    particles: int
    error: Array
    nees: Array
    update_ms: float
    apart: float = 0.0

    @property
    def localizer(self) -> str:
        """What legends call the filter, with its particles."""
        return SHOWN[self.filter] + (f' {self.particles}' if self.particles else '')

    @property
    def label(self) -> str:
        """What legends call it."""
        return f'{SHOWN[self.evidence]}, {self.localizer}'

    @property
    def late(self) -> Array:
        """Errors [m] of the second half of the epochs."""
        return self.error[len(self.error) // 2 - 1:]

    @property
    def late_nees(self) -> Array:
        """NEES of the second half of the epochs."""
        return self.nees[len(self.nees) // 2 - 1:]


def curves_of(results: Sequence[Result]) -> list[Curve]:
    """Lay the runs of each case side by side."""
    curves = []
    for (evidence, method, particles, *apart), outcomes in by_case(results).items():
        error, nees = (side_by_side(outcomes, 'epoch', name) for name in ('error_m', 'nees'))
        seconds = sum(outcome.seconds for outcome in outcomes)
        curves.append(Curve(
            evidence, method, particles, error, nees, 1000 * seconds / error.size, *apart))
    return curves
