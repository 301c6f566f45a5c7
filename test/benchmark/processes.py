"""Processes that are measured from outside, and the traffic that they are measured under."""

from __future__ import annotations

import atexit
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import math
import os
from pathlib import Path
import struct
import subprocess
import sys
import time

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.messages.stamps import split
from tsmcl_ros.nodes import runtime, wire
from tsmcl_ros.nodes.process import session
from tsmcl_ros.types import Array, Observation

PATIENCE = 60.0  # s
_STAMP = struct.Struct('<iI')
_HEADER = 4  # bytes before a message's stamp
_ARREARS = 5  # bursts


class Process:
    """
    A process that says 'active' once it is ready.

    Parameters
    ----------
    command : sequence of str
        What Python is to run.
    core : int or None
        The only core that it may use.

    Attributes
    ----------
    start : float
        What it took to be ready [s].

    """

    def __init__(self, *command: str, core: int | None = None) -> None:
        begin = time.perf_counter()
        pinned = [] if core is None else ['taskset', '--cpu-list', str(core)]
        self._process = subprocess.Popen(
            [*pinned, sys.executable, *command], stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True)
        atexit.register(self._process.kill)
        assert self._process.stdout is not None
        written = []
        for line in self._process.stdout:
            written.append(line)
            if 'active' in line:
                break
        else:
            raise SystemExit(f'{" ".join(command)} ended: {"".join(written)}')
        self.start = time.perf_counter() - begin

    @property
    def cpu(self) -> float:
        """Processor time of all its threads so far [s]."""
        tasks = Path(f'/proc/{self._process.pid}/task').iterdir()
        return sum(int(Path(task, 'schedstat').read_text().split()[0]) for task in tasks) / 1e9

    @property
    def memory(self) -> tuple[float, float]:
        """Resident memory, and what it was at its most [MB]."""
        status = Path(f'/proc/{self._process.pid}/status').read_text()
        now, most = (int(status.partition(key)[2].split()[0]) * 1024 / 1e6
                     for key in ('VmRSS:', 'VmHWM:'))
        return now, most

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.communicate(timeout=PATIENCE)


@dataclass
class Answers:
    """
    What came of some messages.

    Attributes
    ----------
    latency : (M,) float
        From each message to its answer [s], NaN where there was none.

    """

    latency: Array

    @property
    def lost(self) -> int:
        """How many messages got no answer."""
        return int(np.isnan(self.latency).sum())

    @property
    def percentiles(self) -> tuple[float, float]:
        """Median and 99th percentile of the latency [s], NaN if all is lost."""
        if self.lost == len(self.latency):
            return math.nan, math.nan
        median, most = np.nanpercentile(self.latency, (50, 99)).tolist()
        return median, most


class Traffic(runtime.Node):
    """
    Sends beacons to some vehicles, and takes their poses.

    Parameters
    ----------
    names : sequence of str
        Namespaces of the vehicles.

    """

    default_name = 'traffic'

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self._sent: dict[tuple[int, bytes], tuple[int, float]] = {}
        self._latency = np.zeros(0)
        self._map = self.talk('/anchor_map', messages.POINT_CLOUD, wire.LATCHED)
        self._beacons = [
            self.talk(f'{name}/beacons', messages.POINT_CLOUD, wire.SENSOR_DATA)
            for name in names]
        self._poses = [
            self.listen(f'{name}/pose', messages.POSE,
                        lambda data, vehicle=vehicle: self._take(vehicle, data), wire.LATCHED)
            for vehicle, name in enumerate(names)]

    def settle(self, anchors: bytes) -> None:
        """Publish the anchor map, and wait until all topics have found their other end."""
        self._map.publish(anchors)
        names = [publisher.topic_name for publisher in self._beacons]
        poses = [subscription.topic_name for subscription in self._poses]
        if not self.spin(lambda: all(map(self.count_subscribers, names))
                         and all(map(self.count_publishers, poses)), PATIENCE):
            raise SystemExit('nobody listens')
        self.spin(timeout=runtime.SETTLING)

    def send(self, bursts: Sequence[Sequence[tuple[int, bytes]]], rate: float,
             quiet: float = 2.0) -> Answers:
        """
        Send bursts of messages, each with its vehicle, at a rate [Hz]; return what came of them.

        What has not come when nothing comes for `quiet` [s] is lost.

        The latency of a message counts from when it was sent. Where this process does not get to
        send in time, few bursts are made up for, as a real sender would make none.
        """
        self._latency = np.full(sum(map(len, bursts)), np.nan)
        self._sent.clear()
        number, due = 0, time.perf_counter()
        for burst in bursts:
            while (left := due - time.perf_counter()) > 0:
                self._events.spin_once(timeout_sec=left)
            for vehicle, data in burst:
                self._sent[vehicle, data[_HEADER:_HEADER + _STAMP.size]] = (
                    number, time.perf_counter())
                self._beacons[vehicle].publish(data)
                number += 1
            due = max(due + 1 / rate, time.perf_counter() - _ARREARS / rate)
        end = time.perf_counter() + PATIENCE
        while self._sent and time.perf_counter() < end:
            waiting = len(self._sent)
            self.spin(lambda: not self._sent, quiet)
            if len(self._sent) == waiting:
                break
        return Answers(self._latency)

    def _take(self, vehicle: int, data: bytes) -> None:
        now = time.perf_counter()
        sent = self._sent.pop((vehicle, data[_HEADER:_HEADER + _STAMP.size]), None)
        if sent is not None:
            number, begin = sent
            self._latency[number] = now - begin


@contextmanager
def ros() -> Iterator[None]:
    """Use ROS in a domain that no test uses either, as the processes started then do."""
    sys.path.append(str(Path(__file__).resolve().parents[1]))
    import conftest
    conftest.pytest_configure()
    os.environ['PYTHONPATH'] = os.pathsep.join(sys.path)
    try:
        with session():
            yield
    finally:
        conftest.pytest_unconfigure()


def anchor_map(anchors: Array) -> bytes:
    """Return the map of anchors (A, 2) [m] that are numbered from 0."""
    table = Observation.empty(1, len(anchors), 2, 0.0)
    table.sender[0], table.position[0] = np.arange(len(anchors)), anchors
    return messages.encode_beacons(table, 'map')[0]


def scans(anchors: Array, vehicles: int, epochs: int, period: float) -> list[list[bytes]]:
    """
    Return what vehicles hear on their rounds among anchors (A, 2) [m], epoch by epoch.

    They drive at 10 m/s on circles, and range to every anchor with an error of 2 m.
    """
    rng = np.random.default_rng(1)
    radius = rng.uniform(0.2, 0.4, vehicles) * np.ptp(anchors, axis=0).min()
    stamp = period * np.arange(1, epochs + 1)
    angle = 10.0 * stamp[:, None] / radius + rng.uniform(0, 2 * np.pi, vehicles)
    place = anchors.mean(axis=0) + radius[:, None] * np.stack(
        [np.cos(angle), np.sin(angle)], axis=-1)
    distance = np.linalg.norm(place[:, :, None] - anchors, axis=-1)
    heard = Observation.empty(epochs * vehicles, len(anchors), 2, 0.0)
    heard.sender[:], heard.position[:] = np.arange(len(anchors)), anchors
    heard.range[:] = (distance + rng.normal(0, 2.0, distance.shape)).reshape(-1, len(anchors))
    rows = messages.encode_beacons(heard, 'map')
    return [
        [b''.join([data[:_HEADER], _STAMP.pack(*split(float(when))),
                   data[_HEADER + _STAMP.size:]])
         for data in rows[epoch * vehicles:(epoch + 1) * vehicles]]
        for epoch, when in enumerate(stamp)]
