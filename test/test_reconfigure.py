"""Live parameters, changed between two epochs, against localizers that were built with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.health import OK, STALE
from tsmcl_ros.types import ConfigError, Estimate, Links, Observation, VEHICLE
from tsmcl_ros.world import Epoch, make_world

WORLDS: dict[str, dict[str, object]] = {
    'disk': {},
    'ranges': {'measure_range': True, 'range_std': 20.0},
    'everywhere': {'measure_range': True, 'range_std': 1.0, 'radio_range': 3000.0},
    'vehicles': {'measure_range': True, 'range_std': 20.0},
    'rssi': {'measure_rssi': True},
    'lognormal': {'radio_model': 'lognormal', 'measure_rssi': True},
}
VEHICLES = 4
BASE = {'min_particles': 100, 'max_particles': 500, 'radio_range': 600.0}
RANDOM = {'motion_model': 'random'}


@cache
def simulated(kind: str) -> tuple[Observation, list[Epoch]]:
    """Return anchors and epochs of a world."""
    world = make_world(
        {'vehicles': VEHICLES, 'area_x': 1500.0, 'area_y': 1500.0, 'anchor_rows': 4,
         'anchor_columns': 4, 'radio_range': 600.0, **WORLDS[kind]}, np.random.default_rng(3))
    return world.anchors, [world.step() for _ in range(5)]


def links(anchors: Observation) -> Links:
    """Return how the anchors hear each other."""
    receiver, sender = np.triu_indices(anchors.sender.shape[1], 1)
    place = anchors.position[0]
    distance = np.linalg.norm(place[receiver] - place[sender], axis=1)
    noise = 4 * np.random.default_rng(0).standard_normal(len(distance))
    return Links(anchors.sender[0, receiver], anchors.sender[0, sender], place[receiver],
                 place[sender], -45 - 22 * np.log10(distance) + noise)


def heard(kind: str, epoch: Epoch) -> Observation:
    """Return what is heard, by radios that do not tell how far or how well they measure."""
    scan = epoch.observation
    told = np.full_like(scan.range_std, np.nan)
    scan = replace(scan, range_std=told, max_range=told)
    if kind != 'vehicles':
        return scan
    vehicle = (scan.sender >= 0) & (scan.sender % 2 == 0)
    return replace(
        scan, kind=np.where(vehicle, VEHICLE, scan.kind),
        sender=np.where(vehicle, scan.sender + 1000, scan.sender), covariance=np.where(
            vehicle[:, :, None, None], 100 * np.eye(2), scan.covariance))


def estimates(kind: str, settings: Mapping[str, object], later: Mapping[str, object] | None = None,
              wheels: bool = True) -> list[Estimate]:
    """Localize; the later settings come after a first epoch, in which nobody hears anything."""
    anchors, epochs = simulated(kind)
    localizer = Localizer(settings, VEHICLES)
    localizer.anchor_map(anchors)
    if kind == 'rssi':
        localizer.anchor_links(links(anchors))
    found = []
    for number, epoch in enumerate(epochs):
        scan = heard(kind, epoch) if number else Observation.empty(VEHICLES, 0, 2, epoch.stamp)
        wheel = (epoch.odom_position, epoch.odom_yaw) if wheels else (None, None)
        found.append(localizer.epoch(scan, *wheel))
        if later and not number:
            localizer.reconfigure(later)
    return found[1:]


def are_equal(ones: list[Estimate], others: list[Estimate]) -> bool:
    return all(
        np.array_equal(one.mean, other.mean, equal_nan=True)
        and np.array_equal(one.covariance, other.covariance, equal_nan=True)
        for one, other in zip(ones, others, strict=True))


@pytest.mark.parametrize(('kind', 'before', 'after'), [
    ('disk', {}, {'radio_range': 580.0}),
    ('disk', {}, {'edge_softness': 100.0, 'max_particles': 900, 'odom_std': 5.0, 'alpha3': 1.0}),
    ('disk', {}, {'use_heard': False}),
    ('disk', RANDOM, {
        'max_speed': 90.0, 'tabu_length': 1, 'tabu_radius': 0.9, 'neighbourhood_scale': 3.0,
        'neighbourhood_floor': 9.0, 'aspiration': 0.9, 'prior_bandwidth': 1.0}),
    ('disk', RANDOM | {'aspiration': 0.99}, {'max_iterations': 0}),
    ('disk', RANDOM | {'method': 'mcl'}, {'max_redraws': 0, 'max_speed': 90.0}),
    ('disk', {'motion_model': 'velocity'}, {'acceleration_std': 9.0, 'speed_decay': 3.0}),
    ('ranges', {}, {'range_std': 5.0, 'patience': 1, 'exclusion': 0.1, 'alpha1': 1.0,
                    'alpha2': 1.0, 'alpha4': 3.0}),
    ('ranges', {'range_std': 20.0}, {'resample_threshold': 0.0}),
    ('ranges', {'range_std': 20.0}, {'jitter': 1.0}),
    ('ranges', {}, {'use_range': False}),
    ('everywhere', {'radio_range': 3000.0, 'odom_heading': 'known', 'range_std': 1.0}, {
        'range_calibration': 'off'}),
    ('ranges', {'range_noise': 'asymmetric_exponential'}, {
        'range_short_slope': 0.3, 'range_short_offset': 9.0, 'range_long_slope': 0.01,
        'range_long_offset': 30.0}),
    ('ranges', RANDOM | {'method': 'r_mcl'}, {
        'region_references': 1, 'candidates': 2, 'least_parents': 90.0, 'max_widenings': 1}),
    ('ranges', {'method': 'ekf', 'beacon_period': 'adaptive'}, {
        'range_std': 20.0, 'period_q': 3.0, 'period_alpha': 1e9}),
    ('ranges', {'method': 'grey_ekf'}, {'range_std': 20.0}),
    ('ranges', {'method': 'cooperative'}, {
        'reference_samples': 20, 'direction_iterations': 1, 'convergence': 0.1}),
    ('ranges', {'method': 'nbp'}, {'oversampling': 1, 'kernel_scale': 9.0}),
    ('vehicles', {'range_std': 20.0}, {'use_vehicles': False}),
    ('vehicles', {'range_std': 20.0}, {'echo_guard': 0.0}),
    ('rssi', {'measure_rssi': True}, {'sigma_db': 1.0, 'rssi_at_reference': -50.0}),
    ('rssi', {'measure_rssi': True}, {'use_rssi': False}),
    ('rssi', {'measure_rssi': True}, {'rssi_calibration': 'off'}),
    ('rssi', {'measure_rssi': True}, {'link_neighbours': 3}),
    ('lognormal', {'radio_model': 'lognormal'}, {'sensitivity': -80.0}),
    ('lognormal', {'radio_model': 'lognormal'}, {'path_loss_exponent': 3.0}),
])
def test_estimates_after_a_change_are_those_of_a_localizer_built_so(
    kind: str, before: dict[str, object], after: dict[str, object],
) -> None:
    before = BASE | before
    wheels = 'motion_model' not in before
    changed = estimates(kind, before, after, wheels)
    assert are_equal(changed, estimates(kind, before | after, wheels=wheels))
    assert not are_equal(changed, estimates(kind, before, wheels=wheels))


def test_ages_and_waits_hold_from_now_on() -> None:
    localizer = Localizer({'max_wait': 10.0, 'outage_period': 0.0, 'stale_after': 100.0})
    scan = Observation.empty(1, 1, 2, 1.0)
    scan.sender[0], scan.range[0] = 1, 5.0
    localizer.beacons(0, scan)
    localizer.clock(2.0)
    assert not localizer.due()  # odometry may come
    localizer.reconfigure({'max_wait': 0.0})
    assert [estimate.stamp for estimate in localizer.due()] == [1.0]
    localizer.clock(9.0)
    assert not localizer.due()
    localizer.reconfigure({'outage_period': 4.0})
    assert [estimate.stamp for estimate in localizer.due()] == [5.0, 9.0]
    assert localizer.health.status.tolist() == [OK]
    localizer.reconfigure({'stale_after': 5.0})
    assert localizer.health.status.tolist() == [STALE]


@pytest.mark.parametrize(('settings', 'complaint'), [
    ({'max_speed': 9.0, 'odom_std': -1.0}, 'odom_std: -1.0 is not allowed'),
    ({'max_speed': 9.0, 'dimension': 3}, 'dimension cannot change from 2 to 3'),
    ({'max_speed': 9.0, 'max_particles': 100}, 'max_particles: 100 is not allowed'),
    ({'max_speed': 9.0, 'min_particles': 100}, 'min_particles cannot change from 200 to 100'),
    ({'max_speed': 9.0, 'sped': 9.0}, "unknown parameter 'sped'"),
])
def test_of_changes_that_are_not_allowed_none_takes_place(
    settings: dict[str, object], complaint: str,
) -> None:
    localizer = Localizer({})
    with pytest.raises(ConfigError, match=complaint):
        localizer.reconfigure(settings)
    assert localizer.motion_config.max_speed == 50.0
