"""Markers against what RViz and Foxglove take."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.nodes.views import markers
from tsmcl_ros.types import Estimate, Observation
from visualization_msgs.msg import Marker


def estimate(*covariances: object) -> Estimate:
    """Return vehicles at (10, 20), (20, 40) and so on."""
    count = len(covariances)
    unknown = np.full(count, np.nan)
    return Estimate(
        12.5, np.outer(np.arange(1, count + 1), [10.0, 20.0]),
        np.array(covariances, float).reshape(count, 2, 2), unknown, unknown, np.ones(count), 100,
        unknown, np.zeros(count, int), np.zeros(count, bool))


def anchors(max_range: float = np.nan) -> Observation:
    """Return four anchors, one of which has an id beyond those of markers."""
    found = Observation.empty(1, 4, 3, 0.0)
    found.sender[0] = [3, 5, 7, 2**31 - 1]
    found.position[0] = [[0, 0, 2], [100, 0, 2], [0, 100, 2], [100, 100, 2]]
    found.max_range[:] = max_range
    return found


def drawn(
    name: str, table: Observation | None = None, suspects: tuple[int, ...] = (),
    radio_range: float = 0.0, covariance: object = ((1.0, 0.0), (0.0, 1.0)),
) -> list[Marker]:
    found = markers(estimate(covariance), table, suspects, radio_range, 'map').markers
    return [marker for marker in found if marker.ns == name]


def place(marker: Marker) -> list[float]:
    at = marker.pose.position
    return [at.x, at.y, at.z]


def color(marker: Marker) -> tuple[float, ...]:
    return marker.color.r, marker.color.g, marker.color.b


@pytest.mark.parametrize('max_range', [np.nan, 50.0])
@pytest.mark.parametrize('covariance', [
    np.eye(2), np.zeros((2, 2)), [[4.0, 3.9], [3.9, 4.0]], 1e10 * np.eye(2)])
def test_every_marker_is_one_that_can_be_drawn(max_range: float, covariance: object) -> None:
    found = markers(estimate(covariance), anchors(max_range), [5], 0.0, 'map').markers
    names = [(marker.ns, marker.id) for marker in found]
    assert len(set(names)) == len(names)
    for marker in found[1:]:
        turn = marker.pose.orientation
        assert marker.header.frame_id == 'map'
        assert np.hypot(np.hypot(turn.x, turn.y), np.hypot(turn.z, turn.w)) == pytest.approx(1)
        assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0
        assert marker.color.a > 0
        assert marker.action == Marker.ADD


def test_what_was_shown_before_vanishes_first() -> None:
    found = markers(estimate(np.eye(2)), None, [], 0.0, 'map').markers
    assert [marker.action for marker in found] == [Marker.DELETEALL, Marker.ADD]


def test_markers_have_the_time_of_the_estimate() -> None:
    [first, *_] = markers(estimate(np.eye(2)), None, [], 0.0, 'map').markers
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == (12, 500_000_000)


@pytest.mark.parametrize('radio_range', [0.0, 30.0])
def test_anchors_stand_where_the_map_has_them(radio_range: float) -> None:
    found = drawn('anchors', anchors(), radio_range=radio_range)
    assert [place(marker) for marker in found] == anchors().position[0].tolist()


def test_disks_have_the_radio_range_that_anchors_tell_or_else_that_of_the_channel() -> None:
    told, default = (drawn('radio_range', anchors(reach), radio_range=30.0)[0].scale.x
                     for reach in (50.0, np.nan))
    assert (told, default) == (100, 60)


def test_without_a_radio_range_there_are_no_disks() -> None:
    assert drawn('radio_range', anchors()) == []


def test_anchors_are_labelled_with_their_ids() -> None:
    found = drawn('anchor_ids', anchors())
    assert [marker.text for marker in found] == ['3', '5', '7', '2147483647']
    assert {marker.type for marker in found} == {Marker.TEXT_VIEW_FACING}


def test_suspects_have_a_colour_and_a_label_that_tell_them() -> None:
    found = drawn('anchors', anchors(), suspects=(5,))
    assert [color(marker) == color(found[0]) for marker in found] == [True, False, True, True]
    assert drawn('anchor_ids', anchors(), suspects=(5,))[1].text == '5: suspect'


def test_the_ellipse_holds_95_percent() -> None:
    [ellipse] = drawn('covariance', covariance=[[9.0, 0.0], [0.0, 25.0]])
    inside = np.random.default_rng(0).standard_normal((100_000, 2)) * [3, 5]
    turn = 2 * np.arctan2(ellipse.pose.orientation.z, ellipse.pose.orientation.w)
    along = inside @ [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    radii = np.array([ellipse.scale.x, ellipse.scale.y]) / 2
    assert np.mean(((along / radii)**2).sum(axis=1) <= 1) == pytest.approx(0.95, abs=0.003)


def test_a_vehicle_that_is_nowhere_is_not_shown() -> None:
    found = estimate(np.eye(2), np.eye(2))
    found.mean[0] = np.nan
    [_, ellipse] = markers(found, None, [], 0.0, 'map').markers
    assert place(ellipse) == [20, 40, 0]
