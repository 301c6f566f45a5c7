"""
An hour of a fleet, in process and over DDS, as fast as it goes: what grows, and what is lost.

It takes half an hour where others work, too. From the command line, for other lengths:

    python test/reliability/long_run.py [SIMULATED SECONDS]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing, ExitStack
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.nodes.process import session
from tsmcl_ros.scripts.scenario import LOCALIZER
from tsmcl_ros.types import Odometry
from tsmcl_ros.world import make_world

sys.path.append(str(Path(__file__).parents[1] / 'benchmark'))
from goals import Goal, Section  # noqa: E402, I100

VEHICLES, HOUR = 40, 3600
SAMPLES = 60
NODES = ('anchor', 'fleet', 'recorder', 'simulator')
PATIENCE = 60.0  # s, in which nothing need happen


class Sample(NamedTuple):
    """
    What a process holds: resident memory [MB], threads, descriptors; and has worked [s].

    A yardstick tells how long [s] the machine takes for the same work each time, as its speed
    depends on what else goes on.
    """

    memory: float
    threads: int
    descriptors: int
    work: float
    yardstick: float


class Course(NamedTuple):
    """
    How a process fared.

    Attributes
    ----------
    growth : float
        Share by which the memory of the last quarter is above that after the warm-up, a tenth.
    slowing : float
        The same of the processor's time that a simulated second takes, over the yardstick's.
    memory : float
        At the end [MB].
    threads, descriptors : int
        Of all samples after the warm-up, the most less the least.

    """

    growth: float
    slowing: float
    memory: float
    threads: int
    descriptors: int


def sample(process: int) -> Sample:
    """Look at a process of this host."""
    folder = Path('/proc', str(process))
    pages = int(Path(folder, 'statm').read_text().split()[1])
    ticks = Path(folder, 'stat').read_text().rpartition(')')[2].split()[11:13]
    return Sample(pages * os.sysconf('SC_PAGE_SIZE') / 1e6, len(os.listdir(folder / 'task')),
                  len(os.listdir(folder / 'fd')),
                  sum(map(int, ticks)) / os.sysconf('SC_CLK_TCK'), _yardstick())


def _yardstick() -> float:
    """Return the processor's time [s] of what vehicles cost: small arrays, and Python."""
    begin = time.process_time()
    values = np.arange(200.0)
    for _ in range(2000):
        values = np.sort(np.sqrt(values * values + 1.0))
    return time.process_time() - begin


def course(samples: Sequence[Sample]) -> Course:
    """Sum up a process's samples, which were taken at equal times of the simulation."""
    memory, threads, descriptors, work, yardstick = np.array(samples[len(samples) // 10:]).T
    pace = np.diff(work) / (yardstick[1:] + yardstick[:-1])
    quarter = len(pace) // 4

    def rise(values: np.ndarray) -> float:
        return float(np.mean(values[-quarter:]) / max(np.mean(values[:quarter]), 1e-9) - 1)

    return Course(rise(memory), rise(pace), memory[-1], int(np.ptp(threads)),
                  int(np.ptp(descriptors)))


def alone(seconds: int, vehicles: int = VEHICLES) -> tuple[Course, int]:
    """Localize a fleet in this process, by serialized messages; return lost poses as well."""
    world = make_world({'vehicles': vehicles, 'radio_range': LOCALIZER['radio_range']},
                       np.random.default_rng(1))
    localizer = Localizer(LOCALIZER, vehicles)
    names = [f'/veh_{i}' for i in range(vehicles)]
    endpoint = Endpoint(localizer, names)
    heed = {topic: handler for topic, (_, handler) in endpoint.inputs.items()}
    heed['/anchor_map'](messages.encode_beacons(world.anchors, 'map')[0])
    samples, expected, poses = [], 0, 0
    begun = np.zeros(vehicles, bool)
    for second in range(seconds):
        epoch = world.step()
        begun |= epoch.observation.heard.any(axis=1)
        expected += int(begun.sum())
        for i, scan in enumerate(messages.encode_beacons(epoch.observation, 'map')):
            odometry = Odometry(epoch.stamp, np.append(epoch.odom_position[i], 0.0),
                                float(epoch.odom_yaw[i]))
            heed[f'{names[i]}/odom'](messages.encode_odometry(odometry, 'odom', 'base_link'))
            heed[f'{names[i]}/beacons'](scan)
        poses += sum(len(list(endpoint.poses(estimate))) for estimate in endpoint.due())
        if second % max(seconds // SAMPLES, 1) == 0:
            samples.append(sample(os.getpid()))
    poses += sum(len(list(endpoint.poses(estimate))) for estimate in localizer.finish())
    return course(samples), expected - poses


class Clock(runtime.Node):
    """Sees a simulation's time."""

    default_name = 'observer'

    def __init__(self) -> None:
        super().__init__()
        self.time = 0.0
        self.listen('/clock', messages.CLOCK, self._take, wire.SENSOR_DATA)

    def _take(self, data: bytes) -> None:
        self.time = messages.decode_clock(data)


def over_dds(seconds: int, folder: Path, vehicles: int = VEHICLES
             ) -> tuple[dict[str, Course], int, int]:
    """Run the nodes; return how each fared, and which poses the simulator and the bag lack."""
    common = {'use_sim_time': True}
    processes: dict[str, subprocess.Popen[bytes]] = {}
    with ExitStack() as stack:
        def start(name: str, **settings: object) -> None:
            words = [word for key, value in settings.items()
                     for word in ('-p', f'{key}:={str(value).lower()}')]
            log = stack.enter_context((folder / f'{name}.log').open('wb'))
            processes[name] = subprocess.Popen(
                [sys.executable, '-m', f'tsmcl_ros.nodes.{name}', '--ros-args', *words],
                stdout=log, stderr=subprocess.STDOUT)
            stack.callback(processes[name].wait)
            stack.callback(processes[name].send_signal, signal.SIGINT)

        start('recorder', output=folder / 'bag', **common)
        start('fleet', vehicles=vehicles, **common, **LOCALIZER)
        start('anchor', **common)
        # Until it is told to end, so that it is there when it is looked at for the last time.
        start('simulator', vehicles=vehicles, rate=1e4, wait_for=2, lockstep=True,
              beacon_timeout=PATIENCE, pose_timeout=PATIENCE,
              radio_range=LOCALIZER['radio_range'])
        samples = _watch(seconds, [processes[name] for name in NODES])
    complaints = (folder / 'simulator.log').read_text().count('no longer waited for')
    return ({name: course(found) for name, found in zip(NODES, samples, strict=True)},
            complaints, _missing(folder / 'bag', seconds))


def _watch(seconds: int, processes: Sequence[subprocess.Popen[bytes]]) -> list[list[Sample]]:
    """Look at processes at equal times of the simulation."""
    samples: list[list[Sample]] = [[] for _ in processes]
    with session(), closing(Clock()) as clock:
        for number in range(SAMPLES):
            # Two more, so that all poses of the seconds that count have long been given.
            due = 2 + (number + 1) * seconds / SAMPLES
            while not clock.spin(lambda at=due: clock.time >= at, PATIENCE):
                if any(process.poll() is not None for process in processes):
                    raise RuntimeError('a node has ended before its time')
            for process, found in zip(processes, samples, strict=True):
                found.append(sample(process.pid))
    return samples


def _missing(path: Path, seconds: int) -> int:
    """Return how many poses a bag lacks, of the epochs from each vehicle's first one on."""
    stamps: dict[str, set[float]] = {}
    with Reader(path) as bag:
        for message in bag.messages([name for name in bag.topics if name.endswith('/pose')]):
            stamp = messages.decode_pose(message.data).stamp
            if stamp < seconds + 0.5:
                stamps.setdefault(message.topic, set()).add(round(stamp, 6))
    return sum(seconds + 1 - round(min(found)) - len(found) for found in stamps.values())


def measure(seconds: int = HOUR) -> Section:
    """Run an hour twice."""
    within, lost = alone(seconds)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        nodes, given_up, unrecorded = over_dds(seconds, Path(folder))
        took = time.monotonic() - begin
    courses = {'in process': within, **nodes}
    rows = [['', 'memory [MB]', 'growth', 'slowing', 'threads', 'descriptors'], *(
        [name, f'{each.memory:.0f}', f'{each.growth:+.1%}', f'{each.slowing:+.1%}',
         f'{each.threads:+d}', f'{each.descriptors:+d}'] for name, each in courses.items())]

    def worst(of: Callable[[Course], float]) -> float:
        return max(of(each) for each in courses.values())

    return Section(TITLE, f'{VEHICLES} vehicles among 16 anchors for {seconds} simulated seconds, '
                   f'in one process by serialized messages, and as nodes over DDS in lockstep '
                   f'(`simulator`, `lockstep: true`), recorded, in {took:.0f} s. '
                   'Growth and slowing are those of the last quarter against the first one after '
                   'a tenth to warm up; threads and descriptors are how far their number went '
                   'apart after that.', [rows], [
        Goal('growth of memory', 100 * worst(lambda each: each.growth), 5, unit='%'),
        Goal("growth of the processor's time that a second takes",
             100 * worst(lambda each: each.slowing), 10, unit='%'),
        Goal('epochs lost in process', lost, 0),
        Goal('epochs given up over DDS', given_up, 0),
        Goal('poses missing in the bag', unrecorded, 0),
        Goal('change of the number of threads', worst(lambda each: each.threads), 0),
        Goal('change of the number of descriptors', worst(lambda each: each.descriptors), 0),
    ])


TITLE = 'Long runs: an hour of a fleet'


if __name__ == '__main__':
    print(measure(*map(int, sys.argv[1:])).plain())
