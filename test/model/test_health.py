"""When a vehicle is taken for lost, and a sender for unsound."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.config import ConfigError
from tsmcl_ros.model.consistency import Deviations
from tsmcl_ros.model.health import HealthConfig, HealthMonitor
from tsmcl_ros.types import pairs_of

RIGHT, WRONG = 0.5, 9.0


def said(*rows, silent=()):
    """Return what V vehicles hear: the deviation of senders 1, 2, and so on; None for nothing."""
    deviation = np.array([[0 if value is None else value for value in row] for row in rows], float)
    heard = np.array([[value is not None for value in row] for row in rows])
    sender = np.tile(np.arange(1, heard.shape[1] + 1), (len(rows), 1))
    return Deviations(
        sender, heard, np.isin(sender, silent) & heard, np.zeros_like(heard), deviation)


def judge(monitor, epoch, disproved=()):
    contradicts, counts = monitor.judge_vehicles(epoch)
    monitor.judge_senders(
        pairs_of(epoch.sender), contradicts, counts, np.array(disproved, np.int64))


def watch(*epochs, vehicles=1, **settings):
    monitor = HealthMonitor(HealthConfig(**settings), vehicles)
    for epoch in epochs:
        judge(monitor, epoch)
    return monitor


def test_whom_beacons_agree_with_is_not_lost():
    assert watch(*[said([RIGHT] * 3)] * 50).lost < 0.01


@pytest.mark.parametrize(('epoch', 'epochs'), [
    ([WRONG] * 3, 1), ([WRONG, WRONG, RIGHT], 2), ([WRONG], 4)])
def test_whom_most_beacons_contradict_is_lost_soon(epoch, epochs):
    assert watch(*[said([RIGHT] * 3)] * 50, *[said(epoch)] * epochs).lost > 0.5


@pytest.mark.parametrize('heard', [1, 2, 5])
def test_who_is_lost_is_found_once_beacons_agree(heard):
    monitor = watch(*[said([WRONG] * heard)] * 10)
    assert monitor.lost > 0.99
    for _ in range(-(-12 // heard)):
        judge(monitor, said([RIGHT] * heard))
    assert monitor.lost < 0.5


def test_a_lone_contradiction_among_few_beacons_is_taken_for_an_outlier():
    assert watch(*[said([RIGHT])] * 20, said([WRONG])).lost < 0.5


def test_a_sender_alone_makes_no_vehicle_lost_that_hears_others():
    assert watch(*[said([WRONG, RIGHT, RIGHT])] * 100).lost < 0.01


def test_a_sender_that_contradicts_what_others_agree_on_is_suspected_within_ten_epochs():
    monitor = watch(*[said([WRONG, RIGHT, RIGHT])] * 6)
    assert monitor.suspects() == [[1]]
    assert monitor.suspected(pairs_of(np.array([[3, 1, -1]]))).tolist() == [[False, True, False]]


def test_suspects_do_not_outvote_others():
    monitor = watch(*[said([WRONG, WRONG, RIGHT, RIGHT, RIGHT])] * 10)
    judge(monitor, said([WRONG, WRONG, RIGHT, None, None]))
    assert monitor.suspects() == [[1, 2]]
    assert monitor.lost < 0.5


def test_an_honest_sender_is_not_suspected_for_its_outliers():
    rng = np.random.default_rng(1)
    vehicles, epochs = 50, 400
    monitor = HealthMonitor(HealthConfig(), vehicles)
    for _ in range(epochs):
        wrong = rng.random((vehicles, 6)) < 0.02
        judge(monitor, said(*np.where(wrong, WRONG, RIGHT).tolist()))
        assert not any(monitor.suspects())
    assert (monitor.lost < 0.5).all()


def test_a_sender_is_cleared_once_it_agrees():
    monitor = watch(*[said([WRONG, RIGHT, RIGHT])] * 30)
    for _ in range(25):
        judge(monitor, said([RIGHT] * 3))
    assert monitor.suspects() == [[]]


def test_a_sender_that_is_never_met_again_is_forgotten():
    monitor = watch(*[said([WRONG, RIGHT, RIGHT])] * 30)
    for _ in range(100):
        judge(monitor, said([None, RIGHT, RIGHT]))
    assert monitor.suspects() == [[]]


def test_a_lost_vehicle_suspects_nobody():
    assert watch(*[said([WRONG] * 3)] * 30).suspects() == [[]]


def test_an_anchor_that_falls_silent_is_suspected():
    assert watch(*[said([RIGHT, RIGHT, WRONG], silent=[3])] * 10).suspects() == [[3]]


def test_silence_that_was_expected_is_no_vote():
    far = [said([WRONG, RIGHT, RIGHT, RIGHT], silent=[2, 3, 4])]
    assert watch(*far * 10).lost > 0.5


def test_who_hears_nothing_stays_as_it_was():
    monitor = watch(*[said([WRONG] * 3)] * 5)
    before = monitor.lost.copy()
    for _ in range(100):
        judge(monitor, said([None] * 3))
    assert monitor.lost == before


def test_vehicles_are_judged_apart():
    monitor = watch(*[said([WRONG] * 3, [WRONG, RIGHT, RIGHT], [RIGHT] * 3)] * 10, vehicles=3)
    assert (monitor.lost > 0.5).tolist() == [True, False, False]
    assert monitor.suspects() == [[], [1], []]


def test_a_vehicle_placed_anew_is_lost_until_confirmed():
    monitor = watch(said([RIGHT] * 3))
    monitor.doubt(np.array([True]))
    assert monitor.lost > 0.99
    for _ in range(5):
        judge(monitor, said([RIGHT] * 3))
    assert monitor.lost < 0.5


def test_what_was_held_against_senders_is_forgotten_with_the_belief():
    monitor = watch(*[said([WRONG, RIGHT, RIGHT], [WRONG, RIGHT, RIGHT])] * 10, vehicles=2)
    monitor.forget(0)
    assert monitor.suspects() == [[], [1]]
    monitor.doubt(np.array([False, True]))
    assert monitor.suspects() == [[], []]


def test_the_largest_identity_has_its_own_place():
    deviation = said([WRONG, RIGHT, RIGHT])
    deviation.sender[0, 0] = 2 ** 32 - 1
    assert watch(*[deviation] * 10).suspects() == [[2 ** 32 - 1]]


def test_certainty_is_refused_as_a_rate():
    with pytest.raises(ConfigError, match='contradiction_rate: 0.5 is not allowed'):
        HealthConfig(contradiction_rate=0.5)


def test_who_contradicts_itself_is_suspected_within_ten_epochs():
    monitor = HealthMonitor(HealthConfig(), 1)
    for _ in range(5):
        judge(monitor, said([RIGHT] * 3), [7])
    assert monitor.suspects() == [[7]]


def test_senders_that_are_never_met_again_cost_no_memory():
    monitor = watch(*[said([RIGHT] * 3 + [WRONG])] * 2, *[said([RIGHT] * 3)] * 1000)
    assert not len(monitor._pair)
