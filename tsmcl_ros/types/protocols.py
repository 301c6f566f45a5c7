"""What parts of the package offer each other, whoever they are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, TypeVar

from tsmcl_ros.types.arrays import Array
from tsmcl_ros.types.observation import Observation
from tsmcl_ros.types.poses import Estimate, Motion, Prior

T = TypeVar('T')


class Progress(Protocol):
    """Hands through what a loop goes over, and shows how far it is: libraries never print."""

    def __call__(self, items: Iterable[T], total: int | None, unit: str, name: str = ''
                 ) -> Iterable[T]:
        """
        Return the items.

        Parameters
        ----------
        items
            What the loop goes over.
        total
            How many there are, None if nobody knows.
        unit, name
            What an item is, and what is done with them.

        """


def unshown(items: Iterable[T], total: int | None, unit: str, name: str = '') -> Iterable[T]:
    """Return the items and show nothing; see `Progress`."""
    return items


class Estimator(Protocol):
    """
    What every method offers to the localizer; it knows arrays and nothing else.

    `particles` is the cloud (V, N, D) [m]; (V, 0, D) for a method without one.
    """

    @property
    def particles(self) -> Array:
        """Return the cloud (V, N, D) [m]; (V, 0, D) for a method without one."""

    def moments(self) -> tuple[Array, Array]:
        """Return mean (V, D) [m] and covariance (V, D, D) [m^2] of the belief as it stands."""

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior."""

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts anew at its next beacon."""

    def predict(self, motion: Motion) -> None:
        """Move the belief by the motion since the last epoch."""

    def update(self, observation: Observation) -> Estimate:
        """Weigh the belief by what was heard; with nothing heard, only report it."""
