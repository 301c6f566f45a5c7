"""Radio channels: one object simulates what is heard and scores where that is likely."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
import math

import numpy as np
from tsmcl_ros.model.calibration import RangeCalibration
from tsmcl_ros.model.evidence import (
    column,
    DiskBoundary,
    ENDLESS,
    Evidence,
    Factor,
    log_of_rate,
    NEVER,
    Power,
    References,
    ShadowedBoundary,
)
from tsmcl_ros.model.geometry import Reach
from tsmcl_ros.model.kinematics import kinematics_of
from tsmcl_ros.model.learnt import Learnt
from tsmcl_ros.model.links import fit_links
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.power_calibration import PowerCalibration
from tsmcl_ros.model.radio_config import EvidenceConfig, PathLoss, RadioConfig
from tsmcl_ros.model.ranging import (
    AsymmetricErrors,
    draw_asymmetric,
    GaussianErrors,
    RangeErrors,
    Ranging,
)
from tsmcl_ros.types import (
    ANCHOR,
    Array,
    ConfigError,
    Estimate,
    Links,
    Motion,
    Observation,
    Prior,
    Silence,
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
        self.powers = PowerCalibration(
            (switches.rssi_at_reference_std, switches.path_loss_exponent_std),
            switches.anchor_rssi_std, switches.anchor_rssi_time, switches.sigma_db_std, seed)
        self._identity, self._path_loss = PathLoss.table(radio)
        self._floor = switches.outlier_fraction

    def learn(self, links: Links) -> None:
        """Calibrate the path loss by how anchors hear each other, if that is switched on."""
        switches = self.switches
        self._identity, self._path_loss = own, configured = PathLoss.table(self.radio)
        links = links.without(own)
        if switches.rssi_calibration != 'links' or not len(links.rssi):
            return
        rest = configured.of(np.array(-1))
        fit = fit_links(
            links, float(rest.reference), float(rest.exponent), float(rest.sigma),
            switches.path_loss_exponent_std, switches.link_neighbours)
        order = np.append(np.argsort(np.append(own, fit.identity)), -1)
        exponent = np.full(len(fit.sigma), fit.exponent)
        fitted = PathLoss(*(
            np.append(known[:-1], found)[order].astype(np.float32) for known, found in (
                (configured.reference, fit.reference), (configured.exponent, exponent),
                (configured.sigma, fit.sigma))))
        self._identity, self._path_loss = np.sort(np.append(own, fit.identity)), fitted

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
            ranges = self._measure(distance, rng)
            measured = np.where(mask, ranges, np.nan).astype(np.float32)
            std = np.where(mask, self._std_of(ranges), np.nan).astype(np.float32)
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
            factors.append(self._ranging(references, observation, ranged))
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
        distance = (ranges - self.calibration.bias) / self.calibration.scale
        if self._asymmetric:
            short, long = self._asymmetry(self._indicated(ranges))
            distance = distance + short - long
        std = np.where(used, self._range_std(observation), 1)
        return distance, np.maximum(std, 1e-3) / self.calibration.scale, used

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
        as much: those of the asymmetric law have the Fisher information 1 / (short long), more
        than 1 / their variance, as they are mostly small.
        """
        _, std, used = self.distances(observation)
        if self._asymmetric:
            short, long = self._asymmetry(
                self._indicated(np.where(used, observation.range, 0)))
            std = np.where(used, np.sqrt(short * long), std)
        return std, used

    def powered(self, observation: Observation) -> Array:
        """Return the rows (V, K) bool whose rssi counts."""
        return observation.heard & ~np.isnan(observation.rssi) & (
            self.switches.use_rssi
            and (self.radio.radio_model == 'lognormal' or self.radio.measure_rssi))

    def measured(self, observation: Observation) -> Array:
        """Return the rows (V, K) bool that hold a range or an rssi that counts."""
        return self.distances(observation)[2] | self.powered(observation)

    @property
    def calibrates(self) -> bool:
        """Whether ranges teach what they are like."""
        # The mean of asymmetric errors grows with range, as a wrong scale would make it do.
        return self.switches.range_calibration == 'online' and not self._asymmetric

    @property
    def calibrates_power(self) -> bool:
        """Whether rssi teaches what path losses are like."""
        return self.switches.rssi_calibration == 'online'

    def calibrated(self, untaught: bool = True) -> dict[str, str]:
        """Return what is estimated of the radio, +- one standard deviation; or only if taught."""
        found = {}
        if self.calibrates and (untaught or self.calibration.is_taught):
            scale, bias = np.sqrt(np.diag(self.calibration.covariance)).tolist()
            found['range scale'] = f'{self.calibration.scale:.4f} +- {scale:.4f}'
            found['range bias [m]'] = f'{self.calibration.bias:.3f} +- {bias:.3f}'
        if self.calibrates_power and (untaught or self.powers.is_taught):
            rest = self.path_loss(np.array(-1))
            reference, exponent = np.sqrt(np.diag(self.powers.covariance)).tolist()
            found['P_0 [dBm]'] = f'{rest.reference:.2f} +- {reference:.2f}'
            found['path loss exponent'] = f'{rest.exponent:.3f} +- {exponent:.3f}'
        return found

    @property
    def learnt(self) -> Learnt:
        """What another one can begin with."""
        return Learnt(self.calibration.learnt, self.powers.learnt)

    def resume(self, learnt: Learnt) -> None:
        """Begin with what another one has learnt, as far as that is estimated here."""
        if learnt.ranges is not None and self.calibrates:
            self.calibration.resume(learnt.ranges)
        if learnt.rssi is not None and self.calibrates_power:
            self.powers.resume(learnt.rssi)

    def predict(self, motion: Motion) -> None:
        """Move the vehicles that are learnt from."""
        self.calibration.predict(motion)
        if self.calibrates_power:
            self.powers.predict(motion)

    def follow(self, motion: MotionModel, vehicles: int, dimension: int) -> None:
        """Learn from V vehicles that move by this model in D dimensions."""
        self._vehicles = vehicles
        self._follow_powers = partial(
            self.powers.follow, motion, vehicles, dimension, self._floor)
        if self.powers.follows:
            self._follow_powers()
        self.calibration.follow(
            kinematics_of(motion, dimension), vehicles, dimension, self._floor)

    def locate(self, observation: Observation) -> None:
        """Learn ahead of an epoch what its ranges to anchors are like: see `RangeCalibration`."""
        used = observation.heard & ~np.isnan(observation.range) & (observation.kind == ANCHOR)
        if self.calibrates and used.any():
            self.calibration.locate(observation, self._range_std(observation), used)

    def calibrate(self, observation: Observation, estimate: Estimate) -> list[Prior]:
        """
        Learn from an epoch what ranges and rssi are like, as far as that is switched on.

        Vehicles that take most of their ranges for outliers are lost, and teach nothing.

        Returns
        -------
        list of Prior
            What is known better by the way: see `RangeCalibration.opinions`.

        """
        if self.calibrates_power and (
                self.powers.follows or not np.isnan(observation.rssi).all()):
            self._calibrate_power(observation, estimate)
        if not self.calibrates or np.isnan(observation.range).all():
            return []
        ranged = observation.heard & ~np.isnan(observation.range)
        if self._floor > 0:
            lost = estimate.log_likelihood < math.log(self._floor) / 2 * ranged.sum(axis=1)
            ranged &= ~lost[:, None]
        self.calibration.learn(
            observation, estimate, self._range_std(observation), ranged,
            observation.kind == ANCHOR)
        return self.calibration.opinions(estimate)

    def corrected(self, observation: Observation) -> Observation:
        """Return an observation with rssi freed of what single anchors are off."""
        if not self.calibrates_power or np.isnan(observation.rssi).all():
            return observation
        return replace(
            observation, rssi=observation.rssi - self.powers.of(observation.sender))

    def start(self, prior: Prior) -> None:
        """Learn from a vehicle from a prior belief on."""
        self.powers.start(prior)

    def forget(self, vehicle: int) -> None:
        """Take a vehicle for anywhere."""
        self.powers.forget(np.arange(self._vehicles) == vehicle)

    def placed(self, estimate: Estimate) -> Estimate:
        """Return an estimate with those vehicles that are placed together with what rssi are."""
        return self.powers.placed(estimate) if self.calibrates_power else estimate

    def _calibrate_power(self, observation: Observation, estimate: Estimate) -> None:
        loss = self._supposed(observation.sender)
        used = self.powered(observation) & (observation.kind == ANCHOR) & (observation.hops == 1)
        silence = self.radio.radio_model == 'lognormal' and self.switches.silence != 'none'
        if not self.powers.follows:
            self._follow_powers()
        self.powers.forget(estimate.reinitialized)
        self.powers.learn(
            observation.sender, observation.position,
            observation.rssi + self.powers.of(observation.sender),
            used,
            (loss.reference, loss.exponent, loss.sigma),
            self.radio.sensitivity if silence else -math.inf,
            self.evidence(observation).without(Power, ShadowedBoundary),
            *(self._silent(observation) if silence else ()))

    def _silent(self, observation: Observation) -> tuple[Silence | None, tuple[Array, ...]]:
        """Return who was silent to vehicles that heard somebody, and what was to be expected."""
        silent = observation.silent
        if silent is None:
            return None, ()
        heard = observation.heard.any(axis=1, keepdims=True)
        loss = self._supposed(silent.sender)
        return (replace(silent, known=silent.known & heard),
                (loss.reference, loss.exponent, loss.sigma))

    def _measure(self, distance: Array, rng: np.random.Generator) -> Array:
        """Return what ranges say (V, A) [m] at these distances, never below 0."""
        radio = self.radio
        if self._asymmetric:
            short, long = self._asymmetry(distance)
            indicated = distance - draw_asymmetric(short, long, distance.shape, rng)
            return np.maximum(radio.range_scale * indicated + radio.range_bias, 0)
        noise = radio.range_std * rng.standard_normal(distance.shape)
        return np.maximum(radio.range_scale * distance + radio.range_bias + noise, 0)

    @property
    def _asymmetric(self) -> bool:
        return self.radio.range_noise == 'asymmetric_exponential'

    def _asymmetry(self, distance: Array) -> tuple[Array, Array]:
        """Return by how much ranges of this distance [m] are too short and too long [m]."""
        radio = self.radio
        return (radio.range_short_slope * distance + radio.range_short_offset,
                radio.range_long_slope * distance + radio.range_long_offset)

    def _indicated(self, ranges: Array) -> Array:
        """Return the distances [m] that measured ranges stand for, never below 0."""
        return np.maximum((ranges - self.calibration.bias) / self.calibration.scale, 0)

    def _std_of(self, ranges: Array) -> Array | float:
        """Return the standard deviation [m] of ranges, where they do not tell theirs."""
        if not self._asymmetric:
            return self.radio.range_std
        return self.calibration.scale * np.hypot(*self._asymmetry(self._indicated(ranges)))

    def _range_std(self, observation: Observation) -> Array:
        """Return the standard deviation (V, K) [m] of each range's noise."""
        ranges, told = observation.range, observation.range_std
        if self._asymmetric:
            return np.asarray(self._std_of(ranges))
        return np.where(np.isnan(told), np.float32(self.radio.range_std), told)

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

    def _ranging(self, references: References, observation: Observation, ranged: Array
                 ) -> Ranging:
        ranges = np.where(ranged, observation.range, 0)
        errors: RangeErrors
        if self._asymmetric:
            indicated = self._indicated(ranges)
            errors = AsymmetricErrors.of(*(column(np.where(ranged, scale, np.inf))
                                           for scale in self._asymmetry(indicated)))
        else:
            # Not cut at 0: a normal error reaches below.
            indicated = (ranges - self.calibration.bias) / self.calibration.scale
            std = np.maximum(self._range_std(observation), 1e-3) / self.calibration.scale
            errors = GaussianErrors.of(column(np.where(ranged, std, np.inf)))
        return Ranging(references, column(indicated), errors, column(ranged) > 0, self._floor)

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
        std = self._range_std(observation)
        furthest = (observation.range - self.calibration.bias + 3 * std) / self.calibration.scale
        measured = np.where(ranged, np.maximum(furthest, std), np.inf)
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
