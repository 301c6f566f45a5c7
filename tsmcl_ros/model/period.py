"""
The adaptive beacon period: who is localized well asks for fewer beacons.

Gao, Wang, Shen (mobile underwater acoustic networks). A vehicle asks for a beacon every
`period_factor` base periods. The paper's equation is lost; the form here has every property that
it states: a larger q raises the factor at equal residual, alpha leaves its maximum and moves its
steepest point, ln(alpha / q), to the right; it is flat at small residuals and needs alpha >> q.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.types import Array, ConfigError, MessageError

MAX_FACTOR = 2 ** 31 - 1


@dataclass(frozen=True)
class PeriodConfig(Config):
    """How often a vehicle wants beacons, in base periods."""

    beacon_period: str = param(
        'fixed', 'ask for a beacon every period_factor periods, or as often as the residual of '
        'the ranges demands', choices=('fixed', 'adaptive'))
    period_factor: int = param(
        1, 'periods between two beacons (beacon_period fixed)', low=1, high=MAX_FACTOR)
    period_q: float = param(
        15.0, 'periods between two beacons at no residual (beacon_period adaptive)', low=1.0,
        high=1e6)
    period_alpha: float = param(
        1e6, 'how large a residual may be before beacons come more often: exp(residual [m]) of '
        'where the factor is 1 (beacon_period adaptive)', above=0.0, high=1e300)

    def check(self) -> None:
        """Hold that alpha is far larger than q."""
        super().check()
        if self.period_alpha < 100 * self.period_q:
            raise ConfigError(
                f'period_alpha: {self.period_alpha:g} is not allowed, must be at least 100 times '
                f'period_q, {self.period_q:g}')

    def factor(self, residual: Array) -> Array | None:
        """Return the factor (V,) int for these residuals [m], None if none is asked for."""
        if self.beacon_period == 'fixed':
            return np.full(len(residual), self.period_factor) if self.period_factor > 1 else None
        return np.asarray(np.maximum(
            np.rint(omega(residual, self.period_q, self.period_alpha)), 1).astype(int))


def omega(residual: Array, q: float = 15.0, alpha: float = 1e6) -> Array:
    """
    Return 1 / (1 / q + exp(residual) / alpha), the factor before rounding.

    Parameters
    ----------
    residual : float array
        Sum of |measured - predicted| range over the references [m]; NaN, that is not known,
        counts as infinite.
    q, alpha : float
        Largest factor; the residual's scale.
    """
    residual = np.where(np.isnan(residual), np.inf, residual)
    with np.errstate(over='ignore'):
        return np.asarray(1 / (1 / q + np.exp(residual - math.log(alpha))))


def check_factor(factor: int) -> int:
    """
    Return a factor that somebody asks for.

    Raises
    ------
    MessageError
        If it is none.
    """
    if not 1 <= factor <= MAX_FACTOR:
        raise MessageError(
            f'beacon period: factor {factor} is not allowed, must be from 1 to {MAX_FACTOR}')
    return factor


@dataclass(frozen=True)
class AirCost:
    """
    What the messages of a network of M vehicles and N anchors weigh on the air.

    Attributes
    ----------
    vehicles, anchors : int
        M, N.
    max_factor : int
        Largest factor that a period message can tell, omega_max.
    """

    vehicles: int
    anchors: int
    max_factor: int = 15

    TYPE, STAMP, POSITION = 1, 28, 30

    @property
    def localization_bits(self) -> int:
        """Bits of an anchor's localization message: sender, type, time stamp and position."""
        return self._header + self.STAMP + self.POSITION

    @property
    def period_bits(self) -> int:
        """Bits of a period message: sender, type, receiver and period."""
        return self._header + _width(self.vehicles) + _width(self.max_factor)

    @property
    def _header(self) -> int:
        return _width(self.vehicles + self.anchors) + self.TYPE


def _width(values: int) -> int:
    """Return ceil(log2) of a number of values."""
    return max(values - 1, 0).bit_length()
