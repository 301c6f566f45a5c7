"""Positions and calibrations from one epoch's ranges, against what the ranges are made with."""

from __future__ import annotations

import numpy as np
import pytest
from tsmcl_ros.model.joint_fix import joint_fix, JointFix
from tsmcl_ros.types import Array

STD = 1.0  # m
PRIOR = np.diag([0.1, 0.5]) ** 2
PLACE = np.array([380.0, 520.0])
# Seven on all sides, some hundred metres apart.
ANCHORS = np.array([
    [50, 80], [900, 40], [960, 930], [90, 870], [500, 210], [700, 640], [240, 480]], float)


def fix(anchors: Array = ANCHORS, place: Array = PLACE, scale: float = 1.1, bias: float = 0.3,
        off: dict[int, float] | None = None, seed: int | None = None) -> JointFix:
    """Return what ranges from a place tell, of which some are off [m]."""
    ranges = scale * np.linalg.norm(anchors - place, axis=1) + bias
    if seed is not None:
        ranges += STD * np.random.default_rng(seed).standard_normal(len(ranges))
    for row, lie in (off or {}).items():
        ranges[row] += lie
    return joint_fix(
        anchors[None], ranges[None], np.full((1, len(ranges)), STD ** 2),
        np.ones((1, len(ranges)), bool), (np.array([[1.0, 0.0]]), PRIOR[None]))


@pytest.mark.parametrize('scale', [0.8, 0.95, 1.0, 1.1, 1.2])
def test_place_and_scale_are_found_at_once(scale: float) -> None:
    found = fix(scale=scale, bias=0.0)
    assert found.solved.all()
    # What is known of the scale draws by a fraction of the ranges' noise.
    np.testing.assert_allclose(found.mean[0, :2], PLACE, atol=0.2)
    assert found.mean[0, 2] == pytest.approx(scale, abs=1e-3)


def test_they_are_found_in_space() -> None:
    anchors = np.concatenate([ANCHORS, [[610.0, 390.0]]])
    height = np.array([0.0, 300, 80, 260, 150, 20, 330, 210])
    place = np.array([380.0, 520.0, 140.0])
    found = fix(np.column_stack([anchors, height]), place)
    assert found.solved.all()
    np.testing.assert_allclose(found.mean[0, :4], [*place, 1.1], atol=0.2)


def test_it_tells_how_well_it_is_known() -> None:
    errors = []
    for seed in range(20):
        found = fix(seed=seed, bias=0.0)
        off = found.mean[0] - [*PLACE, 1.1, 0.0]
        errors.append(off[:3] @ np.linalg.solve(found.covariance[0, :3, :3], off[:3]))
    # The mean of 20 chi-square values of 3 degrees of freedom, in its 99.9 % band.
    assert 1.5 < np.mean(errors) < 5.0


@pytest.mark.parametrize('lies', [{3: 200.0}, {0: -150.0}, {1: 300.0, 4: -40.0}])
def test_who_lies_is_left_out(lies: dict[int, float]) -> None:
    found = fix(off=lies, seed=2)
    assert found.solved.all()
    np.testing.assert_allclose(found.mean[0, :2], PLACE, atol=5.0)
    assert found.mean[0, 2] == pytest.approx(1.1, abs=0.02)


def test_less_than_two_more_than_what_is_unknown_are_not_believed() -> None:
    assert not fix(off={0: -150.0, 3: 200.0, 5: 90.0}, seed=2).solved.any()


def test_a_scale_that_was_ruled_out_is_not_believed() -> None:
    assert fix(scale=1.25).solved.all()
    assert not fix(scale=1.5).solved.any()


@pytest.mark.parametrize('beside', [0.0, 1.0])
def test_a_place_that_may_be_mirrored_is_none(beside: float) -> None:
    line = np.column_stack([ANCHORS[:, 0], beside * np.array([1, -1, 1, -1, 1, -1, 1])])
    assert not fix(line, np.array([380.0, 60.0])).solved.any()


def test_padding_does_not_count() -> None:
    anchors = np.concatenate([ANCHORS, [[np.nan, np.nan]]])
    ranges = np.append(1.1 * np.linalg.norm(ANCHORS - PLACE, axis=1), np.nan)
    found = joint_fix(
        anchors[None], ranges[None], np.full((1, 8), STD ** 2), np.arange(8)[None] < 7,
        (np.array([[1.0, 0.0]]), PRIOR[None]))
    assert found.mean[0, 2] == pytest.approx(1.1, abs=1e-3)
