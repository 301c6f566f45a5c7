"""When what ranges say of a vehicle is a place."""

from dataclasses import replace

import numpy as np
from tsmcl_ros.model.settling import Settling
from tsmcl_ros.types import Estimate, Observation


def heard(position):
    scan = Observation.empty(1, 1, 2, 0.0)
    scan.sender[:] = 1
    scan.position[0, 0] = position
    return scan


def belief(points):
    """Return the estimate of a cloud of points (N, 2) [m]."""
    unknown = np.full(1, np.nan)
    return Estimate(0.0, points.mean(axis=0)[None], np.cov(points.T)[None], unknown, unknown,
                    unknown, 0, unknown, np.ones(1, int), np.zeros(1, bool))


def judged(settling, points, distance=50.0, std=1.0, reinitialized=False, scan=None):
    estimate = replace(belief(points), reinitialized=np.array([reinitialized]))
    scan = heard([0.0, 0.0]) if scan is None else scan
    used = scan.heard
    settling.judge(scan, estimate, (
        np.full(used.shape, distance), np.full(used.shape, std), used))
    return settling.placed(estimate)


def circle(radius=50.0, span=2 * np.pi):
    angle = np.linspace(0, span, 500)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_a_circle_is_no_place():
    assert np.isnan(judged(Settling(1), circle())).all()


def test_two_crossings_of_circles_are_no_place():
    assert np.isnan(judged(Settling(1), np.array([[30.0, 40], [30, -40]] * 50))).all()


def test_an_arc_as_flat_as_ranges_err_is_one():
    assert np.isfinite(judged(Settling(1), circle(span=0.3))).all()


def test_who_has_a_place_keeps_it_until_it_is_placed_anew():
    settling = Settling(1)
    judged(settling, circle(span=0.1))
    assert np.isfinite(judged(settling, circle())).all()
    assert np.isnan(judged(settling, circle(), reinitialized=True)).all()


def test_ranges_to_three_senders_at_once_make_a_place():
    scan = Observation.empty(1, 3, 2, 0.0)
    scan.sender[0] = 1, 2, 3
    assert np.isfinite(judged(Settling(1), circle(), scan=scan)).all()


def test_silence_makes_no_place():
    silent = Observation.empty(1, 0, 2, 0.0)
    assert np.isnan(judged(Settling(1), circle(span=0.1), scan=silent)).all()


def test_who_is_heard_without_a_range_is_placed_however_broadly():
    settling = Settling(1)
    scan = heard([0.0, 0.0])
    settling.judge(scan, belief(circle()), (
        np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1), bool)))
    assert settling.done.all()
