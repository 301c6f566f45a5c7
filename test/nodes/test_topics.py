"""What docs/topics.md says of each node's topics and services, held against the node."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

import pytest
from tsmcl_ros.nodes.anchor import Anchor
from tsmcl_ros.nodes.fleet import Fleet
from tsmcl_ros.nodes.localizer import LocalizerNode
from tsmcl_ros.nodes.simulator import Simulator

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'topics.md'
QOS = {'sensor data': ('BEST_EFFORT', 'VOLATILE'), 'reliable': ('RELIABLE', 'VOLATILE'),
       'latched': ('RELIABLE', 'TRANSIENT_LOCAL')}
ADAPTIVE = ('-p', 'method:=ekf', '-p', 'beacon_period:=adaptive')
# Each so set up that it has all its topics, in a namespace if names are relative.
NODES = {
    LocalizerNode: ('/veh_0', *ADAPTIVE),
    Fleet: ('', '-p', 'vehicles:=1', '-p', 'cloud_period:=1.0', *ADAPTIVE),
    Anchor: ('', '-p', 'measure_rssi:=true', '-p', 'radio_range:=1000.0'),
    Simulator: ('', '-p', 'vehicles:=1', '-p', 'cooperation:=true'),
}


def written(name: str, namespace: str) -> set[tuple[str, ...]]:
    """Return direction, name, type and QoS of each row of a node's table."""
    section = re.search(rf'^## {name}\n(.*?)^## ', PAGE.read_text(), re.MULTILINE | re.DOTALL)
    rows = re.findall(r'^\| (in|out|service) \| `(.*?)` \| (\S+) \| (.*?) ?\|', section[1],
                      re.MULTILINE)
    return {
        (way, topic.replace('_i/', '_0/') if topic[0] == '/' else f'{namespace}/{topic}', kind,
         *QOS.get(qos, ()))
        for way, topic, kind, qos in rows
    }


def declared(node: Any) -> set[tuple[str, ...]]:
    """Return the same of what a node has, without what rclpy gives to every node."""
    whose = node.get_name(), node.get_namespace()
    found = set()
    for way, named, infos in (
        ('in', node.get_subscriber_names_and_types_by_node, node.get_subscriptions_info_by_topic),
        ('out', node.get_publisher_names_and_types_by_node, node.get_publishers_info_by_topic),
        ('service', node.get_service_names_and_types_by_node, None),
    ):
        for name, (kind,) in named(*whose):
            qos = [info.qos_profile for info in infos(name)] if infos else []
            found.add((way, name, kind,
                       *(text for one in qos[:1]
                         for text in (one.reliability.name, one.durability.name))))
    own = node.get_fully_qualified_name()
    return {row for row in found
            if not row[1].startswith((f'{own}/', '/rosout', '/parameter_events'))}


@pytest.mark.parametrize('kind', NODES)
def test_the_page_of_topics_tells_what_a_node_has(ros, kind) -> None:
    namespace, *arguments = NODES[kind]
    # By a name of its own: the network may still know others by the usual one.
    ros('-r', f'__ns:={namespace or "/"}', '-r', '__node:=documented', *arguments)
    node = kind()
    try:
        assert declared(node) == written(kind.default_name, namespace)
    finally:
        node.close()
