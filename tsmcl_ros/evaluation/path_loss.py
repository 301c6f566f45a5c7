"""
What a radio's path loss is, fitted to recordings with ground truth.

rssi = P_0 - 10 n log10(d) + N(0, sigma_db^2), d the horizontal distance [m]: that is what a
localizer of two dimensions compares rssi with, so heights go into the fit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
import math
from typing import NamedTuple

import numpy as np
from tsmcl_ros.csv_log import CsvLog
from tsmcl_ros.types import Array, LogError, Progress, unshown

MIN_BEACONS = 20

_MAX_EXPONENT = 10.0  # what `path_loss_exponent` allows
_RESOLUTION = 0.3  # dB, the standard deviation of rounding to whole dBm


@dataclass(frozen=True, eq=False)
class Samples:
    """
    Beacons whose distance is known.

    Attributes
    ----------
    sender : (B,) int64
        The anchor that each is from.
    distance, rssi : (B,) float64
        Horizontal distance [m] and received power [dBm].

    """

    sender: Array
    distance: Array
    rssi: Array


class Fit(NamedTuple):
    """P_0 at 1 m [dBm], n and sigma_db [dB], and how many beacons they were fitted to."""

    reference: float
    exponent: float
    sigma: float
    beacons: int


def gather(log: CsvLog, min_distance: float = 0.5) -> Samples:
    """
    Return the beacons of a log that have an rssi, within the truth's span.

    Parameters
    ----------
    log : CsvLog
        Its truth is interpolated at its beacons.
    min_distance : float
        Shorter distances [m] count as this one: the path loss has a pole at zero.

    Raises
    ------
    LogError
        If the log has no truth, or no such beacon.

    """
    if log.truth is None:
        raise LogError('has no truth.csv, which tells the distances to fit to')
    stamp, path = log.truth.stamp, log.truth.position
    used = ~np.isnan(log.rssi) & (log.stamp >= stamp[0]) & (log.stamp <= stamp[-1])
    if not used.any():
        raise LogError('has no beacon with an rssi within the time of the truth')
    sender = log.sender[used]
    anchor = log.anchors.position[0, np.searchsorted(log.anchors.sender[0], sender)]
    x, y = (np.interp(log.stamp[used], stamp, path[:, axis]) - anchor[:, axis]
            for axis in (0, 1))
    return Samples(sender, np.maximum(np.hypot(x, y), min_distance), log.rssi[used])


def join(parts: Iterable[Samples]) -> Samples:
    """Return all parts' samples as one."""
    parts = list(parts)
    return Samples(*(
        np.concatenate([getattr(part, item.name) for part in parts])
        for item in fields(Samples)))


def fit(distance: Array, rssi: Array) -> Fit:
    """
    Return the path loss that fits best to rssi (B,) [dBm] at distances (B,) [m].

    Least squares in dB; sigma_db is at least what rounding to whole dBm makes.

    Raises
    ------
    LogError
        If there are too few beacons, or what fits is no path loss: rssi has to fall with the
        distance.

    """
    count = len(rssi)
    if count < MIN_BEACONS:
        raise LogError(f'{count} beacons are too few, must be at least {MIN_BEACONS}')
    design = np.column_stack([np.ones(count), -10 * np.log10(distance)])
    (reference, exponent), _, rank, _ = np.linalg.lstsq(design, rssi, rcond=None)
    if rank < 2:
        raise LogError('all beacons are from one distance')
    if not 0 < exponent <= _MAX_EXPONENT:
        raise LogError(
            f'the path loss exponent {exponent:.2f} is not allowed, must be above 0 and at most '
            f'{_MAX_EXPONENT:g}')
    residual = rssi - design @ (reference, exponent)
    sigma = math.sqrt(residual @ residual / (count - 2))
    return Fit(float(reference), float(exponent), max(sigma, _RESOLUTION), count)


def fit_anchors(samples: Samples, progress: Progress = unshown
                ) -> tuple[Fit, dict[int, Fit], dict[int, str]]:
    """
    Return the path loss of all anchors together, and those of single ones.

    Parameters
    ----------
    samples : Samples
        Of all anchors.
    progress : Progress
        Shows the fitting.

    Returns
    -------
    pooled : Fit
        Of all beacons.
    single : dict of int to Fit
        By the anchor's id.
    left : dict of int to str
        Ids of the anchors without a fit of their own, and why.

    Raises
    ------
    LogError
        If there is no pooled fit.

    """
    pooled = fit(samples.distance, samples.rssi)
    single, left = {}, {}
    senders = np.unique(samples.sender).tolist()
    for identity in progress(senders, len(senders), 'anchor', 'fitting'):
        rows = samples.sender == identity
        try:
            single[identity] = fit(samples.distance[rows], samples.rssi[rows])
        except LogError as error:
            left[identity] = str(error)
    return pooled, single, left


def as_parameters(pooled: Fit, single: dict[int, Fit], inflation: float = 1.0) -> str:
    """Return the fits as a ROS parameter file, every sigma_db multiplied by the inflation."""
    lines = [
        '/**:',
        '  ros__parameters:',
        '    radio_model: lognormal',
        f'    rssi_at_reference: {pooled.reference:.1f}',
        f'    path_loss_exponent: {pooled.exponent:.2f}',
        f'    sigma_db: {inflation * pooled.sigma:.1f}',
    ]
    if single:
        lines.append('    anchor_path_loss:  # id P_0 n sigma_db')
    lines += [
        f"    - '{identity} {one.reference:.1f} {one.exponent:.2f} {inflation * one.sigma:.1f}'"
        for identity, one in sorted(single.items())
    ]
    return '\n'.join(lines) + '\n'
