"""Normal variables of which only a part is seen, against sums over their density."""

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.censoring import hazard, seen_beyond


def test_the_hazard_is_density_over_probability() -> None:
    excess = np.array([-30.0, -2.0, 0.0, 1.5])
    ratio, log_below = hazard(excess)
    np.testing.assert_allclose(log_below, stats.norm.logcdf(excess))
    np.testing.assert_allclose(ratio, np.exp(stats.norm.logpdf(excess) - log_below))


def test_moments_of_the_loud_are_those_of_a_truncated_normal() -> None:
    excess = np.array([-2.0, 0.0, 1.5])
    mean, variance = seen_beyond(excess)
    for row, least in enumerate(-excess):
        x = np.linspace(least, 12, 100_001)
        density = np.exp(-0.5 * x ** 2)
        density /= density.sum()
        assert mean[row] == pytest.approx(density @ x, rel=1e-3)
        assert variance[row] == pytest.approx(density @ x ** 2 - (density @ x) ** 2, rel=1e-3)
    np.testing.assert_allclose(seen_beyond(np.array([np.inf])), [[0], [1]], atol=1e-12)
