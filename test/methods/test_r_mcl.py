"""R-MCL: where it samples, how near its few particles come, and that they are the posterior."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tsmcl_ros.methods.grid import Grid, GridConfig
from tsmcl_ros.methods.mcb import Mcb, McbConfig
from tsmcl_ros.methods.r_mcl import RMcl, RMclConfig
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Motion, Observation, Prior

RADIO = {'radio_range': 100.0, 'edge_softness': 0.1, 'measure_rssi': True, 'sigma_db': 4.0,
         'path_loss_exponent': 2.6}
RANDOM = {'motion_model': 'random', 'max_speed': 20.0}
ODOMETRY = {'motion_model': 'odometry', 'odom_heading': 'known', 'odom_std': 10.0, 'alpha3': 0.0,
            'alpha4': 0.0}
ANCHORS = np.array([[60.0, 0.0], [0.0, 70.0], [-80.0, -10.0], [30.0, -60.0], [150.0, 20.0]])


def channel(outliers: float = 0.0, **radio: Any) -> Channel:
    return Channel(RadioConfig(**{**RADIO, **radio}), EvidenceConfig(outlier_fraction=outliers))


def make(kind: Any, config: Any, motion: dict[str, Any], vehicles: int = 1,
         outliers: float = 0.0, **settings: Any) -> Any:
    settings = {'min_particles': 50, 'max_particles': 2000, 'jitter': 0.0, **settings}
    return kind(config(**settings), channel(outliers),
                motion_model(MotionConfig(**motion), 2, True), vehicles, 2,
                np.random.default_rng(1))


def listen(position: np.ndarray, truth: tuple[float, float], noise: np.ndarray | float = 0.0,
           vehicles: int = 1) -> Observation:
    """Let vehicles at one place hear anchors with their rssi, all but the last one directly."""
    observation = Observation.empty(vehicles, len(position), 2, 1.0)
    observation.sender[:] = np.arange(len(position))
    observation.position[:] = position
    distance = np.linalg.norm(position - truth, axis=1)
    rssi = channel().path_loss(np.arange(len(position))).mean(distance) + noise
    observation.rssi[:] = np.where(distance < 100.0, rssi, np.nan)
    observation.hops[:] = np.where(distance < 100.0, 1, 2)
    return observation


def moved(x: float = 0.0) -> Motion:
    return Motion(1.0, np.array([[x, 0.0]]), np.zeros(1))


@pytest.mark.accuracy
@pytest.mark.parametrize('motion', [RANDOM, ODOMETRY])
def test_the_posterior_is_that_of_the_exact_filter(motion: dict[str, Any]) -> None:
    exact = Grid(GridConfig(grid_cell=2.0, grid_x_min=-130.0, grid_x_max=130.0, grid_y_min=-130.0,
                            grid_y_max=130.0), channel(),
                 motion_model(MotionConfig(**motion), 2, True), 1, 2, np.random.default_rng(1))
    filter_ = make(RMcl, RMclConfig, motion, min_particles=10_000, max_particles=10_000)
    draw = np.random.default_rng(2)
    for epoch in range(8):
        observation = listen(ANCHORS, (5.0 * epoch, 0.0), draw.normal(0, 4.0, len(ANCHORS)))
        for method in (exact, filter_):
            if epoch:
                method.predict(moved(5.0))
            else:
                method.start(Prior(0, np.zeros(2), 400.0 * np.eye(2)))
        expected, estimate = exact.update(observation), filter_.update(observation)
    # 10 m wide, of 10 000 particles; cells are 2 m.
    np.testing.assert_allclose(estimate.mean, expected.mean, atol=0.5)
    np.testing.assert_allclose(np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)),
                               np.sqrt(np.diagonal(expected.covariance, axis1=1, axis2=2)),
                               atol=0.5)


def follow(kind: Any, config: Any, particles: int) -> np.ndarray:
    """Return the means [m] that vehicles have after five epochs, 10 000 particles altogether."""
    vehicles, draw = 10_000 // particles, np.random.default_rng(2)
    filter_ = make(kind, config, {**RANDOM, 'max_speed': 80.0}, vehicles,
                   min_particles=particles, max_particles=particles)
    for vehicle in range(vehicles):
        filter_.start(Prior(vehicle, np.zeros(2), 900.0 * np.eye(2)))
    for _ in range(5):
        filter_.predict(Motion(1.0, np.zeros((vehicles, 2)), np.zeros(vehicles)))
        noise = draw.normal(0, 4.0, len(ANCHORS))
        estimate = filter_.update(listen(ANCHORS, (20.0, 0.0), noise, vehicles))
    return np.asarray(estimate.mean)


@pytest.mark.accuracy
def test_candidates_that_count_by_weight_say_more_than_survivors_of_rejection() -> None:
    errors = {}
    for kind, config in ((RMcl, RMclConfig), (Mcb, McbConfig)):
        off = follow(kind, config, 50) - follow(RMcl, RMclConfig, 10_000)
        errors[kind] = np.sqrt(np.square(off).sum(axis=1).mean())
    # Twice as near takes four times as many particles.
    assert errors[RMcl] < 0.5 * errors[Mcb]


def test_so_many_candidates_are_drawn_as_are_wanted() -> None:
    filter_ = make(RMcl, RMclConfig, RANDOM, 2, candidates=5)
    for vehicle in range(2):
        filter_.start(Prior(vehicle, np.zeros(2), 100.0 * np.eye(2)))
    filter_.predict(Motion(1.0, np.zeros((2, 2)), np.zeros(2)))
    filter_.update(listen(ANCHORS, (0.0, 0.0), vehicles=2))
    np.testing.assert_array_equal(filter_.draws, [250, 250])


def tail_spread(particles: int, widenings: int) -> float:
    """Return how far a belief spreads [m] that hears to be in the tail of what it was."""
    vehicles = 10_000 // particles
    filter_ = make(RMcl, RMclConfig, {**RANDOM, 'max_speed': 5.0}, vehicles,
                   min_particles=particles, max_particles=particles, max_widenings=widenings)
    for vehicle in range(vehicles):
        filter_.start(Prior(vehicle, np.zeros(2), 3600.0 * np.eye(2)))
    filter_.predict(Motion(1.0, np.zeros((vehicles, 2)), np.zeros(vehicles)))
    estimate = filter_.update(listen(np.array([[190.0, 0.0]]), (100.0, 0.0), vehicles=vehicles))
    spreads = np.sqrt(np.trace(estimate.covariance, axis1=1, axis2=2))
    return float(np.median(spreads[~estimate.reinitialized]))


def test_a_few_particles_that_lead_to_what_is_heard_stand_for_what_is_between_them() -> None:
    exact = tail_spread(10_000, 0)
    assert tail_spread(50, 0) < 0.6 * exact
    assert 0.7 * exact < tail_spread(50, 3) < exact


def test_where_many_particles_lead_to_what_is_heard_motion_is_as_it_is() -> None:
    assert tail_spread(10_000, 3) == tail_spread(10_000, 0)


def test_a_prediction_without_anything_likely_is_replaced_and_told() -> None:
    filter_ = make(RMcl, RMclConfig, RANDOM, 2)
    for vehicle, x in enumerate((500.0, 50.0)):
        filter_.start(Prior(vehicle, np.array([x, 0.0]), np.eye(2)))
    filter_.predict(Motion(1.0, np.zeros((2, 2)), np.zeros(2)))
    estimate = filter_.update(listen(ANCHORS[:1], (50.0, 0.0), vehicles=2))
    np.testing.assert_array_equal(estimate.reinitialized, [True, False])
    assert np.linalg.norm(estimate.mean - [60.0, 0.0], axis=1).max() < 60.0


def test_the_next_nearest_references_replace_those_whose_region_the_motion_cannot_meet() -> None:
    filter_ = make(RMcl, RMclConfig, RANDOM, outliers=0.02, region_references=2)
    filter_.start(Prior(0, np.zeros(2), 100.0 * np.eye(2)))
    filter_.predict(moved())
    observation = listen(ANCHORS, (0.0, 0.0))
    observation.rssi[0, 2] = -10.0  # within a metre, it says, of an anchor 80 m away
    estimate = filter_.update(observation)
    assert not estimate.reinitialized[0]
    assert np.linalg.norm(estimate.mean[0]) < 15


def test_boxes_follow_the_estimates_where_motion_is_extrapolated() -> None:
    middles = {}
    for extrapolate in (False, True):
        filter_ = make(RMcl, RMclConfig, {**RANDOM, 'max_speed': 1.0}, min_particles=2000,
                       extrapolate=extrapolate)
        for x in (0.0, 10.0):
            filter_.start(Prior(0, np.array([x, 0.0]), 0.01 * np.eye(2)))
            filter_._mean[0] = [0.0, 0.0]  # which a prior would have it forget
            filter_.update(Observation.empty(1, 0, 2, x))
        filter_.predict(Motion(1.0))
        middles[extrapolate] = filter_.particles[0].mean(axis=0)
    np.testing.assert_allclose(middles[False], [10.0, 0.0], atol=0.1)
    np.testing.assert_allclose(middles[True], [20.0, 0.0], atol=0.1)
