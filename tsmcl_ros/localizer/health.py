"""How localizers say that they are doing."""

from __future__ import annotations

from dataclasses import dataclass

from tsmcl_ros.types import Array


@dataclass(frozen=True, eq=False)
class Health:
    """
    How V vehicles' localization is doing.

    Attributes
    ----------
    status : (V,) int
        OK, STALE (predicting through an outage) or LOST (not placed, or not where it is believed
        to be).
    lost : (V,) float
        Probability that what was heard contradicts the estimate because the vehicle is elsewhere.
    suspects : list of V lists of int
        Senders that contradict what all others agree on.
    age : (V,) float
        Time since the last beacon [s], inf before the first.
    reinitializations : (V,) int
        Times that no particle explained what was heard.

    """

    status: Array
    lost: Array
    suspects: list[list[int]]
    age: Array
    reinitializations: Array
