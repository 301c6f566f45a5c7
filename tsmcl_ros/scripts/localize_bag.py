"""Run a bag through the localizer, without DDS, as fast as the machine goes."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import re
import sys
from typing import Any

import numpy as np
from tqdm import tqdm
from tsmcl_ros import messages
from tsmcl_ros.bag import Message, Reader, STORAGES, Writer
from tsmcl_ros.config import (
    add_arguments,
    build,
    dump_yaml,
    given_arguments,
    load_yaml,
    parameters,
)
from tsmcl_ros.diagnosis import diagnose, DIAGNOSTICS_PERIOD
from tsmcl_ros.endpoint import Endpoint, OutputConfig, Rest
from tsmcl_ros.localizer import CONFIGS, Localizer
from tsmcl_ros.scripts.cli import command_line, run_script
from tsmcl_ros.types import BagError, Estimate, MessageError

# Carried over to the new bag, so that it can be evaluated by itself.
_CONTEXT = {
    'anchor_map': messages.POINT_CLOUD,
    'anchor_links': messages.POINT_CLOUD,
    'beacons': messages.POINT_CLOUD,
    'ground_truth': messages.ODOMETRY,
}
# What a parameter file for the node may hold that has no meaning here.
_NODES_OWN = {'use_sim_time', 'autostart', *(item.name for item in parameters(OutputConfig))}
_MAX_REASONS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    """Localize a bag from the command line and return the exit code."""
    return run_script(_localize, arguments)


def _localize(arguments: Sequence[str] | None) -> None:
    options = _parser().parse_args(arguments)
    file = load_yaml(options.params, 'localizer') if options.params else {}
    settings = {name: value for name, value in file.items() if name not in _NODES_OWN}
    settings |= given_arguments(options, *CONFIGS)
    frame_id = options.global_frame_id or build(OutputConfig, file).global_frame_id
    outcome = localize_bag(
        options.bag, options.out, settings, options.storage, frame_id,
        progress=not options.quiet, command=command_line('localize_bag', arguments))
    for note in outcome.notes():
        print(f'note: {note}', file=sys.stderr)
    print(f'{options.out}: {outcome.poses} poses, vehicles: {outcome.vehicles}')


@dataclass
class Outcome:
    """
    What became of a bag.

    Attributes
    ----------
    vehicles, poses : int
        How many there are in the new bag.
    restarts : int
        How often time jumped, so that the localizer started anew.
    rejected : Counter of (topic, reason)
        How often messages were rejected; numbers in the reasons are those of the first one.
    """

    vehicles: int
    poses: int = 0
    restarts: int = 0
    rejected: Counter[tuple[str, str]] = field(default_factory=Counter)
    _first: dict[tuple[str, str], str] = field(default_factory=dict)

    def reject(self, topic: str, reason: str) -> None:
        """Count a rejected message; reasons that differ in numbers only are one."""
        kind = topic, re.sub(r'\d+(\.\d+)?', '#', reason)
        self.rejected[topic, self._first.setdefault(kind, reason)] += 1

    def notes(self) -> Iterator[str]:
        """Yield what a user ought to know, a line each."""
        if self.restarts:
            yield f'started anew where time jumped, {self.restarts} times'
        for (topic, reason), count in self.rejected.most_common(_MAX_REASONS):
            yield f'rejected {count} messages of {topic}: {reason}'
        if others := self.rejected.most_common()[_MAX_REASONS:]:
            count = sum(number for _, number in others)
            yield f'rejected {count} messages more, for {len(others)} other reasons'


def localize_bag(
    bag: str, out: str, settings: Mapping[str, Any], storage: str = STORAGES[0],
    frame_id: str = 'map', progress: bool = False, command: str = '',
) -> Outcome:
    """
    Localize every vehicle of a bag and write a bag with the poses.

    The new bag has, beside `NAMESPACE/pose` and `/diagnostics`, what an evaluation needs of the
    old one: anchors, beacons and ground truth. A pose's log time is that of the message that made
    it due. How it was made is left in it, and how the old one was.

    Parameters
    ----------
    bag, out : str
        Folders of the old and the new bag.
    settings : mapping
        Parameters of the localizer.
    storage : str
        Of the new bag.
    frame_id : str
        The map's frame.
    progress : bool
        Show a progress bar where standard error is a terminal.
    command : str
        The command line, if there is one.

    Raises
    ------
    BagError
        If the bag cannot be read or has no beacons, or the new one exists.
    ConfigError
        If the settings are not allowed.
    """
    with Reader(bag) as reader:
        names = _vehicles(reader)
        outcome = Outcome(len(names))
        localizer = Localizer(settings, len(names))
        endpoint = Endpoint(localizer, names, frame_id)
        kept = {topic for topic, kind in reader.topics.items()
                if _CONTEXT.get(topic.rpartition('/')[2]) == kind}
        wanted = kept | (set(endpoint.inputs) & set(reader.topics))
        about = {
            **({'command': command} if command else {}),
            'localizer': dump_yaml(*localizer.configs, commented=False),
            **{f'input: {name}': text for name, text in reader.about.items()},
        }
        with Writer(out, storage, about) as writer:
            for topic in sorted(kept):
                writer.topic(topic, reader.topics[topic], topic in reader.latched)
            for topic in endpoint.outputs:
                writer.topic(topic, messages.POSE, latched=True)
            writer.topic('/diagnostics', messages.DIAGNOSTICS)
            outlet = _Outlet(endpoint, names, writer)
            total = sum(reader.counts[topic] for topic in wanted)
            stamp = reader.start
            for message in tqdm(reader.messages(wanted), total=total, unit='msg',
                                disable=None if progress else True, leave=False):
                stamp = message.stamp
                if message.topic in kept:
                    writer.write(message.topic, stamp, message.data)
                _feed(endpoint, message, outcome)
                outcome.poses += outlet.write(localizer.due(), stamp)
            outcome.poses += outlet.write(localizer.finish(), stamp)
    outcome.restarts = localizer.restarts
    return outcome


def _feed(endpoint: Endpoint, message: Message, outcome: Outcome) -> None:
    """Hand one message to the localizer, counting it if it is rejected."""
    kind, handler = endpoint.inputs.get(message.topic, ('', None))
    if handler is None:
        return
    try:
        if message.type != kind:
            raise MessageError(f'type {message.type} is not allowed, must be {kind}')
        handler(message.data)
    except MessageError as error:
        outcome.reject(message.topic, str(error))


class _Outlet:
    """
    Writes what an endpoint's localizer says into the new bag.

    Parameters
    ----------
    endpoint : Endpoint
    names : sequence of str
        Namespaces of its vehicles.
    writer : Writer
        With the topics registered.
    """

    def __init__(self, endpoint: Endpoint, names: Sequence[str], writer: Writer):
        self._endpoint = endpoint
        self._names = names
        self._writer = writer
        self._rest = Rest()
        self._status = np.full(len(names), -1)

    def write(self, estimates: list[Estimate], stamp: float) -> int:
        """Write what has become due at a log time [s]; return the number of poses."""
        poses = [pose for estimate in estimates for pose in self._endpoint.poses(estimate)]
        for vehicle, data in poses:
            self._writer.write(self._endpoint.outputs[vehicle], stamp, data)
        if estimates:
            self._diagnose(estimates[-1].stamp, stamp)
        return len(poses)

    def _diagnose(self, now: float, stamp: float) -> None:
        """Write how the vehicles are doing, now and then and when it changes."""
        localizer = self._endpoint.localizer
        status = localizer.health.status
        changed = (status != self._status).any()
        if self._rest.is_over(now, DIAGNOSTICS_PERIOD) or changed:
            self._status = status
            self._writer.write('/diagnostics', stamp, messages.encode_diagnostics(
                now, diagnose(localizer, self._names, 'localize_bag', status, {})))


def _vehicles(reader: Reader) -> list[str]:
    """Return the namespaces that have beacons, in the order of their numbers."""
    topics = [
        topic for topic, kind in reader.topics.items()
        if topic.endswith('/beacons') and topic != '/beacons' and kind == messages.POINT_CLOUD]
    if not topics:
        raise BagError(
            f'{reader.path}: has no topic NAMESPACE/beacons of type {messages.POINT_CLOUD}, has '
            f'{", ".join(sorted(reader.topics))}')
    if not any(reader.counts[topic] for topic in topics):
        raise BagError(f'{reader.path}: has no message on {", ".join(sorted(topics))}')
    return sorted((topic.removesuffix('/beacons') for topic in topics), key=lambda name: [
        int(part) if part.isdigit() else part for part in re.split(r'(\d+)', name)])


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='localize_bag', description='Run a bag through the localizer and write its poses.')
    parser.add_argument('bag', help='folder of the bag')
    parser.add_argument('--out', required=True, help='folder of the bag to make; must not exist')
    parser.add_argument('--params', metavar='FILE', help='ROS parameter file (YAML)')
    parser.add_argument('--storage', choices=STORAGES, default=STORAGES[0],
                        help='storage of the new bag (default: %(default)s)')
    parser.add_argument('--global-frame-id', metavar='NAME',
                        help="the map's frame (default: that of the parameter file, or map)")
    parser.add_argument('--quiet', action='store_true', help='show no progress')
    add_arguments(parser, *CONFIGS)
    return parser


if __name__ == '__main__':
    sys.exit(main())
