"""A fleet over DDS whose vehicles are each other's references."""

from __future__ import annotations

from collections.abc import Callable
import json
from typing import Any

import numpy as np
import pytest
from tsmcl_ros import messages
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.relay import Poses
from tsmcl_ros.nodes.simulator import Air
from tsmcl_ros.nodes.wire import LATCHED_INPUT
from tsmcl_ros.types import MessageError, VEHICLE
from tsmcl_ros.world import anchor_table, Epoch, make_world

Start = Callable[..., Any]

# Anchors stand on the left; two of six vehicles are too far to the right to hear any.
ANCHORS = ('0 0', '0 30', '20 15', '10 5')
WORLD = {'vehicles': 6, 'area_x': 60.0, 'area_y': 30.0, 'min_speed': 0.5, 'max_speed': 1.0,
         'radio_range': 30.0, 'measure_range': True, 'range_std': 0.3, 'odom_noise': 0.1}
FLEET = {'min_particles': 200, 'max_particles': 1000, 'motion_model': 'odometry',
         'odom_heading': 'known', 'odom_std': 0.1, 'alpha3': 0.0, 'alpha4': 0.0,
         'radio_range': 30.0, 'range_std': 0.3, 'range_calibration': 'off', 'seed': 1,
         'hold_circles': False}
SEED, EPOCHS = 3, 10
FAR = [0, 3]


def overrides(**settings: object) -> list[str]:
    # As JSON, so that an 'off' stays a text.
    return ['--ros-args', *(
        word for name, value in settings.items() for word in ('-p', f'{name}:={json.dumps(value)}')
    )]


def in_process(cooperation: bool) -> tuple[list[Epoch], np.ndarray, np.ndarray]:
    """
    Return what a world and a localizer do with the same seeds, without DDS.

    That is all epochs, and of the last estimates the errors and the standard deviations [m].
    """
    world = make_world({**WORLD, 'anchor_layout': 'list', 'anchor_positions': ANCHORS},
                       np.random.default_rng(SEED))
    localizer = Localizer(FLEET, WORLD['vehicles'])
    localizer.anchor_map(world.anchors)
    epochs, poses = [], Poses.unknown(WORLD['vehicles'], 2) if cooperation else None
    for _ in range(EPOCHS):
        epochs.append(world.step(poses=poses))
        estimate = localizer.epoch(
            epochs[-1].observation, epochs[-1].odom_position, epochs[-1].odom_yaw)
        if cooperation:
            poses = Poses.of(estimate)
    std = np.sqrt(np.trace(estimate.covariance, axis1=1, axis2=2))
    return epochs, np.linalg.norm(estimate.mean - epochs[-1].position, axis=1), std


@pytest.mark.accuracy
def test_vehicles_that_hear_too_few_anchors_are_localized_through_others(
    probe: Any, start: Start,
) -> None:
    vehicles = range(WORLD['vehicles'])
    scans = [probe.collect(f'/veh_{i}/beacons', messages.POINT_CLOUD) for i in vehicles]
    odometry = [probe.collect(f'/veh_{i}/odom', messages.ODOMETRY) for i in vehicles]
    truths = [probe.collect(f'/veh_{i}/ground_truth', messages.ODOMETRY) for i in vehicles]
    poses = [probe.collect(f'/veh_{i}/pose', messages.POSE, LATCHED_INPUT) for i in vehicles]
    anchors = start('nodes.anchor', *overrides(
        use_sim_time=True, anchor_layout='list', anchor_positions=ANCHORS))
    fleet = start('nodes.fleet', *overrides(vehicles=len(vehicles), use_sim_time=True, **FLEET))
    fleet.wait_for('anchors on the map')
    # A busy machine is no dead anchor, and no lost localizer.
    simulator = start('nodes.simulator', *overrides(
        seed=SEED, duration=EPOCHS, rate=1000, cooperation=True, pose_timeout=20.0,
        beacon_timeout=20.0, wait_for=2,  # fleet and test
        **WORLD))
    probe.expect(lambda: simulator.process.poll() is not None, 'the simulation to end')
    assert simulator.wait() == 0
    assert 'no longer waited for' not in simulator.output
    epochs, errors, stds = in_process(cooperation=True)
    probe.expect(lambda: all(len(found) == EPOCHS for found in scans + odometry + truths) and all(
        found and messages.decode_pose(found[-1]).stamp == EPOCHS for found in poses),
        'the last estimate of each vehicle')
    for i in vehicles:
        for k, epoch in enumerate(epochs):
            scan, _ = messages.decode_beacons(scans[i][k])
            expected = epoch.observation.vehicle(i)
            np.testing.assert_array_equal(scan.sender, expected.sender)
            np.testing.assert_array_equal(scan.range, expected.range)
        error = np.linalg.norm(messages.decode_pose(poses[i][-1]).position[:2]
                               - messages.decode_odometry(truths[i][-1]).position[:2])
        assert error == pytest.approx(errors[i], abs=1e-3)
    last = epochs[-1].observation
    assert all((last.kind[i, last.heard[i]] == VEHICLE).all() for i in FAR)
    assert errors[FAR].max() < 1.0
    # Alone one may be right by luck, but does not know it; NaN is nowhere yet.
    _, _, alone = in_process(cooperation=False)
    assert not (alone[FAR] < 5 * stds[FAR]).any()
    assert anchors.stop() == fleet.stop() == 0


def test_anchors_with_the_identity_of_a_vehicle_are_not_heard() -> None:
    air = Air(range(1_000_000, 1_000_002))
    posing = anchor_table(np.zeros((1, 2)), np.array([1_000_001]))
    for take in (air.map, air.beacon):
        with pytest.raises(MessageError, match='anchor id 1000001 is not allowed, vehicles have '
                                               '1000000 to 1000001 by vehicle_id_offset'):
            take(messages.encode_beacons(posing, 'map')[0])
    assert not air.is_known()
