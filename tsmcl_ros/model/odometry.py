"""The odometry of a fleet, brought to the stamps of its epochs."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array, Motion, Odometry

# Odometry is gone when it is silent for so long [s], and for so many of its intervals.
_GONE, _INTERVALS = 1.0, 1.5


class OdometryBuffer:
    """
    The last odometry poses of V vehicles, interpolated at the epochs' stamps.

    Parameters
    ----------
    vehicles : int
        V.
    depth : int
        Poses kept of each; at 200 Hz the default holds more than a second.

    Attributes
    ----------
    latest : (V,) float64
        Stamp of each vehicle's last pose [s], -inf if there is none.
    at_epoch : (V, 4) float64
        Position [m] and yaw [rad] at the last epoch, NaN where there is no odometry, or none any
        more: a vehicle whose odometry is silent does not stand.

    """

    def __init__(self, vehicles: int, depth: int = 256):
        self._vehicle = np.arange(vehicles)
        # Rings: what follows the newest pose is the oldest.
        self._stamp = np.full((vehicles, depth), -np.inf)
        self._pose = np.zeros((vehicles, depth, 4))
        self._newest = np.zeros(vehicles, int)
        self.latest = np.full(vehicles, -np.inf)
        self.at_epoch = np.full((vehicles, 4), np.nan)

    def add(self, vehicle: int, odometry: Odometry) -> None:
        """Append one vehicle's pose; its yaw is unwrapped."""
        self._append(vehicle, odometry.stamp, odometry.position, odometry.yaw)

    def add_all(self, stamp: float, position: Array, yaw: Array | None) -> None:
        """Append a pose of every vehicle: (V, D) [m], (V,) [rad]."""
        self._append(self._vehicle, stamp, position, yaw)

    def _append(self, vehicle: Array | int, stamp: float, position: Array,
                yaw: Array | float | None) -> None:
        """Append a pose of one vehicle, or of each of some."""
        newest = self._newest[vehicle]
        pose = self._pose[vehicle, newest].copy()
        turn = 0 if yaw is None else yaw - pose[..., 3]
        pose[..., :position.shape[-1]] = position
        pose[..., 3] += (turn + np.pi) % (2 * np.pi) - np.pi
        self._newest[vehicle] = newest = (newest + 1) % self._stamp.shape[1]
        self._pose[vehicle, newest] = pose
        self._stamp[vehicle, newest] = self.latest[vehicle] = stamp

    def motion(self, since: float | None, until: float, dimension: int) -> Motion | None:
        """
        Return the motion between two epochs [s], None if no vehicle has odometry.

        A vehicle that had no odometry at either of them has a displacement of NaN.
        """
        if not np.isfinite(self.latest).any():
            return None
        before, self.at_epoch = self.at_epoch, self._interpolate(until)
        change = self.at_epoch - before
        return Motion(
            elapsed=until - (until if since is None else since),
            displacement=change[:, :dimension], turn=change[:, 3])

    def _interpolate(self, stamp: float) -> Array:
        """Return the poses (V, 4) at a stamp [s]; soon before and after them the nearest one."""
        depth, vehicle = self._stamp.shape[1], self._vehicle
        # Counted from the oldest.
        after = np.minimum((self._stamp < stamp).sum(axis=1), depth - 1)
        before = (self._newest + np.maximum(after, 1)) % depth
        after = (self._newest + 1 + after) % depth
        low, high = self._stamp[vehicle, before], self._stamp[vehicle, after]
        with np.errstate(divide='ignore', invalid='ignore'):
            interval = self.latest - self._stamp[vehicle, self._newest - 1]
            share = np.minimum(np.maximum((stamp - low) / (high - low), 0), 1)
        share = np.where(np.isfinite(low) & (high > low), share, 1)[:, None]
        pose = (1 - share) * self._pose[vehicle, before] + share * self._pose[vehicle, after]
        patience = np.maximum(_GONE, _INTERVALS * np.where(np.isfinite(interval), interval, 0))
        return np.where((stamp - self.latest <= patience)[:, None], pose, np.nan)
