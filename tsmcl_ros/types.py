"""
The values that flow through the package, and the errors it raises.

Everything numeric has a leading vehicle axis V; a single vehicle is V = 1. Positions are metres in
one local Cartesian map frame, stamps are seconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
import math
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
# Rows of an observation: whose each is, (M,) int in increasing order, and what they say by field.
Rows = tuple[Array, Mapping[str, Array]]
T = TypeVar('T')

ANCHOR, VEHICLE = 0, 1
# A sender that says what cannot be true: it was heard, and is left out.
UNTRUE = 2
PADDED = -1
_ID_BITS = 32
# Most base periods that may lie between two beacons.
MAX_PERIOD_FACTOR = 2 ** 31 - 1


# Longest text of an error, of which the ends say what is wrong and what is allowed.
_LONGEST = 2000


class TsmclError(Exception):
    """
    Root of all errors that a user of this package can cause and mend.

    Parameters
    ----------
    text : str
        What is wrong. Files and messages that it quotes may hold anything: it becomes one line of
        bounded length, in which line breaks are spaces and what else cannot be printed is
        escaped, so that it forges no log.

    """

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


def one_line(text: str) -> str:
    """Return a text as one short line, with what cannot be printed escaped."""
    text = _shortened(text)
    if text.isprintable():
        return text
    text = ' '.join(text.splitlines())
    return _shortened(''.join(
        letter if letter.isprintable() else letter.encode('unicode_escape').decode()
        for letter in text))


def _shortened(text: str) -> str:
    """Leave the middle out of a text that is too long."""
    if len(text) <= _LONGEST:
        return text
    return f'{text[:_LONGEST * 3 // 4]} [...] {text[-_LONGEST // 5:]}'


class ConfigError(TsmclError):
    """A parameter has a value that is not allowed, or is not known at all."""


class MessageError(TsmclError):
    """A message is malformed, or says something that cannot be true."""


class BagError(TsmclError):
    """A bag is missing, damaged, already there, or holds nothing of use."""


class LogError(TsmclError):
    """A CSV log or a mobility trace has a bad row; the text names file and line."""


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


def items(rows: Array) -> Array:
    """
    Return rows (M, ...), contiguous in memory, as M items: a view of the same memory.

    Picked and placed by it they are moved in one piece each, in a tenth of the time that numpy
    takes for their numbers one by one.
    """
    width = math.prod(rows.shape[1:])
    return rows.reshape(len(rows), width).view(f'V{width * rows.dtype.itemsize}')[:, 0]


@dataclass(frozen=True, eq=False)
class Links:
    """
    How anchors hear each other, which tells what rssi means.

    Attributes
    ----------
    receiver, sender : (L,) int64
        Identities of who hears, and of who is heard.
    receiver_position, sender_position : (L, D) float32
        [m].
    rssi : (L,) float32
        Received power [dBm].

    """

    receiver: Array
    sender: Array
    receiver_position: Array
    sender_position: Array
    rssi: Array

    @classmethod
    def none(cls) -> Links:
        """Return no links."""
        nobody, nowhere = np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
        return cls(nobody, nobody, nowhere, nowhere, np.zeros(0, np.float32))

    @property
    def distance(self) -> Array:
        """(L,) float64: lengths [m]."""
        return np.asarray(np.linalg.norm(
            self.receiver_position.astype(np.float64) - self.sender_position, axis=1))

    def without(self, sender: Array) -> Links:
        """Return the links in which none of these (S,) is heard."""
        return self.picked(~np.isin(self.sender, sender))

    def updated(self, news: Links) -> Links:
        """Return the links of both; where both have one, the news win."""
        if not len(self.rssi):
            return news
        ends = np.concatenate([[news.receiver, news.sender], [self.receiver, self.sender]], axis=1)
        _, first = np.unique(ends, axis=1, return_index=True)
        return Links(*(
            np.concatenate([getattr(news, field.name), getattr(self, field.name)])
            for field in fields(Links))).picked(first)

    def picked(self, rows: Array) -> Links:
        """Return some of the links: an index, or (L,) bool."""
        return Links(*(getattr(self, field.name)[rows] for field in fields(Links)))


@dataclass(frozen=True, eq=False)
class Odometry:
    """
    One odometry pose of one vehicle, in an odometry frame that starts anywhere and drifts.

    Attributes
    ----------
    stamp : float
        [s].
    position : (3,) float64
        [m].
    yaw : float
        [rad].

    """

    stamp: float
    position: Array
    yaw: float


@dataclass(frozen=True, eq=False)
class Motion:
    """
    What is known of V vehicles' movement since the last epoch.

    Attributes
    ----------
    elapsed : float
        Time since the last epoch [s].
    displacement : (V, D) float or None
        Odometry displacement, in the odometry frame [m]; NaN for a vehicle whose odometry is
        missing, None if nobody has odometry.
    turn : (V,) float or None
        Change of yaw [rad], where there is a displacement.

    """

    elapsed: float
    displacement: Array | None = None
    turn: Array | None = None


@dataclass(frozen=True, eq=False)
class Prior:
    """
    Where somebody says that one vehicle is.

    Attributes
    ----------
    vehicle : int
        Index of the vehicle.
    mean, covariance : (D,), (D, D) float64
        Position [m, m^2].
    yaw : float or None
        Rotation from the odometry frame to the map [rad]; None if unknown.
    yaw_std : float
        [rad].
    velocity_std : float or None
        Of each axis of the velocity, around 0 [m/s]; None if unknown.

    """

    vehicle: int
    mean: Array
    covariance: Array
    yaw: float | None = None
    yaw_std: float = 0.0
    velocity_std: float | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    Where V vehicles are, and how well that is known.

    Attributes
    ----------
    stamp : float
        Time of the measurement [s].
    mean : (V, D) float64
        [m]; NaN before the first beacon.
    covariance : (V, D, D) float64
        [m^2].
    rotation, rotation_variance : (V,) float64
        Rotation from the odometry frame to the map [rad, rad^2]; NaN where there is none.
    ess : (V,) float64
        Effective number of particles of the weighted cloud, before resampling.
    particles : int
        Number of particles, N.
    log_likelihood : (V,) float64
        Log of the cloud's average likelihood of the observation; NaN where nothing was heard.
    heard : (V,) int
        References heard in this epoch.
    reinitialized : (V,) bool
        True where no particle explained the observation and the cloud was drawn anew.
    odometry : (V, 4) float64 or None
        Odometry position [m] and yaw [rad] at the stamp, NaN where there is none; the localizer
        adds it.
    period_factor : (V,) int or None
        How many beacon periods each vehicle wants between two beacons; None if it does not care.

    """

    stamp: float
    mean: Array
    covariance: Array
    rotation: Array
    rotation_variance: Array
    ess: Array
    particles: int
    log_likelihood: Array
    heard: Array
    reinitialized: Array
    odometry: Array | None = None
    period_factor: Array | None = None

    @property
    def yaw(self) -> Array:
        """(V,) float64: yaw of the vehicles in the map [rad], NaN where unknown."""
        if self.odometry is None:
            return np.full(len(self.mean), np.nan)
        return (self.rotation + self.odometry[:, 3] + np.pi) % (2 * np.pi) - np.pi


@dataclass(frozen=True, eq=False)
class Trajectory:
    """
    One vehicle's positions over time.

    Attributes
    ----------
    stamp : (T,) float64
        Strictly increasing [s].
    position : (T, D) float64
        [m].
    yaw : (T,) float64
        [rad], NaN where unknown.
    covariance : (T, D, D) float64 or None
        [m^2]; None for ground truth.

    """

    stamp: Array
    position: Array
    yaw: Array
    covariance: Array | None = None


class Progress(Protocol):
    """Hands through what a loop goes over, and shows how far it is: libraries never print."""

    def __call__(self, items: Iterable[T], total: int | None, unit: str, name: str = ''
                 ) -> Iterable[T]:
        """
        Return the items.

        Parameters
        ----------
        items
            What the loop goes over.
        total
            How many there are, None if nobody knows.
        unit, name
            What an item is, and what is done with them.

        """


def unshown(items: Iterable[T], total: int | None, unit: str, name: str = '') -> Iterable[T]:
    """Return the items and show nothing; see `Progress`."""
    return items


class Estimator(Protocol):
    """
    What every method offers to the localizer; it knows arrays and nothing else.

    `particles` is the cloud (V, N, D) [m]; (V, 0, D) for a method without one.
    """

    @property
    def particles(self) -> Array:
        """Return the cloud (V, N, D) [m]; (V, 0, D) for a method without one."""

    def moments(self) -> tuple[Array, Array]:
        """Return mean (V, D) [m] and covariance (V, D, D) [m^2] of the belief as it stands."""

    def start(self, prior: Prior) -> None:
        """Replace one vehicle's belief by a prior."""

    def forget(self, vehicle: int) -> None:
        """Drop one vehicle's belief: it starts anew at its next beacon."""

    def predict(self, motion: Motion) -> None:
        """Move the belief by the motion since the last epoch."""

    def update(self, observation: Observation) -> Estimate:
        """Weigh the belief by what was heard; with nothing heard, only report it."""
