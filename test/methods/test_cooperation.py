"""Cooperative localization by ranges, against the exact grid and closed forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tsmcl_ros.evaluation.metrics import normalized_error_squared
from tsmcl_ros.methods import METHODS
from tsmcl_ros.methods.cooperative import heaviest
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ConfigError, Estimate, Estimator, Motion, Observation, Prior
from tsmcl_ros.world import anchor_table, receive

COOPERATIVE = ('cooperative', 'nbp')
RADIO = {'radio_range': 30.0, 'measure_range': True, 'range_noise': 'asymmetric_exponential'}


def make(method: str, vehicles: int = 1, radio: dict[str, Any] = RADIO, **settings: Any
         ) -> Estimator:
    channel = Channel(RadioConfig(**radio), EvidenceConfig(
        outlier_fraction=0.0, use_heard=False, silence='none'))
    kind = METHODS[method]
    motion = MotionConfig(motion_model='odometry', odom_heading='known', odom_std=0.5)
    return kind(kind.Config(**settings), channel, motion_model(motion, 2, True), vehicles, 2,
                np.random.default_rng(1))


def ranged(positions: object, ranges: object, vehicles: int = 1, **fields: object) -> Observation:
    """Let vehicles have ranges to references at these positions (K, 2) [m]."""
    references = np.array(positions, np.float32)
    observation = Observation.empty(vehicles, len(references), 2, 1.0)
    observation.sender[:] = np.arange(len(references))
    observation.position[:] = references
    observation.range[:] = ranges
    for name, value in fields.items():
        getattr(observation, name)[:] = value
    return observation


def errors(estimate: Estimate, truth: np.ndarray) -> tuple[float, float]:
    """Return RMSE [m] and mean NEES."""
    off = estimate.mean - truth
    return (float(np.sqrt(np.mean(np.sum(off ** 2, axis=1)))),
            float(normalized_error_squared(off, estimate.covariance).mean()))


@pytest.fixture(scope='module')
def parked() -> tuple[np.ndarray, Observation, Estimate]:
    """Return vehicles that hear three anchors or more, what they hear, and the exact estimate."""
    rng = np.random.default_rng(5)
    cells = np.meshgrid((np.arange(6) + 0.5) * 100 / 6, (np.arange(3) + 0.5) * 100 / 3)
    anchors = np.stack(cells, axis=-1).reshape(-1, 2) + rng.uniform(-6, 6, (18, 2))
    truth = rng.uniform(5, 95, (200, 2))
    heard = receive(Channel(RadioConfig(**RADIO)), truth, anchor_table(anchors), rng, 1.0)
    several = np.flatnonzero(heard.heard.sum(axis=1) >= 3)
    truth, heard = truth[several], heard.of(several).trimmed()
    grid = make('grid', len(truth), grid_cell=1.25, grid_x_min=-20.0, grid_x_max=120.0,
                grid_y_min=-20.0, grid_y_max=120.0)
    return truth, heard, grid.update(heard)


@pytest.mark.accuracy
@pytest.mark.parametrize('count', [50, 200])
def test_vehicles_among_anchors_are_localized_as_well_as_is_possible(
        count: int, parked: tuple[np.ndarray, Observation, Estimate]) -> None:
    truth, heard, exact = parked
    estimate = make('cooperative', len(truth), reference_samples=count).update(heard)
    assert errors(estimate, truth)[0] < 1.06 * errors(exact, truth)[0]
    # 2 for an honest covariance, up to chance.
    assert 1.5 < errors(estimate, truth)[1] < 2.5
    spread, optimum = (np.trace(each.covariance, axis1=1, axis2=2) for each in (estimate, exact))
    assert np.median(spread / optimum) == pytest.approx(1.0, abs=0.1)


@pytest.mark.accuracy
def test_propagated_beliefs_come_near_to_what_is_possible(
        parked: tuple[np.ndarray, Observation, Estimate]) -> None:
    truth, heard, exact = parked
    estimate = make('nbp', len(truth), reference_samples=100).update(heard)
    assert errors(estimate, truth)[0] < 1.1 * errors(exact, truth)[0]
    # Kernels widen what they are laid over, so that the covariance is cautious.
    assert 0.8 < errors(estimate, truth)[1] < 2.2


@pytest.mark.parametrize('method', COOPERATIVE)
def test_one_reference_leaves_its_ring(method: str) -> None:
    estimate = make(method, min_particles=2000).update(
        ranged([[10.0, 0.0]], 20.0, vehicles=1))
    assert np.linalg.norm(estimate.mean[0] - [10.0, 0.0]) < 2.5
    # Ring of radius 20 m, thinned by the law's width of 4 m: half its square along each axis.
    assert np.trace(estimate.covariance[0]) == pytest.approx(20.0 ** 2, rel=0.2)


@pytest.mark.parametrize('method', COOPERATIVE)
def test_two_references_leave_both_crossings_of_their_rings(method: str) -> None:
    filter_ = make(method, radio={'range_std': 0.5}, min_particles=500)
    estimate = filter_.update(ranged([[-10.0, 0.0], [10.0, 0.0]], math.hypot(10.0, 15.0)))
    np.testing.assert_allclose(estimate.mean[0], [0.0, 0.0], atol=2.5)
    assert estimate.covariance[0, 1, 1] == pytest.approx(15.0 ** 2, rel=0.1)
    above = (filter_.particles[0, :, 1] > 0).mean()
    assert 0.35 < above < 0.65


@pytest.mark.parametrize('method', COOPERATIVE)
def test_an_uncertain_reference_counts_less(method: str) -> None:
    # Two references that contradict each other on the line between them.
    corners = [[0.0, 0.0], [40.0, 0.0], [20.0, 30.0], [20.0, -30.0]]
    means = []
    for doubtful in (0, 1):
        covariance = np.zeros((4, 2, 2))
        covariance[doubtful] = 100.0 * np.eye(2)
        means.append(make(method, radio={'range_std': 1.0}, min_particles=1000).update(ranged(
            corners, [16.0, 16.0, 30.0, 30.0], covariance=covariance)).mean[0, 0])
    assert means[0] > 22.0
    assert means[1] < 18.0


def test_belief_and_ranges_are_fused_and_nothing_counts_twice() -> None:
    # A prior of 2 m and one range of 2 m from far away make sqrt(2) m along the line of sight.
    filter_ = make('cooperative', radio={'range_std': 2.0}, min_particles=2000)
    filter_.start(Prior(0, np.zeros(2), 4.0 * np.eye(2)))
    estimate = filter_.update(ranged([[-300.0, 0.0]], 302.0))
    np.testing.assert_allclose(estimate.mean[0], [1.0, 0.0], atol=0.25)
    np.testing.assert_allclose(estimate.covariance[0], np.diag([2.0, 4.0]), atol=0.5)


@pytest.mark.parametrize('method', COOPERATIVE)
def test_a_belief_tells_the_crossings_of_two_rings_apart(method: str) -> None:
    filter_ = make(method, radio={'range_std': 1.0})
    filter_.start(Prior(0, np.array([0.0, 13.0]), 16.0 * np.eye(2)))
    estimate = filter_.update(ranged([[-10.0, 0.0], [10.0, 0.0]], math.hypot(10.0, 15.0)))
    np.testing.assert_allclose(estimate.mean[0], [0.0, 15.0], atol=0.5)


@pytest.mark.accuracy
@pytest.mark.parametrize('method', COOPERATIVE)
def test_a_vehicle_that_moves_is_followed_by_a_single_range(method: str) -> None:
    filter_ = make(method, radio={'range_std': 1.0}, vehicles=20, min_particles=200)
    rng = np.random.default_rng(3)
    truth, anchor = np.tile([0.0, 20.0], (20, 1)), np.zeros(2)
    step = np.array([2.0, 0.0])
    for vehicle in range(20):
        filter_.start(Prior(vehicle, truth[vehicle], 4.0 * np.eye(2)))
    for _ in range(12):
        truth = truth + step + rng.normal(0, 0.5, truth.shape)
        filter_.predict(Motion(1.0, np.tile(step, (20, 1)), np.zeros(20)))
        ranges = np.linalg.norm(truth - anchor, axis=1) + rng.normal(0, 1.0, 20)
        estimate = filter_.update(ranged([anchor], ranges[:, None], 20))
    rmse, nees = errors(estimate, truth)
    assert rmse < 3.0
    assert nees < 4.0


@pytest.mark.parametrize('method', COOPERATIVE)
def test_a_range_that_nothing_explains_does_not_undo_what_the_others_found(method: str) -> None:
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ranges = np.full(24, 24.0)
    ranges[0] = 5.0
    estimate = make(method).update(
        ranged(24.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1), ranges))
    assert not estimate.reinitialized[0]
    assert np.linalg.norm(estimate.mean[0]) < 3.0


@pytest.mark.parametrize('method', COOPERATIVE)
def test_three_dimensions_are_refused(method: str) -> None:
    kind = METHODS[method]
    allowed = 'dimension: 3 is not allowed for cooperative methods, must be 2'
    with pytest.raises(ConfigError, match=allowed):
        kind(kind.Config(), Channel(RadioConfig()), motion_model(MotionConfig(), 3, True), 1, 3,
             np.random.default_rng(1))


# Of the search for directions alone


def test_the_heaviest_samples_are_kept_and_at_least_a_reference_s_share() -> None:
    log_weights = np.log(np.array([[[0.1, 0.5, 0.15, 0.25], [1e-9, 1.0, 1e-9, 2e-9]]]))
    kept = heaviest(log_weights, np.array([[True, True]]))
    np.testing.assert_array_equal(kept[0, 0], [True, True, True, True])
    # Nearly all of the second's weight is in one sample: with two references it keeps two.
    np.testing.assert_array_equal(kept[0, 1], [False, True, False, True])


def test_the_first_reference_keeps_the_remainder() -> None:
    log_weights = np.zeros((1, 3, 7))
    log_weights[:, :, 1:] = -100.0 - np.arange(6)
    kept = heaviest(log_weights, np.array([[True, True, True]]))
    np.testing.assert_array_equal(kept.sum(axis=2), [[3, 2, 2]])


def test_arcs_narrow_to_what_is_uncertain_and_no_further() -> None:
    anchors = [[0.0, 0.0], [40.0, 0.0], [20.0, 35.0], [20.0, -35.0]]
    ranges = np.linalg.norm(np.array(anchors) - [20.0, 5.0], axis=1)
    filter_ = make('cooperative', radio={'range_std': 1.0}, reference_samples=200)
    arcs, unsettled = filter_.search(ranged(anchors, ranges))  # type: ignore[attr-defined]
    assert not unsettled.any()
    # Across the line of sight the position is uncertain by 0.7 m: 3 of that at 20 m, and margin.
    assert (arcs.half < 0.3).all()
    assert (arcs.half > 1.5 * 0.7 / 35.0).all()


def test_a_vehicle_whose_arcs_did_not_settle_says_so_in_its_covariance() -> None:
    corner = ranged([[0.0, 0.0], [40.0, 0.0], [0.0, 40.0]], [28.3, 14.2, 45.0])
    traces = []
    for iterations in (1, 10):
        filter_ = make('cooperative', radio={'range_std': 1.0}, direction_iterations=iterations)
        traces.append(np.trace(filter_.update(corner).covariance[0]))
        assert filter_.settled[0] == (iterations == 10)  # type: ignore[attr-defined]
    # It has moved from the middle of the references, 20 m away, and may move on.
    assert traces[0] > 100.0
    assert traces[1] < 10.0
