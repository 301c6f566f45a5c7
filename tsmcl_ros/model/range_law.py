"""What the ranges of a radio mean: how they are made, and how they err."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.model.calibration import RangeCalibration
from tsmcl_ros.model.radio_config import RadioConfig
from tsmcl_ros.model.ranging import (
    AsymmetricErrors,
    draw_asymmetric,
    GaussianErrors,
    RangeErrors,
    Ranging,
)
from tsmcl_ros.model.references import column, References
from tsmcl_ros.types import Array, Observation


class RangeLaw:
    """
    The law by which distances become ranges, and ranges distances.

    Parameters
    ----------
    radio : RadioConfig
        How ranges are made.
    calibration : RangeCalibration
        What their scale and offset are taken to be.

    """

    def __init__(self, radio: RadioConfig, calibration: RangeCalibration):
        self._radio, self._calibration = radio, calibration

    @property
    def is_asymmetric(self) -> bool:
        """Whether errors are of the asymmetric law."""
        return self._radio.range_noise == 'asymmetric_exponential'

    def measure(self, distance: Array, rng: np.random.Generator) -> Array:
        """Return what ranges say (V, A) [m] at these distances, never below 0."""
        radio = self._radio
        if self.is_asymmetric:
            short, long = self._asymmetry(distance)
            indicated = distance - draw_asymmetric(short, long, distance.shape, rng)
            return np.maximum(radio.range_scale * indicated + radio.range_bias, 0)
        noise = radio.range_std * rng.standard_normal(distance.shape)
        return np.maximum(radio.range_scale * distance + radio.range_bias + noise, 0)

    def std_of(self, ranges: Array) -> Array | float:
        """Return the standard deviation [m] of ranges, where they do not tell theirs."""
        if not self.is_asymmetric:
            return self._radio.range_std
        return self._calibration.scale * np.hypot(*self._asymmetry(self._indicated(ranges)))

    def std(self, observation: Observation) -> Array:
        """Return the standard deviation (V, K) [m] of each range's noise."""
        ranges, told = observation.range, observation.range_std
        if self.is_asymmetric:
            return np.asarray(self.std_of(ranges))
        return np.where(np.isnan(told), np.float32(self._radio.range_std), told)

    def distance(self, ranges: Array) -> Array:
        """Return the distances [m] that ranges say on average, freed of all that is known."""
        distance = self._freed(ranges)
        if self.is_asymmetric:
            short, long = self._asymmetry(self._indicated(ranges))
            distance = distance + short - long
        return distance

    def resolution(self, ranges: Array, std: Array) -> Array:
        """
        Return the standard deviation [m] of the normal errors that would tell as much.

        Those of the asymmetric law have the Fisher information 1 / (short long), more than 1 /
        their variance, as they are mostly small; others are normal, with a `std`.
        """
        if not self.is_asymmetric:
            return std
        short, long = self._asymmetry(self._indicated(ranges))
        return np.asarray(np.sqrt(short * long))

    def furthest(self, observation: Observation) -> Array:
        """Return the distances (V, K) [m] that three standard deviations leave possible."""
        std, calibration = self.std(observation), self._calibration
        furthest = (observation.range - calibration.bias + 3 * std) / calibration.scale
        return np.asarray(np.maximum(furthest, std))

    def factor(self, references: References, observation: Observation, ranged: Array,
               floor: float) -> Ranging:
        """Return what the ranges say of rows (V, K) bool, with a share that may say anything."""
        ranges = np.where(ranged, observation.range, 0)
        errors: RangeErrors
        if self.is_asymmetric:
            indicated = self._indicated(ranges)
            errors = AsymmetricErrors.of(*(column(np.where(ranged, scale, np.inf))
                                           for scale in self._asymmetry(indicated)))
        else:
            # Not cut at 0: a normal error reaches below.
            indicated = self._freed(ranges)
            std = np.maximum(self.std(observation), 1e-3) / self._calibration.scale
            errors = GaussianErrors.of(column(np.where(ranged, std, np.inf)))
        return Ranging(references, column(indicated), errors, column(ranged) > 0, floor)

    def _asymmetry(self, distance: Array) -> tuple[Array, Array]:
        """Return by how much ranges of this distance [m] are too short and too long [m]."""
        radio = self._radio
        return (radio.range_short_slope * distance + radio.range_short_offset,
                radio.range_long_slope * distance + radio.range_long_offset)

    def _freed(self, ranges: Array) -> Array:
        """Return ranges [m] freed of offset and scale."""
        return (ranges - self._calibration.bias) / self._calibration.scale

    def _indicated(self, ranges: Array) -> Array:
        """Return the distances [m] that measured ranges stand for, never below 0."""
        return np.maximum(self._freed(ranges), 0)
