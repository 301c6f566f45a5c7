"""What a bag tells of its runs: the poses beside ground truth, the anchors, the outages."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path

import numpy as np
from tsmcl_ros.bag import Reader
from tsmcl_ros.evaluation.condition import Condition, read_conditions
from tsmcl_ros.evaluation.metrics import compare, Comparison, MAX_AGE, Metrics, pool
from tsmcl_ros.messages import (
    decode_beacons,
    decode_odometries,
    decode_poses,
    decode_scan,
    DIAGNOSTICS,
    ODOMETRY,
    POINT_CLOUD,
    POSE,
)
from tsmcl_ros.types import Array, BagError, MessageError, Progress, Trajectory, unshown

OUTAGE = 5.0


@dataclass(frozen=True, eq=False)
class Run:
    """
    One method's estimates for all vehicles of one bag.

    Attributes
    ----------
    label : str
        Names the run in tables and plots.
    vehicles : mapping of name to Comparison
        A vehicle is named by the namespace of its topics.
    anchors : (A, 3) float32
        Positions in the anchor map [m]; A is 0 without one.
    radio_range : (A,) float32
        [m], NaN where unknown.
    outages : tuple of (from, to)
        Times of more than `OUTAGE` in which no vehicle heard a beacon [s].
    notes : tuple of str
        What the reader of the metrics ought to know.
    anchor_ids : (A,) int32
        Of the anchors.
    conditions : mapping of name to Condition
        How those vehicles that said so were doing, in the evaluated time.
    about : mapping of str to str
        What the bag says of how it was made, see `tsmcl_ros.bag.Writer`.

    """

    label: str
    vehicles: Mapping[str, Comparison]
    anchors: Array
    radio_range: Array
    outages: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]
    anchor_ids: Array = field(default_factory=lambda: np.empty(0, np.int32))
    conditions: Mapping[str, Condition] = field(default_factory=dict)
    about: Mapping[str, str] = field(default_factory=dict)

    @property
    def overall(self) -> Metrics:
        """Metrics over all vehicles' epochs."""
        return pool(self.vehicles.values())

    @property
    def error(self) -> Array:
        """(E,) position errors of all vehicles' epochs [m]."""
        return np.concatenate([part.error for part in self.vehicles.values()])


def read_runs(path: str | Path, label: str | None = None, skip: float = 0.0,
              max_age: float = MAX_AGE, progress: Progress = unshown) -> list[Run]:
    """
    Compare all poses of a bag with their ground truth.

    A topic `NAMESPACE/pose` belongs to the `ground_truth` in the same namespace or in the nearest
    one above it. What lies between the two namespaces is the method's name: `/veh_0/mcl/pose` and
    `/veh_0/ts_mcl/pose` beside `/veh_0/ground_truth` are two runs. A pose topic without messages
    counts as a vehicle that was never localized.

    Parameters
    ----------
    path : str or Path
        The bag's folder.
    label : str, optional
        By default the folder's name; the method's name follows where there are several.
    skip, max_age : float
        See `compare` [s].
    progress : Progress
        Shows the reading.

    Returns
    -------
    list of Run
        At least one, each with at least one epoch.

    Raises
    ------
    BagError
        If the bag cannot be read, holds no poses or no ground truth, or the two do not overlap in
        time.
    MessageError
        If a pose or a ground truth is malformed; the text names bag and topic.

    """
    about, topics, messages = _read(path, progress)
    truths = {_namespace(topic): topic for topic in _named(topics, 'ground_truth', ODOMETRY)}
    poses = {_namespace(topic): topic for topic in _named(topics, 'pose', POSE)}
    _require(path, topics, poses, 'pose', POSE)
    _require(path, topics, truths, 'ground_truth', ODOMETRY)

    pairs: dict[str, dict[str, tuple[str, str]]] = defaultdict(dict)
    notes = []
    for namespace, topic in poses.items():
        home = _nearest(namespace, truths)
        if home is None:
            notes.append(f'{topic} has no ground truth and is not evaluated')
            continue
        method = namespace[len(home):].strip('/')
        pairs[method][home] = (topic, truths[home])
    if not pairs:
        raise BagError(
            f'{path}: no pose belongs to a ground truth: found {_list(poses.values())} and '
            f'{_list(truths.values())}, needed is one of each in the same namespace'
        )
    unlocalized = [home for home in truths if not any(home in pair for pair in pairs.values())]
    if unlocalized:
        notes.append(f'no pose topic, so not evaluated: {_list(map(_vehicle_name, unlocalized))}')

    trajectories = _decode(path, pairs, messages)
    anchor_ids, anchors, radio_range = _anchor_map(topics, messages)
    label = Path(path).resolve().name if label is None else label
    runs = []
    for method, vehicles in pairs.items():
        compared = {
            _vehicle_name(home): compare(trajectories[pose], trajectories[truth], skip, max_age)
            for home, (pose, truth) in vehicles.items()
        }
        run = Run(
            label=f'{label}/{method}' if len(pairs) > 1 and method else label,
            vehicles=compared,
            anchors=anchors,
            radio_range=radio_range,
            outages=_outages(vehicles, compared.values(), messages),
            notes=(*notes, *_left_out(compared.values())),
            anchor_ids=anchor_ids,
            conditions=_conditions(topics, messages, vehicles, compared),
            about=about,
        )
        if not any(len(part.error) for part in compared.values()):
            raise BagError(
                f'{path}: no pose lies in the time of its ground truth: poses span '
                f'{_span(trajectories[pose] for pose, _ in vehicles.values())}, truth spans '
                f'{_span(trajectories[truth] for _, truth in vehicles.values())}'
                + (f', of which the first {skip:g} s are skipped' if skip else '')
            )
        runs.append(run)
    return runs


def _read(path: str | Path, progress: Progress
          ) -> tuple[dict[str, str], dict[str, str], dict[str, list[bytes]]]:
    """Return what the bag is about, its topics with their types, and those of interest."""
    wanted = {'pose': POSE, 'ground_truth': ODOMETRY, 'beacons': POINT_CLOUD,
              'anchor_map': POINT_CLOUD, 'diagnostics': DIAGNOSTICS}
    messages: dict[str, list[bytes]] = defaultdict(list)
    with Reader(path) as reader:
        topics = dict(reader.topics)
        chosen = [topic for name, kind in wanted.items() for topic in _named(topics, name, kind)]
        total = sum(reader.counts[topic] for topic in chosen)
        for message in progress(reader.messages(chosen), total, 'msg', str(path)):
            messages[message.topic].append(message.data)
        return reader.about, topics, messages


def _named(topics: Mapping[str, str], name: str, kind: str) -> list[str]:
    """Return the topics with that last part and type, veh_2 before veh_10."""
    found = [topic for topic, its_kind in topics.items()
             if its_kind == kind and topic.rsplit('/', 1)[-1] == name]
    return sorted(found, key=lambda topic: (len(topic), topic))


def _require(path: str | Path, topics: Mapping[str, str], found: Mapping[str, str], name: str,
             kind: str) -> None:
    if not found:
        raise BagError(
            f'{path}: holds no {name}: needed is a topic NAMESPACE/{name} of type {kind}, found '
            f'{_list(topics)}'
        )


def _namespace(topic: str) -> str:
    return topic.rpartition('/')[0]


def _nearest(namespace: str, homes: Mapping[str, str]) -> str | None:
    """Return the namespace itself or the nearest one above it that is a home."""
    while namespace not in homes:
        if not namespace:
            return None
        namespace = _namespace(namespace)
    return namespace


def _vehicle_name(namespace: str) -> str:
    return namespace.strip('/') or 'vehicle'


def _list(names: Iterable[str]) -> str:
    names = list(names)
    shown = ', '.join(names[:6]) or 'none'
    return shown if len(names) <= 6 else f'{shown} and {len(names) - 6} more'


def _decode(path: str | Path, pairs: Mapping[str, Mapping[str, tuple[str, str]]],
            messages: Mapping[str, Sequence[bytes]]) -> dict[str, Trajectory]:
    """Return the trajectories of all pose and truth topics."""
    trajectories = {}
    for vehicles in pairs.values():
        for pair in vehicles.values():
            for topic, decode in zip(pair, (decode_poses, decode_odometries), strict=True):
                try:
                    trajectories[topic] = decode(messages.get(topic, ()))
                except MessageError as error:
                    raise MessageError(f'{path}: {topic}: {error}') from None
    return trajectories


def _anchor_map(topics: Mapping[str, str],
                messages: Mapping[str, Sequence[bytes]]) -> tuple[Array, Array, Array]:
    """Return ids (A,), positions (A, 3) and radio ranges (A,) of the first readable map."""
    for topic in _named(topics, 'anchor_map', POINT_CLOUD):
        for data in messages.get(topic, ()):
            try:
                observation, _ = decode_beacons(data)
            except MessageError:
                continue
            return observation.sender[0], observation.position[0], observation.max_range[0]
    return np.empty(0, np.int32), np.empty((0, 3), np.float32), np.empty(0, np.float32)


def _outages(homes: Iterable[str], compared: Iterable[Comparison],
             messages: Mapping[str, Sequence[bytes]]) -> tuple[tuple[float, float], ...]:
    """Return when none of the vehicles heard a beacon, though the bag holds beacons."""
    heard = []
    for home in homes:
        for data in messages.get(f'{home}/beacons', ()):
            try:
                observation = decode_scan(data).observation
            except MessageError:
                continue  # The localizer rejected it, too.
            if observation.heard.any():
                heard.append(observation.stamp)
    start, end = _evaluated(compared)
    if not heard or start > end:
        return ()
    inside = sorted(stamp for stamp in heard if start < stamp < end)
    edges = [start, *inside, end]
    return tuple(
        (begin, until) for begin, until in zip(edges, edges[1:], strict=False)
        if until - begin > OUTAGE
    )


def _conditions(
    topics: Mapping[str, str], messages: Mapping[str, Sequence[bytes]],
    vehicles: Mapping[str, tuple[str, str]], compared: Mapping[str, Comparison],
) -> dict[str, Condition]:
    """Return the conditions of those vehicles whose localizer diagnosed itself."""
    begin, end = _evaluated(compared.values())
    found = read_conditions(
        (data for topic in _named(topics, 'diagnostics', DIAGNOSTICS)
         for data in messages.get(topic, ())), begin, end)
    # A localizer names itself by the namespace in which its pose is.
    names = {_vehicle_name(home): _namespace(pose) or '/' for home, (pose, _) in vehicles.items()}
    return {name: found[namespace] for name, namespace in names.items() if namespace in found}


def _evaluated(compared: Iterable[Comparison]) -> tuple[float, float]:
    """Return from when to when anything was evaluated [s]."""
    parts = [part for part in compared if part.duration]
    return (min((part.end - part.duration for part in parts), default=math.inf),
            max((part.end for part in parts), default=-math.inf))


def _left_out(compared: Iterable[Comparison]) -> list[str]:
    count = sum(part.left_out for part in compared)
    return [f'{count} poses lie outside the time of the truth and are left out'] if count else []


def _span(trajectories: Iterable[Trajectory]) -> str:
    parts = [part.stamp for part in trajectories if len(part.stamp)]
    if not parts:
        return 'no time, as there is no message'
    return (f'{min(stamp[0] for stamp in parts):.3f} to '
            f'{max(stamp[-1] for stamp in parts):.3f} s')
