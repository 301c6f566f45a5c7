"""What is learnt of a ranging radio's scale and offset, against what the ranges are made with."""

import numpy as np
import pytest
from tsmcl_ros.model.calibration import RangeCalibration
from tsmcl_ros.model.kinematics import kinematics_of
from tsmcl_ros.model.motion import MotionConfig, OdometryMotion
from tsmcl_ros.types import Estimate, Motion, Observation

ANCHORS = np.array([[0, 0], [60, 0], [60, 45], [0, 45]], float)
STD = 0.5  # m, of the ranges
PRIOR = 0.1, 0.5


def estimate(mean, variance=1.0, reinitialized=False, rotation=np.nan, rotation_variance=np.nan):
    """Return an estimate of V vehicles at mean (V, 2) [m]."""
    vehicles = len(mean)
    unknown = np.full(vehicles, np.nan)
    return Estimate(
        0.0, np.asarray(mean, float), variance * np.broadcast_to(np.eye(2), (vehicles, 2, 2)),
        np.full(vehicles, rotation), np.full(vehicles, rotation_variance), unknown, 0, unknown,
        np.full(vehicles, 4), np.full(vehicles, reinitialized))


def ranges(mean, scale=1.07, bias=0.3, rng=None):
    """Return what radios at mean (V, 2) measure of the anchors."""
    mean = np.asarray(mean, float)
    observation = Observation.empty(len(mean), 4, 2, 0.0)
    observation.sender[:] = range(4)
    observation.position[:] = ANCHORS
    distance = np.linalg.norm(ANCHORS - mean[:, None], axis=2)
    noise = 0 if rng is None else STD * rng.standard_normal(distance.shape)
    observation.range[:] = scale * distance + bias + noise
    return observation


def taken(observation):
    """Return standard deviations, and which ranges count, all of them to anchors."""
    used = observation.heard & ~np.isnan(observation.range)
    return np.full(used.shape, STD), used, used


def place(epoch, vehicles):
    """Return where vehicles (V, 2) are, each on a circle of its own [m]."""
    turn = epoch / 20 + np.arange(vehicles)
    return np.stack([30 + 18 * np.cos(turn), 22 + 15 * np.sin(turn)], axis=1)


def calibration(vehicles=1, scale=1.0, bias=0.0, heading='unknown'):
    found = RangeCalibration(scale, bias, PRIOR)
    motion = OdometryMotion(MotionConfig(odom_heading=heading))
    found.follow(kinematics_of(motion, 2), vehicles, 2, 0.02)
    return found


def drive(found, epochs, vehicles=1, start=0, change=lambda observation: None, shift=3.0,
          variance=9.0, seed=0, **truth):
    """Let vehicles drive whose estimates are off by a shift [m], as those of wrong ranges are."""
    rng = np.random.default_rng(seed)
    for epoch in range(start, start + epochs):
        now, before = place(epoch, vehicles), place(epoch - 1, vehicles)
        found.predict(Motion(1.0, now - before, np.full(vehicles, 0.05)))
        observation = ranges(now, rng=rng, **truth)
        change(observation)
        found.learn(observation, estimate(now + shift, variance), *taken(observation))
    return found


def test_it_starts_from_what_is_configured():
    found = calibration(scale=1.02, bias=-0.4)
    assert (found.scale, found.bias) == (1.02, -0.4)


@pytest.mark.accuracy
@pytest.mark.parametrize(('scale', 'bias', 'vehicles'), [
    (1.07, 0.3, 1), (1.07, 0.3, 10), (1.0, 0.0, 10), (0.93, 0.5, 10), (1.1, -0.5, 10),
    (1.0, 0.8, 10)])
def test_scale_and_offset_are_recovered_though_the_estimates_are_wrong(scale, bias, vehicles):
    found = drive(calibration(vehicles), 500 // vehicles, vehicles, scale=scale, bias=bias)
    # 0.5 m over sqrt(2000) ranges of distances that spread by 15 m, the places unknown.
    assert found.scale == pytest.approx(scale, abs=0.01)
    assert found.bias == pytest.approx(bias, abs=0.3)


@pytest.mark.accuracy
def test_it_tells_how_well_it_is_known():
    errors = []
    for seed in range(12):
        found = drive(calibration(), 60, seed=seed, scale=1.07, bias=0.3)
        off = np.array([found.scale - 1.07, found.bias - 0.3])
        errors.append(off @ np.linalg.solve(found.covariance, off))
    # The mean of 12 chi-square values of 2 degrees of freedom, in its 99.8 % band.
    assert 0.5 < np.mean(errors) < 4.3


def test_the_prior_is_what_is_left_before_ranges_tell():
    found = calibration()
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), PRIOR)
    assert found.variance(np.array(10.0)) == pytest.approx(1.0 ** 2 + 0.5 ** 2)


def test_a_vehicle_that_stands_tells_the_scale_by_ranges_all_around():
    found = calibration()
    rng = np.random.default_rng(3)
    stand = np.array([[22.0, 15.0]])
    for _ in range(60):
        found.predict(Motion(1.0, np.zeros((1, 2)), np.zeros(1)))
        observation = ranges(stand, bias=0.0, rng=rng)
        found.learn(observation, estimate(stand + 2, 4.0), *taken(observation))
    assert found.scale == pytest.approx(1.07, abs=0.02)


def test_a_fleet_knows_more_than_one_vehicle():
    alone = drive(calibration(), 30)
    together = drive(calibration(10), 30, vehicles=10)
    assert together.covariance[0, 0] < 0.5 * alone.covariance[0, 0]
    assert together.scale == pytest.approx(1.07, abs=0.01)


@pytest.mark.accuracy
def test_it_follows_a_radio_that_changes():
    found = drive(calibration(10), 60, vehicles=10, scale=1.05)
    drive(found, 600, vehicles=10, scale=1.04, start=60, seed=1)
    assert found.scale == pytest.approx(1.04, abs=0.004)


@pytest.mark.accuracy
def test_outliers_are_ignored():
    clean = drive(calibration(), 300)

    def spoil(observation):
        if round(float(observation.range[0, 0] * 1000)) % 10 == 0:
            observation.range[0, 1] += 25

    spoilt = drive(calibration(), 300, change=spoil)
    assert spoilt.scale == pytest.approx(clean.scale, abs=0.005)
    assert spoilt.bias == pytest.approx(clean.bias, abs=0.15)


def test_a_vehicle_on_a_circle_does_not_take_part():
    found = drive(calibration(), 20, variance=900.0)
    assert (found.scale, found.bias) == (1.0, 0.0)


def test_ranges_to_vehicles_alone_teach_nothing():
    found = calibration()
    for epoch in range(20):
        now = place(epoch, 1)
        observation = ranges(now)
        found.learn(observation, estimate(now), *taken(observation)[:2], np.zeros((1, 4), bool))
    assert (found.scale, found.bias) == (1.0, 0.0)


@pytest.mark.parametrize('missing', ['place', 'range', 'sender'])
def test_what_is_not_known_teaches_nothing(missing):
    found = calibration()
    for epoch in range(5):
        now = place(epoch, 1)
        observation = ranges(now)
        if missing == 'place':
            now[:] = np.nan
        elif missing == 'range':
            observation.range[:] = np.nan
        else:
            observation.sender[:] = -1
        variance = np.nan if missing == 'place' else 0.01
        found.learn(observation, estimate(now, variance), *taken(observation))
    assert (found.scale, found.bias) == (1.0, 0.0)


def test_a_vehicle_on_top_of_an_anchor_does_no_harm():
    found = calibration()
    for _ in range(3):
        observation = ranges(ANCHORS[:1])
        found.learn(observation, estimate(ANCHORS[:1]), *taken(observation))
    assert np.isfinite([found.scale, found.bias]).all()


@pytest.mark.accuracy
def test_what_was_learnt_outlives_a_vehicle_that_is_placed_anew():
    found = drive(calibration(), 200)
    before = found.scale
    now = place(200, 1)
    observation = ranges(now)
    found.learn(observation, estimate(now + 30, reinitialized=True), *taken(observation))
    assert found.scale == pytest.approx(before, abs=1e-3)
    assert drive(found, 100, start=201).scale == pytest.approx(1.07, abs=0.01)


def test_what_was_learnt_serves_another_one():
    before = drive(calibration(), 200)
    after = calibration()
    assert after.learnt is None
    after.resume(before.learnt)
    assert (after.scale, after.bias) == (before.scale, before.bias)
    assert before.covariance[0, 0] < after.covariance[0, 0] < 0.05 ** 2
    assert drive(after, 20, start=200).scale == pytest.approx(1.07, abs=0.015)


def test_what_was_learnt_is_kept_where_vehicles_are_followed_anew():
    found = drive(calibration(), 200)
    before = found.scale
    found.follow(kinematics_of(OdometryMotion(MotionConfig()), 2), 1, 2, 0.02)
    assert found.scale == before
    assert drive(found, 1, start=200).scale == pytest.approx(before, abs=0.005)


# --- place and calibration at once ------------------------------------------------------------

WIDE = 1000 * np.array([[0, 0], [1, 0.1], [0.9, 1], [0, 1.1], [0.5, 0.6], [0.2, 0.4]])


def wide(scale=1.1, place=(400.0, 700.0), rows=6):
    """Return what a radio far from its anchors measures of the first of them."""
    observation = Observation.empty(1, rows, 2, 0.0)
    observation.sender[:] = range(rows)
    observation.position[:] = WIDE[:rows]
    observation.range[:] = scale * np.linalg.norm(WIDE[:rows] - place, axis=1)
    return observation


def test_one_epoch_of_many_ranges_tells_the_scale():
    found = calibration()
    observation = wide()
    found.locate(observation, *taken(observation)[:2])
    assert found.scale == pytest.approx(1.1, abs=1e-3)
    assert found.covariance[0, 0] < 0.003 ** 2


def test_what_an_epoch_has_told_is_not_learnt_twice():
    found = calibration()
    observation = wide()
    found.locate(observation, *taken(observation)[:2])
    before = found.covariance
    found.learn(observation, estimate([[400.0, 700.0]]), *taken(observation))
    # But for the little that is forgotten.
    np.testing.assert_allclose(found.covariance, before, rtol=0.05)


def test_what_comes_after_is_learnt_from_where_the_vehicle_was_located():
    found = calibration()
    for _ in range(2):
        observation = wide()
        found.locate(observation, *taken(observation)[:2])
        before = found.covariance
        found.predict(Motion(1.0, np.zeros((1, 2)), np.zeros(1)))
        found.learn(observation, estimate([[400.0, 700.0]]), *taken(observation))
    assert found.covariance[0, 0] < 0.7 * before[0, 0]


@pytest.mark.parametrize('why', ['few', 'noisy', 'contradicting'])
def test_ranges_do_not_tell_place_and_scale_at_once_if(why):
    found = calibration()
    observation = wide(rows=4 if why == 'few' else 6)
    std = np.full(observation.range.shape, 150.0 if why == 'noisy' else STD)
    if why == 'contradicting':
        observation.range[0, :3] += [300.0, -200.0, 150.0]
    found.locate(observation, std, observation.heard)
    assert (found.scale, found.bias) == (1.0, 0.0)
    assert not found.is_taught


# --- a second opinion of the heading ----------------------------------------------------------

@pytest.mark.accuracy
def test_a_heading_that_went_astray_is_put_right():
    found = drive(calibration(), 200)
    now = place(199, 1)
    [better] = found.opinions(estimate(now, 0.1, rotation=1.0, rotation_variance=0.05 ** 2))
    assert better.vehicle == 0
    assert better.yaw == pytest.approx(0.0, abs=0.1)
    np.testing.assert_allclose(better.mean, now[0], atol=1.0)


@pytest.mark.accuracy
def test_a_heading_that_nobody_knows_is_told():
    found = drive(calibration(), 200)
    assert len(found.opinions(estimate(place(199, 1), rotation=0.0, rotation_variance=4.0))) == 1


@pytest.mark.accuracy
@pytest.mark.parametrize(('rotation', 'variance'), [(0.0, 0.01 ** 2), (np.nan, np.nan)])
def test_there_is_no_opinion_where_the_heading_is_right_or_no_question(rotation, variance):
    found = drive(calibration(), 200)
    assert not found.opinions(
        estimate(place(199, 1), rotation=rotation, rotation_variance=variance))


def test_there_is_no_opinion_before_the_vehicle_has_moved():
    found = calibration()
    stand = np.array([[22.0, 15.0]])
    for _ in range(20):
        found.predict(Motion(1.0, np.zeros((1, 2)), np.zeros(1)))
        observation = ranges(stand)
        found.learn(observation, estimate(stand), *taken(observation))
    assert not found.opinions(estimate(stand, rotation=0.0, rotation_variance=3.0))
