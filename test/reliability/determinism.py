"""
Same bag, same seed, same package: the same bits, whatever the machine is busy with.

    python test/reliability/run.py determinism

The golden file of the tests is another matter: it tells when bits change from version to version.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
sys.path += [str(ROOT / 'tools'), str(ROOT / 'test' / 'benchmark')]
from goals import Goal, Section  # noqa: E402, I100
import golden  # noqa: E402
from tsmcl_ros import messages  # noqa: E402
from tsmcl_ros.bag import Reader  # noqa: E402
from tsmcl_ros.config import load_yaml  # noqa: E402
from tsmcl_ros.methods import METHODS  # noqa: E402
from tsmcl_ros.nodes import runtime, wire  # noqa: E402
from tsmcl_ros.nodes.process import session  # noqa: E402
from tsmcl_ros.scripts.localize_bag import localize_bag  # noqa: E402

BAG, CONFIG = ROOT / 'bags' / 'waypoint', ROOT / 'config' / 'range_free.yaml'
RATES = (5.0, 20.0, 50.0)
DOMAIN = '93'
PATIENCE = 60.0  # s
THREADS = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS')


class Machine(NamedTuple):
    """What a process runs on."""

    cores: int
    threads: int
    hash_seed: int

    def digests(self) -> dict[str, str]:
        """Return the digest of each method's poses there."""
        mine = sorted(os.sched_getaffinity(0))
        environment = os.environ | dict.fromkeys(THREADS, str(self.threads)) | {
            'PYTHONHASHSEED': str(self.hash_seed)}
        shown = subprocess.run(
            [sys.executable, ROOT / 'tools' / 'golden.py', '--show'], env=environment, check=True,
            capture_output=True, text=True,
            preexec_fn=lambda: os.sched_setaffinity(0, mine[:self.cores])).stdout
        return {method: told['sha256'] for method, told in json.loads(shown)['poses'].items()}


MACHINES = (Machine(1, 1, 1), Machine(1, 2, 2), Machine(2, 1, 3), Machine(2, 2, 4))


class Probe(runtime.Node):
    """Collects the poses of a bag's vehicles."""

    default_name = 'determinism'

    def __init__(self, topics: list[str]) -> None:
        super().__init__()
        self.poses: dict[str, list[bytes]] = {topic: [] for topic in topics}
        for topic, received in self.poses.items():
            self.listen(topic, messages.POSE, received.append, wire.LATCHED_INPUT)


def recorded(bag: Path) -> dict[str, list[bytes]]:
    """Return the serialized poses of a bag by topic."""
    with Reader(bag) as reader:
        poses: dict[str, list[bytes]] = {
            topic: [] for topic in sorted(reader.topics) if topic.endswith('/pose')}
        for message in reader.messages(poses):
            poses[message.topic].append(message.data)
    return poses


def replayed(rate: float, expected: dict[str, list[bytes]]) -> int:
    """Return how many poses differ when the bag is replayed into a running fleet."""
    wanted = [f'{topic.removesuffix("pose")}{name}' for topic in expected
              for name in ('beacons', 'odom')]
    probe = Probe(list(expected))
    nodes = [
        ('fleet', ['--params-file', CONFIG, '-p', 'use_sim_time:=true', '-p', 'seed:=1',
                   '-p', f'vehicles:={len(expected)}']),
        ('replay', ['-p', f'bag:={BAG}', '-p', f'rate:={rate}', '-p', f'wait:={PATIENCE}', '-p',
                    f'wait_for:={["/anchor_map", *wanted]}'.replace("'", '"')])]
    processes = [subprocess.Popen(
        [sys.executable, '-m', f'tsmcl_ros.nodes.{name}', '--ros-args', *map(str, arguments)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for name, arguments in nodes]
    try:
        probe.spin(lambda: all(len(probe.poses[topic]) >= len(poses)
                               for topic, poses in expected.items()), PATIENCE)
    finally:
        for process in processes:
            process.terminate()
            process.wait()
        probe.close()
    return sum(
        len(poses) - sum(one == other for one, other in zip(
            poses, probe.poses[topic], strict=False))
        for topic, poses in expected.items())


def measure() -> Section:
    """Compare bits between processes of several kinds, and with what nodes publish."""
    first, *others = [machine.digests() for machine in MACHINES]
    differing = sum(digests[method] != first[method] for digests in others for method in METHODS)
    os.environ.update(ROS_DOMAIN_ID=DOMAIN, ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, 'out')
        localize_bag(str(BAG), str(out), load_yaml(CONFIG) | {'seed': 1})
        expected = recorded(out)
    total = sum(map(len, expected.values()))
    with session():
        live = [replayed(rate, expected) for rate in RATES]
    table = [
        ['poses of', 'against', 'compared', 'differing'],
        [f'{len(METHODS)} methods, {golden.BAG.name}',
         '1 and 2 cores, 1 and 2 threads, 4 orders of sets', f'{len(others) * len(METHODS)} runs',
         f'{differing}'],
        [f'localize_bag, {BAG.name}', 'those that were recorded live in it', f'{total}',
         f'{_differing(expected, recorded(BAG))}'],
        *([f'localize_bag, {BAG.name}', f'replay at rate {rate:g} into a running fleet',
           f'{total}', f'{wrong}'] for rate, wrong in zip(RATES, live, strict=True))]
    return Section(
        'Determinism',
        'Serialized poses, byte for byte. Across versions of numpy, and processors of which one '
        'has AVX-512 and the other has not, the last bits differ; there `test/test_golden.py` '
        'compares to a millimetre.',
        [table], [
            Goal('runs whose poses differ in a bit', differing, 0),
            Goal('poses that differ after a replay', sum(live), 0)])


def _differing(some: dict[str, list[bytes]], others: dict[str, list[bytes]]) -> int:
    return sum(one != other for topic in some
               for one, other in zip(some[topic], others[topic], strict=True))


if __name__ == '__main__':
    print(measure().plain())
