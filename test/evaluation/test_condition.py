"""What is read from diagnostics."""

import numpy as np
import pytest
from tsmcl_ros.evaluation.condition import read_conditions
from tsmcl_ros.messages import Diagnosis, encode_diagnostics


def told(stamp, level=0, name='/veh_0', **values):
    return encode_diagnostics(stamp, [Diagnosis(level, 'fleet', 'so', name, values)])


def test_a_condition_is_what_was_told_when():
    rows = [told(1.0, 0, **{'particles': '200', 'effective particles': '50'}),
            told(2.0, 1, **{'particles': '400', 'effective particles': '300.5'})]

    found = read_conditions(rows, 0.0, 9.0)['/veh_0']

    assert (found.stamp.tolist(), found.level.tolist()) == ([1, 2], [0, 1])
    assert (found.particles.tolist(), found.ess.tolist()) == ([200, 400], [50, 300.5])
    assert found.effective == pytest.approx([0.25, 0.75125])


def test_numbers_that_are_missing_or_none_are_unknown():
    [found] = read_conditions([told(1.0), told(2.0, particles='many')], 0, 9).values()

    assert np.isnan([found.particles, found.ess, found.effective]).all()


def test_suspects_are_counted_by_the_diagnoses_that_name_them():
    rows = [told(stamp, suspects=text) for stamp, text in enumerate(['', '7', '7, 12', '7'])]

    assert read_conditions(rows, 0, 9)['/veh_0'].suspects == {7: 0.75, 12: 0.25}


def test_one_diagnosis_before_the_evaluated_time_tells_how_it_began():
    rows = [told(stamp, level) for level, stamp in enumerate([1.0, 2.0, 3.0, 8.0, 9.5])]

    assert read_conditions(rows, 2.5, 9.0)['/veh_0'].level.tolist() == [1, 2, 3]


def test_vehicles_are_told_apart_by_their_hardware():
    rows = [told(1.0, 0, '/a'), told(1.0, 2, '/b'), told(2.0, 1, '/a')]

    found = read_conditions(rows, 0, 9)

    assert {name: part.level.tolist() for name, part in found.items()} == {'/a': [0, 1], '/b': [2]}


def test_diagnostics_that_are_damaged_or_go_back_in_time_are_passed_over():
    rows = [told(3.0), b'\0\1\0\0nonsense', told(2.0, 1), told(4.0, 2)]

    assert read_conditions(rows, 0, 9)['/veh_0'].level.tolist() == [0, 2]


def test_what_is_no_id_is_no_suspect():
    rows = [told(1.0, suspects=f'{"9" * 5000}, -7, 0x7, 7')]

    assert read_conditions(rows, 0, 9)['/veh_0'].suspects == {7: 1.0}
