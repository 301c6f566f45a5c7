"""The file of last poses: what is read back, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tsmcl_ros.endpoint import OutputConfig
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.nodes.resume import Memory
from tsmcl_ros.types import Observation, Prior
from tsmcl_ros.world import make_world

NAMES = ['/veh_0', '/veh_1']
SETTINGS = {'radio_range': 1000.0}


def localizer() -> Localizer:
    """Return one that has localized two vehicles."""
    world = make_world({'vehicles': 2, **SETTINGS}, np.random.default_rng(1))
    found = Localizer(SETTINGS, 2)
    found.anchor_map(world.anchors)
    for _ in range(3):
        epoch = world.step()
        found.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)
    return found


def memory(path: Path, of: Localizer, complaints: list[str], **output: Any) -> Memory:
    return Memory(of, NAMES, OutputConfig(resume_from=str(path), **output), complaints.append)


def test_what_one_localizer_keeps_the_next_begins_with(tmp_path: Path) -> None:
    path, complaints = tmp_path / 'last.json', list[str]()
    before, after = localizer(), Localizer(SETTINGS, 2)
    memory(path, before, complaints).save()
    assert memory(path, after, complaints).recall() == 2
    for kept, known in zip(after._core.lasts, before.last_known(), strict=True):
        assert kept.vehicle == known.vehicle
        assert kept.stamp == known.stamp
        for name in ('mean', 'covariance', 'odometry', 'speed', 'rotation'):
            np.testing.assert_array_equal(getattr(kept, name), getattr(known, name))
    assert complaints == []
    assert [item.name for item in tmp_path.iterdir()] == ['last.json']


RANGING: dict[str, Any] = {'radio_range': 1500.0, 'range_std': 1.0}
LONG = {**RANGING, 'measure_range': True, 'range_scale': 1.07}


def hear(found: Localizer, epochs: int, first: int = 0, **radio: Any) -> None:
    """Let two vehicles hear what the radio of a world is like, from an epoch on."""
    world = make_world({'vehicles': 2, **radio}, np.random.default_rng(1))
    found.anchor_map(world.anchors)
    for number in range(first + epochs):
        epoch = world.step()
        if number >= first:
            found.epoch(epoch.observation, epoch.odom_position, epoch.odom_yaw)


def wise(**settings: Any) -> Localizer:
    """Return one that has learnt that ranges are 7 % long."""
    found = Localizer({**RANGING, **settings}, 2)
    hear(found, 3, **LONG)
    return found


def begun(path: Path, **settings: Any) -> Localizer:
    """Return one that has begun with what was kept, and has heard nothing yet."""
    after = Localizer(settings, 2)
    assert memory(path, after, []).recall() == 2
    after.epoch(Observation.empty(2, 1, 2, 9.0))
    return after


def test_what_was_learnt_of_ranges_is_kept_too(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    memory(path, wise(), []).save()
    calibration = begun(path).channel.calibration
    assert calibration.scale == pytest.approx(1.07, abs=1e-3)
    assert calibration.covariance[0, 0] < 0.03 ** 2


@pytest.mark.parametrize('settings', [
    {'range_scale': 1.02}, {'range_bias': 0.3}, {'range_calibration': 'off'}])
def test_what_was_learnt_of_ranges_is_of_no_use_where_other_parameters_hold(
        tmp_path: Path, settings: dict[str, Any]) -> None:
    path = tmp_path / 'last.json'
    memory(path, wise(), []).save()
    calibration = begun(path, **settings).channel.calibration
    assert calibration.scale == settings.get('range_scale', 1.0)


RSSI: dict[str, Any] = {
    'radio_model': 'lognormal', 'measure_rssi': True, 'sensitivity': -120.0, 'sigma_db': 4.0,
    'path_loss_exponent': 2.5, 'odom_heading': 'known'}
LEARNS = {**RSSI, 'rssi_at_reference': -46.0, 'rssi_calibration': 'online'}


def wiser(**settings: Any) -> Localizer:
    """Return one that has learnt that P_0 is 6 dB more than it says."""
    found = Localizer({**LEARNS, **settings}, 2)
    hear(found, 8, **RSSI)
    return found


def test_what_was_learnt_of_rssi_is_kept_too(tmp_path: Path) -> None:
    path, before = tmp_path / 'last.json', wiser()
    memory(path, before, []).save()
    known, begun_with = before.channel.powers, begun(path, **LEARNS).channel.powers
    np.testing.assert_array_equal(begun_with.mean, known.mean)
    assert begun_with.sigma == pytest.approx(known.sigma)
    assert (np.diag(begun_with.covariance) < np.array([6.0, 0.5]) ** 2).all()


@pytest.mark.parametrize('settings', [
    {'rssi_at_reference': -45.0}, {'reference_distance': 2.0}, {'path_loss_exponent': 2.4},
    {'sigma_db': 3.0}, {'anchor_path_loss': ('7 -40 2 4',)}, {'rssi_calibration': 'off'}])
def test_what_was_learnt_of_rssi_is_of_no_use_where_other_parameters_hold(
        tmp_path: Path, settings: dict[str, Any]) -> None:
    path = tmp_path / 'last.json'
    memory(path, wiser(), []).save()
    np.testing.assert_array_equal(
        begun(path, **{**LEARNS, **settings}).channel.powers.mean, [0, 0])


@pytest.mark.parametrize(('learn', 'settings', 'change', 'reason'), [
    (wise, {}, ('"mean": [1.0', '"mean": [-1.0'), 'must have a scale above 0'),
    (wise, {}, ('"configured": [1.0, 0.0], "mean"', '"configured": [1.0, 0.0], "none"'),
     "'mean'"),
    (wiser, LEARNS, ('"sigma": ', '"sigma": -'), 'must be what rssi can tell'),
    (wiser, LEARNS, ('"samples"', '"none"'), "KeyError: 'samples'")])
def test_what_is_wrong_of_what_was_learnt_is_told(
        tmp_path: Path, learn: Callable[[], Localizer], settings: dict[str, Any],
        change: tuple[str, str], reason: str) -> None:
    path, complaints = tmp_path / 'last.json', list[str]()
    memory(path, learn(), []).save()
    path.write_text(path.read_text().replace(*change))
    assert memory(path, Localizer(settings, 2), complaints).recall() == 0
    assert reason in complaints[0]


def test_a_file_from_before_rssi_was_kept_is_read_still(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    memory(path, wiser(), []).save()
    content = json.loads(path.read_text())
    del content['rssi']
    path.write_text(json.dumps(content))
    np.testing.assert_array_equal(begun(path, **LEARNS).channel.powers.mean, [0, 0])


@pytest.mark.parametrize(('name', 'settings'), [
    ('ranges', {}), ('ranges', {'range_calibration': 'off'}), ('rssi', LEARNS),
    ('rssi', {**LEARNS, 'rssi_calibration': 'off'})])
def test_what_was_learnt_outlives_one_that_hears_nothing_of_it(
        tmp_path: Path, name: str, settings: dict[str, Any]) -> None:
    path = tmp_path / 'last.json'
    memory(path, wise() if name == 'ranges' else wiser(), []).save()
    first = json.loads(path.read_text())
    between = begun(path, **settings)
    path.unlink()
    memory(path, between, []).save()
    assert json.loads(path.read_text())[name] == first[name]


def test_what_was_learnt_outlives_a_jump_of_time(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    memory(path, wise(), []).save()
    found = begun(path)
    found.reset()
    found.epoch(Observation.empty(2, 1, 2, 4000.0))
    assert found.channel.calibration.scale == pytest.approx(1.07, abs=1e-3)


def test_what_is_learnt_anew_is_kept_in_place_of_what_was_known(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    memory(path, wise(), []).save()
    first = json.loads(path.read_text())['ranges']
    found = begun(path, **RANGING)
    hear(found, 10, first=10, **LONG)
    memory(path, found, []).save()
    again = json.loads(path.read_text())['ranges']
    assert again['mean'] != first['mean']
    assert again['mean'][0] == pytest.approx(1.07, abs=1e-3)


def test_poses_are_kept_no_more_often_than_wanted(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    keeper = memory(path, localizer(), [], save_pose_rate=1e-3)
    keeper.save()
    path.unlink()
    keeper.save()
    assert not path.exists()
    keeper.save(at_once=True)
    assert path.exists()


def test_the_first_start_has_nothing_to_begin_with(tmp_path: Path) -> None:
    complaints: list[str] = []
    assert memory(tmp_path / 'none.json', Localizer(SETTINGS, 2), complaints).recall() == 0
    assert complaints == []


@pytest.mark.parametrize(('change', 'reason'), [
    (lambda text: text[:100], 'JSONDecodeError: '),
    (lambda text: '', 'JSONDecodeError: '),
    (lambda text: '[' * 100_000, 'RecursionError: '),
    (lambda text: '[]', 'TypeError: list indices'),
    (lambda text: '\udcff', 'UnicodeDecodeError: '),
    (lambda text: text.replace('"map"', '"odom"'),
     "ValueError: frame_id 'odom' is not allowed, must be 'map'"),
    (lambda text: text.replace('"mean": [', '"mean": [1, '),
     'is not allowed, must have the shape (2,)'),
    (lambda text: text.replace('"mean": [', '"mean": [NaN, 1], "none": ['),
     'is not allowed, must have the shape (2,)'),
    (lambda text: text.replace('"covariance": [[', '"covariance": [[-1, 0], [0, 1]], "none": [['),
     'is not allowed, must be positive semidefinite'),
    (lambda text: text.replace('"stamp"', '"time"'), "KeyError: 'stamp'"),
])
def test_a_file_that_is_none_is_one_line_and_vehicles_start_from_anywhere(
    tmp_path: Path, change: Any, reason: str,
) -> None:
    path, complaints = tmp_path / 'last.json', list[str]()
    memory(path, localizer(), complaints).save()
    content = change(path.read_text()).encode(errors='surrogateescape')
    path.write_bytes(content)
    after = Localizer(SETTINGS, 2)
    assert memory(path, after, complaints).recall() == 0
    [line] = complaints
    assert line.startswith(f'resume_from: {path} is not read but kept as last.json.unread, '
                           'vehicles start from anywhere: ')
    assert reason in line
    assert '\n' not in line
    assert after._core.lasts == []
    assert path.with_name('last.json.unread').read_bytes() == content


def test_a_file_of_other_vehicles_is_of_no_use(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    memory(path, localizer(), []).save()
    path.write_text(path.read_text().replace('/veh_', '/car_'))
    assert memory(path, Localizer(SETTINGS, 2), []).recall() == 0


def test_a_file_that_cannot_be_written_is_said_once(tmp_path: Path) -> None:
    complaints: list[str] = []
    keeper = memory(tmp_path / 'none' / 'last.json', localizer(), complaints)
    for _ in range(3):
        keeper.save(at_once=True)
    assert complaints == [f'resume_from: {tmp_path}/none/last.json cannot be written: '
                          'No such file or directory']


def test_whoever_says_where_a_vehicle_is_counts_more(tmp_path: Path) -> None:
    path = tmp_path / 'last.json'
    before = localizer()
    memory(path, before, []).save()
    after = Localizer(SETTINGS, 2)
    memory(path, after, []).recall()
    after.initial_pose(Prior(0, np.array([5.0, 5.0]), 1e-4 * np.eye(2)))
    world = make_world({'vehicles': 2, **SETTINGS}, np.random.default_rng(1))
    epochs = [world.step() for _ in range(4)]
    empty = replace_heard(epochs[-1].observation)
    found = after.epoch(empty, epochs[-1].odom_position, epochs[-1].odom_yaw)
    np.testing.assert_allclose(found.mean[0], [5.0, 5.0], atol=1)
    assert np.linalg.norm(found.mean[1] - epochs[-1].position[1]) < 500


def replace_heard(observation: Any) -> Any:
    """Return an observation of nothing."""
    return type(observation).empty(2, 0, 2, observation.stamp)


def test_the_file_is_plain_json(tmp_path: Path) -> None:
    memory(tmp_path / 'last.json', localizer(), []).save()
    content = json.loads((tmp_path / 'last.json').read_text())
    assert content['frame_id'] == 'map'
    assert content['poses'].keys() == set(NAMES)
