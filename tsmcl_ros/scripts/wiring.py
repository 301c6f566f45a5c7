"""Which of a bag's topics a localizer listens to, and which go into the new bag, as what."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import re

from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.topics import absolute, compiled, few, match_topic, of_kinds
from tsmcl_ros.types import BagError, ConfigError, Odometry

# Carried over to the new bag, so that it can be evaluated by itself.
_CONTEXT = {
    'anchor_map': messages.POINT_CLOUD,
    'anchor_links': messages.POINT_CLOUD,
    'beacons': messages.POINT_CLOUD,
    'ground_truth': messages.ODOMETRY,
}
_LISTENED = ('beacons', 'odom', 'initialpose', 'ground_truth')
_COMMON = ('/anchor_map', '/anchor_links')


def as_it_is(data: bytes) -> bytes:
    """Return a message unchanged."""
    return data


@dataclass(frozen=True)
class Copy:
    """What a topic of the old bag becomes in the new one."""

    topic: str
    type: str
    convert: Callable[[bytes], bytes] = as_it_is


class Remapping:
    """
    Topics that stand for others, by rules FROM:=TO as ROS writes them.

    Parameters
    ----------
    rules : sequence of str
        A relative name on either side is one in every vehicle's namespace.

    Raises
    ------
    ConfigError
        If one is no rule, nothing listens to its topic, or the topic comes twice.

    """

    def __init__(self, rules: Sequence[str]) -> None:
        self._rules: dict[str, str] = {}
        for rule in rules:
            name, separator, target = rule.partition(':=')
            if not separator or not target or name not in (*_LISTENED, *_COMMON):
                raise ConfigError(
                    f'remap: {rule!r} is not allowed, must be FROM:=TO with FROM one of '
                    f'{", ".join((*_LISTENED, *_COMMON))}')
            if name in self._rules:
                raise ConfigError(f'remap: {name} comes twice, must come once')
            self._rules[name] = target

    def of(self, topic: str, namespace: str) -> str | None:
        """Return the topic of a bag that stands for a vehicle's, None if a rule names none."""
        name = topic if topic in _COMMON else topic.rpartition('/')[2]
        target = self._rules.get(name)
        return None if target is None else absolute(target, namespace)

    def silent(self, reader: Reader, namespaces: Iterable[str]) -> list[str]:
        """
        Return a line for each topic that the bag has without messages.

        Raises
        ------
        BagError
            If the bag does not have one.

        """
        lines = []
        for namespace in namespaces:
            for name, target in self._rules.items():
                topic = absolute(target, namespace)
                if topic not in reader.topics:
                    raise BagError(
                        f'{reader.path}: has no topic {topic}, which {name} is remapped to; has '
                        f'{few(sorted(reader.topics), 60)}')
                if not reader.counts[topic]:
                    lines.append(f'{topic}, which {name} is remapped to, has no messages')
        return lines


def wire(endpoint: Endpoint, names: Sequence[str], remapping: Remapping, reader: Reader
         ) -> dict[str, list[tuple[str, Callable[[bytes], None]]]]:
    """
    Return types and handlers of each topic of the bag that the endpoint listens to.

    Raises
    ------
    BagError
        If there is nothing to locate a vehicle by.

    """
    topics = reader.topics
    ranges = endpoint.ranges.discover(topics)
    wires: dict[str, list[tuple[str, Callable[[bytes], None]]]] = defaultdict(list)
    heard = {topic for topic, (kind, _) in ranges.items() if kind == messages.RANGE}
    homes = {absolute(name, home): home for home in names for name in _LISTENED}
    for topic, taker in endpoint.inputs.items():
        source = remapping.of(topic, homes.get(topic, '/')) or topic
        if source in topics:
            wires[source].append(taker)
            if topic.endswith('/beacons'):
                heard.add(source)
    for topic, taker in ranges.items():
        wires[topic].append(taker)
    if not heard:
        missing = endpoint.ranges.unmet(topics) or [
            f'has no topic {absolute("beacons", name)}' for name in names]
        raise BagError(f'{reader.path}: {"; ".join(missing)}')
    if not any(reader.counts[topic] for topic in heard):
        raise BagError(f'{reader.path}: has no message on {few(sorted(heard))}')
    return dict(wires)


def copies(names: Iterable[str], remapping: Remapping, topics: Mapping[str, str]
           ) -> dict[str, list[Copy]]:
    """
    Return what becomes of each topic that an evaluation needs.

    Raises
    ------
    BagError
        If what ground truth is remapped to holds no poses.

    """
    kept: dict[str, list[Copy]] = {
        topic: [Copy(topic, kind)] for topic, kind in topics.items()
        if _CONTEXT.get(topic.rpartition('/')[2]) == kind}
    for name in names:
        truth = absolute('ground_truth', name)
        source = remapping.of(truth, name)
        if source is None or source == truth:
            continue
        kind = topics[source]
        if kind not in messages.POSES:
            raise BagError(
                f'ground_truth: topic {source} has type {kind}, must have one of '
                f'{", ".join(messages.POSES)}')
        kept.pop(truth, None)
        kept.setdefault(source, []).append(Copy(truth, messages.ODOMETRY, _truth_of(kind)))
    return kept


def vehicles(reader: Reader, inputs: InputConfig) -> list[str]:
    """
    Return the namespaces that have beacons or ranges, in the order of their numbers.

    Topics of ranges that are named from the root belong to the root's one vehicle.

    Raises
    ------
    BagError
        If there are none.

    """
    topics = [
        topic for topic, kind in reader.topics.items()
        if topic.endswith('/beacons') and topic != '/beacons' and kind == messages.POINT_CLOUD]
    names = {topic.removesuffix('/beacons') for topic in topics}
    patterns = compiled('ranges', inputs.ranges)
    names |= {
        home for topic in of_kinds(reader.topics, [messages.RANGE])
        for pattern in patterns if (home := _home(pattern, topic))}
    if patterns and not names:
        return ['/']
    if not names:
        ranges = of_kinds(reader.topics, [messages.RANGE])
        raise BagError(
            f'{reader.path}: has no topic NAMESPACE/beacons of type {messages.POINT_CLOUD}, '
            + (f'but of type {messages.RANGE}, {few(ranges)}: name in ranges which to use'
               if ranges else f'has {few(sorted(reader.topics))}'))
    if not patterns and not any(reader.counts[topic] for topic in topics):
        raise BagError(f'{reader.path}: has no message on {", ".join(sorted(topics))}')
    return sorted(names, key=lambda name: [
        int(part) if part.isdigit() else part for part in re.split(r'(\d+)', name)])


def _home(pattern: re.Pattern[str], topic: str) -> str | None:
    """Return the shortest namespace in which a pattern matches a topic."""
    homes = [topic[:at] or '/' for at, letter in enumerate(topic) if letter == '/']
    return next((home for home in homes if match_topic(pattern, topic, home)), None)


def _truth_of(kind: str) -> Callable[[bytes], bytes]:
    if kind == messages.ODOMETRY:
        return as_it_is

    def convert(data: bytes) -> bytes:
        pose = messages.decode_any_pose(kind, data)
        return messages.encode_odometry(
            Odometry(pose.stamp, pose.position, pose.yaw), pose.frame_id, 'base_link')

    return convert
