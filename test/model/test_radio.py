"""
What a channel simulates against what it scores, and both against scipy's distributions.

Scores are relative to their peak, so that a likelihood equals scipy's but for a constant.
"""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy import special, stats
from tsmcl_ros.model.evidence import Evidence
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import ConfigError, Observation, Silence

# Statistical tests have fixed seeds and reject at one in a thousand.
SIGNIFICANCE = 1e-3
MANY = 20_000
SHADOWED = {'radio_model': 'lognormal', 'rssi_at_reference': -40.0, 'path_loss_exponent': 2.5,
            'sigma_db': 5.0, 'sensitivity': -90.0}  # half of the beacons carry 100 m


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def channel(radio: dict[str, Any] | None = None, **switches: Any) -> Channel:
    """Return a disk of 100 m, an edge of 2 m and no outliers, unless the settings say else."""
    settings = {'radio_range': 100.0, 'edge_softness': 2.0, **(radio or {})}
    return Channel(RadioConfig(**settings), EvidenceConfig(**{'outlier_fraction': 0.0,
                                                              **switches}))


def listen(*positions: tuple[float, ...], **fields: object) -> Observation:
    """Let one vehicle hear references at these positions [m]."""
    observation = Observation.empty(1, len(positions), len(positions[0]), 1.0)
    observation.sender[0] = np.arange(len(positions))
    observation.position[0] = positions
    for name, value in fields.items():
        getattr(observation, name)[0] = value
    return observation


def unheard(observation: Observation, *positions: tuple[float, ...],
            max_range: float = math.nan) -> Observation:
    """Return the same observation, with anchors at these positions [m] known and silent."""
    shape = (1, len(positions))
    return replace(observation, silent=Silence(
        known=np.ones(shape, bool), sender=100 + np.arange(len(positions))[None],
        position=np.array([positions], np.float32),
        max_range=np.full(shape, max_range, np.float32)))


def at(distance: object, direction: float = 0.0) -> np.ndarray:
    """Points (1, P, 2) at these distances [m] from the origin."""
    away = np.atleast_1d(np.asarray(distance, float))[:, None]
    return (away * [math.cos(direction), math.sin(direction)])[None].astype(np.float32)


def likelihood(radio: Channel, observation: Observation, points: np.ndarray) -> np.ndarray:
    return radio.evidence(observation).log_likelihood(points)[0]


ORIGIN = (0.0, 0.0)
NEAR_EDGE = np.linspace(80.0, 120.0, 41)


# Simulating


def test_a_disk_radio_hears_within_its_range_and_no_further() -> None:
    heard = channel().hear(np.array([[0.0, 99.9, 100.0, 100.1]]), rng())
    np.testing.assert_array_equal(heard.mask, [[True, True, True, False]])


def test_a_radio_that_measures_nothing_says_nothing_but_who_is_heard() -> None:
    heard = channel().hear(np.array([[50.0]]), rng())
    assert np.isnan([heard.range, heard.range_std, heard.rssi]).all()


def test_what_is_not_heard_is_not_measured() -> None:
    heard = channel({'measure_range': True, 'measure_rssi': True}).hear(
        np.array([[50.0, 150.0]]), rng())
    measured = np.stack([heard.range, heard.range_std, heard.rssi])
    np.testing.assert_array_equal(np.isnan(measured[:, 0]), [[False, True]] * 3)


def test_simulated_ranges_have_the_scale_bias_and_noise_of_the_config() -> None:
    radio = channel({'measure_range': True, 'range_std': 0.5, 'range_bias': 2.0,
                     'range_scale': 1.07})
    heard = radio.hear(np.full((1, MANY), 60.0), rng())
    expected = stats.norm(1.07 * 60.0 + 2.0, 0.5)
    assert stats.kstest(heard.range[0], expected.cdf).pvalue > SIGNIFICANCE
    np.testing.assert_array_equal(heard.range_std, np.float32(0.5))


def test_a_simulated_range_is_never_negative() -> None:
    heard = channel({'measure_range': True, 'range_std': 5.0}).hear(np.zeros((1, 100)), rng())
    assert heard.range.min() == 0.0


def test_simulated_rssi_lies_around_the_path_loss_curve() -> None:
    radio = channel({**SHADOWED, 'measure_rssi': True, 'reference_distance': 2.0,
                     'sensitivity': -300.0})
    heard = radio.hear(np.full((1, MANY), 20.0), rng())
    expected = stats.norm(-40.0 - 25.0 * math.log10(20.0 / 2.0), 5.0)
    assert stats.kstest(heard.rssi[0], expected.cdf).pvalue > SIGNIFICANCE


def test_under_shadowing_a_beacon_is_heard_if_its_rssi_meets_the_sensitivity() -> None:
    heard = channel({**SHADOWED, 'measure_rssi': True}).hear(np.full((1, MANY), 90.0), rng())
    assert heard.rssi[heard.mask].min() >= -90.0
    assert np.isnan(heard.rssi[~heard.mask]).all()


def test_the_range_under_shadowing_is_where_the_mean_rssi_meets_the_sensitivity() -> None:
    assert channel(SHADOWED).radio_range == pytest.approx(100.0)
    assert channel({**SHADOWED, 'reference_distance': 3.0}).radio_range == pytest.approx(300.0)


def test_hardly_anything_is_heard_beyond_the_reach() -> None:
    assert channel().reach == 100.0
    radio = channel({**SHADOWED, 'anchor_path_loss': ('7 -30 2 6',)})
    # Anchor 7 carries furthest: 60 dB below its -30 dBm at 1 m, and five times 6 dB of luck.
    assert radio.reach == pytest.approx(10 ** ((90.0 - 30.0 + 30.0) / 20.0))
    assert likelihood(radio, listen(ORIGIN, sender=7), at(radio.reach))[0] == pytest.approx(
        stats.norm.logcdf(-5.0), rel=1e-3)


def test_a_disk_without_a_range_cannot_be_simulated() -> None:
    with pytest.raises(ConfigError, match='radio_range: 0 is not allowed.* above 0 m'):
        channel({'radio_range': 0.0}).hear(np.array([[1.0]]), rng())


# What is simulated is what is scored


@pytest.mark.parametrize('distance', [40.0, 80.0, 100.0, 130.0, 200.0])
def test_beacons_are_heard_under_shadowing_as_often_as_is_scored(distance: float) -> None:
    radio = channel(SHADOWED)
    heard = radio.hear(np.full((1, MANY), distance), rng()).mask.sum()
    scored = math.exp(likelihood(radio, listen(ORIGIN), at(distance))[0])
    assert stats.binomtest(int(heard), MANY, scored).pvalue > SIGNIFICANCE


def test_a_sharp_disk_is_heard_where_it_is_scored() -> None:
    radio = channel({'edge_softness': 1e-3})
    distance = np.linspace(0.0, 200.0, 1000)
    heard = radio.hear(distance[None], rng()).mask[0]
    np.testing.assert_allclose(
        np.exp(likelihood(radio, listen(ORIGIN), at(distance))), heard, atol=1e-6)


@pytest.mark.parametrize(('radio', 'field'), [
    ({'measure_range': True, 'range_std': 3.0, 'range_bias': 2.0, 'range_scale': 1.07,
      'radio_range': 1e4}, 'range'),
    ({**SHADOWED, 'measure_rssi': True, 'reference_distance': 2.0, 'sensitivity': -200.0},
     'rssi'),
])
def test_measurements_are_scored_with_the_noise_that_they_are_simulated_with(
        radio: dict[str, Any], field: str) -> None:
    simulated = channel(radio).hear(np.full((1, MANY), 60.0), rng())
    observation = Observation.empty(MANY, 1, 2, 1.0)
    observation.sender[:] = 0
    getattr(observation, field)[:] = getattr(simulated, field).T
    scores = channel(radio, use_heard=False).evidence(observation).log_likelihood(at(60.0))
    # Minus twice the logarithm of a Gaussian over its peak is chi-squared.
    assert stats.kstest(-2 * scores[:, 0], stats.chi2(1).cdf).pvalue > SIGNIFICANCE


def test_asymmetric_ranges_err_by_the_published_law() -> None:
    radio = channel({'measure_range': True, 'range_noise': 'asymmetric_exponential'})
    heard = radio.hear(np.full((1, MANY), 60.0), rng())
    error = 60.0 - heard.range[0]
    short, long = 0.058 * 60.0 + 0.01, 0.19 * 60.0 + 0.21

    def cdf(e: np.ndarray) -> np.ndarray:
        return np.where(e <= 0, long * np.exp(np.minimum(e, 0) / long),
                        short + long - short * np.exp(-np.maximum(e, 0) / short)) / (short + long)

    assert stats.kstest(error, cdf).pvalue > SIGNIFICANCE
    # Ranges are long rather than short: e is true minus measured.
    assert error.mean() == pytest.approx(short - long, abs=0.5)
    indicated = heard.range[0]
    np.testing.assert_allclose(
        heard.range_std[0], np.hypot(0.058 * indicated + 0.01, 0.19 * indicated + 0.21), rtol=1e-5)


@pytest.mark.parametrize('distance', [10.0, 35.0, 50.0, 55.0, 80.0])
def test_an_asymmetric_range_is_scored_with_the_scales_of_what_was_measured(
        distance: float) -> None:
    radio = channel({'range_noise': 'asymmetric_exponential', 'range_scale': 1.1,
                     'range_bias': 5.0}, use_heard=False)
    error = distance - 50.0
    expected = -error / (0.058 * 50.0 + 0.01) if error > 0 else error / (0.19 * 50.0 + 0.21)
    assert likelihood(radio, listen(ORIGIN, range=60.0), at(distance))[0] == pytest.approx(
        expected, rel=1e-4, abs=1e-5)


def test_an_anchor_with_a_path_loss_of_its_own_is_heard_and_scored_by_it() -> None:
    radio = channel({**SHADOWED, 'anchor_path_loss': ('7 -50 2 4', '9 -30 3 8')})
    rest, seven, nine = (
        radio.hear(np.full((1, MANY), 130.0), rng(), np.array([sender])).mask.sum()
        for sender in (8, 7, 9))
    for sender, heard, margin in (
            (8, rest, 25.0 * math.log10(100.0 / 130.0) / 5.0),
            (7, seven, (40.0 - 20.0 * math.log10(130.0)) / 4.0),
            (9, nine, (60.0 - 30.0 * math.log10(130.0)) / 8.0)):
        score = likelihood(radio, listen(ORIGIN, sender=sender), at(130.0))[0]
        assert score == pytest.approx(stats.norm.logcdf(margin), rel=1e-4)
        assert stats.binomtest(int(heard), MANY, math.exp(score)).pvalue > SIGNIFICANCE


def test_an_anchor_s_rssi_is_scored_by_its_own_path_loss() -> None:
    radio = channel({**SHADOWED, 'anchor_path_loss': ('7 -50 2 4',)})
    score = likelihood(radio, listen(ORIGIN, rssi=-86.0, sender=7), at(100.0))[0]
    assert score == pytest.approx(-0.5 * ((-86.0 + 90.0) / 4.0) ** 2, rel=1e-4)


# Heard, silent, relayed


def test_a_heard_beacon_s_disk_has_a_logistic_edge() -> None:
    np.testing.assert_allclose(
        likelihood(channel(), listen(ORIGIN), at(NEAR_EDGE)),
        special.log_expit(-(NEAR_EDGE - 100.0) / 2.0), rtol=1e-4, atol=1e-5)


def test_the_edge_is_a_fiftieth_of_the_range_unless_the_config_says_else() -> None:
    np.testing.assert_allclose(
        likelihood(channel({'edge_softness': 0.0, 'radio_range': 500.0}), listen(ORIGIN),
                   at(520.0)), special.log_expit(-2.0), rtol=1e-4)


def test_a_silent_anchor_s_disk_is_scored_outside() -> None:
    observation = unheard(listen((40.0, 0.0)), ORIGIN)
    both = likelihood(channel(), observation, at(NEAR_EDGE))
    heard = likelihood(channel(silence='none'), observation, at(NEAR_EDGE))
    np.testing.assert_allclose(
        both - heard, special.log_expit((NEAR_EDGE - 100.0) / 2.0), rtol=1e-3, atol=1e-5)


def test_a_relayed_beacon_is_between_one_and_two_ranges_away() -> None:
    distance = np.array([0.0, 50.0, 95.0, 105.0, 150.0, 195.0, 205.0, 250.0])
    score = likelihood(channel(), listen(ORIGIN, hops=2), at(distance))
    np.testing.assert_allclose(score, special.log_expit((distance - 100.0) / 2.0)
                               + special.log_expit((200.0 - distance) / 2.0), rtol=1e-4,
                               atol=1e-6)
    np.testing.assert_array_equal(
        score > math.log(0.5), [False, False, False, True, True, True, False, False])


def test_hearing_under_shadowing_is_scored_by_the_normal_distribution() -> None:
    distance = np.array([1.0, 50.0, 100.0, 200.0, 1000.0])
    margin = 25.0 * np.log10(100.0 / distance) / 5.0
    np.testing.assert_allclose(likelihood(channel(SHADOWED), listen(ORIGIN), at(distance)),
                               stats.norm.logcdf(margin), rtol=1e-4, atol=1e-7)


def test_silence_under_shadowing_is_scored_by_the_normal_distribution() -> None:
    distance = np.array([10.0, 50.0, 100.0, 200.0, 1000.0])
    observation = unheard(listen((40.0, 0.0)), ORIGIN)
    both = likelihood(channel(SHADOWED), observation, at(distance))
    heard = likelihood(channel(SHADOWED, silence='none'), observation, at(distance))
    margin = 25.0 * np.log10(100.0 / distance) / 5.0
    np.testing.assert_allclose(both - heard, stats.norm.logsf(margin), rtol=1e-4, atol=1e-5)


def test_a_relayed_beacon_under_shadowing_is_between_one_and_two_ranges_away() -> None:
    score = likelihood(channel({**SHADOWED, 'sigma_db': 0.5}), listen(ORIGIN, hops=2),
                       at([50.0, 150.0, 250.0]))
    np.testing.assert_array_equal(score > math.log(0.9), [False, True, False])


def test_a_beacon_that_tells_its_range_is_scored_by_it() -> None:
    score = likelihood(channel(), listen(ORIGIN, max_range=300.0), at([200.0, 400.0]))
    np.testing.assert_allclose(score, special.log_expit([50.0, -50.0]), atol=1e-5)


@pytest.mark.parametrize('settings', [
    {'radio_range': 100.0}, {'radio_model': 'lognormal', 'sensitivity': -80.0}])
def test_silence_says_no_more_than_how_often_beacons_are_lost_allows(settings) -> None:
    radio = Channel(RadioConfig(**settings))
    observation = unheard(listen((900.0, 0.0)), (0.0, 0.0))
    surely = likelihood(radio, unheard(observation, (0.0, 0.0)), at([1, 60, 100, 150]))
    assert observation.silent is not None
    rate = np.full((1, 1), 0.02, np.float32)
    now = replace(observation, silent=replace(observation.silent, miss_rate=rate))
    heard = likelihood(radio, listen((900.0, 0.0)), at([1, 60, 100, 150]))
    outside = np.exp((surely - heard).astype(float))
    np.testing.assert_allclose(
        np.exp((likelihood(radio, now, at([1, 60, 100, 150])) - heard).astype(float)),
        outside + 0.02 * (1 - outside), rtol=0.01)


def test_a_silent_anchor_that_tells_its_range_is_scored_by_it() -> None:
    observation = unheard(listen(ORIGIN), ORIGIN, max_range=30.0)
    np.testing.assert_allclose(
        likelihood(channel(), observation, at([20.0, 40.0])), [-5.0, 0.0], atol=1e-2)


def test_without_any_radio_range_to_be_heard_says_nothing() -> None:
    radio = channel({'radio_range': 0.0})
    observation = unheard(listen(ORIGIN), (10.0, 0.0))
    np.testing.assert_array_equal(likelihood(radio, observation, at([1.0, 1e4])), [0.0, 0.0])


@pytest.mark.parametrize('radio', [{}, SHADOWED])
def test_a_vehicle_that_heard_nothing_gets_no_silence_either(radio: dict[str, Any]) -> None:
    observation = unheard(replace(listen(ORIGIN), sender=np.array([[-1]])), ORIGIN)
    evidence = channel(radio).evidence(observation)
    assert not evidence.heard[0]
    np.testing.assert_array_equal(evidence.log_likelihood(at([0.0, 50.0, 500.0])), [[0, 0, 0]])


# Measured


def peak(score: np.ndarray) -> np.ndarray:
    return score - score.max()


def test_a_range_is_scored_by_the_normal_distribution() -> None:
    radio = channel({'range_bias': 2.0, 'range_scale': 1.07}, use_heard=False)
    distance = np.arange(0.0, 100.0, 5.0)
    observation = listen(ORIGIN, range=1.07 * 50.0 + 2.0, range_std=3.0)
    expected = stats.norm(1.07 * 50.0 + 2.0, 3.0).logpdf(1.07 * distance + 2.0)
    np.testing.assert_allclose(
        likelihood(radio, observation, at(distance)), peak(expected), rtol=1e-4, atol=1e-4)


def test_a_range_that_tells_no_noise_has_that_of_the_config() -> None:
    radio = channel({'range_std': 4.0}, use_heard=False)
    assert likelihood(radio, listen(ORIGIN, range=50.0), at(58.0))[0] == pytest.approx(-2.0)


def test_an_rssi_is_scored_by_the_normal_distribution_in_db() -> None:
    radio = channel({**SHADOWED, 'reference_distance': 2.0})
    distance = np.array([2.0, 20.0, 100.0, 200.0])
    expected = stats.norm(-40.0 - 25.0 * np.log10(distance / 2.0), 5.0).logpdf(-65.0)
    np.testing.assert_allclose(
        likelihood(radio, listen(ORIGIN, rssi=-65.0), at(distance)), peak(expected),
        rtol=1e-4, atol=1e-4)


def test_an_rssi_weighs_near_references_more_as_a_lognormal_distance_does() -> None:
    near, far = (
        likelihood(channel(SHADOWED), listen(ORIGIN, rssi=-40.0 - 25.0 * math.log10(distance)),
                   at(distance + 1.0))[0]
        for distance in (10.0, 50.0))
    # std of d is d sigma_db ln10 / (10 n): five times as far, a metre counts 25 times less.
    assert near / far == pytest.approx(25.0, rel=0.1)


def test_an_rssi_holds_what_hearing_it_says_so_that_does_not_count_twice() -> None:
    observation = listen(ORIGIN, rssi=-80.0)
    np.testing.assert_array_equal(
        likelihood(channel(SHADOWED), observation, at(NEAR_EDGE)),
        likelihood(channel(SHADOWED, use_heard=False), observation, at(NEAR_EDGE)))


def test_an_rssi_says_nothing_under_the_disk_model() -> None:
    np.testing.assert_array_equal(likelihood(channel(), listen(ORIGIN, rssi=-30.0), at(90.0)),
                                  likelihood(channel(), listen(ORIGIN), at(90.0)))


def test_kinds_of_evidence_add_up() -> None:
    observation = unheard(listen(ORIGIN, range=90.0, range_std=3.0), (150.0, 0.0))
    total = likelihood(channel(), observation, at(NEAR_EDGE))
    parts = [
        likelihood(channel(silence='none', use_range=False), observation, at(NEAR_EDGE)),
        likelihood(channel(use_heard=False, use_range=False), observation, at(NEAR_EDGE)),
        likelihood(channel(use_heard=False, silence='none'), observation, at(NEAR_EDGE)),
    ]
    assert all(part.any() for part in parts)
    np.testing.assert_allclose(total, sum(parts), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(('radio', 'observation', 'switch'), [
    ({}, listen(ORIGIN), {'use_heard': False}),
    ({'radio_range': 0.0}, listen(ORIGIN, range=50.0), {'use_range': False}),
    (SHADOWED, listen(ORIGIN, rssi=-50.0), {'use_rssi': False, 'use_heard': False}),
])
def test_evidence_that_is_switched_off_says_nothing(
        radio: dict[str, Any], observation: Observation, switch: dict[str, Any]) -> None:
    points = at([0.0, 90.0, 300.0])
    assert likelihood(channel(radio), observation, points).any()
    assert not likelihood(channel(radio, **switch), observation, points).any()


def test_an_rssi_that_does_not_count_leaves_that_it_was_heard() -> None:
    np.testing.assert_array_equal(
        likelihood(channel(SHADOWED, use_rssi=False), listen(ORIGIN, rssi=-50.0), at(NEAR_EDGE)),
        likelihood(channel(SHADOWED), listen(ORIGIN), at(NEAR_EDGE)))


@pytest.mark.parametrize(('radio', 'fields'), [
    ({}, {'range': 50.0, 'range_std': 1.0}), (SHADOWED, {'rssi': -60.0}),
])
def test_the_uniform_floor_bounds_how_bad_a_measurement_can_be(
        radio: dict[str, Any], fields: dict[str, float]) -> None:
    score = likelihood(channel(radio, use_heard=False, outlier_fraction=0.1),
                       listen(ORIGIN, **fields), at(np.geomspace(0.01, 1e5, 50)))
    assert score.min() == pytest.approx(math.log(0.1), rel=1e-5)


def test_the_uniform_floor_mixes_with_the_gaussian() -> None:
    radio = channel(use_heard=False, outlier_fraction=0.1)
    observation = listen(ORIGIN, range=50.0, range_std=2.0)
    gaussian = np.exp(-0.5 * ((np.array([50.0, 52.0, 56.0]) - 50.0) / 2.0) ** 2)
    np.testing.assert_allclose(likelihood(radio, observation, at([50.0, 52.0, 56.0])),
                               np.log(0.9 * gaussian + 0.1), atol=1e-5)


# References that are not exactly where they claim to be


def uncertain(*spread: float, **fields: object) -> Observation:
    """Return a reference at the origin with these standard deviations [m] along the axes."""
    return listen(ORIGIN, covariance=np.diag(np.square(spread)), **fields)


def marginal(radio: Channel, observation: Observation, points: np.ndarray) -> np.ndarray:
    """Average the likelihood over 20 000 true positions of the reference."""
    claimed = np.linalg.cholesky(observation.covariance[0, 0].astype(float))
    moved = rng().normal(size=(MANY, 2)) @ claimed.T
    exact = replace(observation, covariance=np.zeros_like(observation.covariance))
    # The reference moved one way is the point moved the other.
    several = (points[0][:, None] - moved).reshape(1, -1, 2).astype(np.float32)
    return np.exp(likelihood(radio, exact, several)).reshape(len(points[0]), MANY).mean(axis=1)


@pytest.mark.parametrize('edge', [0.1, 2.0, 10.0])
def test_a_disk_s_edge_widens_as_the_average_over_the_reference_s_position(edge: float) -> None:
    radio = channel({'edge_softness': edge})
    observation = uncertain(5.0, 5.0)
    # A logistic curve is within 0.01 of a Gaussian's; averaging leaves an error of 0.005, and
    # that the disk is not straight another 0.25 m, or 0.02.
    np.testing.assert_allclose(np.exp(likelihood(radio, observation, at(NEAR_EDGE))),
                               marginal(radio, observation, at(NEAR_EDGE)), atol=0.035)


def test_a_shadowed_edge_widens_as_the_average_over_the_reference_s_position() -> None:
    radio = channel({**SHADOWED, 'sigma_db': 1.0})
    observation = uncertain(10.0, 10.0)
    np.testing.assert_allclose(np.exp(likelihood(radio, observation, at(NEAR_EDGE))),
                               marginal(radio, observation, at(NEAR_EDGE)), atol=0.035)


def test_a_range_s_noise_widens_as_the_average_over_the_reference_s_position() -> None:
    radio = channel({'range_scale': 1.07}, use_heard=False)
    observation = uncertain(3.0, 3.0, range=107.0, range_std=2.0)
    points = at(np.linspace(95.0, 105.0, 11))
    expected = np.log(marginal(radio, observation, points))
    # Averaged over 20 000 positions; sideways movement shifts the distance by 0.05 m.
    np.testing.assert_allclose(
        likelihood(radio, observation, points) - likelihood(radio, observation, at(100.0)),
        expected - expected[5], atol=0.05)


def test_an_rssi_s_noise_widens_as_the_average_over_the_reference_s_position() -> None:
    radio = channel({**SHADOWED, 'sigma_db': 1.0})
    observation = uncertain(5.0, 5.0, rssi=-90.0)
    points = at(np.linspace(90.0, 110.0, 11))
    expected = np.log(marginal(radio, observation, points))
    np.testing.assert_allclose(
        likelihood(radio, observation, points) - likelihood(radio, observation, at(100.0)),
        expected - expected[5], atol=0.1)


ASYMMETRIC = {'range_noise': 'asymmetric_exponential'}
AROUND = np.concatenate([at(distance, direction)[0] for distance in (12.0, 20.0, 26.0)
                         for direction in (0.0, 0.8, math.pi / 2)])[None]


@pytest.mark.parametrize('covariance', [
    [[25.0, 0.0], [0.0, 1.0]], [[25.0, 12.0], [12.0, 9.0]], [[100.0, 0.0], [0.0, 100.0]]])
@pytest.mark.parametrize(('radio', 'fields', 'points'), [
    ({}, {'range': 20.0, 'range_std': 2.0}, AROUND),
    (ASYMMETRIC, {'range': 20.0}, AROUND),
    (SHADOWED, {'rssi': -90.0}, 5 * AROUND),
])
def test_positions_compare_as_averaged_over_where_an_uncertain_reference_may_be(
        radio: dict[str, Any], fields: dict[str, float], points: np.ndarray,
        covariance: list[list[float]]) -> None:
    observation = listen(ORIGIN, covariance=covariance, **fields)
    expected = np.log(marginal(channel(radio, use_heard=False), observation, points))
    scored = likelihood(channel(radio, use_heard=False), observation, points)
    likely = expected > expected.max() - 2.0
    # Second order in the reference's offset, which is nearly as large as the distance here.
    np.testing.assert_allclose((scored - expected)[likely],
                               (scored - expected)[expected.argmax()], atol=0.4)
    # Relative to a peak that no position exceeds.
    assert -1.0 < scored.max() <= 0.0


def test_a_heard_beacon_s_uncertain_disk_needs_no_normalizer() -> None:
    # Whether a beacon is heard is a probability already: averaging it only widens the edge.
    observation = uncertain(9.0, 1.0)
    for direction in (0.0, math.pi / 2):
        points = at(NEAR_EDGE, direction)
        np.testing.assert_allclose(np.exp(likelihood(channel(), observation, points)),
                                   marginal(channel(), observation, points), atol=0.02)


# Many vehicles, padding, flat lists


def some_evidence(model: str, seed: int, covariance: bool, dimension: int = 2,
                  ) -> tuple[Channel, Observation]:
    """Three vehicles, of which the last heard nothing, with all kinds of evidence and padding."""
    draw = rng(seed)
    radio = channel({'radio_model': model, 'edge_softness': 20.0,
                     'range_noise': str(draw.choice(['gaussian', 'asymmetric_exponential'])),
                     'anchor_path_loss': ('2 -50 1.5 3', '7 -30 3 6')},
                    outlier_fraction=float(draw.choice([0.0, 0.1])))
    observation = Observation.empty(3, 5, dimension, 1.0)
    observation.sender[:2] = np.where(draw.random((2, 5)) < 0.6, np.arange(5), -1)
    observation.sender[0, 0] = 7
    observation.position[:] = draw.uniform(-100, 100, (3, 5, dimension))
    observation.hops[:] = draw.choice([1, 2], (3, 5))
    for field, low, high in (('range', 10, 100), ('rssi', -90, -50), ('max_range', 50, 150)):
        known = draw.random((3, 5)) < 0.5
        getattr(observation, field)[known] = draw.uniform(low, high, known.sum())
    if covariance:
        factor = draw.normal(0, 5, (3, 5, dimension, dimension)).astype(np.float32)
        observation.covariance[:] = factor @ np.swapaxes(factor, 2, 3)
    silent = Silence(
        known=draw.random((3, 4)) < 0.7, sender=draw.integers(0, 10, (3, 4)),
        position=draw.uniform(-200, 200, (3, 4, dimension)).astype(np.float32),
        max_range=np.where(draw.random((3, 4)) < 0.5, 60, np.nan).astype(np.float32))
    return radio, replace(observation, silent=silent)


evidence_of_all_kinds = given(
    model=st.sampled_from(['disk', 'lognormal']), seed=st.integers(0, 2**32),
    covariance=st.booleans(), dimension=st.sampled_from([2, 3]))


@evidence_of_all_kinds
def test_a_flat_list_of_points_is_scored_as_each_vehicle_s_own(
        model: str, seed: int, covariance: bool, dimension: int) -> None:
    radio, observation = some_evidence(model, seed, covariance, dimension)
    evidence = radio.evidence(observation)
    points = rng(seed).uniform(-200, 200, (3, 20, dimension)).astype(np.float32)
    vehicle, index = rng(seed).permutation(np.argwhere(np.ones((3, 20)))).T
    np.testing.assert_allclose(
        evidence.log_likelihood_of(points[vehicle, index], vehicle),
        evidence.log_likelihood(points)[vehicle, index], rtol=1e-5, atol=1e-5)


@evidence_of_all_kinds
def test_a_fleet_is_scored_as_its_vehicles_are(
        model: str, seed: int, covariance: bool, dimension: int) -> None:
    radio, observation = some_evidence(model, seed, covariance, dimension)
    points = rng(seed).uniform(-200, 200, (3, 20, dimension)).astype(np.float32)
    fleet = radio.evidence(observation)
    assert observation.silent is not None
    for vehicle in range(3):
        # Alone, without any padding.
        known = observation.silent.known[vehicle]
        silent = Silence(**{name: None if values is None else values[None, vehicle, known]
                            for name, values in vars(observation.silent).items()})
        alone = radio.evidence(replace(observation.vehicle(vehicle), silent=silent))
        np.testing.assert_allclose(
            fleet.log_likelihood(points)[vehicle], alone.log_likelihood(points[[vehicle]])[0],
            rtol=1e-5, atol=1e-5)
        assert fleet.terms[vehicle] == alone.terms[0]
        assert fleet.heard[vehicle] == alone.heard[0]
        np.testing.assert_allclose(fleet.box[vehicle], alone.box[0], rtol=1e-6)


@evidence_of_all_kinds
def test_scores_are_finite_and_never_above_their_peak(
        model: str, seed: int, covariance: bool, dimension: int) -> None:
    radio, observation = some_evidence(model, seed, covariance, dimension)
    points = rng(seed).uniform(-1e5, 1e5, (3, 20, dimension)).astype(np.float32)
    points[:, :5] = observation.position  # where distances are zero
    score = radio.evidence(observation).log_likelihood(points)
    assert np.isfinite(score).all()
    assert score.max() <= 0


@evidence_of_all_kinds
def test_presence_and_measurements_are_all_there_is(
        model: str, seed: int, covariance: bool, dimension: int) -> None:
    radio, observation = some_evidence(model, seed, covariance, dimension)
    evidence = radio.evidence(observation)
    points = rng(seed).uniform(-200, 200, (3, 20, dimension)).astype(np.float32)
    np.testing.assert_allclose(
        evidence.presence.log_likelihood(points) + evidence.measured.log_likelihood(points),
        evidence.log_likelihood(points), rtol=1e-5, atol=1e-5)


def test_shared_points_are_scored_for_every_vehicle() -> None:
    radio, observation = some_evidence('disk', 1, False)
    evidence = radio.evidence(observation)
    points = rng().uniform(-200, 200, (1, 20, 2)).astype(np.float32)
    np.testing.assert_array_equal(evidence.log_likelihood(points),
                                  evidence.log_likelihood(np.repeat(points, 3, axis=0)))


@pytest.mark.parametrize(('radio', 'observation', 'terms'), [
    ({}, listen(ORIGIN, (9.0, 9.0)), 2),
    ({}, listen(ORIGIN, (9.0, 9.0), range=[50.0, math.nan]), 3),
    ({}, listen(ORIGIN, (9.0, 9.0), hops=[1, 2]), 3),
    ({}, unheard(listen(ORIGIN), (300.0, 0.0), (0.0, 300.0)), 3),
    (SHADOWED, listen(ORIGIN, (9.0, 9.0), rssi=[-50.0, math.nan]), 2),
    ({'radio_range': 0.0}, listen(ORIGIN), 1),
])
def test_terms_count_what_is_multiplied(
        radio: dict[str, Any], observation: Observation, terms: int) -> None:
    assert channel(radio).evidence(observation).terms[0] == terms


# The box that holds all likely positions


def outside(evidence: Evidence, count: int = 4000) -> np.ndarray:
    """Points (1, P, D) all around the box of the first vehicle, none within."""
    low, high = evidence.box[0]
    size = high - low
    points = rng().uniform(low - size, high + size, (count, len(low)))
    within = ((points >= low) & (points <= high)).all(axis=1)
    return points[~within][None].astype(np.float32)


@pytest.mark.parametrize(('radio', 'observation'), [
    ({}, listen(ORIGIN)),
    ({}, listen(ORIGIN, (120.0, 50.0))),
    ({}, listen(ORIGIN, hops=2)),
    ({}, listen(ORIGIN, (120.0, 0.0), range=[60.0, 80.0], range_std=3.0)),
    ({'radio_range': 0.0, 'range_scale': 1.07, 'range_bias': 5.0},
     listen(ORIGIN, (50.0, 50.0), range=[60.0, 40.0], range_std=3.0)),
    ({}, listen((0.0, 0.0, 0.0), (120.0, 0.0, 30.0), range=[60.0, 80.0], range_std=3.0)),
    ({'radio_range': 0.0, 'range_noise': 'asymmetric_exponential'},
     listen(ORIGIN, (50.0, 50.0), range=[60.0, 40.0])),
    (SHADOWED, listen(ORIGIN, (50.0, 50.0))),
    (SHADOWED, listen(ORIGIN, (50.0, 50.0), rssi=[-80.0, -70.0])),
    ({}, listen(ORIGIN, (120.0, 0.0), range=[60.0, 80.0], range_std=3.0,
                covariance=25.0 * np.eye(2))),
])
def test_no_likely_position_is_outside_of_the_box(
        radio: dict[str, Any], observation: Observation) -> None:
    evidence = channel(radio).evidence(observation)
    # The box reaches three standard deviations: a Gaussian's density has fallen to exp(-4.5)
    # there, a shadowed edge to Phi(-3), a logistic one to exp(-3).
    assert np.exp(evidence.log_likelihood(outside(evidence))).max() < 0.05


def test_the_box_of_two_disks_holds_their_lens_and_little_more() -> None:
    box = channel({'edge_softness': 1e-3}).evidence(listen(ORIGIN, (120.0, 0.0))).box[0]
    np.testing.assert_allclose(box, [[20.0, -100.0], [100.0, 100.0]], atol=0.01)


def test_references_that_contradict_each_other_give_the_smallest_box() -> None:
    evidence = channel().evidence(
        listen(ORIGIN, (1000.0, 0.0), range=[50.0, 20.0], range_std=1.0))
    np.testing.assert_allclose(evidence.box[0], [[977.0, -23.0], [1023.0, 23.0]])


def test_references_that_bound_nothing_give_a_box_around_themselves() -> None:
    evidence = channel({'radio_range': 0.0}).evidence(listen(ORIGIN, (100.0, 40.0)))
    np.testing.assert_allclose(evidence.box[0], [[-100.0, -100.0], [200.0, 140.0]])


# Rssi of disks


def test_a_disk_radio_that_measures_rssi_is_scored_by_it_beside_its_edge() -> None:
    observation = Observation.empty(1, 1, 2, 0.0)
    observation.sender[:] = 0
    observation.rssi[:] = -80.0
    points = np.array([[[20.0, 0.0], [100.0, 0.0], [160.0, 0.0]]], np.float32)
    found = {}
    for measures in (False, True):
        radio = Channel(
            RadioConfig(radio_range=150.0, edge_softness=1.0, measure_rssi=measures,
                        path_loss_exponent=2.0, sigma_db=4.0),
            EvidenceConfig(outlier_fraction=0.0))
        found[measures] = radio.evidence(observation).log_likelihood(points)[0]
    np.testing.assert_allclose(found[False], [0, 0, -10], atol=1e-3)
    # At 20 m the mean is -66 dBm, at 100 m -80 dBm.
    assert found[True][0] == pytest.approx(-0.5 * ((-80 + 40 + 20 * np.log10(20)) / 4) ** 2, 1e-3)
    assert found[True][1] == pytest.approx(0, abs=1e-3)
    assert found[True][2] < -10
