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
from collections.abc import Callable, Sequence
from contextlib import closing
import math
import sys
import time
from typing import Any, ClassVar

from rclpy.experimental.events_executor import EventsExecutor
import rclpy.node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.utilities import remove_ros_args
from tsmcl_ros import messages
from tsmcl_ros.config import Config, parameters
from tsmcl_ros.nodes.parameters import declare
from tsmcl_ros.nodes.process import asked_to_stop, Misuse, PATIENCE, plainly, session, Stopped
from tsmcl_ros.nodes.recurring import Recurring
from tsmcl_ros.nodes.rejections import Rejections
from tsmcl_ros.nodes.wire import message_class, SENSOR_DATA
from tsmcl_ros.types import ConfigError, MessageError, TsmclError

# A subscription that a publisher has found may not have found the publisher yet, and nothing
# tells when it has.
SETTLING = 1.0  # s


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
        with plainly(ConfigError):
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
        self._recurring: list[Recurring] = []
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
        recurring = Recurring(period, act)
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
            wait = min(PATIENCE, max(left, 0.0))
            if not self.follows_clock:
                now = time.time()
                wait = min([wait, *(recurring.next - now for recurring in self._recurring)])
            self._events.spin_once(timeout_sec=max(wait, 0.0))
            self._raise_failure()
            if asked_to_stop.is_set():
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
