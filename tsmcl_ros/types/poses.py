"""How vehicles move, and where they are taken to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types.arrays import Array


@dataclass(frozen=True, eq=False)
class Odometry:
    """
    One odometry pose of one vehicle, in an odometry frame that starts anywhere and drifts.

    Attributes
    ----------
    stamp : float
        [s].
    position : (3,) float64
        [m].
    yaw : float
        [rad].

    """

    stamp: float
    position: Array
    yaw: float


@dataclass(frozen=True, eq=False)
class Motion:
    """
    What is known of V vehicles' movement since the last epoch.

    Attributes
    ----------
    elapsed : float
        Time since the last epoch [s].
    displacement : (V, D) float or None
        Odometry displacement, in the odometry frame [m]; NaN for a vehicle whose odometry is
        missing, None if nobody has odometry.
    turn : (V,) float or None
        Change of yaw [rad], where there is a displacement.

    """

    elapsed: float
    displacement: Array | None = None
    turn: Array | None = None


@dataclass(frozen=True, eq=False)
class Prior:
    """
    Where somebody says that one vehicle is.

    Attributes
    ----------
    vehicle : int
        Index of the vehicle.
    mean, covariance : (D,), (D, D) float64
        Position [m, m^2].
    yaw : float or None
        Rotation from the odometry frame to the map [rad]; None if unknown.
    yaw_std : float
        [rad].
    velocity_std : float or None
        Of each axis of the velocity, around 0 [m/s]; None if unknown.

    """

    vehicle: int
    mean: Array
    covariance: Array
    yaw: float | None = None
    yaw_std: float = 0.0
    velocity_std: float | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    Where V vehicles are, and how well that is known.

    Attributes
    ----------
    stamp : float
        Time of the measurement [s].
    mean : (V, D) float64
        [m]; NaN before the first beacon.
    covariance : (V, D, D) float64
        [m^2].
    rotation, rotation_variance : (V,) float64
        Rotation from the odometry frame to the map [rad, rad^2]; NaN where there is none.
    ess : (V,) float64
        Effective number of particles of the weighted cloud, before resampling.
    particles : int
        Number of particles, N.
    log_likelihood : (V,) float64
        Log of the cloud's average likelihood of the observation; NaN where nothing was heard.
    heard : (V,) int
        References heard in this epoch.
    reinitialized : (V,) bool
        True where no particle explained the observation and the cloud was drawn anew.
    odometry : (V, 4) float64 or None
        Odometry position [m] and yaw [rad] at the stamp, NaN where there is none; the localizer
        adds it.
    period_factor : (V,) int or None
        How many beacon periods each vehicle wants between two beacons; None if it does not care.

    """

    stamp: float
    mean: Array
    covariance: Array
    rotation: Array
    rotation_variance: Array
    ess: Array
    particles: int
    log_likelihood: Array
    heard: Array
    reinitialized: Array
    odometry: Array | None = None
    period_factor: Array | None = None

    @property
    def yaw(self) -> Array:
        """(V,) float64: yaw of the vehicles in the map [rad], NaN where unknown."""
        if self.odometry is None:
            return np.full(len(self.mean), np.nan)
        return (self.rotation + self.odometry[:, 3] + np.pi) % (2 * np.pi) - np.pi


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    One vehicle's positions over time.

    Attributes
    ----------
    stamp : (T,) float64
        Strictly increasing [s].
    position : (T, D) float64
        [m].
    yaw : (T,) float64
        [rad], NaN where unknown.
    covariance : (T, D, D) float64 or None
        [m^2]; None for ground truth.

    """

    stamp: Array
    position: Array
    yaw: Array
    covariance: Array | None = None
