"""The commands behind `make bench` and `make reliability`, not what they find."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

import pytest

FOLDER = Path(__file__).parent / 'benchmark'


@pytest.mark.accuracy
def test_a_benchmark_prints_its_table_and_writes_it_as_a_page(tmp_path: Path) -> None:
    page = tmp_path / 'page.md'
    printed = subprocess.run(
        [sys.executable, FOLDER / 'run.py', 'codec', '--out', page],
        capture_output=True, text=True, check=True).stdout
    assert printed.startswith('Codec\n')
    assert '## Codec' in page.read_text()
    assert '| beacons |' in page.read_text()


@pytest.mark.parametrize('folder', [FOLDER, FOLDER.parent / 'reliability'])
def test_every_section_is_measured_by_default(folder: Path) -> None:
    modules = {path.stem for path in folder.glob('*.py') if 'def measure(' in path.read_text()}
    listed = subprocess.run(
        [sys.executable, folder / 'run.py', '--help'], env=os.environ | {'COLUMNS': '999'},
        capture_output=True, text=True, check=True).stdout
    assert modules == set(listed[listed.index('sections: ') + 10:listed.index(' (default')]
                          .replace(',', '').split())


@pytest.mark.parametrize(('measured', 'sense', 'verdict'), [
    (0.4, 'at most', 'reached'), (0.41, 'at most', 'missed'),
    (1.8, 'at least', 'reached'), (1.79, 'at least', 'missed'),
])
def test_a_goal_is_reached_on_the_right_side_of_its_bound(
    measured: float, sense: str, verdict: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    from goals import Goal

    bound = 0.4 if sense == 'at most' else 1.8
    assert Goal('us over them', measured, bound, sense).row()[-1] == verdict


def test_a_missed_goal_says_why_and_a_reached_one_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER))
    from goals import Goal, Section

    missed = Goal('time', 2, 1, unit='s', reason='it sleeps')
    reached = Goal('memory', 1, 2, unit='MB', reason='it forgets')
    text = Section('Title', 'Text.', goals=[missed, reached]).markdown()
    assert 'Missed, time: it sleeps' in text
    assert 'it forgets' not in text
