"""The histories of vehicles at even times."""

import numpy as np
import pytest
from tsmcl_ros.model.history import BRIDGED, History

EVERYBODY = np.ones(1, bool)


def learn(history, stamp, x, variance=1.0):
    return history.learn(
        stamp, np.array([[x, 0.0]]), variance * np.eye(2)[None], EVERYBODY)


def test_positions_are_interpolated_at_even_times():
    history = History(1, 2, 8)
    for stamp in (0.5, 1.75, 3.25, 5.5):
        learn(history, stamp, 10 * stamp)

    position, time, known = history.last(5)

    assert known[0]
    assert time[0] == 5.0
    np.testing.assert_allclose(position[0, :, 0], [10, 20, 30, 40, 50])


def test_only_the_last_slots_are_kept():
    history = History(1, 2, 4)
    for stamp in range(20):
        learn(history, stamp + 0.5, stamp)

    assert not history.last(5)[2][0]
    np.testing.assert_allclose(history.last(4)[0][0, :, 0], [15.5, 16.5, 17.5, 18.5])


@pytest.mark.parametrize('step', [1, 3, 7, 300])
def test_a_history_is_as_long_however_time_has_passed(step):
    history = History(1, 2, 8)
    for stamp in range(0, 400 * step, step):
        learn(history, float(stamp), stamp)
        assert history.position.shape == (1, 8, 2)
    known = np.isfinite(history.variance[0])
    assert known.sum() == (8 if step < 30 else 1)
    np.testing.assert_allclose(
        history.position[0, known, 0], np.arange(stamp - known.sum() + 1, stamp + 1))


def test_the_last_positions_can_be_had_after_time_has_passed():
    history = History(1, 2, 16)
    for stamp in range(6):
        learn(history, float(stamp), stamp)
    history.pass_time(9.0)

    position, time, known = history.last(5)

    assert known[0]
    assert time[0] == 5.0
    np.testing.assert_allclose(position[0, :, 0], [1, 2, 3, 4, 5])


@pytest.mark.parametrize(('pause', 'bridged'), [(BRIDGED, True), (BRIDGED + 0.5, False)])
def test_pauses_are_bridged_only_if_they_are_short(pause, bridged):
    history = History(1, 2, 64)
    learn(history, 0.0, 0.0)
    learn(history, pause, 30.0)

    assert history.last(5)[2][0] == bridged


def test_what_is_not_finite_is_not_learned():
    history = History(1, 2, 8)

    rows = history.learn(1.0, np.full((1, 2), np.nan), np.full((1, 2, 2), np.nan), EVERYBODY)

    assert not len(rows)
    assert history.stamp[0] == -np.inf


def test_a_velocity_is_known_once_there_is_a_position_before():
    history = History(1, 2, 8)
    for stamp in range(3):
        learn(history, float(stamp), 4.0 * stamp)
    assert np.isnan(history.velocity(np.zeros(1, int), 3)).all()

    learn(history, 3.0, 12.0)
    learn(history, 4.0, 16.0)

    np.testing.assert_allclose(history.velocity(np.zeros(1, int), 3), [[4.0, 0.0]])


def test_each_vehicle_has_a_past_of_its_own():
    history = History(2, 2, 8)
    for stamp in range(6):
        here = np.array([True, stamp % 2 == 0])
        history.learn(float(stamp), np.full((2, 2), stamp), np.tile(np.eye(2), (2, 1, 1)), here)

    position, time, _ = history.last(3)

    assert time.tolist() == [5.0, 4.0]
    np.testing.assert_allclose(position[:, :, 0], [[3, 4, 5], [2, 3, 4]])
