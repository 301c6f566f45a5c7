"""When the beliefs of vehicles whose ranges are heard one after the other have become places."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array, Estimate, Observation


class Settling:
    """
    Which vehicles have a place, as more than circles around anchors is known of them.

    One range leaves a vehicle anywhere on a circle, whose middle, the mean of what is believed,
    is where it certainly is not; two leave it at either of two points. So a vehicle has a place
    once it has ranges to D + 1 senders at once, or a belief that is no longer bent around them.

    Parameters
    ----------
    vehicles : int
        V.

    Attributes
    ----------
    done : (V,) bool
        Who has one.

    """

    def __init__(self, vehicles: int):
        self.done = np.zeros(vehicles, bool)

    def judge(self, observation: Observation, estimate: Estimate,
              ranges: tuple[Array, Array, Array]) -> None:
        """Judge by an epoch's beacons and the estimate made from them: see `settled`."""
        self.done &= ~estimate.reinitialized
        enough = ranges[2].sum(axis=1) > estimate.mean.shape[1]
        self.done |= observation.heard.any(axis=1) & (
            enough | settled(observation, estimate, ranges))

    def placed(self, estimate: Estimate) -> Array:
        """Return the estimated positions (V, D) [m], NaN of who has no place."""
        return np.where(self.done[:, None], estimate.mean, np.nan)


def settled(observation: Observation, estimate: Estimate, ranges: tuple[Array, Array, Array]
            ) -> Array:
    """
    Return the vehicles (V,) bool whose ranges do not bend the belief around their senders.

    All that is believed in is on average further from a sender than its mean is, by up to
    tr(P) / 2 d. Where that is less than two of the range's errors, the mean is a place like any.

    Parameters
    ----------
    observation : Observation
        Of V vehicles.
    estimate : Estimate
        Made from it.
    ranges : three arrays (V, K)
        Distance and standard deviation [m], and which are used, as `Channel.distances` has them.

    """
    distance, std, used = ranges
    spread = np.trace(estimate.covariance, axis1=1, axis2=2)[:, None]
    error = np.sqrt(std ** 2 + np.trace(observation.covariance, axis1=2, axis2=3))
    bent = used & ~(spread <= 4 * error * np.maximum(distance, error))
    return np.asarray(np.isfinite(estimate.mean).all(axis=1) & ~bent.any(axis=1))
