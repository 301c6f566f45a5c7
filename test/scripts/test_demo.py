from __future__ import annotations

from collections.abc import Callable
import json
import os
from pathlib import Path
import signal
import time
from types import SimpleNamespace
from typing import Any

import pytest
from tsmcl_ros.bag import Reader
from tsmcl_ros.scripts import demo as script
from tsmcl_ros.scripts.demo import main
from tsmcl_ros.types import TsmclError

Start = Callable[..., Any]
SMALL = ('--vehicles', '3', '--rate', '10', '--out', 'demo')


def members(out: Path) -> list[str]:
    """Return the command lines of the processes that log into a demo's folder."""
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        try:
            environment = (process / 'environ').read_bytes()
            if f'ROS_LOG_DIR={out.name}/log'.encode() in environment.split(b'\0') and (
                (process / 'cwd').resolve() == out.parent.resolve()
            ):
                found.append((process / 'cmdline').read_bytes().replace(b'\0', b' ').decode())
        except OSError:
            continue  # it has just ended
    return found


def wait_until(condition: Callable[[], bool], what: str, timeout: float = 60.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            pytest.fail(f'waited {timeout:g} s in vain for {what}')
        time.sleep(0.05)


def is_under_way(out: Path) -> bool:
    """Tell whether the fleet of a demo has heard its first beacons."""
    log = out / 'log' / 'fleet.txt'
    return log.exists() and 'OK: ' in log.read_text()


def test_one_command_simulates_localizes_records_evaluates_and_compares(
    run: Any, tmp_path: Path,
) -> None:
    code, output = run('scripts.demo', *SMALL, '--duration', '20', '--seed', '3')
    assert code == 0
    out = tmp_path / 'demo'
    assert members(out) == []
    for label in ('ts_mcl, over DDS', 'mcl', 'mcl, random motion', 'available', '3 of 3'):
        assert label in output
    assert 'Traceback' not in output
    with Reader(out / 'bag') as bag:
        for i in range(3):
            for name in ('beacons', 'odom', 'ground_truth', 'pose'):
                assert bag.counts[f'/veh_{i}/{name}'] == 20
        assert bag.counts['/anchor_map'] == 1
    metrics = json.loads((out / 'metrics.json').read_text())['bags']
    assert set(metrics['ts_mcl, over DDS']['vehicles']) == {'veh_0', 'veh_1', 'veh_2'}
    report = (out / 'report.html').read_text()
    assert '<svg' in report
    for name, parameter in (('anchor', 'seed: 3'), ('fleet', 'method: ts_mcl'),
                            ('simulator', 'duration: 20.0')):
        row = report.split(f'parameters of {name}', 1)[1].split('</tr>', 1)[0]
        assert parameter in row, row


def test_an_interrupted_demo_leaves_a_complete_bag_and_no_process(
    start: Start, tmp_path: Path,
) -> None:
    demo = start('scripts.demo', *SMALL)
    out = tmp_path / 'demo'
    wait_until(lambda: is_under_way(out), 'the simulation')
    assert len(members(out)) == 4
    assert demo.stop(signal.SIGINT) == 0
    assert members(out) == []
    assert 'Traceback' not in demo.output
    with Reader(out / 'bag') as bag:
        assert bag.counts['/veh_0/beacons'] > 0


def test_processes_of_a_killed_demo_end_too(start: Start, tmp_path: Path) -> None:
    demo = start('scripts.demo', *SMALL)
    out = tmp_path / 'demo'
    wait_until(lambda: is_under_way(out), 'the simulation')
    os.kill(demo.process.pid, signal.SIGKILL)
    wait_until(lambda: not members(out), 'the end of its processes')
    with Reader(out / 'bag') as bag:
        assert bag.counts['/veh_0/beacons'] > 0


def test_what_a_node_complains_of_is_shown_and_ends_the_demo(
    run: Any, tmp_path: Path,
) -> None:
    code, output = run('scripts.demo', *SMALL, '--fcd', 'nowhere.xml')
    assert code == 1
    assert output.startswith('error: simulator: nowhere.xml: ')
    assert len(output.splitlines()) == 1
    assert members(tmp_path / 'demo') == []


def test_a_folder_that_exists_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(['--out', str(tmp_path)]) == 1
    assert capsys.readouterr().err == (
        f'error: --out: {tmp_path} exists already, must be a folder to be made\n')
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize('arguments', [
    ['--vehicles', '0'], ['--rate', '-1'], ['--duration', 'nan'], ['--method', 'magic'],
    ['--config'],
])
def test_values_that_make_no_sense_are_wrong_usage(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2


def test_that_no_domain_is_left_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    class Taken:
        def __init__(self, *_: object) -> None:
            pass

        def bind(self, _: str) -> None:
            raise OSError

        def close(self) -> None:
            pass

    monkeypatch.setattr(script.socket, 'socket', Taken)
    with pytest.raises(TsmclError, match='all 101 ROS domains are in use by other demos'):
        script._free_domain()


def test_nodes_that_do_not_meet_are_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(script, '_START_PATIENCE', 0.0)
    watch = SimpleNamespace(spin=lambda *_: False)
    processes = SimpleNamespace(check=lambda: None, folder='logs')
    error = 'the nodes have not found each other within 0 s, what they say is in logs'
    with pytest.raises(TsmclError, match=error):
        script._await(processes, watch, lambda: False)
