"""Lost UAVs: how they fly, what is predicted of them, and what is concluded."""

from dataclasses import replace
import math

import numpy as np
import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.experiments.grey import Belief, Grey, SHOWN, START
from tsmcl_ros.evaluation.monte_carlo import Outcome, Result, run_experiment


@pytest.fixture(scope='module')
def small():
    """Return an experiment of a second, and its results."""
    experiment = replace(EXPERIMENTS['grey_maneuver'][1], vehicles=200)
    return experiment, run_experiment(experiment, 0, 1)


def made_up(experiment, error):
    """Return results in which the error [m] of each predictor is a given number."""
    size = experiment.horizon * 3
    return [Result(case, 0, Outcome({
        'horizon_s': np.repeat(np.arange(experiment.horizon) + 1, 3),
        'vehicle': np.tile(np.arange(3), experiment.horizon),
        **{name: np.full(size, float(error(case['predictor'])))
           for name in ('error_m', 'along_m', 'across_m')}}, 1.0))
        for case in experiment.cases()]


def test_the_flight_is_that_of_the_claim():
    experiment = Grey(turn=35.0, disturbed=-1)

    way = experiment._fly(np.random.default_rng(1))

    np.testing.assert_allclose(way[0], np.tile([170.4157, 125.6284], (500, 1)))
    steps = np.diff(way, axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=2), 8.0)
    heading = np.degrees(np.arctan2(steps[:, 0, 1], steps[:, 0, 0]))
    np.testing.assert_allclose(heading[:15], 55.0)
    np.testing.assert_allclose(heading[15:], 90.0)


def test_the_disturbance_near_a_is_a_rayleigh_distance_in_any_direction():
    still, disturbed = (
        Grey(turn=0.0, vehicles=4000, disturbed=near)._fly(np.random.default_rng(1))
        for near in (-1, 5))

    off = np.diff(disturbed - still, axis=0)
    length = np.linalg.norm(off, axis=2)
    assert np.flatnonzero(length[:, 0] > 1e-9).tolist() == [13, 14, 15, 16, 17]
    # Rayleigh(1) has the mean sqrt(pi / 2), here to four standard errors.
    assert length[15].mean() == pytest.approx(math.sqrt(math.pi / 2), abs=0.04)
    np.testing.assert_allclose(off[15].mean(axis=0), 0.0, atol=0.07)


def test_both_cases_are_tried_with_all_baselines():
    assert {case['predictor'] for case in Grey(turn=0.0).cases()} == set(SHOWN)
    assert [EXPERIMENTS[f'grey_{name}'][0].turn for name in ('straight', 'maneuver')] == [0, 35]


def test_every_second_of_every_uav_is_a_row(small):
    experiment, results = small

    for result in results:
        rows = result.outcome.rows
        assert {len(column) for column in rows.values()} == {
            experiment.horizon * experiment.vehicles}
        np.testing.assert_allclose(
            np.hypot(rows['along_m'], rows['across_m']), rows['error_m'])


def test_the_smoother_agrees_with_the_filter_at_the_end_and_is_surer_before():
    experiment = Grey(turn=0.0, vehicles=4)
    belief = Belief(np.tile([*START, 4.0, 6.0], (4, 1)), np.tile(np.eye(4), (4, 1, 1)))
    beliefs = [belief]
    for _ in range(5):
        beliefs.append(experiment._move(beliefs[-1]))

    smoothed = experiment._smoothed(beliefs)

    # Where nothing was observed there is nothing to smooth.
    for one, other in zip(smoothed, beliefs, strict=True):
        np.testing.assert_allclose(one.mean, other.mean)
        np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-9)


def test_the_claim_of_the_paper_holds_in_both_cases():
    for name in ('grey_straight', 'grey_maneuver'):
        experiment = replace(EXPERIMENTS[name][0], vehicles=200)
        report = experiment.judge(run_experiment(experiment, 1, 1))
        assert report.findings[0].verdict == 'reproduced'


@pytest.mark.parametrize(('grey', 'verdict'), [(1.0, 'reproduced'), (3.0, 'not reproduced'),
                                               (2.0, 'not distinguishable')])
def test_the_verdict_is_that_of_the_errors(grey, verdict):
    experiment = Grey(turn=0.0)
    results = made_up(experiment, lambda name: grey if name == 'grey_ekf' else 2.0)

    assert experiment.judge(results).findings[0].verdict == verdict


def test_one_station_measures_nothing_along_the_line_of_sight(small):
    experiment, results = small
    along, across = (np.sqrt(np.mean(experiment._curve(results, 'seen', part)[-1] ** 2))
                     for part in ('along_m', 'across_m'))

    assert along > 3 * across


def test_the_figure_is_a_png(small, tmp_path):
    experiment, results = small

    experiment.draw(results, tmp_path / 'a.png')

    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
