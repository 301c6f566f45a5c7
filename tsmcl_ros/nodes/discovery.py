"""Topics that are named by patterns, subscribed to as they appear."""

from __future__ import annotations

from collections.abc import Callable
import time

from tsmcl_ros.inputs import RangeInput, unplaced_note
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.types import MessageError

PERIOD = 0.2  # s, real time, between two looks for new topics
_PATIENCE = 5.0  # s, real time, after which what is missing is told
_ENOUGH = 10  # ranges of a sender that are left out, after which it is told


class Discovery:
    """
    Subscribes a node to ranges and references as they appear, and warns once of what is amiss.

    Parameters
    ----------
    node : Node
        Who listens.
    ranges : RangeInput
        What to.
    heed : callable
        Takes a handler and the message that it is for.

    """

    def __init__(self, node: runtime.Node, ranges: RangeInput,
                 heed: Callable[[Callable[[bytes], None], bytes], None]) -> None:
        self._node, self._ranges, self._heed = node, ranges, heed
        self._begin = time.monotonic()
        self._has_told = False
        self._told: set[int] = set()

    def look(self) -> None:
        """Subscribe to what is new, and tell of what has been missing for a while."""
        topics = {
            topic: kinds[0] for topic, kinds in self._node.get_topic_names_and_types()}
        namespace = self._node.get_namespace()
        for topic, (kind, handler) in self._ranges.discover(topics, namespace).items():
            self._listen(topic, kind, handler)
        if time.monotonic() - self._begin > _PATIENCE and not self._has_told:
            self._has_told = True
            published = {topic: kind for topic, kind in topics.items()
                         if self._node.get_publishers_info_by_topic(topic)}
            for line in self._ranges.unmet(published, namespace):
                self._node.get_logger().warning(f'{line}; still looking')
        news = {sender: count for sender, count in self._ranges.unplaced.items()
                if count >= _ENOUGH and sender not in self._told}
        if news:
            self._told.update(news)
            self._node.get_logger().warning(unplaced_note(news))

    def _listen(self, topic: str, kind: str, handler: Callable[[bytes], None]) -> None:
        try:
            self._node.listen(
                topic, kind, lambda data: self._heed(handler, data), wire.SENSOR_DATA)
        except MessageError as error:
            self._node.get_logger().warning(f'{topic} is not listened to: {error}')
