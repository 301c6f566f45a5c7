"""What radios are told to be like, and the path losses of their anchors."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from tsmcl_ros.config import Config, param
from tsmcl_ros.model.links import LEAST_EXPONENT
from tsmcl_ros.types import Array, ConfigError


@dataclass(frozen=True)
class RadioConfig(Config):
    """What the radio does to a signal, for simulation and for scoring alike."""

    radio_model: str = param(
        'disk', 'who is heard: within a range, or above a sensitivity under shadowing',
        choices=('disk', 'lognormal'))
    radio_range: float = param(
        0.0, 'range of beacons that do not tell theirs, 0 if unknown (disk model)',
        unit='m', low=0.0, live=True)
    edge_softness: float = param(
        0.0, 'width of the soft edge of the radio disk when scoring, 0 for 0.02 of the range',
        unit='m', low=0.0, live=True)
    rssi_at_reference: float = param(
        -40.0, 'mean rssi at the reference distance, P_0', unit='dBm', low=-200.0, high=100.0,
        live=True)
    reference_distance: float = param(1.0, 'distance of P_0, d_0', unit='m', above=0.0)
    path_loss_exponent: float = param(2.0, 'path loss exponent n', above=0.0, high=10.0, live=True)
    sigma_db: float = param(
        4.0, 'standard deviation of the shadowing', unit='dB', above=0.0, live=True)
    sensitivity: float = param(
        -90.0, 'weakest rssi that is heard (lognormal model)', unit='dBm', low=-300.0, high=100.0,
        live=True)
    anchor_path_loss: tuple[str, ...] = param(
        (), "path loss of single anchors where it differs, each 'id P_0 n sigma_db'")
    range_bias: float = param(0.0, 'measured range = scale * distance + bias + noise', unit='m')
    range_scale: float = param(1.0, 'see range_bias', above=0.0)
    range_std: float = param(
        2.0, 'standard deviation of ranges that do not tell theirs', unit='m', above=0.0,
        live=True)
    range_noise: str = param(
        'gaussian', 'noise of ranges: normal with range_std, or asymmetric as range_short and '
        'range_long say, whatever ranges tell of theirs',
        choices=('gaussian', 'asymmetric_exponential'))
    range_short_slope: float = param(
        0.058, 'by how much ranges are too short where they are so, on average, per range',
        unit='m/m', low=0.0, high=1.0, live=True)
    range_short_offset: float = param(
        0.01, 'what comes to it at any range', unit='m', above=0.0, live=True)
    range_long_slope: float = param(
        0.19, 'by how much ranges are too long where they are so, on average, per range',
        unit='m/m', low=0.0, high=1.0, live=True)
    range_long_offset: float = param(
        0.21, 'what comes to it at any range', unit='m', above=0.0, live=True)
    measure_range: bool = param(False, 'the simulated radio measures ranges')
    measure_rssi: bool = param(
        False, 'the simulated radio measures rssi; that of a disk radio only counts if so')

    def check(self) -> None:
        """Hold that every anchor's path loss is one."""
        PathLoss.table(self)


@dataclass(frozen=True)
class EvidenceConfig(Config):
    """Which evidence of an observation counts, each switchable."""

    use_heard: bool = param(True, 'a beacon heard says that its sender is near', live=True)
    silence: str = param(
        'map', 'an anchor not heard is far: never, if heard before, if in the anchor map',
        choices=('none', 'memory', 'map'))
    miss_rate: float = param(
        0.0, 'share of beacons that get lost however near their anchor is; where more are missed '
        'than that, silence says less by itself', low=0.0, high=0.9)
    use_rssi: bool = param(
        True, 'rssi counts (lognormal model, or a disk radio that measures it)', live=True)
    use_range: bool = param(True, 'measured ranges count', live=True)
    range_calibration: str = param(
        'online', 'estimate scale and bias of the ranges while running, from range_scale and '
        'range_bias on', choices=('off', 'online'), live=True)
    range_scale_std: float = param(
        0.1, 'how far off range_scale may be, before ranges tell', above=0.0, high=1.0)
    range_bias_std: float = param(
        0.5, 'how far off range_bias may be, before ranges tell', unit='m', above=0.0)
    use_vehicles: bool = param(True, 'beacons of other vehicles count', live=True)
    echo_guard: float = param(
        1.0, 'how wary to be of knowledge that other vehicles may have from oneself: 1 lets it '
        'flow from the more to the less certain only, 0 is no guard', low=0.0, high=100.0,
        live=True)
    rssi_calibration: str = param(
        'links', 'estimate P_0 and n from how anchors hear each other, but of anchors in '
        'anchor_path_loss; or of all anchors while running, together with the poses, from where '
        'they are taken to be on',
        choices=('off', 'links', 'online'), live=True)
    link_neighbours: int = param(
        8, 'nearest neighbours that an anchor is calibrated by, 0 for all', low=0, high=10_000,
        live=True)
    path_loss_exponent_std: float = param(
        0.5, 'how far off path_loss_exponent may be, or n of all anchors alike, before links or '
        'rssi tell', above=0.0, high=10.0)
    rssi_at_reference_std: float = param(
        6.0, 'how far off P_0 of all anchors alike may be, before rssi tells', unit='dB',
        above=0.0, high=100.0)
    anchor_rssi_std: float = param(
        3.0, 'how far off P_0 of each anchor may be beside that', unit='dB', above=0.0,
        high=100.0)
    anchor_rssi_time: float = param(
        5.0, 'how long it stays so, by shadowing or, much longer, by itself', unit='s', above=0.0)
    sigma_db_std: float = param(
        0.2, 'how far off sigma_db of all anchors alike may be, as a share of it, before rssi '
        'tells', above=0.0, high=1.0)
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

    def corrected(self, reference: float, exponent: float, variance: float) -> PathLoss:
        """Return these with P_0 [dB] and n off, and uncertain by a variance [dB^2]."""
        return PathLoss(*(part.astype(np.float32) for part in (
            self.reference + reference, np.maximum(self.exponent + exponent, LEAST_EXPONENT),
            np.sqrt(self.sigma ** 2 + variance))))

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
            return np.asarray(10 ** self.log_distance(rssi))

    def log_distance(self, rssi: Array | float) -> Array:
        """Return log10 of that distance, which the shadowing leaves normal."""
        return np.asarray((self.reference - rssi) / (10 * self.exponent))
