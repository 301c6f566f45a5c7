"""Path loss fitted to links, against least squares and what made the links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tsmcl_ros.model.learning_channel import LearningChannel
from tsmcl_ros.model.links import Fit, fit_links
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import EvidenceConfig, RadioConfig
from tsmcl_ros.types import Links
from tsmcl_ros.world import anchor_table, hear_each_other

TRUE = RadioConfig(radio_range=120.0, measure_rssi=True, rssi_at_reference=-48.0,
                   path_loss_exponent=2.8, sigma_db=4.0)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def links(seed: int = 1, anchors: int = 40, **radio: float) -> Links:
    """Return how anchors on 400 m x 400 m hear each other."""
    channel = Channel(replace(TRUE, **radio))  # type: ignore[arg-type]
    table = anchor_table(rng(seed).uniform(0, 400, (anchors, 2)))
    return hear_each_other(channel, table, rng(seed + 1))


def fit(measured: Links, exponent_std: float = 1.0, neighbours: int = 0) -> Fit:
    """Fit links by who takes P_0 for -40 dBm and n for 2."""
    return fit_links(measured, -40.0, 2.0, 4.0, exponent_std, neighbours)


def test_with_no_prior_the_common_path_loss_is_that_of_least_squares() -> None:
    measured = links()
    found = fit(measured, exponent_std=1e6)
    slope, intercept = np.polyfit(-10 * np.log10(measured.distance), measured.rssi, 1)
    assert found.exponent == pytest.approx(slope, rel=1e-6)
    assert found.reference[-1] == pytest.approx(intercept, rel=1e-6)


def test_a_wrong_path_loss_is_mended_as_far_as_links_tell() -> None:
    offs = []
    for seed in range(20):
        found = fit(links(seed))
        predicted = found.reference[-1] - 10 * found.exponent * np.log10(70.0)
        offs.append(predicted - Channel(TRUE).path_loss(np.array(-1)).mean(np.array(70.0)))
    # Before, it was 8 dB of P_0 and 15 dB of n off; 300 links of 4 dB have an error of 0.23 dB.
    assert np.sqrt(np.mean(np.square(offs))) < 0.5


def test_senders_of_one_power_share_it() -> None:
    found = fit(links())
    assert np.ptp(found.reference) < 1.5
    assert found.sigma.max() < 4.3


def test_a_sender_of_its_own_power_has_a_p_0_of_its_own() -> None:
    measured = links()
    weak = measured.sender == 7
    measured = replace(measured, rssi=measured.rssi - np.float32(15.0) * weak)
    found = fit(measured)
    off = found.reference[:-1][found.identity == 7] - found.reference[-1]
    # The mean over its own links alone, as in the paper, is drawn towards the others by a third.
    assert -17.0 < off[0] < -8.0
    assert found.sigma[-1] > found.sigma[:-1].max()


def test_few_links_leave_the_exponent_where_it_was_taken_to_be() -> None:
    measured = links()
    few = measured.without(np.arange(2, 40))
    assert 0 < len(few.rssi) < 20
    assert fit(few, exponent_std=0.01).exponent == pytest.approx(2.0, abs=0.02)


def test_a_single_link_tells_p_0_alone_with_twice_the_variance() -> None:
    measured = Links(np.array([1]), np.array([2]), np.zeros((1, 2), np.float32),
                     np.array([[10.0, 0.0]], np.float32), np.array([-70.0], np.float32))
    found = fit(measured)
    assert found.exponent == pytest.approx(2.0)
    np.testing.assert_allclose(found.reference, [-50.0, -50.0])
    # The paper's sqrt(1 + 1 / K).
    np.testing.assert_allclose(found.sigma, 4.0 * np.sqrt(2.0))


def test_the_nearest_neighbours_count() -> None:
    measured = links()
    third = np.array([np.sort(measured.distance[measured.sender == s])[:3].max()
                      for s in measured.sender])
    near = Links(*(getattr(measured, name)[measured.distance <= third] for name in (
        'receiver', 'sender', 'receiver_position', 'sender_position', 'rssi')))
    chosen, same = fit(measured, neighbours=3), fit(near)
    np.testing.assert_allclose(chosen.reference, same.reference)
    assert len(near.rssi) < len(measured.rssi)


def test_a_channel_learns_but_not_of_anchors_whose_path_loss_is_configured() -> None:
    taken = RadioConfig(radio_range=120.0, measure_rssi=True,
                        anchor_path_loss=('7 -30 2.0 3.0',))
    channel = LearningChannel(taken)
    channel.learn(links())
    loss = channel.path_loss(np.array([7, 3, 99]))
    assert loss.reference[0] == -30.0
    np.testing.assert_allclose(loss.mean(np.array(70.0))[1:], -48.0 - 28 * np.log10(70), atol=1.5)
    channel.learn(Links.none())
    assert channel.path_loss(np.array([3])).reference[0] == -40.0


def test_a_channel_that_is_not_to_be_calibrated_is_not() -> None:
    channel = LearningChannel(
        RadioConfig(measure_rssi=True), EvidenceConfig(rssi_calibration='off'))
    channel.learn(links())
    assert channel.path_loss(np.array([3])).reference[0] == -40.0


def test_news_of_a_link_replace_it_and_others_are_added() -> None:
    measured = links()
    half = len(measured.rssi) // 2
    first, second = (Links(*(getattr(measured, name)[part] for name in vars(measured)))
                     for part in (slice(0, half + 5), slice(half, None)))
    louder = replace(second, rssi=second.rssi + np.float32(1.0))
    both = first.updated(louder)
    assert len(both.rssi) == len(measured.rssi)
    assert np.sum(both.rssi) == pytest.approx(
        np.sum(measured.rssi[:half]) + np.sum(louder.rssi), rel=1e-5)


def test_links_in_two_dimensions_can_be_the_first() -> None:
    assert Links.none().updated(links()).receiver_position.shape[1] == 2


def test_anchors_hear_each_other_as_the_channel_says() -> None:
    measured = links(anchors=200)
    assert (measured.receiver != measured.sender).all()
    assert (measured.distance <= 120.0).all()
    ends = set(zip(measured.receiver.tolist(), measured.sender.tolist(), strict=True))
    assert ends == {(b, a) for a, b in ends}
    mean = Channel(TRUE).path_loss(np.array(-1)).mean(measured.distance)
    assert np.std(measured.rssi - mean) == pytest.approx(4.0, rel=0.05)
