"""A ROS context for each test, and a node of the test's own to talk to others with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from pathlib import Path
import time
from typing import Any

import pytest
import rclpy
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from tsmcl_ros.nodes import runtime, wire
import yaml

PATIENCE = 90.0  # s, for anything that healthy nodes do at once, on a machine under load


class Probe(runtime.Node):
    """A test's own node."""

    default_name = 'probe'

    def collect(
        self, topic: str, kind: str, qos: QoSProfile = wire.SENSOR_DATA,
    ) -> list[bytes]:
        """Return a list that fills with a topic's messages."""
        received: list[bytes] = []
        self.listen(topic, kind, received.append, qos)
        return received

    def hears(self, topics: Iterable[str]) -> bool:
        """
        Return whether each subscription to these topics has found a publisher.

        Unlike what ROS's graph knows of, which comes before.
        """
        wanted = {self.resolve_topic_name(topic) for topic in topics}
        return all(subscription.get_publisher_count() for subscription in self.subscriptions
                   if subscription.topic_name in wanted)

    def expect(self, condition: Callable[[], bool], what: str) -> None:
        """Handle messages until the condition holds; fail if it never does."""
        if not self.spin(condition, PATIENCE):
            pytest.fail(f'waited {PATIENCE:g} s in vain for {what}')

    def insist(self, act: Callable[[], None], condition: Callable[[], bool], what: str) -> None:
        """
        Do something again and again until the condition holds; fail if it never does.

        A best-effort message is lost on a subscription that has not found its publisher yet, and
        the publisher cannot know.
        """
        end = time.monotonic() + PATIENCE
        while not condition():
            act()
            self.spin(condition, 0.1)
            if time.monotonic() > end:
                pytest.fail(f'did it for {PATIENCE:g} s in vain for {what}')


class Scene:
    """
    A localizer node and a probe in one process, that talk over DDS.

    They share a DDS participant: a subscription that one has found has found it, too.
    """

    def __init__(self, node: Any, probe: Any) -> None:
        self.node, self.probe = node, probe

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """
        Let both handle messages until the condition holds.

        Both do so at least once: what comes before an executor knows the subscriptions is
        handled in no order.
        """
        for _ in range(3000):
            self.node.spin(timeout=0.005)
            self.probe.spin(timeout=0.005)
            if condition():
                return
        pytest.fail(f'waited in vain for {what}')


@contextmanager
def _ros() -> Iterator[Callable[..., None]]:
    try:
        yield lambda *arguments: rclpy.init(
            args=['test', '--ros-args', *arguments],
            signal_handler_options=SignalHandlerOptions.NO,
        )
    finally:
        rclpy.try_shutdown()


@pytest.fixture
def ros() -> Iterator[Callable[..., None]]:
    """Start ROS with some arguments, once a test."""
    with _ros() as init:
        yield init


@pytest.fixture
def probe_class() -> type[Probe]:
    """Return the class of a test's own node."""
    return Probe


@contextmanager
def _probing() -> Iterator[Probe]:
    with _ros() as ros:
        ros()
        with closing(Probe()) as node:
            yield node


@pytest.fixture(scope='session')
def probing() -> Callable[..., AbstractContextManager[Probe]]:
    """Return what makes a probe for a while, for fixtures that serve several tests."""
    return _probing


@pytest.fixture
def probe() -> Iterator[Probe]:
    """Return a node of the test's own, on the wall's time."""
    with _probing() as node:
        yield node


@pytest.fixture
def begin(ros: Callable[..., None], tmp_path: Path) -> Iterator[Callable[..., Scene]]:
    """Start a node with some parameters in namespace /veh_0, beside a probe."""
    nodes: list[runtime.Node] = []

    def begin_one(kind: type[runtime.Node], **settings: object) -> Scene:
        # For this node alone, as the probe has no such parameters.
        path = tmp_path / 'parameters.yaml'
        path.write_text(yaml.safe_dump(
            {f'/**/{kind.default_name}': {'ros__parameters': settings}}))
        ros('-r', '__ns:=/veh_0', '--params-file', str(path))
        nodes.extend([kind(), Probe()])
        nodes[0].spin(timeout=0.01)  # before anybody publishes a map
        return Scene(*nodes)

    yield begin_one
    for node in nodes:
        node.close()
