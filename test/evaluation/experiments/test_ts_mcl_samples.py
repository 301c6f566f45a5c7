"""TS-MCL beside MCL: what is simulated, and what is concluded."""

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.experiments.ts_mcl_samples import (
    Outcomes,
    TsMclRadius,
    TsMclSamples,
    TsMclTime,
)
from tsmcl_ros.evaluation.monte_carlo import Outcome, Result, run_experiment

NAMES = ('ts_mcl_samples', 'ts_mcl_time', 'ts_mcl_radius')


def made_up(experiment, error, seconds=lambda case: 1.0):
    """Return results in which the error [m] and time [s] of each case are given."""
    return [Result(case, 0, Outcome(
        {'vehicle': np.arange(4), 'error_m': np.full(4, error(case))}, seconds(case)))
        for case in experiment.cases()]


def verdicts(experiment, *made):
    """Return the verdicts on such results."""
    report = experiment.judge(made_up(experiment, *made))
    return [finding.verdict for finding in report.findings]


@pytest.fixture(scope='module')
def small():
    """Return a version of less than a second, and its results."""
    experiment = replace(EXPERIMENTS['ts_mcl_samples'][1], runs=1, particles=(2, 4, 6, 8))
    return experiment, run_experiment(experiment, 0, 1)


@pytest.mark.parametrize('name', NAMES)
def test_every_case_can_be_judged(name):
    quick = EXPERIMENTS[name][1]
    report = quick.judge(made_up(quick, lambda case: 100.0))
    assert len(report.table) == 1 + len(quick.cases())
    assert report.findings


def test_each_vehicle_is_a_row(small):
    experiment, results = small
    for result in results:
        assert result.outcome.rows['vehicle'].tolist() == list(range(experiment.vehicles))
        assert np.isfinite(result.outcome.rows['error_m']).all()


def test_the_figure_is_a_png(small, tmp_path):
    experiment, results = small
    experiment.draw(results, tmp_path / 'a.png')
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize(('error', 'verdict'), [(99.0, 'reached'), (101.0, 'missed')])
def test_ten_particles_are_compared_with_fifty_of_mcl(error, verdict):
    def of(case):
        return error if case['filter'] == 'ts_mcl' and case['particles'] == 10 else 100.0

    assert verdicts(TsMclSamples(), of)[0] == verdict


@pytest.mark.parametrize(('seconds', 'verdict'), [(0.69, 'reached'), (0.71, 'missed')])
def test_time_is_compared_at_equal_accuracy_and_at_equal_n(seconds, verdict):
    def of(case):
        return seconds if case['filter'] == 'ts_mcl' else 1.0

    # With 10 iterations and with a single one, which is as accurate.
    assert verdicts(TsMclTime(), lambda _: 100.0, of) == [verdict] * 4


def test_time_is_compared_with_the_least_iterations_that_are_accurate_enough():
    def error(case):
        return 101.0 if case['filter'] == 'ts_mcl' and case['iterations'] < 5 else 100.0

    claims = [finding.claim for finding in TsMclTime().judge(made_up(TsMclTime(), error)).findings]
    assert [claim.partition('and ')[2].partition(' over')[0] for claim in claims] == [
        '5 iterations', '10 iterations'] * 2


def test_less_time_for_less_accuracy_is_called_that():
    def error(case):
        return 101.0 if case['filter'] == 'ts_mcl' else 100.0

    assert verdicts(TsMclTime(), error, lambda case: 0.5 if case['filter'] == 'ts_mcl' else 1.0
                    ) == ['reached, though less accurate'] * 2


def test_every_radio_range_is_judged_by_itself():
    def of(case):
        good = case['radio_range_m'] < 1000.0 or case['filter'] == 'mcl'
        return (89.0 if case['filter'] == 'ts_mcl' else 100.0) if good else 95.0

    # Beyond 750 m the made-up exact filter is at 0.95 of MCL as well.
    impossible = 'not reproducible: the exact filter misses it too'
    assert verdicts(TsMclRadius(), of) == (['reached'] * 2 + [impossible] * 3) * 2


def test_what_the_exact_filter_reaches_is_missed():
    def of(case):
        return {'ts_mcl': 95.0, 'mcl': 100.0, 'exact': 80.0}[case['filter']]

    assert set(verdicts(TsMclRadius(), of)) == {'missed'}


def test_ratios_pair_the_vehicles_of_the_same_worlds():
    cases = [{'filter': name} for name in ('mcl', 'ts_mcl')]
    errors = np.array([10.0, 1000.0]), np.array([9.0, 900.0])
    outcomes = Outcomes([
        Result(case, 0, Outcome({'error_m': error}, 0.0))
        for case, error in zip(cases, errors, strict=True)])
    ratio = outcomes.ratio(cases[1], cases[0])
    assert tuple(ratio) == pytest.approx((0.9, 0.9, 0.9))
