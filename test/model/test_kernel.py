"""Motion kernels against the motion models that they stand for, and against scipy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.kernel import BallKernel, choose, GaussianKernel
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.types import Motion

SIGNIFICANCE = 1e-3
MANY = 20_000
LOW, HIGH = np.array([[2.0, -3.0]]), np.array([[9.0, 4.0]])


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize('settings', [
    {'motion_model': 'random', 'max_speed': 8.0},
    {'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 4.0},
    {'motion_model': 'odometry', 'odom_heading': 'unknown', 'odom_std': 3.0, 'alpha2': 0.3},
    {'motion_model': 'velocity', 'acceleration_std': 6.0, 'max_speed': 5.0},
    {'motion_model': 'velocity', 'acceleration_std': 6.0, 'speed_decay': 2.0},
])
def test_draws_in_a_box_are_what_the_motion_model_puts_there(settings: dict[str, Any]) -> None:
    model = motion_model(MotionConfig(**settings), 2, True)
    draw = rng()
    parents = np.concatenate([
        np.zeros((1, MANY, 2), np.float32), model.draw(1, MANY, draw)], axis=2)
    motion = Motion(1.0, np.array([[3.0, 1.0]]), np.array([0.2]))
    moved = model.predict(parents, motion, draw)[0]
    expected = moved[((moved[:, :2] > LOW) & (moved[:, :2] < HIGH)).all(axis=1)]
    kernel = model.kernel(parents, motion, draw)
    owner = np.zeros(8000, int)
    drawn, valid = kernel.draw(
        owner, choose(kernel.mass(LOW, HIGH), owner, draw), LOW, HIGH,
        draw.random((8000, 2)), draw)
    drawn = drawn[valid]
    assert ((drawn[:, :2] >= LOW) & (drawn[:, :2] <= HIGH)).all()
    for axis in range(drawn.shape[1]):
        assert stats.ks_2samp(drawn[:, axis], expected[:, axis]).pvalue > SIGNIFICANCE
    if model.extra:
        # What is remembered belongs to where it was drawn.
        for axis in (0, 1):
            mixed, wanted = (x[:, axis] * x[:, 2] for x in (drawn, expected))
            assert stats.ks_2samp(mixed, wanted).pvalue > SIGNIFICANCE


@pytest.mark.parametrize('off', [0.0, 5.0, -5.0, 30.0, -30.0])
def test_a_gaussian_s_mass_is_that_of_scipy_however_far_off_the_box_is(off: float) -> None:
    kernel = GaussianKernel(np.array([[[off, 0.5]]]), np.array([1.0]), np.zeros((1, 1, 0)))
    low, high = np.array([[-1.0, -1.0]]), np.array([[1.5, np.inf]])
    # The survival function mirrors the upper tail, which the difference of cdf cannot resolve.
    x = stats.norm.cdf(1.5 - off) - stats.norm.cdf(-1 - off) if off >= 0 else (
        stats.norm.sf(-1 - off) - stats.norm.sf(1.5 - off))
    assert kernel.mass(low, high)[0, 0] == pytest.approx(x * stats.norm.sf(-1.5), rel=1e-9)


def test_draws_far_in_a_tail_are_finite_and_within_the_box() -> None:
    kernel = GaussianKernel(np.array([[[35.0, -35.0]]]), np.array([1.0]), np.zeros((1, 1, 0)))
    low, high = np.array([[-1.0, -1.0]]), np.array([[1.0, 1.0]])
    states, valid = kernel.draw(np.zeros(100, int), np.zeros(100, int), low, high,
                                rng().random((100, 2)), rng())
    assert valid.all()
    assert (np.abs(states) <= 1).all()


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_ball_fills_its_own_box_as_geometry_says(dimension: int) -> None:
    kernel = BallKernel(np.zeros((1, 1, dimension)), 2.0)
    everywhere = np.full((1, dimension), np.inf)
    assert kernel.mass(-everywhere, everywhere)[0, 0] == pytest.approx(4.0 ** dimension)
    zero = np.zeros(MANY, int)
    _, valid = kernel.draw(zero, zero, -everywhere, everywhere,
                           rng().random((MANY, dimension)), rng())
    share = math.pi / 4 if dimension == 2 else math.pi / 6
    assert stats.binomtest(int(valid.sum()), MANY, share).pvalue > SIGNIFICANCE


def test_a_box_beyond_the_ball_has_no_mass() -> None:
    kernel = BallKernel(np.zeros((1, 1, 2)), 2.0)
    assert kernel.mass(np.array([[2.5, -1.0]]), np.array([[4.0, 1.0]]))[0, 0] == 0


def test_particles_are_chosen_as_often_as_their_weights_say() -> None:
    weights = np.array([[1.0, 0.0, 3.0], [0.0, 5.0, 5.0]])
    owner = np.repeat([1, 0], 5000)
    index = choose(weights, owner, rng())
    for vehicle, row in enumerate(weights):
        counts = np.bincount(index[owner == vehicle], minlength=3)
        used = row > 0
        assert counts[~used].sum() == 0
        expected = 5000 * row[used] / row.sum()
        assert stats.chisquare(counts[used], expected).pvalue > SIGNIFICANCE


def test_wider_kernels_are_those_of_a_motion_as_much_wider() -> None:
    centre = np.array([[[1.0, 0.5]]])
    gaussian = GaussianKernel(centre, np.array([3.0]), np.zeros((1, 1, 0)))
    tripled = GaussianKernel(centre, np.array([1.0]), np.zeros((1, 1, 0))).widened(3.0)
    for wide, wanted in ((tripled, gaussian),
                         (BallKernel(centre, 2.0).widened(1.5), BallKernel(centre, 3.0))):
        assert wide.mass(LOW, HIGH)[0, 0] == pytest.approx(wanted.mass(LOW, HIGH)[0, 0])


def test_what_wider_gaussians_remember_varies_as_before() -> None:
    zero, far = np.zeros(MANY, int), np.full((1, 2), 1e3)
    kernel = GaussianKernel(np.zeros((1, 1, 2)), np.array([2.0]), np.zeros((1, 1, 2)),
                            coupling=0.5, remembered_std=1.0)
    states, _ = kernel.widened(4.0).draw(zero, zero, -far, far, rng().random((MANY, 2)), rng(2))
    # Along each axis 8 m and sqrt(2) m/s; the standard error of the latter is 0.007 m/s.
    np.testing.assert_allclose(states.std(axis=0), [8, 8, *[math.sqrt(2)] * 2], rtol=0.02)
