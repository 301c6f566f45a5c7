"""What the silence of anchors is worth that are out of order, gone, or not always received."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.model.absence import Absences
from tsmcl_ros.model.consistency import Deviations
from tsmcl_ros.model.health import HealthConfig
from tsmcl_ros.types import Observation, Silence, VEHICLE

RIGHT, WRONG = 0.5, 9.0
NOBODY, TWO = np.array([0]), np.array([2])
FOUND = np.array([False])
# Anchors of 1 to 4 are heard, those of 5 to 8 are silent.
ANCHORS = np.arange(1, 9)[None]


def epoch(heard, silent):
    """Return what one vehicle hears, and how it deviates; None for who is not there."""
    values = [*heard, *silent]
    said = np.array([[value is not None for value in values]])
    deviation = np.array([[value or 0.0 for value in values]])
    is_silent = np.arange(len(values))[None] >= len(heard)
    observation = Observation.empty(1, 4, 2, 0.0)
    observation.sender[:, :len(heard)] = ANCHORS[:, :len(heard)]
    silence = Silence(
        np.ones((1, len(silent)), bool), ANCHORS[:, 4:4 + len(silent)],
        np.zeros((1, len(silent), 2), np.float32), np.full((1, len(silent)), np.float32(100)))
    sender = np.concatenate([ANCHORS[:, :len(heard)], silence.sender], axis=1)
    return Deviations(sender, said, is_silent & said, ~is_silent & said, deviation), replace(
        observation, silent=silence)


def learnt(*epochs, miss_rate=0.0, met=TWO, renewed=False, follows=True):
    absences = Absences(HealthConfig(), miss_rate, 1)
    for found, observation in epochs:
        absences.renew(np.array([renewed]))
        absences.learn(found, observation, met, np.array([follows]))
    return absences


def weighed(absences, silent=1, lost=FOUND, met=TWO):
    return absences.weigh(epoch([RIGHT] * 2, [RIGHT] * silent)[1], lost, met).silent


MISSED = epoch([RIGHT] * 4, [WRONG])


def test_a_silence_that_agrees_says_all_that_the_radio_makes_of_it():
    observation = epoch([RIGHT] * 4, [RIGHT])
    assert weighed(learnt(*[observation] * 100)).miss_rate is None


def test_a_silence_that_contradicts_for_the_first_time_is_as_rare_as_a_lost_beacon():
    assert weighed(learnt(MISSED)).miss_rate == pytest.approx(0.05, abs=0.01)


def test_an_anchor_that_stays_silent_is_left_out():
    assert weighed(learnt(MISSED)).known.all()
    assert not weighed(learnt(*[MISSED] * 5)).known.any()


def test_nobody_is_missed_who_is_silent_to_a_belief_that_nothing_but_who_is_heard_leads():
    assert weighed(learnt(*[MISSED] * 20, follows=False)).known.all()


def test_an_anchor_is_missed_where_ranges_place_a_vehicle_without_odometry():
    found, observation = MISSED
    ranged = replace(found, disk=np.zeros_like(found.disk)), observation
    assert not weighed(learnt(*[ranged] * 5, follows=False)).known.any()


def test_an_anchor_that_is_heard_again_counts_again():
    heard = epoch([RIGHT] * 4, [RIGHT])
    heard[1].sender[0, 0] = 5
    absences = learnt(*[MISSED] * 5, *[heard] * 30)
    assert weighed(absences).known.all()
    assert weighed(absences).miss_rate < 0.02


def test_what_a_vehicle_misses_that_is_somewhere_else_proves_little():
    elsewhere = epoch([WRONG] * 4, [WRONG])
    assert weighed(learnt(*[elsewhere] * 20)).known.all()


SEVERAL = epoch([RIGHT] * 2, [WRONG] * 3)


def test_several_silences_at_once_say_little_at_first_but_then_that_a_vehicle_is_elsewhere():
    assert weighed(learnt(SEVERAL), 3).miss_rate == pytest.approx(0.05)
    assert weighed(learnt(*[SEVERAL] * 5), 3).known.all()


@pytest.mark.parametrize('case', [{'renewed': True}, {'met': NOBODY}])
def test_of_several_anchors_missed_by_who_was_placed_anew_or_meets_strangers_none_is_left(case):
    assert not weighed(learnt(*[SEVERAL] * 2, **case), 4).known.any()


def test_one_missing_anchor_says_nothing_of_the_others():
    absences = learnt(*[MISSED] * 10)
    assert weighed(absences, 3).known.tolist() == [[False, True, True]]


def test_who_hears_only_anchors_that_it_does_not_know_learns_nothing_from_silence():
    assert not weighed(learnt(), met=NOBODY).known.any()


def test_who_hears_only_vehicles_learns_from_silence():
    _, observation = epoch([RIGHT] * 2, [RIGHT])
    observation.kind[:] = VEHICLE
    assert learnt().weigh(observation, FOUND, NOBODY).silent.known.all()


def test_silence_is_no_proof_to_who_is_lost():
    assert weighed(learnt(), lost=~FOUND).miss_rate == pytest.approx(0.1)


def test_the_configured_miss_rate_holds_from_the_start():
    assert weighed(learnt(miss_rate=0.03)).miss_rate == pytest.approx(0.03)


def test_what_is_missed_often_is_usual():
    absences = learnt(*[MISSED] * 5)
    assert absences.usual(MISSED[0]).tolist() == [[False] * 4 + [True]]


def test_a_vehicle_that_starts_anew_misses_nobody():
    absences = learnt(*[MISSED] * 5)
    absences.forget(0)
    assert weighed(absences).miss_rate is None
