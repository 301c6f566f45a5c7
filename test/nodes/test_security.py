"""Nodes that insist on DDS security, and the keys that it takes."""

from __future__ import annotations

from pathlib import Path
import subprocess

import pytest
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.runtime import main

SCRIPT = Path(__file__).resolve().parents[2] / 'examples' / 'make_keystore.sh'
NAMES = ('ROS_SECURITY_ENABLE', 'ROS_SECURITY_STRATEGY', 'ROS_SECURITY_KEYSTORE')


@pytest.fixture(autouse=True)
def insecure(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.delenv(name, raising=False)


def refused(capfd: pytest.CaptureFixture[str], kind: type = LocalizerNode) -> str:
    """Start a node that requires security, and return the one line of its own."""
    assert main(kind, ['test', '--ros-args', '-p', 'require_security:=true']) == 1
    line, = [line for line in capfd.readouterr().err.splitlines()
             if line.startswith(f'{kind.default_name}: ')]
    return line.partition(': ')[2]


@pytest.mark.parametrize('kind', [LocalizerNode, Fleet, Anchor])
def test_a_node_that_requires_security_does_not_start_without(
    capfd: pytest.CaptureFixture[str], kind: type,
) -> None:
    assert refused(capfd, kind) == (
        "require_security: DDS security is off, as ROS_SECURITY_ENABLE is '', must be true")


def test_a_strategy_that_lets_nodes_do_without_is_not_enough(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Permissive')
    assert refused(capfd).endswith("as ROS_SECURITY_STRATEGY is 'Permissive', must be Enforce")


def test_no_keystore_is_told_in_words(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    monkeypatch.setenv('ROS_SECURITY_STRATEGY', 'Enforce')
    assert refused(capfd).startswith(
        'DDS security is enforced and ROS_SECURITY_KEYSTORE names no folder')


def test_a_keystore_that_is_not_there_is_named(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
) -> None:
    for name, value in zip(NAMES, ('true', 'Enforce', str(tmp_path / 'keys')), strict=True):
        monkeypatch.setenv(name, value)
    assert f"directory '{tmp_path}/keys/enclaves' does not exist" in refused(capfd)


def test_keys_that_are_none_or_a_dds_without_security_end_it_in_one_line(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
) -> None:
    """With the wheels it is the latter, whatever the keys: their Fast DDS is built without."""
    (tmp_path / 'enclaves').mkdir()
    for name, value in zip(NAMES, ('true', 'Enforce', str(tmp_path)), strict=True):
        monkeypatch.setenv(name, value)
    assert 'secur' in refused(capfd).lower()


def test_the_script_that_makes_a_keystore_can_be_read_by_bash() -> None:
    assert subprocess.run(['bash', '-n', SCRIPT]).returncode == 0


@pytest.mark.parametrize(('arguments', 'code', 'line'), [
    ([], 2, 'usage: '), (['keys'], 1, 'ros2 is not found: source a ROS installation first')])
def test_the_script_says_what_it_lacks(
    tmp_path: Path, arguments: list[str], code: int, line: str,
) -> None:
    done = subprocess.run(
        ['/bin/bash', SCRIPT, *arguments], cwd=tmp_path, env={'PATH': '/usr/bin:/bin'},
        capture_output=True, text=True)
    assert (done.returncode, len(done.stderr.splitlines())) == (code, 1)
    assert line in done.stderr
