"""Which kind a trace is, and that all kinds are followed."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from tsmcl_ros.traces import FOLLOW, READERS, recognise, TraceConfig
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
