"""Worlds as settings describe them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from tsmcl_ros.config import build, Config
from tsmcl_ros.model.mobility import Mobility
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.relay import RelayConfig
from tsmcl_ros.world.anchors import anchor_table, AnchorConfig, lay_out
from tsmcl_ros.world.core import World
from tsmcl_ros.world.settings import MOBILITY, MobilityConfig, WorldConfig

# All that `make_world` reads its settings into.
CONFIGS: tuple[type[Config], ...] = (
    WorldConfig, AnchorConfig, RadioConfig, RelayConfig, MobilityConfig,
)


def make_mobility(settings: Mapping[str, Any], rng: np.random.Generator) -> Mobility:
    """
    Return the mobility that the settings, flat parameters by name, describe.

    Raises
    ------
    ConfigError, LogError
        If a parameter is not allowed; if a trace cannot be read.

    """
    world = build(WorldConfig, settings)
    config, make = MOBILITY[world.mobility]
    return make(build(config, settings), world.vehicles, rng)


def make_world(settings: Mapping[str, Any], rng: np.random.Generator) -> World:
    """
    Return the world that the settings, flat parameters by name, describe; see `CONFIGS`.

    Raises
    ------
    ConfigError, LogError
        If a parameter is not allowed; if a trace cannot be read.

    """
    mobility_rng, anchor_rng, rng = rng.spawn(3)
    mobility = make_mobility(settings, mobility_rng)
    dimension = mobility.state.position.shape[1]
    anchors = anchor_table(lay_out(build(AnchorConfig, settings), dimension, anchor_rng))
    channel = Channel(build(RadioConfig, settings))
    return World(build(WorldConfig, settings), channel, mobility, anchors, rng,
                 relaying=build(RelayConfig, settings))
