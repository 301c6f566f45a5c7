"""
Grey prediction: the GM(1,1) model of a short series, extrapolated, for many series at once.

Deng: Control problems of grey systems, 1982; here as Zhuo et al. predict the azimuth of a node
that a delay-tolerant network no longer hears. A few values of any series are taken for samples of
an exponential, so a prediction is good for a few steps and grows without bound after many.
"""

from __future__ import annotations

import numpy as np
from tsmcl_ros.types import Array

LEAST = 4  # values that a model needs

# Series are shifted this many of their spans above 0. Neighbouring values must have ratios within
# e^(+-2/(n+1)) for the model to be sound, which takes 2.5 spans for 5 values; but so near to 0 a
# rising series rises on like an exponential, and overshoots a line by half after ten steps.
_LIFT = 10.0
# Below this development coefficient the response is a constant that knows no trend.
_FLAT = 1e-6
# No value is further than this from 0; what is, or is no number, is taken for it.
_FURTHEST = 1e100


def fit_grey(series: Array) -> tuple[Array, Array]:
    """
    Fit GM(1,1) to positive series.

    With theta1 the cumulative sum of theta0 and z(k) = (theta1(k) + theta1(k-1)) / 2, that is
    [a, b] = lstsq([-z, 1], theta0(2..n)).

    Parameters
    ----------
    series : (..., n) float
        Of at least 4 values, above 0.

    Returns
    -------
    a, b : (...) float64
        Development coefficient, the rate at which the series falls a step, and grey input.

    """
    total = np.cumsum(series, axis=-1)
    z = (total[..., 1:] + total[..., :-1]) / 2
    value = series[..., 1:]
    middle, mean = z.mean(axis=-1), value.mean(axis=-1)
    deviation = z - middle[..., None]
    a = -(deviation * value).sum(axis=-1) / np.square(deviation).sum(axis=-1)
    return a, mean + a * middle


def predict_grey(series: Array, steps: Array | int) -> Array:
    """
    Extrapolate series by GM(1,1).

    theta0(k+1) = (1 - e^a) (theta0(1) - b/a) e^(-a k). Each series is shifted above 0 first, in
    proportion to its span, so that the prediction moves and scales with the series. Where a is
    near 0 it goes on by the mean increment.

    Parameters
    ----------
    series : (..., n) float
        The last values, of equal steps, at least 4.
    steps : (...) int
        How many steps ahead, from 1 on; its shape broadcasts against the series' leading one.

    Returns
    -------
    (...) float64
        Always finite.

    """
    series = np.nan_to_num(
        np.asarray(series, np.float64), posinf=_FURTHEST, neginf=-_FURTHEST)
    series = np.clip(series, -_FURTHEST, _FURTHEST)
    count = series.shape[-1]
    low = series.min(axis=-1)
    span = series.max(axis=-1) - low
    unit = np.where(span > 0, span, 1)
    scaled = (series - low[..., None]) / unit[..., None] + _LIFT
    a, b = fit_grey(scaled)
    flat = np.abs(a) < _FLAT
    rate = np.where(flat, 1, a)
    # An exponent of 60 is further than anything goes: the clip is against overflow.
    growth = np.exp(np.clip(-rate * (count - 1 + np.asarray(steps)), -60, 60))
    grown = -np.expm1(rate) * (scaled[..., 0] - b / rate) * growth
    straight = scaled[..., -1] + steps * (scaled[..., -1] - scaled[..., 0]) / (count - 1)
    return np.asarray(low + unit * (np.where(flat, straight, grown) - _LIFT))


def predict_azimuth(series: Array, steps: Array | int) -> Array:
    """
    Extrapolate series (..., n) of angles [rad] by GM(1,1); they are unwrapped first.

    Returns
    -------
    (...) float64
        [rad], not wrapped: a series that turns on goes beyond pi.

    """
    series = np.nan_to_num(np.asarray(series, np.float64), posinf=0.0, neginf=0.0)
    return predict_grey(np.unwrap(series, axis=-1), steps)
