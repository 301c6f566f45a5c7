from __future__ import annotations

from collections.abc import Callable
import csv
from importlib.util import find_spec
from pathlib import Path
import signal
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from std_srvs.srv import Empty
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.methods import METHODS
from tsmcl_ros.nodes import localizer
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.runtime import main, Node
from tsmcl_ros.nodes.wire import LATCHED, LATCHED_INPUT, RELIABLE, SENSOR_DATA
from tsmcl_ros.scripts import import_csv
from tsmcl_ros.scripts.localize_bag import localize_bag
from tsmcl_ros.types import Observation, Odometry
from tsmcl_ros.world import make_world, World
from visualization_msgs.msg import MarkerArray

sys.path.append(str(Path(__file__).parent))
from stalls import ARREARS, calmly  # noqa: E402, I100

Start = Callable[..., Any]
Ros = Callable[..., None]
Scene = Any  # of conftest.py
PARAMETERS = {'radio_range': 1000.0, 'odom_heading': 'known', 'odom_std': 0.5}


def overrides(**settings: object) -> list[str]:
    return [word for name, value in settings.items()
            for word in ('-p', f'{name}:={str(value).lower()}')]


def world(vehicles: int = 1, seed: int = 2, **settings: object) -> World:
    return make_world(
        {'vehicles': vehicles, 'area_x': 3000.0, 'area_y': 3000.0, 'anchor_rows': 3,
         'anchor_columns': 3, 'radio_range': 1000.0, **settings}, np.random.default_rng(seed))


class Source:
    """Publishes what a world's vehicles hear and measure."""

    def __init__(self, node: Node, scene: World, names: list[str]) -> None:
        self.node, self.world, self.names = node, scene, names
        self.map = node.talk('/anchor_map', messages.POINT_CLOUD, LATCHED)
        self.beacons = [node.talk(f'{name}/beacons', messages.POINT_CLOUD, SENSOR_DATA)
                        for name in names]
        self.odom = [node.talk(f'{name}/odom', messages.ODOMETRY, SENSOR_DATA) for name in names]
        self.map.publish(messages.encode_beacons(scene.anchors, 'map')[0])

    def is_heard(self) -> bool:
        return all(talk.get_subscription_count()
                   for talk in (self.map, *self.beacons, *self.odom))

    def step(self) -> dict[str, bytes]:
        """Let one epoch pass, and return what was published by topic."""
        epoch = self.world.step()
        sent = {}
        for i, scan in enumerate(messages.encode_beacons(epoch.observation, 'map')):
            position = np.append(epoch.odom_position[i], 0.0)
            odometry = Odometry(epoch.stamp, position, float(epoch.odom_yaw[i]))
            data = messages.encode_odometry(odometry, 'odom', 'base_link')
            self.odom[i].publish(data)
            self.beacons[i].publish(scan)
            sent |= {f'{self.names[i]}/odom': data, f'{self.names[i]}/beacons': scan}
        return sent


def logged(scene: Scene, capfd: pytest.CaptureFixture[str], note: str) -> str:
    """Return what has been logged, a few periods of warnings after a note."""
    written: list[str] = []

    def is_noted() -> bool:
        written.append(capfd.readouterr().err)
        return note in ''.join(written)

    scene.until(is_noted, note)
    scene.node.spin(timeout=0.3)
    return ''.join(written) + capfd.readouterr().err


@pytest.fixture
def begin(begin: Callable[..., Any]) -> Callable[..., Any]:
    """Start a localizer node with these parameters and some more."""
    return lambda kind=LocalizerNode, **settings: begin(kind, **PARAMETERS | settings)


def offline(sent: list[dict[str, bytes]], scene: World, names: list[str], **settings: object
            ) -> list[bytes]:
    """Return the poses that the localizer gives in process for the same messages."""
    endpoint = Endpoint(Localizer(PARAMETERS | settings, len(names)), names)
    endpoint.inputs['/anchor_map'][1](messages.encode_beacons(scene.anchors, 'map')[0])
    poses = []
    for epoch in sent:
        for topic, data in epoch.items():
            endpoint.inputs[topic][1](data)
        for estimate in endpoint.localizer.due():
            poses += [data for _, data in endpoint.poses(estimate)]
    return poses


def test_poses_are_those_of_the_localizer_in_process_and_late_joiners_get_the_last(
    begin: Callable[..., Scene],
) -> None:
    scene = begin()
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer to listen')
    sent = []
    for _ in range(5):
        sent.append(source.step())
        scene.until(lambda: len(poses) == len(sent), 'a pose')
    assert poses == offline(sent, source.world, ['/veh_0'])
    late = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    scene.until(lambda: bool(late), 'the last pose')
    assert late == poses[-1:]


@pytest.mark.parametrize('method', METHODS)
def test_every_method_gives_the_same_poses_over_dds_as_in_process(
    begin: Callable[..., Scene], method: str,
) -> None:
    # With ranges to two anchors there is a pose from the start.
    settings: dict[str, object] = {'method': method, 'hold_circles': False}
    if method == 'grid':
        settings |= {'motion_model': 'random', 'grid_cell': 50.0, 'grid_x_max': 3000.0,
                     'grid_y_max': 3000.0}
    scene = begin(**settings)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(measure_range=True, range_std=5.0), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer to listen')
    sent = []
    for _ in range(3):
        sent.append(source.step())
        scene.until(lambda: len(poses) == len(sent), 'a pose')
    assert poses == offline(sent, source.world, ['/veh_0'], **settings)


@pytest.mark.parametrize('method', ['cooperative', 'nbp'])
def test_ranged_beacons_place_a_vehicle_by_methods_that_cooperate(
    begin: Callable[..., Scene], method: str,
) -> None:
    scene = begin(method=method, hold_circles=False)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(measure_range=True, range_std=5.0), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer to listen')
    for count in (1, 2):
        source.step()
        scene.until(lambda count=count: len(poses) == count, 'a pose')
    pose = messages.decode_pose(poses[-1])
    off = pose.position[:2] - source.world.mobility.state.position[0]
    # Two or three ranges of 5 m, in an area of 3 km; that it knows how well is the stricter test.
    assert np.linalg.norm(off) < 200.0
    assert off @ np.linalg.solve(pose.covariance[:2, :2], off) < 14.0


def test_a_fleet_localizes_its_vehicles_as_one_batch(begin: Callable[..., Scene]) -> None:
    names = ['/veh_3', '/veh_4']
    scene = begin(Fleet, vehicles=2, first_vehicle=3)
    received: list[bytes] = []
    for name in names:
        scene.probe.listen(f'{name}/pose', messages.POSE, received.append, LATCHED_INPUT)
    source = Source(scene.probe, world(vehicles=2), names)
    scene.until(source.is_heard, 'the fleet to listen')
    sent = []
    for _ in range(3):
        sent.append(source.step())
        scene.until(lambda: len(received) == 2 * len(sent), 'two poses')
    assert received == offline(sent, source.world, names)


def test_clouds_and_markers_show_what_is_estimated(begin: Callable[..., Scene]) -> None:
    from geometry_msgs.msg import PoseArray

    scene = begin(cloud_period=0.1, marker_period=0.1)
    clouds = scene.probe.collect('particle_cloud', messages.POSE_ARRAY)
    shown = scene.probe.collect('markers', 'visualization_msgs/msg/MarkerArray', LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer to listen')
    source.step()
    scene.until(lambda: bool(clouds and shown), 'cloud and markers')
    cloud = deserialize_message(clouds[0], PoseArray)
    assert (cloud.header.frame_id, cloud.header.stamp.sec) == ('map', 1)
    assert len(cloud.poses) >= 200
    markers = deserialize_message(shown[0], MarkerArray).markers
    assert [sum(marker.ns == name for marker in markers)
            for name in ('anchors', 'radio_range', 'covariance')] == [9, 9, 1]
    disk = next(marker for marker in markers if marker.ns == 'radio_range')
    assert disk.scale.x == 2000.0


def test_who_comes_after_the_last_epoch_still_sees_its_markers(
    begin: Callable[..., Scene],
) -> None:
    scene = begin()
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer to listen')
    source.step()
    scene.until(lambda: bool(poses), 'a pose')
    shown = scene.probe.collect('markers', 'visualization_msgs/msg/MarkerArray', LATCHED_INPUT)
    scene.until(lambda: bool(shown), 'markers')
    markers = deserialize_message(shown[0], MarkerArray).markers
    assert sum(marker.ns == 'covariance' for marker in markers) == 1


def test_initial_poses_are_taken_in_the_map_and_ignored_with_a_warning_elsewhere(
    begin: Callable[..., Scene], capfd: pytest.CaptureFixture[str],
) -> None:
    scene = begin()
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    initial = scene.probe.talk('initialpose', messages.POSE, RELIABLE)
    scene.until(lambda: source.is_heard() and initial.get_subscription_count() > 0, 'listeners')
    truth = source.world.mobility.state.position[0]
    for frame in ('odom', 'map'):
        initial.publish(messages.encode_pose(0.0, frame, truth, 100.0 * np.eye(2), 0.0, 0.1))
    scene.until(initial.wait_for_all_acked, 'the initial pose to arrive')
    source.step()
    scene.until(lambda: bool(poses), 'a pose')
    mean = messages.decode_pose(poses[0]).position[:2]
    assert np.linalg.norm(mean - source.world.mobility.state.position[0]) < 60
    error = capfd.readouterr().err
    assert error.count('[WARN]') == 1
    assert "frame_id 'odom' is not allowed, must be 'map'" in error


def test_diagnostics_go_from_lost_to_ok_to_stale(begin: Callable[..., Scene]) -> None:
    scene = begin(stale_after=0.5)
    told: list[DiagnosticStatus] = []
    scene.probe.listen(
        '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray',
        lambda data: told.extend(deserialize_message(data, DiagnosticArray).status), RELIABLE)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(lambda: source.is_heard() and bool(told), 'the first diagnostics')
    assert (told[-1].level, told[-1].name) == (DiagnosticStatus.ERROR, 'localizer: /veh_0')
    source.step()
    scene.until(lambda: told[-1].level == DiagnosticStatus.OK, 'OK')
    facts = {item.key: item.value for item in told[-1].values}
    assert facts['method'] == 'ts_mcl'
    assert facts['seed'] == '0'
    assert int(facts['beacons heard']) > 0
    assert float(facts['effective particles']) > 0
    scene.until(lambda: told[-1].level == DiagnosticStatus.WARN, 'STALE, as nothing comes')
    assert told[-1].message.startswith('STALE')


def test_strangers_are_ignored_named_once_and_can_be_let_in_while_it_runs(
    begin: Callable[..., Scene], capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(localizer, '_WARNING_PERIOD', 0.05)
    scene = begin(anchor_allowlist=['1'])
    told: list[DiagnosticStatus] = []
    scene.probe.listen(
        '/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray',
        lambda data: told.extend(deserialize_message(data, DiagnosticArray).status), RELIABLE)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(lambda: source.is_heard() and bool(told), 'the first diagnostics')

    def facts() -> dict[str, str]:
        return {item.key: item.value for item in told[-1].values}

    def step(heard: Callable[[int], bool]) -> None:
        source.step()
        scene.until(lambda: heard(int(facts().get('beacons heard', -1))), 'a diagnosis')

    step(lambda count: count in (0, 1))
    assert int(facts()['beacons and ranges ignored']) > 0
    assert '1' not in facts()['senders ignored'].split(', ')
    note = 'ignored beacons and ranges, '
    assert logged(scene, capfd, note).count(note) == 1
    set_one, = scene.node.set_parameters([Parameter('anchor_allowlist', value=['0-99'])])
    assert set_one.successful
    step(lambda count: count > 1)


def test_who_says_what_cannot_be_true_is_named_once_and_the_others_are_heard(
    begin: Callable[..., Scene], capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(localizer, '_WARNING_PERIOD', 0.05)
    scene = begin()
    source = Source(scene.probe, world(), ['/veh_0'])
    received: list[bytes] = []
    scene.probe.listen('/veh_0/pose', messages.POSE, received.append, LATCHED)
    scene.until(source.is_heard, 'the localizer')
    for stamp in (1.0, 2.0):
        heard = Observation.empty(1, 5, 2, stamp)
        heard.sender[0] = np.arange(5)
        heard.position[0] = source.world.anchors.position[0, :5]
        heard.range[0, 0] = -1
        source.beacons[0].publish(messages.encode_beacons(heard, 'map')[0])
    scene.until(lambda: bool(received), 'a pose')
    note = 'left out beacons that cannot be true, '
    written = logged(scene, capfd, note)
    assert written.count(note) == 1
    assert 'of id 0, such as: range -1 of id 0 is not allowed' in written
    assert 'rejected' not in written


def test_every_second_of_the_messages_time_is_diagnosed(begin: Callable[..., Scene]) -> None:
    scene = begin()
    told: list[float] = []
    scene.probe.listen('/diagnostics', messages.DIAGNOSTICS,
                       lambda data: told.append(messages.decode_diagnostics(data)[0]), RELIABLE)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer')
    for number in range(1, 6):
        source.step()
        scene.until(lambda number=number: len(poses) == number, 'a pose')
    stamps = [messages.decode_pose(data).stamp for data in poses]
    scene.until(lambda: set(np.round(stamps, 3)) <= set(np.round(told, 3)), 'a diagnosis of each')


def test_services_have_the_names_of_amcl(begin: Callable[..., Scene]) -> None:
    scene = begin()
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    clients = [scene.probe.create_client(Empty, name) for name in
               ('request_nomotion_update', 'reinitialize_global_localization')]
    scene.until(lambda: source.is_heard() and all(c.service_is_ready() for c in clients), 'all')
    source.step()
    scene.until(lambda: len(poses) == 1, 'a pose')
    again = clients[0].call_async(Empty.Request())
    scene.until(lambda: again.done() and len(poses) == 2, 'the same pose again')
    assert poses[1] == poses[0]
    anew = clients[1].call_async(Empty.Request())
    scene.until(anew.done, 'the answer')
    source.step()
    scene.until(lambda: len(poses) == 3, 'a pose from anywhere')


def test_time_that_goes_back_is_told_once_and_localization_starts_anew(
    begin: Callable[..., Scene], capfd: pytest.CaptureFixture[str],
) -> None:
    scene = begin(time_jump=2.0)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(source.is_heard, 'the localizer to listen')
    for count in range(1, 11):
        source.step()
        scene.until(lambda count=count: len(poses) == count, 'a pose')
        if count == 5:
            source.world = world()
    assert poses[:5] == poses[5:]
    assert capfd.readouterr().err.count('time went back from 5.000 s to 1.000 s') == 1


def test_while_no_message_comes_poses_are_predicted_as_the_clock_goes_on(
    begin: Callable[..., Scene],
) -> None:
    # Of odometry so poor that it shows beside what 200 particles leave to chance.
    scene = begin(use_sim_time=True, outage_period=2.0, max_wait=0.5, odom_std=100.0)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    clock = scene.probe.talk('/clock', messages.CLOCK, RELIABLE)
    source = Source(scene.probe, world(), ['/veh_0'])
    scene.until(lambda: source.is_heard() and clock.get_subscription_count() == 2, 'listeners')
    for count in (1, 2):
        clock.publish(messages.encode_clock(1000.0 + count))  # the clock of the sensors differs
        source.step()
        scene.until(lambda count=count: len(poses) == count, 'a pose')
    for step in range(10):
        clock.publish(messages.encode_clock(1002.0 + step / 2))
        # Step by step: of poses at once, who comes late gets only the last.
        scene.until(lambda: True, 'a step')
    scene.until(lambda: len(poses) == 4, 'two predictions')
    decoded = [messages.decode_pose(data) for data in poses]
    assert [pose.stamp for pose in decoded] == [1.0, 2.0, 4.0, 6.0]
    spread = [np.trace(pose.covariance[:2, :2]) for pose in decoded]
    assert spread[1] < spread[2] < spread[3]


def test_the_grey_ekf_goes_on_by_itself_when_beacons_stop(begin: Callable[..., Scene]) -> None:
    # Silent scans go on with the stamps of the radio, which hears nothing any more.
    scene = begin(method='grey_ekf', motion_model='velocity', range_std=1.0, max_wait=0.0)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    beacons = scene.probe.talk('beacons', messages.POINT_CLOUD, SENSOR_DATA)
    scene.until(lambda: beacons.get_subscription_count() == 1, 'the localizer to listen')
    corners = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    for stamp in range(1, 21):
        place = np.array([20.0 + 2 * stamp, 30.0])
        scan = Observation.empty(1, 3 if stamp <= 10 else 0, 3, float(stamp))
        if stamp <= 10:
            scan.sender[0], scan.position[0, :, :2] = (1, 2, 3), corners
            scan.range[0] = np.linalg.norm(corners - place, axis=1)
        beacons.publish(messages.encode_beacons(scan, 'map')[0])
        scene.until(lambda stamp=stamp: len(poses) == stamp, 'a pose')
    decoded = [messages.decode_pose(data) for data in poses]
    assert np.linalg.norm(decoded[9].position[:2] - [40.0, 30.0]) < 3
    assert np.linalg.norm(decoded[-1].position[:2] - place) < 15
    spread = [np.trace(pose.covariance[:2, :2]) for pose in decoded[9:]]
    assert (np.diff(spread) > 0).all()


def test_malformed_messages_are_reported_and_the_node_goes_on(
    probe: Any, start: Start,
) -> None:
    localizer = start('nodes.localizer', '--ros-args', '-r', '__ns:=/veh_0',
                      *overrides(**PARAMETERS))
    poses = probe.collect('/veh_0/pose', messages.POSE, LATCHED_INPUT)
    source = Source(probe, world(), ['/veh_0'])
    good, = messages.encode_beacons(source.world.anchors, 'map')
    elsewhere, = messages.encode_beacons(source.world.anchors, 'utm')

    def send_bad() -> None:
        for bad in (b'', b'\0\1\0\0', good[:-40], bytes(len(good)), elsewhere):
            source.beacons[0].publish(bad)
            source.odom[0].publish(bad)

    probe.insist(send_bad, lambda: all(
        f'/veh_0/{topic}: message rejected: ' in localizer.output for topic in ('beacons', 'odom')
    ), 'reports')
    source.step()
    probe.expect(lambda: bool(poses), 'a pose')
    assert localizer.stop(signal.SIGTERM) == 0
    assert 'messages rejected since the last report' in localizer.output
    assert 'Traceback' not in localizer.output


@pytest.mark.parametrize('method', ['mcb', 'r_mcl'])
def test_anchors_and_a_localizer_by_rssi_agree_on_the_path_loss_over_dds(
    begin: Callable[..., Scene], start: Start, capfd: pytest.CaptureFixture[str], method: str,
) -> None:
    radio = {'measure_rssi': True, 'radio_range': 1000.0, 'sigma_db': 2.0}
    start('nodes.anchor', '--ros-args', *overrides(
        anchor_rows=3, anchor_columns=3, seed=2, rssi_at_reference=-55.0, **radio))
    scene = begin(method=method, motion_model='random', max_speed=50.0, **radio)
    told: list[bytes] = []
    scene.probe.listen('/anchor_links', messages.POINT_CLOUD, told.append, LATCHED_INPUT)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    source = Source(scene.probe, make_world(
        {'vehicles': 1, 'area_x': 3000.0, 'area_y': 3000.0, 'anchor_rows': 3,
         'anchor_columns': 3, 'rssi_at_reference': -55.0, **radio},
        np.random.default_rng(2)), ['/veh_0'])
    bad = scene.probe.talk('/anchor_links', messages.POINT_CLOUD, LATCHED)
    bad.publish(b'\0\1\0\0')
    channel = scene.node._localizer
    scene.until(lambda: source.is_heard() and bool(told) and channel.channel.path_loss(
        np.array([0])).reference[0] < -50.0, 'a calibration')
    for count in range(1, 4):
        source.step()
        scene.until(lambda count=count: len(poses) == count, 'a pose')
    mean = messages.decode_pose(poses[-1]).position[:2]
    assert np.linalg.norm(mean - source.world.mobility.state.position[0]) < 300
    error = capfd.readouterr().err
    assert error.count('/anchor_links: message rejected: ') == 1


def cut(source: Path, target: Path, end: float) -> Path:
    """Write the beginning of a CSV log [s]."""
    target.mkdir()
    for path in source.glob('*.csv'):
        with path.open(newline='') as rows, (target / path.name).open('w', newline='') as out:
            reader, writer = csv.reader(rows), csv.writer(out)
            header = next(reader)
            writer.writerow(header)
            writer.writerows(row for row in reader if header[0] != 't' or float(row[0]) < end)
    return target


@pytest.mark.parametrize(('log', 'settings'), [
    ('plaza1', {'motion_model': 'odometry', 'seed': 3}),
    ('ble_straight_01', {'motion_model': 'velocity', 'radio_model': 'lognormal', 'seed': 3}),
])
def test_a_replay_into_a_running_localizer_gives_what_the_bag_gives_in_process(
    starting: Start, probing: Start, shared_data: Path, tmp_path: Path, log: str,
    settings: dict[str, object],
) -> None:
    cut(shared_data / log, tmp_path / 'log', end=60.0)
    assert import_csv.main([str(tmp_path / 'log'), str(tmp_path / 'bag')]) == 0
    localize_bag(str(tmp_path / 'bag'), str(tmp_path / 'offline'), dict(settings))
    with Reader(tmp_path / 'offline') as bag:
        expected = [message.data for message in bag.messages(['/veh_0/pose'])]

    def replay(_: int) -> None:
        with probing() as probe, starting(tmp_path) as start:
            localizer = start('nodes.localizer', '--ros-args', '-r', '__ns:=/veh_0',
                              *overrides(use_sim_time=True, **settings))
            localizer.wait_for('1 vehicles')
            poses = probe.collect('/veh_0/pose', messages.POSE, LATCHED_INPUT)
            player = start('nodes.replay', '--ros-args', *overrides(bag='bag', rate=20.0),
                           '-p', 'wait_for:=["/anchor_map", ".*/beacons"]')
            probe.expect(lambda: player.process.poll() is not None, 'the replay to end')
            probe.spin(lambda: len(poses) == len(expected), ARREARS)
            assert poses == expected
            assert player.wait() == localizer.stop() == 0
        assert 'rejected' not in localizer.output

    calmly(replay)


@pytest.mark.parametrize(('override', 'complaint'), [
    ('method:=magic', f"method: 'magic' is not allowed, must be one of {', '.join(METHODS)}"),
    ('silence:=loud', "silence: 'loud' is not allowed, must be one of none, memory, map"),
    ('particles:=5', "--ros-args: unknown parameter 'particles', did you mean "),
])
@pytest.mark.parametrize('kind', [LocalizerNode, Fleet])
def test_a_parameter_that_is_not_allowed_is_one_line_and_exit_code_1(
    capfd: pytest.CaptureFixture[str], kind: type[Node], override: str, complaint: str,
) -> None:
    assert main(kind, ['test', '--ros-args', '-p', override]) == 1
    error = capfd.readouterr().err
    assert error.startswith(f'{kind.default_name}: {complaint}')
    assert len(error.splitlines()) == 1


@pytest.mark.skipif(find_spec('tf2_ros') is not None, reason='tf2_ros is installed')
def test_tf_without_tf2_ros_is_refused_at_start(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(LocalizerNode, ['test', '--ros-args', '-p', 'tf_broadcast:=true']) == 1
    assert capfd.readouterr().err == (
        'localizer: tf_broadcast: true is not allowed, tf2_ros is not installed\n')
