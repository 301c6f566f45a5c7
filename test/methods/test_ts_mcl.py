"""The tabu search, step by step, on evidence that follows a script; then as a part of a filter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import math
from typing import Any

from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.methods.ts_mcl import score, TsMcl, TsMclConfig
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import motion_model, MotionConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ConfigError, Motion, Observation, Prior

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
MANY = 20_000
HOPELESS = -1e3  # a log-likelihood that no search takes


def ts_mcl(vehicles: int = 1, radio: dict[str, Any] | None = None, **settings: Any) -> TsMcl:
    """Return TS-MCL on disks of 100 m, without jitter and tabu unless the settings say else."""
    config = TsMclConfig(**{'min_particles': 200, 'max_particles': 2000, 'exclusion': 25.0,
                            'resample_threshold': 0.5, 'max_iterations': 10,
                            'tabu_length': 3, 'tabu_radius': 0.0,
                            'neighbourhood_scale': 0.0, 'neighbourhood_floor': 0.0,
                            'aspiration': 0.5, 'jitter': 0.0, **settings})
    channel = Channel(RadioConfig(**{'radio_range': 100.0, 'edge_softness': 2.0,
                                     **(radio or {})}), EvidenceConfig(outlier_fraction=0.0))
    known = MotionConfig(motion_model='odometry', odom_heading='known', odom_std=0.0, alpha3=0.0)
    return TsMcl(config, channel, motion_model(known, 2, True), vehicles, 2,
                 np.random.default_rng(1))


@dataclass
class Script:
    """Evidence of one term that follows a function, and remembers what it was asked."""

    function: Callable[[np.ndarray], np.ndarray]
    terms: np.ndarray = field(default_factory=lambda: np.ones(1, np.float32))
    asked: list[np.ndarray] = field(default_factory=list)

    def log_likelihood_of(self, points: np.ndarray, vehicle: np.ndarray) -> np.ndarray:
        assert len(points) == len(vehicle)
        self.asked.append(points.copy())
        return np.broadcast_to(self.function(points), len(points)).astype(np.float32)


def search(script: Script, omega: float, count: int = MANY, scale: float = 10.0,
           **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """Search from the origin, where the score is omega."""
    start = np.zeros((count, 2), np.float32)
    return ts_mcl(**settings).search(
        start, np.full(count, math.log(omega), np.float32), np.zeros(count, int),
        np.full(count, scale, np.float32), script)  # type: ignore[arg-type]


def constant(value: float) -> Script:
    return Script(lambda points: np.array(math.log(value) if value > 0 else HOPELESS))


def pairs(asked: np.ndarray) -> np.ndarray:
    """Return the two neighbours of each particle (M, 2, 2) of one iteration."""
    return asked.reshape(2, -1, 2).swapaxes(0, 1)


# The score


def test_the_score_is_the_geometric_mean_of_the_likelihoods() -> None:
    likelihoods = np.array([0.9, 0.5, 0.2])
    assert score(np.log(likelihoods).sum(), np.array(3)) == pytest.approx(
        stats.gmean(likelihoods))


# The search


def test_a_particle_above_the_aspiration_threshold_is_left_alone() -> None:
    script = constant(1.0)
    found, likelihood = search(script, 0.6)
    assert not script.asked
    np.testing.assert_array_equal(found, 0.0)
    np.testing.assert_array_equal(likelihood, np.float32(math.log(0.6)))


def test_a_neighbour_above_the_aspiration_threshold_ends_the_search() -> None:
    script = constant(0.51)
    found, likelihood = search(script, 0.5)
    assert len(script.asked) == 1
    assert (found[:, None] == pairs(script.asked[0])).all(axis=2).any(axis=1).all()
    np.testing.assert_allclose(likelihood, math.log(0.51), rtol=1e-6)


def test_of_two_neighbours_the_better_one_is_taken() -> None:
    script = Script(lambda points: -1e-3 * (100.0 - points[:, 0]))
    found, likelihood = search(script, 0.1, aspiration=0.5)
    both = pairs(script.asked[0])
    np.testing.assert_array_equal(found[:, 0], both[:, :, 0].max(axis=1))
    np.testing.assert_allclose(likelihood, -1e-3 * (100.0 - found[:, 0]), rtol=1e-5)


@pytest.mark.parametrize('iterations', [0, 1, 7])
def test_a_hopeless_search_ends_after_the_iterations_allowed_where_it_began(iterations: int
                                                                            ) -> None:
    script = constant(0.0)
    found, likelihood = search(script, 0.3, 100, max_iterations=iterations)
    assert [len(asked) for asked in script.asked] == [200] * iterations
    np.testing.assert_array_equal(found, 0.0)
    np.testing.assert_array_equal(likelihood, np.float32(math.log(0.3)))


def test_a_step_is_as_long_as_the_score_is_bad() -> None:
    script = constant(0.0)
    search(script, 0.3, scale=10.0, max_iterations=2)
    for asked in script.asked:
        # (1 - omega) h N(0, I), around where the search began, in every iteration.
        for axis in range(2):
            test = stats.kstest(asked[:, axis], stats.norm(0.0, 0.7 * 10.0).cdf)
            assert test.pvalue > SIGNIFICANCE


@pytest.mark.parametrize(('settings', 'length'), [
    ({'neighbourhood_scale': 3.0}, 3.0),
    ({'neighbourhood_floor': 25.0}, 25.0),
    ({'neighbourhood_floor': 2.0}, 10.0),
])
def test_the_config_can_set_the_length_of_a_step_or_its_least_one(
        settings: dict[str, float], length: float) -> None:
    script = constant(0.0)
    search(script, 1e-6, scale=10.0, max_iterations=1, **settings)
    test = stats.kstest(script.asked[0].ravel(), stats.norm(0.0, length).cdf)
    assert test.pvalue > SIGNIFICANCE


def test_a_neighbour_is_accepted_by_chance_the_more_it_is_better() -> None:
    script = constant(0.3)
    search(script, 0.1, max_iterations=2)
    # omega* > omega + (1 - omega) U(0, 1)
    accepted = MANY - len(script.asked[1]) // 2
    assert stats.binomtest(accepted, MANY, (0.3 - 0.1) / (1 - 0.1)).pvalue > SIGNIFICANCE


def test_without_acceptance_the_best_of_all_that_was_tried_is_returned() -> None:
    # Likelihoods of e^-50 are never accepted by chance, but they differ.
    script = Script(lambda points: -50.0 - np.abs(points[:, 0] - 3.0))
    found, likelihood = search(script, math.exp(-52.0), 500, max_iterations=5)
    tried = np.concatenate(
        [pairs(asked)[:, :, 0] for asked in script.asked] + [np.zeros((500, 1))], axis=1)
    reached = np.abs(tried[:, :-1] - 3.0).min(axis=1)
    better = reached < 2.0  # than the start
    assert 0.5 < better.mean() < 1.0
    np.testing.assert_allclose(np.abs(found[better, 0] - 3.0), reached[better], rtol=1e-6)
    np.testing.assert_allclose(likelihood[better], -50.0 - reached[better], rtol=1e-6)
    np.testing.assert_array_equal(found[~better], 0.0)
    np.testing.assert_array_equal(likelihood[~better], -52.0)


@given(seed=st.integers(0, 2**32), length=st.integers(1, 5), iterations=st.integers(0, 12))
@hypothesis_settings(max_examples=40)
def test_a_search_never_lowers_a_likelihood_and_knows_it(
        seed: int, length: int, iterations: int) -> None:
    draw = np.random.default_rng(seed)
    filter_ = ts_mcl(2, tabu_length=length, max_iterations=iterations, tabu_radius=0.3)
    evidence = filter_.channel.evidence(listen(
        [(0.0, 0.0), (150.0, 0.0)], [(0.0, 0.0), (0.0, 0.0)], vary=True))
    points = draw.uniform(-300, 300, (50, 2)).astype(np.float32)
    owner = draw.integers(2, size=50)
    before = evidence.log_likelihood_of(points, owner)
    kept = points.copy()
    found, likelihood = filter_.search(
        points, before, owner, np.full(50, 50.0, np.float32), evidence)
    assert (likelihood >= before).all()
    np.testing.assert_allclose(
        likelihood, evidence.log_likelihood_of(found, owner), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(points, kept)


# The tabu list


def near(centre: np.ndarray, radius: float, std: float) -> np.ndarray:
    """Return how probable a step from the origin of this std lands within a radius of centres."""
    return stats.ncx2.cdf(
        (radius / std) ** 2, 2, np.square(centre).sum(axis=-1).astype(float) / std ** 2)


def ahead() -> Script:
    """Return a script in which the neighbour further along x is the better one."""
    return Script(lambda points: HOPELESS + points[:, 0])


def better(asked: np.ndarray) -> np.ndarray:
    both = pairs(asked)
    return both[np.arange(len(both)), both[:, :, 0].argmax(axis=1)]


def test_a_neighbour_near_a_tabu_entry_is_redrawn_once() -> None:
    script = ahead()
    search(script, 1e-6, scale=10.0, tabu_radius=0.8, max_iterations=2)
    tabu = better(script.asked[0])
    landed = np.linalg.norm(pairs(script.asked[1])[:, 0] - tabu, axis=1) < 8.0
    # It lands there if both draws do.
    expected = near(tabu, 8.0, 10.0) ** 2
    deviation = math.sqrt((expected * (1 - expected)).sum())
    assert landed.sum() == pytest.approx(expected.sum(), abs=4 * deviation)


@pytest.mark.parametrize(('length', 'forgotten'), [(1, True), (2, False), (3, False)])
def test_the_tabu_list_forgets_the_oldest_entry(length: int, forgotten: bool) -> None:
    script = ahead()
    search(script, 1e-6, scale=10.0, tabu_radius=0.5, tabu_length=length, max_iterations=3)
    first, second = better(script.asked[0]), better(script.asked[1])
    apart = np.linalg.norm(first - second, axis=1) > 10.0  # disks that do not overlap
    first, second = first[apart], second[apart]
    landed = np.linalg.norm(pairs(script.asked[2])[apart, 0] - first, axis=1) < 5.0
    here, there = near(first, 5.0, 10.0), near(second, 5.0, 10.0)
    # At once, unless that is tabu; or after a redraw.
    expected = (here + there * here) if forgotten else (here + there) * here
    deviation = math.sqrt((expected * (1 - expected)).sum())
    assert landed.sum() == pytest.approx(expected.sum(), abs=4 * deviation)


# The filter


def listen(*rows: list[tuple[float, float]], vary: bool = False, **fields: object
           ) -> Observation:
    """Let each vehicle hear references at its row of positions [m]; ranges may vary by row."""
    observation = Observation.empty(len(rows), max(map(len, rows)), 2, 1.0)
    for vehicle, positions in enumerate(rows):
        observation.sender[vehicle, :len(positions)] = np.arange(len(positions))
        observation.position[vehicle, :len(positions)] = np.reshape(positions, (-1, 2))
        if vary:
            observation.range[vehicle, 0] = 20.0 + 40.0 * vehicle
    for name, value in fields.items():
        getattr(observation, name)[:] = value
    return observation


def start(filter_: TsMcl, *at: float, std: float = 1.0) -> None:
    """Start each vehicle at an x [m]."""
    for vehicle, x in enumerate(at):
        filter_.start(Prior(vehicle, np.array([x, 0.0]), std ** 2 * np.eye(2)))


def repair(filter_: TsMcl, evidence: Evidence) -> np.ndarray:
    return filter_.repair(evidence, evidence.log_likelihood(filter_.particles))


def test_an_update_repairs_the_particles_that_explain_least() -> None:
    filter_ = ts_mcl(prior_bandwidth=0.0, aspiration=0.5)
    start(filter_, 100.0, std=20.0)
    before = filter_.particles.copy()
    evidence = filter_.channel.evidence(listen([(0.0, 0.0)]))
    good = np.linalg.norm(before[0], axis=1) < 100.0  # where the soft edge scores above a half
    repair(filter_, evidence)
    np.testing.assert_array_equal(filter_.particles[0, good], before[0, good])
    assert (filter_.particles[0, ~good] != before[0, ~good]).any(axis=1).mean() > 0.9
    assert evidence.log_likelihood(filter_.particles).mean() > evidence.log_likelihood(
        before).mean() / 4


def test_repaired_clouds_are_weighed_by_what_was_predicted() -> None:
    # Two ranges leave two places, 11 and 109 m along x; the prediction favours the second one.
    share = {}
    for bandwidth in (0.0, 0.3):
        filter_ = ts_mcl(100, prior_bandwidth=bandwidth, min_particles=200)
        start(filter_, *[100.0] * 100, std=40.0)
        filter_.update(listen(*[[(60.0, 50.0), (60.0, -50.0)]] * 100, range=70.0, range_std=1.0))
        share[bandwidth] = (filter_.particles[:, :, 0] < 60.0).mean()
    right, left = stats.norm(100.0, 40.0).pdf([109.0, 11.0])
    exact = left / (left + right)
    assert abs(share[0.3] - exact) < 0.5 * abs(share[0.0] - exact)


def test_a_repair_returns_the_log_likelihood_of_what_it_repaired() -> None:
    filter_ = ts_mcl(2)
    start(filter_, 100.0, 110.0, std=20.0)
    evidence = filter_.channel.evidence(listen([(0.0, 0.0)], [(10.0, 0.0), (50.0, 0.0)]))
    returned = repair(filter_, evidence)
    np.testing.assert_allclose(
        returned, evidence.log_likelihood(filter_.particles), rtol=1e-4, atol=1e-5)


def test_a_repair_steps_as_far_as_each_vehicle_s_cloud_is_wide() -> None:
    class Watched(TsMcl):
        """Keeps what it was asked to search."""

        def search(self, points: np.ndarray, log_likelihood: np.ndarray, owner: np.ndarray,
                   scale: np.ndarray, evidence: Any) -> tuple[np.ndarray, np.ndarray]:
            self.asked = owner, scale
            return points, log_likelihood

    plain = ts_mcl(2, min_particles=2000)
    filter_ = Watched(plain.config, plain.channel, plain.cloud.motion, 2, 2,
                      np.random.default_rng(1))
    start(filter_, 150.0, std=5.0)
    filter_.start(Prior(1, np.array([150.0, 0.0]), np.diag([300.0, 500.0])))
    repair(filter_, filter_.channel.evidence(listen([(0.0, 0.0)], [(0.0, 0.0)])))
    owner, scale = filter_.asked
    np.testing.assert_allclose(scale[owner == 0], 5.0, rtol=0.05)
    np.testing.assert_allclose(scale[owner == 1], 20.0, rtol=0.05)


def test_nobody_s_particles_move_for_what_another_hears() -> None:
    filter_ = ts_mcl(3)
    start(filter_, 110.0, 110.0)
    before = filter_.particles.copy()
    repair(filter_, filter_.channel.evidence(listen([(0.0, 0.0)], [], [])))
    np.testing.assert_array_equal(filter_.particles[1:], before[1:])
    assert (filter_.particles[0] != before[0]).any()


def test_without_iterations_an_update_moves_no_particle() -> None:
    filter_ = ts_mcl(max_iterations=0, resample_threshold=0.0)
    start(filter_, 100.0, std=20.0)
    filter_.predict(Motion(1.0, np.array([[5.0, 0.0]]), np.zeros(1)))
    before = filter_.particles.copy()
    filter_.update(listen([(0.0, 0.0)]))
    np.testing.assert_array_equal(filter_.particles, before)


def test_without_iterations_weights_are_the_likelihood() -> None:
    filter_ = ts_mcl(max_iterations=0, resample_threshold=0.0)
    start(filter_, 100.0, std=20.0)
    estimate = filter_.update(listen([(0.0, 0.0)]))
    distance = np.linalg.norm(filter_.particles[0], axis=1)
    likelihood = 1 / (1 + np.exp((distance - 100.0) / 2.0))
    np.testing.assert_allclose(
        estimate.mean[0], np.average(filter_.particles[0], axis=0, weights=likelihood), rtol=1e-5)
    assert estimate.log_likelihood[0] == pytest.approx(math.log(likelihood.mean()), abs=1e-5)
    assert estimate.ess[0] == pytest.approx(
        likelihood.sum() ** 2 / np.square(likelihood).sum(), rel=1e-4)


def test_a_cloud_that_hardly_overlaps_what_is_heard_is_saved_by_the_search() -> None:
    # Three standard deviations off, where of 200 particles hardly one is within the disk.
    sizes = {}
    for iterations in (0, 10):
        filter_ = ts_mcl(20, max_iterations=iterations, min_particles=200,
                         radio={'edge_softness': 0.5})
        start(filter_, *[115.0] * 20, std=5.0)
        sizes[iterations] = np.median(filter_.update(listen(*[[(0.0, 0.0)]] * 20)).ess)
    assert sizes[0] < 3
    assert sizes[10] > 2 * sizes[0]


def test_a_cloud_that_who_is_heard_excludes_is_drawn_anew_all_over_the_disk() -> None:
    filter_ = ts_mcl(min_particles=500, max_particles=5000)
    start(filter_, 400.0, std=50.0)
    estimate = filter_.update(listen([(0.0, 0.0)]))
    assert estimate.reinitialized[0]
    disk = np.random.default_rng(1).uniform(-100, 100, (MANY, 2))
    disk = disk[np.linalg.norm(disk, axis=1) < 100.0]
    weights = stats.multivariate_t([400.0, 0.0], 2500.0, df=1).pdf(disk)
    mean = np.average(disk, axis=0, weights=weights)
    spread = np.sqrt(np.average((disk - mean) ** 2, axis=0, weights=weights))
    np.testing.assert_allclose(estimate.mean[0], mean, atol=5.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(estimate.covariance[0])), spread, rtol=0.1)


def test_a_cloud_that_a_range_excludes_is_searched_from_where_it_is() -> None:
    filter_ = ts_mcl(neighbourhood_floor=5.0)
    start(filter_, 80.0, std=1.0)
    estimate = filter_.update(listen([(0.0, 0.0)], range=90.0, range_std=1.0))
    assert not estimate.reinitialized[0]
    np.testing.assert_allclose(estimate.mean[0], [90.0, 0.0], atol=5.0)


def test_who_starts_anew_searches_from_every_candidate() -> None:
    # Three ranges leave one candidate in thousands as it is drawn.
    anchors = [(0.0, 0.0), (90.0, 0.0), (0.0, 90.0)]
    truth = np.array([30.0, 40.0])
    ranges = np.linalg.norm(np.array(anchors) - truth, axis=1)
    heard = listen(anchors, range=ranges, range_std=0.5)
    errors = {}
    for iterations in (0, 20):
        filter_ = ts_mcl(40, max_iterations=iterations, min_particles=20, max_particles=100)
        fleet = Observation.stack([heard] * 40, 1.0)
        errors[iterations] = np.linalg.norm(filter_.update(fleet).mean - truth, axis=1)
    assert np.median(errors[20]) < 0.5 * np.median(errors[0])


@pytest.mark.parametrize(('name', 'value', 'allowed'), [
    ('max_iterations', -1, 'at least 0'), ('tabu_length', 0, 'at least 1'),
    ('aspiration', 0.0, 'above 0 and at most 1'), ('tabu_radius', 2.0, 'at most 1'),
])
def test_settings_of_the_search_are_held_to_what_is_allowed(
        name: str, value: float, allowed: str) -> None:
    with pytest.raises(ConfigError, match=f'{name}: {value} is not allowed, must be .*{allowed}'):
        TsMclConfig(**{name: value})
