"""What a process that uses ROS sets up."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tsmcl_ros.nodes.process import session


@pytest.mark.parametrize('name', [
    'FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'])
def test_what_a_user_tells_fast_dds_stands(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str,
) -> None:
    for each in ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'):
        monkeypatch.delenv(each, raising=False)
    monkeypatch.setenv(name, str(tmp_path / 'profiles.xml'))
    with session():
        assert [value for key, value in os.environ.items() if 'DEFAULT_PROFILES' in key] == [
            str(tmp_path / 'profiles.xml')]


def test_fast_dds_takes_no_memory_for_messages_that_have_not_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
    monkeypatch.delenv('FASTDDS_DEFAULT_PROFILES_FILE', raising=False)
    with session():
        told = ElementTree.parse(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'])
    assert [found.text for found in told.iter() if found.tag.endswith('allocated_samples')] == [
        '0', '0']
