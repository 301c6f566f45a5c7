"""Where rings around references are drawn, against the density that they say they have."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.model.geometry import Arcs
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.model.ranging import without_ranges
from tsmcl_ros.model.rings import Rings
from tsmcl_ros.types import Observation

MANY = 100_000


def rings(half: float, std: float, noise: str = 'gaussian') -> Rings:
    """Return two references with ranges, one of them uncertain, and one without."""
    observation = Observation.empty(1, 3, 2, 1.0)
    observation.sender[:] = [0, 1, 2]
    observation.position[0] = [[0.0, 0.0], [30.0, 0.0], [9.0, 9.0]]
    observation.covariance[0, 1] = np.diag([std ** 2, (std / 2) ** 2])
    observation.range[0] = [20.0, 25.0, np.nan]
    channel = Channel(RadioConfig(range_noise=noise, range_std=2.0), EvidenceConfig())
    ranging, _ = without_ranges(channel.evidence(observation))
    assert ranging is not None
    middle = np.array([[0.5, 2.0, 0.0]], np.float32)
    return Rings(ranging, Arcs(middle, np.full((1, 3), half, np.float32)))


@pytest.mark.parametrize('noise', ['gaussian', 'asymmetric_exponential'])
@pytest.mark.parametrize(('half', 'std'), [(np.pi, 0.0), (0.4, 0.0), (0.4, 4.0)])
def test_samples_have_the_density_that_they_are_weighed_by(
        half: float, std: float, noise: str) -> None:
    sectors = rings(half, std, noise)
    points, _ = sectors.draw(MANY, np.random.default_rng(1))
    listed = points[:, :2].reshape(1, -1, 2)  # the third has no range
    edges = np.linspace(-60.0, 90.0, 51)
    counts, _, _ = np.histogram2d(*listed[0].T, bins=[edges, edges])
    fine = np.linspace(-60.0, 90.0, 501)
    fine = (fine[:-1] + fine[1:]) / 2
    raster = np.stack(np.meshgrid(fine, fine, indexing='ij'), axis=-1).reshape(1, -1, 2)
    raster = raster.astype(np.float32)
    distance, _ = sectors.ranging.references.distance(raster)
    density = np.exp(
        sectors.log_density(raster, distance, sectors.ranging.log_density(raster))[0])
    cells = density.reshape(50, 10, 50, 10).sum(axis=(1, 3)) * 0.3 ** 2
    # A tenth of the samples' own noise; the variance across the line of sight is second order.
    apart = np.abs(counts / counts.sum() - cells).sum() / 2
    assert apart < (0.03 if std == 0 else 0.06)
    assert cells.sum() == pytest.approx(1.0, abs=0.03)


def test_a_sample_s_direction_is_where_its_reference_sees_it() -> None:
    sectors = rings(0.4, 3.0)
    points, direction = sectors.draw(100, np.random.default_rng(1))
    away = points[0, 1] - [30.0, 0.0]
    np.testing.assert_allclose(np.arctan2(away[:, 1], away[:, 0]), direction[0, 1], atol=1e-3)
