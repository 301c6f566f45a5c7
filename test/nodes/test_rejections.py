"""Reports of rejected messages."""

from __future__ import annotations

from tsmcl_ros.nodes.rejections import Rejections
from tsmcl_ros.types import MessageError


def test_rejections_are_reported_once_in_five_seconds_a_topic_with_their_number() -> None:
    reports: list[str] = []
    time = [0.0]
    rejections = Rejections(reports.append, lambda: time[0])
    for topic in ('/a', '/a', '/b', '/a'):
        rejections.add(topic, MessageError('odd'))
    assert reports == ['/a: message rejected: odd', '/b: message rejected: odd']
    time[0] = 4.9
    rejections.report()
    assert len(reports) == 2
    time[0] = 5.0
    rejections.report()
    assert reports[2:] == ['/a: message rejected: odd (2 messages rejected since the last report)']
    rejections.report(at_once=True)
    assert len(reports) == 3
