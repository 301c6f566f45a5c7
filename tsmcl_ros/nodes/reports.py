"""Where vehicles say that they are, for a simulation that goes in step with their localizers."""

from __future__ import annotations

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.model.relay import Poses
from tsmcl_ros.types import Array, MessageError


class Reports:
    """
    The last poses of V vehicles, and who is still to send one of an epoch.

    A vehicle is waited for from the first beacon that it hears, which is when its localizer finds
    it, until it is given up; and again from the epoch after it has sent one all the same. Only
    whom one waits for counts, so that a simulation does not depend on how fast messages are.

    Parameters
    ----------
    vehicles : int
        V.
    frame_id : str
        The frame that poses have to be given in.

    """

    def __init__(self, vehicles: int, frame_id: str) -> None:
        self._frame_id = frame_id
        self._last = Poses.unknown(vehicles, 3)
        self._heard = np.zeros(vehicles, bool)
        self._silent = np.zeros(vehicles, bool)
        self._awaited = np.zeros(vehicles, bool)
        self._epoch = -np.inf

    def take(self, vehicle: int, data: bytes) -> None:
        """
        Take in one vehicle's serialized pose.

        Raises
        ------
        MessageError
            If it is malformed, or in another frame.

        """
        pose = messages.decode_pose(data)
        if pose.frame_id != self._frame_id:
            raise MessageError(
                f'frame_id {pose.frame_id!r} is not allowed, must be {self._frame_id!r}')
        self._silent[vehicle] = False
        if pose.stamp < self._last.stamp[vehicle]:
            return
        self._last.stamp[vehicle] = pose.stamp
        self._last.mean[vehicle] = pose.position
        self._last.covariance[vehicle] = pose.covariance[:3, :3]

    def expect(self, stamp: float, heard: Array) -> None:
        """Wait for the poses of an epoch [s], now that these vehicles (V,) bool hear beacons."""
        self._epoch = stamp
        self._heard |= heard
        self._awaited = self._heard & ~self._silent

    def is_complete(self) -> bool:
        """Tell whether all vehicles that are waited for have sent their pose."""
        return not self._missing().any()

    def give_up(self) -> list[int]:
        """Wait no longer for the vehicles that have not sent theirs, and return them."""
        missing = self._missing()
        self._silent |= missing
        self._awaited &= ~missing
        return np.flatnonzero(missing).tolist()

    def poses(self, dimension: int) -> Poses:
        """Return what is known, in D dimensions, of those who were waited for and did report."""
        stamp = np.where(self._awaited, self._last.stamp, np.nan)
        return Poses(stamp, self._last.mean[:, :dimension],
                     self._last.covariance[:, :dimension, :dimension])

    def _missing(self) -> Array:
        # Stamps are rounded to the nanosecond on the way.
        return self._awaited & ~(self._last.stamp > self._epoch - 1e-6)
