"""ns-2 movement files: what their statements mean, and damaged ones refused by line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tsmcl_ros.traces import follow, TraceConfig
from tsmcl_ros.traces.ns2 import read_ns2
from tsmcl_ros.types import LogError

# Node 0 drives 30 m north-east in 10 s and stands; 1 is sent off again before it arrives.
MOVEMENTS = """
# nodes: 2, pause: 0.00, max speed: 5.00
$node_(0) set X_ 10.0
$node_(0) set Y_ 20.0
$node_(0) set Z_ 0.0
$ns_ at 2.0 "$node_(0) setdest 28.0 44.0 3.0"
$god_ set-dist 0 1 1
$node_(1) set X_ 0.0
$node_(1) set Y_ 0.0
$ns_ at 0.0 "$node_(1) setdest 100.0 0.0 10.0"
$ns_ at 4.0 "$node_(1) setdest 40.0 60.0 5.0"
$ns_ at 5.0 "$god_ set-dist 0 1 2"
"""


@pytest.fixture
def write(tmp_path):
    def write_text(text: str) -> Path:
        path = tmp_path / 'scenario.ns_movements'
        path.write_text(text)
        return path
    return write_text


def places(path: Path, *times: float, **options: bool) -> np.ndarray:
    """Return where the nodes are at the times, (T, V, D)."""
    trace = read_ns2(path, 2, **options)
    return np.array([
        [[np.interp(time, trace.stamp, axis) for axis in way.T]
         for way in trace.position.transpose(1, 0, 2)] for time in times])


def test_a_node_stands_until_it_is_sent_and_when_it_has_arrived(write) -> None:
    found = places(write(MOVEMENTS), 1.0, 7.0, 12.0, 15.0)[:, 0]
    np.testing.assert_allclose(found, [[10, 20], [19, 32], [28, 44], [28, 44]])


def test_a_node_sent_elsewhere_turns_where_it_is(write) -> None:
    found = places(write(MOVEMENTS), 4.0, 8.0, 16.0)[:, 1]
    np.testing.assert_allclose(found, [[40, 0], [40, 20], [40, 60]])


def test_a_speed_of_zero_stops_a_node(write) -> None:
    text = MOVEMENTS + '$ns_ at 6.0 "$node_(1) setdest 90 90 0"\n'
    np.testing.assert_allclose(places(write(text), 6.0, 11.0)[:, 1], [[40, 10], [40, 10]])


def test_the_trace_lasts_until_the_last_node_has_arrived(write) -> None:
    trace = read_ns2(write(MOVEMENTS), 2)
    assert (trace.stamp[0], trace.stamp[-1]) == (0.0, 16.0)


def test_places_to_begin_may_stand_at_the_end_of_the_file(write) -> None:
    lines = MOVEMENTS.splitlines()
    moved = [line for line in lines if ' set ' not in line] + [
        line for line in lines if ' set ' in line]
    np.testing.assert_array_equal(
        places(write('\n'.join(moved)), 3.0, 9.0), places(write(MOVEMENTS), 3.0, 9.0))


def test_nodes_are_named_by_their_numbers(write) -> None:
    assert read_ns2(write(MOVEMENTS), 2).names == ('0', '1')


def test_nodes_face_where_they_drive(write) -> None:
    path = write(MOVEMENTS)
    replay = follow('ns2', TraceConfig(trace=str(path), trace_start=0.0), 2)
    np.testing.assert_allclose(replay.step(3.0).yaw, [np.arctan2(24, 18), 0])
    np.testing.assert_allclose(replay.step(4.0).yaw, [np.arctan2(24, 18), np.pi / 2])


def test_height_is_kept_when_asked_for(write) -> None:
    text = ('$node_(0) set X_ 0\n$node_(0) set Y_ 0\n$node_(0) set Z_ 7\n'
            '$ns_ at 0 "$node_(0) setdest 0 0 17 2"\n'
            '$node_(1) set X_ 0\n$node_(1) set Y_ 0\n')
    np.testing.assert_allclose(
        places(write(text), 2.5, elevation=True)[0], [[0, 0, 12], [0, 0, 0]])


@pytest.mark.parametrize(('line', 'complaint'), [
    ('$ns_ at 9.0 "$node_(0) set X_ 5.0"', r':13: .*set X_ 5.0.* is not understood, expected'),
    ('hello', r":13: 'hello' is not understood"),
    ('$node_(0) set X_ east', r":13: 'east' is not a finite number"),
    ('$node_(0) set X_ 1e300', r':13: 1e300 is not allowed, must be within 1e\+12'),
    ('$ns_ at 9.0 "$node_(0) setdest 1 1 1e-300"', r': who goes 41.8115 m at 1e-300 m/s'),
    ('$ns_ at nan "$node_(0) setdest 1 1 1"', r":13: 'nan' is not a finite number"),
    ('$ns_ at 1.0 "$node_(0) setdest 1 1 1"', r':13: time 1 s of \$node_\(0\) does not come af'),
    ('$ns_ at 9.0 "$node_(0) setdest 1 1 -2"', r':13: speed -2 m/s is not allowed, must be at l'),
    ('$ns_ at 9.0 "$node_(2) setdest 1 1 2"', r': \$node_\(2\) has no place to begin, expected'),
    ('$ns_ at 9.0 "$node_(1) setdest 1 1 1 2"', r': \$node_\(1\) is sent to "x y z" but has no'),
])
def test_what_is_no_movement_is_refused_by_file_and_line(write, line, complaint) -> None:
    with pytest.raises(LogError, match=r'scenario\.ns_movements' + complaint):
        read_ns2(write(MOVEMENTS + line + '\n'), 2)


def test_more_vehicles_than_nodes_are_refused(write) -> None:
    with pytest.raises(LogError, match='holds 2 vehicles that are there from 0 s on, 3 are want'):
        read_ns2(write(MOVEMENTS), 3)


def test_an_empty_file_holds_no_vehicles(write) -> None:
    with pytest.raises(LogError, match='holds 0 vehicles'):
        read_ns2(write('# nothing\n'), 1)
