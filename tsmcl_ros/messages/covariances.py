"""What a covariance must be."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array

_ROUNDING = 1e-5  # of a correlation; those of FLOAT32 variances are off by 1e-6


def is_covariance(matrix: Array) -> bool:
    """Tell whether matrices (..., D, D) are covariances, but for rounding."""
    variance = np.diagonal(matrix, axis1=-2, axis2=-1)
    if not np.isfinite(matrix).all() or (variance < 0).any():
        return False
    # Of the correlations, so that a large variance does not hide what is wrong with a small one.
    std = np.sqrt(variance)
    scale = std[..., :, np.newaxis] * std[..., np.newaxis, :]
    with np.errstate(over='ignore'):
        correlation = np.divide(matrix, scale, out=np.array(matrix), where=scale > 0)
    if (np.abs(correlation) > 1 + _ROUNDING).any():
        return False
    if (np.abs(correlation - np.swapaxes(correlation, -1, -2)) > _ROUNDING).any():
        return False
    return bool((np.linalg.eigvalsh(correlation) >= -_ROUNDING).all())
