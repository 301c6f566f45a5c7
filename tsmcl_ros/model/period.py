"""
The adaptive beacon period: who is localized well asks for fewer beacons.

Gao, Wang, Shen (mobile underwater acoustic networks). A vehicle asks for a beacon every
`period_factor` base periods. The paper's equation is lost; the form here has every property that
it states: a larger q raises the factor at equal residual, alpha leaves its maximum and moves its
steepest point, ln(alpha / q), to the right; it is flat at small residuals and needs alpha >> q.

The paper's residual, a sum of metres, grows with the noise of the ranges and the number of
anchors, so that q and alpha suit one network; normalized by what the filter expects it does not,
and q 3, alpha 5000 serve 6 to 18 anchors and variances of 1 to 10 m^2: exp(residual) / alpha is
then 1 / (alpha times the likelihood of the prediction).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.types import Array, ConfigError, MAX_PERIOD_FACTOR, Observation, PADDED

_TYPE, _STAMP, _POSITION = 1, 28, 30  # bits of a message's parts


@dataclass(frozen=True)
class PeriodConfig(Config):
    """How often a vehicle wants beacons, in base periods."""

    beacon_period: str = param(
        'fixed', 'ask for a beacon every period_factor periods, or as often as the residual of '
        'the ranges demands', choices=('fixed', 'adaptive'))
    period_residual: str = param(
        'sum', 'the residual: sum of |measured - predicted| range [m], or minus the log of how '
        'likely the predicted position is in view of the ranges, 0 at best (beacon_period '
        'adaptive)', choices=('sum', 'normalized'))
    period_factor: int = param(
        1, 'periods between two beacons (beacon_period fixed)', low=1, high=MAX_PERIOD_FACTOR)
    period_q: float = param(
        15.0, 'periods between two beacons at no residual (beacon_period adaptive)', low=1.0,
        high=1e6, live=True)
    period_alpha: float = param(
        1e6, 'how large a residual may be before beacons come more often: exp(residual) of '
        'where the factor is 1 (beacon_period adaptive)', above=0.0, high=1e300, live=True)

    def check(self) -> None:
        """Hold that alpha is far larger than q."""
        super().check()
        if self.period_alpha < 100 * self.period_q:
            raise ConfigError(
                f'period_alpha: {self.period_alpha:g} is not allowed, must be at least 100 times '
                f'period_q, {self.period_q:g}')

    @property
    def asks(self) -> bool:
        """Whether another period is asked for than every base period."""
        return self.beacon_period == 'adaptive' or self.period_factor > 1

    def factor(self, residual: Array) -> Array:
        """Return what factors (V,) int vehicles with these residuals (V,) ask for."""
        if self.beacon_period == 'fixed':
            return np.full(len(residual), self.period_factor)
        return np.asarray(np.maximum(
            np.rint(omega(residual, self.period_q, self.period_alpha)), 1).astype(int))


def omega(residual: Array, q: float = 15.0, alpha: float = 1e6) -> Array:
    """
    Return 1 / (1 / q + exp(residual) / alpha), the factor before rounding.

    Parameters
    ----------
    residual : float array
        See `period_residual`; NaN, that is not known, counts as infinite.
    q, alpha : float
        Largest factor; the residual's scale.

    """
    residual = np.where(np.isnan(residual), np.inf, residual)
    with np.errstate(over='ignore'):
        return np.asarray(1 / (1 / q + np.exp(residual - math.log(alpha))))


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

    @property
    def localization_bits(self) -> int:
        """Bits of an anchor's localization message: sender, type, time stamp and position."""
        return self._header + _STAMP + _POSITION

    @property
    def period_bits(self) -> int:
        """Bits of a period message: sender, type, receiver and period."""
        return self._header + _width(self.vehicles) + _width(self.max_factor)

    @property
    def _header(self) -> int:
        return _width(self.vehicles + self.anchors) + _TYPE


class Schedule:
    """
    When vehicles get beacons, as they have asked for, and what has been on the air for it.

    Parameters
    ----------
    vehicles : int
        V.

    Attributes
    ----------
    factor : (V,) int
        Base periods from one beacon to the next.
    localizations, requests : (V,) int
        Messages so far: beacons passed on to each vehicle, and periods that it has asked for.

    """

    def __init__(self, vehicles: int):
        self.factor = np.ones(vehicles, int)
        self.localizations, self.requests = np.zeros((2, vehicles), int)
        self._waited = np.full(vehicles, MAX_PERIOD_FACTOR)
        self._largest = 1

    def ask(self, vehicle: int, factor: int) -> None:
        """Give a vehicle beacons this often, counted from its last one on."""
        self.factor[vehicle] = factor
        self.requests[vehicle] += 1
        self._largest = max(self._largest, factor)

    def pass_on(self, heard: Observation) -> Observation:
        """
        Let one base period pass, and return what of its beacons (V, K) is meant for the vehicles.

        Who hears nothing when its time has come gets the next beacon that it can hear.
        """
        self._waited += 1
        due = self._waited >= self.factor
        passed = replace(heard, sender=np.where(due[:, None], heard.sender, PADDED))
        self._waited[passed.heard.any(axis=1)] = 0
        self.localizations += passed.heard.sum(axis=1)
        return passed

    def bits(self, anchors: int) -> int:
        """Return what all messages weighed, in a network of this many anchors."""
        cost = AirCost(len(self.factor), anchors, self._largest)
        return int(self.localizations.sum() * cost.localization_bits
                   + self.requests.sum() * cost.period_bits)


def _width(values: int) -> int:
    """Return ceil(log2) of a number of values."""
    return max(values - 1, 0).bit_length()
