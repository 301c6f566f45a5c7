"""What is learnt of path losses while running, against what the rssi are made with."""

import numpy as np
import pytest
from tsmcl_ros.evaluation.metrics import nees_band
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import MotionConfig, OdometryMotion
from tsmcl_ros.model.power_calibration import PowerCalibration
from tsmcl_ros.types import Motion, Observation, Prior, Silence
from tsmcl_ros.world import make_world

ANCHORS = np.array([[0, 0], [60, 0], [60, 45], [0, 45], [30, 20], [10, 30]], float)
SUPPOSED = -60.0, 2.0, 3.0  # P_0 [dBm], n and sigma_db [dB]
PRIOR = 6.0, 0.5
RADIO = {'radio_model': 'lognormal', 'rssi_at_reference': -40.0, 'path_loss_exponent': 2.5,
         'sigma_db': 4.0, 'sensitivity': -120.0, 'measure_rssi': True, 'odom_heading': 'known'}


NOTHING = Evidence((), np.ones(1), np.zeros(1), np.ones(1, bool), lambda: None)


def calibration(vehicles=1, anchor_std=0.1, time=1e4, sigma_share=0.1):
    found = PowerCalibration(PRIOR, anchor_std, time, sigma_share)
    found.follow(OdometryMotion(MotionConfig(odom_heading='known')), vehicles, 2, 0.02)
    return found


def place(epoch, vehicles):
    """Return where vehicles (V, 2) are, each on a circle of its own [m]."""
    turn = epoch / 20 + np.arange(vehicles)
    return np.stack([30 + 25 * np.cos(turn), 22 + 20 * np.sin(turn)], axis=1)


def drive(found, epochs, vehicles=1, off=(0.0, 0.0), anchors=0.0, least=-np.inf, is_mapped=False,
          noise=1.0, watch=lambda here: None):
    """
    Let vehicles drive among anchors whose path losses are off, and return the calibration.

    The anchors (epochs, 6) or (6,) are off for themselves. Of a map are those that are silent.
    """
    rng = np.random.default_rng(0)
    sender = np.tile(np.arange(len(ANCHORS)), (vehicles, 1))
    position = np.tile(ANCHORS, (vehicles, 1, 1))
    reference, exponent, sigma = SUPPOSED
    loss = tuple(np.full(sender.shape, part) for part in SUPPOSED)
    anchors = np.broadcast_to(anchors, (epochs, len(ANCHORS)))
    for epoch in range(epochs):
        here = place(epoch, vehicles)
        found.predict(Motion(1.0, here - place(epoch - 1, vehicles), np.zeros(vehicles)))
        distance = np.linalg.norm(ANCHORS - here[:, None], axis=2)
        rssi = (reference + off[0] + anchors[epoch]
                - 10 * (exponent + off[1]) * np.log10(distance)
                + noise * sigma * rng.standard_normal(distance.shape))
        silent = Silence(rssi < least, sender, position, np.full(sender.shape, np.nan))
        found.learn(sender, position, rssi, rssi >= least, loss, least, NOTHING,
                    *((silent, loss) if is_mapped else ()))
        watch(here)
    return found


def nees(anchor_std, time):
    """Return the mean NEES of a vehicle whose anchors' shadowing of 4 dB stays for 10 s."""
    rng, shadowing = np.random.default_rng(1), [4 * np.ones(len(ANCHORS))]
    for _ in range(59):
        shadowing.append(np.exp(-0.1) * shadowing[-1] + 4 * np.sqrt(
            1 - np.exp(-0.2)) * rng.standard_normal(len(ANCHORS)))
    found, squared = calibration(3, anchor_std, time), []

    def watch(here):
        mean, covariance = found.pose
        error = (mean - here)[:, :, None]
        squared.append((error * np.linalg.solve(covariance, error)).sum(axis=(1, 2)))

    drive(found, 60, 3, anchors=np.array(shadowing), watch=watch)
    return np.mean(squared[10:])


def test_it_is_honest_about_vehicles_whose_anchors_stay_shadowed():
    low, high = nees_band(2, 15)  # three vehicles, of 50 s that forget in 10 s what they were
    assert low < nees(4.0, 10.0) < high < nees(0.1, 10.0)


@pytest.mark.parametrize('off', [(0.0, 0.0), (6.0, 0.5), (-6.0, -0.5), (6.0, -0.5)])
def test_what_p_0_and_n_are_off_is_found_to_within_what_it_says(off):
    found = drive(calibration(2), 40, 2, off=off)
    error = found.mean - off
    assert error @ np.linalg.solve(found.covariance, error) < 9.2  # 99 %
    assert np.sqrt(found.covariance[0, 0]) < 2.0
    assert np.sqrt(found.covariance[1, 1]) < 0.15


def test_p_0_is_found_where_only_the_loud_are_heard():
    found = drive(calibration(2), 40, 2, off=(3.0, 0.0), least=-91.0)
    error = found.mean - (3.0, 0.0)
    assert error @ np.linalg.solve(found.covariance, error) < 9.2


def test_who_is_silent_tells_of_p_0():
    told, untold = (drive(calibration(), 20, off=(3.0, 0.0), least=-91.0, is_mapped=is_mapped)
                    for is_mapped in (True, False))
    assert told.covariance[0, 0] < 0.8 * untold.covariance[0, 0]
    assert told.mean[0] == pytest.approx(3.0, abs=2.5 * np.sqrt(told.covariance[0, 0]))


@pytest.mark.parametrize('noise', [0.6, 1.0, 1.5])
def test_the_noise_of_rssi_is_found(noise):
    found = drive(calibration(2), 40, 2, noise=noise)
    assert found.sigma == pytest.approx(noise, rel=0.15)


def test_a_vehicle_is_where_it_is_told_to_be_before_it_has_heard_three():
    found = calibration(2)
    found.start(Prior(1, np.array([20.0, 30.0]), np.eye(2)))
    drive(found, 1, 2, least=np.inf)
    mean, covariance = found.pose
    np.testing.assert_allclose(mean[1], [20, 30] + place(0, 2)[1] - place(-1, 2)[1], atol=0.3)
    assert np.trace(covariance[1]) < 4


def test_a_fleet_knows_better_than_one_alone():
    alone = drive(calibration(), 20)
    together = drive(calibration(6), 20, 6)
    assert np.linalg.det(together.covariance) < 0.2 * np.linalg.det(alone.covariance)


def test_what_was_learnt_serves_another_one():
    before, after = drive(calibration(), 40, off=(6.0, 0.5), noise=1.5), calibration()
    assert after.learnt is None
    after.resume(before.learnt)
    np.testing.assert_array_equal(after.mean, before.mean)
    assert after.sigma == pytest.approx(before.sigma)
    for place in range(2):
        known, begun, prior = (of[place, place] for of in (
            before.covariance, after.covariance, np.diag(np.square(PRIOR))))
        assert known < begun < 0.2 * prior
    assert after.learnt is None


def test_it_goes_on_from_what_was_learnt():
    before, after = drive(calibration(), 40, off=(6.0, 0.5)), calibration(2)
    after.resume(before.learnt)
    after.follow(OdometryMotion(MotionConfig(odom_heading='known')), 2, 2, 0.02)
    begun = after.covariance
    drive(after, 10, 2, off=(6.0, 0.5))
    error = after.mean - (6.0, 0.5)
    assert error @ np.linalg.solve(after.covariance, error) < 9.2
    assert np.linalg.det(after.covariance) < np.linalg.det(begun)


def test_what_was_learnt_counts_once_for_all_who_are_followed_anew():
    found = drive(calibration(6), 40, 6)
    before = found.learnt
    found.follow(OdometryMotion(MotionConfig(odom_heading='known')), 6, 2, 0.02)
    np.testing.assert_array_equal(found.mean, before.mean)
    begun = found.covariance
    drive(found, 1, 6)
    # One epoch more tells a little; what six knew before, counted six times, would tell much.
    assert (np.diag(found.covariance) > 0.3 * np.diag(begun)).all()


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
        found.learn(sender, ANCHORS[None], np.full((1, 6), -85.0), sender >= 0, loss, -np.inf,
                    NOTHING)
    off = found.of(np.arange(60)[None])[0]
    np.testing.assert_array_equal(off[:42], 0)
    assert (off[54:] != 0).all()
    assert np.isfinite(off).all()


def rmse(settings, seed=1, epochs=24, vehicles=2):
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


def test_a_place_that_is_told_ahead_of_the_first_rssi_is_kept():
    world = make_world({**RADIO, 'vehicles': 1, 'odom_noise': 0.5}, np.random.default_rng(1))
    localizer = Localizer({**RADIO, 'odom_std': 0.5, 'rssi_calibration': 'online'})
    localizer.anchor_map(world.anchors)
    epoch = world.step()
    localizer.initial_pose(Prior(0, epoch.position[0], np.eye(2)))
    found = localizer.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
    np.testing.assert_allclose(found.mean, epoch.position, atol=4.0)


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


def test_a_vehicle_that_is_to_be_placed_anew_is_nowhere_until_it_hears_something():
    _, localizer = rmse({'rssi_calibration': 'online'}, epochs=6)
    localizer.reinitialize(1)
    estimate = localizer.epoch(Observation.empty(2, 0, 2, localizer.estimate.stamp + 1))
    np.testing.assert_array_equal(np.isnan(estimate.mean).any(axis=1), [False, True])


def test_poses_are_those_that_are_estimated_with_what_rssi_are_off():
    _, localizer = rmse({'rssi_calibration': 'online'}, epochs=6)
    mean, covariance = localizer.channel.powers.pose
    np.testing.assert_array_equal(localizer.estimate.mean, mean)
    np.testing.assert_array_equal(localizer.estimate.covariance, covariance)
