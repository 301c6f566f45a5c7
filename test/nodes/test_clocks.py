"""Live nodes among clocks that are wrong, paused, or set: who is told what, and how often."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.wire import LATCHED_INPUT, RELIABLE, SENSOR_DATA
from tsmcl_ros.types import Observation

CORNERS = np.array([[0, 0, 0], [100, 0, 0], [0, 100, 0], [100, 100, 0]], np.float32)
SETTINGS = {'method': 'ekf', 'motion_model': 'velocity', 'range_std': 1.0, 'outage_period': 0.0}


def beacons(stamp: float) -> bytes:
    scan = Observation.empty(1, 4, 3, stamp)
    scan.sender[0] = np.arange(4)
    scan.position[0] = CORNERS
    scan.range[0] = np.linalg.norm(CORNERS - [30, 40, 0], axis=1)
    return messages.encode_beacons(scan, 'map')[0]


class Drivers:
    """Publish beacons of vehicles, and collect their poses."""

    def __init__(self, scene: Any, names: list[str]) -> None:
        self.scene = scene
        self.talks = [scene.probe.talk(f'{name}/beacons', messages.POINT_CLOUD, SENSOR_DATA)
                      for name in names]
        self.poses = [scene.probe.collect(f'{name}/pose', messages.POSE, LATCHED_INPUT)
                      for name in names]
        scene.until(lambda: all(talk.get_subscription_count() for talk in self.talks), 'listeners')

    def say(self, *stamps: float) -> None:
        """Have each vehicle hear its anchors at a stamp of its own [s]."""
        for talk, stamp in zip(self.talks, stamps, strict=True):
            talk.publish(beacons(stamp))
        self.scene.until(lambda: True, 'a round')

    def stamps(self, vehicle: int = 0) -> list[float]:
        return [messages.decode_pose(data).stamp for data in self.poses[vehicle]]


def test_one_wrong_clock_in_a_fleet_is_one_line_and_nobody_elses_matter(
    begin: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    scene = begin(Fleet, vehicles=3, **SETTINGS)
    drivers = Drivers(scene, ['/veh_0', '/veh_1', '/veh_2'])
    for stamp in range(10, 40):
        drivers.say(stamp, stamp + 500, stamp)
    # The last epoch waits for whoever else may have heard something.
    scene.until(lambda: drivers.stamps()[-1:] == [38.0] == drivers.stamps(2)[-1:], 'poses')
    assert drivers.stamps()[-20:] == [float(stamp) for stamp in range(19, 39)]
    lines = capfd.readouterr().err.splitlines()
    assert not [line for line in lines if 'started anew' in line]
    rejected = [line for line in lines if 'rejected' in line]
    assert 1 <= len(rejected) <= 3  # at most one in five seconds a topic
    assert all('veh_1' in line for line in rejected)


def test_a_clock_that_is_set_is_one_line_and_localization_goes_on(
    begin: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    scene = begin(LocalizerNode, **SETTINGS)
    drivers = Drivers(scene, ['/veh_0'])
    for stamp in (*range(1, 5), *(1_700_000_000 + second for second in range(5)), *range(1, 5)):
        drivers.say(stamp)
    scene.until(lambda: drivers.stamps()[-1:] == [4.0], 'poses of the third time')
    text = capfd.readouterr().err
    assert text.count('time leapt from 4.000 s to 1700000000.000 s: started anew') == 1
    assert text.count('time went back from 1700000004.000 s to 1.000 s: started anew') == 1
    assert text.count('started anew') == 2
    assert text.count(']: OK: ') == 1
    assert 'rejected' not in text


def test_a_clock_that_is_paused_and_goes_on_is_no_line_at_all(
    begin: Callable[..., Any], capfd: pytest.CaptureFixture[str],
) -> None:
    scene = begin(LocalizerNode, use_sim_time=True, **SETTINGS)
    clock = scene.probe.talk('/clock', messages.CLOCK, RELIABLE)
    drivers = Drivers(scene, ['/veh_0'])
    scene.until(lambda: clock.get_subscription_count() >= 1, 'who follows the clock')
    for stamp in range(1, 6):
        clock.publish(messages.encode_clock(float(stamp)))
        drivers.say(stamp)
    for _ in range(20):
        clock.publish(messages.encode_clock(5.0))
        scene.until(lambda: True, 'a pause')
    for stamp in range(6, 9):
        clock.publish(messages.encode_clock(float(stamp)))
        drivers.say(stamp)
    scene.until(lambda: drivers.stamps()[-1:] == [8.0], 'poses after the pause')
    assert drivers.stamps()[-8:] == [float(stamp) for stamp in range(1, 9)]
    text = capfd.readouterr().err
    assert 'rejected' not in text
    assert 'started anew' not in text
