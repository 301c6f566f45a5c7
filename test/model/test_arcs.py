"""Arcs of directions, against brute force."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.geometry import Arcs


def cover(*direction: float, kept: object = True) -> tuple[float, float]:
    """Return middle and half width [rad] of the smallest arc."""
    values = np.array([direction], np.float32)
    arcs = Arcs.cover(values, np.broadcast_to(np.asarray(kept), values.shape))
    return float(arcs.middle[0]) % (2 * math.pi), float(arcs.half[0])


def test_an_arc_covers_directions_on_both_sides_of_zero() -> None:
    # An interval [min, max] would be nearly the whole circle.
    assert cover(0.1, 2 * math.pi - 0.3) == pytest.approx((2 * math.pi - 0.1, 0.2), abs=1e-5)


def test_the_arc_of_one_direction_has_no_width() -> None:
    assert cover(1.5, 4.0, 5.0, kept=[False, True, False]) == pytest.approx((4.0, 0.0), abs=1e-5)


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=8), st.data())
@hypothesis_settings(max_examples=60)
def test_arcs_are_the_smallest_that_cover_all_that_is_kept(
        directions: list[float], data: st.DataObject) -> None:
    kept = data.draw(st.lists(st.booleans(), min_size=len(directions),
                              max_size=len(directions)).filter(any))
    middle, half = cover(*directions, kept=kept)
    chosen = np.array(directions)[kept]

    def aside(direction: float) -> float:
        return float(np.abs((chosen - direction + math.pi) % (2 * math.pi) - math.pi).max())

    assert aside(middle) <= half + 1e-4
    # No middle on a fine raster does with less.
    assert min(aside(trial) for trial in np.linspace(0, 2 * math.pi, 721)) > half - 0.01


def test_directions_are_drawn_uniformly_in_an_arc_and_arcs_grow_to_a_circle() -> None:
    arcs = Arcs(np.array([3.0], np.float32), np.array([0.5], np.float32))
    drawn = arcs.draw(5000, np.random.default_rng(1))[0]
    assert stats.kstest(drawn, stats.uniform(2.5, 1.0).cdf).pvalue > 1e-3
    assert arcs.wider(np.array([0.25])).half[0] == 0.75
    assert arcs.wider(np.array([9.0])).half[0] == pytest.approx(math.pi)
