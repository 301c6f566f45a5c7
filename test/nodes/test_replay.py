from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
import sys
import time
from typing import Any

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.bag import Writer
from tsmcl_ros.nodes.replay import Replay
from tsmcl_ros.nodes.runtime import main
from tsmcl_ros.nodes.wire import LATCHED_INPUT, SENSOR_DATA
from tsmcl_ros.types import Odometry
from tsmcl_ros.world import anchor_table

sys.path.append(str(Path(__file__).parent))
from stalls import calmly  # noqa: E402, I100

Start = Callable[..., Any]
ODOM, POSE, MAP = '/veh_0/odom', '/veh_0/pose', '/anchor_map'
BEGIN, STEP = 1000.0, 0.5  # s


def odometry(k: int) -> bytes:
    """Return a message whose stamp is not its log time."""
    return messages.encode_odometry(Odometry(float(k), np.zeros(3), 0.0), 'odom', 'base_link')


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Return a bag of 10 s: odometry, two anchor maps and a pose."""
    anchors = messages.encode_beacons(anchor_table(np.zeros((1, 3))), 'map')[0]
    pose = messages.encode_pose(3.0, 'map', np.zeros(2), np.eye(2), np.nan, np.nan)
    with Writer(tmp_path / 'bag') as writer:
        writer.topic(ODOM, messages.ODOMETRY)
        writer.topic(POSE, messages.POSE, latched=True)
        writer.topic(MAP, messages.POINT_CLOUD, latched=True)
        writer.write(MAP, BEGIN, anchors)
        for k in range(21):
            writer.write(ODOM, BEGIN + k * STEP, odometry(k))
        writer.write(POSE, BEGIN + 10.0, pose)
    return tmp_path / 'bag'


def play(start: Start, *parameters: str) -> Any:
    given = [word for parameter in parameters for word in ('-p', parameter)]
    return start('nodes.replay', '--ros-args', '-p', 'bag:=bag', *given)


def stamps(received: list[bytes]) -> list[float]:
    return [messages.decode_odometry(data).stamp for data in received]


def test_messages_are_played_byte_for_byte_with_the_clock_at_their_log_time(
    probe: Any, start: Start, bag: Path,
) -> None:
    clock = [0.0]
    played: list[tuple[float, bytes]] = []
    probe.listen('/clock', messages.CLOCK,
                 lambda data: clock.append(messages.decode_clock(data)), SENSOR_DATA)
    probe.listen(ODOM, messages.ODOMETRY,
                 lambda data: played.append((clock[-1], data)), SENSOR_DATA)
    poses = probe.collect(POSE, messages.POSE)
    replay = play(start, 'rate:=20.0', f'wait_for:=[{ODOM}]')
    probe.expect(lambda: replay.process.poll() is not None, 'the replay to end')
    assert replay.wait() == 0
    assert [data for _, data in played] == [odometry(k) for k in range(21)]
    at = np.array([stamp for stamp, _ in played])
    log = BEGIN + STEP * np.arange(21)
    assert (at <= log).all()
    # The clock is shown each 10 ms, here 0.2 s of the time in the bag.
    assert (log - at < 0.2 + 1e-6).all()
    assert (np.diff(clock) >= 0).all()
    assert clock[-1] > BEGIN + 10
    assert poses == []


def test_latched_messages_come_first_and_also_to_who_comes_later(
    probe: Any, start: Start, bag: Path,
) -> None:
    order: list[str] = []
    probe.listen(MAP, messages.POINT_CLOUD, lambda _: order.append(MAP), LATCHED_INPUT)
    probe.listen(ODOM, messages.ODOMETRY, lambda _: order.append(ODOM), SENSOR_DATA)
    play(start, 'rate:=5.0', f'wait_for:=[{ODOM}, {MAP}]')
    probe.expect(lambda: len(order) == 5, 'the first messages')
    assert order == [MAP, *[ODOM] * 4]
    late = probe.collect(MAP, messages.POINT_CLOUD, LATCHED_INPUT)
    probe.expect(lambda: bool(late), 'the map')


def test_a_replay_keeps_its_rate(probe: Any, start: Start, bag: Path) -> None:
    times: list[float] = []
    probe.listen(ODOM, messages.ODOMETRY, lambda _: times.append(time.monotonic()), SENSOR_DATA)
    play(start, 'rate:=10.0', 'loop:=true', f'wait_for:=[{ODOM}]')

    def took(_: int) -> float:
        times.clear()
        probe.expect(lambda: len(times) > 21, 'as many messages as a round has, and one more')
        return times[21] - times[0]

    assert calmly(took) == pytest.approx(1.0, abs=0.25)


def test_a_replay_can_begin_in_the_middle_and_again_at_the_end(
    probe: Any, start: Start, bag: Path,
) -> None:
    received = probe.collect(ODOM, messages.ODOMETRY)
    maps = probe.collect(MAP, messages.POINT_CLOUD, LATCHED_INPUT)
    replay = play(start, 'rate:=20.0', 'start:=8.0', 'loop:=true', f'wait_for:=[{ODOM}]')
    probe.expect(lambda: len(received) >= 12, 'two and a half rounds')
    assert stamps(received[:12]) == [16, 17, 18, 19, 20, 16, 17, 18, 19, 20, 16, 17]
    assert maps
    assert replay.stop(signal.SIGTERM) == 0
    assert 'Traceback' not in replay.output


def test_topics_may_be_chosen_left_out_and_remapped(
    probe: Any, start: Start, bag: Path,
) -> None:
    poses = probe.collect('/recorded', messages.POSE)
    odom = probe.collect(ODOM, messages.ODOMETRY)
    replay = start('nodes.replay', '--ros-args', '-p', 'bag:=bag', '-p', 'rate:=50.0',
                   '-p', 'topics:=[".*/pose", ".*/odom"]', '-p', f'exclude:=[{ODOM}]',
                   '-r', f'{POSE}:=/recorded')
    assert replay.wait() == 0
    probe.expect(lambda: bool(poses), 'the pose')
    assert odom == []


def test_a_replay_begins_without_listeners_after_a_while(start: Start, bag: Path) -> None:
    replay = play(start, 'rate:=100.0', 'wait:=0.2', f'wait_for:=[{ODOM}]')
    assert replay.wait() == 0
    assert f'nobody listens to {ODOM}' in replay.output


def test_topics_of_a_type_that_is_not_installed_are_named_and_skipped(
    probe: Any, start: Start, bag: Path, tmp_path: Path,
) -> None:
    received = probe.collect(ODOM, messages.ODOMETRY)
    for path in bag.iterdir():
        data = path.read_bytes()
        # A name of the same length, so that the bag stays in order.
        path.write_bytes(data.replace(b'PoseWithCovarianceStamped', b'PoseWithConvenienceStamps'))
    replay = play(start, 'rate:=50.0', 'exclude:=[]')
    probe.expect(lambda: len(received) == 21, 'the other topic')
    assert replay.wait() == 0
    assert replay.output.count(f'{POSE} is not played: message type') == 1


@pytest.mark.parametrize(('parameters', 'complaint'), [
    ([], "bag: '' is not allowed, must be the folder of a bag"),
    (['bag:=nowhere'], 'nowhere: there is no such bag'),
    (['bag:={bag}', 'start:=11.0'], "start: 11 s is not allowed, must be at most the bag's "
                                    'duration, 10 s'),
    (['bag:={bag}', 'topics:=[nothing]'], '{bag}: has no topic to play, has /anchor_map, '),
    (['bag:={bag}', 'rate:=0.0'], 'rate: 0.0 is not allowed, must be a number above 0'),
])
def test_what_is_not_allowed_is_one_line_and_exit_code_1(
    capfd: pytest.CaptureFixture[str], bag: Path, parameters: list[str], complaint: str,
) -> None:
    given = [word.format(bag=bag) for parameter in parameters for word in ('-p', parameter)]
    assert main(Replay, ['replay', '--ros-args', *given]) == 1
    error = capfd.readouterr().err
    assert error.startswith(f'replay: {complaint.format(bag=bag)}')
    assert len(error.splitlines()) == 1
