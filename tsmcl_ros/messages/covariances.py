"""What a covariance must be."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array

_ROUNDING = 1e-5  # of a correlation; those of FLOAT32 variances are off by 1e-6


def is_covariance(matrix: Array) -> Array:
    """Return which matrices (..., D, D) are covariances, but for rounding, as (...) bool."""
    variance = np.diagonal(matrix, axis1=-2, axis2=-1)
    sound = np.isfinite(matrix).all(axis=(-2, -1)) & (variance >= 0).all(axis=-1)
    if not sound.all():
        matrix = np.where(sound[..., np.newaxis, np.newaxis], matrix, 0)
        variance = np.diagonal(matrix, axis1=-2, axis2=-1)
    # Of the correlations, so that a large variance does not hide what is wrong with a small one.
    std = np.sqrt(variance)
    scale = std[..., :, np.newaxis] * std[..., np.newaxis, :]
    with np.errstate(over='ignore'):
        correlation = np.divide(matrix, scale, out=np.array(matrix), where=scale > 0)
    wrong = np.abs(correlation) > 1 + _ROUNDING
    # What overflows is wrong already, and nothing to reckon with.
    correlation = np.clip(correlation, -2, 2)
    wrong |= np.abs(correlation - np.swapaxes(correlation, -1, -2)) > _ROUNDING
    sound &= ~wrong.any(axis=(-2, -1))
    least = np.linalg.eigvalsh(correlation)[..., 0]
    return np.asarray(sound & (least >= -_ROUNDING))
