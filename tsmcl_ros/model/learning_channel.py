"""A radio whose own beacons teach what it is like."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
import math

import numpy as np
from tsmcl_ros.model.factors import Power, ShadowedBoundary
from tsmcl_ros.model.kinematics import kinematics_of
from tsmcl_ros.model.learnt import Learnt
from tsmcl_ros.model.links import fit_links
from tsmcl_ros.model.motion import MotionModel
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.radio_config import PathLoss
from tsmcl_ros.types import ANCHOR, Array, Estimate, Links, Motion, Observation, Prior, Silence


class LearningChannel(Channel):
    """
    A channel that learns what its ranges and path losses are, as far as that is switched on.

    From the links of anchors at once; else from vehicles that it follows.
    """

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
    def calibrates(self) -> bool:
        """Whether ranges teach what they are like."""
        # The mean of asymmetric errors grows with range, as a wrong scale would make it do.
        return self.switches.range_calibration == 'online' and not self.ranges.is_asymmetric

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
            self.calibration.locate(observation, self.ranges.std(observation), used)

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
            observation, estimate, self.ranges.std(observation), ranged,
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
        if self.calibrates_power:
            self._begin_powers()
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
        self._begin_powers()
        self.powers.forget(estimate.reinitialized)
        self.powers.learn(
            observation.sender, observation.position,
            observation.rssi + self.powers.of(observation.sender),
            used,
            (loss.reference, loss.exponent, loss.sigma),
            self.radio.sensitivity if silence else -math.inf,
            self.evidence(observation).without(Power, ShadowedBoundary),
            *(self._silent(observation) if silence else ()))

    def _begin_powers(self) -> None:
        """Follow vehicles by rssi, which costs something, no sooner than that is of use."""
        if not self.powers.follows:
            self._follow_powers()

    def _silent(self, observation: Observation) -> tuple[Silence | None, tuple[Array, ...]]:
        """Return who was silent to vehicles that heard somebody, and what was to be expected."""
        silent = observation.silent
        if silent is None:
            return None, ()
        heard = observation.heard.any(axis=1, keepdims=True)
        loss = self._supposed(silent.sender)
        return (replace(silent, known=silent.known & heard),
                (loss.reference, loss.exponent, loss.sigma))
