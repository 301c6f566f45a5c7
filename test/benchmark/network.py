"""What a fleet sends over the network, counted on the wires between three hosts."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
from typing import NamedTuple

from goals import Section

sys.path.append(str(Path(__file__).parents[1] / 'nodes'))
from hosts import discovery_server, Host, network, Refused  # noqa: E402, I100

VEHICLES, ANCHORS = 40, 16
EPOCHS = 100  # counted once all have found each other
RECORDED = {'poses': ['/veh_.*/pose'], 'everything': []}


class Sent(NamedTuple):
    """Bytes that left all hosts till all had found each other, and that two sent since [B]."""

    before: int
    vehicles: int
    recorder: int


def measure() -> Section:
    """Count bytes as they leave each host, with the headers of Ethernet, IP, UDP and RTPS."""
    rows = [['recorded on the third host', 'vehicles to recorder [B]',
             'recorder to vehicles [B]', 'all hosts, to find each other [MB]']]
    try:
        for name, topics in RECORDED.items():
            sent = _sent(topics)
            rows.append([name, *(f'{each / EPOCHS / VEHICLES:.0f}'
                                 for each in (sent.vehicles, sent.recorder)),
                         f'{sent.before / 1e6:.1f}'])
    except Refused as refused:
        return Section(TITLE, f'Not measured, this machine lets nobody make hosts: {refused}.')
    return Section(TITLE, TEXT, [rows])


TITLE = 'Network: bytes for each vehicle and epoch'
TEXT = (f'{ANCHORS} anchors, {VEHICLES} vehicles and a recorder on three hosts, found through a '
        'discovery server; counted on their interfaces, with all headers. See '
        '[fleets across hosts](hosts.md).')


def _sent(topics: list[str]) -> Sent:
    """Count what is sent in a simulation."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        roadside, site, office = hosts = stack.enter_context(network(3, folder))
        server = stack.enter_context(discovery_server(roadside))

        def start(host: Host, node: str, **settings: object) -> subprocess.Popen[str]:
            words = [word for name, value in settings.items()
                     for word in ('-p', f'{name}:={value}')]
            process = subprocess.Popen(
                [*host.node(server), sys.executable, '-m', f'tsmcl_ros.nodes.{node}',
                 '--ros-args', *words], text=True, stderr=subprocess.PIPE)
            stack.callback(process.communicate)
            stack.callback(process.send_signal, signal.SIGINT)
            return process

        chosen = {'topics': topics} if topics else {}
        start(office, 'recorder', output=folder / 'bag', use_sim_time=True, **chosen)
        start(site, 'fleet', vehicles=VEHICLES, use_sim_time=True)
        simulator = start(site, 'simulator', vehicles=VEHICLES, duration=float(EPOCHS), rate=10.0,
                          beacon_timeout=20.0, wait_for=1 if topics else 2)
        start(roadside, 'anchor', use_sim_time=True)
        while 'under way' not in (line := simulator.stderr.readline()):
            if not line:
                raise RuntimeError('the simulator ended before it had begun')
        begin = [host.sent() for host in hosts]
        simulator.wait()
        since = [host.sent() - count for host, count in zip(hosts, begin, strict=True)]
        return Sent(sum(begin), *since[1:])
