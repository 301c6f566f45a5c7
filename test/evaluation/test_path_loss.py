"""Fits of path losses, against the parameters that the samples were drawn with."""

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.config import build, load_yaml
from tsmcl_ros.csv_log import CsvLog
from tsmcl_ros.evaluation.path_loss import (
    as_parameters,
    Fit,
    fit,
    fit_anchors,
    gather,
    join,
    MIN_BEACONS,
    Samples,
)
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import PathLoss, RadioConfig
from tsmcl_ros.types import LogError, Observation, Trajectory


def draw(count, reference=-50.0, exponent=2.5, sigma=4.0, seed=0, sender=1):
    """Return samples from the channel that simulates the radio."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(1, 30, count)
    radio = RadioConfig(
        radio_model='lognormal', rssi_at_reference=reference, path_loss_exponent=exponent,
        sigma_db=sigma, sensitivity=-200.0, measure_rssi=True)
    rssi = Channel(radio).hear(distance[None], rng).rssi[0].astype(float)
    return Samples(np.full(count, sender), distance, rssi)


def straight_log(stamp, rssi, anchor=(0.0, 0.0, 2.0)):
    """Return a log of somebody who walks along x at 1 m/s from t = 0 to 10, past one anchor."""
    anchors = Observation.empty(1, 1, 3, 0.0)
    anchors.sender[0], anchors.position[0, 0] = 7, anchor
    truth = Trajectory(
        np.array([0.0, 10.0]), np.array([[0.0, 3.0, 1.0], [10.0, 3.0, 1.0]]), np.full(2, np.nan))
    stamp = np.asarray(stamp, float)
    return CsvLog(
        anchors, stamp, np.full(len(stamp), 7), np.full(len(stamp), np.nan),
        np.asarray(rssi, float), None, truth, ())


def test_a_fit_finds_the_parameters_that_a_channel_simulates_with():
    samples = draw(20_000)
    found = fit(samples.distance, samples.rssi)
    # Four standard errors of each: sigma / sqrt(20000) is 0.03, over a spread of 0.3 decades.
    assert found.reference == pytest.approx(-50, abs=0.5)
    assert found.exponent == pytest.approx(2.5, abs=0.04)
    assert found.sigma == pytest.approx(4, abs=0.08)
    assert found.beacons == 20_000


def test_a_fit_is_the_least_squares_line_of_numpy():
    samples = draw(100)
    found = fit(samples.distance, samples.rssi)
    slope, offset = np.polyfit(np.log10(samples.distance), samples.rssi, 1)
    assert (found.exponent, found.reference) == pytest.approx((-slope / 10, offset), rel=1e-9)


def test_a_sigma_is_never_below_what_rounding_makes():
    distance = np.geomspace(1, 30, 50)
    assert fit(distance, -40 - 20 * np.log10(distance)).sigma == 0.3


def test_too_few_beacons_are_refused():
    samples = draw(MIN_BEACONS - 1)
    with pytest.raises(LogError, match='19 beacons are too few, must be at least 20'):
        fit(samples.distance, samples.rssi)


def test_power_that_grows_with_distance_is_refused():
    distance = np.geomspace(1, 30, 50)
    with pytest.raises(LogError, match=r'exponent -2\.00 is not allowed, must be above 0 and at'):
        fit(distance, -80 + 20 * np.log10(distance))


def test_a_single_distance_is_refused():
    with pytest.raises(LogError, match='all beacons are from one distance'):
        fit(np.full(50, 3.0), np.linspace(-60, -50, 50))


def test_each_anchor_gets_its_own_path_loss():
    pooled, single, left = fit_anchors(join([
        draw(5000, -45, 2, sender=3), draw(5000, -60, 3, seed=1, sender=1)]))
    assert list(single) == [1, 3]
    assert left == {}
    assert single[3].exponent == pytest.approx(2, abs=0.1)
    assert single[1].exponent == pytest.approx(3, abs=0.1)
    assert 2 < pooled.exponent < 3
    assert pooled.beacons == 10_000


def test_an_anchor_that_cannot_be_fitted_is_left_to_the_pooled_one():
    wrong = draw(50, sender=2)
    parts = [draw(500), replace(wrong, rssi=-100 - wrong.rssi), draw(3, sender=5)]
    pooled, single, left = fit_anchors(join(parts))
    assert list(single) == [1]
    assert left[2].startswith('the path loss exponent -')
    assert left[5] == '3 beacons are too few, must be at least 20'
    assert pooled.beacons == 553


def test_distances_are_horizontal_and_from_the_truth_interpolated():
    samples = gather(straight_log([0.0, 4.0], [-60, -61]))
    np.testing.assert_allclose(samples.distance, [3, 5])
    np.testing.assert_array_equal(samples.rssi, [-60, -61])
    np.testing.assert_array_equal(samples.sender, [7, 7])


def test_short_distances_are_clipped():
    samples = gather(straight_log([0.0, 4.0], [-60, -61], anchor=(4.0, 3.0, 9.0)), 0.7)
    np.testing.assert_allclose(samples.distance, [4, 0.7])


def test_beacons_outside_of_the_truths_time_or_without_rssi_are_left_out():
    samples = gather(straight_log([0.0, 4.0, 10.0, 10.1], [-60, np.nan, -62, -63]))
    np.testing.assert_array_equal(samples.rssi, [-60, -62])


def test_a_log_without_rssi_is_refused():
    with pytest.raises(LogError, match='no beacon with an rssi within the time of the truth'):
        gather(straight_log([1.0], [np.nan]))


def test_a_log_without_truth_is_refused():
    with pytest.raises(LogError, match=r'has no truth\.csv'):
        gather(replace(straight_log([1.0], [-60]), truth=None))


def test_what_is_written_are_parameters_of_the_radio(tmp_path):
    path = tmp_path / 'radio.yaml'
    path.write_text(as_parameters(
        Fit(-61.66, 1.436, 6.07, 99), {12: Fit(-57.5, 2.456, 5.8, 9), 3: Fit(-60, 2, 4, 9)}, 1.5))
    radio = build(RadioConfig, load_yaml(path))
    assert radio == RadioConfig(
        radio_model='lognormal', rssi_at_reference=-61.7, path_loss_exponent=1.44, sigma_db=9.1,
        anchor_path_loss=('3 -60.0 2.00 6.0', '12 -57.5 2.46 8.7'))
    identities, _ = PathLoss.table(radio)
    assert identities.tolist() == [3, 12]


def test_without_single_anchors_only_the_pooled_path_loss_is_written(tmp_path):
    path = tmp_path / 'radio.yaml'
    path.write_text(as_parameters(Fit(-61.66, 1.436, 6.07, 99), {}))
    assert build(RadioConfig, load_yaml(path)).anchor_path_loss == ()
