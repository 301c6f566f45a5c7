"""Where the anchors of a simulated world stand, and what they transmit."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.types import Array, ConfigError, Observation


@dataclass(frozen=True)
class AnchorConfig(Config):
    """Where anchors stand."""

    anchor_layout: str = param(
        'grid', 'on a jittered grid, anywhere in the rectangle of that grid, or as listed',
        choices=('grid', 'uniform', 'list'))
    anchor_rows: int = param(4, 'anchors along y', low=1, high=10_000)
    anchor_columns: int = param(4, 'anchors along x', low=1, high=10_000)
    anchor_spacing: float = param(1000.0, 'side of a grid cell, in which one anchor stands',
                                  unit='m', above=0, high=1e5)
    anchor_jitter: float = param(
        200.0, 'furthest that an anchor is off the middle of its cell, along each axis', unit='m',
        low=0, high=1e5)
    anchor_origin_x: float = param(0.0, 'lower left corner of the grid', unit='m', low=-1e5,
                                   high=1e5)
    anchor_origin_y: float = param(0.0, 'see anchor_origin_x', unit='m', low=-1e5, high=1e5)
    anchor_height: float = param(
        0.0, 'in three dimensions anchors stand anywhere between 0 and this height', unit='m',
        low=0, high=1e5)
    anchor_positions: tuple[str, ...] = param((), 'the listed anchors: "x y" or "x y z" each [m]')


def anchor_table(position: Array, identity: Array | None = None) -> Observation:
    """
    Return what anchors transmit.

    Parameters
    ----------
    position : (A, D) float
        [m].
    identity : (A,) int or None
        By default 0, 1, 2 and so on.

    Returns
    -------
    Observation
        V = 1, K = A, at stamp 0.

    """
    anchors, dimension = position.shape
    table = Observation.empty(1, anchors, dimension, stamp=0.0)
    table.position[0] = position
    table.sender[0] = np.arange(anchors) if identity is None else identity
    return table


def lay_out(config: AnchorConfig, dimension: int, rng: np.random.Generator) -> Array:
    """
    Return positions (A, D) [m] of anchors in 2 or 3 dimensions, row by row.

    Raises
    ------
    ConfigError
        If anchors are to be listed, and the list is empty or holds what is no position.

    """
    if config.anchor_layout == 'list':
        if not config.anchor_positions:
            raise ConfigError('anchor_positions: () is not allowed with anchor_layout list, must '
                              'be a list of "x y" or "x y z"')
        return np.array([_listed(text, dimension) for text in config.anchor_positions])
    rows, columns = config.anchor_rows, config.anchor_columns
    if config.anchor_layout == 'grid':
        cell = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
        plane = (cell + 0.5) * config.anchor_spacing
        plane += config.anchor_jitter * rng.uniform(-1, 1, plane.shape)
    else:
        plane = rng.random((rows * columns, 2)) * [columns, rows] * config.anchor_spacing
    plane += [config.anchor_origin_x, config.anchor_origin_y]
    height = rng.uniform(0, config.anchor_height, (len(plane), dimension - 2))
    return np.concatenate([plane, height], axis=1)


def _listed(text: str, dimension: int) -> list[float]:
    """Return the coordinates of a listed anchor; a height left out is 0."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise ConfigError(f'anchor_positions: {text!r} is not allowed, must be "x y" or "x y z" '
                          'in m')
    return [*values, 0.0][:dimension]
