"""What vehicles transmit themselves: relays against brute force, and which poses are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.relay import Poses, relay, RelayConfig, vehicle_beacons
from tsmcl_ros.types import ConfigError, Observation, VEHICLE
from tsmcl_ros.world import make_world


def listen(position: np.ndarray, anchors: np.ndarray, reach: float) -> Observation:
    """Return the anchors (A, 2) within reach of vehicles (V, 2), by all distances."""
    near = np.linalg.norm(position[:, None] - anchors, axis=2) <= reach
    vehicle, anchor = np.nonzero(near)
    return Observation.tabulate(
        vehicle, {'sender': 10 + anchor, 'position': anchors[anchor]}, len(position), 2, 1.0)


def meet(position: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of these vehicles (V, 2) that hear each other, by all distances."""
    near = np.linalg.norm(position[:, None] - position, axis=2) <= reach
    np.fill_diagonal(near, False)
    listener, neighbour = np.nonzero(near)
    return listener, neighbour


def relayed_to(heard: Observation, pairs: tuple[np.ndarray, np.ndarray]) -> Observation:
    """Return what is relayed within 20 m."""
    rows = relay(heard, *pairs, 20.0)
    return Observation.tabulate(*rows, len(heard.sender), 2, 1.0)


def scene(seed: int = 1, vehicles: int = 60, anchors: int = 25
          ) -> tuple[np.ndarray, np.ndarray, Observation, tuple[np.ndarray, np.ndarray]]:
    draw = np.random.default_rng(seed)
    position = draw.uniform(0, 100, (vehicles, 2))
    place = draw.uniform(0, 100, (anchors, 2)).astype(np.float32)
    return position, place, listen(position, place, 20.0), meet(position, 20.0)


@pytest.mark.parametrize('seed', range(5))
def test_relayed_anchors_are_those_that_neighbours_hear_and_oneself_does_not(seed: int) -> None:
    _, _, heard, neighbours = scene(seed)
    relayed = relayed_to(heard, neighbours)
    own = [set(row[row >= 0].tolist()) for row in heard.sender]
    listener, neighbour = neighbours
    for vehicle in range(len(own)):
        others = neighbour[listener == vehicle]
        told = set().union(*(own[other] for other in others)) - own[vehicle]
        found = relayed.sender[vehicle, relayed.heard[vehicle]].tolist()
        assert found == sorted(told)


def test_relayed_anchors_are_two_hops_away_and_measured_by_nobody() -> None:
    _, place, heard, neighbours = scene()
    measured = replace(heard, range=np.ones_like(heard.range), rssi=np.ones_like(heard.rssi))
    relayed = relayed_to(measured, neighbours)
    rows = relayed.heard
    assert rows.any()
    assert (relayed.hops[rows] == 2).all()
    assert np.isnan(relayed.range).all()
    assert np.isnan(relayed.rssi).all()
    np.testing.assert_array_equal(relayed.position[rows], place[relayed.sender[rows] - 10])
    np.testing.assert_array_equal(relayed.max_range[rows], 20.0)


def test_a_relayed_anchor_is_beyond_the_range_and_within_twice_the_range() -> None:
    position, _, heard, neighbours = scene()
    relayed = relayed_to(heard, neighbours)
    vehicle, row = np.nonzero(relayed.heard)
    distance = np.linalg.norm(position[vehicle] - relayed.position[vehicle, row], axis=1)
    assert distance.min() > 20.0
    assert distance.max() <= 40.0


@pytest.mark.parametrize('field', ['kind', 'hops'])
def test_neither_vehicles_nor_relayed_anchors_are_relayed(field: str) -> None:
    _, _, heard, neighbours = scene()
    other = {'kind': VEHICLE, 'hops': 2}[field]
    changed = replace(heard, **{field: np.full_like(heard.kind, other)})
    assert relayed_to(changed, neighbours).sender.size == 0


def test_without_neighbours_nothing_is_relayed() -> None:
    _, _, heard, _ = scene()
    nobody = np.zeros(0, int)
    assert relayed_to(heard, (nobody, nobody)).sender.size == 0


def test_a_beacon_of_a_vehicle_claims_its_pose_with_its_covariance() -> None:
    covariance = np.array([[[2.0, 1.0], [1.0, 3.0]], [[4.0, 0.0], [0.0, 4.0]]])
    poses = Poses(np.ones(2), np.array([[1.0, 2.0], [3.0, 4.0]]), covariance)
    beacons = vehicle_beacons(RelayConfig(vehicle_id_offset=500), poses)
    assert beacons.sender.tolist() == [[500, 501]]
    assert (beacons.kind == VEHICLE).all()
    np.testing.assert_array_equal(beacons.position[0], poses.mean)
    np.testing.assert_array_equal(beacons.covariance[0], covariance)


def test_poses_are_told_that_are_known_within_a_radius() -> None:
    covariance = np.zeros((5, 2, 2))
    covariance[:, 0, 0] = [8.9, 9.1, 1.0, 1.0, 0.0]  # and 16 along the other axis
    covariance[:, 1, 1] = 16.0
    covariance[2] = np.nan
    mean = np.zeros((5, 2))
    mean[3] = np.nan
    poses = Poses(np.ones(5), mean, covariance)
    assert poses.within(5.0).tolist() == [True, False, False, False, False]


def test_an_anchor_with_the_identity_of_a_vehicle_is_refused() -> None:
    anchors = replace(Observation.empty(1, 2, 2, 0.0), sender=np.array([[7, 102]]))
    RelayConfig(vehicle_id_offset=100).refuse_anchors(anchors, 2)
    with pytest.raises(ConfigError, match='vehicle_id_offset: 100 is not allowed, it gives '
                                          'vehicles the ids 100 to 102, and 102 is an anchor'):
        RelayConfig(vehicle_id_offset=100).refuse_anchors(anchors, 3)


@pytest.mark.accuracy
def test_mcl_is_nearer_with_relayed_anchors() -> None:
    # 40 vehicles among few anchors, range-free: what neighbours hear says where one is not.
    settings = {'radio_range': 100.0, 'vehicles': 40, 'area_x': 400.0, 'area_y': 400.0,
                'anchor_rows': 3, 'anchor_columns': 3, 'anchor_spacing': 400 / 3,
                'anchor_jitter': 30.0, 'min_speed': 5.0, 'max_speed': 20.0}
    errors = []
    for hops in (1, 2):
        world = make_world({**settings, 'relay_hops': hops}, np.random.default_rng(1))
        localizer = Localizer({
            'method': 'mcl', 'min_particles': 50, 'max_particles': 500, 'motion_model': 'random',
            'max_speed': 20.0, 'radio_range': 100.0, 'silence': 'none', 'seed': 1}, 40)
        epochs = [world.step() for _ in range(30)]
        estimates = [localizer.epoch(epoch.observation) for epoch in epochs]
        errors.append(np.array([np.linalg.norm(estimate.mean - epoch.position, axis=1)
                                for epoch, estimate in zip(epochs, estimates, strict=True)])[10:])
    located = np.isfinite(errors[0]) & np.isfinite(errors[1])
    assert errors[1][located].mean() < 0.9 * errors[0][located].mean()
