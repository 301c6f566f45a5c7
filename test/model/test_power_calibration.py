"""What is learnt of path losses while running, against what the rssi are made with."""

import numpy as np
import pytest
import scipy
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.motion import MotionConfig, OdometryMotion
from tsmcl_ros.model.power_calibration import _beyond, PowerCalibration
from tsmcl_ros.types import Motion
from tsmcl_ros.world import make_world

ANCHORS = np.array([[0, 0], [60, 0], [60, 45], [0, 45], [30, 20], [10, 30]], float)
SUPPOSED = -60.0, 2.0, 3.0  # P_0 [dBm], n and sigma_db [dB]
PRIOR = 6.0, 0.5
RADIO = {'radio_model': 'lognormal', 'rssi_at_reference': -40.0, 'path_loss_exponent': 2.5,
         'sigma_db': 4.0, 'sensitivity': -120.0, 'measure_rssi': True, 'odom_heading': 'known'}


def calibration(vehicles=1, anchor_std=0.1, time=1e4):
    found = PowerCalibration(PRIOR, anchor_std, time)
    found.follow(OdometryMotion(MotionConfig(odom_heading='known')), vehicles, 2, 0.02)
    return found


def place(epoch, vehicles):
    """Return where vehicles (V, 2) are, each on a circle of its own [m]."""
    turn = epoch / 20 + np.arange(vehicles)
    return np.stack([30 + 25 * np.cos(turn), 22 + 20 * np.sin(turn)], axis=1)


def drive(found, epochs, vehicles=1, start=0, off=(0.0, 0.0), anchors=0.0, least=-np.inf):
    """Let vehicles drive among anchors whose path losses are off, and return the calibration."""
    rng = np.random.default_rng(start)
    sender = np.tile(np.arange(len(ANCHORS)), (vehicles, 1))
    reference, exponent, sigma = SUPPOSED
    loss = tuple(np.full(sender.shape, part) for part in SUPPOSED)
    for epoch in range(start, start + epochs):
        here = place(epoch, vehicles)
        found.predict(Motion(1.0, here - place(epoch - 1, vehicles), np.zeros(vehicles)))
        distance = np.linalg.norm(ANCHORS - here[:, None], axis=2)
        rssi = (reference + off[0] + anchors - 10 * (exponent + off[1]) * np.log10(distance)
                + sigma * rng.standard_normal(distance.shape))
        found.learn(sender, np.tile(ANCHORS, (vehicles, 1, 1)), rssi, rssi >= least, loss, least)
    return found


@pytest.mark.parametrize('off', [(0.0, 0.0), (6.0, 0.5), (-6.0, -0.5), (6.0, -0.5)])
def test_what_p_0_and_n_are_off_is_found_to_within_what_it_says(off):
    found = drive(calibration(3), 80, 3, off=off)
    error = found.mean - off
    assert error @ np.linalg.solve(found.covariance, error) < 9.2  # 99 %
    assert np.sqrt(found.covariance[0, 0]) < 2.0
    assert np.sqrt(found.covariance[1, 1]) < 0.15


def test_p_0_is_found_where_only_the_loud_are_heard():
    found = drive(calibration(3), 80, 3, off=(3.0, 0.0), least=-91.0)
    error = found.mean - (3.0, 0.0)
    assert error @ np.linalg.solve(found.covariance, error) < 9.2


def test_moments_of_the_loud_are_those_of_a_truncated_normal():
    excess = np.array([-2.0, 0.0, 1.5])
    mean, variance = _beyond(excess)
    truth = scipy.stats.truncnorm(-excess, np.inf)
    np.testing.assert_allclose(mean, truth.mean())
    np.testing.assert_allclose(variance, truth.var(), rtol=1e-6)
    np.testing.assert_allclose(_beyond(np.array([np.inf])), [[0], [1]], atol=1e-12)


def test_a_fleet_knows_better_than_one_alone():
    alone = drive(calibration(), 30)
    together = drive(calibration(8), 30, 8)
    assert np.linalg.det(together.covariance) < 0.2 * np.linalg.det(alone.covariance)


def test_an_anchor_of_another_power_is_found_out_and_forgotten():
    another = np.array([8.0, 0, 0, 0, 0, 0])
    found = drive(calibration(anchor_std=4.0, time=1000.0), 80, anchors=another)
    off = found.of(np.arange(6)[None])[0]
    assert off[0] - off[1:].mean() == pytest.approx(8.0, abs=3.0)
    found.predict(Motion(1e5, np.zeros((1, 2)), np.zeros(1)))
    assert np.abs(found.of(np.arange(6)[None])).max() < 0.5


def test_nothing_is_known_of_an_anchor_that_was_never_heard():
    found = drive(calibration(anchor_std=4.0), 5)
    np.testing.assert_array_equal(found.of(np.array([[77, -1]])), 0)


def test_more_anchors_than_it_remembers_take_the_place_of_those_heard_longest_ago():
    found = calibration(anchor_std=4.0)
    for first in range(0, 60, 6):
        found.predict(Motion(1.0, np.zeros((1, 2)), np.zeros(1)))
        sender = np.arange(first, first + 6)[None]
        loss = tuple(np.full((1, 6), part) for part in SUPPOSED)
        found.learn(sender, ANCHORS[None], np.full((1, 6), -85.0), sender >= 0, loss, -np.inf)
    off = found.of(np.arange(60)[None])[0]
    np.testing.assert_array_equal(off[:42], 0)
    assert (off[54:] != 0).all()
    assert np.isfinite(off).all()


def rmse(settings, seed=1, epochs=60, vehicles=3):
    """Return the error [m] of vehicles with odometry, of their second half."""
    world = make_world({**RADIO, 'vehicles': vehicles, 'odom_noise': 0.5},
                       np.random.default_rng(seed))
    localizer = Localizer({**RADIO, 'odom_std': 0.5, 'seed': seed, **settings}, vehicles)
    localizer.anchor_map(world.anchors)
    squared = []
    for _ in range(epochs):
        epoch = world.step()
        estimate = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
        squared.append(np.square(estimate.mean - epoch.position).sum(axis=1))
    return np.sqrt(np.mean(squared[epochs // 2:])), localizer


@pytest.mark.parametrize(('p_0', 'n'), [(6.0, 0.0), (0.0, 0.5)])
def test_vehicles_are_localized_by_path_losses_that_are_wrong_at_first(p_0, n):
    wrong = {'rssi_at_reference': -40.0 + p_0, 'path_loss_exponent': 2.5 + n}
    fixed, _ = rmse(wrong)
    learnt, localizer = rmse({**wrong, 'rssi_calibration': 'online'})
    assert learnt < 0.2 * fixed
    assert localizer.channel.path_loss(np.array(-1)).exponent == pytest.approx(2.5, abs=0.3)


def test_it_can_be_switched_on_and_off_while_running():
    _, localizer = rmse({'rssi_calibration': 'online'}, epochs=6)
    learnt = localizer.channel.path_loss(np.array(-1))
    localizer.reconfigure({'rssi_calibration': 'off'})
    assert localizer.channel.path_loss(np.array(-1)).reference == -40.0
    localizer.reconfigure({'rssi_calibration': 'online'})
    assert localizer.channel.path_loss(np.array(-1)).reference == learnt.reference != -40.0


def test_what_it_has_learnt_is_told_with_how_well_it_is_known():
    _, localizer = rmse({'rssi_calibration': 'online', 'range_calibration': 'off'}, epochs=6)
    told = localizer.channel.calibrated()
    assert told.keys() == {'P_0 [dBm]', 'path loss exponent'}
    assert all(len(text.split(' +- ')) == 2 for text in told.values())
