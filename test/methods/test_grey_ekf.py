"""What is special of the grey EKF: how it leads vehicles through outages."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.methods import METHODS
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Motion, Observation

# All of them are near the middle of the circle, so that the azimuth is that of the way.
ANCHORS = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 30.0]])


def make(method='grey_ekf', vehicles=1, **motion):
    config = METHODS[method].Config()
    model = motion_model(MotionConfig(**{'motion_model': 'velocity', **motion}), 2, False)
    channel = Channel(RadioConfig(range_std=1.0), EvidenceConfig())
    return METHODS[method](config, channel, model, vehicles, 2, np.random.default_rng(1))


def scan(stamp, positions):
    """Return the ranges of all anchors as vehicles at positions (V, 2) [m] measure them."""
    observation = Observation.empty(len(positions), len(ANCHORS), 2, stamp)
    observation.sender[:] = np.arange(len(ANCHORS))
    observation.position[:] = ANCHORS
    observation.range[:] = np.linalg.norm(positions[:, None] - ANCHORS, axis=2)
    return observation


def circle(stamp, vehicles=1):
    """Return positions (V, 2) [m] on a circle around the first anchor, at 5 m/s."""
    angle = 5 * stamp / 100 + np.arange(vehicles)
    return 100 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def followed(method, outage, vehicles=1, motion=lambda stamp: Motion(1.0)):
    """Follow vehicles for 60 s of ranges and an outage [s]; return the estimates of the latter."""
    filter_ = make(method, vehicles)
    estimates = []
    for stamp in range(60 + outage):
        if stamp:
            filter_.predict(motion(stamp))
        heard = (scan(float(stamp), circle(stamp, vehicles)) if stamp < 60
                 else Observation.empty(vehicles, 0, 2, float(stamp)))
        estimate = filter_.update(heard)
        if stamp >= 60:
            estimates.append(estimate)
    return estimates


def test_heard_or_not_it_is_an_ekf_but_for_the_outage():
    grey, plain = make('grey_ekf'), make('ekf')
    for stamp in range(12):
        for filter_ in (grey, plain):
            filter_.predict(Motion(1.0))
        one, other = (filter_.update(scan(float(stamp), circle(stamp)))
                      for filter_ in (grey, plain))
        np.testing.assert_array_equal(one.mean, other.mean)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_vehicle_that_turns_is_led_around_the_bend():
    grey, plain = followed('grey_ekf', 10)[-1], followed('ekf', 10)[-1]
    truth = circle(69.0)

    assert np.linalg.norm(grey.mean - truth) < np.linalg.norm(plain.mean - truth)


def test_the_covariance_is_that_of_the_motion_alone():
    grey, plain = followed('grey_ekf', 6), followed('ekf', 6)

    # Its gradients are those at other means, and else nothing differs.
    for one, other in zip(grey, plain, strict=True):
        np.testing.assert_allclose(one.covariance, other.covariance)
    assert (np.diff([np.trace(one.covariance[0]) for one in grey]) > 0).all()


def test_measured_displacements_are_followed_instead():
    def stand(stamp):
        return Motion(1.0, np.zeros((1, 2)), np.zeros(1))

    estimates = followed('grey_ekf', 6, motion=stand)
    plain = followed('ekf', 6, motion=stand)

    np.testing.assert_array_equal(estimates[-1].mean, plain[-1].mean)


def test_vehicles_of_a_fleet_are_led_as_each_alone():
    fleet = followed('grey_ekf', 5, vehicles=3)[-1]
    alone = followed('grey_ekf', 5)[-1]

    np.testing.assert_allclose(fleet.mean[0], alone.mean[0], rtol=1e-6)


def test_a_forgotten_vehicle_is_not_led_by_its_old_way():
    filter_ = make()
    for stamp in range(10):
        filter_.predict(Motion(1.0))
        filter_.update(scan(float(stamp), circle(stamp)))
    filter_.forget(0)
    there = filter_.update(scan(10.0, np.array([[100.0, 100.0]])))
    filter_.predict(Motion(1.0))
    after = filter_.update(Observation.empty(1, 0, 2, 11.0))

    np.testing.assert_allclose(after.mean, there.mean, atol=1e-6)
