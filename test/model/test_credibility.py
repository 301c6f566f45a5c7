"""Whom vehicles believe, from what they hear and expect."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.model.credibility import Credibility
from tsmcl_ros.model.health import HealthConfig
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.types import Observation

CHANNEL = Channel(RadioConfig(radio_range=1000.0, edge_softness=5.0, range_std=2.0))
ANCHORS = np.array([(700, 0), (-700, 0), (0, 700), (0, -700), (500, 500), (-500, 400)], float)
NOWHERE = np.array([np.nan, np.nan])


def heard(place=(0.0, 0.0), ranged=False, lies=None):
    """Return what a vehicle at a place hears; liars, by id, claim to be elsewhere."""
    table = Observation.empty(1, len(ANCHORS), 2, 0.0)
    table.sender[0], table.position[0] = np.arange(len(ANCHORS)), ANCHORS
    if ranged:
        table.range[0] = np.linalg.norm(ANCHORS - place, axis=1)
    for sender, claim in (lies or {}).items():
        table.position[0, sender] = claim
    return table


def sift(credibility, observation, mean=(0.0, 0.0), std=10.0, way=0.0):
    """Return the ids that are believed, and the beliefs that are to be replaced."""
    credibility.move(np.full((1, 2), way), np.zeros(1))
    kept, priors = credibility.sift(
        CHANNEL, observation, np.array([mean], float), std ** 2 * np.eye(2)[None], np.zeros(1))
    return kept.sender[kept.heard].tolist(), priors


def watch():
    return Credibility(HealthConfig(), 0.0, 1, 2)


@pytest.mark.parametrize('ranged', [False, True])
@pytest.mark.parametrize('mean', [(0.0, 0.0), NOWHERE])
def test_who_is_honest_is_believed(ranged, mean):
    assert sift(watch(), heard(ranged=ranged), mean) == ([0, 1, 2, 3, 4, 5], [])


@pytest.mark.parametrize('ranged', [False, True])
@pytest.mark.parametrize('mean', [(0.0, 0.0), NOWHERE])
def test_who_lies_is_not_believed_with_a_prediction_or_without(ranged, mean):
    lie = {4: (2000, 1000)}
    assert sift(watch(), heard(ranged=ranged, lies=lie), mean) == ([0, 1, 2, 3, 5], [])


@pytest.mark.parametrize('ranged', [False, True])
def test_who_lies_is_suspected_within_ten_epochs(ranged):
    credibility = watch()
    for _ in range(10):
        sift(credibility, heard(ranged=ranged, lies={4: (2000, 1000)}))
    assert credibility.monitor.suspects() == [[4]]


def test_who_knows_its_place_stays_there_though_half_of_what_it_hears_lies():
    credibility = watch()
    lies = {0: (2700, 0), 2: (0, 2500), 4: (-1800, 1000)}
    for _ in range(10):
        kept, _ = sift(credibility, heard(ranged=True, lies=lies))
        assert kept == [1, 3, 5]
    assert credibility.monitor.lost < 0.01
    assert credibility.monitor.suspects() == [[0, 2, 4]]


def test_a_lost_vehicle_believes_ranges_that_agree():
    credibility = watch()
    kept, _ = sift(credibility, heard((300.0, 200.0), ranged=True), mean=(-300, 100))
    assert credibility.monitor.lost > 0.5
    assert kept == [0, 1, 2, 3, 4, 5]


def test_a_young_belief_that_a_liar_led_to_is_replaced_once_he_is_unmasked():
    credibility, priors = watch(), []
    lie = {4: (900, 900)}
    sift(credibility, heard(lies=lie), NOWHERE)
    for _ in range(8):
        _, news = sift(credibility, heard(lies={4: (2000, 1000)}), mean=(200, 200))
        priors += news
    [prior] = priors
    assert np.linalg.norm(prior.mean) < 300


def test_a_belief_is_not_replaced_by_nothing():
    credibility = watch()
    sift(credibility, heard(), NOWHERE)
    for epoch in range(12):
        lies = {sender: (3000 + 5 * epoch, 40 * sender) for sender in range(6)}
        _, priors = sift(credibility, heard(lies=lies))
        assert not priors


@pytest.mark.parametrize('told', [False, True])
def test_a_young_belief_is_refuted_by_disks_unless_somebody_told_it(told):
    credibility = watch()
    if told:
        credibility.forget(0)
    _, priors = sift(credibility, heard(), mean=(600, 600), std=1.0)
    assert credibility.monitor.lost < 0.5
    assert len(priors) == (not told)


@pytest.mark.parametrize(('way', 'believed'), [
    (0.0, [0, 2, 3, 4, 5]), (np.nan, [0, 1, 2, 3, 4, 5])])
def test_disks_that_agree_are_believed_against_a_belief_that_no_odometry_carries(way, believed):
    credibility = watch()
    for _ in range(12):
        sift(credibility, heard(), way=way)
    # Beyond the reach of sender 1.
    assert sift(credibility, heard(), mean=(350, 0), std=1.0, way=way) == (believed, [])
