"""What mobilities share."""

from __future__ import annotations

import math

import numpy as np
from tsmcl_ros.model.mobility.base import Draws, wrap


def test_wrap_keeps_half_a_turn_positive() -> None:
    np.testing.assert_allclose(
        wrap(np.array([math.pi, -math.pi, 3 * math.pi, 0.5, -7.0])),
        [math.pi, math.pi, math.pi, 0.5, 2 * math.pi - 7.0])


def test_what_a_vehicle_draws_does_not_depend_on_the_others() -> None:
    one, other = (Draws(np.random.default_rng(1), 3, 2) for _ in range(2))
    alone = [one.take(np.array([2])) for _ in range(4)]
    other.take(np.array([0, 1, 2]))
    other.take(np.array([0]))
    together = [other.take(np.array([2, 1])) for _ in range(3)]
    for k in range(3):
        np.testing.assert_array_equal(alone[k + 1][0], together[k][0])


def test_no_vehicle_draws_the_same_numbers_twice() -> None:
    draws = Draws(np.random.default_rng(1), 4, 3)
    drawn = np.concatenate([draws.take(np.arange(4)) for _ in range(50)])
    assert len(np.unique(drawn)) == drawn.size
