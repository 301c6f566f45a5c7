"""Radio channels: one object simulates what is heard and scores where that is likely."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.model.calibration import RangeCalibration
from tsmcl_ros.model.evidence import Evidence, Factor
from tsmcl_ros.model.factors import (
    DiskBoundary,
    ENDLESS,
    log_of_rate,
    NEVER,
    Power,
    ShadowedBoundary,
)
from tsmcl_ros.model.geometry import Reach
from tsmcl_ros.model.power_calibration import PowerCalibration
from tsmcl_ros.model.radio_config import EvidenceConfig, PathLoss, RadioConfig
from tsmcl_ros.model.range_law import RangeLaw
from tsmcl_ros.model.references import column, References
from tsmcl_ros.types import (
    Array,
    ConfigError,
    Observation,
)

_ALL = EvidenceConfig()


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
    ranges : RangeLaw
        What ranges mean by it.
    powers : PowerCalibration
        What it takes the path losses of `radio` to be off.

    """

    def __init__(self, radio: RadioConfig, switches: EvidenceConfig = _ALL,
                 seed: int = 0):
        self.radio = radio
        self.switches = switches
        self.calibration = RangeCalibration(
            radio.range_scale, radio.range_bias,
            (switches.range_scale_std, switches.range_bias_std))
        self.ranges = RangeLaw(radio, self.calibration)
        self.powers = PowerCalibration(
            (switches.rssi_at_reference_std, switches.path_loss_exponent_std),
            switches.anchor_rssi_std, switches.anchor_rssi_time, switches.sigma_db_std, seed)
        self._identity, self._path_loss = PathLoss.table(radio)
        self._floor = switches.outlier_fraction

    @property
    def radio_range(self) -> float:
        """Range [m] at which half of the beacons are heard; 0 if unknown."""
        if self.radio.radio_model == 'disk':
            return self.radio.radio_range
        return float(self._path_loss.distance(self.radio.sensitivity)[-1])

    @property
    def reach(self) -> float:
        """Distance [m] beyond which nothing is heard; 0 if unknown."""
        if self.radio.radio_model == 'disk':
            return self.radio.radio_range
        # Five standard deviations of shadowing: one beacon in three million carries further.
        loss = self._path_loss
        return float(loss.distance(self.radio.sensitivity - 5 * loss.sigma).max())

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
            ranges = self.ranges.measure(distance, rng)
            measured = np.where(mask, ranges, np.nan).astype(np.float32)
            std = np.where(mask, self.ranges.std_of(ranges), np.nan).astype(np.float32)
        if radio.measure_rssi:
            rssi = np.where(mask, rssi, np.nan).astype(np.float32)
        else:
            rssi = unmeasured
        return Heard(mask=mask, range=measured, range_std=std, rssi=rssi)

    def evidence(self, observation: Observation) -> Evidence:
        """
        Return what an observation says, split into factors.

        A beacon with a range adds a ranging term to its heard term, and so does one with rssi of
        a disk radio that measures it; under the lognormal model the power term stands instead of
        the heard term, as it holds the same information. A vehicle that heard nothing gets no
        silence either: its radio may be off.
        """
        switches = self.switches
        rows = observation.heard
        heard = rows.any(axis=1)
        ranged = rows & ~np.isnan(observation.range) & switches.use_range
        lognormal = self.radio.radio_model == 'lognormal'
        powered = self.powered(observation)
        radius = self.radius(observation.max_range, observation.sender)
        bounded = rows & (radius > 0) & ~(powered & lognormal) & switches.use_heard

        factors: list[Factor] = []
        terms = np.zeros(len(heard), np.float32)
        if ranged.any() or powered.any():
            references = References.lay_out(observation.position, observation.covariance)
        if ranged.any():
            factors.append(self.ranges.factor(references, observation, ranged, self._floor))
            terms += ranged.sum(axis=1)
        if powered.any():
            loss = self.path_loss(observation.sender)
            excess = (np.where(powered, observation.rssi, 0) - loss.reference) / loss.sigma
            factors.append(Power(
                references, excess=column(excess), weight=column(powered),
                slope=column(loss.slope), floor=self._floor))
            terms += powered.sum(axis=1)
        floor = np.full(len(heard), -np.inf, np.float32)
        if self._floor > 0:
            floor[terms > 0] = math.log(self._floor) * terms[terms > 0]
        boundary = self._boundary(observation, bounded, radius, heard)
        if boundary is not None:
            factors.append(boundary)
            terms += (boundary.radius < ENDLESS).sum(axis=(1, 2))
        return Evidence(
            factors=tuple(factors), terms=np.maximum(terms, 1), floor=floor, heard=heard,
            region=lambda: self._reach(observation, ranged, powered, bounded, radius))

    def distances(self, observation: Observation) -> tuple[Array, Array, Array]:
        """
        Return what the ranges of an observation say on average, freed of all that is known.

        Returns
        -------
        distance, std : (V, K) float
            [m].
        used : (V, K) bool
            False where there is no range that counts.

        """
        used = observation.heard & ~np.isnan(observation.range) & self.switches.use_range
        ranges = np.where(used, observation.range, 0)
        std = np.where(used, self.ranges.std(observation), 1)
        return self.ranges.distance(ranges), np.maximum(std, 1e-3) / self.calibration.scale, used

    def disks(self, observation: Observation) -> tuple[Array, Array]:
        """
        Return the radii (V, K) [m] of disks that hold vehicles who heard a sender.

        The second value tells which rows (V, K) bool have one and hold no measurement, which
        would say more.
        """
        radius = self.radius(observation.max_range, observation.sender) * observation.hops
        ranged = ~np.isnan(observation.range) & self.switches.use_range
        rows = observation.heard & (radius > 0) & ~ranged & ~self.powered(observation)
        return radius, rows & self.switches.use_heard & (self.radio.radio_model == 'disk')

    def resolution(self, observation: Observation) -> tuple[Array, Array]:
        """
        Return what the ranges of an observation resolve, and which rows (V, K) bool have one.

        The first value (V, K) [m] is the standard deviation of the normal errors that would tell
        as much: see `RangeLaw.resolution`.
        """
        _, std, used = self.distances(observation)
        resolved = self.ranges.resolution(np.where(used, observation.range, 0), std)
        return np.where(used, resolved, std), used

    def powered(self, observation: Observation) -> Array:
        """Return the rows (V, K) bool whose rssi counts."""
        return observation.heard & ~np.isnan(observation.rssi) & (
            self.switches.use_rssi
            and (self.radio.radio_model == 'lognormal' or self.radio.measure_rssi))

    def measured(self, observation: Observation) -> Array:
        """Return the rows (V, K) bool that hold a range or an rssi that counts."""
        return self.distances(observation)[2] | self.powered(observation)

    @property
    def calibrates_power(self) -> bool:
        """Whether rssi teaches what path losses are like."""
        return self.switches.rssi_calibration == 'online'

    def path_loss(self, sender: Array) -> PathLoss:
        """Return each sender's path loss, in the shape of the senders' ids."""
        loss = self._supposed(sender)
        if not self.calibrates_power:
            return loss
        reference, exponent = self.powers.mean.tolist()
        return loss.corrected(reference, exponent, self.powers.variance)

    def _supposed(self, sender: Array) -> PathLoss:
        """Return the path losses that those of senders are taken to be at first."""
        if not len(self._identity):
            return self._path_loss.of(np.full(sender.shape, -1))
        index = np.minimum(np.searchsorted(self._identity, sender), len(self._identity) - 1)
        return self._path_loss.of(np.where(self._identity[index] == sender, index, -1))

    def softness(self, radius: Array) -> Array:
        """Return the width [m] of the soft edge of disks of these radii [m]."""
        if self.radio.edge_softness > 0:
            return np.full_like(radius, self.radio.edge_softness)
        return np.float32(0.02) * radius

    def radius(self, max_range: Array, sender: Array) -> Array:
        """Return the radio range [m] of each row, 0 where unknown."""
        if self.radio.radio_model == 'lognormal':
            return self.path_loss(sender).distance(self.radio.sensitivity)
        return np.where(np.isnan(max_range), np.float32(self.radio.radio_range), max_range)

    def _boundary(self, observation: Observation, bounded: Array, radius: Array, heard: Array
                  ) -> DiskBoundary | ShadowedBoundary | None:
        """Gather heard, relayed and silent beacons into one factor, None if there are none."""
        relayed = bounded & (observation.hops == 2)
        inside, outside = np.ones(bounded.shape), -np.ones(bounded.shape)
        never = np.full(bounded.shape, NEVER)
        said = observation.sender, observation.position, observation.covariance
        groups = [(*said, bounded, np.where(relayed, 2 * radius, radius), inside, never),
                  (*said, relayed, radius, outside, never)]
        silent = observation.silent
        if silent is not None and self.switches.silence != 'none':
            reach = self.radius(silent.max_range, silent.sender)
            exact = np.zeros((*silent.position.shape, silent.position.shape[-1]), np.float32)
            groups.append((silent.sender, silent.position, exact,
                           silent.known & (reach > 0) & heard[:, None], reach,
                           -np.ones(reach.shape), log_of_rate(silent)))
        groups = [group for group in groups if group[3].any()]
        if not groups:
            return None
        sender, position, covariance, used, reach, side, missed = _packed(
            [np.concatenate(parts, axis=1) for parts in zip(*groups, strict=True)])
        references = References.lay_out(position, covariance)
        # A padded column has an endless radius and stands inside of it: it scores 0.
        softness = self.softness(np.where(used, reach, 50))
        reach = column(np.where(used, reach, ENDLESS))
        side = np.where(used, side, 1)
        lost = column(missed) if (used & (missed > NEVER)).any() else None
        if self.radio.radio_model == 'lognormal':
            return ShadowedBoundary(
                references, reach, column(side), column(self.path_loss(sender).slope), lost)
        return DiskBoundary(references, reach, column(side / softness), lost)

    def _reach(self, observation: Observation, ranged: Array, powered: Array, bounded: Array,
               radius: Array) -> Reach:
        """Return how far from the heard references the vehicles may be, but for one in 700."""
        radio = self.radio
        edge = radius + 3 * (radio.edge_softness or 0.02 * radius)
        loss = self.path_loss(observation.sender)
        if radio.radio_model == 'lognormal':
            edge = radius * 10 ** (3 / loss.slope)
        presence = np.where(bounded, edge * observation.hops, np.inf)
        measured = np.where(ranged, self.ranges.furthest(observation), np.inf)
        by_power = loss.distance(observation.rssi - 3 * loss.sigma)
        measured = np.where(powered, np.minimum(measured, by_power), measured)
        spread = 3 * np.sqrt(np.diagonal(observation.covariance, axis1=2, axis2=3))
        return Reach(observation.position, observation.heard, presence[:, :, None] + spread,
                     measured[:, :, None] + spread)


def _packed(columns: list[Array]) -> list[Array]:
    """Return columns (V, E, ...), the fourth of which says what is used, without idle ones."""
    used = columns[3]
    width = used.sum(axis=1).max()
    if width == used.shape[1]:
        return columns
    order = np.argsort(~used, axis=1, kind='stable')[:, :width]
    return [values[np.arange(len(used))[:, None], order] for values in columns]
