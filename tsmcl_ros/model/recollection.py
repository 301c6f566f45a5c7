"""What vehicles have heard of late, from where they are now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types import Array, pair, split

# Epochs after which who is not heard any more is forgotten.
_HORIZON = 100


@dataclass(frozen=True, eq=False)
class Disks:
    """
    Disks in which V vehicles are now, if what M senders each claimed was true.

    Attributes
    ----------
    sender : (V, M) int
        Identities, one column each.
    used : (V, M) bool
        False where padded.
    centre : (2, V, M, D) float64
        As of when a sender was first and last heard [m].
    radius : (V, M) float64
        [m].
    variance : (2, V, M) float64
        What is uncertain of the way since then [m^2].

    """

    sender: Array
    used: Array
    centre: Array
    radius: Array
    variance: Array


class Recollection:
    """
    When V vehicles first and last heard each sender, and how they have moved since.

    A disk holds all of a straight way if it holds both ends, so these two tell nearly all that a
    sender's beacons did. It lasts as long as odometry tells of the way.

    Parameters
    ----------
    vehicles, dimension : int
        V and D.

    Attributes
    ----------
    follows : (V,) bool
        Whose way of the last epoch is known.

    """

    def __init__(self, vehicles: int, dimension: int):
        self._way = np.zeros((vehicles, dimension))
        self._variance = np.zeros(vehicles)
        self._epoch = 0
        self.follows = np.zeros(vehicles, bool)
        self._pair = np.zeros(0, np.int64)
        # Centres as they would be if the vehicle had been at 0 all the time.
        self._centre = np.zeros((2, 0, dimension))
        self._then = np.zeros((2, 0))
        self._radius = np.zeros(0)
        self._heard = np.zeros(0, int)

    def move(self, displacement: Array, variance: Array) -> None:
        """
        Take in an epoch's motion.

        Parameters
        ----------
        displacement : (V, D) float
            In the map [m]; NaN where it is unknown, so that all before is of no use.
        variance : (V,) float
            What is uncertain of it, along each axis [m^2].

        """
        self._epoch += 1
        known = np.isfinite(displacement).all(axis=1)
        self.follows = known
        self._way += np.where(known[:, None], displacement, 0)
        self._variance += np.where(known, variance, 0)
        self.forget(~known)

    def forget(self, which: Array) -> None:
        """Forget what some vehicles (V,) bool have heard."""
        if len(self._pair):
            self._keep(~which[split(self._pair)[0]])

    def hear(self, vehicle: Array, sender: Array, centre: Array, radius: Array) -> None:
        """Take in that vehicles (M,) heard senders (M,) with disks (M, D), (M,) [m]."""
        pairs, first = np.unique(pair(vehicle, sender), return_index=True)
        vehicle = vehicle[first]
        place, variance = centre[first] - self._way[vehicle], self._variance[vehicle]
        merged = np.union1d(self._pair, pairs)
        old, new = np.searchsorted(merged, self._pair), np.searchsorted(merged, pairs)
        centres, then = np.zeros((2, len(merged), place.shape[1])), np.zeros((2, len(merged)))
        sizes, heard = np.zeros(len(merged)), np.zeros(len(merged), int)
        centres[:, new], then[:, new] = place, variance
        centres[:, old], then[:, old] = self._centre, self._then
        sizes[old], heard[old] = self._radius, self._heard
        centres[1, new], then[1, new] = place, variance
        sizes[new], heard[new] = radius[first], self._epoch
        self._pair, self._centre, self._then = merged, centres, then
        self._radius, self._heard = sizes, heard
        self._keep(self._epoch - heard < _HORIZON)

    def disks(self, vehicle: Array) -> Disks:
        """Return the disks of some vehicles (V,), in increasing order."""
        nobody = np.zeros_like(vehicle)
        begin, end = (
            np.searchsorted(self._pair, pair(vehicle + later, nobody)) for later in (0, 1))
        column = begin[:, None] + np.arange((end - begin).max(initial=0))
        used = column < end[:, None]
        column = np.where(used, column, 0)
        _, sender = split(self._pair)
        return Disks(
            sender[column], used, self._centre[:, column] + self._way[vehicle][:, None],
            self._radius[column], self._variance[vehicle][:, None] - self._then[:, column])

    def _keep(self, rows: Array) -> None:
        self._pair, self._radius, self._heard = (
            self._pair[rows], self._radius[rows], self._heard[rows])
        self._centre, self._then = self._centre[:, rows], self._then[:, rows]
