from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
import os
from pathlib import Path
import signal
import sys
from typing import Any

import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
import rclpy.node
from tsmcl_ros import messages
from tsmcl_ros.config import Config, param, Parameter, parameters
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.recorder import Recorder
from tsmcl_ros.nodes.rejections import Rejections
from tsmcl_ros.nodes.replay import Replay
from tsmcl_ros.nodes.runtime import main, Node
from tsmcl_ros.nodes.simulator import Simulator
from tsmcl_ros.nodes.wire import RELIABLE, SENSOR_DATA
from tsmcl_ros.types import ConfigError, MessageError

sys.path.append(str(Path(__file__).parent))
from stalls import calmly  # noqa: E402, I100

Ros = Callable[..., None]


class Watch(Node):
    """Tells each half second of /clock."""

    default_name = 'watch'

    def __init__(self) -> None:
        super().__init__()
        self.struck: list[float] = []
        self.every(0.5, self.struck.append)


def test_serialized_messages_arrive_as_they_were_sent(probe: Any) -> None:
    received = probe.collect('talk', messages.POSE_ARRAY)
    talk = probe.talk('talk', messages.POSE_ARRAY, SENSOR_DATA)
    probe.expect(lambda: talk.get_subscription_count() > 0, 'the subscription')
    data = messages.encode_clock(1.0) + b'\1\0\0\0\0\0\0\0\0\0\0\0'
    talk.publish(data)
    probe.expect(lambda: bool(received), 'the message')
    assert received == [data]


def test_a_request_that_rclpy_would_die_of_is_reported_and_answered(
    begin: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    scene = begin(Watch)
    client = scene.probe.create_client(SetParameters, 'watch/set_parameters')
    scene.until(client.service_is_ready, 'the service')
    value = ParameterValue(type=99)
    answer = client.call_async(SetParameters.Request(
        parameters=[ParameterMessage(name='use_sim_time', value=value)]))
    scene.until(answer.done, 'an answer')
    assert not answer.result().results
    assert '/veh_0/watch/set_parameters: request rejected: 99 is not' in capfd.readouterr().err


def test_a_rejected_message_is_reported_and_the_next_one_is_heeded(probe: Any) -> None:
    heeded: list[bytes] = []

    def heed(data: bytes) -> None:
        if data.endswith(b'bad '):
            raise MessageError('is bad')
        heeded.append(data)

    reports: list[str] = []
    probe._rejections = Rejections(reports.append)
    probe.listen('talk', messages.CLOCK, heed, RELIABLE)
    talk = probe.talk('talk', messages.CLOCK, RELIABLE)
    probe.expect(lambda: talk.get_subscription_count() > 0, 'the subscription')
    for data in (b'\0\1\0\0bad bad ', b'\0\1\0\0goodgood'):
        talk.publish(data)
    probe.expect(lambda: bool(heeded), 'the good message')
    assert heeded == [b'\0\1\0\0goodgood']
    assert reports == ['/talk: message rejected: is bad']


def test_with_sim_time_each_multiple_of_a_period_is_met_once_with_its_exact_stamp(
    ros: Ros,
) -> None:
    ros('-p', 'use_sim_time:=true')
    watch = Watch()
    clock = watch.talk('/clock', messages.CLOCK, RELIABLE)
    watch.spin(lambda: clock.get_subscription_count() > 1, 30)
    # Begun between two multiples, one shown twice, one jumped over, and time that goes back.
    for stamp in (0.2, 0.5, 0.5, 0.9, 1.0, 2.1, 0.5):
        clock.publish(messages.encode_clock(stamp))
        assert watch.spin(lambda stamp=stamp: watch.now == stamp, 30)
    assert watch.struck == [0.5, 1.0, 2.0, 0.5]
    watch.close()


def test_without_sim_time_multiples_of_a_period_are_met_by_the_wall_clock(ros: Ros) -> None:
    ros()

    def keep_watch(_: int) -> None:
        with closing(Watch()) as watch:
            assert watch.spin(lambda: len(watch.struck) == 2, 30)
            assert [stamp % 0.5 for stamp in watch.struck] == [0.0, 0.0]
            assert watch.struck[1] - watch.struck[0] == 0.5
            assert abs(watch.now - watch.struck[1]) < 0.5

    calmly(keep_watch)


def test_spinning_ends_after_its_timeout_and_says_that_the_condition_never_held(
    probe: Any,
) -> None:
    assert probe.spin(lambda: False, 0.01) is False
    assert probe.spin(lambda: True, 0.0) is True


class Signalled(Node):
    """Gets a signal as soon as it runs."""

    default_name = 'signalled'
    number = signal.SIGINT
    closed = False

    def run(self) -> None:
        os.kill(os.getpid(), self.number)
        self.spin()

    def close(self) -> None:
        type(self).closed = True
        super().close()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_with_exit_code_0_after_it_was_closed(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Signalled, 'number', number)
    monkeypatch.setattr(Signalled, 'closed', False)
    assert main(Signalled, ['signalled']) == 0
    assert Signalled.closed
    assert capfd.readouterr() == ('', '')


class Broken(Node):
    """Finds that what it was told cannot be."""

    default_name = 'broken'

    def run(self) -> None:
        raise ConfigError('output: is missing')


def test_an_error_that_the_user_can_mend_is_one_line_and_exit_code_1(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert main(Broken, ['broken']) == 1
    assert capfd.readouterr() == ('', 'broken: output: is missing\n')


def test_a_parameter_file_that_is_missing_is_exit_code_1(
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert main(Broken, ['broken', '--ros-args', '--params-file', 'missing.yaml']) == 1
    assert "broken: Couldn't parse params file: '--params-file missing.yaml'" in (
        capfd.readouterr().err
    )


@pytest.mark.parametrize('arguments', [['--speed', '1'], ['--ros-args', '-p', 'nonsense']])
def test_a_command_line_that_makes_no_sense_is_exit_code_2(arguments: list[str]) -> None:
    try:
        code = main(Broken, ['broken', *arguments])
    except SystemExit as end:
        code = end.code
    assert code == 2


@dataclass(frozen=True)
class DiverConfig(Config):
    """Parameters of a test."""

    depth: float = param(3.0, 'how deep', unit='m', low=1)


class Diver(Broken):
    """Dives."""

    default_name = 'diver'
    configs = (DiverConfig,)


def test_help_lists_the_parameters(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(Diver, ['diver', '--help'])
    assert end.value.code == 0
    shown = capfd.readouterr().out
    assert 'Dives.' in shown
    assert 'depth: how deep [m]; a number at least 1 m (default: 3.0)' in shown


@pytest.mark.parametrize('kind', [Anchor, Simulator, LocalizerNode, Fleet])
def test_nodes_leave_the_attributes_of_rclpys_nodes_alone(ros: Ros, kind: type[Node]) -> None:
    ros()
    plain, node = rclpy.node.Node('plain'), kind()
    for name, value in vars(plain).items():
        assert value is None or type(getattr(node, name)) is type(value), name
    node.close()


@pytest.mark.parametrize('kind', [Anchor, Simulator, LocalizerNode, Fleet, Recorder, Replay])
def test_parameters_that_share_a_name_are_the_same(kind: type[Node]) -> None:
    known: dict[str, Parameter] = {}
    for config in kind.configs:
        for item in parameters(config):
            assert known.setdefault(item.name, item) == item
