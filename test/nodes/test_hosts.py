"""A fleet across three hosts that only a router connects, found through a discovery server."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
import json
from pathlib import Path
import sys
from typing import Any

import pytest
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader

sys.path.append(str(Path(__file__).parent))
from hosts import discovery_server, Host, network, Refused  # noqa: E402, I100

Start = Callable[..., Any]

VEHICLES, EPOCHS = 5, 10
ANCHORS = {'anchor_layout': 'list', 'anchor_positions': ['0 0', '400 0', '200 200'],
           'use_sim_time': True}
AREA = {'area_x': 400.0, 'area_y': 200.0, 'radio_range': 1000.0}


def overrides(**settings: object) -> list[str]:
    return ['--ros-args', *(
        word for name, value in settings.items() for word in ('-p', f'{name}:={json.dumps(value)}')
    )]


@pytest.fixture
def hosts(tmp_path: Path) -> Iterator[list[Host]]:
    """Return three hosts: of the anchors, of the vehicles, and of the recorder."""
    try:
        with network(3, tmp_path) as made:
            yield made
    except Refused as refused:
        pytest.skip(f'this machine lets nobody make hosts: {refused}')


def test_a_recorder_hears_every_pose_of_a_fleet_on_another_host(
    hosts: list[Host], start: Start, tmp_path: Path,
) -> None:
    roadside, site, office = hosts
    before = site.sent()
    with discovery_server(roadside) as server:
        recorder = start('nodes.recorder', *overrides(
            output=str(tmp_path / 'bag'), use_sim_time=True), within=office.node(server))
        recorder.wait_for('recording to')
        fleet = start('nodes.fleet', *overrides(
            vehicles=VEHICLES, use_sim_time=True, radio_range=1000.0), within=site.node(server))
        # It goes on when it has heard the poses of an epoch; one more, as it waits for no others.
        simulator = start('nodes.simulator', *overrides(
            vehicles=VEHICLES, duration=EPOCHS + 1, rate=1000, wait_for=2, cooperation=True,
            beacon_timeout=20.0, pose_timeout=20.0, **AREA), within=site.node(server))
        simulator.wait_for('waiting for an /anchor_map')
        anchor = start('nodes.anchor', *overrides(**ANCHORS), within=roadside.node(server))
        anchor.wait_for('3 anchors')
        assert simulator.wait() == 0, simulator.output
        assert [node.stop() for node in (fleet, recorder, anchor)] == [0, 0, 0]

    poses: Counter[str] = Counter()
    with Reader(tmp_path / 'bag') as bag:
        for message in bag.messages():
            if message.topic.endswith('/pose'):
                poses[message.topic] += messages.decode_pose(message.data).stamp <= EPOCHS
    assert poses == {f'/veh_{vehicle}/pose': EPOCHS for vehicle in range(VEHICLES)}
    # Nothing went by a memory that the hosts share: the poses alone have 360 bytes each.
    assert site.sent() - before > 360 * VEHICLES * EPOCHS


def test_without_a_server_nothing_is_found_beyond_the_router(
    hosts: list[Host], start: Start, tmp_path: Path,
) -> None:
    here, there, _ = hosts
    recorder = start('nodes.recorder', *overrides(output=str(tmp_path / 'bag')),
                     within=there.node())
    recorder.wait_for('recording to')
    simulator = start('nodes.simulator', *overrides(
        vehicles=1, duration=3, rate=1000, beacon_timeout=20.0, **AREA), within=here.node())
    simulator.wait_for('waiting for an /anchor_map')
    start('nodes.anchor', *overrides(**ANCHORS), within=here.node()).wait_for('3 anchors')

    assert simulator.wait() == 0, simulator.output
    assert recorder.stop() == 0
    assert 'recorded 0 messages of 0 topics' in recorder.output
