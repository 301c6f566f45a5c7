"""
Where vehicles are after a while of which nothing is known, from where they were before it.

Their localizer may have been away, or their odometry and all beacons with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types import Array, Estimate, Prior

# How much faster a vehicle may have become [m/s^2].
_ACCELERATION = 3.0
# Of the radio range, beyond which a vehicle is found anew sooner than in what it has become.
_SHARE = 0.25
# Of a displacement, the standard deviation that odometry has at least.
_DRIFT = 0.1


@dataclass(frozen=True, eq=False)
class Last:
    """
    The last that was known of one vehicle.

    Attributes
    ----------
    vehicle : int
        Index of the vehicle.
    stamp : float
        [s].
    mean, covariance : (D,), (D, D) float64
        Position [m, m^2].
    rotation, rotation_variance : float
        From the odometry frame to the map [rad, rad^2]; NaN if unknown.
    odometry : (4,) float64
        Position [m] and yaw [rad] by odometry; NaN without.
    speed : float
        By odometry [m/s]; NaN without.

    """

    vehicle: int
    stamp: float
    mean: Array
    covariance: Array
    rotation: float
    rotation_variance: float
    odometry: Array
    speed: float


def last_known(estimate: Estimate, speed: Array, sound: Array) -> list[Last]:
    """
    Return what is to be known of those vehicles whose pose can be trusted.

    Parameters
    ----------
    estimate : Estimate
        Of V vehicles.
    speed : (V,) float
        [m/s], NaN without odometry.
    sound : (V,) bool
        Who is not lost.

    """
    odometry = estimate.odometry
    if odometry is None:
        odometry = np.full((len(sound), 4), np.nan)
    return [
        Last(vehicle, estimate.stamp, estimate.mean[vehicle], estimate.covariance[vehicle],
             float(estimate.rotation[vehicle]), float(estimate.rotation_variance[vehicle]),
             odometry[vehicle], float(speed[vehicle]))
        for vehicle in np.flatnonzero(sound & np.isfinite(estimate.mean).all(axis=1)).tolist()]


def resumed(last: Last, stamp: float, odometry: Array, max_speed: float, radio_range: float,
            may_begin: bool = True) -> Prior | None:
    """
    Return where a vehicle is now; None if its first beacons would tell as much.

    Odometry tells if it has gone on, which shows where it has not left the way that the vehicle
    can have gone, nor can have come from its own beginning meanwhile. Else that way is what the
    pose becomes uncertain by.

    Parameters
    ----------
    last : Last
        What was known of it.
    stamp : float
        [s].
    odometry : (4,) float
        Position [m] and yaw [rad] at the stamp, NaN without.
    max_speed, radio_range : float
        Of the vehicle, and of beacons [m/s, m]; 0 for a range that nobody knows.
    may_begin : bool
        Whether odometry may have begun anew meanwhile.

    """
    elapsed = stamp - last.stamp
    reach = max_speed * elapsed
    if np.isfinite(last.speed):
        reach = min(reach, last.speed * elapsed + _ACCELERATION * elapsed ** 2 / 2)
    if elapsed < 0:
        return None
    dimension = len(last.mean)
    moved = (odometry - last.odometry)[:dimension]
    distance = float(np.linalg.norm(moved))
    if may_begin:
        goes_on = distance <= reach < np.linalg.norm(odometry[:dimension])
    else:
        goes_on = distance <= max_speed * elapsed
    if not (np.isfinite(last.rotation) and goes_on):
        if reach > _SHARE * (radio_range or np.inf):
            return None
        # Evenly within a disk, the variance of each axis is a quarter of its radius squared.
        wider = last.covariance + reach ** 2 / 4 * np.eye(dimension)
        return Prior(last.vehicle, last.mean, wider)
    cos, sin = np.cos(last.rotation), np.sin(last.rotation)
    moved[:2] = cos * moved[0] - sin * moved[1], sin * moved[0] + cos * moved[1]
    variance = distance ** 2 * (_DRIFT ** 2 + last.rotation_variance)
    return Prior(
        last.vehicle, last.mean + moved, last.covariance + variance * np.eye(dimension),
        last.rotation + float(odometry[3]), float(np.sqrt(last.rotation_variance)))


class Bridges:
    """
    Leads vehicles over times without odometry and beacons, as soon as odometry is back.

    Parameters
    ----------
    max_speed, radio_range : float
        As for `resumed`.

    """

    def __init__(self, max_speed: float, radio_range: float) -> None:
        self._max_speed, self._radio_range = max_speed, radio_range
        self._lasts: dict[int, Last] = {}

    def leave(self, estimate: Estimate, speed: Array, sound: Array, odometry: Array) -> None:
        """
        Remember those vehicles whose odometry has ceased since an estimate.

        Parameters
        ----------
        estimate, speed, sound
            As for `last_known`.
        odometry : (V, 4) float
            At present, NaN where there is none.

        """
        if estimate.odometry is None:
            return
        ceased = np.isnan(odometry[:, 0]) & np.isfinite(estimate.odometry[:, 0])
        if ceased.any():
            self._lasts |= {
                last.vehicle: last for last in last_known(estimate, speed, sound & ceased)}

    def arrive(self, stamp: float, odometry: Array) -> dict[int, Prior | None]:
        """Return where those vehicles are whose odometry (V, 4) is back at a stamp [s]."""
        return {
            vehicle: resumed(self._lasts.pop(vehicle), stamp, odometry[vehicle], self._max_speed,
                             self._radio_range, may_begin=False)
            for vehicle in list(self._lasts) if np.isfinite(odometry[vehicle, 0])}

    def forget(self, vehicle: Array) -> None:
        """Forget of some vehicles (V,) bool what they have been told better."""
        for each in [each for each in self._lasts if vehicle[each]]:
            del self._lasts[each]
