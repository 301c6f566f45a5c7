"""Observations: padding, stacking, projecting, and taking one vehicle out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros import types
from tsmcl_ros.types import Observation

ROWS = ('sender', 'kind', 'hops', 'position', 'covariance', 'max_range', 'range', 'range_std',
        'rssi')


def heard(*senders: int, dimension: int = 3, stamp: float = 1.0) -> Observation:
    """Return what one vehicle heard, each field telling its sender."""
    empty = Observation.empty(1, len(senders), dimension, stamp)
    number = np.array([senders], np.float32)
    axes = np.arange(dimension, dtype=np.float32)
    return replace(
        empty,
        sender=np.array([senders], np.int64),
        kind=np.array([senders]).astype(np.uint8),
        hops=np.array([senders]).astype(np.uint8),
        position=number[:, :, None] + axes,
        covariance=number[:, :, None, None] * np.eye(dimension, dtype=np.float32),
        max_range=number + 1,
        range=number + 2,
        range_std=number + 3,
        rssi=-number,
    )


def assert_equal(one: Observation, other: Observation) -> None:
    assert one.stamp == other.stamp
    for name in ROWS:
        a, b = getattr(one, name), getattr(other, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, name)


def test_that_an_empty_observation_heard_nobody() -> None:
    empty = Observation.empty(2, 3, 2, 1.5)
    assert empty.stamp == 1.5
    assert not empty.heard.any()
    assert empty.position.shape == (2, 3, 2)
    assert empty.covariance.shape == (2, 3, 2, 2)
    assert np.isnan([empty.max_range, empty.range, empty.range_std, empty.rssi]).all()


def test_that_an_empty_observation_s_fields_share_no_memory() -> None:
    empty = Observation.empty(1, 1, 2, 0.0)
    empty.range[:] = 1.0
    assert np.isnan([empty.max_range, empty.range_std, empty.rssi]).all()


def test_that_heard_tells_rows_from_padding() -> None:
    both = Observation.stack([heard(7), heard(8, 9)], 1.0)
    np.testing.assert_array_equal(both.heard, [[True, False], [True, True]])


@pytest.mark.parametrize('index', [0, 1, 2])
def test_that_a_vehicle_comes_out_of_a_stack_as_it_went_in(index: int) -> None:
    parts = [heard(1, 2, stamp=3.0), heard(stamp=3.0), heard(4, 5, 6, stamp=3.0)]
    assert_equal(Observation.stack(parts, 3.0).vehicle(index), parts[index])


def test_that_a_stack_pads_as_an_empty_observation_does() -> None:
    padded = Observation.stack([heard(1), heard(2, 3)], 1.0)
    unheard = Observation.empty(1, 1, 3, 1.0)
    for name in ROWS:
        np.testing.assert_array_equal(getattr(padded, name)[0, 1], getattr(unheard, name)[0, 0])


def test_that_a_stack_takes_fleets_and_its_own_stamp() -> None:
    fleet = Observation.stack([heard(1), heard(2)], 1.0)
    three = Observation.stack([fleet, heard(3)], 2.0)
    assert three.stamp == 2.0
    np.testing.assert_array_equal(three.sender, [[1], [2], [3]])


def test_that_a_stack_of_nothing_has_no_vehicle() -> None:
    assert Observation.stack([], 1.0).sender.shape == (0, 0)


def test_that_projecting_cuts_coordinates_and_nothing_else() -> None:
    flat = heard(1, 2).project(2)
    assert_equal(flat, heard(1, 2, dimension=2))


def test_that_the_largest_identity_of_32_bits_is_not_taken_for_padding() -> None:
    largest = Observation.stack([heard(2**32 - 1)], 0.0)
    assert largest.sender[0, 0] == 2**32 - 1
    assert largest.heard.all()


@pytest.mark.parametrize('name', ['ConfigError', 'MessageError', 'BagError', 'LogError'])
def test_that_all_errors_have_one_root(name: str) -> None:
    assert issubclass(getattr(types, name), types.TsmclError)


def test_an_error_is_one_line_that_forges_no_other() -> None:
    error = types.LogError('cell "1\r\n[ERROR] all is lost\x1b[2J\u202e\udcff" is not allowed')
    assert str(error) == 'cell "1 [ERROR] all is lost\\x1b[2J\\u202e\\udcff" is not allowed'


@pytest.mark.parametrize('letter', ['x', '\0'])
def test_an_error_keeps_its_ends_of_a_text_that_is_too_long(letter: str) -> None:
    text = str(types.MessageError(f'frame {letter * 10**6} is not allowed, must be map'))
    assert len(text) < 2100
    assert text.startswith('frame ')
    assert text.endswith(' is not allowed, must be map')


def test_an_error_of_an_error_is_escaped_once() -> None:
    inner = types.MessageError('frame \t')
    assert str(types.MessageError(f'message 3: {inner}')) == 'message 3: frame \\t'
