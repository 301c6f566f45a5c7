"""The error of TS-MCL over time: what is simulated, and what is concluded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import dblquad
from tsmcl_ros.config import load_yaml
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.experiments.anchor_field import EVIDENCE
from tsmcl_ros.evaluation.experiments.ts_mcl_convergence import (
    lens_radius,
    TsMclConvergence,
    uniform_in_lens,
)
from tsmcl_ros.evaluation.monte_carlo import Outcome, Result, run_experiment

CONFIG = Path(__file__).parents[3] / 'config'


@pytest.fixture(scope='module')
def small():
    """Return a convergence experiment of seconds, and its results."""
    experiment = replace(EXPERIMENTS['ts_mcl_convergence'][1], runs=1, epochs=6, vehicles=4)
    return experiment, run_experiment(experiment, 0, 1)


def made_up(experiment, error):
    """Return results in which the error [m] of each case is a given number in all epochs."""
    results = []
    for case in experiment.cases():
        epochs = 4
        rows = {'epoch': np.repeat(np.arange(epochs) + 1, 3), 'vehicle': np.tile(np.arange(3), 4),
                'error_m': np.full(12, error(case)), 'nees': np.full(12, 2.0)}
        results.append(Result(case, 0, Outcome(rows, 1.2)))
    return results


def test_the_odometry_curves_have_the_parameters_that_the_demo_runs():
    shipped = load_yaml(CONFIG / 'range_free.yaml')
    experiment = TsMclConvergence()
    case = {'evidence': 'odometry', 'filter': 'ts_mcl', 'particles': 200, 'anchors_apart_m': 0.0}

    assert {**EVIDENCE['odometry'], **experiment._method(case)} == shipped


def test_the_full_size_is_that_of_the_claim():
    experiment = TsMclConvergence()

    assert (experiment.vehicles, experiment.epochs) == (40, 200)
    assert (experiment.particles, experiment.first_particles) == (200, 2000)
    assert experiment.bootstrap == ((200, 2000), (3000, 20_000), (20_000, 100_000))


def test_every_epoch_of_every_vehicle_is_a_row(small):
    experiment, results = small

    for result in results:
        rows = result.outcome.rows
        epochs, vehicles = experiment.epochs, experiment.vehicles
        if result.case['anchors_apart_m']:
            epochs, vehicles = experiment.lens_epochs, experiment.lens_vehicles
        elif result.case['filter'] == 'exact':
            vehicles = experiment.exact_vehicles
        assert {len(column) for column in rows.values()} == {epochs * vehicles}
        assert rows['epoch'][-1] == epochs


def test_filters_are_tried_on_the_same_vehicles(small):
    # At the first beacon the box of the references is all that any filter of particles knows.
    _, results = small
    odometry = [result.outcome.rows['error_m'][0] for result in results
                if result.case['evidence'] == 'odometry']

    assert len(odometry) == 3
    assert np.ptp(odometry) < 100


def test_the_table_has_a_row_for_each_case_among_the_anchor_field(small):
    experiment, results = small

    report = experiment.judge(results)

    assert len(report.table) - 1 == sum(not case['anchors_apart_m'] for case in experiment.cases())
    assert {len(row) for row in report.table} == {len(report.table[0])}


def test_the_figure_is_a_png(small, tmp_path):
    experiment, results = small

    experiment.draw(results, tmp_path / 'a.png')

    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize(('error', 'verdicts'), [
    (3.9, ['reached', 'reached', 'reached']),
    (4.5, ['reached', 'missed', 'reached']),
    (5.1, ['missed', 'missed', 'missed']),
])
def test_goals_are_judged_by_the_errors(error, verdicts):
    experiment = TsMclConvergence()
    results = made_up(
        experiment, lambda case: error if case['filter'] == 'ts_mcl' else min(error, 4.6))

    report = experiment.judge(results)

    assert [finding.verdict for finding in report.findings[:3]] == verdicts


def test_what_the_exact_filter_misses_is_called_not_reproducible():
    experiment = TsMclConvergence()
    results = made_up(experiment, lambda case: 160.0)

    report = experiment.judge(results)

    assert all(finding.verdict.startswith('not reproducible') for finding in report.findings[3:])
    assert '470 m' in report.findings[5].limit
    assert '202 m' in report.findings[6].limit


@pytest.mark.parametrize('apart', [1000.0, 1800.0])
def test_the_radius_of_a_lens_agrees_with_cubature(apart):
    half, reach = 1000 - apart / 2, 1000.0

    def edge(x):
        return np.sqrt(reach**2 - (abs(x) + apart / 2)**2)

    area, _ = dblquad(lambda y, x: 1, 0, half, 0, edge)
    moment, _ = dblquad(lambda y, x: x * x + y * y, 0, half, 0, edge)

    assert lens_radius(apart, reach) == pytest.approx(np.sqrt(moment / area), rel=1e-5)


def test_points_of_a_lens_lie_in_it_and_fill_it():
    points = uniform_in_lens(4000, 1000.0, 1000.0, np.random.default_rng(1))

    assert points.shape == (4000, 2)
    for side in (-500, 500):
        assert (np.hypot(points[:, 0] - side, points[:, 1]) <= 1000).all()
    # The standard error of this RMS of 4000 points is 3 m.
    assert np.sqrt(np.mean(np.sum(points**2, axis=1))) == pytest.approx(
        lens_radius(1000, 1000), abs=10)
