"""Half a minute of what test/reliability/long_run.py runs for an hour."""

from __future__ import annotations

from pathlib import Path
import sys

sys.path.append(str(Path(__file__).parents[1] / 'reliability'))
from long_run import alone, over_dds  # noqa: E402, I100


def test_a_localizer_loses_no_epoch_and_keeps_its_size() -> None:
    found, lost = alone(seconds=300, vehicles=5)
    assert lost == 0
    assert (found.threads, found.descriptors) == (0, 0)
    assert found.growth < 0.05


def test_nodes_in_lockstep_lose_no_epoch_at_any_rate_and_keep_their_size(tmp_path: Path) -> None:
    nodes, given_up, unrecorded = over_dds(seconds=60, folder=tmp_path, vehicles=5)
    assert (given_up, unrecorded) == (0, 0)
    assert len(nodes) == 4
    assert all(node.threads == node.descriptors == 0 for node in nodes.values())
    assert all(node.growth < 0.05 for node in nodes.values())
