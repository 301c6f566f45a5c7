"""
Fixtures for all tests: real recordings, ROS of one's own, and the package's executables.

DDS is never mocked. Each pytest process, and so each xdist worker, has a ROS domain to itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
import os
from pathlib import Path
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading

from hypothesis import settings
import pytest

ROOT = Path(__file__).resolve().parent.parent
PATIENCE = 90.0  # s, for anything a healthy executable does at once, on a machine under load

# Examples are the same in every run, and may take their time where other work goes on.
settings.register_profile('tsmcl_ros', deadline=None, derandomize=True)
settings.load_profile('tsmcl_ros')

_claim: socket.socket | None = None
_ros_home: str | None = None


def pytest_configure() -> None:
    """Give this process a ROS of its own, before anything imports rclpy, and its interrupts."""
    global _ros_home
    # Shells have the processes that they start in the background ignore interrupts.
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    _ros_home = tempfile.mkdtemp(prefix='tsmcl_ros_test_')
    os.environ.update(
        ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST',
        ROS_DOMAIN_ID=str(_free_domain()),
        ROS_HOME=_ros_home,
        ROS_LOG_DIR=str(Path(_ros_home, 'log')),
        PYTHONUNBUFFERED='1',
    )
    for name in ('ROS_LOCALHOST_ONLY', 'ROS_STATIC_PEERS', 'ROS_DISCOVERY_SERVER',
                 'ROS_NAMESPACE', 'RMW_IMPLEMENTATION'):
        os.environ.pop(name, None)


def pytest_unconfigure() -> None:
    """Remove the logs."""
    if _ros_home is not None:
        shutil.rmtree(_ros_home, ignore_errors=True)


def _free_domain() -> int:
    """
    Claim a ROS domain that no other test process on this host uses.

    The claim is a name in Linux's abstract socket space: the kernel hands it out once, frees it
    however the process ends, and its scope is the network namespace, as DDS's is. Domains above
    101 have ports that the kernel gives to anybody; people choose small ones, so search downwards.
    """
    global _claim
    _claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    for domain in range(101, 0, -1):
        try:
            _claim.bind(f'\0tsmcl_ros_domain_{domain}')
        except OSError:
            continue
        return domain
    raise RuntimeError('all 101 ROS domains are claimed by running tests')


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Folder of the real recordings; $TSMCL_SHARED_DATA, or ../shared/data beside the project."""
    path = Path(os.environ.get('TSMCL_SHARED_DATA') or ROOT.parent / 'shared' / 'data')
    if not path.is_dir():
        pytest.skip(f'the recordings are not at {path}; TSMCL_SHARED_DATA can say where')
    return path


class Executable:
    """
    One of the package's executables, running as a process of its own.

    Attributes
    ----------
    process : subprocess.Popen
        The process; standard input is closed.

    """

    def __init__(self, module: str, arguments: tuple[str, ...], cwd: Path,
                 within: Sequence[str] = ()) -> None:
        self.module = module
        self.process = subprocess.Popen(
            [*within, sys.executable, '-m', f'tsmcl_ros.{module}', *arguments],
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding='utf-8',
            errors='replace',
            start_new_session=True,
        )
        self._lines: list[str] = []
        self._ended = False
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._changed:
                self._lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def output(self) -> str:
        """Return what it has written so far, standard output and error together."""
        with self._changed:
            return ''.join(self._lines)

    def wait_for(self, text: str, timeout: float = PATIENCE) -> str:
        """Return the first line that holds the text, once it has been written."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended or self._find(text), timeout)
            line = self._find(text)
            reason = 'ended' if self._ended else f'went on for {timeout:g} s'
        if line is None:
            pytest.fail(f'{self.module} {reason} without {text!r}; it wrote:\n{self.output}')
        return line.rstrip('\n')

    def _find(self, text: str) -> str | None:
        return next((line for line in self._lines if text in line), None)

    def wait(self, timeout: float = PATIENCE) -> int:
        """Return the exit code, once it has ended by itself."""
        try:
            code = self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f'{self.module} still runs after {timeout:g} s; it wrote:\n{self.output}')
        self._reader.join(timeout)
        return code

    def stop(self, how: signal.Signals = signal.SIGINT, timeout: float = PATIENCE) -> int:
        """Send it a signal and return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        return self.wait(timeout)

    def kill(self) -> None:
        """End it, and what it has started, without asking."""
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._reader.join()
        assert self.process.stdout is not None
        self.process.stdout.close()


@contextmanager
def _starting(folder: Path) -> Iterator[Callable[..., Executable]]:
    started: list[Executable] = []

    def start_one(module: str, *arguments: object, cwd: Path | None = None,
                  within: Sequence[str] = ()) -> Executable:
        executable = Executable(module, tuple(map(str, arguments)), cwd or folder, within)
        started.append(executable)
        return executable

    try:
        yield start_one
    finally:
        for executable in started:
            executable.kill()


@pytest.fixture(scope='session')
def starting() -> Callable[[Path], AbstractContextManager[Callable[..., Executable]]]:
    """Return what gives `start` in a folder for a while, for fixtures that serve several tests."""
    return _starting


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Executable]]:
    """
    Return a function that starts one of the package's executables.

    `start('nodes.localizer', '--ros-args', '-p', 'seed:=1')` runs it in the test's temporary
    folder; neither it nor what it started outlives the test. `within` precedes its command line,
    such as `env`.
    """
    with _starting(tmp_path) as start_one:
        yield start_one


@pytest.fixture
def run(start: Callable[..., Executable]) -> Callable[..., tuple[int, str]]:
    """
    Return a function that runs an executable to its end.

    `code, output = run('scripts.evaluate', bag)`
    """

    def run_one(module: str, *arguments: object, timeout: float = 240.0,
                cwd: Path | None = None) -> tuple[int, str]:
        executable = start(module, *arguments, cwd=cwd)
        return executable.wait(timeout), executable.output

    return run_one


@pytest.fixture(scope='session')
def record() -> Callable[..., Path]:
    """
    Return a function that writes a bag.

    `record(path, {'/veh_0/pose': trajectory, '/veh_0/beacons': [observation]})` records
    trajectories as poses if they have a covariance, else as odometry, each message under its own
    stamp; what is serialized already comes as a pair of its type and rows of (stamp, bytes).
    """
    import numpy as np
    from tsmcl_ros import messages
    from tsmcl_ros.bag import Writer
    from tsmcl_ros.types import Odometry, Trajectory

    def rows_of(content: object) -> list[tuple[float, bytes]]:
        if isinstance(content, tuple):
            return list(content[1])
        if not isinstance(content, Trajectory):
            assert isinstance(content, list)
            return [(scan.stamp, messages.encode_beacons(scan, 'map')[0]) for scan in content]
        if content.covariance is None:
            return [
                (stamp, messages.encode_odometry(
                    Odometry(stamp, np.append(position, 0.0)[:3], yaw), 'map', 'base_link'))
                for stamp, position, yaw in zip(
                    content.stamp, content.position, content.yaw, strict=True)
            ]
        return [
            (stamp, messages.encode_pose(stamp, 'map', position, covariance, yaw, 0.1))
            for stamp, position, covariance, yaw in zip(
                content.stamp, content.position, content.covariance, content.yaw, strict=True)
        ]

    def record_one(path: Path, topics: dict[str, object],
                   about: dict[str, str] | None = None) -> Path:
        rows: list[tuple[float, str, bytes]] = []
        with Writer(path, about=about) as bag:
            for topic, content in topics.items():
                kind = messages.POINT_CLOUD
                if isinstance(content, Trajectory):
                    kind = messages.ODOMETRY if content.covariance is None else messages.POSE
                elif isinstance(content, tuple):
                    kind = content[0]
                bag.topic(topic, kind)
                rows += [(stamp, topic, data) for stamp, data in rows_of(content)]
            for stamp, topic, data in sorted(rows):
                bag.write(topic, stamp, data)
        return path

    return record_one
