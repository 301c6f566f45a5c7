"""Beliefs that take in measurements, against numerical integration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.belief import Beliefs, Sight

YES = np.array([True])


def line(mean: float, variance: float, outliers: float) -> Beliefs:
    """Return a belief on a line."""
    beliefs = Beliefs(1, 1, 1, outliers)
    beliefs.place(np.array([0]), np.array([[mean]]), np.array([[[variance]]]),
                  (np.zeros(0), np.zeros((0, 0))))
    return beliefs


def seen(beliefs: Beliefs) -> Sight:
    """Return the sight of the state itself."""
    return Sight(beliefs.mean[:, 0], np.ones((1, 1)), np.zeros(1))


@pytest.mark.parametrize('outliers', [0.0, 0.1])
@pytest.mark.parametrize('measured', [0.5, 4.0, 30.0])
def test_the_log_likelihood_is_that_of_the_whole_belief(outliers: float, measured: float) -> None:
    beliefs = line(1.0, 4.0, outliers)
    beliefs.measure(YES, seen(beliefs), np.array([measured]), np.array([2.0]))
    x = np.linspace(-80, 80, 400_001)
    likelihood = (1 - outliers) * np.exp(-(measured - x) ** 2 / 4) + outliers
    average = np.sum(stats.norm(1, 2).pdf(x) * likelihood) * (x[1] - x[0])
    assert math.exp(beliefs.log_likelihood[0]) == pytest.approx(average, rel=1e-5)
    assert beliefs.terms[0] == 1


def test_an_outlier_changes_next_to_nothing_and_raises_doubt() -> None:
    beliefs = line(0.0, 1.0, 0.02)
    beliefs.measure(YES, seen(beliefs), np.array([100.0]), np.array([1.0]))
    assert beliefs.doubtful[0]
    assert abs(beliefs.mean[0, 0]) < 1e-6
    assert beliefs.covariance[0, 0, 0] == pytest.approx(1.0)


def test_a_sound_measurement_raises_none() -> None:
    beliefs = line(0.0, 1.0, 0.02)
    beliefs.measure(YES, seen(beliefs), np.array([1.0]), np.array([1.0]))
    assert not beliefs.doubtful[0]
    assert beliefs.mean[0, 0] == pytest.approx(0.5, abs=0.02)


def test_who_has_no_measurement_keeps_the_belief() -> None:
    beliefs = line(3.0, 2.0, 0.0)
    beliefs.measure(~YES, seen(beliefs), np.array([math.nan]), np.array([1.0]))
    beliefs.bound(
        ~YES, seen(beliefs), np.array([math.inf]), 1, np.array([1.0]), np.zeros(1))
    assert beliefs.mean[0, 0] == 3.0
    assert beliefs.covariance[0, 0, 0] == pytest.approx(2.0)
    assert beliefs.fit[0] == beliefs.log_likelihood[0] == beliefs.terms[0] == 0


@pytest.mark.parametrize('side', [1, -1])
def test_a_bound_keeps_the_belief_on_its_side(side: int) -> None:
    beliefs = line(0.0, 1.0, 0.0)
    beliefs.bound(YES, seen(beliefs), np.array([0.0]), side, np.array([1e-12]), np.zeros(1))
    assert beliefs.mean[0, 0] == pytest.approx(-side * math.sqrt(2 / math.pi), rel=1e-4)
    assert beliefs.log_likelihood[0] == pytest.approx(math.log(0.5), rel=1e-4)


def test_an_uncertain_reference_is_uncertain_along_the_line_of_sight() -> None:
    beliefs = Beliefs(1, 2, 2, 0.0)
    beliefs.covariance[:] = 0
    beliefs.mean[0] = [3.0, 4.0]
    sight = beliefs.sight(np.zeros((1, 2)), np.array([[[100.0, 0.0], [0.0, 1.0]]]))
    assert sight.expected[0] == pytest.approx(5.0)
    assert sight.variance[0] == pytest.approx(0.36 * 100 + 0.64)


def test_the_log_of_a_range_has_the_gradient_of_finite_differences() -> None:
    def at(x: float) -> Sight:
        beliefs = Beliefs(1, 2, 2, 0.0)
        beliefs.covariance[:] = 0
        beliefs.mean[0] = [x, 7.0]
        sight = beliefs.sight(np.zeros((1, 2)), np.zeros((1, 2, 2)))
        return sight.on_log_scale(beliefs.covariance)

    assert at(5.0).expected[0] == pytest.approx(math.log10(math.hypot(5, 7)))
    slope = (at(5.001).expected[0] - at(4.999).expected[0]) / 0.002
    assert at(5.0).gradient[0, 0] == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize('std', [(1.0, 1.0), (3.0, 1.0), (1.0, 3.0), (3.0, 3.0), (6.0, 2.0)])
def test_the_log_of_a_range_is_expected_where_draws_have_it(std: tuple[float, float]) -> None:
    beliefs = Beliefs(1, 2, 2, 0.0)
    beliefs.mean[0], beliefs.covariance[0] = [10.0, 0.0], np.diag(np.square(std))
    sight = beliefs.sight(np.zeros((1, 2)), np.zeros((1, 2, 2))).on_log_scale(beliefs.covariance)
    drawn = beliefs.mean[0] + std * np.random.default_rng(0).standard_normal((100_000, 2))
    truth = np.log10(np.linalg.norm(drawn, axis=1)).mean()
    assert sight.expected[0] == pytest.approx(truth, abs=0.005)  # 0.1 dB with n = 2
