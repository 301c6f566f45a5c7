from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
import sys
import time
from typing import Any

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader as RosbagsReader
from sensor_msgs.msg import CompressedImage
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader, STORAGES
from tsmcl_ros.nodes.recorder import Recorder
from tsmcl_ros.nodes.runtime import main, SETTLING
from tsmcl_ros.nodes.wire import LATCHED, publish_all, RELIABLE, SENSOR_DATA
from tsmcl_ros.types import BagError, MessageError, Odometry
from tsmcl_ros.world import anchor_table
from visualization_msgs.msg import Marker, MarkerArray

sys.path.append(str(Path(__file__).parent))
from stalls import calmly  # noqa: E402, I100

Start = Callable[..., Any]


def odometry(stamp: float) -> bytes:
    return messages.encode_odometry(Odometry(stamp, np.zeros(3), 0.0), 'odom', 'base_link')


def record(start: Start, *parameters: str, cwd: Path | None = None) -> Any:
    given = [word for parameter in parameters for word in ('-p', parameter)]
    recorder = start('nodes.recorder', '--ros-args', '-p', 'output:=bag', *given, cwd=cwd)
    recorder.wait_for('recording to bag')
    return recorder


def send(probe: Any, publisher: Any, count: int) -> list[bytes]:
    """Send a burst of messages to a recorder, once it has surely found the publisher."""
    probe.expect(lambda: publisher.get_subscription_count() > 0, 'the recorder')
    sent = [odometry(float(k)) for k in range(count)]
    for data in sent:
        publisher.publish(data)
    return sent


def stored(bag: Path) -> int:
    return sum(path.stat().st_size for path in bag.iterdir())


def recorded(path: Path, topic: str) -> list[bytes]:
    with Reader(path / 'bag') as bag:
        return [message.data for message in bag.messages([topic])]


@pytest.mark.parametrize(('storage', 'how'), [
    ('mcap', signal.SIGINT), ('sqlite3', signal.SIGTERM),
])
def test_a_recorder_stopped_by_a_signal_leaves_a_complete_bag_that_other_tools_open(
    probe: Any, start: Start, tmp_path: Path, storage: str, how: signal.Signals,
) -> None:
    talk = probe.talk('/veh_0/odom', messages.ODOMETRY, RELIABLE)
    recorder = record(start, f'storage:={storage}')
    sent = send(probe, talk, 500)
    probe.expect(lambda: talk.wait_for_all_acked(), 'the acknowledgement')
    assert recorder.stop(how) == 0
    assert 'recorded 500 messages of 1 topics to bag' in recorder.output
    assert 'Traceback' not in recorder.output
    with RosbagsReader(tmp_path / 'bag') as bag:
        assert [data for _, _, data in bag.messages()] == sent
        assert bag.connections[0].msgtype == messages.ODOMETRY
    if storage == 'mcap':
        [file] = (tmp_path / 'bag').glob('*.mcap')
        with file.open('rb') as stream:
            reader = make_reader(stream)
            assert reader.get_summary().statistics.message_count == 500
            assert [item.data for _, _, item in reader.iter_messages()] == sent


def test_a_best_effort_burst_of_many_topics_is_recorded_without_loss(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    talks = [probe.talk(f'/veh_{i}/odom', messages.ODOMETRY, SENSOR_DATA) for i in range(40)]
    recorder = record(start)
    probe.expect(lambda: all(talk.get_subscription_count() for talk in talks), 'the recorder')
    probe.spin(timeout=SETTLING)
    # Less than 512 messages and half a megabyte, which the memory between processes holds.
    for epoch in range(10):
        publish_all((talk, odometry(float(epoch))) for talk in talks)
    probe.spin(timeout=SETTLING)
    assert recorder.stop() == 0
    with Reader(tmp_path / 'bag') as bag:
        assert set(bag.counts.values()) == {10}
        assert len(bag.counts) == 40


def test_a_topic_of_several_types_is_refused() -> None:
    # One participant of DDS cannot have both.
    with pytest.raises(MessageError, match='it has several types, a/msg/A, b/msg/B'):
        Recorder._subscribe(None, '/twofold', ['a/msg/A', 'b/msg/B'], RELIABLE)


def test_a_bag_says_by_which_command_and_parameters_it_was_recorded(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    talk = probe.talk('/odom', messages.ODOMETRY, RELIABLE)
    recorder = record(start, 'exclude:=[/a]')
    send(probe, talk, 1)
    probe.expect(lambda: talk.wait_for_all_acked(), 'the acknowledgement')
    recorder.stop()
    with Reader(tmp_path / 'bag') as bag:
        about = bag.about
    assert about['command'] == (
        "recorder --ros-args -p output:=bag -p 'exclude:=[/a]'")
    assert '    exclude: ["/a"]\n' in about['recorder']


@pytest.mark.parametrize('storage', STORAGES)
def test_a_killed_recorder_loses_the_last_second_at_most(
    probe: Any, start: Start, run: Callable[..., tuple[int, str]], tmp_path: Path, storage: str,
) -> None:
    def kill_one(number: int) -> None:
        folder, topic = tmp_path / f'{number}', f'/odom_{number}'
        folder.mkdir()
        talk = probe.talk(topic, messages.ODOMETRY, RELIABLE)
        recorder = record(start, f'storage:={storage}', cwd=folder)
        sent: list[tuple[float, bytes]] = []

        def send_one() -> None:
            sent.append((time.monotonic(), odometry(float(len(sent)))))
            talk.publish(sent[-1][1])
            probe.spin(timeout=0.01)

        bag = folder / 'bag'
        probe.expect(lambda: talk.get_subscription_count() > 0, 'the recorder')
        size = stored(bag)
        # Once it has got going, on a machine that may be busy.
        probe.insist(send_one, lambda: stored(bag) > size, 'something saved')
        end = time.monotonic() + 2.5
        while time.monotonic() < end:
            send_one()
        recorder.kill()
        killed = time.monotonic()
        probe.destroy_publisher(talk)

        with pytest.raises(BagError, match=f'cut short; .*: recorder --repair {bag}'):
            Reader(bag)
        code, said = run('nodes.recorder', '--repair', bag)
        found = recorded(folder, topic)
        assert (code, said) == (0, f'{bag}: repaired, {len(found)} messages of 1 topics\n')
        assert found == [data for _, data in sent[:len(found)]]
        assert all(stamp > killed - 1 for stamp, _ in sent[len(found):])

    calmly(kill_one)


def test_on_a_full_disk_a_recorder_ends_with_one_line_and_a_bag_that_is_valid(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    talk = probe.talk('/image', 'sensor_msgs/msg/CompressedImage', RELIABLE)
    recorder = start(
        'nodes.recorder', '--ros-args', '-p', 'output:=bag',
        within=['prlimit', f'--fsize={3 * 2**20}'])
    recorder.wait_for('recording to bag')
    image = serialize_message(CompressedImage(format='png', data=bytes(100_000)))
    probe.expect(lambda: talk.get_subscription_count() > 0, 'the recorder')
    for _ in range(100):
        talk.publish(image)
        probe.spin(timeout=0.02)
    assert recorder.wait() == 1
    *_, last = recorder.output.splitlines()
    assert last.startswith('recorder: bag: cannot be written: ')
    assert 'Traceback' not in recorder.output
    found = recorded(tmp_path, '/image')
    assert last.endswith(f'; complete are the {len(found)} messages before')
    assert len(found) > 10
    assert set(found) == {image}


def test_a_bag_is_never_overwritten(start: Start, tmp_path: Path) -> None:
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'precious').write_text('data')
    recorder = start('nodes.recorder', '--ros-args', '-p', 'output:=bag')
    assert recorder.wait() == 1
    assert recorder.output == 'recorder: bag: exists already, bags are never overwritten\n'
    assert [item.name for item in (tmp_path / 'bag').iterdir()] == ['precious']


def test_topics_are_chosen_by_name_or_regular_expression(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    names = ('/veh_0/odom', '/veh_1/odom', '/veh_2/odom', '/else')
    talks = {name: probe.talk(name, messages.ODOMETRY, RELIABLE) for name in names}
    recorder = record(start, 'topics:=["/veh_.*/odom", "else"]', 'exclude:=["/veh_1/.*"]')
    wanted = [talks[name] for name in ('/veh_0/odom', '/veh_2/odom', '/else')]
    for talk in wanted:
        send(probe, talk, 1)
    probe.expect(lambda: all(talk.wait_for_all_acked() for talk in wanted), 'acknowledgements')
    assert recorder.stop() == 0
    with Reader(tmp_path / 'bag') as bag:
        assert bag.counts == {'/veh_0/odom': 1, '/veh_2/odom': 1, '/else': 1}


def test_mcaps_own_decoder_understands_every_message_by_the_schemas_in_the_bag(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    marker = Marker(ns='anchor_ids', text='7: suspect')
    diagnosis = messages.Diagnosis(1, 'fleet: /veh_0', 'STALE', '/veh_0', {'suspects': '7'})
    sent = {
        '/markers': ('visualization_msgs/msg/MarkerArray',
                     serialize_message(MarkerArray(markers=[marker]))),
        '/diagnostics': (messages.DIAGNOSTICS, messages.encode_diagnostics(1.5, [diagnosis])),
        '/odom': (messages.ODOMETRY, odometry(1.5)),
        '/pose': (messages.POSE, messages.encode_pose(
            1.5, 'map', np.array([3.0, 4.0]), np.eye(2), 0.1, 0.2)),
        '/cloud': (messages.POSE_ARRAY, messages.encode_pose_array(
            1.5, 'map', np.array([[3.0, 4.0]]))),
        '/beacons': (messages.POINT_CLOUD, messages.encode_beacons(
            anchor_table(np.zeros((1, 3))), 'map')[0]),
        '/beacon_period': (messages.UINT32, messages.encode_period(4)),
    }
    talks = {name: probe.talk(name, kind, RELIABLE) for name, (kind, _) in sent.items()}
    recorder = record(start)
    probe.expect(lambda: all(talk.get_subscription_count() for talk in talks.values()), 'recorder')
    for name, talk in talks.items():
        talk.publish(sent[name][1])
    probe.expect(lambda: all(talk.wait_for_all_acked() for talk in talks.values()), 'its answer')
    recorder.stop()

    [file] = (tmp_path / 'bag').glob('*.mcap')
    with file.open('rb') as stream:
        found = {channel.topic: decoded for _, channel, _, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()}
    assert found.keys() == sent.keys()
    assert found['/markers'].markers[0].text == '7: suspect'
    assert found['/diagnostics'].status[0].values[0].value == '7'
    assert found['/diagnostics'].header.stamp.nanosec == 500_000_000
    assert found['/odom'].child_frame_id == 'base_link'
    assert found['/pose'].pose.pose.position.y == 4.0
    assert found['/cloud'].poses[0].position.x == 3.0
    assert found['/beacons'].fields[0].name == 'x'
    assert found['/beacon_period'].data == 4


def test_a_latched_message_is_recorded_although_it_came_before_and_stays_latched(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    anchor_map = probe.talk('/anchor_map', messages.POINT_CLOUD, LATCHED)
    data, = messages.encode_beacons(anchor_table(np.zeros((1, 3))), 'map')
    anchor_map.publish(data)
    recorder = record(start)
    probe.expect(lambda: anchor_map.get_subscription_count() > 0, 'the recorder')
    probe.spin(timeout=SETTLING)  # an acknowledgement tells nothing of what came before the match
    assert recorder.stop() == 0
    found, = recorded(tmp_path, '/anchor_map')
    assert found.rstrip(b'\0') == data.rstrip(b'\0')  # DDS pads messages to four bytes
    with Reader(tmp_path / 'bag') as bag:
        assert bag.latched == {'/anchor_map'}


def test_with_sim_time_log_times_follow_the_clock_and_the_duration_too(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    clock = probe.talk('/clock', messages.CLOCK, RELIABLE)
    talk = probe.talk('/veh_0/odom', messages.ODOMETRY, RELIABLE)
    recorder = record(start, 'use_sim_time:=true', 'duration:=20.0')
    probe.expect(lambda: clock.get_subscription_count() == 2, 'the recorder to watch the clock')
    probe.spin(timeout=SETTLING)
    send(probe, talk, 1)  # before there is any time
    probe.expect(talk.wait_for_all_acked, 'the acknowledgement')
    for stamp in (100.0, 107.5, 119.0):
        clock.publish(messages.encode_clock(stamp))
        talk.publish(odometry(stamp))
    clock.publish(messages.encode_clock(120.0))
    assert recorder.wait() == 0
    with Reader(tmp_path / 'bag') as bag:
        stamps = [message.stamp for message in bag.messages()]
    assert stamps == [100.0, 100.0, 107.5, 119.0]


def test_a_topic_that_appears_later_is_recorded(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    recorder = record(start)
    late = probe.talk('/late', messages.ODOMETRY, RELIABLE)
    sent = send(probe, late, 3)
    probe.expect(late.wait_for_all_acked, 'the acknowledgement')
    assert recorder.stop() == 0
    assert recorded(tmp_path, '/late') == sent


@pytest.mark.parametrize(('parameters', 'complaint'), [
    ([], "output: '' is not allowed, must be the folder of a new bag"),
    (['output:=b', 'storage:=rosbag'], "storage: 'rosbag' is not allowed, must be one of mcap, "
                                       'sqlite3'),
    (['output:=b', 'topics:=["(odom"]'], "topics: '(odom' is not allowed, must be a topic or a "
                                         'regular expression: '),
])
def test_a_parameter_that_is_not_allowed_is_one_line_and_exit_code_1(
    capfd: pytest.CaptureFixture[str], parameters: list[str], complaint: str,
) -> None:
    given = [word for parameter in parameters for word in ('-p', parameter)]
    assert main(Recorder, ['recorder', '--ros-args', *given]) == 1
    error = capfd.readouterr().err
    assert error.startswith(f'recorder: {complaint}')
    assert len(error.splitlines()) == 1
