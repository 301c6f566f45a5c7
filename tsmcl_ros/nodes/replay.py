"""Playing a bag over DDS, byte for byte."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
import sys

from rclpy.publisher import Publisher
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.config import build, Config, param
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.types import BagError, ConfigError, MessageError

_CLOCK_PERIOD = 0.01  # s of real time, between two messages of /clock
_AFTERWARDS = 1.0  # s of the bag's time, that the clock goes on for those who wait


@dataclass(frozen=True)
class ReplayConfig(Config):
    """What is played, and how."""

    bag: str = param('', 'folder of the bag')
    rate: float = param(1.0, "the bag's time against real time", above=0, high=1e4)
    start: float = param(0.0, 'where in the bag to begin', unit='s', low=0)
    loop: bool = param(False, 'begin anew at the end')
    topics: tuple[str, ...] = param(
        (), 'topics, or regular expressions that match whole ones; none for all')
    exclude: tuple[str, ...] = param(
        (f'.*/pose {messages.POSE}', '.*/(particle_cloud|markers)',
         '/(diagnostics|parameter_events|rosout)'),
        'topics to leave out, named as in topics, or by name and type; by default what a live '
        'localizer publishes itself')
    wait_for: tuple[str, ...] = param(
        (), 'topics that must have a subscription before it begins; none for any of those played')
    wait: float = param(10.0, 'longest wait for these subscriptions, in real time', unit='s',
                        low=0)


class Replay(runtime.Node):
    """
    Replay: plays a bag with /clock, for nodes that run with use_sim_time.

    The clock shows the bag's log time; messages keep the stamps that they were recorded with.
    Latched topics come first, and are received before the others begin.
    """

    default_name = 'replay'
    configs = (ReplayConfig,)
    adjustable = ('rate',)

    def __init__(self) -> None:
        super().__init__()
        self._config = build(ReplayConfig, self.settings)
        if not self._config.bag:
            raise ConfigError("bag: '' is not allowed, must be the folder of a bag")
        self._bag = Reader(self._config.bag)
        self._begin = self._bag.start + self._config.start
        if self._config.start > self._bag.duration:
            raise ConfigError(
                f'start: {self._config.start:g} s is not allowed, must be at most the '
                f"bag's duration, {self._bag.duration:g} s"
            )
        self._played = self._offer()
        if not self._played:
            found = ', '.join(sorted(self._bag.topics))
            raise BagError(f'{self._bag.path}: has no topic to play, has {found}')
        self._clock_out = self.talk('/clock', messages.CLOCK, wire.RELIABLE)
        self._position = self._shown = self._begin
        self.get_logger().info(
            f'{len(self._played)} topics, {self._bag.duration - self._config.start:.1f} s')

    def run(self) -> None:
        """Play the bag, once or for ever."""
        self._wait_for_subscriptions()
        self._play()
        while self._config.loop:
            self.get_logger().info('begins anew')
            self._play()
        self._wait_until_received(self._played)
        self.get_logger().info('the bag is over')

    def close(self) -> None:
        """Close the bag too."""
        self._bag.close()
        super().close()

    def _selected(self) -> list[str]:
        """Return the topics that the user wants to be played."""
        is_named = wire.topic_filter('topics', self._config.topics or ('.*',))
        is_excluded = wire.topic_filter('exclude', self._config.exclude)
        return sorted(
            topic for topic in self._bag.topics
            if topic != '/clock' and is_named(topic)
            and not is_excluded(topic) and not is_excluded(f'{topic} {self._bag.topics[topic]}')
        )

    def _offer(self) -> dict[str, Publisher]:
        """Return a publisher a topic, naming each type once that is not installed."""
        found: dict[str, Publisher] = {}
        failed: dict[str, list[str]] = {}
        for topic in self._selected():
            # One that all kinds of subscriptions match.
            qos = wire.LATCHED_INPUT if topic in self._bag.latched else wire.RELIABLE
            try:
                found[topic] = self.talk(topic, self._bag.topics[topic], qos)
            except MessageError as error:
                failed.setdefault(str(error), []).append(topic)
        for reason, topics in failed.items():
            verb = 'is' if len(topics) == 1 else 'are'
            self.get_logger().warning(f'{", ".join(topics)} {verb} not played: {reason}')
        return found

    def _wait_for_subscriptions(self) -> None:
        """Wait for those that are asked for, or for any; begin without them after a while."""
        is_awaited = wire.topic_filter('wait_for', self._config.wait_for or ('.*',))
        awaited = [topic for topic in self._played if is_awaited(topic)]
        enough = all if self._config.wait_for else any

        def missing() -> list[str]:
            return [topic for topic in awaited
                    if not self._played[topic].get_subscription_count()]

        found = self.spin(
            lambda: enough(topic not in missing() for topic in awaited), self._config.wait)
        if found:
            self.settle()
        else:
            self.get_logger().warning(f'nobody listens to {", ".join(missing())}')

    def _play(self) -> None:
        """Play the bag once."""
        self._position = self._shown = self._begin
        self._show(self._begin)
        self._latch()
        pace = runtime.Pace(self)
        wire.publish_all(self._messages(pace))
        self._advance(self._position + _AFTERWARDS + 2 * self._clock_step(), pace)

    def _messages(self, pace: runtime.Pace) -> Iterator[tuple[Publisher, bytes]]:
        """Yield each message that has not been latched, and its publisher, when it is time."""
        for message in self._bag.messages(self._played):
            is_sent = message.topic in self._bag.latched and message.stamp <= self._begin
            if message.stamp >= self._begin and not is_sent:
                self._advance(message.stamp, pace)
                yield self._played[message.topic], message.data

    def _latch(self) -> None:
        """Publish what had been latched when the replay begins, and have it received."""
        latched = {
            topic: publisher for topic, publisher in self._played.items()
            if topic in self._bag.latched
        }
        if latched:
            for message in self._bag.messages(latched):
                if message.stamp > self._begin:
                    break
                latched[message.topic].publish(message.data)
            self._wait_until_received(latched)

    def _wait_until_received(self, publishers: dict[str, Publisher]) -> None:
        for topic, publisher in publishers.items():
            if not self.spin(partial(wire.is_received, publisher), self._config.wait):
                self.get_logger().warning(f'{topic} is not received by all who listen')

    def _advance(self, stamp: float, pace: runtime.Pace) -> None:
        """Let the bag's time pass until a stamp [s]; the clock is never ahead of the messages."""
        while self._position < stamp:
            next_shown = self._shown + self._clock_step()
            until = min(stamp, next_shown)
            pace.wait((until - self._position) / self.settings['rate'])
            self._position = until
            if until == next_shown:
                self._show(until)

    def _clock_step(self) -> float:
        """Return how far the clock is advanced at once, in the bag's time [s]."""
        return float(_CLOCK_PERIOD * self.settings['rate'])

    def _show(self, stamp: float) -> None:
        self._shown = stamp
        self._clock_out.publish(messages.encode_clock(stamp))


def main() -> int:
    """Run the node and return the exit code."""
    return runtime.main(Replay)


if __name__ == '__main__':
    sys.exit(main())
