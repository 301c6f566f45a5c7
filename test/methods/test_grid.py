"""The exact grid: kernels against integrals, beliefs against closed forms, refusals."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import integrate, stats
from tsmcl_ros.methods.grid import disk_kernel, Grid, GridConfig, hat_kernel
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ConfigError, Motion, Observation, Prior

KNOWN = {'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 0.0, 'alpha3': 0.0,
         'alpha4': 0.0}
RANDOM = {'motion_model': 'random', 'max_speed': 20.0}


def grid(motion: dict[str, Any] = KNOWN, area: float = 0.0, cell: float = 5.0, vehicles: int = 1,
         dimension: int = 2, **settings: Any) -> Grid:
    """Return a grid over a square of twice the area's half width, or what is heard first."""
    if area:
        settings = {'grid_x_min': -area, 'grid_x_max': area, 'grid_y_min': -area,
                    'grid_y_max': area, **settings}
    return Grid(GridConfig(grid_cell=cell, **settings),
                Channel(RadioConfig(radio_range=100.0, edge_softness=0.1),
                        EvidenceConfig(outlier_fraction=0.0)),
                motion_model(MotionConfig(**motion), dimension, True), vehicles, dimension,
                np.random.default_rng(1))


def listen(*positions: tuple[float, float], vehicles: int = 1) -> Observation:
    """Let every vehicle hear anchors at these positions [m]."""
    observation = Observation.empty(vehicles, len(positions), 2, 1.0)
    observation.sender[:] = np.arange(len(positions))
    observation.position[:] = np.reshape(positions, (-1, 2))
    return observation


NOTHING = Observation.empty(1, 0, 2, 2.0)
EVERYWHERE = Observation(**{**vars(listen((0.0, 0.0))), 'max_range': np.full((1, 1), 1e5)})


def known(x: float, y: float, covariance: np.ndarray, **settings: Any) -> Grid:
    """Return a grid of 400 m with a Gaussian belief."""
    filter_ = grid(area=200.0, **settings)
    filter_.start(Prior(0, np.array([x, y]), covariance))
    filter_.update(EVERYWHERE)
    return filter_


# Kernels


@pytest.mark.parametrize('radius', [0.0, 0.3, 0.5, 1.0, 2.4, 7.7])
def test_a_disk_kernel_is_symmetric_about_its_middle_cell(radius: float) -> None:
    kernel = disk_kernel(radius)
    assert kernel.shape[0] == kernel.shape[1]
    assert kernel.shape[0] % 2 == 1
    np.testing.assert_allclose(kernel, kernel[::-1], atol=1e-15)
    np.testing.assert_allclose(kernel, kernel.T, atol=1e-15)
    assert kernel.sum() == pytest.approx(1.0)


@pytest.mark.parametrize('radius', [1.5, 2.4, 5.0, 7.7])
def test_a_disk_kernel_covers_the_area_of_the_disk(radius: float) -> None:
    # All inner cells weigh one over the area; the raster is good to 1 %.
    assert 1 / disk_kernel(radius).max() == pytest.approx(math.pi * radius ** 2, rel=0.01)


@pytest.mark.parametrize('radius', [0.2, 0.5, 1.0, 2.4, 7.7, 60.3])
def test_a_disk_kernel_spreads_as_the_disk_does_however_small(radius: float) -> None:
    kernel = disk_kernel(radius)
    reach = len(kernel) // 2
    outwards = np.abs(np.arange(-reach, reach + 1))
    second = (kernel.sum(axis=0) * outwards ** 2).sum()
    # A disk's variance is r^2 / 4 an axis. The hat adds f (1 - f) at a fraction f of a cell, 1 / 6
    # on average; within one cell that makes x^2 into |x|, of which a disk has 4 r / (3 pi).
    expected = radius ** 2 / 4 + 1 / 6 if radius > 1 else 4 * radius / (3 * math.pi)
    assert second == pytest.approx(expected, rel=0.03)


def test_no_motion_leaves_the_belief_in_its_cell() -> None:
    kernel = disk_kernel(0.0)
    assert kernel[len(kernel) // 2, len(kernel) // 2] == 1.0


@given(mean=st.floats(-3.0, 3.0), std=st.one_of(st.just(0.0), st.floats(1e-6, 4.0)))
def test_a_hat_kernel_keeps_mass_and_mean_however_narrow(mean: float, std: float) -> None:
    offsets = np.arange(-40, 41)
    kernel = hat_kernel(offsets - mean, np.array(std))
    assert kernel.min() > -1e-12
    assert kernel.sum() == pytest.approx(1.0, abs=1e-9)
    assert (kernel * offsets).sum() == pytest.approx(mean, abs=1e-9)


@pytest.mark.parametrize('std', [0.1, 0.5, 2.0])
def test_a_hat_kernel_is_a_gaussian_averaged_over_a_hat(std: float) -> None:
    x = np.linspace(-1, 1, 20_001)
    for offset in (-2.0, -0.3, 0.0, 0.9, 3.5):
        expected = integrate.simpson(stats.norm(offset, std).pdf(x) * (1 - np.abs(x)), x=x)
        assert hat_kernel(np.array(offset), np.array(std)) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize('std', [1.0, 3.0])
def test_a_hat_adds_a_sixth_of_a_cell_squared_to_the_variance(std: float) -> None:
    offsets = np.arange(-40, 41)
    kernel = hat_kernel(offsets - 0.4, np.array(std))
    assert (kernel * (offsets - 0.4) ** 2).sum() == pytest.approx(std ** 2 + 1 / 6, rel=1e-4)


# Prediction


def test_random_motion_spreads_the_belief_and_does_not_drift() -> None:
    filter_ = known(30.0, -20.0, 100.0 * np.eye(2), motion=RANDOM)
    before = filter_.update(NOTHING)
    for _ in range(10):
        filter_.predict(Motion(1.0))
    after = filter_.update(NOTHING)
    np.testing.assert_allclose(after.mean, before.mean, atol=1e-3)
    # Uniform in a disk of 20 m, ten times over: each time r^2 / 4, and the hat's share.
    np.testing.assert_allclose(after.covariance[0] - before.covariance[0],
                               10 * (100.0 + 25.0 / 6) * np.eye(2), rtol=0.01, atol=0.1)


@pytest.mark.parametrize(('x', 'y'), [(5.0, -10.0), (1.3, 7.1), (0.01, 0.0)])
def test_odometry_moves_the_mean_by_the_displacement_whatever_the_cells(x: float, y: float
                                                                        ) -> None:
    filter_ = known(0.0, 0.0, 100.0 * np.eye(2))
    before = filter_.update(NOTHING)
    for _ in range(5):
        filter_.predict(Motion(1.0, np.array([[x, y]]), np.zeros(1)))
    after = filter_.update(NOTHING)
    np.testing.assert_allclose(after.mean - before.mean, [[5 * x, 5 * y]], atol=1e-3)


def test_odometry_noise_widens_the_belief() -> None:
    filter_ = known(0.0, 0.0, 100.0 * np.eye(2), motion={**KNOWN, 'odom_std': 12.0})
    before = filter_.update(NOTHING)
    filter_.predict(Motion(4.0, np.array([[3.0, 4.0]]), np.zeros(1)))
    after = filter_.update(NOTHING)
    # 12 m a root second over 4 s, and the hat's sixth of a cell.
    np.testing.assert_allclose(after.covariance[0] - before.covariance[0],
                               (576.0 + 25.0 / 6) * np.eye(2), rtol=1e-3, atol=0.1)


def test_vehicles_are_moved_by_their_own_odometry() -> None:
    filter_ = grid(area=200.0, vehicles=2)
    for vehicle in range(2):
        filter_.start(Prior(vehicle, np.zeros(2), 100.0 * np.eye(2)))
    filter_.update(listen((0.0, 0.0), vehicles=2))
    filter_.predict(Motion(1.0, np.array([[20.0, 0.0], [0.0, -30.0]]), np.zeros(2)))
    estimate = filter_.update(Observation.empty(2, 0, 2, 2.0))
    np.testing.assert_allclose(estimate.mean, [[20.0, 0.0], [0.0, -30.0]], atol=1e-3)


def test_missing_odometry_spreads_as_random_motion_does() -> None:
    filter_ = known(0.0, 0.0, 100.0 * np.eye(2), motion={**KNOWN, 'max_speed': 20.0})
    before = filter_.update(NOTHING)
    filter_.predict(Motion(1.0))
    after = filter_.update(NOTHING)
    np.testing.assert_allclose(after.covariance[0] - before.covariance[0],
                               (100.0 + 25.0 / 6) * np.eye(2), rtol=1e-3, atol=0.1)


def test_a_belief_that_has_left_the_area_could_be_anywhere_in_it() -> None:
    filter_ = known(0.0, 0.0, 100.0 * np.eye(2), cell=20.0)
    filter_.predict(Motion(1.0, np.array([[5000.0, 0.0]]), np.zeros(1)))
    covariance = filter_.update(NOTHING).covariance[0]
    np.testing.assert_allclose(covariance, 400.0 ** 2 / 12 * np.eye(2), rtol=1e-3, atol=1.0)


# Update


def test_the_log_likelihood_is_that_of_the_areas() -> None:
    filter_ = grid(cell=1.0)
    filter_.update(listen((0.0, 0.0)))
    likelihood = filter_.update(listen((100.0, 0.0))).log_likelihood[0]
    # The lens of two disks a radius apart, over the disk; edges and cells are 1 % of it.
    lens = 2 * math.pi / 3 - math.sqrt(3) / 2
    assert likelihood == pytest.approx(math.log(lens / math.pi), abs=0.015)


def test_a_disk_s_belief_is_uniform_in_it() -> None:
    filter_ = grid(cell=1.0)
    estimate = filter_.update(listen((7.0, -3.0)))
    np.testing.assert_allclose(estimate.mean, [[7.0, -3.0]], atol=0.01)
    np.testing.assert_allclose(estimate.covariance[0], 100.0 ** 2 / 4 * np.eye(2), rtol=0.01,
                               atol=1.0)
    # The effective number of cells is that of the disk's area.
    assert estimate.ess[0] == pytest.approx(math.pi * 100.0 ** 2, rel=0.01)


def test_a_single_cell_is_uncertain_by_its_own_width() -> None:
    filter_ = grid(area=50.0, cell=12.0)
    filter_.start(Prior(0, np.array([-8.0, -8.0]), 1e-6 * np.eye(2)))
    covariance = filter_.update(EVERYWHERE).covariance[0]
    # That width counts in the prior too, of which 6 % reach the neighbours.
    np.testing.assert_allclose(covariance, 12.0 * np.eye(2), atol=1.0)


@pytest.mark.parametrize('correlation', [0.0, 0.8])
def test_a_prior_s_mean_and_covariance_are_those_of_the_belief(correlation: float) -> None:
    covariance = np.array([[400.0, 200.0 * correlation], [200.0 * correlation, 100.0]])
    estimate = known(31.0, -17.0, covariance, cell=2.0).update(NOTHING)
    np.testing.assert_allclose(estimate.mean, [[31.0, -17.0]], atol=0.01)
    # Cells of 2 m count as 1/3 m^2, twice: once in the prior, once in the estimate.
    np.testing.assert_allclose(estimate.covariance[0], covariance + 2 / 3 * np.eye(2), atol=0.5)


def test_a_prior_may_be_exact() -> None:
    estimate = known(31.0, -17.0, np.zeros((2, 2))).update(NOTHING)
    np.testing.assert_allclose(estimate.mean, [[31.0, -17.0]], atol=2.5)
    assert np.sqrt(np.trace(estimate.covariance[0])) < 5.0


def test_a_prior_replaces_the_belief_that_there_was() -> None:
    filter_ = known(100.0, 100.0, 100.0 * np.eye(2))
    filter_.start(Prior(0, np.array([-50.0, 0.0]), 100.0 * np.eye(2)))
    np.testing.assert_allclose(filter_.update(NOTHING).mean, [[-50.0, 0.0]], atol=0.1)


def test_a_prior_waits_for_the_area_that_the_first_beacon_gives() -> None:
    filter_ = grid()
    filter_.start(Prior(0, np.array([30.0, 0.0]), 100.0 * np.eye(2)))
    assert np.isnan(filter_.update(NOTHING).mean).all()
    np.testing.assert_allclose(filter_.update(listen((0.0, 0.0))).mean, [[30.0, 0.0]], atol=1.0)


def test_a_belief_that_everything_contradicts_starts_from_what_is_heard() -> None:
    filter_ = known(-150.0, 0.0, np.eye(2))
    estimate = filter_.update(listen((150.0, 0.0)))
    assert estimate.reinitialized[0]
    assert estimate.mean[0, 0] > 50.0


# The area


def test_the_area_is_where_the_references_heard_first_leave_the_vehicles() -> None:
    filter_ = grid(vehicles=2)
    filter_.update(Observation.stack([listen((0.0, 0.0)), listen((300.0, 50.0))], 1.0))
    np.testing.assert_allclose(filter_.cells.min(axis=0), [-100.3 + 2.5, -100.3 + 2.5], atol=1e-3)
    assert np.all(np.abs(filter_.cells.max(axis=0) - [400.3, 150.3]) < 5.0)


def test_a_margin_grows_the_area() -> None:
    plain, grown = grid(), grid(grid_margin=50.0)
    for filter_ in (plain, grown):
        filter_.update(listen((0.0, 0.0)))
    assert plain.cells.min() - grown.cells.min() == pytest.approx(50.0)
    assert len(grown.cells) == pytest.approx(len(plain.cells) * 1.5 ** 2, rel=0.05)


def test_an_area_of_too_many_cells_is_refused_with_their_number() -> None:
    with pytest.raises(ConfigError, match=r'grid_cell: 1 m cuts the area of 400 x 400 m into '
                                          r'160000 cells, grid_max_cells allows 100000'):
        grid(area=200.0, cell=1.0, grid_max_cells=100_000).update(listen((0.0, 0.0)))


@pytest.mark.parametrize('area', [
    {'grid_x_max': 10.0}, {'grid_x_min': 5.0, 'grid_x_max': -5.0, 'grid_y_max': 1.0},
])
def test_an_area_that_is_none_is_refused(area: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match='must be all 0 or each minimum below its maximum'):
        GridConfig(**area)


# What a grid cannot hold


def test_three_dimensions_are_refused() -> None:
    error = 'dimension: 3 is not allowed for method grid, must be 2'
    with pytest.raises(ConfigError, match=error):
        grid(dimension=3)


@pytest.mark.parametrize('motion', [
    {**KNOWN, 'odom_heading': 'unknown'}, {'motion_model': 'velocity'},
])
def test_a_motion_that_remembers_more_than_a_position_is_refused(motion: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match='grid holds positions only, so motion_model must be'):
        grid(motion)
