"""Error against particles by evidence: what is simulated, and what is concluded."""

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.experiments.anchor_field import EVIDENCE, has_odometry
from tsmcl_ros.evaluation.experiments.beyond import Beyond
from tsmcl_ros.evaluation.monte_carlo import Outcome, Result, run_experiment

EXPERIMENT = replace(EXPERIMENTS['beyond'][1], vehicles=3, epochs=4)


@pytest.fixture(scope='module')
def results():
    """Return the results of a version of a second."""
    return run_experiment(EXPERIMENT, 0, 1)


def made_up(error):
    """Return results in which the error [m] of each case is a given number in all epochs."""
    made = []
    for case in EXPERIMENT.cases():
        few = case['filter'] == 'exact' or case['particles'] == EXPERIMENT.most
        count = EXPERIMENT.yardstick_vehicles if few else EXPERIMENT.vehicles
        rows = {'epoch': np.repeat(np.arange(4) + 1, count),
                'vehicle': np.tile(np.arange(count), 4),
                'error_m': np.full(4 * count, error(case)), 'nees': np.full(4 * count, 2.0)}
        made.append(Result(case, 0, Outcome(rows, 1.0)))
    return made


def findings(error):
    """Return the findings of such results by their claims."""
    return {finding.claim: finding for finding in EXPERIMENT.judge(made_up(error)).findings}


def test_every_filter_is_tried_with_every_evidence():
    tried = {(case['evidence'], case['filter'], case['particles'])
             for case in Beyond().cases()}
    for evidence in EVIDENCE:
        for method in ('bootstrap', 'mcb', 'ts_mcl'):
            assert {(evidence, method, count) for count in Beyond().particles} < tried
        yardstick = ('bootstrap', 20_000) if has_odometry(evidence) else ('exact', 0)
        assert (evidence, *yardstick) in tried


def test_each_epoch_of_each_vehicle_is_a_row(results):
    for result in results:
        rows = result.outcome.rows
        few = result.case['filter'] == 'exact' or result.case['particles'] == EXPERIMENT.most
        vehicles = EXPERIMENT.yardstick_vehicles if few else EXPERIMENT.vehicles
        assert rows['vehicle'].tolist() == list(range(vehicles)) * EXPERIMENT.epochs
        assert np.isfinite(rows['error_m']).all()


def test_the_table_has_a_row_for_each_case(results):
    assert len(EXPERIMENT.judge(results).table) == 1 + len(EXPERIMENT.cases())


def test_the_figure_is_a_png(results, tmp_path):
    EXPERIMENT.draw(results, tmp_path / 'a.png')
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')


def test_the_least_particles_that_come_near_the_best_are_named():
    near = {('ts_mcl', 10), ('mcb', 20), ('exact', 0), ('bootstrap', EXPERIMENT.most)}
    found = findings(
        lambda case: 100.0 if (case['filter'], case['particles']) in near else 120.0)
    said = found['+ silence: particles for an RMSE within 10 % of the best']
    assert said.measured == 'bootstrap more than 20, MCB 20, TS-MCL 10'
    assert said.verdict == 'the search saves particles'


def test_a_search_that_needs_as_many_saves_none():
    said = findings(
        lambda case: 100.0)['heard only: particles for an RMSE within 10 % of the best']
    assert said.measured == 'bootstrap 10, MCB 10, TS-MCL 10'
    assert said.verdict == 'the search saves none'


@pytest.mark.parametrize(('silence', 'verdict'), [
    (50.0, 'worth it'), (100.0, 'worth nothing that could be shown')])
def test_evidence_is_worth_what_it_takes_off_the_best_error(silence, verdict):
    found = findings(lambda case: silence if case['evidence'] == 'silence' else 100.0)
    assert found['+ silence: best RMSE over that of heard only'].verdict == verdict
