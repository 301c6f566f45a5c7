"""Asking other nodes for their parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

# What rclpy declares for itself.
_UNASKED = ('qos_overrides.', 'start_type_description_service')


class Inquiry:
    """
    Asks nodes for their parameters, once each; answers come while the asking node spins.

    Parameters
    ----------
    node
        Who asks.
    heed
        Takes a node's full name, and its parameters by name.
    """

    def __init__(self, node: Node, heed: Callable[[str, dict[str, Any]], None]) -> None:
        self._node = node
        self._heed = heed
        self._asked: set[str] = set()
        self._waiting: list[tuple[Client, Any, Callable[[Any], None]]] = []

    def ask(self, name: str) -> None:
        """Ask a node of that full name, unless it has been asked."""
        if name not in self._asked:
            self._asked.add(name)
            self._request(name, ListParameters, ListParameters.Request(),
                          lambda answer: self._ask_values(name, answer.result.names))

    def go_on(self) -> None:
        """Send what waits for services that have been found by now."""
        waiting, self._waiting = self._waiting, []
        for client, request, take in waiting:
            if client.service_is_ready():
                client.call_async(request).add_done_callback(self._finish(client, take))
            else:
                self._waiting.append((client, request, take))

    def _ask_values(self, name: str, names: list[str]) -> None:
        wanted = [each for each in names if not each.startswith(_UNASKED)]

        def take(answer: Any) -> None:
            values = map(parameter_value_to_python, answer.values)
            self._heed(name, dict(zip(wanted, values, strict=False)))

        self._request(name, GetParameters, GetParameters.Request(names=wanted), take)

    def _request(self, name: str, kind: Any, request: Any, take: Callable[[Any], None]) -> None:
        service = 'list_parameters' if kind is ListParameters else 'get_parameters'
        client = self._node.create_client(kind, f'{name}/{service}')
        self._waiting.append((client, request, take))

    def _finish(self, client: Client, take: Callable[[Any], None]) -> Callable[[Any], None]:
        def finish(future: Any) -> None:
            if future.exception() is None:
                take(future.result())
            self._node.destroy_client(client)

        return finish
