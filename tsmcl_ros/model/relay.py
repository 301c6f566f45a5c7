"""What vehicles transmit themselves: where they take themselves to be, and whom they hear."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from tsmcl_ros.config import Config, param
from tsmcl_ros.types import ANCHOR, Array, ConfigError, Estimate, Observation, Rows, VEHICLE


@dataclass(frozen=True)
class RelayConfig(Config):
    """What vehicles transmit themselves: their poses, and the anchors that they hear."""

    vehicle_id_offset: int = param(
        1_000_000, 'identity of the first vehicle as a sender, the others count on; no anchor may '
        'have one of these', low=0, high=2**31)
    pose_max_age: float = param(
        3.0, 'a pose that is older than so many beacon periods is not broadcast', low=1, high=100)
    pose_max_speed: float = param(
        50.0, 'how fast a vehicle may have moved since its pose, where its odometry does not tell '
        'the way in the map', unit='m/s', above=0, high=1e4)
    pose_max_spread: float = param(
        0.1, 'a pose whose standard deviation is larger is not broadcast, in radio ranges: the '
        'belief behind it is likely to have several modes, which a covariance hides', above=0,
        high=1)
    relay_hops: int = param(
        1, 'with 2, vehicles relay the anchors that they hear to those who do not', choices=(1, 2))

    def identities(self, vehicles: int) -> range:
        """Return the identities of V vehicles as senders."""
        return range(self.vehicle_id_offset, self.vehicle_id_offset + vehicles)

    def refuse_anchors(self, senders: Observation, vehicles: int) -> None:
        """
        Hold that no sender has the identity of one of V vehicles.

        Raises
        ------
        ConfigError
            Naming the first that has.

        """
        mine = self.identities(vehicles)
        taken = senders.sender[(senders.sender >= mine[0]) & (senders.sender <= mine[-1])]
        if len(taken):
            raise ConfigError(
                f'vehicle_id_offset: {self.vehicle_id_offset} is not allowed, it gives vehicles '
                f'the ids {mine[0]} to {mine[-1]}, and {taken[0]} is an anchor')


@dataclass(frozen=True, eq=False)
class Poses:
    """
    Where V vehicles last took themselves to be.

    Attributes
    ----------
    stamp : (V,) float64
        [s]; NaN for a vehicle without a pose.
    mean : (V, D) float64
        [m].
    covariance : (V, D, D) float64
        [m^2].

    """

    stamp: Array
    mean: Array
    covariance: Array

    @classmethod
    def unknown(cls, vehicles: int, dimension: int) -> Poses:
        """Return V vehicles of which none has a pose."""
        return cls(np.full(vehicles, np.nan), np.full((vehicles, dimension), np.nan),
                   np.full((vehicles, dimension, dimension), np.nan))

    @classmethod
    def of(cls, estimate: Estimate) -> Poses:
        """Return the poses of one epoch's estimates."""
        known = np.isfinite(estimate.mean).all(axis=1)
        return cls(np.where(known, estimate.stamp, np.nan), estimate.mean, estimate.covariance)

    def moved(self, displacement: Array, variance: Array) -> Poses:
        """Return the poses after displacements (V, D) [m], each axis's variance (V,) [m^2]."""
        noise = variance[:, None, None] * np.eye(self.mean.shape[1])
        return replace(self, mean=self.mean + displacement, covariance=self.covariance + noise)

    def within(self, radius: float) -> Array:
        """Return which poses (V,) bool are known, to a standard deviation below a radius [m]."""
        known = np.isfinite(self.mean).all(axis=1) & np.isfinite(self.covariance).all(axis=(1, 2))
        covariance = np.where(known[:, None, None], self.covariance, 0)
        spread = np.sqrt(np.maximum(np.trace(covariance, axis1=1, axis2=2), 0))
        definite = np.linalg.eigvalsh(covariance)[:, 0] > 0
        return np.asarray(known & definite & (spread <= radius))


def vehicle_beacons(config: RelayConfig, poses: Poses) -> Observation:
    """
    Return what V vehicles transmit of their poses.

    Returns
    -------
    Observation
        One transmitter (V = 1) of a row a vehicle, in their order.

    """
    vehicles, dimension = poses.mean.shape
    table = Observation.empty(1, vehicles, dimension, stamp=0.0)
    table.sender[0] = config.identities(vehicles)
    table.kind[0] = VEHICLE
    table.position[0], table.covariance[0] = poses.mean, poses.covariance
    return table


def relay(heard: Observation, listener: Array, neighbour: Array, radio_range: float) -> Rows:
    """
    Return the anchors that vehicles do not hear, but one of their neighbours does.

    They come with hops 2 and nothing measured, one row a vehicle and anchor, however many
    neighbours relay it.

    Parameters
    ----------
    heard : Observation
        What V vehicles hear; vehicles among the senders are not relayed, and what is itself
        relayed neither.
    listener, neighbour : (M,) int
        The vehicles that hear another, and the vehicle that each of them hears.
    radio_range : float
        [m].

    """
    vehicles = len(heard.position)
    vehicle, row = np.nonzero(heard.heard & (heard.kind == ANCHOR) & (heard.hops == 1))
    _, first, anchor = np.unique(
        heard.sender[vehicle, row], return_index=True, return_inverse=True)
    direct = _matrix(vehicle, anchor.reshape(-1), (vehicles, len(first)))
    links = _matrix(listener, neighbour, (vehicles, vehicles))
    # A count of ways, of which those who hear the anchor themselves have none left.
    missed = (links @ direct > direct * np.int32(vehicles)).tocoo()
    order = np.lexsort((missed.col, missed.row))
    listener, anchor = missed.row[order], missed.col[order]
    at = vehicle[first[anchor]], row[first[anchor]]
    return listener, {
        'sender': heard.sender[at], 'position': heard.position[at],
        'covariance': heard.covariance[at], 'hops': np.full(len(order), 2),
        'max_range': np.full(len(order), radio_range),
    }


def _matrix(row: Array, column: Array, shape: tuple[int, int]) -> csr_array:
    """Return a sparse matrix that is 1 at these places, which are all different."""
    return csr_array((np.ones(len(row), np.int32), (row, column)), shape=shape)
