"""A few hundred hostile inputs each; `python test/fuzz/run.py` tries as many as are wanted."""

from pathlib import Path
import subprocess
import sys

import pytest

RUN = Path(__file__).parent / 'fuzz' / 'run.py'


def fuzz(*arguments: object) -> tuple[int, str]:
    found = subprocess.run(
        [sys.executable, RUN, *map(str, arguments)], capture_output=True, encoding='utf-8')
    return found.returncode, found.stdout + found.stderr


def test_nothing_crashes_on_hostile_inputs_nor_refuses_them_unclearly(tmp_path: Path) -> None:
    code, output = fuzz('--inputs', 2000, '--seed', 1, '--out', tmp_path / 'crashes')
    assert code == 0, output
    assert not (tmp_path / 'crashes').exists()


@pytest.mark.parametrize('target', ['nothing', '--inputs=x'])
def test_a_wrong_call_is_refused(target: str) -> None:
    code, output = fuzz(target)
    assert code == 2
    assert 'nothing is not allowed, must be one of beacons, ' in output or 'invalid int' in output
