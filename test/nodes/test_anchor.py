from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
from typing import Any

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.runtime import main
from tsmcl_ros.nodes.wire import LATCHED_INPUT, RELIABLE
from tsmcl_ros.world import hear_each_other, make_world

Start = Callable[..., Any]


def test_each_anchor_transmits_its_position_once_a_period_of_the_clock(
    probe: Any, start: Start,
) -> None:
    start('nodes.anchor', '--ros-args', '-p', 'use_sim_time:=true', '-p', 'anchor_layout:=list',
          '-p', "anchor_positions:=['0 5', '10 0 2']", '-p', 'beacon_period:=0.5',
          '-p', 'first_id:=7')
    received = probe.collect('/beacons', messages.POINT_CLOUD)

    def heard() -> list[tuple[float, int]]:
        beacons = [messages.decode_beacons(data)[0] for data in received]
        return [(beacon.stamp, int(beacon.sender[0, 0])) for beacon in beacons]

    clock = probe.talk('/clock', messages.CLOCK, RELIABLE)
    begin = 1.0
    while not received:  # only the anchors know when they have found the probe
        begin += 0.5
        clock.publish(messages.encode_clock(begin))
        probe.spin(lambda: bool(received), 0.2)
    begin += 0.5
    clock.publish(messages.encode_clock(begin))
    probe.expect(lambda: heard()[-1:] == [(begin, 8)], 'the beacons of now')
    received.clear()
    begin += 0.5
    for stamp, count in ((begin, 2), (begin + 0.2, 2), (begin + 0.5, 4)):
        clock.publish(messages.encode_clock(stamp))
        probe.expect(lambda count=count: len(received) == count, f'{count} beacons')
    assert heard() == [(begin, 7), (begin, 8), (begin + 0.5, 7), (begin + 0.5, 8)]
    rows = [messages.decode_beacons(data) for data in received]
    assert [frame for _, frame in rows] == ['map'] * 4
    assert [row.position[0, 0].tolist() for row, _ in rows[:2]] == [[0, 5, 0], [10, 0, 2]]


def test_who_comes_later_gets_the_map_of_the_anchors_that_the_same_seed_gives_in_process(
    probe: Any, start: Start,
) -> None:
    start('nodes.anchor', '--ros-args', '-p', 'seed:=3', '-p', 'anchor_rows:=2').wait_for(
        '8 anchors')
    received = probe.collect('/anchor_map', messages.POINT_CLOUD, LATCHED_INPUT)
    probe.expect(lambda: bool(received), 'the map')
    table, _ = messages.decode_beacons(received[0])
    world = make_world({'anchor_rows': 2}, np.random.default_rng(3))
    assert table.sender.tolist() == world.anchors.sender.tolist()
    np.testing.assert_array_equal(table.position[:, :, :2], world.anchors.position)


def test_anchors_may_stand_in_a_file(probe: Any, start: Start, shared_data: Path) -> None:
    path = shared_data / 'plaza1' / 'anchors.csv'
    start('nodes.anchor', '--ros-args', '-p', f'anchor_file:={path}')
    received = probe.collect('/anchor_map', messages.POINT_CLOUD, LATCHED_INPUT)
    probe.expect(lambda: bool(received), 'the map')
    table, _ = messages.decode_beacons(received[0])
    expected = np.loadtxt(path, delimiter=',', skiprows=1, usecols=range(3))
    expected = expected[np.argsort(expected[:, 0])]
    assert table.sender[0].tolist() == expected[:, 0].tolist()
    np.testing.assert_allclose(table.position[0, :, :2], expected[:, 1:], rtol=1e-6)


def test_anchors_whose_radio_measures_rssi_tell_how_they_hear_each_other(
    probe: Any, start: Start,
) -> None:
    start('nodes.anchor', '--ros-args', '-p', 'anchor_rows:=2', '-p', 'measure_rssi:=true',
          '-p', 'radio_range:=1500.0', '-p', 'seed:=3')
    received = probe.collect('/anchor_links', messages.POINT_CLOUD, LATCHED_INPUT)
    probe.expect(lambda: bool(received), 'the links')
    found, frame_id = messages.decode_links(received[0])
    anchors = make_world({'anchor_rows': 2}, np.random.default_rng(3)).anchors
    expected = hear_each_other(
        Channel(RadioConfig(radio_range=1500.0, measure_rssi=True)), anchors,
        np.random.default_rng(3).spawn(4)[3])
    assert frame_id == 'map'
    assert found.sender.tolist() == expected.sender.tolist()
    np.testing.assert_array_equal(found.rssi, expected.rssi)
    np.testing.assert_array_equal(found.sender_position[:, :2], expected.sender_position)


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_without_a_complaint(start: Start, how: signal.Signals) -> None:
    anchors = start('nodes.anchor')
    anchors.wait_for('16 anchors')
    assert anchors.stop(how) == 0
    assert len(anchors.output.splitlines()) == 1


@pytest.mark.parametrize(('override', 'complaint'), [
    ('anchor_layout:=circle', "anchor_layout: 'circle' is not allowed, must be one of grid, "
                              'uniform, list'),
    ('anchor_layot:=grid', "--ros-args: unknown parameter 'anchor_layot', did you mean "
                           'anchor_layout'),
    ('anchor_file:=nowhere.csv', 'nowhere.csv: '),
    ('measure_rssi:=true', 'radio_range: 0 is not allowed for a simulated disk radio'),
])
def test_a_parameter_that_is_not_allowed_is_one_line_and_exit_code_1(
    capfd: pytest.CaptureFixture[str], override: str, complaint: str,
) -> None:
    assert main(Anchor, ['anchor', '--ros-args', '-p', override]) == 1
    error = capfd.readouterr().err
    assert error.startswith(f'anchor: {complaint}')
    assert len(error.splitlines()) == 1
