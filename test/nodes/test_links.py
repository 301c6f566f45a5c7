"""A link that is cut, localizers and anchors that are killed; see test/reliability/links.py."""

from __future__ import annotations

from pathlib import Path
import sys

import pytest

sys.path += [str(Path(__file__).parents[1] / 'reliability'), str(Path(__file__).parent)]
from broken_bags import fill_disk  # noqa: E402, I100
from links import cut_link, kill_fleet, Refused, restart_anchors  # noqa: E402, I100
from stalls import calmly  # noqa: E402, I100


def made(folder: Path) -> Path:
    """Make a folder."""
    folder.mkdir()
    return folder


@pytest.mark.accuracy
def test_a_fleet_behind_a_cut_link_is_stale_in_two_epochs_and_well_again_in_five(
    tmp_path: Path,
) -> None:
    try:
        found = calmly(lambda number: cut_link(
            made(tmp_path / f'{number}'), settled=4, seconds=6, after=5))
    except Refused as refused:
        pytest.skip(f'this machine lets nobody make hosts: {refused}')
    assert found.noticed < 2
    assert found.recovered < 5
    assert found.wrong < 0.1
    assert (found.lost, found.suspects) == (0, 0)


@pytest.mark.accuracy
def test_killed_localizers_are_right_again_in_three_epochs(tmp_path: Path) -> None:
    found = calmly(lambda number: kill_fleet(
        made(tmp_path / f'{number}'), settled=4, after=5))
    assert found.recovered < 3
    # One vehicle more or less is a twentieth, and stays so for some epochs.
    assert found.wrong < 0.15


@pytest.mark.accuracy
def test_of_anchors_that_are_started_again_nobody_speaks(tmp_path: Path) -> None:
    found, news = calmly(lambda number: restart_anchors(
        made(tmp_path / f'{number}'), settled=4, after=5))
    assert (found.lost, found.suspects) == (0, 0)
    assert found.wrong < 0.1
    # No beacons for a moment, and nothing else.
    assert all('STALE: ' in line or 'OK: ' in line for line in news)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_on_a_real_disk_that_is_full_is_valid(tmp_path: Path, storage: str) -> None:
    try:
        valid, said = fill_disk(tmp_path, storage, size=2500)
    except FileNotFoundError as error:
        pytest.skip(f'{error.filename} is not installed')
    if 'unshare' in said or 'mount' in said:
        pytest.skip(f'this machine lets nobody mount: {said}')
    assert valid, said
    assert 'No space left on device' in said or 'is full' in said
