"""Messages by their types."""

from __future__ import annotations

import pytest
from tsmcl_ros.nodes.wire import message_class
from tsmcl_ros.types import MessageError


def test_message_classes_are_found_by_the_name_of_their_type() -> None:
    assert message_class('nav_msgs/msg/Odometry').__name__ == 'Odometry'


@pytest.mark.parametrize('kind', ['nav_msgs/msg/Nothing', 'no_msgs/msg/Odometry', 'nonsense', ''])
def test_a_message_type_that_is_not_installed_is_named(kind: str) -> None:
    with pytest.raises(MessageError, match=f'message type {kind} is not installed'):
        message_class(kind)
