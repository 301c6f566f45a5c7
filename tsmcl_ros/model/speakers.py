"""
Who may speak: the anchors and vehicles that are heeded, and what all others said in vain.

An id is no proof of who sent a beacon; it takes the radio's own protection, and DDS security, to
keep others from using it. What this does is to leave out whoever does not even claim to be known.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.tally import listed, Tally
from tsmcl_ros.types import ANCHOR, Array, ConfigError, Links, Observation, PADDED, VEHICLE

_ALL, _MAP = 'all', 'map'
_MAX_ID = 2**32 - 1
_MOST_DIGITS = 20  # zeros in front included


@dataclass(frozen=True)
class SpeakerConfig(Config):
    """Who may speak: whose beacons and ranges are heeded."""

    anchor_allowlist: tuple[str, ...] = param(
        (_ALL,), "anchors that are heeded: 'all'; or any of 'map', those of /anchor_map and of "
        "anchors, ids, and spans of them such as '10-19'; what others say is ignored and counted",
        live=True, ids=True)
    vehicle_allowlist: tuple[str, ...] = param(
        (_ALL,), "vehicles, and references that move, that are heeded: 'all', or ids and spans of "
        'them; use_vehicles: false heeds none', live=True, ids=True)

    def check(self) -> None:
        """Hold that the lists can be read, and name somebody."""
        for name, words, allowed in (
            ('anchor_allowlist', self.anchor_allowlist, (_ALL, _MAP)),
            ('vehicle_allowlist', self.vehicle_allowlist, (_ALL,)),
        ):
            form = f"{', '.join(map(repr, allowed))}, an id, or a span of ids as '10-19'"
            if not words:
                raise ConfigError(f'{name}: an empty list is not allowed, must hold {form}')
            for word in words:
                if word not in allowed and _span(word) is None:
                    raise ConfigError(f'{name}: {word!r} is not allowed, must be {form}')


class Speakers(Tally):
    """
    Tells V vehicles whom to heed, and counts what others say.

    Parameters
    ----------
    config : SpeakerConfig
        Read at every use, as it may change.
    vehicles : int
        V.

    """

    def __init__(self, config: SpeakerConfig, vehicles: int):
        super().__init__(vehicles)
        self.config = config
        self._map = np.zeros(0, np.int64)

    @property
    def heed_all(self) -> bool:
        """Whether nobody is ignored."""
        return _ALL in self.config.anchor_allowlist and _ALL in self.config.vehicle_allowlist

    def learn_map(self, anchors: Observation) -> None:
        """Take over who stands in an anchor map (V = 1); several complete each other."""
        told = anchors.sender[(anchors.kind == ANCHOR) & anchors.heard]
        self._map = np.union1d(self._map, told)

    def heeds(self, identity: Array, kind: Array | int = ANCHOR) -> Array:
        """Return which of some senders are heeded, in their ids' shape."""
        return np.where(
            np.equal(kind, VEHICLE), self._listed(identity, self.config.vehicle_allowlist),
            self._listed(identity, self.config.anchor_allowlist))

    def heed(self, observation: Observation, vehicles: Iterable[int]) -> Observation:
        """
        Return what those said who are heeded; the rows of others are left out, and counted.

        Parameters
        ----------
        observation : Observation
            Of the given vehicles.
        vehicles : iterable of int
            Which of the V.

        """
        if self.heed_all:
            return observation
        others = observation.heard & ~self.heeds(observation.sender, observation.kind)
        if not others.any():
            return observation
        for vehicle, rows, senders in zip(vehicles, others, observation.sender, strict=True):
            self.count(vehicle, senders[rows].tolist())
        if len(others) == 1:
            # Without a trace: not even padding, which may change how sums are rounded.
            return observation.columns(np.flatnonzero(~others[0]))
        return replace(observation, sender=np.where(others, PADDED, observation.sender))

    def heed_links(self, links: Links) -> Links:
        """Return the links between those who are heeded."""
        if self.heed_all:
            return links
        return links.picked(self.heeds(links.receiver) & self.heeds(links.sender))

    def heed_silence(self, observation: Observation) -> Observation:
        """Return it without the silence of anchors who would not be heeded if they spoke."""
        silent = observation.silent
        if silent is None or self.heed_all:
            return observation
        return replace(observation, silent=replace(
            silent, known=silent.known & self.heeds(silent.sender)))

    def _listed(self, identity: Array, words: tuple[str, ...]) -> Array:
        if _ALL in words:
            return np.ones(np.shape(identity), bool)
        spans = _spans(words)
        number = np.asarray(identity)[..., None]
        named = ((number >= spans[:, 0]) & (number <= spans[:, 1])).any(axis=-1)
        return np.asarray(named | np.isin(identity, self._map) if _MAP in words else named)


def ignored_note(counts: Mapping[int, int]) -> str:
    """Say whose beacons, and how many of each sender, were left out as nobody knows them."""
    return (f'ignored beacons and ranges, {listed(counts)}, whom neither anchor_allowlist nor '
            'vehicle_allowlist names')


def _span(word: str) -> tuple[int, int] | None:
    """Return the first and the last id that a word stands for, None if it is no span."""
    first, dash, last = word.partition('-')
    ends = first.strip(), (last if dash else first).strip()
    if not all(end.isdecimal() and len(end) <= _MOST_DIGITS for end in ends):
        return None
    low, high = map(int, ends)
    return (low, high) if low <= high <= _MAX_ID else None


@lru_cache(maxsize=64)
def _spans(words: tuple[str, ...]) -> Array:
    """Return the spans (S, 2) int64 among the words."""
    found = [span for span in map(_span, words) if span is not None]
    return np.array(found, np.int64).reshape(-1, 2)
