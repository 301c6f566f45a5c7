"""Replay against hand-made traces."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from tsmcl_ros.model.mobility.trace import Replay, Trace
from tsmcl_ros.types import ConfigError, LogError


@pytest.fixture
def trace() -> Trace:
    """Two vehicles at 10 s, 12 s and 13 s; the first turns left through north-west to south."""
    return Trace(
        names=('taxi', 'bus'),
        stamp=np.array([10.0, 12.0, 13.0]),
        position=np.array([
            [[0.0, 0.0], [5.0, 5.0]],
            [[4.0, 2.0], [5.0, 5.0]],
            [[4.0, 10.0], [6.0, 5.0]],
        ]),
        yaw=np.radians([[90.0, 0.0], [170.0, 0.0], [-90.0, 0.0]]),
    )


def test_replay_begins_where_the_trace_does(trace) -> None:
    np.testing.assert_array_equal(Replay(trace).state.position, trace.position[0])


def test_replay_passes_through_every_instant_of_the_trace(trace) -> None:
    replay = Replay(trace)
    np.testing.assert_allclose(replay.step(2.0).position, trace.position[1])
    np.testing.assert_allclose(replay.step(1.0).position, trace.position[2])


def test_replay_interpolates_positions_linearly(trace) -> None:
    np.testing.assert_allclose(Replay(trace).step(0.5).position, [[1.0, 0.5], [5.0, 5.0]])


def test_replayed_velocity_is_the_slope_of_the_positions(trace) -> None:
    replay = Replay(trace)
    np.testing.assert_allclose(replay.step(1.9).velocity, [[2.0, 1.0], [0.0, 0.0]])
    np.testing.assert_allclose(replay.step(0.2).velocity, [[0.0, 8.0], [1.0, 0.0]])


def test_replayed_yaw_turns_the_short_way(trace) -> None:
    replay = Replay(trace)
    assert replay.step(1.0).yaw[0] == pytest.approx(math.radians(130.0))
    assert replay.step(1.5).yaw[0] == pytest.approx(math.radians(-140.0))


def test_replay_can_begin_inside_the_trace(trace) -> None:
    replay = Replay(trace, start=12.5)
    np.testing.assert_allclose(replay.state.position[0], [4.0, 6.0])
    assert replay.duration == 0.5


def test_replay_keeps_the_names_of_the_recording(trace) -> None:
    assert Replay(trace).names == ('taxi', 'bus')


def test_replay_reaches_the_end_in_many_small_steps(trace) -> None:
    replay = Replay(trace)
    for _ in range(30):
        state = replay.step(0.1)  # sums to 3.0000000000000013 s
    np.testing.assert_allclose(state.position, trace.position[-1])


def test_replay_beyond_the_trace_is_refused(trace) -> None:
    replay = Replay(trace)
    with pytest.raises(LogError, match='13.5 s is not in it, it lasts from 10 s to 13 s'):
        replay.step(3.5)


def test_replay_back_in_time_is_refused(trace) -> None:
    with pytest.raises(ConfigError, match='-0.5 is not allowed'):
        Replay(trace).step(-0.5)


def test_without_a_recorded_yaw_vehicles_face_where_they_drive(trace) -> None:
    replay = Replay(replace(trace, yaw=None))
    assert replay.state.yaw[0] == pytest.approx(math.atan2(2, 4))
    assert replay.step(2.5).yaw[0] == pytest.approx(math.pi / 2)


def test_without_a_recorded_yaw_a_vehicle_keeps_its_while_it_stands() -> None:
    north_then_stand = np.array([[[0.0, 0.0]], [[0.0, 1.0]], [[0.0, 1.0]]])
    replay = Replay(Trace(('bus',), np.array([0.0, 1.0, 2.0]), north_then_stand, None))
    assert replay.step(1.5).yaw[0] == pytest.approx(math.pi / 2)
