"""The adaptive beacon period from end to end: an EKF in space asks, the simulated air heeds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
from typing import Any

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.config import Config, load_yaml, parameters
from tsmcl_ros.localizer import CONFIGS
from tsmcl_ros.model.period import AirCost
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.simulator import Simulator
from tsmcl_ros.nodes.wire import LATCHED, LATCHED_INPUT
import yaml

Start = Callable[..., Any]
SCENARIO = Path(__file__).parents[2] / 'config' / 'underwater.yaml'


def given(file: Path, node: str, configs: tuple[type[Config], ...], **settings: object
          ) -> list[str]:
    """Return the command line that hands a node what it has parameters for."""
    known = {item.name for config in configs for item in parameters(config)} | {'use_sim_time'}
    values = {name: value for name, value in {**load_yaml(SCENARIO, node), **settings}.items()
              if name in known}
    file.write_text(yaml.safe_dump({'/**': {'ros__parameters': values}}))
    return ['--ros-args', '--params-file', str(file)]


def test_vehicles_in_space_get_beacons_as_often_as_they_ask(
    probe: Any, start: Start, tmp_path: Path,
) -> None:
    poses = probe.collect('/veh_0/pose', messages.POSE, LATCHED_INPUT)
    factors = probe.collect('/veh_0/beacon_period', messages.UINT32, LATCHED_INPUT)
    scans = {i: probe.collect(f'/veh_{i}/beacons', messages.POINT_CLOUD) for i in range(2)}
    odometry = [probe.collect(f'/veh_{i}/odom', messages.ODOMETRY) for i in range(2)]
    # With the localizer there are two who listen to each vehicle, for whom the simulation waits.
    for topic, kind in (('beacons', messages.POINT_CLOUD), ('odom', messages.ODOMETRY)):
        probe.collect(f'/veh_1/{topic}', kind)
    truths = probe.collect('/veh_0/ground_truth', messages.ODOMETRY)
    bad = probe.talk('/veh_1/beacon_period', messages.UINT32, LATCHED)
    bad.publish(messages.encode_period(0))
    start('nodes.anchor', *given(
        tmp_path / 'a.yaml', 'anchor', Anchor.configs, use_sim_time=True))
    start('nodes.localizer', *given(
        tmp_path / 'l.yaml', 'localizer', CONFIGS, use_sim_time=True), '-r', '__ns:=/veh_0')
    probe.expect(lambda: probe.hears(['/veh_0/pose']), 'the localizer')
    epochs = 40
    assert not any(odometry)
    simulator = start('nodes.simulator', *given(
        tmp_path / 's.yaml', 'simulator', Simulator.configs, vehicles=2, duration=float(epochs),
        rate=10.0, beacon_timeout=20.0, wait_for=2))
    probe.expect(lambda: simulator.process.poll() is not None, 'the simulation to end')
    assert simulator.wait() == 0
    # Who is found late misses the first ones.
    probe.expect(lambda: min(map(len, (*scans.values(), truths, poses))) >= epochs - 5,
                 'the messages of most periods')

    heard = {i: np.array([messages.decode_beacons(data)[0].sender.size for data in found])
             for i, found in scans.items()}
    assert (heard[1] == 10).all()  # nobody has asked for less there, but by a bad message
    assert 'period factor 0 is not allowed' in simulator.output
    wanted = [messages.decode_period(data) for data in factors]
    assert wanted[0] == 1
    assert 1 < max(wanted) <= 15
    assert set(heard[0].tolist()) == {0, 10}
    # How soon a wish arrives is DDS' business; that it is honoured is ours.
    assert (heard[0] == 0).sum() > epochs / 10
    told = re.search(r'were (\d+) localization messages and (\d+) period messages, (\d+) bits',
                     simulator.output)
    assert told is not None
    localizations, requests, bits = map(int, told.groups())
    assert heard[0].sum() + heard[1].sum() <= localizations < 20 * epochs * 0.97
    assert 0 < requests <= len(factors)
    cost = AirCost(2, 10, max(wanted))
    assert bits == localizations * cost.localization_bits + requests * cost.period_bits

    found = {pose.stamp: pose for pose in map(messages.decode_pose, poses)}
    errors = [np.linalg.norm(found[truth.stamp].position - truth.position)
              for truth in map(messages.decode_odometry, truths) if truth.stamp in found]
    assert len(errors) > epochs / 2
    assert np.mean(errors) < 6.0
