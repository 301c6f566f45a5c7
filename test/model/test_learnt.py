"""What one localizer tells the next of its radio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tsmcl_ros.model.learnt import aged, Learnt, LearntRanges, LearntRssi

RANGES = LearntRanges(np.array([1.1, 0.2]), 1e-4 * np.eye(2))
OTHERS = LearntRanges(np.array([0.9, 0.0]), 1e-4 * np.eye(2))
RSSI = LearntRssi(np.array([3.0, 0.2]), np.diag([1.0, 0.01]), 1.2, 400.0)


def test_what_was_known_before_stands_for_what_is_not_known() -> None:
    assert Learnt(RANGES).beside(Learnt(OTHERS, RSSI)) == Learnt(RANGES, RSSI)
    assert Learnt().beside(Learnt(OTHERS)) == Learnt(OTHERS)


def test_after_a_while_a_twentieth_of_what_was_open_is_open_again() -> None:
    np.testing.assert_allclose(aged(np.eye(2), 5 * np.eye(2)), 1.2 * np.eye(2))


def test_what_was_learnt_is_sound() -> None:
    assert RANGES.is_sound
    assert RSSI.is_sound


@pytest.mark.parametrize('change', [
    {'mean': np.array([301.0, 0.2])}, {'mean': np.array([3.0, -10.1])},
    {'covariance': np.diag([9.1e4, 0.01])}, {'covariance': np.diag([1.0, 0.0])},
    {'covariance': np.array([[1.0, 0.1], [0.1, 0.01]])}, {'covariance': -np.eye(2)},
    {'sigma': 0.0}, {'sigma': 101.0}, {'sigma': np.nan}, {'samples': 0.0}, {'samples': np.inf}])
def test_what_rssi_cannot_tell_is_not(change: dict[str, Any]) -> None:
    assert not RSSI._replace(**change).is_sound


def test_ranges_that_shrink_to_nothing_are_not() -> None:
    assert not RANGES._replace(mean=np.array([0.0, 0.2])).is_sound
