"""BonnMotion's movements: selection of nodes, both dimensions, damaged files refused by line."""

from __future__ import annotations

import gzip
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.traces.bonnmotion import read_bonnmotion
from tsmcl_ros.types import LogError

# Nodes 0 and 2 are there for 20 s; 1 leaves after 8 s.
PLANE = """# a comment
0.0 5.0 5.0 10.0 15.0 5.0 20.0 15.0 25.0
0.0 1.0 1.0 8.0 9.0 1.0

0.0 0.0 0.0 5.0 0.0 0.0 20.0 30.0 0.0
"""
SPACE = '0.0 1.0 2.0 3.0 10.0 1.0 2.0 13.0\n'


@pytest.fixture
def write(tmp_path):
    def write_text(text: str) -> Path:
        path = tmp_path / 'city.movements'
        path.write_text(text)
        return path
    return write_text


def test_nodes_go_straight_from_waypoint_to_waypoint(write) -> None:
    trace = read_bonnmotion(write(PLANE), 3)
    np.testing.assert_array_equal(trace.stamp, [0.0, 5.0, 8.0])
    np.testing.assert_allclose(trace.position[:, 0], [[5, 5], [10, 5], [13, 5]])
    np.testing.assert_allclose(trace.position[:, 2], [[0, 0], [0, 0], [6, 0]])


def test_the_longest_lived_nodes_are_taken_in_the_order_of_the_file(write) -> None:
    trace = read_bonnmotion(write(PLANE), 2)
    assert trace.names == ('0', '2')
    assert trace.stamp[-1] == 20.0


def test_only_nodes_that_are_there_long_enough_count(write) -> None:
    with pytest.raises(LogError, match='holds 2 vehicles that are there from 0 s to 9 s, 3 are w'):
        read_bonnmotion(write(PLANE), 3, duration=9.0)


def test_a_trace_can_begin_and_end_between_waypoints(write) -> None:
    trace = read_bonnmotion(write(PLANE), 2, 7.0, 5.0)
    np.testing.assert_array_equal(trace.stamp, [7.0, 10.0, 12.0])
    np.testing.assert_allclose(trace.position[:, 0], [[12, 5], [15, 5], [15, 9]])


def test_a_packed_file_is_read_whatever_its_name(write, tmp_path) -> None:
    packed = tmp_path / 'packed'
    packed.write_bytes(gzip.compress(PLANE.encode()))
    np.testing.assert_array_equal(
        read_bonnmotion(packed, 2).position, read_bonnmotion(write(PLANE), 2).position)


def test_waypoints_with_a_height_give_three_dimensions(write) -> None:
    trace = read_bonnmotion(write(SPACE), 1, elevation=True)
    np.testing.assert_array_equal(trace.position[:, 0], [[1, 2, 3], [1, 2, 13]])


def test_far_places_are_refused_unless_a_local_origin_is_asked_for(write) -> None:
    path = write('0 500000.5 4000000 9 500009.5 4000001\n')
    with pytest.raises(LogError, match=r'beyond 100 km, at \(500010, 4000001\) m; ask for a l'):
        read_bonnmotion(path, 1)
    trace = read_bonnmotion(path, 1, local_origin=True)
    np.testing.assert_allclose(trace.position[:, 0], [[0.5, 0], [9.5, 1]])


@pytest.mark.parametrize(('text', 'elevation', 'complaint'), [
    (SPACE, False, r':1: has 8 numbers, expected waypoints of "t x y"; .*trace_elevation: true'),
    (PLANE, True, r':2: has 9 numbers, expected waypoints of "t x y z"; .*elevation: false'),
    (PLANE + '0 1 1 0 2 2\n', False, r':6: time 0 s does not come after 0 s, expected'),
    (PLANE + '0 1 one\n', False, r":6: 'one' is not a finite number"),
    (PLANE + '0 1 inf\n', False, r":6: 'inf' is not a finite number"),
])
def test_what_are_no_movements_is_refused_by_file_and_line(
    write, text, elevation, complaint,
) -> None:
    with pytest.raises(LogError, match=r'city\.movements' + complaint):
        read_bonnmotion(write(text), 1, elevation=elevation)


def test_a_file_that_is_no_text_is_refused(tmp_path) -> None:
    path = tmp_path / 'picture'
    path.write_bytes(b'\x89PNG\xff\xfe')
    with pytest.raises(LogError, match='picture:1: is not text'):
        read_bonnmotion(path, 1)


def test_more_waypoints_than_memory_holds_are_refused(write, monkeypatch) -> None:
    monkeypatch.setattr('tsmcl_ros.traces.files._MOST_NUMBERS', 10)
    with pytest.raises(LogError, match=r'3 vehicles have 3 waypoints .* makes 18 coordinates'):
        read_bonnmotion(write(PLANE), 3)


@settings(max_examples=100)
@given(st.lists(st.lists(st.tuples(
    st.floats(0.01, 1e3), st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)), min_size=2, max_size=4),
    min_size=1, max_size=3))
def test_whatever_is_written_is_read_back(tmp_path_factory, nodes) -> None:
    path = tmp_path_factory.mktemp('written') / 'movements'
    ways = [np.array(rows) for rows in nodes]
    for way in ways:
        way[:, 0] = np.cumsum(way[:, 0])
        way[0, 0] = 0.0
    path.write_text('\n'.join(' '.join(map(repr, way.ravel().tolist())) for way in ways))
    trace = read_bonnmotion(path, len(ways))
    for number, way in enumerate(ways):
        there = way[:, 0] <= trace.stamp[-1]
        index = np.searchsorted(trace.stamp, way[there, 0])
        np.testing.assert_allclose(trace.position[index, number], way[there, 1:], atol=1e-6)
