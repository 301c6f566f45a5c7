"""Run a bag through the localizer, without DDS, as fast as the machine goes."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
import re
import sys
from typing import Any

from tqdm import tqdm
from tsmcl_ros import messages
from tsmcl_ros.bag import Message, Reader, STORAGES, Writer
from tsmcl_ros.config import add_arguments, given_arguments, load_yaml
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.localizer import CONFIGS, Localizer
from tsmcl_ros.scripts.cli import run_script
from tsmcl_ros.types import BagError, MessageError

# Carried over to the new bag, so that it can be evaluated by itself.
_CONTEXT = re.compile('.*/(anchor_map|beacons|ground_truth)')


def main(arguments: Sequence[str] | None = None) -> int:
    """Localize a bag from the command line and return the exit code."""
    return run_script(_localize, arguments)


def _localize(arguments: Sequence[str] | None) -> None:
    options = _parser().parse_args(arguments)
    settings: dict[str, Any] = load_yaml(options.params, 'localizer') if options.params else {}
    settings |= given_arguments(options, *CONFIGS)
    rejected = localize_bag(
        options.bag, options.out, settings, options.storage, progress=not options.quiet)
    for reason, count in rejected.items():
        print(f'rejected {count} messages: {reason}', file=sys.stderr)
    print(options.out)


def localize_bag(
    bag: str, out: str, settings: dict[str, Any], storage: str = STORAGES[0],
    progress: bool = False,
) -> Counter[str]:
    """
    Localize every vehicle of a bag and write a bag with the poses.

    The new bag has, beside `NAMESPACE/pose`, what an evaluation needs of the old one: anchors,
    beacons and ground truth. A pose's log time is its stamp's, as far as the other messages
    allow.

    Parameters
    ----------
    bag, out : str
        Folders of the old and the new bag.
    settings : dict
        Parameters of the localizer.
    storage : str
        Of the new bag.
    progress : bool
        Show a progress bar where standard error is a terminal.

    Returns
    -------
    Counter of str
        How often a message was rejected, by topic and reason.

    Raises
    ------
    BagError
        If the bag cannot be read or has no beacons, or the new one exists.
    ConfigError
        If the settings are not allowed.
    """
    rejected: Counter[str] = Counter()
    with Reader(bag) as reader:
        names = _vehicles(reader)
        localizer = Localizer(settings, len(names))
        endpoint = Endpoint(localizer, names)
        kept = {topic for topic in reader.topics if _CONTEXT.fullmatch(topic)}
        wanted = kept | (set(endpoint.inputs) & set(reader.topics))
        with Writer(out, storage) as writer:
            for topic in sorted(kept):
                writer.topic(topic, reader.topics[topic], topic in reader.latched)
            for topic in endpoint.outputs:
                writer.topic(topic, messages.POSE, latched=True)
            total = sum(reader.counts[topic] for topic in wanted)
            stamp = reader.start
            for message in tqdm(reader.messages(wanted), total=total, unit='msg',
                                disable=None if progress else True, leave=False):
                stamp = message.stamp
                if message.topic in kept:
                    writer.write(message.topic, stamp, message.data)
                _feed(endpoint, message, rejected)
                _write_due(endpoint, localizer.due(), writer, stamp)
            _write_due(endpoint, localizer.finish(), writer, stamp)
    return rejected


def _feed(endpoint: Endpoint, message: Message, rejected: Counter[str]) -> None:
    """Hand one message to the localizer, counting it if it is rejected."""
    kind, handler = endpoint.inputs.get(message.topic, ('', None))
    if handler is None:
        return
    try:
        if message.type != kind:
            raise MessageError(f'type {message.type} is not allowed, must be {kind}')
        handler(message.data)
    except MessageError as error:
        # Without its numbers a reason counts as one, however often it comes.
        rejected[re.sub(r'-?\d+\.\d+', '#', f'{message.topic}: {error}')] += 1


def _write_due(endpoint: Endpoint, estimates: list[Any], writer: Writer, stamp: float) -> None:
    for estimate in estimates:
        for vehicle, pose in endpoint.poses(estimate):
            writer.write(endpoint.outputs[vehicle], stamp, pose)


def _vehicles(reader: Reader) -> list[str]:
    """Return the namespaces that have beacons, in the order of their numbers."""
    found = [
        topic.removesuffix('/beacons') for topic, kind in reader.topics.items()
        if topic.endswith('/beacons') and topic != '/beacons' and kind == messages.POINT_CLOUD]
    if not found:
        raise BagError(
            f'{reader.path}: has no topic NAMESPACE/beacons of type {messages.POINT_CLOUD}, has '
            f'{", ".join(sorted(reader.topics))}')
    return sorted(found, key=lambda name: [
        int(part) if part.isdigit() else part for part in re.split(r'(\d+)', name)])


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='localize_bag', description='Run a bag through the localizer and write its poses.')
    parser.add_argument('bag', help='folder of the bag')
    parser.add_argument('--out', required=True, help='folder of the bag to make; must not exist')
    parser.add_argument('--params', metavar='FILE', help='ROS parameter file (YAML)')
    parser.add_argument('--storage', choices=STORAGES, default=STORAGES[0],
                        help='storage of the new bag (default: %(default)s)')
    parser.add_argument('--quiet', action='store_true', help='show no progress')
    add_arguments(parser, *CONFIGS)
    return parser


if __name__ == '__main__':
    sys.exit(main())
