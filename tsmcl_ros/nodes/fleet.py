"""Many vehicles' localizers in one process, computed as one batch."""

from __future__ import annotations

from dataclasses import dataclass
import sys

from tsmcl_ros.config import Config, param
from tsmcl_ros.endpoint import OutputConfig
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.localizer import CONFIGS
from tsmcl_ros.nodes import runtime
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.managed import LifecycleConfig
from tsmcl_ros.nodes.security import SecurityConfig


@dataclass(frozen=True)
class FleetConfig(Config):
    """Which vehicles there are."""

    vehicles: int = param(40, 'number of vehicles', low=1, high=1000)
    first_vehicle: int = param(0, 'number of the first one, of namespace /veh_i', low=0)


@dataclass(frozen=True)
class FleetOutputConfig(OutputConfig):
    """What a fleet publishes; by default no particle clouds, which are most of the bytes."""

    cloud_period: float = param(
        0.0, 'shortest time between two particle clouds, 0 for none', unit='s', low=0, live=True)


class Fleet(LocalizerNode):
    """
    Fleet: localizers of many vehicles, in the namespaces /veh_0, /veh_1 and so on.

    For each what a localizer does for its one; markers and services are common to all.
    """

    default_name = 'fleet'
    configs = (LifecycleConfig, SecurityConfig, FleetConfig, FleetOutputConfig, InputConfig,
               *CONFIGS)

    def vehicle_names(self) -> list[str]:
        """Return the namespaces of the vehicles."""
        first = self.settings['first_vehicle']
        return [f'/veh_{i}' for i in range(first, first + self.settings['vehicles'])]


def main() -> int:
    """Run the node and return the exit code."""
    return runtime.main(Fleet)


if __name__ == '__main__':
    sys.exit(main())
