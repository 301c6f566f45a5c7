"""What a localizer says and has gathered, written into a bag."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.bag import Writer
from tsmcl_ros.diagnosis import diagnose, DIAGNOSTICS_PERIOD
from tsmcl_ros.endpoint import Endpoint, Rest
from tsmcl_ros.topics import absolute
from tsmcl_ros.types import Estimate, Observation


class Outlet:
    """
    Writes what an endpoint's localizer says into a new bag.

    What is gathered from ranges becomes beacons, so that it can be evaluated.

    Parameters
    ----------
    endpoint : Endpoint
    names : sequence of str
        Namespaces of its vehicles.
    writer : Writer
        Of the bag.

    Attributes
    ----------
    stamp : float
        Log time of what is written [s].
    poses : int
        How many were written.

    """

    def __init__(self, endpoint: Endpoint, names: Sequence[str], writer: Writer):
        self.stamp = 0.0
        self.poses = 0
        self._endpoint = endpoint
        self._names = names
        self._writer = writer
        self._rest = Rest()
        self._status = np.full(len(names), -1)
        for topic in endpoint.outputs:
            writer.topic(topic, messages.POSE, latched=True)
        writer.topic('/diagnostics', messages.DIAGNOSTICS)
        endpoint.ranges.heed_epoch = self._heed_epoch

    def write_anchors(self) -> None:
        """Write the anchors that a parameter tells."""
        self._write_scan('/anchor_map', self._endpoint.ranges.anchors, latched=True)

    def write(self, estimates: list[Estimate]) -> None:
        """Write what has become due."""
        for estimate in estimates:
            for vehicle, data in self._endpoint.poses(estimate):
                self._writer.write(self._endpoint.outputs[vehicle], self.stamp, data)
                self.poses += 1
        if estimates:
            self._diagnose(estimates[-1].stamp)

    def _diagnose(self, now: float) -> None:
        """Write how the vehicles are doing, now and then and when it changes."""
        localizer = self._endpoint.localizer
        status = localizer.health.status
        changed = (status != self._status).any()
        if self._rest.is_over(now, DIAGNOSTICS_PERIOD) or changed:
            self._status = status
            self._writer.write('/diagnostics', self.stamp, messages.encode_diagnostics(
                now, diagnose(localizer, self._names, 'localize_bag', status, {})))

    def _heed_epoch(self, vehicle: int, scan: Observation) -> None:
        self._endpoint.localizer.beacons(vehicle, scan)
        self._write_scan(absolute('beacons', self._names[vehicle]), scan)

    def _write_scan(self, topic: str, scan: Observation, latched: bool = False) -> None:
        self._writer.topic(topic, messages.POINT_CLOUD, latched)
        data, = messages.encode_beacons(scan, self._endpoint.frame_id)
        self._writer.write(topic, self.stamp, data)
