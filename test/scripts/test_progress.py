"""Progress bars, seen through a terminal that is none."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
import os
from pathlib import Path
import pty
import sys
import termios
import threading

import numpy as np
import pytest
from tsmcl_ros.scripts.cli import progress
from tsmcl_ros.types import Trajectory


@pytest.fixture(scope='module')
def walk(record: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a small bag that can be evaluated."""
    stamp = np.arange(20.0)
    path = np.stack([stamp, 0 * stamp], axis=1)
    return record(tmp_path_factory.mktemp('bags') / 'walk', {
        '/ground_truth': Trajectory(stamp, path, 0 * stamp),
        '/pose': Trajectory(stamp, path + 1, 0 * stamp, np.tile(np.eye(2), (20, 1, 1)))})


@pytest.fixture(scope='module')
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a small log whose rssi falls with the distance."""
    folder = tmp_path_factory.mktemp('log')
    (folder / 'anchors.csv').write_text('id,x,y,z\n1,0,0,\n')
    rows = [(t, -50 - 20 * np.log10(t + 1)) for t in range(60)]
    (folder / 'beacons.csv').write_text(
        't,anchor,range,rssi\n' + ''.join(f'{t},1,,{rssi:.1f}\n' for t, rssi in rows))
    (folder / 'truth.csv').write_text(
        't,x,y,z,yaw\n' + ''.join(f'{t},{t + 1},0,,\n' for t, _ in rows))
    return folder


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Return a function that returns what a script says to a terminal, or to a pipe."""

    def said_by(module: str, *arguments: object, terminal: bool = True) -> str:
        mine, its = pty.openpty() if terminal else os.pipe()
        if terminal:
            termios.tcsetwinsize(its, (25, 100))
        chunks: list[bytes] = []
        reader = threading.Thread(target=lambda: chunks.extend(_chunks(mine)), daemon=True)
        reader.start()
        with monkeypatch.context() as patch, os.fdopen(its, 'w') as stream:
            patch.setattr(sys, 'stderr', stream)
            main = import_module(f'tsmcl_ros.scripts.{module}').main
            assert main(list(map(str, arguments))) == 0
        reader.join(10)
        os.close(mine)
        return b''.join(chunks).decode()

    return said_by


def _chunks(descriptor: int) -> Iterator[bytes]:
    while True:
        try:
            chunk = os.read(descriptor, 65536)
        except OSError:  # how a terminal says that nobody writes to it any more
            return
        if not chunk:
            return
        yield chunk


Call = tuple[str, list[object], list[str]]


@pytest.fixture(params=['evaluate', 'import_csv', 'fit_path_loss', 'experiment'])
def call(request: pytest.FixtureRequest, walk: Path, log: Path, tmp_path: Path) -> Call:
    """Return a script that may take long, its arguments, and what it shows."""
    calls: dict[str, tuple[list[object], list[str]]] = {
        'evaluate': ([walk, '--out', tmp_path / 'out'], [f'{walk}', 'drawing']),
        'import_csv': ([log, tmp_path / 'bag'], [
            f'{log}/beacons.csv', 'gathering', 'writing']),
        'fit_path_loss': ([log], [f'{log}/beacons.csv', 'fitting']),
        'experiment': (['period_factor', '--quick', '--workers', 1, '--out', tmp_path],
                       ['period_factor']),
    }
    return request.param, *calls[request.param]


def test_a_terminal_shows_how_far_a_script_is(
    said: Callable[..., str], call: Call,
) -> None:
    module, arguments, shown = call
    text = said(module, *arguments)
    for name in shown:
        assert f'\r{name}:   0%' in text or f'\r{name}: 0' in text


def test_nobody_is_shown_who_wants_it_quiet(
    said: Callable[..., str], call: Call,
) -> None:
    module, arguments, _ = call
    assert said(module, *arguments, '--quiet') == ''


def test_a_pipe_is_not_shown(
    said: Callable[..., str], call: Call,
) -> None:
    module, arguments, _ = call
    assert said(module, *arguments, terminal=False) == ''


def test_what_is_shown_is_handed_through() -> None:
    assert list(progress(True)(iter('abc'), None, 'letter')) == ['a', 'b', 'c']
