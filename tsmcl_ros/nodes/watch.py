"""What a script sees of a running simulation."""

from __future__ import annotations

import math

from tsmcl_ros import messages
from tsmcl_ros.messages.diagnostics import FAILURE
from tsmcl_ros.nodes import runtime, wire


class Watch(runtime.Node):
    """
    Watches a simulation and the fleet in it.

    Parameters
    ----------
    vehicles
        How many there are.

    Attributes
    ----------
    time : float
        Latest time that /clock has shown [s], NaN before the first.
    estimated : float
        Stamp of the last vehicle's latest pose [s], NaN before the first.
    localized : int
        Number of vehicles that are not lost.

    """

    default_name = 'watch'

    def __init__(self, vehicles: int) -> None:
        super().__init__()
        self._poses = [f'/veh_{i}/pose' for i in range(vehicles)]
        self.time = math.nan
        self.estimated = math.nan
        self.localized = 0
        self.listen('/clock', messages.CLOCK, self._take_time, wire.SENSOR_DATA)
        self.listen(self._poses[-1], messages.POSE, self._take_pose, wire.LATCHED_INPUT)
        self.listen('/diagnostics', messages.DIAGNOSTICS,
                    self._take_diagnostics, wire.RELIABLE)

    def is_recorded(self) -> bool:
        """Tell whether somebody else listens to the anchors and to each vehicle's pose."""
        ours = self._poses[-1]
        return all(
            self.count_publishers(topic) and self.count_subscribers(topic) > (topic == ours)
            for topic in ('/anchor_map', '/beacons', *self._poses)
        )

    def _take_time(self, data: bytes) -> None:
        self.time = messages.decode_clock(data)

    def _take_pose(self, data: bytes) -> None:
        self.estimated = messages.decode_pose(data).stamp

    def _take_diagnostics(self, data: bytes) -> None:
        _, vehicles = messages.decode_diagnostics(data)
        self.localized = sum(vehicle.level != FAILURE for vehicle in vehicles)
