"""What a demo simulates, and with which parameters it localizes: by default or from a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tsmcl_ros.config import load_yaml, parameters, refuse_unknown
from tsmcl_ros.localizer import CONFIGS
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.simulator import Simulator

NODES = (Anchor, Simulator, Fleet)

# What config/range_free.yaml holds but the method: an installed demo finds no such files.
LOCALIZER = {
    'min_particles': 200, 'max_particles': 2000, 'aspiration': 0.9, 'prior_bandwidth': 0.2,
    'motion_model': 'odometry',
    'odom_heading': 'known', 'odom_std': 0.5, 'alpha3': 0.0, 'alpha4': 0.0,
    'radio_model': 'disk', 'radio_range': 1000.0, 'edge_softness': 1.0, 'silence': 'map',
}
# What the recording is run through for comparison; MCL was published with random motion.
OTHERS = {
    'ts_mcl': {'method': 'ts_mcl'},
    'mcl': {'method': 'mcl'},
    'mcl, random motion': {'method': 'mcl', 'motion_model': 'random'},
}
ALONE = {'anchors alone': {'use_vehicles': False}}


class Scenario(NamedTuple):
    """
    Parameters by name of the nodes of a demo.

    Attributes
    ----------
    anchor, simulator, fleet : mapping
        Of the nodes of these names.
    others : mapping of label to mapping
        What else the recording is to be localized with, as changes to the fleet's parameters.

    """

    anchor: Mapping[str, Any]
    simulator: Mapping[str, Any]
    fleet: Mapping[str, Any]
    others: Mapping[str, Mapping[str, Any]]

    @property
    def localizer(self) -> dict[str, Any]:
        """Return the fleet's parameters that other localizers have too."""
        shared = {item.name for config in CONFIGS for item in parameters(config)}
        return {name: value for name, value in self.fleet.items() if name in shared}

    @property
    def defaults(self) -> dict[str, Any]:
        """Return what the demo has options for."""
        run = {name: self.simulator[name] for name in ('vehicles', 'duration', 'rate', 'seed')
               if name in self.simulator}
        return run | ({'method': self.fleet['method']} if 'method' in self.fleet else {})


RANGE_FREE = Scenario({}, {'radio_range': LOCALIZER['radio_range']}, LOCALIZER, OTHERS)


def read_scenario(path: Path) -> Scenario:
    """
    Return the scenario of a ROS parameter file.

    Its sections are `anchor`, `simulator` and `fleet`; what stands under `/**` is for those of
    them that have such a parameter. Where vehicles cooperate it is compared with what they could
    do without, else with MCL.

    Raises
    ------
    ConfigError
        If the file cannot be read, or holds a parameter that none of them has.

    """
    known = {node: {item.name for config in node.configs for item in parameters(config)}
             for node in NODES}
    said = {node: load_yaml(path, node.default_name) for node in NODES}
    refuse_unknown(
        (name for values in said.values() for name in values),
        [config for node in NODES for config in node.configs], str(path))
    anchor, simulator, fleet = (
        {name: value for name, value in said[node].items() if name in known[node]}
        for node in NODES)
    others = ALONE if simulator.get('cooperation') else {'mcl': OTHERS['mcl']}
    return Scenario(anchor, simulator, fleet, others)
