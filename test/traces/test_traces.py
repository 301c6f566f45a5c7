"""Which kind a trace is, and that all kinds are followed."""

from __future__ import annotations

from contextlib import suppress
import gzip

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from tsmcl_ros.traces import FOLLOW, follow, READERS, recognise, TraceConfig
from tsmcl_ros.types import LogError

# A vehicle that drives 10 m to the east in 10 s.
SAME = {
    'fcd': '<fcd-export><timestep time="0"><vehicle id="a" x="0" y="0" angle="90"/></timestep>'
           '<timestep time="10"><vehicle id="a" x="10" y="0" angle="90"/></timestep></fcd-export>',
    'ns2': '# a comment\n$node_(0) set X_ 0\n$node_(0) set Y_ 0\n'
           '$ns_ at 0 "$node_(0) setdest 10 0 1"\n',
    'bonnmotion': '0 0 0 10 10 0\n',
}


@pytest.mark.parametrize('kind', READERS)
@pytest.mark.parametrize('packed', [False, True])
def test_a_trace_is_recognised_by_how_it_begins(tmp_path, kind, packed) -> None:
    path = tmp_path / 'trace'
    data = SAME[kind].encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    assert recognise(path) == kind


@pytest.mark.parametrize(('kind', 'file'), [
    *((kind, kind) for kind in READERS), *(('trace', kind) for kind in READERS),
])
def test_vehicles_follow_the_same_way_in_every_format(tmp_path, kind, file) -> None:
    path = tmp_path / 'trace'
    path.write_text(SAME[file])
    state = FOLLOW[kind](TraceConfig(trace=str(path), trace_start=0.0), 1).step(4.0)
    np.testing.assert_allclose(state.position, [[4.0, 0.0]])
    np.testing.assert_allclose(state.velocity, [[1.0, 0.0]])
    np.testing.assert_allclose(state.yaw, [0.0], atol=1e-12)


def test_a_missing_file_is_refused(tmp_path) -> None:
    with pytest.raises(LogError, match='none: cannot read the trace: No such file'):
        recognise(tmp_path / 'none')


PIECES = st.sampled_from([
    '$node_(0) set X_ ', '$node_(1) set Y_ ', '$ns_ at ', ' "$node_(0) setdest ', '"', '\n', ' ',
    '0', '1', '-3.5', 'nan', '1e308', '#', '<fcd-export>', '\x00', '\u2028', '$god_ '])


@pytest.mark.parametrize('kind', READERS)
@given(pieces=st.lists(PIECES, max_size=30))
def test_no_text_is_worse_than_refused(tmp_path_factory, kind, pieces) -> None:
    path = tmp_path_factory.mktemp('text') / 'trace'
    path.write_text(''.join(pieces))
    with suppress(LogError):
        trace = READERS[kind](path, 1)
        assert np.isfinite(trace.position).all()


def follow_one(path, data) -> None:
    path.write_bytes(data)
    follow('trace', TraceConfig(trace=str(path)), 1)


@pytest.mark.parametrize(('line', 'error'), [
    (b'\n', 'unpacks to more than 50 times its size, which no trace does'),
    (b'$node_(0) set X_ 1.0\n', 'unpacks to more than 50 times its size, which no trace does'),
])
def test_a_file_that_unpacks_beyond_measure_is_refused(tmp_path, line, error) -> None:
    packed = gzip.compress(line * (3_000_000 // len(line)))
    assert len(packed) < 20_000
    with pytest.raises(LogError, match=error):
        follow_one(tmp_path / 'trace.gz', packed)


def test_a_line_that_would_not_end_is_refused(tmp_path) -> None:
    with pytest.raises(LogError, match=':1: is longer than 2097152 bytes, as no line may be'):
        follow_one(tmp_path / 'trace', b' ' * 3_000_000)


def test_xml_that_unpacks_beyond_measure_is_refused(tmp_path) -> None:
    packed = gzip.compress(b'<fcd-export>\n' + b' \n' * 3_000_000)
    with pytest.raises(LogError, match='unpacks to more than 50 times its size'):
        follow_one(tmp_path / 'trace.gz', packed)


def test_xml_without_an_end_of_its_element_is_refused(tmp_path) -> None:
    with pytest.raises(LogError, match='has an element of more than 1048576 bytes'):
        follow_one(tmp_path / 'trace', b'<fcd-export\na="' + b'x' * 3_000_000)


@pytest.mark.parametrize('encoding', ['idna', 'utf-7', 'nonsense', 'rot13'])
def test_xml_in_an_encoding_that_is_none_is_refused(tmp_path, encoding) -> None:
    data = f'<?xml version="1.0" encoding="{encoding}"?><fcd-export></fcd-export>'
    with pytest.raises(LogError, match=':1: has an encoding that cannot be read, must be UTF-8'):
        follow_one(tmp_path / 'trace', data.encode())


def test_a_node_with_a_number_of_thousands_of_digits_is_refused(tmp_path) -> None:
    with pytest.raises(LogError, match='is not understood, expected'):
        follow_one(tmp_path / 'trace', b'$node_(' + b'9' * 5000 + b') set X_ 1.0\n')
