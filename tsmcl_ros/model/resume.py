"""Where vehicles are after their localizer was away for a while, from where it left them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types import Array, Estimate, Prior

# How much faster a vehicle may have become [m/s^2].
_ACCELERATION = 3.0
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


def resumed(last: Last, stamp: float, odometry: Array, max_speed: float, radio_range: float
            ) -> Prior | None:
    """
    Return where a vehicle is now; None if a first beacon would tell as much.

    Odometry tells if it has gone on, which shows where it can neither have come from its own
    beginning meanwhile nor have left the way that the vehicle can have gone. Else that way is
    what the pose becomes uncertain by.

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

    """
    elapsed = stamp - last.stamp
    reach = max_speed * elapsed
    if np.isfinite(last.speed):
        reach = min(reach, last.speed * elapsed + _ACCELERATION * elapsed ** 2 / 2)
    if elapsed < 0 or reach > (radio_range or np.inf):
        return None
    dimension = len(last.mean)
    moved = (odometry - last.odometry)[:dimension]
    distance = float(np.linalg.norm(moved))
    beyond_beginning = np.linalg.norm(odometry[:dimension]) > reach
    if not (np.isfinite(last.rotation) and distance <= reach and beyond_beginning):
        # Evenly within a disk, the variance of each axis is a quarter of its radius squared.
        wider = last.covariance + reach ** 2 / 4 * np.eye(dimension)
        return Prior(last.vehicle, last.mean, wider)
    cos, sin = np.cos(last.rotation), np.sin(last.rotation)
    moved[:2] = cos * moved[0] - sin * moved[1], sin * moved[0] + cos * moved[1]
    variance = distance ** 2 * (_DRIFT ** 2 + last.rotation_variance)
    return Prior(
        last.vehicle, last.mean + moved, last.covariance + variance * np.eye(dimension),
        last.rotation + float(odometry[3]), float(np.sqrt(last.rotation_variance)))
