"""Cooperative localization against NBP: the network, the rounds, and what is concluded."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.experiments.cooperation import CoopSamples, CoopTime, RADIO
from tsmcl_ros.evaluation.experiments.network import cooperate, Network
from tsmcl_ros.evaluation.monte_carlo import Outcome, Result, run_experiment
from tsmcl_ros.types import Estimate


def network(targets=40, radio=RADIO, seed=1):
    return Network.make(100.0, (6, 3), targets, radio, np.random.default_rng(seed))


@pytest.fixture(scope='module')
def small():
    """Return an experiment of a second, and its results."""
    experiment = replace(EXPERIMENTS['coop_samples'][1], samples=(20, 40))
    return experiment, run_experiment(experiment, 0, 1)


def made_up(experiment, error, seconds):
    """Return results in which error [m] and time [s] are functions of method and M."""
    results = []
    rng = np.random.default_rng(1)
    for case in experiment.cases():
        rounds = 1 if case['method'] == 'grid' else experiment.rounds
        cells = rounds * experiment.targets
        rows = {'round': np.repeat(np.arange(rounds) + 1, experiment.targets),
                'target': np.tile(np.arange(experiment.targets), rounds),
                'anchors_heard': np.full(cells, 4),
                'error_m': error(*case.values()) * rng.uniform(0.9, 1.1, cells),
                'nees': np.full(cells, 2.0), 'localized': np.ones(cells, int)}
        for run in range(experiment.runs):
            results.append(Result(case, run, Outcome(rows, seconds(*case.values()))))
    return results


def test_the_full_size_is_that_of_the_claim():
    experiment = CoopSamples()

    assert (experiment.targets, experiment.samples) == (132, (50, 100, 200, 500))
    assert len(network().anchors) == 18


def test_both_nodes_of_a_pair_know_one_range_and_only_where_they_hear_each_other():
    net = network()
    position = np.concatenate([net.anchors, net.targets])
    distance = np.linalg.norm(position[:, None] - position, axis=2)

    np.testing.assert_array_equal(net.ranges, net.ranges.T)
    np.testing.assert_array_equal(
        np.isfinite(net.ranges), (distance <= 30) & ~np.eye(len(distance), dtype=bool))


def test_targets_hear_anchors_first_and_those_that_may_be_references_later():
    net = network()
    usable = np.zeros(40, bool)
    first = net.observe(None, usable)
    usable[[3, 7]] = True
    mean = np.full((40, 2), np.nan)
    mean[usable] = net.targets[usable] + 1
    covariance = np.tile(4 * np.eye(2), (40, 1, 1))
    nothing = np.zeros(40)
    belief = Estimate(0.0, mean, covariance, nothing, nothing, nothing, 1, nothing, nothing,
                      nothing)
    second = net.observe(belief, usable)

    assert set(first.sender[first.heard]) <= set(range(18))
    assert set(second.sender[second.heard]) - set(range(18)) <= {18 + 3, 18 + 7}
    row = np.argwhere(second.sender == 18 + 3)[0]
    np.testing.assert_allclose(second.position[tuple(row)], net.targets[3] + 1, rtol=1e-5)
    np.testing.assert_allclose(second.covariance[tuple(row)], 4 * np.eye(2))
    assert second.range[tuple(row)] == pytest.approx(net.ranges[18 + row[0], 18 + 3], rel=1e-6)


@pytest.mark.parametrize('method', ['cooperative', 'nbp'])
def test_neighbours_make_errors_smaller_and_localize_more(method):
    rounds = cooperate(network(80), method, {'reference_samples': 50}, RADIO, 2, 8.0,
                       np.random.SeedSequence(1))

    # Eighty targets have some eighteen neighbours each, besides four anchors.
    assert np.sqrt(np.mean(rounds.error[1] ** 2)) < 0.7 * np.sqrt(np.mean(rounds.error[0] ** 2))
    assert rounds.localized[1].sum() > rounds.localized[0].sum()
    # No range has counted twice yet.
    assert 1.0 < rounds.nees[1].mean() < 4.0


def test_who_hears_its_own_words_again_stays_honest():
    # In the third round references know each other, and the ranges between them, already.
    rounds = cooperate(network(132, seed=4), 'cooperative', {'reference_samples': 50}, RADIO, 3,
                       8.0, np.random.SeedSequence(4))

    assert 1.5 < rounds.nees[2].mean() < 2.5
    assert np.mean(rounds.nees[2] < chi2.ppf(0.95, 2)) > 0.92


def test_every_round_of_every_target_is_a_row(small):
    experiment, results = small

    for result in results:
        rounds = 1 if result.case['method'] == 'grid' else experiment.rounds
        assert len(result.outcome.rows['error_m']) == rounds * experiment.targets
    assert {len(row) for row in experiment.judge(results).table} == {10}


def test_the_figure_is_a_png(small, tmp_path):
    experiment, results = small

    experiment.draw(results, tmp_path / 'a.png')

    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize(('nbp', 'cooperative', 'verdicts'), [
    (2.0, 1.0, ['reproduced', 'reproduced']),
    (1.0, 1.0, ['not to be told apart', 'not to be told apart']),
    (1.0, 2.0, ['not reproduced', 'not reproduced']),
])
def test_errors_are_judged_on_the_same_targets(nbp, cooperative, verdicts):
    experiment = CoopSamples(runs=1, targets=40, samples=(50, 500))
    results = made_up(experiment, lambda method, _: nbp if method == 'nbp' else cooperative,
                      lambda *_: 1.0)
    findings = experiment.judge(results).findings

    assert [findings[index].verdict for index in (0, 3)] == verdicts
    assert findings[2].verdict == 'reproduced'
    assert findings[4].verdict == 'as good as possible'


@pytest.mark.parametrize(('nbp', 'verdict'), [
    (1.0, 'as good as possible'), (1.1, 'not as good as possible')])
def test_the_baseline_too_is_held_against_the_exact_filter(nbp, verdict):
    experiment = CoopSamples(runs=1, targets=40, samples=(50, 500))
    results = made_up(experiment, lambda method, _: nbp if method == 'nbp' else 1.0,
                      lambda *_: 1.0)
    assert experiment.judge(results).findings[5].verdict == verdict


def test_errors_that_fall_with_the_samples_are_no_reproduction():
    experiment = CoopSamples(runs=1, targets=40, samples=(50, 500))
    results = made_up(experiment, lambda _, samples: 10 / max(samples, 1), lambda *_: 1.0)

    assert experiment.judge(results).findings[2].verdict == 'not reproduced'


def test_times_are_judged_at_equal_samples_and_from_few_to_many():
    experiment = CoopTime(targets=40, samples=(50, 500))
    results = made_up(experiment, lambda *_: 1.0,
                      lambda method, samples: samples ** 2 / 1e4 if method == 'nbp' else 1.0)
    findings = experiment.judge(results).findings

    assert [finding.verdict for finding in findings] == [
        'not reproduced', 'reproduced', 'reproduced']
    assert '25.0' in findings[-1].measured
