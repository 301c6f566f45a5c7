"""The EKF in the plane and in space: tracking, honesty, outliers, and beacons without ranges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.evaluation.metrics import normalized_error_squared
from tsmcl_ros.methods.ekf import Ekf
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ConfigError, Motion, Observation, Prior

RANGE_STD = 2.0


def make(vehicles: int = 1, dimension: int = 3, motion: dict[str, Any] | None = None,
         radio: dict[str, Any] | None = None, outliers: float = 0.02, **settings: Any) -> Ekf:
    """Return an EKF without odometry."""
    config = MotionConfig(**{'motion_model': 'velocity', 'acceleration_std': 0.5,
                             'max_speed': 5.0, **(motion or {})})
    channel = Channel(RadioConfig(**{'range_std': RANGE_STD, **(radio or {})}),
                      EvidenceConfig(outlier_fraction=outliers, range_calibration='off'))
    return Ekf(Ekf.Config(**settings), channel, motion_model(config, dimension, True), vehicles,
               dimension, np.random.default_rng(1))


def ranged(truth: np.ndarray, anchors: np.ndarray, draw: np.random.Generator | None,
           stamp: float = 1.0) -> Observation:
    """Return the ranges of vehicles (V, D) to all anchors (A, D)."""
    observation = Observation.empty(len(truth), *anchors.shape, stamp)
    observation.sender[:] = np.arange(len(anchors))
    observation.position[:] = anchors
    observation.range[:] = np.linalg.norm(truth[:, None] - anchors, axis=2)
    if draw is not None:
        observation.range[:] += RANGE_STD * draw.standard_normal(observation.range.shape)
    return observation


def field(anchors: int = 8, dimension: int = 3, seed: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 400, (anchors, dimension))


def cruise(vehicles: int, dimension: int, steps: list[float], seed: int = 2
           ) -> list[tuple[float, np.ndarray]]:
    """Return elapsed times and positions of vehicles whose acceleration is as configured."""
    draw = np.random.default_rng(seed)
    position = draw.uniform(100, 300, (vehicles, dimension))
    velocity = draw.normal(0, 2.0, position.shape)
    way = []
    for elapsed in steps:
        first, second = draw.standard_normal((2, *position.shape))
        change = 0.5 * np.sqrt(elapsed) * first
        position = (position + elapsed * velocity + elapsed / 2 * change
                    + 0.5 * np.sqrt(elapsed ** 3 / 12) * second)
        velocity = velocity + change
        way.append((elapsed, position))
    return way


@pytest.mark.parametrize('dimension', [2, 3])
def test_errors_are_as_large_as_it_says_at_any_period(dimension: int) -> None:
    draw, anchors = np.random.default_rng(3), field(dimension=dimension)
    filter_ = make(200, dimension, outliers=0.0)
    for elapsed, truth in cruise(200, dimension, [1.0] * 10 + [5.0, 1.0, 12.0, 0.5, 3.0, 2.0]):
        filter_.predict(Motion(elapsed))
        estimate = filter_.update(ranged(truth, anchors, draw))
    nees = normalized_error_squared(estimate.mean - truth, estimate.covariance)
    assert stats.kstest(nees, stats.chi2(dimension).cdf).pvalue > 1e-3
    assert np.linalg.norm(estimate.mean - truth, axis=1).mean() < 3.0


def test_a_vehicle_does_as_well_in_a_fleet_as_alone() -> None:
    anchors, way = field(), cruise(3, 3, [1.0] * 4)
    fleet, alone = make(3), make(1)
    for elapsed, truth in way:
        observation = ranged(truth, anchors, None)
        fleet.predict(Motion(elapsed))
        alone.predict(Motion(elapsed))
        together, single = fleet.update(observation), alone.update(observation.vehicle(1))
    np.testing.assert_allclose(together.mean[1], single.mean[0], rtol=1e-9)
    np.testing.assert_allclose(together.covariance[1], single.covariance[0], rtol=1e-9)


@pytest.mark.parametrize('count', [1, 2, 3])
def test_fewer_ranges_than_place_a_vehicle_leave_it_honestly_uncertain(count: int) -> None:
    anchors = field(count)
    truth = np.random.default_rng(5).uniform(50, 350, (100, 3))
    estimate = make(100).update(ranged(truth, anchors, np.random.default_rng(6)))
    nees = normalized_error_squared(estimate.mean - truth, estimate.covariance)
    assert 0.3 < nees.mean() / 3 < 1.5


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_mirror_image_is_told_by_the_covariance(dimension: int) -> None:
    anchors = field(dimension=dimension)
    anchors[:, -1] = 0.0
    truth = np.full((1, dimension), 150.0)
    estimate = make(1, dimension).update(ranged(truth, anchors, None))
    assert estimate.mean[0, -1] == pytest.approx(0.0, abs=45.0)
    assert np.sqrt(estimate.covariance[0, -1, -1]) == pytest.approx(150.0, rel=0.2)


def test_an_initial_pose_tells_which_mirror_image_it_is() -> None:
    anchors = field()
    anchors[:, 2] = 0.0
    truth = np.full((1, 3), 150.0)
    filter_ = make()
    filter_.start(Prior(0, truth[0] + 20.0, 900.0 * np.eye(3)))
    for _ in range(5):
        estimate = filter_.update(ranged(truth, anchors, None))
    np.testing.assert_allclose(estimate.mean, truth, atol=2.0)


def test_one_wild_range_in_eight_does_not_capture_it() -> None:
    draw, anchors = np.random.default_rng(3), field()
    filter_ = make(50)
    for elapsed, truth in cruise(50, 3, [1.0] * 15):
        observation = ranged(truth, anchors, draw)
        observation.range[:, 2] += 80.0
        filter_.predict(Motion(elapsed))
        estimate = filter_.update(observation)
    assert np.linalg.norm(estimate.mean - truth, axis=1).max() < 12.0
    assert not estimate.reinitialized.any()


def test_a_kidnapped_vehicle_is_found_again_and_tells() -> None:
    anchors = field()
    filter_ = make(2)
    here, there = np.full((2, 3), 100.0), np.array([[100.0] * 3, [300.0] * 3])
    for _ in range(5):
        filter_.predict(Motion(1.0))
        filter_.update(ranged(here, anchors, None))
    told = np.zeros(2, bool)
    for _ in range(8):
        filter_.predict(Motion(1.0))
        estimate = filter_.update(ranged(there, anchors, None))
        told |= estimate.reinitialized
    np.testing.assert_array_equal(told, [False, True])
    np.testing.assert_allclose(estimate.mean, there, atol=1.0)


def test_reported_covariances_of_references_count() -> None:
    anchors, truth = field(), np.full((1, 3), 200.0)
    estimates = []
    for variance in (0.0, 100.0):
        observation = ranged(truth, anchors, None)
        observation.covariance[:] = variance * np.eye(3)
        filter_ = make()
        filter_.update(observation)
        estimates.append(filter_.update(observation))
    ratio = np.trace(estimates[1].covariance[0]) / np.trace(estimates[0].covariance[0])
    assert ratio == pytest.approx((100.0 + RANGE_STD ** 2) / RANGE_STD ** 2, rel=0.05)


def test_power_alone_places_and_tracks_a_vehicle() -> None:
    draw, anchors = np.random.default_rng(3), field(10, 2) / 10
    radio = {'radio_model': 'lognormal', 'sigma_db': 3.0, 'path_loss_exponent': 2.5}
    filter_ = make(100, 2, radio=radio, motion={'acceleration_std': 0.1, 'max_speed': 1.0})
    truth = draw.uniform(5, 35, (100, 2))
    for _ in range(10):
        observation = ranged(truth, anchors, None)
        distance = observation.range.copy()
        observation.range[:] = np.nan
        observation.rssi[:] = -40 - 25 * np.log10(distance) + draw.normal(0, 3, distance.shape)
        filter_.predict(Motion(1.0))
        estimate = filter_.update(observation)
    error = np.linalg.norm(estimate.mean - truth, axis=1)
    assert np.sqrt(np.mean(error ** 2)) < 3.0
    nees = normalized_error_squared(estimate.mean - truth, estimate.covariance)
    assert 0.7 < nees.mean() / 2 < 1.5


def test_a_vehicle_that_drives_out_of_a_disk_is_not_left_behind() -> None:
    filter_ = make(1, 2, {'motion_model': 'odometry', 'odom_heading': 'known'})
    where = np.zeros(2)
    starts = np.random.default_rng(1).uniform(-510, 510, (100_000, 2))
    for step in range(30):
        observation = Observation.empty(1, 1, 2, float(step))
        observation.sender[:] = 1
        observation.position[0, 0] = [1000.0 if where[0] > 500 else 0.0, 0.0]
        observation.max_range[:] = 510.0
        if step:
            filter_.predict(Motion(1.0, np.array([[30.0, 0.0]]), np.zeros(1)))
            where = where + [30.0, 0.0]
        estimate = filter_.update(observation)
        starts = starts[np.linalg.norm(
            starts + where - observation.position[0, 0], axis=1) < 510.0]
    # Driving from disk to disk has told how far along it is, and less of how far aside.
    spread = np.sqrt(np.diagonal(estimate.covariance[0]))
    assert abs(estimate.mean[0, 0] - where[0]) < 2 * spread[0] < 250.0
    assert spread[0] < spread[1]
    assert (spread > starts.std(axis=0)).all()


def test_the_period_follows_the_residual() -> None:
    anchors, truth = field(4), np.full((2, 3), 150.0)
    filter_ = make(2, beacon_period='adaptive')
    first = filter_.update(ranged(truth, anchors, None))
    np.testing.assert_array_equal(first.period_factor, [1, 1])
    for _ in range(3):
        filter_.update(ranged(truth, anchors, None))
    off = ranged(truth, anchors, None)
    off.range[1] += 5.0
    later = filter_.update(off)
    np.testing.assert_array_equal(later.period_factor, [15, 1])
    heard_nothing = filter_.update(Observation.empty(2, 0, 3, 9.0))
    np.testing.assert_array_equal(heard_nothing.period_factor, [15, 1])


@pytest.mark.accuracy
@pytest.mark.parametrize(('count', 'noise'), [(6, 0.5), (6, 8.0), (18, 0.5), (18, 8.0)])
def test_a_normalized_residual_asks_alike_whatever_the_noise_and_the_anchors(
        count: int, noise: float) -> None:
    draw, anchors = np.random.default_rng(3), field(count)
    filter_ = make(200, outliers=0.0, radio={'range_std': noise}, beacon_period='adaptive',
                   period_residual='normalized', period_q=4.0, period_alpha=400.0)
    for elapsed, truth in cruise(200, 3, [1.0] * 12):
        observation = ranged(truth, anchors, None)
        observation.range[:] += noise * draw.standard_normal(observation.range.shape)
        filter_.predict(Motion(elapsed))
        factor = filter_.update(observation).period_factor
    assert factor is not None
    # 1 / (1 / 4 + exp(chi2 / 2) / 400) rounds to 4 below a chi2 of 5.3.
    assert (factor == 4).mean() == pytest.approx(stats.chi2(3).cdf(5.3), abs=0.08)


def turning(vehicles: int, elapsed: float) -> list[np.ndarray]:
    """Return positions of vehicles that turn by a right angle half-way."""
    way = np.zeros((vehicles, 3)) + [150.0, 150.0, 100.0]
    return [way := way + elapsed * np.eye(3)[int(step >= 15)] * 2.0 for step in range(25)]


@pytest.mark.accuracy
@pytest.mark.parametrize('elapsed', [1.0, 4.0])
def test_a_noticed_turn_costs_less(elapsed: float) -> None:
    anchors, errors = field(), []
    for notice in (False, True):
        draw = np.random.default_rng(3)
        filter_ = make(50, motion={'acceleration_std': 0.02, 'max_speed': 2.0},
                       notice_turns=notice)
        late = []
        for truth in turning(50, elapsed):
            filter_.predict(Motion(elapsed))
            estimate = filter_.update(ranged(truth, anchors, draw))
            late.append(np.linalg.norm(estimate.mean - truth, axis=1).mean())
        errors.append(np.mean(late[15:]))
    assert errors[1] < 0.8 * errors[0]


def test_turns_are_noticed_by_ranges_alone() -> None:
    anchors, spreads = field(), []
    for notice in (False, True):
        filter_ = make(motion={'acceleration_std': 0.02}, radio={'radio_model': 'disk'},
                       notice_turns=notice)
        for _ in range(3):
            filter_.predict(Motion(1.0))
            filter_.update(ranged(np.full((1, 3), 150.0), anchors, None))
        merely_heard = ranged(np.full((1, 3), 150.0), anchors[:1], None)
        merely_heard.range[:] = np.nan
        filter_.predict(Motion(1.0))
        spreads.append(filter_.update(merely_heard).covariance)
    np.testing.assert_array_equal(*spreads)


def test_turns_are_noticed_of_velocities_only() -> None:
    with pytest.raises(ConfigError, match='notice_turns: True is not allowed, must be False'):
        make(motion={'motion_model': 'random'}, notice_turns=True)


def test_nobody_asks_for_a_period_unless_told_to() -> None:
    estimate = make().update(ranged(np.full((1, 3), 150.0), field(), None))
    assert estimate.period_factor is None


def anything(draw: np.random.Generator, dimension: int) -> Observation:
    """Return four vehicles' beacons that say anything that messages may hold."""
    observation = Observation.empty(4, int(draw.integers(0, 7)), dimension, 1.0)
    shape = observation.sender.shape
    observation.sender[:] = draw.integers(-1, 4, shape)
    observation.hops[:] = draw.integers(1, 3, shape)
    observation.position[:] = draw.choice([0.0, 1.0, -300.0, 1e5], (*shape, dimension))
    variance = draw.choice([0.0, 1.0, 1e4], shape)
    observation.covariance[:] = variance[:, :, None, None] * np.eye(dimension)
    for name, low, high in (('max_range', 0.0, 1e5), ('range', 0.0, 1e5),
                            ('range_std', 0.0, 1e3), ('rssi', -200.0, 50.0)):
        measured = np.where(draw.random(shape) < 0.3, low, draw.uniform(low, high, shape))
        getattr(observation, name)[:] = np.where(draw.random(shape) < 0.4, np.nan, measured)
    return observation


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize(('motion', 'heading'), [
    ('random', 'known'), ('velocity', 'known'), ('odometry', 'known'), ('odometry', 'unknown'),
])
def test_whatever_is_heard_and_driven_it_stays_finite(
        motion: str, heading: str, dimension: int) -> None:
    draw = np.random.default_rng(8)
    for model in ('disk', 'lognormal'):
        filter_ = make(4, dimension, {'motion_model': motion, 'odom_heading': heading},
                       {'radio_model': model}, beacon_period='adaptive',
                       period_residual='sum' if model == 'disk' else 'normalized',
                       notice_turns=motion == 'velocity')
        placed = np.zeros(4, bool)
        for _ in range(5):
            observation = anything(draw, dimension)
            displacement = draw.choice([0.0, 5.0, -1e3, np.nan], (4, dimension))
            filter_.predict(Motion(float(draw.choice([0.0, 1.0, 1e3])), displacement,
                                   draw.normal(0, 1, 4)))
            estimate = filter_.update(observation)
            placed |= observation.heard.any(axis=1)
            np.testing.assert_array_equal(np.isfinite(estimate.mean).all(axis=1), placed)
            spread = np.linalg.eigvalsh(estimate.covariance[placed])
            assert (spread > -1e-6 * np.abs(spread).max(initial=1.0)).all()
            assert (np.isfinite(estimate.rotation) == (placed & (heading == 'unknown'))).all()
            assert estimate.period_factor is not None
            assert (estimate.period_factor >= 1).all()
