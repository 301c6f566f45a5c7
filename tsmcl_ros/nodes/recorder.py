"""Recording of topics into a rosbag2, byte for byte."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import sys
import time

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from tsmcl_ros.bag import STORAGES, Writer
from tsmcl_ros.config import build, Config, dump_yaml, param
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.repair import repair
from tsmcl_ros.scripts.cli import command_line, run_script
from tsmcl_ros.types import BagError, ConfigError, MessageError

# Time of a replay is its own, and the rest is ROS talking to itself.
_UNASKED = ('/clock', '/parameter_events', '/rosout')
_DISCOVERY = 0.1  # s, between two looks for new topics
_SAVING = 0.5  # s, between two times that all is put on disk
_QUIET = 0.2  # s, after which nothing is on its way any more, on a machine under load


@dataclass(frozen=True)
class RecorderConfig(Config):
    """What is recorded, and where to."""

    output: str = param('', 'folder of the new bag')
    storage: str = param('mcap', 'format of the bag', choices=STORAGES)
    topics: tuple[str, ...] = param(
        (), 'topics, or regular expressions that match whole ones; none for all topics but '
        + ', '.join(_UNASKED))
    exclude: tuple[str, ...] = param((), 'topics to leave out, named as in topics')
    duration: float = param(0.0, 'time after which it ends, of /clock with use_sim_time, '
                            '0 for never', unit='s', low=0)


class Recorder(runtime.Node):
    """
    Recorder: writes a rosbag2 of topics as they come, discovering new ones.

    A message's log time is when it arrived: by /clock with use_sim_time, so that a bag of an
    accelerated simulation plays at the simulation's pace, else by the wall clock. All that came
    is on disk half a second later: `recorder --repair BAG` makes a bag of it if the recording is
    cut short.
    """

    default_name = 'recorder'
    configs = (RecorderConfig,)

    def __init__(self) -> None:
        super().__init__()
        self._config = build(RecorderConfig, self.settings)
        if not self._config.output:
            raise ConfigError("output: '' is not allowed, must be the folder of a new bag")
        self._is_named = wire.topic_filter('topics', self._config.topics)
        self._is_excluded = wire.topic_filter('exclude', self._config.exclude)
        self._seen: set[str] = set()
        # Came before the first /clock said what time it is.
        self._early: list[tuple[str, bytes]] = []
        self._counts: dict[str, int] = {}
        self._begin = math.nan
        self._bag = Writer(Path(self._config.output), self._config.storage, {
            'command': command_line(self.default_name, None),
            self.default_name: dump_yaml(self._config, commented=False),
        })
        self.get_logger().info(f'recording to {self._config.output}')

    def run(self) -> None:
        """Record until it is time, or a signal comes."""
        self._discover()
        saved = time.monotonic()
        while not self.spin(self._is_over, _DISCOVERY):
            self._discover()
            if time.monotonic() - saved >= _SAVING:
                self._bag.save()
                saved = time.monotonic()

    def close(self) -> None:
        """Write what has arrived already, and complete the bag, if the disk has not failed."""
        if self._bag.is_open:
            try:
                self.drain(_QUIET, timeout=2.0)
                self._write_early(0.0)
            finally:
                self._bag.close()
            self.get_logger().info(
                f'recorded {sum(self._counts.values())} messages of {len(self._counts)} topics to '
                f'{self._config.output}'
            )
        super().close()

    def _is_over(self) -> bool:
        if math.isnan(self._begin):
            self._begin = self.now
        return 0 < self._config.duration <= self.now - self._begin

    def _discover(self) -> None:
        """Record the topics that are new and wanted."""
        new = {}
        for topic, kinds in sorted(self.get_topic_names_and_types()):
            if topic in self._seen or not self._is_wanted(topic):
                continue
            qos = self._offered_qos(topic)
            if qos is None:
                continue
            self._seen.add(topic)
            try:
                new[topic] = kinds[0], qos, self._subscribe(topic, kinds, qos)
            except MessageError as error:
                self.get_logger().warning(f'{topic} is not recorded: {error}')
        # Only now, as it takes long, while messages come already.
        for topic, (kind, qos, subscription) in new.items():
            try:
                self._bag.topic(topic, kind, latched=qos is wire.LATCHED_INPUT)
                self._counts[topic] = 0
            except BagError as error:
                self.destroy_subscription(subscription)
                self.get_logger().warning(f'{topic} is not recorded: {error}')

    def _is_wanted(self, topic: str) -> bool:
        if self._config.topics:
            return self._is_named(topic) and not self._is_excluded(topic)
        return topic not in _UNASKED and not self._is_excluded(topic)

    def _offered_qos(self, topic: str) -> QoSProfile | None:
        """Return the strictest QoS that all present publishers meet, None if there are none."""
        offers = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        if not offers:
            return None
        if any(offer.reliability != ReliabilityPolicy.RELIABLE for offer in offers):
            return wire.SENSOR_DATA
        if any(offer.durability != DurabilityPolicy.TRANSIENT_LOCAL for offer in offers):
            return wire.RELIABLE
        return wire.LATCHED_INPUT

    def _subscribe(self, topic: str, kinds: list[str], qos: QoSProfile) -> Subscription:
        if len(kinds) > 1:
            raise MessageError(f'it has several types, {", ".join(kinds)}')
        return self.listen(topic, kinds[0], lambda data: self._take(topic, data), qos)

    def _take(self, topic: str, data: bytes) -> None:
        now = self.now
        if math.isnan(now):
            self._early.append((topic, data))
            return
        self._write_early(now)
        self._write(topic, now, data)

    def _write_early(self, stamp: float) -> None:
        for topic, data in self._early:
            self._write(topic, stamp, data)
        self._early.clear()

    def _write(self, topic: str, stamp: float, data: bytes) -> None:
        self._bag.write(topic, stamp, data)
        self._counts[topic] += 1


def main() -> int:
    """Run the node, or repair a bag, and return the exit code."""
    if '--repair' in sys.argv[1:]:
        return run_script(_repair, None)
    return runtime.main(Recorder)


def _repair(arguments: Sequence[str] | None) -> None:
    parser = argparse.ArgumentParser(
        prog=Recorder.default_name,
        description='Complete a bag whose recording was cut short, in its place.')
    parser.add_argument('--repair', metavar='BAG', required=True, help='folder of the bag')
    bag = parser.parse_args(arguments).repair
    repaired, messages, topics = repair(bag)
    done = 'repaired' if repaired else 'is complete already'
    print(f'{bag}: {done}, {messages} messages of {topics} topics')


if __name__ == '__main__':
    sys.exit(main())
