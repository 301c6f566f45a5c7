"""Static anchors that broadcast where they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
import sys
from typing import Any

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.config import build, Config, param
from tsmcl_ros.csv_log import read_anchors
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.nodes.security import SecurityConfig
from tsmcl_ros.types import Links, Observation
from tsmcl_ros.world import anchor_table, AnchorConfig, hear_each_other, lay_out


@dataclass(frozen=True)
class BroadcastConfig(Config):
    """What anchors transmit, and when."""

    beacon_period: float = param(1.0, 'time between two beacons of an anchor', unit='s', above=0,
                                 high=3600)
    anchor_file: str = param('', 'CSV file with columns id, x, y, z [m], instead of a layout')
    first_id: int = param(0, 'identity of the first anchor of a layout, the others count on',
                          low=0, high=2**31)
    global_frame_id: str = param('map', 'frame of the positions')
    seed: int = param(1, 'of the layout, and of the rssi between anchors', low=0)


class Anchor(runtime.Node):
    """
    Static anchors: broadcast their positions on /beacons every period.

    All of them stand in the latched /anchor_map; where the radio measures rssi, how they hear each
    other stands in the latched /anchor_links.
    """

    default_name = 'anchor'
    configs = (BroadcastConfig, SecurityConfig, AnchorConfig, RadioConfig)

    def __init__(self) -> None:
        super().__init__()
        self._config = build(BroadcastConfig, self.settings)
        anchors = _anchors(self._config, self.settings)
        # What is not allowed shows before anything is said to anybody.
        links = _links(self._config, build(RadioConfig, self.settings), anchors)
        self._beacons = _one_each(anchors)
        # In this order: who has received the map has found the beacons too.
        self._air = self.talk('/beacons', messages.POINT_CLOUD, wire.SENSOR_DATA)
        self._map = self.talk('/anchor_map', messages.POINT_CLOUD, wire.LATCHED)
        self._map.publish(messages.encode_beacons(anchors, self._config.global_frame_id)[0])
        if links is not None:
            self._links = self.talk('/anchor_links', messages.POINT_CLOUD, wire.LATCHED)
            self._links.publish(
                messages.encode_links(anchors.stamp, links, self._config.global_frame_id))
        self.every(self._config.beacon_period, self.transmit)
        self.get_logger().info(f'{anchors.sender.size} anchors')

    def transmit(self, stamp: float) -> None:
        """Broadcast one beacon an anchor."""
        beacons = replace(self._beacons, stamp=stamp)
        wire.publish_all(
            (self._air, data)
            for data in messages.encode_beacons(beacons, self._config.global_frame_id)
        )


def _anchors(config: BroadcastConfig, settings: dict[str, Any]) -> Observation:
    """Return the anchors' rows (V = 1)."""
    if config.anchor_file:
        return read_anchors(config.anchor_file)
    # The generator that make_world lays anchors out with: a seed means the same anchors there.
    _, rng, _ = np.random.default_rng(config.seed).spawn(3)
    position = lay_out(build(AnchorConfig, settings), 3, rng)
    return anchor_table(position, config.first_id + np.arange(len(position)))


def _links(config: BroadcastConfig, radio: RadioConfig, anchors: Observation) -> Links | None:
    """Return how the anchors hear each other, None if their radio measures no rssi."""
    if not radio.measure_rssi:
        return None
    # After the generators that the layout and the world take: a seed keeps its layout.
    *_, rng = np.random.default_rng(config.seed).spawn(4)
    return hear_each_other(Channel(radio), anchors, rng)


def _one_each(anchors: Observation) -> Observation:
    """Return anchors (1, A) as A transmitters of one row each."""
    transmitters = Observation.empty(anchors.sender.size, 1, 3, anchors.stamp)
    transmitters.sender[:, 0] = anchors.sender[0]
    transmitters.position[:, 0] = anchors.position[0]
    return transmitters


def main() -> int:
    """Run the node and return the exit code."""
    return runtime.main(Anchor)


if __name__ == '__main__':
    sys.exit(main())
