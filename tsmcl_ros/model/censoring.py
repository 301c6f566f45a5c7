"""Normal variables of which only a part is seen: the loud, or none as they are too weak."""

from __future__ import annotations

import math

import numpy as np
import scipy
from tsmcl_ros.types import Array


def hazard(excess: Array) -> tuple[Array, Array]:
    """Return phi / Phi of a standard normal variable at `excess`, and the logarithm of Phi."""
    log_below = scipy.special.log_ndtr(excess)
    return np.exp(-0.5 * excess ** 2 - log_below) / math.sqrt(2 * math.pi), log_below


def seen_beyond(excess: Array) -> tuple[Array, Array]:
    """
    Return the mean and variance of a standard normal variable of which more than -excess is seen.

    The variance is also by how much the mean of what is seen follows that of all.
    """
    excess = np.minimum(excess, 30.0)  # beyond, all is seen
    ratio, _ = hazard(excess)
    return ratio, np.clip(1 - ratio * (ratio + excess), 0.05, 1)
