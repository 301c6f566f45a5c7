"""A vehicle that is certain of a wrong place finds back, by ranges alone."""

import numpy as np
import pytest
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.types import Observation, Prior

VEHICLES, TRUTH = 10, np.array([50.0, 50.0])
ANCHORS = np.array([[5, 10], [90, 15], [80, 95], [10, 80], [45, 5]], np.float32)


def ranges(stamp: float, rng: np.random.Generator) -> Observation:
    heard = Observation.empty(VEHICLES, len(ANCHORS), 2, stamp)
    heard.sender[:], heard.position[:], heard.range_std[:] = range(len(ANCHORS)), ANCHORS, 1.0
    noise = rng.standard_normal(heard.range.shape)
    heard.range[:] = np.linalg.norm(ANCHORS - TRUTH, axis=1) + noise
    return heard


def follow(method: str, epochs: int, **settings: object) -> tuple[np.ndarray, int]:
    """Start 57 m off with a standard deviation of 0.5 m; return errors [m] and placings anew."""
    localizer = Localizer(
        {'method': method, 'motion_model': 'odometry', 'odom_heading': 'known'} | settings,
        VEHICLES)
    for vehicle in range(VEHICLES):
        localizer.initial_pose(Prior(vehicle, np.array([10.0, 10.0]), np.eye(2) * 0.25, 0.0, 0.1))
    rng, again = np.random.default_rng(3), 0
    still = np.zeros((VEHICLES, 2)), np.zeros(VEHICLES)
    for stamp in range(epochs):
        estimate = localizer.epoch(ranges(float(stamp), rng), *still)
        again += int(estimate.reinitialized.sum())
    return np.linalg.norm(estimate.mean - TRUTH, axis=1), again


@pytest.mark.accuracy
@pytest.mark.parametrize('method', ['ts_mcl', 'mcl', 'mcb', 'r_mcl'])
def test_a_wrong_start_is_left_within_ten_epochs(method: str) -> None:
    error, _ = follow(method, 10)
    assert error.max() < 5.0


@pytest.mark.accuracy
@pytest.mark.parametrize('method', ['ts_mcl', 'mcl', 'mcb', 'r_mcl'])
def test_it_takes_one_placing_a_vehicle(method: str) -> None:
    assert follow(method, 30)[1] == VEHICLES


def test_patience_says_after_how_many_epochs() -> None:
    assert follow('mcl', 6, patience=7)[1] == 0
    assert follow('mcl', 7, patience=7)[1] == VEHICLES
