"""What is learnt of a radio, as far as another localizer can begin with it."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from tsmcl_ros.types import Array

# Share of its prior by which it may have changed while nobody was there.
_AGED = 0.05
# What no P_0 [dB] or n is off by, what no sigma_db is wrong by as a factor, and the fewest rssi
# that it is known as from.
_MOST_OFF = (300.0, 10.0)
_MOST_WRONG, _FEWEST = 100.0, 0.5

Variance = TypeVar('Variance', Array, float)


class LearntRanges(NamedTuple):
    """
    What is known of ranges.

    Attributes
    ----------
    mean, covariance : (2,), (2, 2) float64
        Of scale and offset [m].

    """

    mean: Array
    covariance: Array

    @property
    def is_sound(self) -> bool:
        """Whether it can be."""
        return bool(self.mean[0] > 0)


class LearntRssi(NamedTuple):
    """
    What is known of rssi.

    Attributes
    ----------
    mean, covariance : (2,), (2, 2) float64
        Of what P_0 [dB] and n are off, for all anchors alike.
    sigma, samples : float
        How large noise is beside sigma_db, known as from so many rssi.

    """

    mean: Array
    covariance: Array
    sigma: float
    samples: float

    @property
    def is_sound(self) -> bool:
        """Whether it can be."""
        most, variance = np.array(_MOST_OFF), np.diag(self.covariance)
        return bool(
            (np.abs(self.mean) <= most).all()
            and (variance > 0).all() and (variance <= most ** 2).all()
            and self.covariance[0, 1] ** 2 < variance.prod()
            and 1 / _MOST_WRONG <= self.sigma <= _MOST_WRONG and _FEWEST <= self.samples < np.inf)


class Learnt(NamedTuple):
    """What is known of a radio; None of what it has told nothing of."""

    ranges: LearntRanges | None = None
    rssi: LearntRssi | None = None

    def beside(self, before: Learnt) -> Learnt:
        """Return it with what was known before in place of what it does not know."""
        return Learnt(before.ranges if self.ranges is None else self.ranges,
                      before.rssi if self.rssi is None else self.rssi)


def aged(variance: Variance, prior: Variance) -> Variance:
    """Return the variance of what was known, after a while, from that of who knows nothing."""
    return variance + _AGED * (prior - variance)
