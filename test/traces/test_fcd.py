"""SUMO traces: the real one read whole, small ones by hand, damaged ones refused by line."""

from __future__ import annotations

import gzip
import math
from pathlib import Path
import re

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.traces import follow, TraceConfig
from tsmcl_ros.traces.fcd import read_fcd
from tsmcl_ros.types import ConfigError, LogError

BOMB = """<!DOCTYPE fcd-export [
<!ENTITY a "aaaaaaaaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>
<fcd-export><timestep time="0"><vehicle id="&c;" x="0" y="0" angle="0"/></timestep></fcd-export>
"""


def xml(*steps: str) -> str:
    return '\n'.join(['<fcd-export>', *steps, '</fcd-export>'])


def step(time: object, *vehicles: str) -> str:
    return f'<timestep time="{time}">' + ''.join(vehicles) + '</timestep>'


def vehicle(name: str, x: object = 0, y: object = 0, angle: object = 0, **more: object) -> str:
    values = {'id': name, 'x': x, 'y': y, 'angle': angle, **more}
    return '<vehicle ' + ' '.join(f'{key}="{value}"' for key, value in values.items()) + '/>'


@pytest.fixture
def write(tmp_path):
    def write_text(*steps: str) -> Path:
        path = tmp_path / 'fcd.xml'
        path.write_text(xml(*steps))
        return path
    return write_text


@pytest.fixture
def three(write) -> Path:
    """Two vehicles from 0 s on, of which `a` leaves after 2 s; `late` comes at 1 s."""
    return write(
        step(0, vehicle('a', 0, 1, 90), vehicle('b', 5, 5, 0)),
        step(1, vehicle('a', 2, 1, 90), vehicle('b', 5, 6, 0), vehicle('late')),
        step(2, vehicle('a', 4, 1, 90), vehicle('b', 5, 8, 315), vehicle('late')),
        step(3, vehicle('b', 4, 9, 315), vehicle('late')),
    )


@pytest.fixture
def city(shared_data) -> Path:
    return shared_data / 'sumo_grid40' / 'fcd40.xml.gz'


def test_the_real_trace_holds_its_forty_cars_from_40_s_to_its_end(city) -> None:
    trace = read_fcd(city, 40, 40.0)
    assert sorted(trace.names, key=int) == [str(number) for number in range(40)]
    np.testing.assert_array_equal(trace.stamp, np.arange(40.0, 300.0))


def test_the_real_trace_gives_every_position_as_a_plain_text_search_finds_it(city) -> None:
    trace = read_fcd(city, 40, 40.0)
    step_100 = gzip.open(city, 'rt').read().split('<timestep time="100.000">')[1]
    found = dict(re.findall(r'id="(\w+)" x="([^"]*)"', step_100.split('</timestep>')[0]))
    assert [float(found[name]) for name in trace.names] == trace.position[60, :, 0].tolist()


def test_cars_of_the_real_trace_head_where_they_drive(city) -> None:
    replay = follow('fcd', TraceConfig(trace=str(city)), 40)
    states = [replay.step(1.0) for _ in range(200)]
    velocity = np.array([state.velocity for state in states])
    yaw = np.array([state.yaw for state in states])
    driving = np.linalg.norm(velocity, axis=2) > 5.0
    along = velocity[..., 0] * np.cos(yaw) + velocity[..., 1] * np.sin(yaw)
    speed = np.linalg.norm(velocity, axis=2)
    assert np.mean(along[driving] > 0.99 * speed[driving]) > 0.95  # lane changes are the rest


def test_plain_and_compressed_files_read_alike_whatever_their_names(city, tmp_path) -> None:
    plain = tmp_path / 'plain.gz'
    plain.write_bytes(gzip.decompress(city.read_bytes()))
    np.testing.assert_array_equal(
        read_fcd(plain, 40, 40.0).position, read_fcd(city, 40, 40.0).position)


@pytest.mark.parametrize(('angle', 'yaw'), [(0, 90), (90, 0), (180, -90), (270, 180), (45, 45)])
def test_sumo_angles_become_yaws(write, angle, yaw) -> None:
    path = write(step(0, vehicle('a', angle=angle)), step(1, vehicle('a', angle=angle)))
    np.testing.assert_allclose(np.degrees(read_fcd(path, 1).yaw), yaw, atol=1e-12)


def test_the_longest_lived_vehicles_are_chosen(three) -> None:
    assert read_fcd(three, 1).names == ('b',)


def test_the_trace_ends_with_the_first_of_the_chosen_vehicles(three) -> None:
    trace = read_fcd(three, 2)
    assert trace.names == ('a', 'b')
    np.testing.assert_array_equal(trace.stamp, [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(trace.position[2], [[4.0, 1.0], [5.0, 8.0]])


def test_a_vehicle_that_comes_before_the_start_counts(three) -> None:
    assert read_fcd(three, 2, start=1.0).names == ('b', 'late')


def test_a_start_between_time_steps_begins_with_the_one_before(three) -> None:
    replay = follow('fcd', TraceConfig(trace=str(three), trace_start=0.5), 2)
    np.testing.assert_array_equal(replay.state.position, [[1.0, 1.0], [5.0, 5.5]])
    assert replay.duration == 1.5


def test_a_vehicle_missed_by_a_time_step_has_ended_there(write) -> None:
    path = write(
        step(0, vehicle('a'), vehicle('b')), step(1, vehicle('a'), vehicle('b')),
        step(2, vehicle('a')), step(3, vehicle('a'), vehicle('b')))
    assert read_fcd(path, 2).stamp.size == 2


def test_only_what_the_duration_wants_is_read(tmp_path) -> None:
    steps = [step(time, vehicle('a', time)) for time in range(3)]
    path = tmp_path / 'endless.xml'
    path.write_text(xml(*steps) + ' ' * 200_000 + 'not XML at all <<<')
    np.testing.assert_array_equal(read_fcd(path, 1, duration=1.5).stamp, [0.0, 1.0, 2.0])


def test_too_few_vehicles_for_the_duration_are_refused(three) -> None:
    with pytest.raises(LogError, match='holds 1 vehicles that are there from 0 s to 3 s, 2 are'):
        read_fcd(three, 2, duration=3.0)


def test_a_duration_beyond_the_file_is_refused(three) -> None:
    with pytest.raises(LogError, match='holds 0 vehicles that are there from 0 s to 9 s'):
        read_fcd(three, 1, duration=9.0)


def test_too_few_vehicles_are_refused(three) -> None:
    with pytest.raises(LogError, match=r'fcd\.xml: holds 2 vehicles .* from 0 s on, 3 are wanted'):
        read_fcd(three, 3)


@pytest.mark.parametrize('start', [-1, 3.5])
def test_a_start_outside_of_the_file_is_refused(three, start) -> None:
    with pytest.raises(LogError, match=f'holds nothing at the wanted start, {start} s: it '
                                       'lasts from 0 s to 3 s'):
        read_fcd(three, 1, start=start)


def test_a_file_without_time_steps_is_refused(write) -> None:
    with pytest.raises(LogError, match='it is empty'):
        read_fcd(write(), 1)


def test_height_is_read_when_asked_for(write) -> None:
    path = write(step(0, vehicle('a', z=7)), step(1, vehicle('a', z=8)))
    assert read_fcd(path, 1).position.shape == (2, 1, 2)
    np.testing.assert_array_equal(read_fcd(path, 1, elevation=True).position[:, 0, 2], [7.0, 8.0])


def test_height_asked_for_and_missing_is_refused_by_line(write) -> None:
    with pytest.raises(LogError, match=r'fcd\.xml:2: <vehicle> has no z'):
        read_fcd(write(step(0, vehicle('a'))), 1, elevation=True)


def utm(write) -> Path:
    return write(step(0, vehicle('a', 690123.5, 5336000, 90)),
                 step(1, vehicle('a', 690133.5, 5336000.25, 90)))


def test_coordinates_beyond_100_km_are_refused(write) -> None:
    with pytest.raises(LogError, match=r'beyond 100 km, at \(690134, 5336000\) m; .*local_origin'):
        read_fcd(utm(write), 1)


def test_a_local_origin_moves_ways_by_whole_metres_when_asked_for(write) -> None:
    trace = read_fcd(utm(write), 1, local_origin=True)
    np.testing.assert_array_equal(trace.position[:, 0], [[0.5, 0.0], [10.5, 0.25]])


def test_other_road_users_and_elements_are_passed_over(write) -> None:
    path = write(step(0, vehicle('a'), '<person id="p"/>'), step(1, vehicle('a'), '<new x="q"/>'))
    assert read_fcd(path, 1).names == ('a',)


@pytest.mark.parametrize(('steps', 'message'), [
    ([step(0, '<vehicle x="0" y="0" angle="0"/>')], ':2: <vehicle> has no id'),
    ([step(0, '<vehicle id="a" x="0" angle="0"/>')], ':2: <vehicle> has no y, expected a number'),
    ([step(0, '<vehicle id="a" x="0" y="0"/>')], ':2: <vehicle> has no angle'),
    ([step(0), step(1, vehicle('a', x='far'))], ":3: x='far' of <vehicle> is not a finite number"),
    ([step(0, vehicle('a', y='nan'))], ":2: y='nan' of <vehicle> is not a finite"),
    ([step(0, vehicle('a', y='1e999'))], ":2: y='1e999' of <vehicle> is not a finite"),
    (['<timestep/>'], ':2: <timestep> has no time'),
    ([step('00:00:01')], ":2: time='00:00:01' of <timestep> is not a finite number"),
    ([step(1), step(0.5)], ':3: time 0.5 s does not come after 1 s, expected time steps in order'),
    ([step(1), step(1)], ':3: time 1 s does not come after 1 s'),
    ([step(0, vehicle('a'), vehicle('a'))], ":2: vehicle 'a' appears twice in the time step 0 s"),
    ([vehicle('a')], ':2: <vehicle> stands outside of a <timestep>'),
    (['<timestep time="0">'], ':3: is not well-formed XML: mismatched tag'),
    ([step(0, vehicle('&lol;'))], ':2: is not well-formed XML: undefined entity'),
])
def test_a_bad_row_is_refused_by_file_and_line(write, steps, message) -> None:
    with pytest.raises(LogError, match=re.escape('fcd.xml' + message)):
        read_fcd(write(*steps), 1)


def test_entities_are_refused_before_they_grow(tmp_path) -> None:
    path = tmp_path / 'bomb.xml'
    path.write_text(BOMB)
    with pytest.raises(LogError, match=r'bomb\.xml:1: has a document type definition .* refused'):
        read_fcd(path, 1)


def test_another_kind_of_xml_is_refused(tmp_path) -> None:
    path = tmp_path / 'routes.xml'
    path.write_text('<routes/>')
    with pytest.raises(LogError, match=r':1: <routes> is not the root .* expected <fcd-export>'):
        read_fcd(path, 1)


def test_a_file_that_is_no_xml_is_refused(tmp_path) -> None:
    path = tmp_path / 'noise.xml'
    path.write_bytes(bytes(range(256)))
    with pytest.raises(LogError, match=r'noise\.xml:1: is not well-formed XML'):
        read_fcd(path, 1)


def test_a_truncated_gzip_file_is_refused(city, tmp_path) -> None:
    path = tmp_path / 'cut.xml.gz'
    path.write_bytes(city.read_bytes()[:50_000])
    with pytest.raises(LogError, match=r'cut\.xml\.gz:\d{4,}: the gzip file is damaged'):
        read_fcd(path, 40, 40.0)


def test_a_truncated_plain_file_is_refused(city, tmp_path) -> None:
    path = tmp_path / 'cut.xml'
    path.write_bytes(gzip.decompress(city.read_bytes())[:500_000])
    with pytest.raises(LogError, match=r'cut\.xml:\d{4,}: is not well-formed XML'):
        read_fcd(path, 40, 40.0)


def test_a_corrupt_gzip_file_is_refused(city, tmp_path) -> None:
    data = bytearray(city.read_bytes())
    data[40_000:40_100] = bytes(100)
    path = tmp_path / 'corrupt.xml.gz'
    path.write_bytes(data)
    with pytest.raises(LogError, match=r'corrupt\.xml\.gz:\d+: '):
        read_fcd(path, 40, 40.0)


def test_a_missing_file_is_refused(tmp_path) -> None:
    with pytest.raises(LogError, match=r'none\.xml: cannot read the trace: No such file'):
        read_fcd(tmp_path / 'none.xml', 1)


def test_a_replay_without_a_trace_is_refused() -> None:
    with pytest.raises(ConfigError, match="trace: '' is not allowed, must be the path"):
        follow('fcd', TraceConfig(), 1)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(
    st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.floats(0, 360)), min_size=2, max_size=5))
def test_whatever_is_written_is_read_back(tmp_path_factory, rows) -> None:
    path = tmp_path_factory.mktemp('fcd') / 'any.xml'
    path.write_text(xml(*(step(time, vehicle('a', *row)) for time, row in enumerate(rows))))
    trace = read_fcd(path, 1)
    assert trace.position[:, 0].tolist() == [[x, y] for x, y, _ in rows]
    np.testing.assert_allclose(
        np.exp(1j * trace.yaw[:, 0]), [1j * np.exp(-1j * math.radians(a)) for *_, a in rows],
        atol=1e-12)
