"""The adaptive beacon period, and what it costs on the air."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.model.period import AirCost, omega, PeriodConfig, Schedule
from tsmcl_ros.types import ConfigError, Observation


@pytest.mark.parametrize(('residual', 'expected'), [
    (0.0, 1 / (1 / 15 + 1e-6)), (math.log(1e6 / 15), 7.5), (math.log(1e6), 15 / 16),
])
def test_the_factor_is_that_of_the_formula(residual: float, expected: float) -> None:
    assert omega(np.array(residual)) == pytest.approx(expected, rel=1e-12)


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_any_residual_gives_a_factor(residual: float) -> None:
    value = float(omega(np.array(residual)))
    assert 0 <= value <= 15.000001
    [factor] = PeriodConfig(beacon_period='adaptive').factor(np.array([residual]))
    assert 1 <= factor <= 15


def test_the_steepest_point_is_where_alpha_and_q_say() -> None:
    residual = np.linspace(0, 20, 20_001)
    for q, alpha in ((10.0, 1e4), (15.0, 1e6), (25.0, 1e5)):
        slope = np.gradient(omega(residual, q, alpha), residual)
        assert residual[slope.argmin()] == pytest.approx(math.log(alpha / q), abs=0.002)
        assert slope.min() == pytest.approx(-q / 4, rel=1e-4)


def test_larger_q_means_a_larger_factor_and_larger_alpha_a_wider_curve() -> None:
    residual = np.linspace(0, 10, 50)
    assert (omega(residual, 20.0) > omega(residual, 15.0)).all()
    wide, narrow = omega(residual, 15.0, 1e6), omega(residual, 15.0, 1e4)
    assert (wide > narrow).all()
    assert wide[0] == pytest.approx(narrow[0], rel=0.002)


def test_a_fixed_period_is_asked_for_unless_it_is_every_one() -> None:
    assert not PeriodConfig().asks
    assert PeriodConfig(period_factor=5).asks
    assert PeriodConfig(beacon_period='adaptive').asks
    np.testing.assert_array_equal(PeriodConfig(period_factor=5).factor(np.zeros(2)), [5, 5])


@pytest.mark.parametrize('settings', [
    {'period_q': 0.0}, {'period_alpha': 0.0}, {'period_alpha': math.inf}, {'period_q': math.nan},
    {'period_q': 15.0, 'period_alpha': 1000.0}, {'period_factor': 0},
    {'period_factor': 2 ** 31}, {'beacon_period': 'sometimes'},
])
def test_what_makes_no_period_is_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match='is not allowed, must be'):
        PeriodConfig(**settings)  # type: ignore[arg-type]


def test_messages_weigh_what_the_paper_says() -> None:
    cost = AirCost(vehicles=20, anchors=10, max_factor=15)
    assert cost.localization_bits == 5 + 1 + 28 + 30  # 30 senders take 5 bits
    assert cost.period_bits == 5 + 1 + 5 + 4
    assert AirCost(1, 1, 1).period_bits == 1 + 1


@given(st.integers(1, 10_000), st.integers(0, 10_000), st.integers(1, 2 ** 31 - 1))
def test_every_number_fits_into_its_bits(vehicles: int, anchors: int, factor: int) -> None:
    cost = AirCost(vehicles, anchors, factor)
    sender, receiver, period = (math.ceil(math.log2(count)) for count in (
        vehicles + anchors, vehicles, factor))
    assert cost.period_bits == sender + 1 + receiver + period


def heard(*counts: int) -> Observation:
    """Return an observation of vehicles that hear so many beacons each."""
    observation = Observation.empty(len(counts), max(counts), 2, 1.0)
    for vehicle, count in enumerate(counts):
        observation.sender[vehicle, :count] = np.arange(count)
    return observation


def test_beacons_come_when_asked_for() -> None:
    schedule = Schedule(2)
    got = []
    for period in range(12):
        got.append(schedule.pass_on(heard(3, 2)).heard.sum(axis=1).tolist())
        if period == 2:
            schedule.ask(1, 4)
        if period == 8:
            schedule.ask(1, 1)
    assert [first for first, _ in got] == [3] * 12
    assert [second for _, second in got] == [2, 2, 2, 0, 0, 0, 2, 0, 0, 2, 2, 2]
    assert schedule.localizations.tolist() == [12 * 3, 7 * 2]
    assert schedule.requests.tolist() == [0, 2]
    cost = AirCost(2, 3, 4)
    assert schedule.bits(3) == 50 * cost.localization_bits + 2 * cost.period_bits


def test_who_hears_nothing_at_its_time_hears_the_next_beacon() -> None:
    schedule = Schedule(1)
    schedule.pass_on(heard(1))
    schedule.ask(0, 3)
    got = [bool(schedule.pass_on(heard(count)).heard.any()) for count in (1, 1, 0, 0, 1, 1)]
    assert got == [False, False, False, False, True, False]


def test_nobody_who_asks_for_nothing_misses_anything() -> None:
    observation = heard(2, 0, 1)
    np.testing.assert_array_equal(Schedule(3).pass_on(observation).sender, observation.sender)
