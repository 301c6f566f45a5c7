"""Run a bag through the localizer, without DDS, as fast as the machine goes."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
import math
import re
import sys
from typing import Any

from tsmcl_ros.bag import Message, Reader, STORAGES, Writer
from tsmcl_ros.config import (
    add_arguments,
    build,
    dump_yaml,
    given_arguments,
    load_yaml,
    parameters,
)
from tsmcl_ros.endpoint import Endpoint, lag_note, OutputConfig
from tsmcl_ros.inputs import InputConfig, unplaced_note
from tsmcl_ros.localizer import CONFIGS, Localizer
from tsmcl_ros.model.speakers import ignored_note
from tsmcl_ros.model.tally import untrue_note
from tsmcl_ros.scripts.cli import add_quiet, command_line, progress, run_script
from tsmcl_ros.scripts.outlet import Outlet
from tsmcl_ros.scripts.wiring import copies, Remapping, vehicles, wire
from tsmcl_ros.topics import absolute
from tsmcl_ros.types import MessageError, Progress, unshown

# What a parameter file for the node may hold that has no meaning here.
_NODES_OWN = {'use_sim_time', 'autostart', 'require_security',
              *(item.name for item in parameters(OutputConfig))}
_MAX_REASONS = 5


def main(arguments: Sequence[str] | None = None) -> int:
    """Localize a bag from the command line and return the exit code."""
    return run_script(_localize, arguments)


def _localize(arguments: Sequence[str] | None) -> None:
    options = _parser().parse_args(arguments)
    file = load_yaml(options.params, 'localizer') if options.params else {}
    settings = {name: value for name, value in file.items() if name not in _NODES_OWN}
    settings |= given_arguments(options, InputConfig, *CONFIGS)
    frame_id = options.global_frame_id or build(OutputConfig, file).global_frame_id
    outcome = localize_bag(
        options.bag, options.out, settings, options.storage, frame_id,
        remap=options.remap, namespaces=options.namespace, show=progress(options.quiet),
        command=command_line('localize_bag', arguments))
    for note in outcome.notes():
        print(f'note: {note}', file=sys.stderr)
    print(f'{options.out}: {outcome.poses} poses, vehicles: {outcome.vehicles}')
    if outcome.calibrated:
        print(', '.join(f'{name} {value}' for name, value in outcome.calibrated.items()))


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
    undecodable : mapping of str to str
        Topics of the old bag whose types nobody defines, and these types.
    lag : float
        By how much the header stamps are before the log times at first [s], NaN if there are none.
    missing : sequence of str
        What is asked of the bag in vain, a line each.
    unplaced : mapping of int to int
        How many ranges of which sender were of no use, as nobody tells where it is.
    ignored : mapping of int to int
        How many beacons and ranges of which sender were ignored, as it may not speak.
    untrue : mapping of int to int
        How many beacons of which sender were left out, as they cannot be true.
    reason : str
        What is wrong with one of these.
    calibrated : mapping of str to str
        What was learnt of the radio, +- one standard deviation.
    rejected : Counter of (topic, reason)
        How often messages were rejected; numbers in the reasons are those of the first one.

    """

    vehicles: int
    poses: int = 0
    restarts: int = 0
    undecodable: Mapping[str, str] = field(default_factory=dict)
    lag: float = math.nan
    missing: Sequence[str] = ()
    unplaced: Mapping[int, int] = field(default_factory=dict)
    ignored: Mapping[int, int] = field(default_factory=dict)
    calibrated: Mapping[str, str] = field(default_factory=dict)
    untrue: Mapping[int, int] = field(default_factory=dict)
    reason: str = ''
    rejected: Counter[tuple[str, str]] = field(default_factory=Counter)
    _first: dict[tuple[str, str], str] = field(default_factory=dict)

    def reject(self, topic: str, reason: str) -> None:
        """Count a rejected message; reasons that differ in numbers only are one."""
        kind = topic, re.sub(r'\d+(\.\d+)?', '#', reason)
        self.rejected[topic, self._first.setdefault(kind, reason)] += 1

    @contextmanager
    def counting(self, topic: str) -> Iterator[None]:
        """Count a message of a topic that turns out to be none, and go on."""
        try:
            yield
        except MessageError as error:
            self.reject(topic, str(error))

    def notes(self) -> Iterator[str]:
        """Yield what a user ought to know, a line each."""
        for kind in sorted(set(self.undecodable.values())):
            topics = sorted(topic for topic, its in self.undecodable.items() if its == kind)
            yield f'skipped what is of type {kind}, which nobody defines: {", ".join(topics)}'
        if note := lag_note(self.lag):
            yield note
        yield from self.missing
        if self.unplaced:
            yield unplaced_note(self.unplaced)
        if self.ignored:
            yield ignored_note(self.ignored)
        if self.untrue:
            yield untrue_note(self.untrue, self.reason)
        if self.restarts:
            yield f'started anew where time jumped, {self.restarts} times'
        for (topic, reason), count in self.rejected.most_common(_MAX_REASONS):
            yield f'rejected {count} messages of {topic}: {reason}'
        if others := self.rejected.most_common()[_MAX_REASONS:]:
            count = sum(number for _, number in others)
            yield f'rejected {count} messages more, for {len(others)} other reasons'


def localize_bag(
    bag: str, out: str, settings: Mapping[str, Any], storage: str = STORAGES[0],
    frame_id: str = 'map', remap: Sequence[str] = (), namespaces: Sequence[str] = (),
    show: Progress = unshown, command: str = '',
) -> Outcome:
    """
    Localize every vehicle of a bag and write a bag with the poses.

    The new bag has, beside `NAMESPACE/pose` and `/diagnostics`, what an evaluation needs of the
    old one: anchors, beacons, also those gathered from ranges, and ground truth. A pose's log
    time is that of the message that made it due. How it was made is left in it, and how the old
    one was.

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
    remap : sequence of str
        Rules FROM:=TO, by which a topic of the bag stands for one that is listened to, or for
        ground truth, which becomes Odometry.
    namespaces : sequence of str
        Of the vehicles; by default all that have beacons or ranges.
    show : Progress
        Shows how much of the bag is done.
    command : str
        The command line, if there is one.

    Raises
    ------
    BagError
        If the bag cannot be read or has not what is asked for, or the new one exists.
    ConfigError
        If the settings are not allowed.

    """
    with Reader(bag) as reader:
        inputs = build(InputConfig, settings)
        remapping = Remapping(remap)
        names = [absolute(name, '/') for name in namespaces] or vehicles(reader, inputs)
        silent = remapping.silent(reader, names)
        outcome = Outcome(len(names), undecodable=reader.undecodable)
        own = {item.name for item in parameters(InputConfig)}
        localizer = Localizer(
            {name: value for name, value in settings.items() if name not in own}, len(names))
        endpoint = Endpoint(localizer, names, frame_id, inputs)
        takers = wire(endpoint, names, remapping, reader)
        outcome.missing = [*silent, *endpoint.ranges.unmet(reader.topics)]
        kept = copies(names, remapping, reader.topics)
        wanted = kept.keys() | takers.keys()
        about = {
            **({'command': command} if command else {}),
            'localizer': dump_yaml(inputs, *localizer.configs, commented=False),
            **{f'input: {name}': text for name, text in reader.about.items()},
        }
        with Writer(out, storage, about) as writer:
            for topic in sorted(kept):
                for copy in kept[topic]:
                    writer.topic(copy.topic, copy.type, topic in reader.latched)
            outlet = Outlet(endpoint, names, writer)
            outlet.stamp = reader.start
            if inputs.anchors:
                outlet.write_anchors()
            total = sum(reader.counts[topic] for topic in wanted)
            for message in show(reader.messages(wanted), total, 'msg', 'localizing'):
                outlet.stamp = message.stamp
                for copy in kept.get(message.topic, ()):
                    with outcome.counting(message.topic):
                        writer.write(copy.topic, message.stamp, copy.convert(message.data))
                if message.topic not in takers:
                    continue
                for kind, handler in takers[message.topic]:
                    with outcome.counting(message.topic):
                        _hand(handler, kind, message)
                for vehicle, error in localizer.refused():
                    outcome.reject(names[vehicle] or '/', str(error))
                if math.isnan(outcome.lag) and localizer.now > -math.inf:
                    outcome.lag = message.stamp - localizer.now
                outlet.write(localizer.due())
            with outcome.counting('the last epochs'):
                endpoint.ranges.gather(math.inf)
            outlet.write(localizer.finish())
    outcome.poses = outlet.poses
    outcome.unplaced = endpoint.ranges.unplaced
    outcome.ignored = localizer.speakers.senders
    outcome.untrue, outcome.reason = localizer.untrue.senders, localizer.untrue.reason
    outcome.calibrated = localizer.channel.calibrated(untaught=False)
    outcome.restarts = localizer.restarts
    return outcome


def _hand(handler: Callable[[bytes], None], kind: str, message: Message) -> None:
    if message.type != kind:
        raise MessageError(f'type {message.type} is not allowed, must be {kind}')
    handler(message.data)


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
    parser.add_argument('--remap', action='append', default=[], metavar='FROM:=TO',
                        help='let a topic of the bag stand for another, as ROS does; also '
                        'ground_truth:=TOPIC, for an evaluation')
    parser.add_argument('--namespace', action='append', default=[], metavar='NAME',
                        help='namespace of a vehicle (default: all that have beacons or ranges)')
    add_quiet(parser)
    add_arguments(parser, InputConfig, *CONFIGS)
    return parser


if __name__ == '__main__':
    sys.exit(main())
