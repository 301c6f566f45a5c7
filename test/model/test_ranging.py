"""Laws of range errors, against quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.model.ranging import AsymmetricErrors, draw_asymmetric, GaussianErrors, RangeErrors
from tsmcl_ros.types import Observation

SHORT, LONG = 1.2, 4.0


def column(value: float) -> np.ndarray:
    return np.full((1, 1, 1), value, np.float32)


LAWS: list[RangeErrors] = [
    GaussianErrors.of(column(3.0)), AsymmetricErrors.of(column(SHORT), column(LONG))]


def density(law: RangeErrors, error: float, variance: float | None = None) -> float:
    """Return p(e) [1/m]."""
    spread = None if variance is None else column(variance)
    return math.exp(law.log_density(column(error), spread).item())


@pytest.mark.parametrize('variance', [None, 0.01, 4.0, 400.0])
@pytest.mark.parametrize('law', LAWS)
def test_densities_integrate_to_one(law: RangeErrors, variance: float | None) -> None:
    error = np.linspace(-200, 200, 400_001, dtype=np.float32)[None, None]
    spread = None if variance is None else np.full_like(error, variance)
    assert np.exp(law.log_density(error, spread)).sum() * 1e-3 == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize('variance', [0.01, 4.0, 400.0])
@pytest.mark.parametrize('error', [-20.0, -5.0, 0.0, 0.5, 5.0, 20.0])
@pytest.mark.parametrize('law', LAWS)
def test_an_uncertain_distance_convolves_the_law(
        law: RangeErrors, error: float, variance: float) -> None:
    std = math.sqrt(variance)
    grid = np.linspace(error - 9 * std, error + 9 * std, 20_001)
    exact = np.exp(law.log_density(grid[None, None].astype(np.float32), None)[0, 0])
    average = integrate.trapezoid(exact * stats.norm.pdf(grid, error, std), grid)
    assert math.log(density(law, error, variance)) == pytest.approx(
        math.log(average), rel=2e-3, abs=2e-3)


@pytest.mark.parametrize('least', [None, 0.01, 4.0, 400.0])
@pytest.mark.parametrize('law', LAWS)
def test_no_density_exceeds_the_bound_and_the_greatest_comes_near(
        law: RangeErrors, least: float | None) -> None:
    error = np.linspace(-60, 60, 2401, dtype=np.float32)[None, None]
    variance = None if least is None else np.full_like(error, least)
    bound = law.bound(None if least is None else column(least))
    excess = law.log_density(error, variance) - bound
    assert -0.7 < excess.max() <= 1e-5


@pytest.mark.parametrize('law', LAWS)
def test_densities_are_finite_however_far_off(law: RangeErrors) -> None:
    error = np.array([-1e5, -1e3, 1e3, 1e5], np.float32)[None, None]
    for variance in (0.0, 1e-8, 1.0, 1e8):
        assert np.isfinite(law.log_density(error, np.full_like(error, variance))).all()


@pytest.mark.parametrize('law', LAWS)
def test_errors_are_drawn_by_their_density(law: RangeErrors) -> None:
    drawn = law.draw(20_000, np.random.default_rng(1)).ravel()
    grid = np.linspace(-60, 30, 9001)
    cdf = np.cumsum(np.exp(law.log_density(grid[None, None].astype(np.float32), None)[0, 0]))
    assert stats.kstest(drawn, lambda e: np.interp(e, grid, cdf * 0.01)).pvalue > 1e-3


def test_errors_without_scales_are_zero() -> None:
    padded = column(np.inf)
    for law in (GaussianErrors.of(padded), AsymmetricErrors.of(padded, padded)):
        assert not law.draw(5, np.random.default_rng(1)).any()


def test_the_mean_of_asymmetric_errors_is_the_difference_of_their_scales() -> None:
    drawn = draw_asymmetric(np.float32(SHORT), np.float32(LONG), (40_000,),
                            np.random.default_rng(1))
    # The standard error is 0.02 m.
    assert drawn.mean() == pytest.approx(SHORT - LONG, abs=0.08)


@pytest.mark.parametrize('noise', ['gaussian', 'asymmetric_exponential'])
def test_ranges_resolve_what_their_law_s_fisher_information_says(noise: str) -> None:
    channel = Channel(RadioConfig(range_noise=noise, range_std=3.0),
                      EvidenceConfig(range_calibration='off'))
    observation = Observation.empty(1, 1, 2, 0.0)
    observation.sender[:] = 0
    observation.range[:] = 20.0
    std, used = channel.resolution(observation)
    scales = 0.058 * 20 + 0.01, 0.19 * 20 + 0.21
    law = (GaussianErrors.of(column(3.0)) if noise == 'gaussian' else
           AsymmetricErrors.of(*(column(scale) for scale in scales)))
    # Beside the peak, of which a step would take both sides.
    error = np.linspace(-150, 150, 60_000)
    log_density = law.log_density(error[None, None], None)[0, 0].astype(np.float64)
    slope = np.diff(log_density) / np.diff(error)
    information = (slope ** 2 * np.exp(log_density[1:])).sum() * (error[1] - error[0])
    assert used.all()
    assert std[0, 0] == pytest.approx(1 / math.sqrt(information), rel=0.02)
