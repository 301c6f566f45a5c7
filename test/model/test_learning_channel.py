"""What a channel learns of its radio from those who hear it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from tsmcl_ros.model.learning_channel import LearningChannel
from tsmcl_ros.model.motion import MotionConfig, RandomMotion
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Estimate, Motion, Observation


def channel(calibration: str, **radio: Any) -> LearningChannel:
    """Return a disk of 100 m without outliers."""
    return LearningChannel(
        RadioConfig(radio_range=100.0, **radio),
        EvidenceConfig(outlier_fraction=0.0, range_calibration=calibration))


def estimated(mean: np.ndarray) -> Estimate:
    vehicles = len(mean)
    nothing = np.full(vehicles, math.nan)
    return Estimate(
        stamp=1.0, mean=mean, covariance=np.tile(0.01 * np.eye(2), (vehicles, 1, 1)),
        rotation=nothing, rotation_variance=nothing, ess=nothing, particles=1,
        log_likelihood=nothing, heard=np.ones(vehicles, int),
        reinitialized=np.zeros(vehicles, bool))


def ranged_epochs(radio: LearningChannel) -> None:
    """Let vehicles calibrate a radio by ranges that are 7 % long."""
    draw = np.random.default_rng(1)
    truth = np.random.default_rng(1).uniform(-30, 30, (4, 2))
    corners = np.array([[-60, -60], [60, -60], [60, 60], [-60, 60]], float)
    radio.follow(RandomMotion(MotionConfig(max_speed=4.0)), 4, 2)
    for _ in range(100):
        truth = truth + draw.uniform(-2, 2, truth.shape)
        radio.calibration.predict(Motion(1.0))
        observation = Observation.empty(4, 4, 2, 1.0)
        observation.sender[:], observation.position[:] = range(4), corners
        distance = np.linalg.norm(truth[:, None] - corners, axis=2)
        observation.range[:] = 1.07 * distance + draw.normal(0, 0.5, (4, 4))
        observation.range_std[:] = 0.5
        radio.calibrate(observation, estimated(truth))


def test_calibration_learns_the_scale_of_ranges() -> None:
    radio = channel('online')
    ranged_epochs(radio)
    assert radio.calibration.scale == pytest.approx(1.07, abs=0.005)
    observation = Observation.empty(1, 1, 2, 1.0)
    observation.sender[:], observation.range[:], observation.range_std[:] = 0, 53.5, 0.5
    points = np.array([[[50.0, 0.0], [53.5, 0.0]]], np.float32)
    score = radio.evidence(observation).log_likelihood(points)[0]
    assert score[0] > -0.5
    assert score[1] < -10.0


def test_calibration_learns_nothing_from_asymmetric_errors() -> None:
    radio = channel('online', range_noise='asymmetric_exponential')
    ranged_epochs(radio)
    assert radio.calibration.scale == 1.0


def test_calibration_that_is_off_learns_nothing() -> None:
    radio = channel('off')
    ranged_epochs(radio)
    assert radio.calibration.scale == 1.0
