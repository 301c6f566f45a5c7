"""What radios hear in an epoch, and whom they do not hear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from tsmcl_ros.types.arrays import Array, items

# Rows of an observation: whose each is, (M,) int in increasing order, and what they say by field.
Rows = tuple[Array, Mapping[str, Array]]

ANCHOR, VEHICLE = 0, 1
# A sender that says what cannot be true: it was heard, and is left out.
UNTRUE = 2
PADDED = -1
_ID_BITS = 32


@dataclass(frozen=True, eq=False)
class Silence:
    """
    Known anchors that V radios did not hear in an epoch, padded to S rows a vehicle.

    Attributes
    ----------
    known : (V, S) bool
        False where padded.
    sender : (V, S) int64
        Their identities.
    position : (V, S, D) float32
        [m].
    max_range : (V, S) float32
        Radio range [m], NaN where unknown.
    miss_rate : (V, S) float32 or None
        How probable it is that they are not heard however near; None for never.

    """

    known: Array
    sender: Array
    position: Array
    max_range: Array
    miss_rate: Array | None = None

    def of(self, index: Array) -> Silence:
        """Return what these vehicles did not hear, padding and all."""
        return Silence(
            self.known[index], self.sender[index], self.position[index], self.max_range[index],
            None if self.miss_rate is None else self.miss_rate[index])


@dataclass(frozen=True, eq=False)
class Observation:
    """
    What V radios heard in one beacon epoch, padded to K rows a vehicle.

    Attributes
    ----------
    stamp : float
        Reception time [s].
    sender : (V, K) int64
        Identity of each sender, -1 where padded.
    kind : (V, K) uint8
        0 for an anchor, 1 for a vehicle, 2 for whoever says what cannot be true.
    hops : (V, K) uint8
        1 if heard directly, 2 if relayed by a neighbour.
    position : (V, K, D) float32
        Position that the sender claims [m].
    covariance : (V, K, D, D) float32
        Covariance of that position [m^2]; zero for a surveyed anchor.
    max_range, range, range_std, rssi : (V, K) float32
        Radio range [m], measured range and its standard deviation [m], received power [dBm];
        NaN where not measured.
    silent : Silence or None
        Known anchors not heard, where their silence is to count as evidence.

    """

    stamp: float
    sender: Array
    kind: Array
    hops: Array
    position: Array
    covariance: Array
    max_range: Array
    range: Array
    range_std: Array
    rssi: Array
    silent: Silence | None = None

    @classmethod
    def empty(cls, vehicles: int, references: int, dimension: int, stamp: float) -> Observation:
        """Return an observation of V vehicles and K rows in which nobody was heard."""
        shape = (vehicles, references)
        unmeasured = np.full(shape, np.nan, np.float32)
        return cls(
            stamp=stamp,
            sender=np.full(shape, PADDED, np.int64),
            kind=np.zeros(shape, np.uint8),
            hops=np.ones(shape, np.uint8),
            position=np.zeros((*shape, dimension), np.float32),
            covariance=np.zeros((*shape, dimension, dimension), np.float32),
            max_range=unmeasured,
            range=unmeasured.copy(),
            range_std=unmeasured.copy(),
            rssi=unmeasured.copy(),
        )

    @classmethod
    def stack(cls, parts: list[Observation], stamp: float) -> Observation:
        """Return one observation of all the parts' vehicles, padded to the longest part."""
        vehicles = sum(part.sender.shape[0] for part in parts)
        references = max((part.sender.shape[1] for part in parts), default=0)
        dimension = parts[0].position.shape[2] if parts else 2
        whole = cls.empty(vehicles, references, dimension, stamp)
        row = 0
        for part in parts:
            count, width = part.sender.shape
            for name in _ROW_FIELDS:
                getattr(whole, name)[row:row + count, :width] = getattr(part, name)
            row += count
        return whole

    @classmethod
    def tabulate(cls, vehicle: Array, rows: Mapping[str, Array], vehicles: int, dimension: int,
                 stamp: float) -> Observation:
        """
        Return an observation of V vehicles, padded to the most rows that one of them has.

        Parameters
        ----------
        vehicle : (M,) int
            Whose each row is; in increasing order.
        rows : mapping of str to (M, ...) array
            What the rows say, by field; the others are as in `empty`.
        vehicles, dimension : int
            V and D.
        stamp : float
            [s].

        """
        return cls._assemble([(vehicle, rows)], vehicles, dimension, stamp)

    @classmethod
    def join(cls, parts: Sequence[Observation]) -> Observation:
        """Return what the same V vehicles heard in several ways, one after the other."""
        first, *others = parts
        return first.followed_by([part.rows() for part in others])

    def followed_by(self, parts: Sequence[Rows]) -> Observation:
        """Return it with further rows of its vehicles behind those that it has."""
        vehicles, _, dimension = self.position.shape
        return self._assemble([self.rows(), *parts], vehicles, dimension, self.stamp)

    @classmethod
    def _assemble(cls, parts: Sequence[Rows], vehicles: int, dimension: int, stamp: float
                  ) -> Observation:
        """Put each vehicle's rows of all the parts behind each other."""
        counts = np.array([np.bincount(vehicle, minlength=vehicles) for vehicle, _ in parts])
        width = int(counts.sum(axis=0).max(initial=0))
        table = cls.empty(vehicles, width, dimension, stamp)
        column, end = np.arange(width), np.zeros((vehicles, 1), int)
        for (_, rows), count in zip(parts, counts, strict=True):
            begin, end = end, end + count[:, None]
            # They are sorted by vehicle, so they fill the table's rows in its own order.
            place = np.flatnonzero((begin <= column) & (column < end))
            for name, values in rows.items():
                whole = getattr(table, name)
                shape = whole.shape[2:]
                items(whole.reshape(-1, *shape))[place] = items(
                    np.ascontiguousarray(values, whole.dtype).reshape(-1, *shape))
        return table

    def rows(self) -> Rows:
        """Return its rows without padding."""
        place = np.flatnonzero(self.heard)
        columns = ((name, getattr(self, name)) for name in _ROW_FIELDS)
        return place // self.sender.shape[1], {
            name: values.reshape(-1, *values.shape[2:]).take(place, axis=0)
            for name, values in columns}

    @property
    def heard(self) -> Array:
        """(V, K) bool: True where a row holds a sender."""
        return np.asarray(self.sender != PADDED)

    def project(self, dimension: int) -> Observation:
        """Return the same observation, rows and all, cut to the first D coordinates."""
        if self.position.shape[2] == dimension:
            return self
        return replace(
            self,
            position=self.position[:, :, :dimension],
            covariance=self.covariance[:, :, :dimension, :dimension],
        )

    def without(self, pairs: Array) -> Observation:
        """Return it without pairs (M,) of vehicle and sender, and without their silence."""
        if not len(pairs):
            return self
        silent = self.silent
        if silent is not None:
            silent = replace(
                silent, known=silent.known & ~np.isin(pairs_of(silent.sender), pairs))
        return replace(self, silent=silent, sender=np.where(
            np.isin(pairs_of(self.sender), pairs), PADDED, self.sender))

    def vehicle(self, index: int) -> Observation:
        """Return what one vehicle observes (V = 1) without its padding."""
        rows = self.heard[index]
        return replace(
            self, **{name: getattr(self, name)[index:index + 1, rows] for name in _ROW_FIELDS}
        )

    def of(self, index: Array) -> Observation:
        """Return what these vehicles heard, padding, silence and all."""
        silent = self.silent
        if silent is not None:
            silent = silent.of(index)
        return replace(self, silent=silent, **{
            name: getattr(self, name)[index] for name in _ROW_FIELDS})

    def trimmed(self) -> Observation:
        """Return the same observation without the columns that are padding for all vehicles."""
        return self.columns(self.heard.any(axis=0))

    def columns(self, index: Array) -> Observation:
        """Return these columns of the rows, copied."""
        return replace(self, **{name: getattr(self, name)[:, index] for name in _ROW_FIELDS})


_ROW_FIELDS = tuple(
    field.name for field in fields(Observation) if field.name not in ('stamp', 'silent')
)


def pair(vehicle: Array, sender: Array) -> Array:
    """Return one number for each vehicle and sender: ids are UINT32 in beacons, or PADDED."""
    return (vehicle << _ID_BITS) + sender


def pairs_of(sender: Array) -> Array:
    """Return the pairs (V, K) of vehicles and the senders (V, K) that each has."""
    return pair(np.arange(len(sender))[:, None], sender)


def split(pairs: Array) -> tuple[Array, Array]:
    """Return the vehicles and senders of pairs."""
    return pairs >> _ID_BITS, pairs & (1 << _ID_BITS) - 1
