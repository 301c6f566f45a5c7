"""
What becomes of a fleet, its recorder and its anchors when processes die and links break.

Nodes run as processes of their own, on hosts that are namespaces of Linux where links are cut, and
in real time, as DDS and the dead have no other.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any, NamedTuple

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader, STORAGES
from tsmcl_ros.messages.diagnostics import FINE, WARNING
from tsmcl_ros.scripts.scenario import LOCALIZER
from tsmcl_ros.types import Array
from tsmcl_ros.world import make_world

sys.path += [str(Path(__file__).parents[1] / name) for name in ('benchmark', 'nodes')]
from broken_bags import fill_disk, kill_recorder  # noqa: E402, I100
from goals import Goal, Section  # noqa: E402, I100
from hosts import discovery_server, Host, network, Refused  # noqa: E402, I100

VEHICLES = 20
SEED = 7
WORLD = {'vehicles': VEHICLES, 'radio_range': LOCALIZER['radio_range']}
SETTLED, CUT, AFTER = 12, 10, 12  # epochs of a second
NEES_BOUND = 5.99  # of two coordinates, in 95 of 100
PATIENCE = 60.0  # s
KILLS = 10


class Nodes:
    """
    The package's nodes as processes; a context manager, after which none is left.

    Parameters
    ----------
    folder : Path
        Where they run, and what they say is in NAME.log.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, within: list[str] | None = None, **settings: Any) -> None:
        """Start one, in place of the last one of the name."""
        words = [word for key, value in settings.items()
                 for word in ('-p', f'{key}:={str(value).lower()}')]
        with (self.folder / f'{name}.log').open('ab') as log:
            self._running[name] = subprocess.Popen(
                [*(within or []), sys.executable, '-m', f'tsmcl_ros.nodes.{name}', '--ros-args',
                 *words], cwd=self.folder, stdout=log, stderr=subprocess.STDOUT)

    def end(self, name: str, how: signal.Signals = signal.SIGINT) -> None:
        """End one."""
        self._running[name].send_signal(how)
        self._running.pop(name).wait(PATIENCE)

    def said(self, name: str) -> list[str]:
        """Return the lines that a node has written."""
        return (self.folder / f'{name}.log').read_text().splitlines()

    def await_line(self, name: str, text: str) -> None:
        """Wait until a node says something."""
        end = time.monotonic() + PATIENCE
        while not any(text in line for line in self.said(name)):
            if time.monotonic() > end or self._running[name].poll() is not None:
                raise RuntimeError(f'{name} did not say {text!r}: {self.said(name)}')
            time.sleep(0.05)

    def __enter__(self) -> Nodes:
        return self

    def __exit__(self, *_: object) -> None:
        for name in list(self._running):
            self.end(name)


class Course(NamedTuple):
    """
    What a bag tells of a fleet about something that happened.

    Attributes
    ----------
    noticed : float
        From when it began until all vehicles were said to be no longer OK [s], NaN if never.
    recovered : float
        From when it ended until all were OK again [s].
    epochs : float
        How many epochs had poses meanwhile, NaN if they were never OK again.
    nees : (P,) float
        Of the poses from when it began on.
    error : (P,) float
        Of the same [m].
    stamp : (P,) float
        Of the same [s].
    suspects, lost : int
        How many diagnoses named a sender, or said LOST, from when it began on.

    """

    noticed: float
    recovered: float
    epochs: float
    nees: Array
    error: Array
    stamp: Array
    suspects: int
    lost: int

    @property
    def wrong(self) -> float:
        """Share of poses that are further off than 95 of 100 should be."""
        return float((self.nees > NEES_BOUND).mean())


def read_course(path: Path, begin: float, end: float) -> Course:
    """Return what a bag with wall-clock log times tells of what happened meanwhile [s]."""
    truth = truths()
    status: list[tuple[float, set[int]]] = []
    rows: list[tuple[float, float, float]] = []
    seen: list[tuple[float, float]] = []
    suspects = lost = 0
    with Reader(path) as bag:
        for message in bag.messages():
            if message.topic == '/diagnostics' and message.stamp > begin:
                _, found = messages.decode_diagnostics(message.data)
                status.append((message.stamp, {each.level for each in found}))
                lost += sum(each.level > WARNING for each in found)
                suspects += sum(bool(each.values.get('suspects')) for each in found)
            elif message.topic.endswith('/pose') and message.stamp > begin:
                pose = messages.decode_pose(message.data)
                vehicle = int(message.topic.split('/')[1].removeprefix('veh_'))
                error = pose.position[:2] - truth[round(pose.stamp), vehicle]
                seen.append((message.stamp, pose.stamp))
                rows.append((pose.stamp, float(np.linalg.norm(error)),
                             float(error @ np.linalg.solve(pose.covariance[:2, :2], error))))
    stamp, error, nees = np.array(rows).T if rows else np.zeros((3, 0))
    well = next((at for at, levels in status if at > end and levels == {FINE}), np.nan)
    return Course(
        next((at - begin for at, levels in status if FINE not in levels), np.nan),
        well - end, len({epoch for at, epoch in seen if end < at <= well}) or np.nan,
        nees, error, stamp, suspects, lost)


def truths(epochs: int = 100) -> Array:
    """Return where the vehicles of the simulation are: (epochs, V, 2) [m]."""
    world = make_world(WORLD, np.random.default_rng(SEED))
    begin = np.full((VEHICLES, 2), np.nan)
    return np.stack([begin, *(world.step().position[:, :2] for _ in range(epochs - 1))])


@contextmanager
def scene(folder: Path, roadside: list[str], site: list[str], settled: float
          ) -> Iterator[Nodes]:
    """Have a fleet localized in real time, from the anchors and the simulator of another host."""
    with Nodes(folder) as nodes:
        nodes.start('recorder', site, output=folder / 'bag',
                    topics='["/diagnostics", "/veh_.*/pose"]')
        fleet(nodes, site)
        nodes.start('simulator', roadside, **WORLD, seed=SEED, duration=90.0, rate=1.0,
                    wait_for=1, beacon_timeout=0.5)
        nodes.start('anchor', roadside, use_sim_time=True, seed=SEED)
        nodes.await_line('simulator', 'under way')
        nodes.await_line('fleet', 'OK: ')
        time.sleep(settled)
        yield nodes
        nodes.end('recorder')


def fleet(nodes: Nodes, within: list[str]) -> None:
    """Start the localizers, which go on from their last poses."""
    nodes.start('fleet', within, vehicles=VEHICLES, use_sim_time=True,
                resume_from=nodes.folder / 'last.json', **LOCALIZER)


@contextmanager
def hosts(folder: Path) -> Iterator[tuple[Host, Host, list[str], list[str]]]:
    """Make two hosts, and return them with what precedes the command lines of nodes there."""
    with network(2, folder) as (roadside, site), discovery_server(site) as server:
        yield roadside, site, roadside.node(server), site.node(server)


def cut_link(folder: Path, settled: float = SETTLED, seconds: float = CUT,
             after: float = AFTER) -> Course:
    """Cut the link between two hosts for a while."""
    with hosts(folder) as (roadside, _, there, here), scene(folder, there, here, settled):
        begin = time.time()
        with roadside.cut():
            time.sleep(seconds)
        end = time.time()
        time.sleep(after)
    return read_course(folder / 'bag', begin, end)


def kill_fleet(folder: Path, settled: float = SETTLED, after: float = AFTER) -> Course:
    """Kill the localizers, and start them again."""
    with scene(folder, [], [], settled) as nodes:
        begin = time.time()
        nodes.end('fleet', signal.SIGKILL)
        fleet(nodes, [])
        nodes.await_line('fleet', 'resume from')
        end = time.time()
        time.sleep(after)
    return read_course(folder / 'bag', begin, end)


def restart_anchors(folder: Path, settled: float = SETTLED, after: float = AFTER
                    ) -> tuple[Course, list[str]]:
    """Kill the anchors, and start them again; return what the fleet logged since as well."""
    with scene(folder, [], [], settled) as nodes:
        before = len(nodes.said('fleet'))
        begin = time.time()
        nodes.end('anchor', signal.SIGKILL)
        nodes.start('anchor', use_sim_time=True, seed=SEED)
        time.sleep(after)
        news = nodes.said('fleet')[before:]
    return read_course(folder / 'bag', begin, begin), news


def measure() -> Section:
    """Let each happen, some of it again and again."""
    with tempfile.TemporaryDirectory() as name:
        return _measure(Path(name))


def _measure(root: Path) -> Section:
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rng = np.random.default_rng(11)

    def folder() -> Path:
        return Path(tempfile.mkdtemp(dir=root))

    kills = {storage: [kill_recorder(folder(), storage, seconds=float(rng.uniform(1, 3)))
                       for _ in range(KILLS)] for storage in STORAGES}
    disks = {storage: [fill_disk(folder(), storage, int(size))
                       for size in rng.integers(1500, 8000, KILLS)] for storage in STORAGES}
    again = kill_fleet(folder())
    anchors, news = restart_anchors(folder())
    try:
        cut = cut_link(folder())
    except Refused as refused:
        return Section(TITLE, f'Not measured, this machine lets nobody make hosts: {refused}.')
    rows = [['what happened', 'how often', 'noticed [s]', 'OK again [s]',
             'poses beyond their 95 % [%]', 'diagnoses LOST', 'with suspects'], *(
        [what, '1', f'{each.noticed:.1f}', f'{each.recovered:.1f}', f'{100 * each.wrong:.1f}',
         str(each.lost), str(each.suspects)] for what, each in (
            (f'link cut for {CUT} s', cut), ('localizers killed', again),
            ('anchors killed', anchors)))]
    bags = [['bags', 'how often', 'valid', 'lost at most'], *(
        [f'recorder killed, {storage}', str(KILLS), str(sum(each.is_whole for each in found)),
         f'{max(each.lost for each in found):.2f} s'] for storage, found in kills.items()), *(
        [f'disk full, {storage}', str(KILLS), str(sum(valid for valid, _ in found)), '']
        for storage, found in disks.items())]
    errors = [line for line in news if 'INFO' not in line]
    return Section(TITLE, TEXT, [bags, rows], [
        Goal('lost by a killed recorder', max(
            each.lost for found in kills.values() for each in found), 1, unit='s'),
        Goal('bags of killed recorders that are whole to there', sum(
            each.is_whole for found in kills.values() for each in found),
            KILLS * len(kills), 'at least'),
        Goal('bags on full disks that are valid', sum(
            valid for found in disks.values() for valid, _ in found), KILLS * len(disks),
            'at least'),
        Goal('link cut until STALE', cut.noticed, 2, unit='epochs'),
        Goal('link back until OK', cut.recovered, 5, unit='epochs'),
        Goal('poses beyond their 95 %, from the cut on', 100 * cut.wrong, 10, unit='%'),
        Goal('localizers back until OK', again.recovered, 3, unit='epochs'),
        Goal('poses beyond their 95 % after that', 100 * again.wrong, 10, unit='%'),
        Goal('vehicles LOST, or suspecting somebody, while anchors restarted',
             anchors.lost + anchors.suspects, 0),
        Goal('warnings and errors of the localizers then', len(errors), 0),
    ])


TITLE = 'Processes that die, links that break'
TEXT = (
    f'{VEHICLES} range-free vehicles with odometry, in real time with an epoch a second. The link '
    f'is that between the host of the simulator and the anchors and that of the localizers: '
    'beacons, odometry and time are all cut. Localizers have `resume_from`. Killed is with '
    'SIGKILL; what writes bags is killed after 1 to 3 s, and repaired; full disks have 1.5 to '
    '8 MB. Noticed is from when it happened until no vehicle was OK, the rest from its end.')


if __name__ == '__main__':
    print(measure().plain())
