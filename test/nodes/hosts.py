"""Hosts without machines: namespaces of Linux, each on a subnet of its own, about a router."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack
import os
from pathlib import Path
import shutil
import subprocess
import sys
from types import TracebackType

UNSHARE = ('unshare', '--net', '--mount', '--ipc')
# What hosts must not share: DDS would leave the network for the memory.
SETUP = 'mount -t tmpfs tmpfs /dev/shm && ip link set lo up && echo ready && exec cat'
PORT = 11811


class Refused(Exception):
    """This machine does not let us have namespaces."""


class Host:
    """
    A network stack, a shared memory and an IPC of their own; a context manager.

    The process that holds them ends with its standard input: when whoever made it ends, however
    it does, and nothing is left of them then.

    Parameters
    ----------
    command : sequence of str
        Makes the namespaces and runs the rest of its arguments in them.
    folder : Path
        Where commands run.
    address : str
        On the way to the other hosts.

    """

    def __init__(self, command: Sequence[str], folder: Path, address: str = '') -> None:
        self.address = address
        self.link: tuple[Host, str] | None = None  # the router, and what it calls the way here
        try:
            self._holder = subprocess.Popen(
                [*command, 'sh', '-c', SETUP], cwd=folder, text=True, stdin=subprocess.PIPE,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        except FileNotFoundError as error:
            raise Refused(f'{error.filename} is not installed') from None
        self.pid = str(self._holder.pid)
        self.inside = ('nsenter', '--target', self.pid, '--user', '--preserve-credentials',
                       '--net', '--mount', '--ipc', '--wd')
        if self._holder.stdout.readline() != 'ready\n':
            raise Refused(self._holder.communicate()[1].strip())

    def __enter__(self) -> Host:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self._holder.communicate()

    def run(self, command: str) -> str:
        """Run a command of the shell there and return what it says."""
        done = subprocess.run([*self.inside, 'sh', '-c', command], capture_output=True, text=True)
        if done.returncode:
            raise Refused(f'{command}: {done.stderr.strip()}')
        return done.stdout

    @contextmanager
    def cut(self) -> Iterator[None]:
        """Cut the link to all other hosts, at the router, which nobody there is told of."""
        router, name = self.link
        router.run(f'ip link set {name} down')
        try:
            yield
        finally:
            router.run(f'ip link set {name} up')

    def sent(self) -> int:
        """Return how many bytes have left for other hosts, with all headers."""
        for line in self.run('cat /proc/self/net/dev').splitlines():
            name, _, counts = line.partition(':')
            if name.strip() == 'eth0':
                return int(counts.split()[8])
        raise AssertionError('a host without eth0')

    def node(self, server: str = '') -> list[str]:
        """Return what precedes the command line of a node there, which is to ask a server."""
        settings = ['ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET']
        if server:
            # Who looks for topics, as a recorder does, has to be told of all.
            settings += [f'ROS_DISCOVERY_SERVER={server}', 'ROS_SUPER_CLIENT=TRUE']
        return [*self.inside, 'env', *settings]


@contextmanager
def network(hosts: int, folder: Path) -> Iterator[list[Host]]:
    """
    Make hosts about a router, which passes on no multicast.

    Raises
    ------
    Refused
        If this machine does not let us.

    """
    with ExitStack() as stack:
        router = stack.enter_context(Host([*UNSHARE, '--user', '--map-root-user'], folder))
        router.run('echo 1 > /proc/sys/net/ipv4/ip_forward')
        made = []
        for number in range(1, hosts + 1):
            subnet = f'10.77.{number}'
            host = stack.enter_context(Host([*router.inside, *UNSHARE], folder, f'{subnet}.2'))
            router.run(f'ip link add to{number} type veth peer name eth0 netns {host.pid} && '
                       f'ip address add {subnet}.1/24 dev to{number} && '
                       f'ip link set to{number} up')
            host.run(f'ip address add {subnet}.2/24 dev eth0 && ip link set eth0 up && '
                     f'ip route add default via {subnet}.1')
            host.link = router, f'to{number}'
            made.append(host)
        yield made


@contextmanager
def discovery_server(host: Host) -> Iterator[str]:
    """Run a discovery server of Fast DDS on a host, and return its address, once it runs."""
    binary = shutil.which('fast-discovery-server', path=os.pathsep.join(
        [str(Path(sys.executable).parent), os.environ.get('PATH', '')]))
    if binary is None:
        raise Refused('fast-discovery-server is not installed')
    prefix = Path(sys.prefix)
    libraries = [os.environ.get('LD_LIBRARY_PATH', ''), str(prefix / 'lib'),
                 *map(str, prefix.glob('lib/python3*/site-packages/*.libs'))]
    process = subprocess.Popen(
        [*host.inside, 'env', f'LD_LIBRARY_PATH={os.pathsep.join(filter(None, libraries))}',
         binary, '-i', '0', '-l', host.address, '-p', str(PORT)],
        text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    try:
        said = ''
        while 'Server is running' not in said:
            line = process.stdout.readline()
            if not line:
                raise Refused(f'fast-discovery-server ended: {said}')
            said += line
        yield f'{host.address}:{PORT}'
    finally:
        process.kill()
        process.communicate()
