"""Metrics against evo, scipy, numpy and cases worked by hand."""

import json
import math
import os
from pathlib import Path
import subprocess
import sysconfig
import zipfile

from evo.core.metrics import APE, PoseRelation, StatisticsType
from evo.core.trajectory import PoseTrajectory3D
import numpy as np
import pytest
from scipy.spatial.distance import mahalanobis
from tsmcl_ros.evaluation.metrics import (
    compare,
    evaluate,
    metrics_document,
    nees_band,
    pool,
    write_tum,
)
from tsmcl_ros.messages import UNMEASURED
from tsmcl_ros.types import Trajectory


def trajectory(stamp, position, covariance=None, yaw=None):
    stamp = np.asarray(stamp, float)
    return Trajectory(
        stamp,
        np.asarray(position, float),
        np.full(len(stamp), np.nan) if yaw is None else np.asarray(yaw, float),
        covariance,
    )


def straight(stamp, speed=1.0, dimension=2):
    position = np.zeros((len(stamp), dimension))
    position[:, 0] = speed * np.asarray(stamp)
    return trajectory(stamp, position)


@pytest.fixture
def wandering():
    """Return a 3-D estimate at other stamps than its truth's, with clocks of 2026."""
    rng = np.random.default_rng(1)
    truth_stamp = 1.77e9 + np.sort(rng.uniform(0, 100, 400))
    truth = trajectory(truth_stamp, np.cumsum(rng.normal(0, 1, (400, 3)), axis=0),
                       yaw=rng.uniform(-3, 3, 400))
    stamp = np.linspace(truth_stamp[0], truth_stamp[-1], 251)
    position = np.column_stack([
        np.interp(stamp, truth_stamp, column) for column in truth.position.T])
    factor = rng.normal(0, 1, (251, 3, 3))
    covariance = factor @ factor.transpose(0, 2, 1) + 0.1 * np.eye(3)
    estimate = trajectory(stamp, position + rng.normal(0, 2, (251, 3)), covariance,
                          rng.uniform(-3, 3, 251))
    return estimate, truth


def ape(comparison):
    def path(part):
        xyz = np.zeros((len(part.stamp), 3))
        xyz[:, :part.position.shape[1]] = part.position
        return PoseTrajectory3D(xyz, np.tile([1.0, 0, 0, 0], (len(xyz), 1)), part.stamp)

    metric = APE(PoseRelation.translation_part)
    metric.process_data((path(comparison.truth), path(comparison.estimate)))
    return metric


@pytest.mark.parametrize(('name', 'statistic'), [
    ('rmse_m', StatisticsType.rmse),
    ('mean_m', StatisticsType.mean),
    ('median_m', StatisticsType.median),
    ('max_m', StatisticsType.max),
])
def test_error_statistics_are_those_of_evo(wandering, name, statistic):
    ours = getattr(evaluate(*wandering), name)

    assert ours == pytest.approx(ape(compare(*wandering)).get_statistic(statistic), abs=1e-9)


def test_the_exported_files_give_the_same_rmse_in_evo_ape(wandering, tmp_path):
    comparison = compare(*wandering)
    write_tum(tmp_path / 'truth.tum', comparison.truth)
    write_tum(tmp_path / 'estimate.tum', comparison.estimate)

    shown = subprocess.run(
        [Path(sysconfig.get_path('scripts'), 'evo_ape'), 'tum', 'truth.tum', 'estimate.tum',
         '--save_results', 'result.zip', '--verbose'],
        cwd=tmp_path, env={**os.environ, 'HOME': str(tmp_path)}, capture_output=True, text=True,
        check=True)

    with zipfile.ZipFile(tmp_path / 'result.zip') as result:
        rmse = json.loads(result.read('stats.json'))['rmse']
    assert 'Compared 251 absolute pose pairs' in shown.stdout
    assert rmse == pytest.approx(pool([comparison]).rmse_m, abs=1e-6)


def test_the_95_percent_error_is_numpys_percentile(wandering):
    assert evaluate(*wandering).p95_m == np.percentile(compare(*wandering).error, 95)


def test_truth_is_interpolated_at_the_estimates_stamps():
    truth = trajectory([0, 10], [[0, 0], [10, 20]])

    assert evaluate(trajectory([2.5], [[2.5, 5.0]]), truth).max_m == 0.0


def test_truth_yaw_is_interpolated_across_the_cut_of_the_circle():
    truth = trajectory([0, 1], [[0, 0], [0, 0]], yaw=[math.pi - 0.1, -math.pi + 0.3])

    middle = compare(trajectory([0.5], [[0, 0]]), truth).truth.yaw[0]

    assert np.exp(1j * middle) == pytest.approx(np.exp(1j * (math.pi + 0.1)))


def test_estimates_outside_the_truths_span_are_left_out_and_counted():
    comparison = compare(straight([-1, 0, 1, 2, 3, 3.5]), straight([0, 1, 2, 3]))

    assert (len(comparison.error), comparison.left_out) == (4, 2)


def test_an_estimate_that_is_not_finite_is_left_out():
    estimate = trajectory([0, 1, 2], [[np.nan, 0], [1, 0], [2, 0]])

    assert evaluate(estimate, straight([0, 1, 2])).epochs == 2


def test_skip_leaves_out_the_truths_first_seconds():
    truth = straight(np.arange(100.0, 111.0))

    comparison = compare(straight(np.arange(100.0, 111.0)), truth, skip=5.0)

    assert comparison.estimate.stamp[0] == 105.0
    assert comparison.duration == 5.0


def test_height_with_unmeasured_variance_is_not_compared():
    covariance = np.broadcast_to(np.diag([1, 1, UNMEASURED]), (2, 3, 3))
    estimate = trajectory([0, 1], np.zeros((2, 3)), covariance)

    assert evaluate(estimate, trajectory([0, 1], [[0, 0, 7], [0, 0, 7]])).max_m == 0.0


def test_height_whose_truth_is_unknown_is_not_compared():
    estimate = trajectory([0, 1], [[0, 0, 5], [0, 0, 5]])

    assert evaluate(estimate, trajectory([0, 1], [[0, 0, np.nan]] * 2)).max_m == 0.0


def test_estimated_height_is_compared():
    estimate = trajectory([0, 1], [[0, 0, 5], [0, 0, 5]], np.broadcast_to(np.eye(3), (2, 3, 3)))

    assert evaluate(estimate, trajectory([0, 1], np.zeros((2, 3)))).mean_m == 5.0


def test_no_overlap_in_time_gives_no_epoch_and_no_availability():
    metrics = evaluate(straight([50, 51]), straight([0, 1]))

    assert (metrics.epochs, metrics.availability) == (0, 0.0)
    assert math.isnan(metrics.rmse_m)


def test_nees_is_the_squared_mahalanobis_distance(wandering):
    comparison = compare(*wandering)

    expected = [
        mahalanobis(found, true, np.linalg.inv(covariance))**2
        for found, true, covariance in zip(
            comparison.estimate.position, comparison.truth.position,
            comparison.estimate.covariance, strict=True)]

    np.testing.assert_allclose(comparison.nees, expected, rtol=1e-9)


def consistent(runs, dimension, rng):
    """One epoch of each of `runs` vehicles whose errors are drawn from their covariances."""
    factor = rng.normal(0, 1, (runs, dimension, dimension)) + np.eye(dimension)
    error = np.einsum('rij,rj->ri', factor, rng.normal(0, 1, (runs, dimension)))
    covariance = factor @ factor.transpose(0, 2, 1)
    return trajectory(np.arange(runs), error, covariance)


@pytest.mark.parametrize('dimension', [2, 3])
def test_nees_of_a_consistent_estimator_is_the_dimension(dimension):
    estimate = consistent(20_000, dimension, np.random.default_rng(3))

    metrics = evaluate(estimate, straight(np.arange(20_000), 0.0, dimension))

    assert metrics.nees == pytest.approx(dimension, abs=4 * math.sqrt(2 * dimension / 20_000))


def test_the_nees_band_holds_95_percent_of_consistent_fleets():
    low, high = nees_band(dimension=2, samples=40)
    rng = np.random.default_rng(4)
    truth = straight(np.arange(40), 0.0)
    fleets = [evaluate(consistent(40, 2, rng), truth).nees for _ in range(1000)]

    inside = np.mean([low <= nees <= high for nees in fleets])

    assert inside == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / 1000))


def test_a_singular_covariance_has_infinite_nees():
    estimate = trajectory([0, 1], [[1, 0], [1, 0]], np.zeros((2, 2, 2)))

    assert evaluate(estimate, straight([0, 1], 0.0)).nees == math.inf


def test_without_a_covariance_nees_is_unknown():
    assert math.isnan(evaluate(straight([0, 1]), straight([0, 1])).nees)


def test_spread_is_the_rmse_that_the_covariance_claims():
    covariance = np.broadcast_to(np.diag([9.0, 16.0]), (2, 2, 2))

    comparison = compare(trajectory([0, 1], np.zeros((2, 2)), covariance), straight([0, 1]))

    assert comparison.spread.tolist() == [5.0, 5.0]


def test_an_estimator_that_predicts_through_an_outage_stays_available():
    stamp = np.arange(0.0, 101.0)

    assert evaluate(straight(stamp), straight(stamp)).availability == 1.0


def test_an_estimator_that_falls_silent_is_unavailable_once_its_estimate_is_too_old():
    stamp = np.arange(0.0, 101.0)
    heard = (stamp <= 40) | (stamp >= 80)

    metrics = evaluate(straight(stamp[heard]), straight(stamp), max_age=2.0)

    assert metrics.availability == pytest.approx(1 - (40 - 2) / 100)


def test_the_time_before_the_first_estimate_is_unavailable():
    metrics = evaluate(straight(np.arange(10.0, 21.0)), straight(np.arange(0.0, 21.0)))

    assert metrics.availability == pytest.approx(0.5)


def test_an_estimate_just_before_the_skipped_time_ends_still_serves():
    truth = straight(np.arange(0.0, 21.0))

    metrics = evaluate(straight([9.0, 12.0, 14, 16, 18, 20]), truth, skip=10.0)

    assert metrics.availability == pytest.approx(1 - 1 / 10)


def test_pooling_weighs_every_epoch_alike():
    truth = straight(np.arange(0.0, 4.0), 0.0)
    near = compare(trajectory([0, 1, 2], [[1, 0]] * 3), truth)
    far = compare(trajectory([3], [[5, 0]]), truth)

    assert pool([near, far]).mean_m == 2.0


def test_pooling_weighs_availability_by_time():
    always = compare(straight(np.arange(0.0, 31.0)), straight(np.arange(0.0, 31.0)))
    never = compare(straight([]), straight(np.arange(0.0, 11.0)))

    assert pool([always, never]).availability == pytest.approx(0.75)


def test_the_document_holds_the_agreed_keys(wandering):
    metrics = evaluate(*wandering)

    document = metrics_document(metrics, {'veh_0': metrics})

    keys = {'rmse_m', 'mean_m', 'median_m', 'p95_m', 'max_m', 'nees', 'availability', 'epochs'}
    assert set(document) == {'overall', 'vehicles'}
    assert set(document['overall']) == set(document['vehicles']['veh_0']) == keys


def test_values_that_are_not_finite_become_null(wandering):
    metrics = evaluate(straight([50.0]), straight([0, 1]))

    assert json.dumps(metrics.as_json(), allow_nan=False).count('null') == 6


def test_a_tum_file_of_a_plane_has_height_zero_and_the_yaw_as_quaternion(tmp_path):
    write_tum(tmp_path / 'a.tum', trajectory([1.5], [[2, 3]], yaw=[math.pi / 2]))

    row = np.loadtxt(tmp_path / 'a.tum')

    np.testing.assert_allclose(row, [1.5, 2, 3, 0, 0, 0, math.sqrt(0.5), math.sqrt(0.5)],
                               atol=1e-9)
