from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
import signal
from typing import Any

from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from tsmcl_ros import messages
from tsmcl_ros.nodes.runtime import main
from tsmcl_ros.nodes.simulator import Air, Simulator
from tsmcl_ros.nodes.wire import LATCHED, SENSOR_DATA
from tsmcl_ros.types import MessageError, Observation
from tsmcl_ros.world import anchor_table, make_world

Start = Callable[..., Any]
SMALL = {'vehicles': 3, 'anchor_rows': 2, 'anchor_columns': 2, 'area_x': 2000.0, 'area_y': 2000.0,
         'radio_range': 900.0, 'measure_range': True, 'drop_rate': 0.1, 'beacon_period': 0.3}
ANCHORS = ('anchor_rows', 'anchor_columns', 'beacon_period')
EPOCHS = 20


def overrides(**settings: object) -> list[str]:
    return ['--ros-args', *(
        word for name, value in settings.items()
        for word in ('-p', f'{name}:={str(value).lower()}')
    )]


def collect(probe: Any, vehicles: int) -> dict[str, list[bytes]]:
    """Return lists that fill with what the simulator says of each vehicle."""
    return {
        topic: probe.collect(topic, kind)
        for i in range(vehicles)
        for topic, kind in ((f'/veh_{i}/ground_truth', messages.ODOMETRY),
                            (f'/veh_{i}/beacons', messages.POINT_CLOUD),
                            (f'/veh_{i}/odom', messages.ODOMETRY))
    }


def simulate(probe: Any, start: Start, rate: float) -> dict[str, list[bytes]]:
    """Return what anchors and a simulator with the small world's settings give over DDS."""
    received = collect(probe, SMALL['vehicles'])
    listeners = probe.count_subscribers('/veh_0/odom')
    # A busy machine is no dead anchor.
    anchors = play(probe, start, received, overrides(
        seed=5, beacon_timeout=20.0, wait_for=listeners, rate=rate,
        duration=EPOCHS * SMALL['beacon_period'],
        **{name: value for name, value in SMALL.items() if name not in ANCHORS[:2]},
    ), overrides(use_sim_time=True, seed=5, **{name: SMALL[name] for name in ANCHORS}))
    probe.expect(lambda: all(len(found) == EPOCHS for found in received.values()),
                 f'{EPOCHS} messages on each topic')
    assert anchors.stop() == 0
    return received


@pytest.fixture(scope='module')
def simulated(
    probing: Callable[..., Any], starting: Callable[..., Any],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, list[bytes]]:
    """Return what a simulation as fast as can be gives over DDS."""
    with probing() as probe, starting(tmp_path_factory.mktemp('simulated')) as start:
        return simulate(probe, start, rate=1000)


def play(probe: Any, start: Start, topics: Iterable[str], simulation: list[str],
         anchors: list[str]) -> Any:
    """
    Run a simulation with some arguments to its end, and return the anchors' process.

    It waits for anchors, so that we have found its topics too before it says anything there: what
    it knows of us tells it nothing of that.
    """
    probe.expect(lambda: not any(map(probe.count_publishers, topics)),
                 'any earlier simulation to be forgotten')
    simulator = start('nodes.simulator', *simulation)
    probe.expect(lambda: probe.hears(topics), "the simulator's topics")
    process = start('nodes.anchor', *anchors)
    probe.expect(lambda: simulator.process.poll() is not None, 'the simulation to end')
    assert simulator.wait() == 0
    return process


def test_vehicles_move_and_hear_as_in_process_for_the_same_seed(
    simulated: dict[str, list[bytes]],
) -> None:
    world = make_world(SMALL, np.random.default_rng(5))
    for k in range(EPOCHS):
        epoch = world.step()
        assert epoch.stamp == (k + 1) * SMALL['beacon_period']
        for i in range(SMALL['vehicles']):
            truth = messages.decode_odometry(simulated[f'/veh_{i}/ground_truth'][k])
            odometry = messages.decode_odometry(simulated[f'/veh_{i}/odom'][k])
            scan, frame = messages.decode_beacons(simulated[f'/veh_{i}/beacons'][k])
            expected = epoch.observation.vehicle(i)
            assert frame == 'map'
            for part in (truth, odometry, scan):
                assert part.stamp == pytest.approx(epoch.stamp, abs=1e-9)
            np.testing.assert_array_equal(truth.position[:2], epoch.position[i])
            np.testing.assert_array_equal(odometry.position[:2], epoch.odom_position[i])
            np.testing.assert_allclose([truth.yaw, odometry.yaw],
                                       [epoch.yaw[i], epoch.odom_yaw[i]], atol=1e-9)
            np.testing.assert_array_equal(scan.sender, expected.sender)
            np.testing.assert_array_equal(scan.position[..., :2], expected.position)
            np.testing.assert_array_equal(scan.range, expected.range)


def test_a_simulation_is_the_same_at_another_rate(
    simulated: dict[str, list[bytes]], probe: Any, start: Start,
) -> None:
    assert simulate(probe, start, rate=10) == simulated


def test_ground_truth_tells_the_velocity_ahead(simulated: dict[str, list[bytes]]) -> None:
    message = deserialize_message(simulated['/veh_0/ground_truth'][0], Odometry)
    world = make_world(SMALL, np.random.default_rng(5))
    velocity = world.step().velocity[0]
    assert message.twist.twist.linear.x == pytest.approx(np.linalg.norm(velocity), rel=1e-6)
    assert message.twist.twist.linear.y == pytest.approx(0, abs=1e-6)
    assert (message.header.frame_id, message.child_frame_id) == ('map', 'veh_0/base_link')


def test_an_anchor_that_is_silent_is_reported_once_and_costs_one_wait(
    probe: Any, start: Start,
) -> None:
    anchors = anchor_table(np.array([[100.0, 100.0], [300.0, 100.0]]))
    received = collect(probe, 1)
    anchor_map = probe.talk('/anchor_map', messages.POINT_CLOUD, LATCHED)
    anchor_map.publish(messages.encode_beacons(anchors, 'map')[0])
    air = probe.talk('/beacons', messages.POINT_CLOUD, SENSOR_DATA)

    stamps: set[float] = set()

    def transmit(data: bytes) -> None:
        stamp = messages.decode_clock(data)
        if stamp in stamps:
            return
        stamps.add(stamp)
        beacon = Observation.empty(1, 1, 2, stamp)
        beacon.sender[0, 0], beacon.position[0, 0] = 1, anchors.position[0, 1]
        air.publish(messages.encode_beacons(beacon, 'map')[0])

    probe.listen('/clock', messages.CLOCK, transmit, SENSOR_DATA)
    simulator = start('nodes.simulator', *overrides(
        vehicles=1, area_x=400.0, area_y=200.0, duration=5, rate=100, wait_for=1,
        beacon_timeout=4.0))
    probe.expect(lambda: simulator.process.poll() is not None, 'the simulation to end')
    assert simulator.wait() == 0
    probe.expect(lambda: len(received['/veh_0/beacons']) == 5, 'five scans')
    assert simulator.output.count('anchors 0 did not transmit at 1 s') == 1
    assert simulator.output.count('did not transmit') == 1
    scans = [messages.decode_beacons(data)[0] for data in received['/veh_0/beacons']]
    assert [scan.sender.tolist() for scan in scans] == [[[1]]] * 5


def test_malformed_beacons_are_reported_and_the_simulation_goes_on(
    probe: Any, start: Start,
) -> None:
    simulator = start('nodes.simulator', *overrides(vehicles=1))
    air = probe.talk('/beacons', messages.POINT_CLOUD, SENSOR_DATA)
    probe.insist(lambda: air.publish(b'\0\1\0\0broken'),
                 lambda: '/beacons: message rejected: ' in simulator.output, 'a report')
    assert '[ERROR]' in simulator.output
    assert simulator.stop(signal.SIGTERM) == 0


def test_cars_of_a_sumo_trace_drive_as_recorded(
    probe: Any, start: Start, shared_data: Path,
) -> None:
    from tsmcl_ros.traces.fcd import read_fcd

    path = shared_data / 'sumo_grid40' / 'fcd40.xml.gz'
    received = collect(probe, 40)
    play(probe, start, received, overrides(
        mobility='fcd', trace=path, vehicles=40, duration=3, rate=100, wait_for=1),
        overrides(use_sim_time=True))
    trace = read_fcd(path, 40, 40.0)
    for i in range(40):
        topic = f'/veh_{i}/ground_truth'
        probe.expect(lambda topic=topic: len(received[topic]) == 3, topic)
        truth = messages.decode_odometry(received[topic][2])
        at = int(np.searchsorted(trace.stamp, 43.0))
        np.testing.assert_allclose(truth.position[:2], trace.position[at, i], atol=1e-6)


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['mobility:=teleport'], "mobility: 'teleport' is not allowed, must be one of "),
    (['radio_range:=0'], 'radio_range: 0.0 is not allowed, must be a number above 0 m'),
    (['mobility:=fcd', 'trace:=nowhere.xml'], 'nowhere.xml: '),
    (['min_speed:=60.0'], 'min_speed: 60.0 is not allowed, must be at most max_speed'),
])
def test_a_parameter_that_is_not_allowed_is_one_line_and_exit_code_1(
    capfd: pytest.CaptureFixture[str], arguments: list[str], complaint: str,
) -> None:
    given = [word for override in arguments for word in ('-p', override)]
    assert main(Simulator, ['simulator', '--ros-args', *given]) == 1
    error = capfd.readouterr().err
    assert error.startswith(f'simulator: {complaint}')
    assert len(error.splitlines()) == 1


def test_a_beacon_of_several_rows_is_refused() -> None:
    scan = Observation.empty(1, 2, 3, 1.0)
    scan.sender[0] = 1, 2
    data, = messages.encode_beacons(scan, 'map')
    with pytest.raises(MessageError, match='2 rows are not allowed, a beacon has one'):
        Air(range(0)).beacon(data)
