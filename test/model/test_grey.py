"""Grey prediction, against its closed forms and a plain implementation, one series at a time."""

import math

from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest
from tsmcl_ros.model.grey import fit_grey, predict_azimuth, predict_grey


def plain(series, steps):
    """Return what GM(1,1) predicts, by the equations as printed and numpy's least squares."""
    n = len(series)
    total = np.cumsum(series)
    z = [(total[k] + total[k - 1]) / 2 for k in range(1, n)]
    design = np.array([[-value, 1] for value in z])
    (a, b), *_ = np.linalg.lstsq(design, np.array(series[1:]), rcond=None)
    return a, b, (1 - math.exp(a)) * (series[0] - b / a) * math.exp(-a * (n - 1 + steps))


@pytest.mark.parametrize('ratio', [0.7, 0.95, 1.1, 1.5])
def test_the_coefficients_of_a_geometric_series_have_a_closed_form(ratio):
    a, b = fit_grey(3.0 * ratio ** np.arange(5.0))

    # z(k) = c (q^k (q+1) - 2) / (2 (q-1)), linear in theta0(k) = c q^k.
    assert a == pytest.approx(2 * (1 - ratio) / (1 + ratio))
    assert b == pytest.approx(2 * 3.0 / (1 + ratio))


def test_many_series_are_fitted_as_a_plain_implementation_fits_each():
    series = np.random.default_rng(1).uniform(1, 2, (4, 3, 6))

    a, b = fit_grey(series)

    for index in np.ndindex(4, 3):
        assert (a[index], b[index]) == pytest.approx(plain(series[index], 1)[:2])


def test_predictions_are_those_of_a_plain_implementation_once_shifted_and_scaled():
    series = np.random.default_rng(2).uniform(-3, 5, (20, 5))
    lift = 10.0

    predicted = predict_grey(series, np.arange(1, 21))

    for row, value in enumerate(predicted):
        low, span = series[row].min(), np.ptp(series[row])
        expected = plain((series[row] - low) / span + lift, row + 1)[2]
        assert value == pytest.approx(low + span * (expected - lift))


def test_the_shift_brings_neighbouring_values_within_the_ratios_that_the_model_is_sound_for():
    for values in ([0.0, 1.0, 0.0, 1.0, 0.5], [-9.0, -5.0, 3.0, 4.0, 4.0]):
        series = np.array(values)
        low, span = series.min(), np.ptp(series)
        shifted = (series - low) / span + 10
        ratio = shifted[:-1] / shifted[1:]
        assert ratio.min() >= math.exp(-2 / 6) - 1e-12
        assert ratio.max() <= math.exp(2 / 6) + 1e-12


def test_a_straight_series_goes_on_nearly_straight_for_some_steps():
    # An exponential through five points of a line is off by little next to them.
    assert predict_grey(np.arange(5.0), 1) == pytest.approx(5.0, abs=0.1)
    assert predict_grey(np.arange(5.0), 3) == pytest.approx(7.0, abs=0.25)


def test_the_prediction_moves_and_scales_with_the_series():
    series = np.array([0.3, 0.5, 0.4, 0.9, 1.4])

    there = predict_grey(-7 + 100 * series, np.array([1, 5]))

    np.testing.assert_allclose(there, -7 + 100 * predict_grey(series, np.array([1, 5])))


@pytest.mark.parametrize('value', [0.0, -2.5, 1e9])
def test_what_stands_still_goes_on_standing_still(value):
    assert predict_grey(np.full(5, value), 40) == value


def test_where_no_rate_is_found_the_mean_increment_goes_on():
    # The model is fitted to the values after the first, which have no trend here.
    assert predict_grey(np.array([0.0, 1.0, 1.0, 1.0, 1.0]), 4) == pytest.approx(2.0)


def test_an_angle_that_passes_the_cut_is_unwrapped():
    series = np.array([2.9, 3.0, 3.1, 3.2, 3.3])
    wrapped = np.arctan2(np.sin(series), np.cos(series))

    assert predict_azimuth(wrapped, 2) == pytest.approx(predict_grey(series, 2))


@given(arrays(np.float64, (2, 5), elements=st.floats()), st.integers(1, 10**6))
def test_no_series_gives_anything_but_a_finite_number(series, steps):
    assert np.isfinite(predict_grey(series, steps)).all()
    assert np.isfinite(predict_azimuth(series, steps)).all()
