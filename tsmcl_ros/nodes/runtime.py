"""
What all nodes share: raw messages in and out, time, and a clean end.

Three things are done otherwise than rclpy's tutorials do them, all for a reason:

- Nodes run on the EventsExecutor, which takes a quarter of the processor time, by `spin_once`:
  its `spin` delivers nothing in rclpy 7.1.6, and ignores SIGTERM.
- Signals only raise a flag, which `spin` looks at between two callbacks. rclpy's own handlers
  shut the context down at once, and whatever a callback publishes then ends in a traceback.
- What recurs with time follows /clock messages, or the wall clock, and not rclpy's timers: each
  multiple of a period is met once, with its exact stamp, however fast simulated time goes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from importlib import import_module
import math
import os
from pathlib import Path
import re
import signal
import sys
import threading
import time
from typing import Any, ClassVar
import warnings

import rclpy
from rclpy.duration import Duration
from rclpy.experimental.events_executor import EventsExecutor
import rclpy.node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from tsmcl_ros import messages
from tsmcl_ros.config import Config, parameters
from tsmcl_ros.nodes.parameters import declare
from tsmcl_ros.topics import compiled
from tsmcl_ros.types import ConfigError, MessageError, TsmclError

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

# A subscription that a publisher has found may not have found the publisher yet, and nothing
# tells when it has.
SETTLING = 1.0  # s

_PATIENCE = 0.1  # s, longest wait before a signal is looked for
_BURST = 100  # messages
_PAUSE = 0.01  # s
_ROUNDING = 1e-6  # s, more than a stamp of today loses as a float

# Where Fast DDS looks for its defaults, in Jazzy and later: users' own go before ours.
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')

# All that rcl's failure to initialize with security enforced can mean.
_NO_KEYSTORE = ('DDS security is enforced and ROS_SECURITY_KEYSTORE names no folder with the keys '
                'of this enclave, must be a keystore')

# Signals come to a process, and not to one of its objects.
_asked_to_stop = threading.Event()


class Stopped(Exception):
    """SIGINT or SIGTERM came while a node was spinning."""


class Misuse(Exception):
    """The command line makes no sense to ROS."""


class Node(rclpy.node.Node):  # type: ignore[misc]
    """
    A node that takes and gives serialized messages.

    Subclasses say their `default_name`, the `configs` that their parameters come from, and which
    of these are `adjustable` while they run; they set up in `__init__`, and may override `run`
    and `close`.

    Attributes
    ----------
    settings : dict of str to Any
        Value of each parameter by name, kept up to date.
    follows_clock : bool
        Time is that of /clock (use_sim_time), not the wall's.

    """

    default_name: ClassVar[str]
    configs: ClassVar[tuple[type[Config], ...]] = ()
    adjustable: ClassVar[tuple[str, ...]] = ()
    fixed: Callable[[], str] | None = None

    def __init__(self) -> None:
        with _plainly(ConfigError):
            super().__init__(self.default_name)
        # rclpy offers no other way to see overrides of parameters that nobody has declared.
        self.settings = declare(
            self, self._parameter_overrides, self.configs, self.adjustable, self.fixed,
            self.adjust,
        )
        for service in self.services:
            self.outlive(service)
        self._events = EventsExecutor(context=self.context)
        self._events.add_node(self)
        self._rejections = Rejections(self.get_logger().error)
        self._failure: TsmclError | None = None
        self._recurring: list[_Recurring] = []
        self.follows_clock = self.get_parameter('use_sim_time').value is True
        self._now = math.nan
        if self.follows_clock:
            self.listen('/clock', messages.CLOCK, self._take_clock, SENSOR_DATA)

    @property
    def now(self) -> float:
        """Time [s]: that of /clock if the node follows it, NaN before its first; else today's."""
        return self._now if self.follows_clock else time.time()

    def listen(
        self, topic: str, kind: str, heed: Callable[[bytes], None], qos: QoSProfile,
    ) -> Subscription:
        """
        Subscribe to the serialized messages of a topic.

        Where `heed` raises MessageError the message is rejected: an ERROR is logged, at most one
        in five seconds a topic, and the node lives on.
        """
        def receive(data: bytes) -> None:
            try:
                heed(data)
            except MessageError as error:
                self.reject(name, error)
            except TsmclError as error:
                # For `spin` to raise: the executor would write a traceback first.
                self._failure = error

        subscription = self.create_subscription(message_class(kind), topic, receive, qos, raw=True)
        name = subscription.topic_name
        return subscription

    def reject(self, whose: str, error: MessageError) -> None:
        """Log that a message was rejected, of a topic or of somebody."""
        self._rejections.add(whose, error)

    def talk(self, topic: str, kind: str, qos: QoSProfile) -> Publisher:
        """Return a publisher, which takes serialized messages as they are."""
        return self.create_publisher(message_class(kind), topic, qos)

    def outlive(self, service: Service) -> None:
        """Answer by what says no, and log why, where a service of rclpy's own would raise."""
        serve = service.callback

        def answer(request: Any, response: Any) -> Any:
            try:
                return serve(request, response)
            except Exception as error:
                self.get_logger().error(f'{service.service_name}: request rejected: {error}')
                return response

        service.callback = answer

    def every(self, period: float, act: Callable[[float], None]) -> None:
        """
        Call `act` with each multiple of the period [s] that time passes, while spinning.

        Of several that are passed at once only the last counts.
        """
        recurring = _Recurring(period, act)
        self._recurring.append(recurring)
        if not self.follows_clock:
            recurring.begin(time.time())

    def spin(
        self, until: Callable[[], bool] = lambda: False, timeout: float = math.inf,
    ) -> bool:
        """
        Handle messages until a condition holds or the timeout [s] has passed.

        Messages are handled in the order in which they come, across topics too, but for those
        that came before the first spin. The condition is looked at after every callback; a
        timeout of zero handles one event.

        Returns
        -------
        bool
            Whether the condition holds.

        Raises
        ------
        Stopped
            If the process was asked to end.
        TsmclError
            If a callback raised one that is not a mere MessageError.

        """
        end = time.monotonic() + timeout
        while not until():
            left = end - time.monotonic()
            wait = min(_PATIENCE, max(left, 0.0))
            if not self.follows_clock:
                now = time.time()
                wait = min([wait, *(recurring.next - now for recurring in self._recurring)])
            self._events.spin_once(timeout_sec=max(wait, 0.0))
            self._raise_failure()
            if _asked_to_stop.is_set():
                raise Stopped
            if not self.follows_clock:
                self.pass_time(time.time())
            self._rejections.report()
            if left <= 0:
                return until()
        return True

    def settle(self) -> None:
        """Give messages and discoveries time, where nothing tells when they have arrived."""
        self.spin(timeout=SETTLING)

    def drain(self, quiet: float, timeout: float) -> None:
        """Handle what has arrived already, until nothing came for `quiet` [s]; signals wait."""
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            begin = time.monotonic()
            self._events.spin_once(timeout_sec=quiet)
            self._raise_failure()
            if time.monotonic() - begin >= quiet:
                return

    def pass_time(self, now: float) -> None:
        """Take note of the time [s], while spinning: do what recurs."""
        for recurring in self._recurring:
            recurring.pass_time(now)

    def adjust(self) -> None:
        """Take note of settings that were changed while running."""

    def run(self) -> None:
        """Do what the node is for; here, handle messages for ever."""
        self.spin()

    def close(self) -> None:
        """Let go of everything; nothing can be sent after that."""
        self._rejections.report(at_once=True)
        self._events.shutdown()
        self.destroy_node()

    def _raise_failure(self) -> None:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _take_clock(self, data: bytes) -> None:
        self._now = messages.decode_clock(data)
        self.pass_time(self._now)


class Rejections:
    """
    Reports of rejected messages, at most one in five seconds a topic, with a count.

    Parameters
    ----------
    log
        Takes a line.
    clock
        Returns seconds that never go back.

    """

    interval = 5.0

    def __init__(
        self, log: Callable[[str], Any], clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._log = log
        self._clock = clock
        self._pending: dict[str, tuple[int, Exception]] = {}
        self._reported: dict[str, float] = {}

    def add(self, topic: str, error: Exception) -> None:
        """Count a rejected message; the first of a topic is reported at once."""
        count, _ = self._pending.get(topic, (0, error))
        self._pending[topic] = count + 1, error
        self.report()

    def report(self, at_once: bool = False) -> None:
        """Report what has waited for long enough, or everything."""
        if not self._pending:
            return
        now = self._clock()
        for topic, (count, error) in list(self._pending.items()):
            if at_once or now - self._reported.get(topic, -math.inf) >= self.interval:
                more = f' ({count} messages rejected since the last report)' if count > 1 else ''
                self._log(f'{topic}: message rejected: {error}{more}')
                self._reported[topic] = now
                del self._pending[topic]


class Pace:
    """Keeps what a node does in time with the wall clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._due = time.monotonic()

    def wait(self, seconds: float) -> None:
        """
        Spin until so many seconds after the last wait was due to end.

        A delay is made up for, unless it grows beyond a second.
        """
        now = time.monotonic()
        self._due = max(self._due + seconds, now - 1.0)
        self._node.spin(timeout=self._due - now)


@dataclass
class _Recurring:
    """Meets each multiple of a period [s] once."""

    period: float
    act: Callable[[float], None]
    count: int | None = None

    @property
    def next(self) -> float:
        """Stamp of the next multiple [s]."""
        return 0.0 if self.count is None else (self.count + 1) * self.period

    def begin(self, now: float) -> None:
        """Wait for the multiple after this time."""
        self.count = self._latest(now)

    def pass_time(self, now: float) -> None:
        """Act on the last multiple that has been reached, if it is not the one acted on."""
        count = self._latest(now)
        # The first time seen may lie anywhere between two multiples: the past one is gone.
        late = self.count is None and now - count * self.period > _ROUNDING
        if count != self.count:
            self.count = count
            if not late:
                self.act(count * self.period)

    def _latest(self, now: float) -> int:
        return math.floor((now + _ROUNDING) / self.period)


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
    return bool(publisher.wait_for_all_acked(Duration(seconds=_PATIENCE)))


def main(node_class: type[Node], arguments: Sequence[str] | None = None) -> int:
    """
    Run a node until it is done, or SIGINT or SIGTERM comes, and return the exit code.

    That is 0 after a signal, 1 after an error that the user can mend, which is shown as one line
    on standard error, and 2 where the command line makes no sense.
    """
    arguments = sys.argv if arguments is None else arguments
    name = node_class.default_name
    try:
        with session(arguments):
            _parser(node_class).parse_args(remove_ros_args(arguments)[1:])
            with closing(node_class()) as node:
                node.run()
    except Stopped:
        pass
    except Misuse as error:
        print(f'{name}: {error}', file=sys.stderr)
        return 2
    except TsmclError as error:
        print(f'{name}: {error}', file=sys.stderr)
        return 1
    return 0


@contextmanager
def session(arguments: Sequence[str] = ()) -> Iterator[None]:
    """
    Use ROS, with SIGINT and SIGTERM ending in `Stopped` while a node spins.

    However often they come: what follows, such as closing a bag, is not hurried.

    Raises
    ------
    Misuse, ConfigError
        If the arguments make no sense, or a parameter file cannot be read.

    """
    before = {
        number: signal.signal(number, lambda *_: _asked_to_stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        _init(arguments)
        yield
    finally:
        rclpy.try_shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)
        _asked_to_stop.clear()


def _init(arguments: Sequence[str]) -> None:
    if not any(name in os.environ for name in _PROFILES):
        os.environ[_PROFILES[0]] = str(Path(__file__).with_name('fastdds.xml'))
    with _plainly(Misuse):
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)


@contextmanager
def _plainly(kind: type[Exception]) -> Iterator[None]:
    """Raise what rcl complains of as an error of this kind, or as one of the configuration."""
    try:
        with warnings.catch_warnings():  # of what it could not tidy up after that
            warnings.simplefilter('ignore', RuntimeWarning)
            yield
    except RuntimeError as error:  # rclpy's own types are private
        # What went wrong, without where in its sources.
        text = re.sub(r'^failed to initialize rcl: |,? at /\S+\.c(pp)?:\d+', '',
                      ' '.join(str(error).split()))
        if text == 'error not set' and os.environ.get('ROS_SECURITY_ENABLE') == 'true':
            text, kind = _NO_KEYSTORE, ConfigError
        wrong = any(words in text for words in ('params file', 'SECURITY ERROR'))
        raise (ConfigError if wrong else kind)(text) from None


def _parser(node_class: type[Node]) -> argparse.ArgumentParser:
    """Return what answers --help, and refuses arguments that are not ROS's."""
    lines = [
        f'  {item.name}: {item.doc}{f" [{item.unit}]" if item.unit else ""}; {item.allowed} '
        f'(default: {item.default})'
        for config in node_class.configs for item in parameters(config)
    ]
    return argparse.ArgumentParser(
        prog=node_class.default_name,
        usage='%(prog)s [-h] [--ros-args -p PARAMETER:=VALUE ... --params-file FILE -r FROM:=TO]',
        description=' '.join((node_class.__doc__ or '').split()),
        epilog='\n'.join(['parameters:', *lines]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
