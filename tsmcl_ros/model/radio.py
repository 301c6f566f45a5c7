"""
Radio channels: one object simulates what is heard and scores where that is likely.

Scoring splits an observation into factors, one a kind of evidence. Every factor works on arrays
laid out (V, E, P), references before points, so that sums over references run along contiguous
memory. All log-likelihoods are relative to their peak: at most 0, exp() of them in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Protocol

import numpy as np
from scipy.special import log_ndtr
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.calibration import RangeCalibration
from tsmcl_ros.types import Array, ConfigError, Estimate, Observation


@dataclass(frozen=True)
class RadioConfig(Config):
    """What the radio does to a signal, for simulation and for scoring alike."""

    radio_model: str = param(
        'disk', 'who is heard: within a range, or above a sensitivity under shadowing',
        choices=('disk', 'lognormal'))
    radio_range: float = param(
        0.0, 'range of beacons that do not tell theirs, 0 if unknown (disk model)',
        unit='m', low=0.0)
    edge_softness: float = param(
        0.0, 'width of the soft edge of the radio disk when scoring, 0 for 0.02 of the range',
        unit='m', low=0.0)
    rssi_at_reference: float = param(
        -40.0, 'mean rssi at the reference distance, P_0', unit='dBm', low=-200.0, high=100.0)
    reference_distance: float = param(1.0, 'distance of P_0, d_0', unit='m', above=0.0)
    path_loss_exponent: float = param(2.0, 'path loss exponent n', above=0.0, high=10.0)
    sigma_db: float = param(4.0, 'standard deviation of the shadowing', unit='dB', above=0.0)
    sensitivity: float = param(
        -90.0, 'weakest rssi that is heard (lognormal model)', unit='dBm', low=-300.0, high=100.0)
    anchor_path_loss: tuple[str, ...] = param(
        (), "path loss of single anchors where it differs, each 'id P_0 n sigma_db'")
    range_bias: float = param(0.0, 'measured range = scale * distance + bias + noise', unit='m')
    range_scale: float = param(1.0, 'see range_bias', above=0.0)
    range_std: float = param(
        2.0, 'standard deviation of ranges that do not tell theirs', unit='m', above=0.0)
    measure_range: bool = param(False, 'the simulated radio measures ranges')
    measure_rssi: bool = param(False, 'the simulated radio measures rssi')

    def check(self) -> None:
        """Hold that every anchor's path loss is one."""
        PathLoss.table(self)


@dataclass(frozen=True)
class EvidenceConfig(Config):
    """Which evidence of an observation counts, each switchable."""

    use_heard: bool = param(True, 'a beacon heard says that its sender is near')
    silence: str = param(
        'map', 'an anchor not heard is far: never, if heard before, if in the anchor map',
        choices=('none', 'memory', 'map'))
    use_rssi: bool = param(True, 'rssi counts (lognormal model)')
    use_range: bool = param(True, 'measured ranges count')
    range_calibration: str = param(
        'online', 'estimate scale and bias of the ranges while running, from range_scale and '
        'range_bias on', choices=('off', 'online'))
    outlier_fraction: float = param(
        0.02, "share of measurements that may say anything: the likelihood's uniform floor",
        low=0.0, high=0.5)


@dataclass(frozen=True, eq=False)
class PathLoss:
    """
    Mean rssi against distance, rssi = P_0 - 10 n log10(d / d_0), and the shadowing around it.

    Attributes
    ----------
    reference, exponent, sigma : float32 arrays of one shape
        P_0 at 1 m [dBm], n, and sigma_db [dB].
    """

    reference: Array
    exponent: Array
    sigma: Array

    @classmethod
    def table(cls, radio: RadioConfig) -> tuple[Array, PathLoss]:
        """
        Return the ids (A,) of anchors with a path loss of their own, and these (A + 1,).

        The last one is everybody else's.

        Raises
        ------
        ConfigError
            If a row of `anchor_path_loss` is not 'id P_0 n sigma_db'.
        """
        rows = {}
        for text in radio.anchor_path_loss:
            try:
                identity, reference, exponent, sigma = text.split()
                row = float(reference), float(exponent), float(sigma)
                sound = int(identity) >= 0 and all(map(math.isfinite, row)) and min(row[1:]) > 0
            except ValueError:
                sound = False
            if not sound or int(identity) in rows:
                raise ConfigError(
                    f'anchor_path_loss: {text!r} is not allowed, must be the id of an anchor, '
                    'once, its P_0 [dBm], n above 0 and sigma_db above 0')
            rows[int(identity)] = row
        identities = np.array(sorted(rows), np.int64)
        rest = radio.rssi_at_reference, radio.path_loss_exponent, radio.sigma_db
        table = np.array([rows[item] for item in identities.tolist()] + [rest], np.float32).T
        table[0] += 10 * table[1] * math.log10(radio.reference_distance)
        return identities, cls(*table)

    def of(self, index: Array) -> PathLoss:
        """Return the path losses of these rows of the table, in the index's shape."""
        return PathLoss(self.reference[index], self.exponent[index], self.sigma[index])

    @property
    def slope(self) -> Array:
        """How many sigmas a tenfold distance costs."""
        return np.asarray(10 * self.exponent / self.sigma)

    def mean(self, distance: Array) -> Array:
        """Return the mean rssi [dBm] at distances [m]."""
        return np.asarray(
            self.reference - 10 * self.exponent * np.log10(np.maximum(distance, 1e-3)))

    def distance(self, rssi: Array | float) -> Array:
        """Return the distance [m] at which this rssi [dBm] is the mean."""
        with np.errstate(over='ignore'):
            return np.asarray(10 ** ((self.reference - rssi) / (10 * self.exponent)))


@dataclass(frozen=True, eq=False)
class Heard:
    """
    What V radios measure of A senders.

    Attributes
    ----------
    mask : (V, A) bool
        True where the sender was heard.
    range, range_std, rssi : (V, A) float32
        [m, m, dBm]; NaN where not measured.
    """

    mask: Array
    range: Array
    range_std: Array
    rssi: Array


class Factor(Protocol):
    """One kind of evidence of V vehicles, E references each (padded ones score 0)."""

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): the sum over references at points (V, P, D) [m]."""

    def at(self, vehicle: Array) -> Factor:
        """Return the factor for a flat list of points (1, M, D) of the vehicles (M,)."""


@dataclass(frozen=True, eq=False)
class References:
    """
    The positions that a factor's evidence is about.

    Attributes
    ----------
    position : (D, V, E, 1) float32
        [m].
    covariance : (D, D, V, E, 1) float32 or None
        [m^2]; None if all are exactly known.
    """

    position: Array
    covariance: Array | None

    def distance(self, points: Array) -> tuple[Array, Array | None]:
        """
        Return the distances (V, E, P) [m] of points (V, P, D), and what is uncertain of them.

        The second value is the references' variance along the line of sight (V, E, P) [m^2],
        u^T S u, or None if all are exactly known.
        """
        delta = [points[:, None, :, axis] - position
                 for axis, position in enumerate(self.position)]
        squared = delta[0] * delta[0]
        for axis in delta[1:]:
            squared += axis * axis
        if self.covariance is None:
            return np.sqrt(squared), None
        variance = sum(
            delta[i] * delta[j] * self.covariance[i, j]
            for i in range(len(delta)) for j in range(len(delta))
        )
        return np.sqrt(squared), variance / np.maximum(squared, np.float32(1e-6))

    def at(self, vehicle: Array) -> References:
        """Return the references for a flat list of points of the vehicles (M,)."""
        return References(
            _flat(self.position, vehicle),
            None if self.covariance is None else _flat(self.covariance, vehicle),
        )


def _flat(column: Array, vehicle: Array) -> Array:
    """Lay out columns (..., V, E, 1) for a flat list of points of M vehicles: (..., 1, E, M)."""
    return np.swapaxes(column[..., 0].take(vehicle, axis=-2), -1, -2)[..., None, :, :]


@dataclass(frozen=True, eq=False)
class DiskBoundary:
    """
    Inside or outside of soft-edged disks: heard, silent and relayed beacons alike.

    log p = -log(1 + exp(side (d - R) / s)), with side 1 for heard and -1 for silent; a relayed
    beacon (R < d <= 2R) is one of each. Columns are (V, E, 1).
    """

    references: References
    radius: Array
    softness: Array
    side: Array

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        softness = self.softness
        if variance is not None:
            # A logistic curve of width s lies within 0.01 of a Gaussian's of std 1.702 s.
            softness = np.sqrt(softness * softness + variance / np.float32(1.702 ** 2))
        return -_softplus(self.side * (distance - self.radius) / softness).sum(axis=1)

    def at(self, vehicle: Array) -> DiskBoundary:
        """Return the factor for a flat list of points: see `Factor`."""
        return DiskBoundary(self.references.at(vehicle), *(
            _flat(column, vehicle) for column in (self.radius, self.softness, self.side)))


@dataclass(frozen=True, eq=False)
class ShadowedBoundary:
    """
    Heard or not under log-normal shadowing.

    p = Phi(side 10 n log10(R / d) / sigma_db), with R where the mean rssi meets the sensitivity.
    Columns are (V, E, 1).
    """

    references: References
    radius: Array
    side: Array
    slope: Array

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        distance = np.maximum(distance, np.float32(1e-3))
        excess = self.side * self.slope * np.log10(self.radius / distance)
        if variance is not None:
            excess = excess / np.sqrt(_power_variance(self.slope, variance, distance))
        return np.asarray(log_ndtr(excess).sum(axis=1))

    def at(self, vehicle: Array) -> ShadowedBoundary:
        """Return the factor for a flat list of points: see `Factor`."""
        return ShadowedBoundary(self.references.at(vehicle), *(
            _flat(column, vehicle) for column in (self.radius, self.side, self.slope)))


@dataclass(frozen=True, eq=False)
class Power:
    """
    Received power around the path-loss curve, Gaussian in dB, with a uniform floor.

    Equivalently log-normal in distance, so near references weigh more. Columns are (V, E, 1);
    `weight` is 0 where padded.
    """

    references: References
    excess: Array
    weight: Array
    slope: Array
    floor: float

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        distance = np.maximum(distance, np.float32(1e-3))
        residual = self.excess + self.slope * np.log10(distance)
        squared = residual * residual
        if variance is not None:
            squared = squared / _power_variance(self.slope, variance, distance)
        return _heavy_tailed(self.weight * squared, self.floor).sum(axis=1)

    def at(self, vehicle: Array) -> Power:
        """Return the factor for a flat list of points: see `Factor`."""
        return replace(
            self, references=self.references.at(vehicle),
            excess=_flat(self.excess, vehicle), weight=_flat(self.weight, vehicle),
            slope=_flat(self.slope, vehicle))


@dataclass(frozen=True, eq=False)
class Ranging:
    """
    Measured ranges around scale * distance + bias, Gaussian, with a uniform floor.

    Columns are (V, E, 1); `precision` [1/m^2] is 0 where padded.
    """

    references: References
    measured: Array
    precision: Array
    scale: float
    bias: float
    floor: float

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P): see `Factor`."""
        distance, variance = self.references.distance(points)
        residual = self.measured - self.bias - self.scale * distance
        precision = self.precision
        if variance is not None:
            precision = precision / (1 + precision * self.scale ** 2 * variance)
        return _heavy_tailed(precision * residual * residual, self.floor).sum(axis=1)

    def at(self, vehicle: Array) -> Ranging:
        """Return the factor for a flat list of points: see `Factor`."""
        return replace(
            self, references=self.references.at(vehicle),
            measured=_flat(self.measured, vehicle), precision=_flat(self.precision, vehicle))


@dataclass(frozen=True, eq=False)
class Evidence:
    """
    All that an observation says of V vehicles' positions.

    Attributes
    ----------
    factors : tuple of Factor
        Their log-likelihoods add up.
    terms : (V,) float32
        Number of terms in that sum, at least 1.
    heard : (V,) bool
        False for a vehicle that heard nothing; its likelihood is 1 everywhere.
    box : (V, 2, D) float32
        Lower and upper corner [m] of a region that holds all likely positions.
    """

    factors: tuple[Factor, ...]
    terms: Array
    heard: Array
    box: Array

    def log_likelihood(self, points: Array) -> Array:
        """Return (V, P) float32 at points (V, P, D) or shared ones (1, P, D) [m]."""
        total = np.zeros((len(self.heard), points.shape[1]), np.float32)
        for factor in self.factors:
            total += factor.log_likelihood(points)
        return total

    @property
    def presence(self) -> Evidence:
        """Only who was heard and who was silent."""
        return replace(self, factors=tuple(
            factor for factor in self.factors
            if isinstance(factor, (DiskBoundary, ShadowedBoundary))))

    @property
    def measured(self) -> Evidence:
        """Only what was measured: ranges and rssi."""
        return replace(self, factors=tuple(
            factor for factor in self.factors if isinstance(factor, (Ranging, Power))))

    def log_likelihood_of(self, points: Array, vehicle: Array) -> Array:
        """Return (M,) float32 of a flat list of points (M, D) [m] of the vehicles (M,)."""
        total = np.zeros(len(points), np.float32)
        for factor in self.factors:
            flat = factor if len(self.heard) == 1 else factor.at(vehicle)
            total += flat.log_likelihood(points[None])[0]
        return total


class Channel:
    """
    The radio between senders and vehicles.

    Parameters
    ----------
    radio : RadioConfig
        Its physics, used by `hear` and by `evidence`.
    switches : EvidenceConfig
        Which evidence `evidence` uses.

    Attributes
    ----------
    calibration : RangeCalibration
        What `evidence` takes ranges to be; it starts from `radio`.
    """

    def __init__(self, radio: RadioConfig, switches: EvidenceConfig = EvidenceConfig()):
        self.radio = radio
        self.switches = switches
        self.calibration = RangeCalibration(radio.range_scale, radio.range_bias)
        self._identity, self._path_loss = PathLoss.table(radio)
        self._floor = switches.outlier_fraction

    @property
    def radio_range(self) -> float:
        """Range [m] at which half of the beacons are heard; 0 if unknown."""
        if self.radio.radio_model == 'disk':
            return self.radio.radio_range
        return float(self._path_loss.distance(self.radio.sensitivity)[-1])

    def hear(self, distance: Array, rng: np.random.Generator, sender: Array | None = None
             ) -> Heard:
        """
        Return what radios at these distances of the senders hear and measure.

        Parameters
        ----------
        distance : (V, A) float
            [m].
        rng : numpy.random.Generator
            Draws the shadowing and the noise.
        sender : int array that broadcasts to (V, A), optional
            Identities, for anchors with a path loss of their own.

        Raises
        ------
        ConfigError
            If the radio range is unknown.
        """
        radio = self.radio
        if self.radio_range <= 0:
            raise ConfigError(
                'radio_range: 0 is not allowed for a simulated disk radio, must be above 0 m')
        distance = np.asarray(distance)
        unmeasured = np.full(distance.shape, np.nan, np.float32)
        rssi = unmeasured
        if radio.radio_model == 'lognormal' or radio.measure_rssi:
            loss = self.path_loss(np.array(-1) if sender is None else sender)
            shadowing = loss.sigma * rng.standard_normal(distance.shape)
            rssi = (loss.mean(distance) + shadowing).astype(np.float32)
        if radio.radio_model == 'disk':
            mask = distance <= radio.radio_range
        else:
            mask = rssi >= radio.sensitivity
        measured, std = unmeasured, unmeasured
        if radio.measure_range:
            noise = radio.range_std * rng.standard_normal(distance.shape)
            measured = np.maximum(radio.range_scale * distance + radio.range_bias + noise, 0)
            measured = np.where(mask, measured, np.nan).astype(np.float32)
            std = np.where(mask, radio.range_std, np.nan).astype(np.float32)
        if radio.measure_rssi:
            rssi = np.where(mask, rssi, np.nan).astype(np.float32)
        else:
            rssi = unmeasured
        return Heard(mask=mask, range=measured, range_std=std, rssi=rssi)

    def evidence(self, observation: Observation) -> Evidence:
        """
        Return what an observation says, split into factors.

        A beacon with a range adds a ranging term to its heard term; a beacon with rssi, under
        the lognormal model, has a power term instead, which holds the same information. A
        vehicle that heard nothing gets no silence either: its radio may be off.
        """
        radio, switches = self.radio, self.switches
        rows = observation.heard
        heard = rows.any(axis=1)
        ranged = rows & ~np.isnan(observation.range) & switches.use_range
        powered = rows & ~np.isnan(observation.rssi) & (
            switches.use_rssi and radio.radio_model == 'lognormal')
        radius = self._radius(observation.max_range, observation.sender)
        bounded = rows & (radius > 0) & ~powered & switches.use_heard
        references = _references(observation.position, observation.covariance)

        factors: list[Factor] = []
        terms = np.zeros(len(heard), np.float32)
        if ranged.any():
            factors.append(self._ranging(references, observation, ranged))
            terms += ranged.sum(axis=1)
        if powered.any():
            loss = self.path_loss(observation.sender)
            excess = (np.where(powered, observation.rssi, 0) - loss.reference) / loss.sigma
            factors.append(Power(
                references, excess=_column(excess), weight=_column(powered),
                slope=_column(loss.slope), floor=self._floor))
            terms += powered.sum(axis=1)
        boundary = self._boundary(observation, bounded, radius, heard)
        if boundary is not None:
            factors.append(boundary)
            terms += np.isfinite(boundary.radius).sum(axis=(1, 2))
        return Evidence(
            factors=tuple(factors), terms=np.maximum(terms, 1), heard=heard,
            box=self._box(observation, ranged, powered, bounded, radius))

    def calibrate(self, observation: Observation, estimate: Estimate) -> None:
        """Learn from an epoch what the ranges are like, if that is switched on."""
        if self.switches.range_calibration == 'online':
            self.calibration.learn(observation, estimate, self._range_std(observation))

    def _range_std(self, observation: Observation) -> Array:
        """Return the standard deviation (V, K) [m] of each range."""
        return np.where(np.isnan(observation.range_std), np.float32(self.radio.range_std),
                        observation.range_std)

    def path_loss(self, sender: Array) -> PathLoss:
        """Return each sender's path loss, in the shape of the senders' ids."""
        if not len(self._identity):
            return self._path_loss.of(np.full(sender.shape, -1))
        index = np.minimum(np.searchsorted(self._identity, sender), len(self._identity) - 1)
        return self._path_loss.of(np.where(self._identity[index] == sender, index, -1))

    def _radius(self, max_range: Array, sender: Array) -> Array:
        """Return the radio range [m] of each row, 0 where unknown."""
        if self.radio.radio_model == 'lognormal':
            return self.path_loss(sender).distance(self.radio.sensitivity)
        return np.where(np.isnan(max_range), np.float32(self.radio.radio_range), max_range)

    def _ranging(self, references: References, observation: Observation, ranged: Array
                 ) -> Ranging:
        std = self._range_std(observation)
        return Ranging(
            references, measured=_column(np.where(ranged, observation.range, 0)),
            precision=_column(np.where(ranged, 1 / np.maximum(std, 1e-3) ** 2, 0)),
            scale=self.calibration.scale, bias=self.calibration.bias, floor=self._floor)

    def _boundary(self, observation: Observation, bounded: Array, radius: Array, heard: Array
                  ) -> DiskBoundary | ShadowedBoundary | None:
        """Gather heard, relayed and silent beacons into one factor, None if there are none."""
        relayed = bounded & (observation.hops == 2)
        inside, outside = np.ones(bounded.shape), -np.ones(bounded.shape)
        said = observation.sender, observation.position, observation.covariance
        groups = [(*said, bounded, np.where(relayed, 2 * radius, radius), inside),
                  (*said, relayed, radius, outside)]
        silent = observation.silent
        if silent is not None and self.switches.silence != 'none':
            reach = self._radius(silent.max_range, silent.sender)
            exact = np.zeros((*silent.position.shape, silent.position.shape[-1]), np.float32)
            groups.append((silent.sender, silent.position, exact,
                           silent.known & (reach > 0) & heard[:, None], reach,
                           -np.ones(reach.shape)))
        groups = [group for group in groups if group[3].any()]
        if not groups:
            return None
        sender, position, covariance, used, reach, side = (
            np.concatenate(parts, axis=1) for parts in zip(*groups, strict=True))
        references = _references(position, covariance)
        # A padded column has an infinite radius and stands inside of it: it scores 0.
        reach = _column(np.where(used, reach, np.inf))
        side = _column(np.where(used, side, 1))
        if self.radio.radio_model == 'lognormal':
            return ShadowedBoundary(
                references, reach, side, _column(self.path_loss(sender).slope))
        softness = np.where(np.isfinite(reach), np.float32(0.02) * reach, 1)
        if self.radio.edge_softness > 0:
            softness = np.full_like(reach, self.radio.edge_softness)
        return DiskBoundary(references, reach, softness.astype(np.float32), side)

    def _box(self, observation: Observation, ranged: Array, powered: Array, bounded: Array,
             radius: Array) -> Array:
        """Return the boxes (V, 2, D) in which the heard references leave the vehicles."""
        radio = self.radio
        reach = np.full(radius.shape, np.inf)
        edge = radius + 3 * (radio.edge_softness or 0.02 * radius)
        loss = self.path_loss(observation.sender)
        if radio.radio_model == 'lognormal':
            edge = radius * 10 ** (3 / loss.slope)
        reach = np.where(bounded, edge * observation.hops, reach)
        std = self._range_std(observation)
        furthest = (observation.range - self.calibration.bias + 3 * std) / self.calibration.scale
        reach = np.where(ranged, np.minimum(reach, np.maximum(furthest, std)), reach)
        by_power = loss.distance(observation.rssi - 3 * loss.sigma)
        reach = np.where(powered, by_power, reach)
        spread = 3 * np.sqrt(np.diagonal(observation.covariance, axis1=2, axis2=3))
        reach = reach[:, :, None] + spread
        return _intersect(observation.position, reach, observation.heard)


def _intersect(position: Array, reach: Array, rows: Array) -> Array:
    """
    Intersect the boxes position +- reach (V, K, D) [m] of the rows used (V, K).

    Where they contradict each other the smallest one is taken; where none is bounded, the box
    around the references themselves, grown by its own size.
    """
    if not rows.shape[1]:
        return np.zeros((rows.shape[0], 2, position.shape[2]), np.float32)
    used = rows[:, :, None]
    low = np.where(used, position - reach, -np.inf).max(axis=1)
    high = np.where(used, position + reach, np.inf).min(axis=1)
    smallest = np.where(used, reach, np.inf).min(axis=2).argmin(axis=1)
    single = np.arange(len(rows)), smallest
    empty = (low > high).any(axis=1, keepdims=True)
    low = np.where(empty, position[single] - reach[single], low)
    high = np.where(empty, position[single] + reach[single], high)
    outer_low = np.where(used, position, np.inf).min(axis=1)
    outer_high = np.where(used, position, -np.inf).max(axis=1)
    size = np.maximum((outer_high - outer_low).max(axis=1, keepdims=True), 1)
    unbounded = ~(np.isfinite(low) & np.isfinite(high)).all(axis=1, keepdims=True)
    low = np.where(unbounded, outer_low - size, low)
    high = np.where(unbounded, outer_high + size, high)
    box = np.stack([low, high], axis=1)
    return np.where(rows.any(axis=1)[:, None, None], box, 0).astype(np.float32)


def _column(values: Array) -> Array:
    """Lay out per-reference values (V, E) against points: (V, E, 1) float32."""
    return np.asarray(values, np.float32)[:, :, None]


def _references(position: Array, covariance: Array) -> References:
    """Lay out positions (V, E, D) and covariances (V, E, D, D) against points."""
    return References(
        np.moveaxis(np.asarray(position, np.float32), 2, 0)[..., None],
        np.moveaxis(covariance, (2, 3), (0, 1))[..., None] if covariance.any() else None,
    )


def _power_variance(slope: Array, variance: Array, distance: Array) -> Array:
    """
    Return the variance of received power, in sigma_db^2.

    To the shadowing comes what the reference's variance [m^2] along the line of sight makes of
    the path loss at this distance [m].
    """
    return np.asarray(1 + (slope / math.log(10)) ** 2 * variance / distance ** 2)


def _softplus(x: Array) -> Array:
    """Return log(1 + exp(x)) without overflow, in the fast float32 functions."""
    return np.asarray(np.maximum(x, 0) + np.log(1 + np.exp(-np.abs(x))))


def _heavy_tailed(squared: Array, floor: float) -> Array:
    """Return log((1 - floor) exp(-squared / 2) + floor) for the squared normalized residual."""
    if floor == 0:
        return np.float32(-0.5) * squared
    return np.log((1 - np.float32(floor)) * np.exp(np.float32(-0.5) * squared)
                  + np.float32(floor))
