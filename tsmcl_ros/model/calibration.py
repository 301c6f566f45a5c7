"""Online calibration of range measurements: their scale and offset, one pair for a fleet."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array, Estimate, Observation

# What ranging radios are found to have before calibration: 5 % of scale, 0.3 m of offset.
_PRIOR_STD = np.array([0.05, 0.3])
# Random walk of both per measurement, so that the calibration never quite freezes.
_DRIFT = np.diag([1e-9, 1e-8])
# A measurement further off than this many standard deviations is no news of the calibration.
_GATE = 4.0
# The estimate has used the range that is compared with it, so its own variance says too little.
_INFLATION = 4.0


class RangeCalibration:
    """
    Recursive least squares of measured range against distance to the estimated position.

    It sees only estimates, never the truth: what tells a scale from a wrong position is that
    ranges to anchors all around, and odometry, would else contradict each other.

    Parameters
    ----------
    scale : float
        Initial scale.
    bias : float
        Initial offset [m].
    max_spread : float
        Vehicles less certain than this standard deviation [m] do not take part.

    """

    def __init__(self, scale: float, bias: float, max_spread: float = 5.0):
        self.max_spread = max_spread
        self._mean = np.array([scale, bias])
        self._covariance = np.diag(_PRIOR_STD ** 2)

    @property
    def scale(self) -> float:
        """Measured over true range."""
        return float(self._mean[0])

    @property
    def bias(self) -> float:
        """Measured minus scaled true range [m]."""
        return float(self._mean[1])

    def learn(self, observation: Observation, estimate: Estimate, std: Array) -> None:
        """
        Take in the ranges of an epoch.

        Parameters
        ----------
        observation : Observation
            Of V vehicles.
        estimate : Estimate
            Made from it.
        std : (V, K) float
            Standard deviation of each range [m].

        """
        variance = np.trace(estimate.covariance, axis1=1, axis2=2)
        used = observation.heard & ~np.isnan(observation.range)
        used &= (variance < self.max_spread ** 2)[:, None]
        vehicle, row = np.nonzero(used)
        if not len(vehicle):
            return
        sight = estimate.mean[vehicle] - observation.position[vehicle, row]
        distance = np.maximum(np.linalg.norm(sight, axis=1), 1e-3)
        sight /= distance[:, None]
        shared = estimate.covariance[vehicle] + observation.covariance[vehicle, row]
        noise = std[vehicle, row] ** 2 + _INFLATION * np.einsum(
            'mi,mij,mj->m', sight, shared, sight)
        design = np.stack([distance, np.ones_like(distance)], axis=1)
        residual = observation.range[vehicle, row] - design @ self._mean
        expected = noise + np.einsum('mi,ij,mj->m', design, self._covariance, design)
        sound = residual ** 2 < _GATE ** 2 * expected
        weighted = design[sound] / noise[sound, None]
        information = np.linalg.inv(self._covariance) + weighted.T @ design[sound]
        covariance = np.linalg.inv(information)
        self._mean = self._mean + covariance @ (weighted.T @ residual[sound])
        self._covariance = covariance + _DRIFT
