"""
How fast numpy lets a fleet's particle filter be: the bare arithmetic, in the form that suits it.

One array a coordinate, float32, squared distances, draws from a table, resampling by repeating,
and chunks that stay in the cache. There is no soft edge, no outlier, no recovery, no redraw and
no covariance here, and every vehicle hears the same anchors; what a method takes beyond this is
what it does beyond this.
"""

from __future__ import annotations

import math
import time

import numpy as np

PARTICLES, SPREAD, RANGE = 500, 50.0, 1000.0
_CHUNK, _POINTS = 256, 1 << 16
_ANCHORS = np.array(
    [[500, 500], [1500, 500], [2500, 500], [500, 1500], [1500, 1500], [2500, 1500]], np.float32)
_TRUTH = np.array([1400.0, 900.0], np.float32)
_SQUARED = np.square(_TRUTH - _ANCHORS).sum(axis=1)
_SIGMA, _EXPONENT = 4.0, 2.0


def limit(kind: str, vehicles: int, updates: int) -> float:
    """Return the median processor time [s] of an update by presence ('mcl') or by 'rssi'."""
    rng = np.random.SFC64(1)
    number = np.arange(_POINTS)
    angle, radius = number * math.pi * (3 - math.sqrt(5)), SPREAD * np.sqrt(number / _POINTS)
    table = [(radius * turn(angle)).astype(np.float32) for turn in (np.cos, np.sin)]
    spot = np.random.default_rng(1).normal(_TRUTH[:, None, None], 100, (2, vehicles, PARTICLES))
    x, y = spot.astype(np.float32)
    times = []
    for _ in range(updates):
        begin = time.process_time()
        for first in range(0, vehicles, _CHUNK):
            rows = slice(first, first + _CHUNK)
            _update(kind, x[rows], y[rows], table, rng)
        times.append(time.process_time() - begin)
    return float(np.median(times))


def _update(kind: str, x: np.ndarray, y: np.ndarray, table: list[np.ndarray],
            rng: np.random.SFC64) -> None:
    """Predict, weigh, estimate and resample the particles (V, N) of a chunk of vehicles."""
    vehicles, count = x.shape
    draw = rng.random_raw(-(-x.size // 4)).view(np.uint16)[:x.size].reshape(x.shape)
    squared, aside, alive = np.empty_like(x), np.empty_like(x), np.ones(x.shape, bool)
    for axis, column in zip((x, y), table, strict=True):
        axis += np.take(column, draw, out=squared, mode='clip')
    total = np.zeros_like(x)
    for (east, north), true in zip(_ANCHORS, _SQUARED, strict=True):
        np.subtract(x, east, out=squared)
        np.subtract(y, north, out=aside)
        squared *= squared
        aside *= aside
        squared += aside
        if kind == 'mcl':
            alive &= squared < RANGE ** 2 if true < RANGE ** 2 else squared >= RANGE ** 2
        else:
            np.log2(squared, out=squared)
            squared -= np.log2(true)
            squared *= squared
            total += squared
    if kind == 'mcl':
        weights = alive.astype(np.float32)
    else:
        total -= total.min(axis=1, keepdims=True)
        total *= np.float32(-0.5 * (5 * math.log10(2) * _EXPONENT / _SIGMA) ** 2)
        weights = np.exp(total, out=total)
    for axis in (x, y):
        np.einsum('vn,vn->v', weights, axis)
    edges = np.cumsum(weights, axis=1, out=aside)
    edges *= np.float32(count) / np.maximum(edges[:, -1:], np.float32(1e-9))
    edges -= np.float32(np.random.random_sample())
    ticks = np.ceil(edges, out=edges).astype(np.int32)
    ticks[:, -1] = count
    copies = np.diff(ticks, axis=1, prepend=0).ravel()
    parent = np.repeat(np.arange(x.size), copies)
    for axis in (x, y):
        np.take(axis.ravel(), parent, mode='clip', out=squared.reshape(-1))
        axis[:] = squared
