"""
Ranges as drivers publish them, and where their senders are: topics found by name and pattern.

A driver of ranging radios publishes sensor_msgs/Range, a topic for each pair of radios, and tells
who was measured in the topic's name or in frame_id. Where that sender is, an anchor map says, or
a parameter, or, if it moves, a topic of its poses. Nodes and offline runs listen by the same code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
import math
import re
from typing import TypeVar

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.config import Config, param
from tsmcl_ros.gathering import Gatherer, Reading, Track
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.model.tally import listed
from tsmcl_ros.topics import absolute, compiled, few, match_topic, of_kinds
from tsmcl_ros.types import ANCHOR, Array, ConfigError, MessageError, Observation, VEHICLE

Handler = Callable[[bytes], None]
T = TypeVar('T')

_MAX_ID = 2**32 - 1


@dataclass(frozen=True)
class InputConfig(Config):
    """Ranges from drivers' own topics, beside beacons, and where their senders are."""

    ranges: tuple[str, ...] = param(
        (), 'topics of sensor_msgs/Range, or regular expressions that match whole ones, relative '
        'to the namespace or absolute; the number in a group names the sender, without a group '
        'that in frame_id; silence is no evidence then')
    range_epoch: float = param(
        0.1, 'ranges of this time are one epoch; the vehicle should move by less than a range '
        'errs in it', unit='s', above=0.0)
    anchors: tuple[str, ...] = param(
        (), "anchors, beside those of /anchor_map, each 'id x y' or 'id x y z' [m]")
    references: tuple[str, ...] = param(
        (), "senders that move, each 'id topic' of PoseStamped, PoseWithCovarianceStamped or "
        'Odometry')
    reference_std: float = param(
        0.1, 'standard deviation of poses of references that do not tell theirs', unit='m',
        above=0.0)
    reference_age: float = param(
        1.0, 'how far from a range the pose of a reference may be in time', unit='s', above=0.0)

    def check(self) -> None:
        """Hold that patterns, anchors and references can be read, and no id comes twice."""
        compiled('ranges', self.ranges)
        both = self.anchor_positions.keys() & self.reference_topics.keys()
        if both:
            raise ConfigError(
                f'references: id {min(both)} is not allowed, stands in anchors too: an id has one '
                'sender')

    @property
    def anchor_positions(self) -> dict[int, Array]:
        """Position (3,) [m] of each anchor."""
        return _table('anchors', self.anchors, "'id x y' or 'id x y z'", _position)

    @property
    def reference_topics(self) -> dict[int, str]:
        """Topic of each reference's poses."""
        return _table('references', self.references, "'id topic'", _topic)


class RangeInput:
    """
    Turns ranges and poses of references into the beacons that a localizer takes.

    Parameters
    ----------
    config : InputConfig
        What is listened to.
    localizer : Localizer
        Of V vehicles.
    names : sequence of str
        Namespace of each vehicle; '' for the node's own.
    frame_id : str
        The map's frame.

    Attributes
    ----------
    heed_epoch : callable
        Takes the vehicle's index and its observation (V = 1, D = 3) of each epoch gathered.

    Raises
    ------
    ConfigError
        If an epoch of ranges is longer than epochs wait.

    """

    def __init__(self, config: InputConfig, localizer: Localizer, names: Sequence[str],
                 frame_id: str) -> None:
        self.heed_epoch: Callable[[int, Observation], None] = localizer.beacons
        self._config, self._localizer, self._names = config, localizer, names
        self._frame_id = frame_id
        if config.ranges and config.range_epoch > localizer.config.max_wait:
            raise ConfigError(
                f'range_epoch: {config.range_epoch:g} is not allowed, must be at most max_wait, '
                f'{localizer.config.max_wait:g} s')
        if config.ranges:
            # Radios are asked for ranges one after the other: not to be asked is not to be far.
            localizer.ignore_silence()
        self._patterns = compiled('ranges', config.ranges)
        self._gatherer = Gatherer(len(names), config.range_epoch, config.reference_age)
        self._gatherer.references = {sender: Track() for sender in config.reference_topics}
        self._known: set[str] = set()
        self._matched: set[re.Pattern[str]] = set()
        self._restarts = localizer.restarts
        if config.anchors:
            localizer.anchor_map(self.anchors)
            self.learn_map(self.anchors)

    @property
    def anchors(self) -> Observation:
        """The anchors of the parameter, as a map (V = 1, D = 3)."""
        table = self._config.anchor_positions
        scan = Observation.empty(1, len(table), 3, 0.0)
        scan.sender[0] = list(table)
        scan.position[0] = np.reshape(list(table.values()), (-1, 3))
        return scan

    @property
    def unplaced(self) -> Mapping[int, int]:
        """How many ranges of which sender were of no use, as nobody tells where it is."""
        return self._gatherer.unplaced

    def learn_map(self, anchors: Observation) -> None:
        """Take over where anchors are (V = 1)."""
        for row in np.flatnonzero(anchors.kind[0] == ANCHOR).tolist():
            self._gatherer.anchors[int(anchors.sender[0, row])] = anchors.position[0, row]

    def discover(self, topics: Mapping[str, str], namespace: str = '/'
                 ) -> dict[str, tuple[str, Handler]]:
        """
        Return type and handler of those topics that are to be listened to and were not known.

        Parameters
        ----------
        topics : mapping of str to str
            Type of each topic that there is, by its absolute name.
        namespace : str
            The node's own.

        """
        found: dict[str, tuple[str, Handler]] = {}
        senders = {absolute(topic, namespace): sender
                   for sender, topic in self._config.reference_topics.items()}
        for topic in sorted(topics.keys() - self._known):
            kind = topics[topic]
            if topic in senders and kind in messages.POSES:
                found[topic] = kind, self._reference_handler(senders[topic], kind)
            elif kind == messages.RANGE and (handler := self._range_handler(topic, namespace)):
                found[topic] = kind, handler
        self._known.update(topics)
        return found

    def unmet(self, topics: Mapping[str, str], namespace: str = '/') -> list[str]:
        """Return what is asked for in vain, a line each, where these are all topics."""
        there = sorted(topic for topic, kind in topics.items() if kind == messages.RANGE)
        lines = [
            f"ranges: '{pattern.pattern}' matches no topic of {messages.RANGE}, of which there "
            f'{"are " + few(there) if there else "is none"}'
            for pattern in self._patterns if pattern not in self._matched]
        allowed = ', '.join(messages.POSES)
        for sender, topic in self._config.reference_topics.items():
            kind = topics.get(absolute(topic, namespace))
            if kind not in messages.POSES:
                lines.append(
                    f'references: topic {topic} of id {sender} '
                    + (f'has type {kind}, must have one of {allowed}' if kind else
                       f'is not there, must be one of {few(of_kinds(topics, messages.POSES))}'))
        return lines

    def gather(self, now: float | None = None) -> None:
        """
        Hand the epochs that are complete to the localizer; at a time of infinity [s], all.

        Raises
        ------
        MessageError
            If the localizer refuses one of them; the others have been handed over.

        """
        self._note_restarts()
        now = self._localizer.now if now is None else now
        refused: MessageError | None = None
        for vehicle, scan in self._gatherer.due(now, self._localizer.config.max_wait):
            try:
                self.heed_epoch(vehicle, scan)
            except MessageError as error:
                refused = refused or error
        if refused is not None:
            raise refused

    def _range_handler(self, topic: str, namespace: str) -> Handler | None:
        """Return what takes the ranges of a topic, for all vehicles that a pattern names it to."""
        whose = []
        for vehicle, name in enumerate(self._names):
            if match := self._match(topic, name or namespace):
                text = next((group for group in match.groups() if group), None)
                self._gatherer.expect(vehicle, topic)
                whose.append((vehicle, text))
        return (lambda data: self._take_range(topic, whose, data)) if whose else None

    def _match(self, topic: str, namespace: str) -> re.Match[str] | None:
        for pattern in self._patterns:
            if match := match_topic(pattern, topic, namespace):
                self._matched.add(pattern)
                return match
        return None

    def _take_range(self, topic: str, whose: Iterable[tuple[int, str | None]], data: bytes
                    ) -> None:
        reading = messages.decode_range(data)
        for vehicle, text in whose:
            sender = _sender(reading.frame_id if text is None else text, text is not None)
            self._take(vehicle, topic, Reading(
                reading.stamp, sender, reading.range, math.sqrt(reading.variance)))
        self.gather()

    def _take(self, vehicle: int, topic: str, reading: Reading) -> None:
        """Take in a range of a vehicle, if it is in time."""
        self._note_restarts()
        if not self._localizer.schedule.admit(
                'range', vehicle, reading.stamp,
                self._gatherer.last(vehicle, topic, reading.sender),
                partial(self._take, vehicle, topic, reading)):
            return
        self.gather()
        if not self._is_heeded(vehicle, reading.sender):
            reading = replace(reading, range=math.nan)
        self._gatherer.add(vehicle, topic, reading)
        self._localizer.clock(reading.stamp)

    def _note_restarts(self) -> None:
        """Forget what waits where the localizer has started anew."""
        if self._localizer.restarts != self._restarts:
            self._restarts = self._localizer.restarts
            self._gatherer.reset()

    def _is_heeded(self, vehicle: int, sender: int) -> bool:
        """Tell whether a sender may speak, and count a range to one that may not."""
        speakers = self._localizer.speakers
        moves = sender in self._gatherer.references
        if speakers.heed_all or speakers.heeds(np.array(sender), VEHICLE if moves else ANCHOR):
            return True
        speakers.count(vehicle, [sender])
        return False

    def _reference_handler(self, sender: int, kind: str) -> Handler:
        unknown = self._config.reference_std ** 2 * np.eye(3)

        def take(data: bytes) -> None:
            pose = messages.decode_any_pose(kind, data)
            if pose.frame_id != self._frame_id:
                raise MessageError(
                    f'reference {sender}: frame_id {pose.frame_id!r} is not allowed, must be '
                    f'{self._frame_id!r}, as global_frame_id says')
            covariance = pose.covariance[:3, :3]
            told = np.diagonal(covariance).any()
            self._gatherer.move(
                sender, pose.stamp, pose.position, covariance if told else unknown)
            self.gather()

        return take


def unplaced_note(counts: Mapping[int, int]) -> str:
    """Say what to do about ranges, so many of each sender, that nobody has placed."""
    return (
        f'left out ranges, {listed(counts)}, as nobody tells where these are: give their places '
        'in anchors, or their topics of poses in references, or leave their ranges out')


def _sender(text: str, is_group: bool) -> int:
    """Return the id that a topic's group or a frame_id names: its last number."""
    numbers = re.findall(r'\d+', text)
    # Python takes no number of more than 4300 digits.
    digits = numbers[-1].lstrip('0') or '0' if numbers else ''
    if 0 < len(digits) <= len(str(_MAX_ID)) and int(digits) <= _MAX_ID:
        return int(digits)
    if is_group:
        raise MessageError(
            f'{text!r} in the name of the topic names no sender, must hold a number')
    raise MessageError(
        f'frame_id {text!r} names no sender, must hold a number; or let a group in ranges, as in '
        r"'/uwb/n_(\d+)', name it")


def _table(parameter: str, rows: Iterable[str], form: str, parse: Callable[[list[str]], T]
           ) -> dict[int, T]:
    """Return what follows the id in each row, by the id."""
    table: dict[int, T] = {}
    for row in rows:
        identity, *rest = row.split() or ['']
        try:
            if not identity.isdecimal() or int(identity) > _MAX_ID:
                raise ValueError
            value = parse(rest)
        except ValueError:
            raise ConfigError(f'{parameter}: {row!r} is not allowed, must be {form}') from None
        if int(identity) in table:
            raise ConfigError(f'{parameter}: id {identity} comes twice, must come once')
        table[int(identity)] = value
    return table


def _position(words: list[str]) -> Array:
    values = [float(word) for word in words]
    if len(values) not in (2, 3) or not all(
            abs(value) <= messages.MAX_COORDINATE for value in values):
        raise ValueError
    return np.array([*values, 0.0][:3])


def _topic(words: list[str]) -> str:
    topic, = words
    return topic
