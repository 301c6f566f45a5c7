"""Where vehicles may be by the rssi of one epoch, whatever their path losses are off."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.particles import even_resample, normalize
from tsmcl_ros.types import Array

# Places that particles are drawn from, and how much of their log-likelihood counts.
CANDIDATES = 8000
_PROPOSED = 0.5
# What is nearer than this counts as this far, as path loss has no bound [m].
_NEAREST = 0.5


def decades(away: Array) -> Array:
    """Return log10 of the lengths [m] of ways (..., D) to anchors."""
    return np.log10(np.maximum(np.linalg.norm(away, axis=-1), _NEAREST))


def draw_places(position: Array, rssi: Array, used: Array, loss: tuple[Array, ...], error: Array,
                anchor_variance: float, count: int, rng: np.random.Generator
                ) -> tuple[Array, Array]:
    """
    Draw places around the anchors that vehicles hear, by about how likely they are.

    Parameters
    ----------
    position : (V, K, D) float
        Of the anchors [m].
    rssi, used : (V, K) float, (V, K) bool
        [dBm], and which count.
    loss : three arrays (V, K)
        P_0 at 1 m [dBm], n and sigma_db [dB] of each.
    error : (2, 2) float
        Covariance of what P_0 and n are off for all anchors alike.
    anchor_variance : float
        Of what the P_0 of each is off beside that [dB^2].
    count : int
        N.
    rng : numpy.random.Generator
        Draws them.

    Returns
    -------
    places, log_weights : (V, N, D), (V, N) float
        [m], and what makes up for how they were drawn.

    """
    low = np.where(used[:, :, None], position, np.inf).min(axis=1)[:, None]
    high = np.where(used[:, :, None], position, -np.inf).max(axis=1)[:, None]
    margin = (high - low).max(axis=2, keepdims=True) / 2
    points = low - margin + (high - low + 2 * margin) * rng.random(
        (len(position), CANDIDATES, position.shape[2]))
    score = _PROPOSED * _log_likelihood(
        points, position, np.where(used, rssi, 0), used, loss, error, anchor_variance)
    index = even_resample(points, normalize(score)[0], count, rng)
    drawn = np.take_along_axis(points, index[:, :, None], axis=1)
    apart = margin * CANDIDATES ** (-1 / position.shape[2])
    places = drawn + apart * rng.standard_normal(drawn.shape)
    return places, -np.take_along_axis(score, index, axis=1)


def _log_likelihood(points: Array, position: Array, rssi: Array, used: Array,
                    loss: tuple[Array, ...], error: Array, anchor_variance: float) -> Array:
    """Return that (V, P) of rssi at points (V, P, D); P_0 and n are integrated out."""
    reference, exponent, sigma = (part[:, None] for part in loss)
    decade = decades(points[:, :, None] - position[:, None])
    residual = rssi[:, None] - reference + 10 * exponent * decade
    weight = np.where(used[:, None], 1 / (sigma ** 2 + anchor_variance), 0)
    slope = np.stack([np.ones_like(decade), -10 * decade], axis=2)
    told = slope @ (weight * residual)[:, :, :, None]
    joint = np.linalg.inv(error) + (slope * weight[:, :, None]) @ np.swapaxes(slope, 2, 3)
    explained = (told * np.linalg.solve(joint, told)).sum(axis=(2, 3))
    return np.asarray(0.5 * (explained - (weight * residual ** 2).sum(axis=2)
                             - np.linalg.slogdet(joint)[1]))
