"""R-MCL: where it samples, how evenly its particles weigh, and that they are the posterior."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tsmcl_ros.methods.grid import Grid, GridConfig
from tsmcl_ros.methods.mcb import Mcb, McbConfig
from tsmcl_ros.methods.r_mcl import control_level, RMcl, RMclConfig
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel, EvidenceConfig, RadioConfig
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


def test_more_particles_count_than_where_measurements_only_weigh() -> None:
    ess = {}
    for kind, config, settings in ((Mcb, McbConfig, {}), (RMcl, RMclConfig, {'acceptance': 0.2})):
        filter_ = make(kind, config, {**RANDOM, 'max_speed': 80.0}, 40, **settings)
        for vehicle in range(40):
            filter_.start(Prior(vehicle, np.zeros(2), 100.0 * np.eye(2)))
        filter_.predict(Motion(1.0, np.zeros((40, 2)), np.zeros(40)))
        ess[kind] = filter_.update(listen(ANCHORS, (20.0, 0.0), vehicles=40)).ess.mean()
    assert ess[Mcb] < 35
    assert ess[RMcl] > 40


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


@pytest.mark.parametrize('share', [0.1, 0.5, 0.9])
def test_the_level_of_rejection_lets_the_wanted_share_survive_but_no_level_higher(
        share: float) -> None:
    trials = np.random.default_rng(3).normal(-5.0, 2.0, (4, 60)).astype(np.float32)
    level = control_level(trials, share)
    for row, found in zip(trials.astype(np.float64), level, strict=True):
        def survive(c: float, row: np.ndarray = row) -> float:
            return float(np.minimum(np.exp(row - c), 1).mean())

        assert survive(found) >= share
        higher = row[row > found + 1e-6]
        assert not len(higher) or survive(higher.min()) < share


def test_without_any_likely_trial_nobody_is_rejected() -> None:
    assert np.isneginf(control_level(np.full((2, 5), -np.inf, np.float32), 0.5)).all()
