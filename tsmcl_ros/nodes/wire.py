"""Serialized messages on the wire: how they are served, what they are, and bursts of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from tsmcl_ros.nodes.process import PATIENCE
from tsmcl_ros.topics import compiled
from tsmcl_ros.types import MessageError

# Best effort, as drivers publish, but deep: all vehicles' messages of an epoch come at once, and
# none must be lost while the receiver computes. Memory is only taken for what waits.
SENSOR_DATA = QoSProfile(
    reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=1000,
)
RELIABLE = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=1000,
)
# Reliable and transient local: who comes later still gets the last message.
LATCHED = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST, depth=1,
)
# For subscriptions: each of many publishers may have latched its message.
LATCHED_INPUT = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST, depth=1000,
)

_BURST = 100  # messages
_PAUSE = 0.01  # s


def publish_all(burst: Iterable[tuple[Publisher, bytes]]) -> None:
    """
    Publish a burst, with pauses in which others take it.

    Shared memory between processes holds 512 messages and half a megabyte; what is more is lost
    unless the receivers get to run.
    """
    for number, (publisher, data) in enumerate(burst, start=1):
        publisher.publish(data)
        if number % _BURST == 0:
            time.sleep(_PAUSE)


def topic_filter(parameter: str, patterns: Iterable[str]) -> Callable[[str], bool]:
    """
    Return what tells whether a topic is named by one of the patterns.

    Parameters
    ----------
    parameter
        Where they come from, for the error.
    patterns
        Topics, or regular expressions that match whole ones; the leading slash may be left out.

    Raises
    ------
    ConfigError
        If one is no regular expression.

    """
    expressions = compiled(parameter, patterns)
    return lambda topic: any(
        expression.fullmatch(topic) or expression.fullmatch(topic, 1) for expression in expressions
    )


def message_class(kind: str) -> Any:
    """
    Return the Python class of a message type.

    Raises
    ------
    MessageError
        If the type is not installed.

    """
    package, _, name = kind.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError, TypeError, ValueError):
        raise MessageError(f'message type {kind} is not installed') from None


def is_received(publisher: Publisher) -> bool:
    """Tell whether all reliable subscriptions have, or get soon, what was published."""
    return bool(publisher.wait_for_all_acked(Duration(seconds=PATIENCE)))
