"""Ranges that drivers publish, found by a localizer as their topics appear."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import sys
from typing import Any

import pytest
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.config import load_yaml
from tsmcl_ros.nodes import discovery
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.wire import LATCHED_INPUT, SENSOR_DATA
from tsmcl_ros.scripts.localize_bag import localize_bag

sys.path.append(str(Path(__file__).parent))
from stalls import ARREARS, calmly  # noqa: E402, I100

CONFIG = Path(__file__).parents[2] / 'config' / 'tiers.yaml'
ODOM = 'odom:=/cali/turtle01/odom'
RANGES = {'ranges': [r'uwb/n_(\d+)'], 'anchors': ['5 3 0', '6 0 4']}


def measured(stamp: float, distance: float) -> bytes:
    return messages.encode_range(
        messages.RangeReading(stamp, '', distance, 0.0, 0.0, 0.01))


class Log:
    """What has been logged since the test began."""

    def __init__(self, capfd: pytest.CaptureFixture[str]) -> None:
        self._capfd, self._text = capfd, ''

    def counts(self, lines: list[str]) -> list[int]:
        """Return how often each line was logged."""
        self._text += self._capfd.readouterr().err
        return [self._text.count(line) for line in lines]

    def tells(self, lines: list[str]) -> bool:
        """Tell whether all lines have been logged."""
        return all(self.counts(lines))


def drive(scene: Any, talks: list[tuple[Any, float]], begin: int) -> None:
    """Have ranges to some anchors received for two seconds."""
    for tick in range(begin, begin + 20):
        for talk, distance in talks:
            talk.publish(measured(0.1 * tick, distance))
        scene.until(lambda: True, 'nothing')


@pytest.fixture
def talk(begin: Callable[..., Any]) -> Callable[..., tuple[Any, list[tuple[Any, float]]]]:
    """Return a function that starts a localizer and then drivers, whose topics it has found."""
    def talk_one(**settings: object) -> tuple[Any, list[tuple[Any, float]]]:
        scene = begin(LocalizerNode, **RANGES, **settings)
        talks = [
            (scene.probe.talk(f'/veh_0/uwb/n_{sender}', messages.RANGE, SENSOR_DATA), distance)
            for sender, distance in ((5, 3.0), (6, 4.0), (9, 1.0))]
        scene.until(lambda: all(one.get_subscription_count() for one, _ in talks), 'listeners')
        return scene, talks

    return talk_one


def test_ranges_of_topics_that_appear_later_place_a_vehicle(
    talk: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    scene, talks = talk()
    poses = scene.probe.collect('/veh_0/pose', messages.POSE, LATCHED_INPUT)
    drive(scene, talks, 10)
    lines = [
        ' of id 9, as nobody tells where these are',
        'epochs and poses go by the header stamps']
    log = Log(capfd)
    scene.until(lambda: log.tells(lines) and len(poses) > 5, 'poses and notes')
    assert log.counts(lines) == [1, 1]


def test_what_is_cleaned_up_is_found_again(talk: Callable[..., Any]) -> None:
    scene, talks = talk()
    scene.node.trigger_deactivate()
    scene.node.trigger_cleanup()
    scene.until(lambda: not any(one.get_subscription_count() for one, _ in talks), 'nobody')
    scene.node.trigger_configure()
    scene.node.trigger_activate()
    scene.until(lambda: all(one.get_subscription_count() for one, _ in talks), 'listeners')
    drive(scene, talks, 10)
    assert scene.node.state == 'active'


def test_what_does_not_appear_is_told_once(
    begin: Callable[..., Any], capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(discovery, '_PATIENCE', 0.3)
    scene = begin(LocalizerNode, **RANGES, references=['3 /robot/pose'])
    told = ["ranges: 'uwb/n_(\\d+)' matches no topic of sensor_msgs/msg/Range, of which there is "
            'none; still looking',
            'references: topic /robot/pose of id 3 is not there, must be one of ']
    log = Log(capfd)
    scene.until(lambda: log.tells(told), 'warnings')
    scene.node.spin(timeout=3 * discovery.PERIOD)
    assert log.counts(told) == [1, 1]


def test_the_bag_of_a_driver_replayed_as_it_is_gives_what_it_gives_in_process(
    starting: Callable[..., Any], probing: Callable[..., Any], shared_data: Path, tmp_path: Path,
) -> None:
    """
    Its clock shows 2022-11-28, its header stamps are of 2022-10-11.

    At this rate a second's messages fit into what best effort holds while a machine is busy.
    """
    bag = shared_data / 'tiers_bag'
    settings = load_yaml(CONFIG, 'localizer')
    frame_id = settings.pop('global_frame_id')
    localize_bag(str(bag), str(tmp_path / 'offline'), settings, frame_id=frame_id, remap=[ODOM])
    with Reader(tmp_path / 'offline') as offline:
        expected = [message.data for message in offline.messages(['/pose'])]
    wanted = [*(f'/uwb/tof/{pair}/distance' for pair in ('n_3/n_7', 'n_4/n_7', 'n_7/n_5')),
              *(f'/vrpn_client_node/turtlebot{i}_cap/pose' for i in (3, 4)), '/cali/turtle01/odom']

    def replay(_: int) -> None:
        with probing() as probe, starting(tmp_path) as start:
            localizer = start('nodes.localizer', '--ros-args', '--params-file', CONFIG, '-r', ODOM,
                              '-p', 'use_sim_time:=true')
            poses = probe.collect('/pose', messages.POSE, LATCHED_INPUT)
            probe.expect(lambda: probe.hears(['/pose']), 'the localizer')
            player = start('nodes.replay', '--ros-args', '-p', f'bag:={bag}', '-p', 'rate:=2.0',
                           '-p', 'wait:=60.0', '-p', f'wait_for:={wanted}'.replace("'", '"'))
            probe.expect(lambda: player.process.poll() is not None, 'the replay to end')
            probe.spin(lambda: len(poses) == len(expected), ARREARS)
            assert poses == expected
            assert player.wait() == localizer.stop() == 0
        assert 'rejected' not in localizer.output
        assert player.output.count('is not installed') == 1

    calmly(replay)
