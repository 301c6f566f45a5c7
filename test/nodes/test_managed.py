"""The life cycle of the localizer and the fleet, asked for as Nav2's lifecycle manager does."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import count
import os
from pathlib import Path
import signal
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
import numpy as np
import pytest
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from std_srvs.srv import Empty
from tsmcl_ros import messages
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.managed import ManagedNode
from tsmcl_ros.nodes.runtime import main
from tsmcl_ros.nodes.wire import LATCHED, LATCHED_INPUT, RELIABLE, SENSOR_DATA
from tsmcl_ros.types import ConfigError, Observation
from visualization_msgs.msg import MarkerArray
import yaml

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = (
    Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP,
    Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE)


class Manager:
    """Asks a node for transitions, by its services."""

    def __init__(self, probe: Any, name: str, wait: Callable[..., None]) -> None:
        self.wait = wait
        self.clients = {
            kind: probe.create_client(kind, f'{name}/{service}') for kind, service in
            ((ChangeState, 'change_state'), (GetState, 'get_state'),
             (SetParameters, 'set_parameters'))}
        wait(lambda: all(client.service_is_ready() for client in self.clients.values()),
             'the services')

    def call(self, request: Any, kind: type[Any]) -> Any:
        answer = self.clients[kind].call_async(request)
        self.wait(answer.done, 'an answer')
        return answer.result()

    def change(self, *transitions: int) -> bool:
        """Ask for transitions, and return whether all of them succeeded."""
        return all(
            self.call(ChangeState.Request(transition=Transition(id=transition)),
                      ChangeState).success
            for transition in transitions)

    @property
    def state(self) -> str:
        return str(self.call(GetState.Request(), GetState).current_state.label)

    def set(self, name: str, value: object) -> str:
        """Set a parameter, and return why that failed, '' if it did not."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()])
        return str(self.call(request, SetParameters).results[0].reason)


class Anchors:
    """Three anchors, latched in a map, and a vehicle that hears them at 20 m of ranges."""

    def __init__(self, probe: Any, name: str = '') -> None:
        self.table = Observation.empty(1, 3, 3, 0.0)
        self.table.sender[0] = 1, 2, 3
        self.table.position[0, :, :2] = [0.0, 0.0], [30.0, 0.0], [0.0, 30.0]
        self.map = probe.talk('/anchor_map', messages.POINT_CLOUD, LATCHED)
        self.map.publish(messages.encode_beacons(self.table, 'map')[0])
        self.beacons = probe.talk(f'{name}/beacons', messages.POINT_CLOUD, SENSOR_DATA)

    def are_heard(self) -> bool:
        return bool(self.beacons.get_subscription_count())

    def step(self, stamp: float) -> bytes:
        """Let the vehicle hear all of them, and return its message."""
        scan = Observation.empty(1, 3, 3, stamp)
        scan.sender[:], scan.position[:] = self.table.sender, self.table.position
        scan.range[0] = np.linalg.norm(scan.position[0, :, :2] - [10.0, 12.0], axis=1)
        data, = messages.encode_beacons(scan, 'map')
        self.beacons.publish(data)
        return data


@pytest.fixture
def managed(begin: Callable[..., Any]) -> Callable[..., tuple[Any, Manager, Anchors]]:
    """Start a localizer node that waits for transitions, unless told otherwise."""
    def begin_one(kind: type[ManagedNode] = LocalizerNode, **settings: object) -> Any:
        scene = begin(kind, autostart=False, max_wait=0.0, motion_model='velocity', **settings)
        return scene, Manager(scene.probe, kind.default_name, scene.until), Anchors(
            scene.probe, '/veh_0')
    return begin_one


def test_by_default_a_node_becomes_active_by_itself(begin: Callable[..., Any]) -> None:
    scene = begin(Fleet, vehicles=1)
    assert Manager(scene.probe, 'fleet', scene.until).state == 'active'


def test_a_node_talks_and_listens_while_it_is_active_only_and_keeps_its_belief(
    managed: Callable[..., Any],
) -> None:
    scene, manager, anchors = managed(stale_after=1000.0, outage_period=0.0)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    again = scene.probe.create_client(Empty, 'request_nomotion_update')
    assert manager.state == 'unconfigured'
    assert not scene.probe.count_publishers('/veh_0/pose')
    assert manager.change(CONFIGURE)
    assert manager.state == 'inactive'
    scene.until(lambda: anchors.are_heard() and again.service_is_ready(), 'the localizer')

    def nudge() -> None:
        answer = again.call_async(Empty.Request())
        scene.until(answer.done, 'an answer')  # what was sent before is handled by then

    anchors.step(1.0)
    nudge()
    assert manager.change(ACTIVATE)
    for stamp in (2.0, 3.0):
        anchors.step(stamp)
        scene.until(lambda stamp=stamp: len(poses) == stamp - 1, 'a pose')
    assert manager.change(DEACTIVATE)
    anchors.step(4.0)
    nudge()
    assert manager.change(ACTIVATE)
    nudge()
    scene.until(lambda: len(poses) == 3, 'the last pose')
    assert [messages.decode_pose(data).stamp for data in poses] == [2.0, 3.0, 3.0]


def test_after_cleanup_parameters_can_be_set_and_latched_maps_come_again(
    managed: Callable[..., Any],
) -> None:
    scene, manager, anchors = managed(marker_period=0.1)
    told = scene.probe.collect('markers', 'visualization_msgs/msg/MarkerArray', LATCHED_INPUT)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    assert manager.change(CONFIGURE, ACTIVATE)
    for state, transition in (('active', DEACTIVATE), ('inactive', CLEANUP)):
        assert manager.set('dimension', 3) == (
            f'dimension cannot change while the node is {state}: set it after cleanup and before '
            'configure, or restart the node with it')
        assert manager.change(transition)
    scene.until(lambda: not scene.probe.count_publishers('/veh_0/pose'), 'the end of poses')
    assert manager.set('dimension', 4).startswith('dimension: 4 is not allowed')
    assert manager.set('dimension', 3) == ''
    assert manager.change(CONFIGURE, ACTIVATE)
    scene.until(anchors.are_heard, 'the localizer')
    stamps = count(1.0)

    def shown() -> int:
        anchors.step(next(stamps))
        return sum(marker.ns == 'anchors' for data in told
                   for marker in deserialize_message(data, MarkerArray).markers)

    scene.until(lambda: shown() > 0, 'the map')
    assert messages.decode_pose(poses[0]).covariance[2, 2] < 1e4  # a height is estimated


def test_what_is_told_once_counts_from_when_a_node_is_configured(
    managed: Callable[..., Any],
) -> None:
    scene, manager, anchors = managed()
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    initial = scene.probe.talk('initialpose', messages.POSE, RELIABLE)
    assert manager.change(CONFIGURE)
    scene.until(lambda: anchors.are_heard() and initial.get_subscription_count() > 0, 'listeners')
    initial.publish(messages.encode_pose(
        0.0, 'map', np.array([500.0, 0.0]), np.eye(2), 0.0, 0.1))
    scene.until(initial.wait_for_all_acked, 'the initial pose to arrive')
    assert manager.change(ACTIVATE)
    silent = Observation.empty(1, 0, 3, 1.0)
    anchors.beacons.publish(messages.encode_beacons(silent, 'map')[0])
    scene.until(lambda: bool(poses), 'a pose')
    assert abs(messages.decode_pose(poses[0]).position[0] - 500.0) < 5.0


def test_a_configuration_that_is_not_allowed_fails_the_transition_and_can_be_mended(
    managed: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    scene, manager, _ = managed(tf_broadcast=True, method='ekf', notice_turns=True)
    manager.set('motion_model', 'random')
    assert not manager.change(CONFIGURE)
    assert manager.state == 'unconfigured'
    error = capfd.readouterr().err
    assert [line for line in error.splitlines() if '[ERROR]' in line] == [
        next(line for line in error.splitlines() if 'notice_turns' in line)]
    assert manager.set('tf_broadcast', False) == manager.set('notice_turns', False) == ''
    assert manager.change(CONFIGURE, ACTIVATE)


def test_a_transition_that_the_state_does_not_know_fails_and_the_node_goes_on(
    managed: Callable[..., Any],
) -> None:
    _, manager, _ = managed()
    assert not manager.change(ACTIVATE)
    assert not manager.change(99)
    assert manager.state == 'unconfigured'


def test_an_error_in_the_code_is_logged_and_leads_back_to_unconfigured(
    managed: Callable[..., Any], capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, manager, _ = managed()
    monkeypatch.setattr(scene.node, 'set_up', lambda: 1 / 0)
    assert not manager.change(CONFIGURE)
    assert manager.state == 'unconfigured'
    assert 'ZeroDivisionError' in capfd.readouterr().err


def test_live_parameters_hold_at_once_for_the_localizer_and_for_what_is_published(
    managed: Callable[..., Any],
) -> None:
    scene, manager, anchors = managed(cloud_period=0.0, range_std=50.0)
    poses = scene.probe.collect('pose', messages.POSE, LATCHED_INPUT)
    clouds = scene.probe.collect('particle_cloud', messages.POSE_ARRAY)
    assert manager.change(CONFIGURE, ACTIVATE)
    scene.until(anchors.are_heard, 'the localizer')
    assert manager.set('range_std', 0.0).startswith('range_std: 0.0 is not allowed')
    assert manager.set('cloud_period', 0.1) == ''
    scene.until(lambda: scene.probe.count_publishers('/veh_0/particle_cloud') > 0, 'a publisher')
    local = Localizer({'max_wait': 0.0, 'motion_model': 'velocity', 'range_std': 50.0})
    endpoint, expected = Endpoint(local, ['']), []
    for stamp in (1.0, 2.0, 3.0):
        endpoint.inputs['beacons'][1](anchors.step(stamp))
        expected += [data for estimate in local.due() for _, data in endpoint.poses(estimate)]
        scene.until(lambda stamp=stamp: len(poses) == stamp, 'a pose')
        assert manager.set('range_std', 1.0) == ''
        local.reconfigure({'range_std': 1.0})
    assert poses == expected
    scene.until(lambda: bool(clouds), 'a cloud')
    assert manager.change(DEACTIVATE, CLEANUP)
    assert not scene.probe.count_publishers('/veh_0/particle_cloud')


@pytest.mark.parametrize('settings', [(), ('-p', 'method:=ekf', '-p', 'notice_turns:=true',
                                          '-p', 'motion_model:=random')])
def test_of_a_node_that_is_closed_or_never_came_about_nothing_stays_on_the_network(
    ros: Callable[..., None], probe_class: Any, settings: tuple[str, ...],
) -> None:
    ros(*settings)
    with suppress(ConfigError):
        node = LocalizerNode()
        assert not settings
        node.close()
    rclpy.try_shutdown()
    ros()
    probe = probe_class()
    probe.spin(lambda: bool(probe.count_publishers('/localizer/transition_event')), 0.5)
    assert not probe.count_publishers('/localizer/transition_event')
    probe.close()


class Signalled(LocalizerNode):
    """Gets a signal in some state."""

    number = signal.SIGINT
    path: tuple[str, ...] = ()

    def run(self) -> None:
        for transition in self.path:
            getattr(self, f'trigger_{transition}')()
        os.kill(os.getpid(), self.number)
        super().run()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('path', [
    (), ('configure',), ('configure', 'activate'), ('configure', 'activate', 'deactivate'),
    ('configure', 'cleanup'), ('shutdown',),
])
def test_a_signal_ends_a_node_in_any_state_with_exit_code_0(
    number: signal.Signals, path: tuple[str, ...], monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Signalled, 'number', number)
    monkeypatch.setattr(Signalled, 'path', path)
    assert main(Signalled, ['test', '--ros-args', '-p', 'autostart:=false']) == 0
    assert 'Traceback' not in capfd.readouterr().err


def test_shutting_down_ends_the_process_with_exit_code_0_after_an_answer(
    probe: Any, start: Callable[..., Any],
) -> None:
    fleet = start('nodes.fleet', '--ros-args', '-r', '__ns:=/cars', '-p', 'vehicles:=2')
    manager = Manager(probe, '/cars/fleet', probe.expect)
    assert manager.state == 'active'
    assert manager.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert fleet.wait() == 0
    assert 'Traceback' not in fleet.output


def test_names_namespaces_remaps_and_sections_of_parameter_files_are_ros_own(
    ros: Callable[..., None], tmp_path: Path,
) -> None:
    path = tmp_path / 'cars.yaml'
    path.write_text(yaml.safe_dump({
        '/**': {'ros__parameters': {'seed': 1, 'max_wait': 0.1}},
        '/cars/one/where': {'ros__parameters': {'seed': 2, 'initial_pose': {'x': 5.0}}},
        '/cars/two/where': {'ros__parameters': {'seed': 3}},
    }))
    ros('-r', '__ns:=/cars/one', '-r', '__node:=where', '-r', 'beacons:=uwb/scan',
        '-r', '/anchor_map:=/site/anchors', '-r', 'pose:=/fused/pose',
        '-r', 'reinitialize_global_localization:=anew', '--params-file', str(path))
    node = LocalizerNode()
    assert node.get_fully_qualified_name() == '/cars/one/where'
    assert (node.settings['seed'], node.settings['max_wait']) == (2, 0.1)
    assert node.settings['initial_pose.x'] == 5.0
    assert {'/cars/one/uwb/scan', '/cars/one/odom', '/site/anchors'} <= {
        subscription.topic_name for subscription in node.subscriptions}
    assert {'/fused/pose', '/cars/one/particle_cloud', '/diagnostics'} <= {
        publisher.topic_name for publisher in node.publishers}
    assert {'/cars/one/anew', '/cars/one/where/change_state'} <= {
        service.service_name for service in node.services}
    node.close()
