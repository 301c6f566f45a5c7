"""
How fast localize_bag is, beside raw reading and the bare filter, and how much memory it takes.

    python test/benchmark/run.py bag

One vehicle: the first epochs of the robot mower's recording, ../shared/data/plaza1, by ts_mcl as
it comes. A fleet: 40 simulated vehicles by mcl with 200 particles. The bare filter is the
localizer, fed with messages that are decoded already. Long bags: images that nobody wants, between
which a vehicle hears beacons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
import contextlib
from dataclasses import dataclass, field, replace
import io
from pathlib import Path
import shutil
from statistics import median
import subprocess
import sys
import tempfile
import time
from typing import Any

from goals import Goal, Section
import numpy as np
from timing import seconds
from tsmcl_ros import messages
from tsmcl_ros.bag import Message, Reader, Writer
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.scripts import import_csv
from tsmcl_ros.scripts.localize_bag import localize_bag
from tsmcl_ros.types import Observation, Odometry
from tsmcl_ros.world import make_world

LOG = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'plaza1'
EPOCHS, FLEET_EPOCHS, FLEET = 250, 60, 40
REPEAT = 2
POSES = 50_000
FLEET_SETTINGS = {'seed': 1, 'method': 'mcl', 'min_particles': 200, 'radio_range': 1000.0}
IMAGE = 'sensor_msgs/msg/Image'
MEGABYTE = 2 ** 20
SIZES = (200, 1000)  # MB
DECODERS: dict[str, Callable[[bytes], Any]] = {
    'anchor_map': messages.decode_beacons,
    'beacons': messages.decode_beacons,
    'odom': messages.decode_odometry,
}


@dataclass
class Case:
    """A bag, and what each way through it takes [s]."""

    bag: Path
    settings: Mapping[str, Any]
    vehicles: int
    times: dict[str, list[float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Read and decode what the bare filter is fed with."""
        self._out = self.bag.with_name(f'{self.bag.name}_out')
        recorded = list(self._read())
        self.epochs = sum(message.topic.endswith('/beacons') for message in recorded)
        self._decoded = [
            (message.topic, DECODERS[kind](message.data)) for message in recorded
            if (kind := message.topic.rpartition('/')[2]) in DECODERS]

    def run(self) -> None:
        """Take each way once."""
        out = str(self._out)
        for name, work in {
            'localize_bag': lambda: localize_bag(str(self.bag), out, self.settings),
            'opening it and a new one': self._open,
            'raw reading': lambda: list(self._read()),
            'bare filter': self._filter,
        }.items():
            shutil.rmtree(out, ignore_errors=True)
            begin = time.process_time()
            work()
            self.times.setdefault(name, []).append(time.process_time() - begin)

    def time(self, name: str) -> float:
        """Return the median of one way [s]."""
        return median(self.times[name])

    @property
    def ratio(self) -> float:
        """How often the time of raw reading and the bare filter localize_bag takes."""
        return self.time('localize_bag') / (self.time('raw reading') + self.time('bare filter'))

    @property
    def rate(self) -> float:
        """Epochs of vehicles in a second."""
        return self.epochs / self.time('localize_bag')

    def reason(self) -> str:
        """Say where the time goes."""
        each = {name: 1e6 * self.time(name) / self.epochs for name in self.times}
        opening, bare = each['opening it and a new one'], each['bare filter']
        rest = each['localize_bag'] - bare - opening
        return (f'Of {each["localize_bag"]:.0f} us an epoch of a vehicle the bare filter takes '
                f'{bare:.0f}, to open two bags of {self._topics} topics {opening:.0f} (YAML, '
                f'once a bag), to read, decode, encode and write {rest:.0f}.')

    def rows(self) -> Iterator[list[str]]:
        """Yield a row of the table for each way."""
        for name in self.times:
            took = self.time(name)
            yield [self.bag.name, name, f'{took:.2f} s', f'{1e6 * took / self.epochs:.0f} us',
                   f'{self.epochs / took:,.0f}']

    def _read(self) -> Iterator[Message]:
        with Reader(self.bag) as reader:
            self._topics = len(reader.topics)
            yield from reader.messages()

    def _open(self) -> None:
        with Reader(self.bag) as reader, Writer(self._out) as new:
            for topic, kind in reader.topics.items():
                new.topic(topic, kind)

    def _filter(self) -> None:
        localizer = Localizer(self.settings, self.vehicles)
        number = {f'/veh_{vehicle}': vehicle for vehicle in range(self.vehicles)}
        for topic, content in self._decoded:
            name, _, kind = topic.rpartition('/')
            if kind == 'odom':
                localizer.odometry(number[name], content)
            elif kind == 'beacons':
                localizer.beacons(number[name], content[0])
            else:
                localizer.anchor_map(content[0])
            localizer.due()
        localizer.finish()


def measure() -> Section:
    """Time localize_bag beside its parts, decode poses, and weigh long bags."""
    with tempfile.TemporaryDirectory() as folder:
        one = Case(_recording(Path(folder, 'plaza1')), {'seed': 1}, 1)
        fleet = Case(_fleet(Path(folder, 'fleet')), FLEET_SETTINGS, FLEET)
        for _ in range(REPEAT):
            one.run()
            fleet.run()
        weights = [_weigh(_long(Path(folder, f'long_{size}'), size)) for size in SIZES]
    poses = _poses_per_second()
    small, large = weights
    return Section(
        'Bags',
        f'`localize_bag` beside raw reading and the bare filter, by processor time: {one.epochs} '
        f'epochs of {LOG.name} by ts_mcl, and of {FLEET} simulated vehicles by mcl with 200 '
        'particles. Poses are decoded many at once, as `evaluate` does. Memory is the most that '
        f'a process of localize_bag held, on bags of {SIZES[0]} and {SIZES[1]} MB.',
        [[['bag', '', 'processor time', 'an epoch of a vehicle', 'epochs a second'],
          *one.rows(), *fleet.rows()]], [
            Goal('localize_bag, of raw reading and the bare filter, one vehicle', one.ratio, 2,
                 reason=one.reason()),
            Goal(f'localize_bag, of raw reading and the bare filter, {FLEET} vehicles',
                 fleet.ratio, 2, reason=fleet.reason()),
            Goal('epochs a second, one vehicle', one.rate, 5000, 'at least',
                 reason=one.reason()),
            Goal(f'epochs of vehicles a second, {FLEET} vehicles', fleet.rate, 50_000, 'at least',
                 reason=fleet.reason()),
            Goal('poses decoded a second', poses, 400_000, 'at least'),
            Goal(f'memory on a bag of {SIZES[1]} MB', large, 300, unit='MB'),
            Goal(f'memory on it, of that on a bag of {SIZES[0]} MB', large / small, 1.1),
        ])


def _recording(path: Path) -> Path:
    """Make a bag of the recording's first epochs."""
    whole = path.with_name('whole')
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if import_csv.main([str(LOG), str(whole)]):
            raise SystemExit(1)
    with Reader(whole) as reader, Writer(path) as writer:
        epochs = 0
        for message in reader.messages():
            writer.topic(message.topic, message.type)
            writer.write(message.topic, message.stamp, message.data)
            epochs += message.topic.endswith('/beacons')
            if epochs == EPOCHS:
                break
    return path


def _fleet(path: Path) -> Path:
    """Make a bag of simulated vehicles."""
    world = make_world({'vehicles': FLEET, 'radio_range': 1000.0}, np.random.default_rng(1))
    with Writer(path) as writer:
        _write(writer, '/anchor_map', messages.POINT_CLOUD, 0.5,
               messages.encode_beacons(world.anchors, 'map')[0])
        for _ in range(FLEET_EPOCHS):
            epoch = world.step()
            for vehicle, scan in enumerate(messages.encode_beacons(epoch.observation, 'map')):
                name = f'/veh_{vehicle}'
                for topic, place, yaw in (
                    ('odom', epoch.odom_position[vehicle], epoch.odom_yaw[vehicle]),
                    ('ground_truth', epoch.position[vehicle], epoch.yaw[vehicle]),
                ):
                    pose = Odometry(epoch.stamp, np.append(place, 0.0), float(yaw))
                    _write(writer, f'{name}/{topic}', messages.ODOMETRY, epoch.stamp,
                           messages.encode_odometry(pose, 'map', f'{name}/base_link'))
                _write(writer, f'{name}/beacons', messages.POINT_CLOUD, epoch.stamp, scan)
    return path


def _long(path: Path, size: int) -> Path:
    """Make a bag of so many megabytes, nearly all of them images."""
    place = np.array([[0.0, 0.0], [900.0, 0.0], [0.0, 900.0]])
    scan = Observation.empty(1, len(place), 2, 0.0)
    scan.sender[0], scan.position[0] = np.arange(len(place)), place
    image = bytes(MEGABYTE // 4)
    with Writer(path) as writer:
        for number in range(4 * size):
            stamp = 1 + 0.1 * number
            _write(writer, '/camera', IMAGE, stamp, image)
            if number % 10 == 0:
                heard, = messages.encode_beacons(replace(scan, stamp=stamp), 'map')
                _write(writer, '/veh_0/beacons', messages.POINT_CLOUD, stamp, heard)
    return path


def _write(writer: Writer, topic: str, kind: str, stamp: float, data: bytes) -> None:
    writer.topic(topic, kind)
    writer.write(topic, stamp, data)


# getrusage would tell what the process held that this one was forked from, if that was more.
_WEIGHED = """
import sys
from tsmcl_ros.scripts.localize_bag import localize_bag
localize_bag(sys.argv[1], sys.argv[1] + '_out', {'method': 'mcl', 'radio_range': 1000.0})
print(open('/proc/self/status').read().partition('VmHWM:')[2].split()[0])
"""


def _weigh(bag: Path) -> float:
    """Return the most memory [MB] that a process held which localized the bag; it is removed."""
    found = subprocess.run([sys.executable, '-c', _WEIGHED, str(bag)], check=True, text=True,
                           stdout=subprocess.PIPE).stdout
    shutil.rmtree(bag)
    return int(found) / 1024


def _poses_per_second() -> float:
    """Return how many poses of a trajectory are decoded in a second of processor time."""
    covariance = np.eye(2)
    data = [messages.encode_pose(1 + 0.1 * number, 'map', np.array([1.0, 2.0]), covariance, 0.5,
                                 0.1) for number in range(POSES)]
    return POSES / seconds(lambda: messages.decode_poses(data))
