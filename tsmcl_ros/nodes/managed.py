"""
Nodes with a managed life cycle, as Nav2's are: unconfigured, inactive, active, finalized.

Publications are held back but where a node is active, and whatever a node creates while it is
configured is destroyed as it is cleaned up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
import traceback
from typing import Any, ClassVar

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from tsmcl_ros.config import Config, param
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.types import TsmclError

_SUCCESS, _FAILURE, _ERROR = (
    TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR)


@dataclass(frozen=True)
class LifecycleConfig(Config):
    """How a managed node starts."""

    autostart: bool = param(
        True, 'become active at start; if not, wait for the transitions configure and activate')


class ManagedNode(LifecycleNodeMixin, runtime.Node):  # type: ignore[misc]
    """
    A node that is configured, activated, deactivated and cleaned up on request.

    Subclasses create what they need in `set_up`, among `configs` have LifecycleConfig, and may
    override `begin`, which is called whenever the node becomes active.

    Raises
    ------
    ConfigError
        If it starts by itself and its parameters do not allow it. Otherwise the transition fails,
        and the reason is logged.

    """

    configs: ClassVar[tuple[type[Config], ...]] = (LifecycleConfig,)

    def __init__(self) -> None:
        runtime.Node.__init__(self)
        LifecycleNodeMixin.__init__(self)
        # rclpy raises where a state does not know a transition.
        self.outlive(self._service_change_state)
        self._lasting = set(self._entities())
        self._obstacle: Exception | None = None
        self._starts = bool(self.settings['autostart'])
        if self._starts:
            for transition in (self.trigger_configure, self.trigger_activate):
                transition()
                if self._obstacle is not None:
                    self.close()
                    raise self._obstacle
        self._starts = False

    @property
    def state(self) -> str:
        """Label of the state: unconfigured, inactive, active, finalized, or one in between."""
        # rclpy offers no other way to see it from within.
        return str(self._state_machine.current_state[1])

    def fixed(self) -> str:
        """Return why parameters that are not adjustable cannot be set now, '' if they can."""
        return '' if self.state == 'unconfigured' else (
            f'while the node is {self.state}: set it after cleanup and before configure, or '
            'restart the node with it')

    def set_up(self) -> None:
        """Read the settings, and create what depends on them; raise TsmclError if that fails."""
        raise NotImplementedError

    def begin(self) -> None:
        """Take note of becoming active."""

    def talk(self, topic: str, kind: str, qos: QoSProfile) -> Publisher:
        """Return a publisher of serialized messages, which is silent unless the node is active."""
        publisher = self.create_lifecycle_publisher(wire.message_class(kind), topic, qos)
        if self.state == 'active':
            publisher.on_activate(None)
        return publisher

    def run(self) -> None:
        """Handle messages until the node is shut down."""
        self.spin(lambda: self.state == 'finalized')
        # The answer to who asked for that is on its way still.
        self.settle()

    def close(self) -> None:
        """Let go of everything, and of the state's publisher, which rclpy forgets."""
        super().close()
        self._state_machine.destroy_when_not_in_use()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let `set_up` create things; take them back if it fails."""
        self._lasting = set(self._entities())
        result = self._attempt(self.set_up)
        if result != _SUCCESS:
            self._tear_down()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let publications pass."""
        result = self._attempt(self.begin)
        if result != _SUCCESS:
            return result
        self.get_logger().info('active')
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Hold publications back."""
        self.get_logger().info('inactive')
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy what `set_up` has created."""
        self._tear_down()
        self.get_logger().info('unconfigured')
        return _SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let `run` end."""
        self.get_logger().info('shut down')
        return _SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to where one can be configured, after an error in the code."""
        self._tear_down()
        return _SUCCESS

    def _attempt(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        """Do something, and tell rclpy of exceptions, which it would swallow."""
        try:
            act()
        except Exception as error:
            self._obstacle = error
            known = isinstance(error, TsmclError)
            if not self._starts:
                self.get_logger().error(str(error) if known else traceback.format_exc())
            return _FAILURE if known else _ERROR
        return _SUCCESS

    def _entities(self) -> Iterator[Any]:
        yield from self.publishers
        yield from self.subscriptions
        yield from self.services
        yield from self.timers

    def _tear_down(self) -> None:
        destroyers = (self.destroy_lifecycle_publisher, self.destroy_subscription,
                      self.destroy_service, self.destroy_timer)
        for entity in set(self._entities()) - self._lasting:
            # Each knows its own, and says so.
            any(destroy(entity) for destroy in destroyers)
