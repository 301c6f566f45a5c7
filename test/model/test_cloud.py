"""The steps of a particle filter: placing, weighing, estimating, resampling, starting anew."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import stats
from tsmcl_ros.model.cloud import Cloud, CloudConfig
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.motion import MotionConfig, OdometryMotion, RandomMotion
from tsmcl_ros.model.particles import spread
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ConfigError, Observation, Prior

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
MANY = 20_000

# Four anchors so far off that their ranges measure x and y, each twice.
AXES = np.array([[1e4, 0.0], [-1e4, 0.0], [0.0, 1e4], [0.0, -1e4]])


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def cloud(count: int = 100, vehicles: int = 1, heading: bool = False, seed: int = 1,
          **settings: Any) -> Cloud:
    """Return a cloud of as many particles, drawn from as many candidates, without jitter."""
    config = CloudConfig(**{'min_particles': count, 'max_particles': max(count, 2000),
                            'jitter': 0.0, 'resample_threshold': 0.5, 'exclusion': 25.0,
                            **settings})
    motion = (OdometryMotion(MotionConfig(odom_heading='unknown')) if heading
              else RandomMotion(MotionConfig(max_speed=10.0)))
    return Cloud(config, motion, vehicles, 2, rng(seed))


def listen(*rows: list[tuple[float, float]], **fields: object) -> Observation:
    """Let each vehicle hear references at its row of positions [m]."""
    observation = Observation.empty(len(rows), max(map(len, rows)), 2, 3.5)
    for vehicle, positions in enumerate(rows):
        observation.sender[vehicle, :len(positions)] = np.arange(len(positions))
        observation.position[vehicle, :len(positions)] = np.reshape(positions, (-1, 2))
    for name, value in fields.items():
        getattr(observation, name)[:] = value
    return observation


def evidence(observation: Observation, **radio: Any) -> Evidence:
    """Return what it says to a radio of 100 m with a sharp edge, without outliers."""
    return Channel(RadioConfig(**{'radio_range': 100.0, 'edge_softness': 0.1, **radio}),
                   EvidenceConfig(outlier_fraction=0.0)).evidence(observation)


def fix(x: float, y: float, std: float, vehicles: int = 1) -> Evidence:
    """Return Gaussian evidence of a position, with this standard deviation [m] on each axis."""
    ranges = np.linalg.norm(AXES - [x, y], axis=1)
    return evidence(listen(*[[tuple(anchor) for anchor in AXES]] * vehicles, range=ranges,
                           range_std=std * math.sqrt(2)), radio_range=0.0)


def prior(vehicle: int = 0, x: float = 0.0, y: float = 0.0, std: float = 1.0, **heading: Any
          ) -> Prior:
    return Prior(vehicle, np.array([x, y]), std ** 2 * np.eye(2), **heading)


NOBODY = listen([])
ONE = listen([(0.0, 0.0)])
ONE_OF_TWO = listen([(0.0, 0.0)], [])


def weigh(one: Cloud, what: Evidence) -> None:
    one.weigh(what.log_likelihood(one.particles))


def excluded(one: Cloud, what: Evidence) -> np.ndarray:
    return one.excluded(what, what.log_likelihood(one.particles))


def test_fewer_candidates_than_particles_are_refused() -> None:
    with pytest.raises(ConfigError, match='max_particles: 100 .* at least min_particles, 200'):
        CloudConfig(min_particles=200, max_particles=100)


# Placing


def test_a_vehicle_is_placed_when_it_first_hears_a_beacon() -> None:
    both = cloud(vehicles=2)
    both.place(evidence(ONE_OF_TWO))
    np.testing.assert_array_equal(both.placed, [True, False])


def test_a_vehicle_without_a_place_has_no_estimate() -> None:
    both = cloud(vehicles=2)
    both.place(evidence(ONE_OF_TWO))
    estimate = both.estimate(ONE_OF_TWO)
    np.testing.assert_array_equal(np.isnan(estimate.mean[:, 0]), [False, True])
    np.testing.assert_array_equal(np.isnan(estimate.covariance[:, 0, 0]), [False, True])


def test_a_vehicle_that_hears_one_anchor_is_anywhere_in_its_disk() -> None:
    one = cloud(2000, max_particles=MANY)
    one.place(evidence(ONE))
    away = np.linalg.norm(one.particles[0], axis=1)
    assert stats.kstest((away / 100.0) ** 2, 'uniform').pvalue > SIGNIFICANCE


def test_placing_keeps_the_likely_candidates() -> None:
    one = cloud()
    one.place(evidence(listen([(0.0, 0.0), (150.0, 0.0)])))
    for x in (0.0, 150.0):
        # A tenth of a metre of edge lets one in e^10 lie a metre outside.
        assert np.linalg.norm(one.particles[0] - [x, 0.0], axis=1).max() < 101.0


def test_placing_searches_from_every_candidate_where_too_few_are_likely() -> None:
    one = cloud(min_particles=290, max_particles=300)

    def search(points: np.ndarray, likelihood: np.ndarray, owner: np.ndarray,
               scale: np.ndarray, _: Evidence) -> tuple[np.ndarray, np.ndarray]:
        assert points.shape == (300, 2)
        np.testing.assert_array_equal(owner, 0)
        # The standard deviation of the box's uniform distribution, 200 m wide.
        np.testing.assert_allclose(scale, 200.0 / math.sqrt(12), rtol=0.1)
        return np.full_like(points, 7.0), likelihood

    one.place(evidence(ONE), search)
    np.testing.assert_array_equal(one.particles, 7.0)


def test_placing_searches_nothing_where_enough_candidates_are_likely() -> None:
    one = cloud(max_particles=3000)
    one.place(evidence(ONE), None)
    other = cloud(max_particles=3000)
    other.place(evidence(ONE), lambda *_: pytest.fail('searched'))
    np.testing.assert_array_equal(one.particles, other.particles)


def test_copies_of_the_few_candidates_that_are_likely_stand_for_what_is_between_them() -> None:
    # Two disks that hardly meet, askew, so that one in a thousand of the candidates lies in both.
    few = cloud(max_particles=500)
    few.place(evidence(listen([(0.0, 0.0), (141.0, 141.0)])))
    assert len(np.unique(few.particles[0], axis=0)) == 100
    between = 59 / math.sqrt(500)  # m, in a box of 59 m
    assert spread(few.particles)[0] > between / math.sqrt(12)


def test_placing_leaves_alone_who_has_a_place() -> None:
    both = cloud(vehicles=2)
    both.place(evidence(ONE_OF_TWO))
    before = both.states[0].copy()
    both.place(evidence(listen([(0.0, 0.0)], [(0.0, 0.0)])))
    np.testing.assert_array_equal(both.states[0], before)
    assert both.placed.all()


def test_a_vehicle_may_be_put_where_somebody_else_has_drawn_it() -> None:
    both = cloud(4, vehicles=2, heading=True)
    both.put(np.array([1]), np.arange(8.0).reshape(1, 4, 2))
    np.testing.assert_array_equal(both.particles[1], np.arange(8.0).reshape(4, 2))
    np.testing.assert_array_equal(both.placed, [False, True])
    assert len(np.unique(both.states[1, :, 2])) == 4


def test_placing_draws_what_the_motion_model_remembers() -> None:
    one = cloud(2000, heading=True)
    one.place(evidence(ONE))
    uniform = stats.uniform(-math.pi, 2 * math.pi)
    assert stats.kstest(one.states[0, :, 2], uniform.cdf).pvalue > SIGNIFICANCE


def test_the_first_evidence_counts_once() -> None:
    one = cloud(MANY, max_particles=400_000)
    first = fix(3.0, -4.0, 2.0)
    one.place(first)
    weigh(one, first)
    estimate = one.estimate(NOBODY)
    # The standard error is 2 m / sqrt(20 000) of the mean, 1 % of the variance.
    np.testing.assert_allclose(estimate.mean, [[3.0, -4.0]], atol=0.06)
    np.testing.assert_allclose(estimate.covariance[0], 4.0 * np.eye(2), atol=0.15)


def test_the_second_evidence_counts_like_any_other() -> None:
    one = cloud(MANY, max_particles=400_000)
    for x in (0.0, 2.0):
        one.place(fix(x, 0.0, 2.0))
        weigh(one, fix(x, 0.0, 2.0))
    estimate = one.estimate(NOBODY)
    np.testing.assert_allclose(estimate.mean, [[1.0, 0.0]], atol=0.06)
    np.testing.assert_allclose(estimate.covariance[0], 2.0 * np.eye(2), atol=0.08)


def test_a_place_forgotten_is_found_anew_at_the_next_beacon() -> None:
    both = cloud(vehicles=2)
    both.place(evidence(listen([(0.0, 0.0)], [(0.0, 0.0)])))
    both.forget(0)
    np.testing.assert_array_equal(both.placed, [False, True])
    both.place(evidence(listen([(5000.0, 0.0)], [(5000.0, 0.0)])))
    assert both.placed.all()
    assert both.particles[0].min(axis=0)[0] > 4800.0
    assert both.particles[1].max(axis=0)[0] < 200.0


# Starting from a prior


def test_a_prior_s_mean_and_covariance_are_those_of_the_particles() -> None:
    one = cloud(MANY)
    covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
    one.start(Prior(0, np.array([10.0, -20.0]), covariance))
    estimate = one.estimate(NOBODY)
    np.testing.assert_allclose(estimate.mean, [[10.0, -20.0]], atol=0.06)
    np.testing.assert_allclose(estimate.covariance[0], covariance, atol=0.12)


def test_a_prior_replaces_one_vehicle_s_belief_and_its_weights() -> None:
    both = cloud(vehicles=2)
    both.place(evidence(listen([(0.0, 0.0)], [(0.0, 0.0)])))
    both.weights = rng().dirichlet(np.ones(both.weights.shape[1]), 2).astype(np.float32)
    states, weights = both.states[1].copy(), both.weights[1].copy()
    both.start(prior(x=500.0))
    np.testing.assert_array_equal(both.states[1], states)
    np.testing.assert_array_equal(both.weights[1], weights)
    np.testing.assert_allclose(both.weights[0], 1 / both.weights.shape[1])


def test_a_prior_gives_a_place() -> None:
    one = cloud()
    one.start(prior())
    assert one.placed[0]


def test_a_prior_may_be_exact() -> None:
    one = cloud()
    one.start(prior(x=5.0, std=0.0))
    np.testing.assert_allclose(one.particles[0], np.broadcast_to([5.0, 0.0], (100, 2)))


def test_a_prior_may_know_the_heading() -> None:
    one = cloud(MANY, heading=True)
    one.start(prior(yaw=2.0, yaw_std=0.1))
    heading = one.states[0, :, 2]
    assert stats.kstest(heading, stats.norm(2.0, 0.1).cdf).pvalue > SIGNIFICANCE


def test_a_prior_without_a_heading_leaves_it_open() -> None:
    one = cloud(MANY, heading=True)
    one.start(prior())
    uniform = stats.uniform(-math.pi, 2 * math.pi)
    assert stats.kstest(one.states[0, :, 2], uniform.cdf).pvalue > SIGNIFICANCE


# Weighing and estimating


def test_the_log_likelihood_is_that_of_the_average_over_the_cloud() -> None:
    one = cloud(MANY)
    one.start(prior(std=3.0))
    weigh(one, fix(2.0, 0.0, 4.0))
    # Relative to the likelihood's own peak, for both axes.
    marginal, alone = stats.norm(0.0, 5.0), stats.norm(0.0, 4.0)
    expected = marginal.logpdf(2.0) + marginal.logpdf(0.0) - 2 * alone.logpdf(0.0)
    assert one.estimate(ONE).log_likelihood[0] == pytest.approx(expected, abs=0.02)


def test_the_log_likelihood_is_that_of_this_evidence_alone() -> None:
    one = cloud(MANY)
    one.start(prior(std=3.0))
    weigh(one, fix(2.0, 0.0, 4.0))
    weigh(one, fix(2.0, 0.0, 400.0))
    assert one.estimate(ONE).log_likelihood[0] == pytest.approx(0.0, abs=1e-3)


def test_nothing_heard_leaves_the_weights_as_they_were() -> None:
    one = cloud()
    one.start(prior())
    weigh(one, fix(1.0, 0.0, 1.0))
    before = one.weights.copy()
    weigh(one, evidence(NOBODY))
    np.testing.assert_allclose(one.weights, before, rtol=1e-5)
    assert math.isnan(one.estimate(NOBODY).log_likelihood[0])


def test_an_estimate_tells_how_many_were_heard_and_when() -> None:
    both = cloud(vehicles=2)
    estimate = both.estimate(ONE_OF_TWO)
    np.testing.assert_array_equal(estimate.heard, [1, 0])
    assert estimate.stamp == 3.5
    assert estimate.particles == 100


def test_an_estimate_tells_the_effective_number_of_particles() -> None:
    one = cloud(4)
    one.weights[0] = [0.5, 0.5, 1e-9, 1e-9]
    assert one.estimate(NOBODY).ess[0] == pytest.approx(2.0)


def test_headings_are_averaged_on_the_circle() -> None:
    one = cloud(500, heading=True)
    one.start(prior(yaw=math.pi, yaw_std=0.5))
    estimate = one.estimate(ONE)
    heading = one.states[0, :, 2]
    expected = stats.circmean(heading, high=math.pi, low=-math.pi)
    assert estimate.rotation[0] == pytest.approx(expected, abs=1e-5)
    # A circular standard deviation is defined so that it is that of a wrapped normal.
    assert estimate.rotation_variance[0] == pytest.approx(stats.circstd(heading) ** 2, rel=1e-4)


def test_uniform_headings_have_a_large_and_finite_variance() -> None:
    one = cloud(4, heading=True)
    one.start(prior())
    one.states[0, :, 2] = np.arange(4) * math.pi / 2
    assert one.estimate(ONE).rotation_variance[0] == pytest.approx(math.pi ** 2)


def test_a_motion_without_headings_has_no_rotation() -> None:
    one = cloud()
    one.start(prior())
    estimate = one.estimate(ONE)
    assert np.isnan([estimate.rotation, estimate.rotation_variance]).all()


# Resampling


def weighted(threshold: float, jitter: float = 0.0, count: int = 100) -> Cloud:
    """Return a cloud of two vehicles; the first one's effective size is a quarter of all."""
    both = cloud(count, vehicles=2, resample_threshold=threshold, jitter=jitter)
    for vehicle in range(2):
        both.start(prior(vehicle))
    both.weights[0] = np.where(np.arange(count) < count // 4, 4 / count, 1e-20)
    return both


def test_a_degenerate_cloud_is_resampled_to_equal_weights() -> None:
    both = weighted(0.5)
    heavy = both.particles[0, :25].copy()
    both.resample()
    np.testing.assert_array_equal(both.particles[0], np.repeat(heavy, 4, axis=0))
    np.testing.assert_allclose(both.weights[0], 1 / both.weights.shape[1])


def test_a_cloud_that_is_not_degenerate_is_left_alone() -> None:
    both = weighted(0.5)
    states = both.states[1].copy()
    both.resample()
    np.testing.assert_array_equal(both.states[1], states)


@pytest.mark.parametrize(('threshold', 'resampled'), [(0.2, False), (0.3, True)])
def test_the_threshold_says_how_degenerate_a_cloud_must_be(
        threshold: float, resampled: bool) -> None:
    both = weighted(threshold)
    both.resample()
    assert (both.weights[0] == both.weights[0, 0]).all() == resampled


def test_jitter_parts_copies_by_a_share_of_the_cloud_s_spread() -> None:
    plain, parted = weighted(0.5, count=MANY), weighted(0.5, jitter=0.1, count=MANY)
    plain.resample()
    parted.resample()
    noise = parted.particles[0] - plain.particles[0]
    total = np.square(noise / (0.1 * spread(plain.particles)[0])).sum(dtype=np.float64)
    assert SIGNIFICANCE < stats.chi2(noise.size).cdf(total) < 1 - SIGNIFICANCE


def test_what_the_motion_model_remembers_is_resampled_with_its_particle() -> None:
    one = cloud(4, heading=True)
    one.start(prior(yaw=0.0))
    one.states[0] = np.arange(12).reshape(4, 3)
    one.weights[0] = [0, 0, 1, 0]
    one.resample()
    np.testing.assert_array_equal(one.states[0], np.tile([6.0, 7.0, 8.0], (4, 1)))


def test_it_says_what_the_resampled_are_copies_of() -> None:
    both = weighted(0.5)
    before = both.states.copy()
    vehicle, index = both.resample()
    np.testing.assert_array_equal(vehicle, [0])
    np.testing.assert_array_equal(both.states[0], before[0, index[0]])


# Starting anew


def test_evidence_excludes_who_has_no_particle_that_explains_it() -> None:
    both = cloud(vehicles=2)
    both.start(prior(0, x=50.0))
    both.start(prior(1, x=500.0))
    np.testing.assert_array_equal(
        excluded(both, evidence(listen([(0.0, 0.0)], [(0.0, 0.0)]))), [False, True])


def test_one_particle_that_explains_the_evidence_is_enough() -> None:
    one = cloud()
    one.start(prior(x=500.0))
    one.states[0, 17] = [50.0, 0.0]
    assert not excluded(one, evidence(ONE))[0]


@pytest.mark.parametrize(('exclusion', 'expected'), [(11.0, True), (13.0, False)])
def test_the_config_says_how_unlikely_is_excluded(exclusion: float, expected: bool) -> None:
    one = cloud(exclusion=exclusion)
    one.start(prior(std=0.0))
    # Five standard deviations off is -12.5; a reference allows 0.7 more.
    off = evidence(listen([(1e4, 0.0)], range=1e4 + 5.0, range_std=1.0), radio_range=0.0)
    assert excluded(one, off)[0] == expected


def test_nobody_is_excluded_by_hearing_nothing() -> None:
    one = cloud()
    one.start(prior(x=500.0))
    assert not excluded(one, evidence(NOBODY))[0]


def test_who_is_placed_again_is_told_and_the_others_left_alone() -> None:
    both = cloud(vehicles=2)
    for vehicle in range(2):
        both.start(prior(vehicle, x=500.0))
    before = both.states[1].copy()
    again = listen([(0.0, 0.0)], [(0.0, 0.0)])
    both.place_again(np.array([True, False]), evidence(again))
    np.testing.assert_array_equal(both.estimate(again).reinitialized, [True, False])
    np.testing.assert_array_equal(both.states[1], before)
    assert np.linalg.norm(both.particles[0], axis=1).max() < 101.0


# Weights of moved particles


def test_moved_particles_are_favoured_where_the_prediction_was_dense() -> None:
    many = cloud(500, 40)
    predicted = np.random.default_rng(1).normal(0.0, 10.0, (40, 500, 2)).astype(np.float32)
    many.states[:] = np.random.default_rng(2).normal(6.0, 10.0, (40, 500, 2)).astype(np.float32)
    many.favour(np.arange(40), predicted, 0.3)
    mean = np.einsum('vn,vnd->vd', many.weights, many.particles)
    # A part of the particles as kernels leaves some error of each; a limit of the weights, a bias.
    np.testing.assert_allclose(mean, 0.0, atol=6.0)
    np.testing.assert_allclose(mean.mean(axis=0), 0.0, atol=1.0)
    np.testing.assert_allclose(many.weights.sum(axis=1), 1.0, atol=1e-5)
