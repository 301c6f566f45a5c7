"""What hearing and not hearing say of distances: that they lie below or above a radio range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Observation

# A logistic edge of width s lies within 0.01 of a Gaussian one of this std.
_LOGISTIC_STD = 1.702


@dataclass(frozen=True, eq=False)
class Bound:
    """
    Distances of V vehicles to B senders each that lie below (side 1) or above (side -1) a limit.

    Attributes
    ----------
    sender : (V, B) int
        Identities.
    position, covariance : (V, B, D), (V, B, D, D) float
        [m], [m^2].
    used : (V, B) bool
        False where nothing is said.
    limit, std : (V, B) float
        Where the edge is, and the standard deviation of its softness: [m], or log10 of metres
        and its decades if `logarithmic`; 1 where not used.
    side : int
        1 or -1.
    silent : bool
        Whether it is about anchors that were not heard.
    logarithmic : bool
        Whether the edge is soft on a logarithmic scale of distance, as under shadowing.

    """

    sender: Array
    position: Array
    covariance: Array
    used: Array
    limit: Array
    std: Array
    side: int
    silent: bool
    logarithmic: bool


def bounds(channel: Channel, observation: Observation, measured: Array) -> Iterator[Bound]:
    """
    Yield what an observation says of distances beside what it measures.

    Parameters
    ----------
    channel : Channel
        Which evidence counts, and how far radios reach.
    observation : Observation
        Of V vehicles.
    measured : (V, K) bool
        Rows that hold a measurement, which says more than that they were heard.

    """
    radius = channel.radius(observation.max_range, observation.sender)
    heard = observation.heard & (radius > 0) & ~measured & channel.switches.use_heard
    relayed = heard & (observation.hops == 2)
    said = observation.sender, observation.position, observation.covariance
    yield _bound(channel, *said, heard, np.where(relayed, 2 * radius, radius), 1, False)
    yield _bound(channel, *said, relayed, radius, -1, False)
    silent = observation.silent
    if silent is not None and channel.switches.silence != 'none':
        radius = channel.radius(silent.max_range, silent.sender)
        size = silent.position.shape[2]
        exact = np.zeros((*silent.position.shape, size))
        used = silent.known & (radius > 0) & observation.heard.any(axis=1, keepdims=True)
        yield _bound(channel, silent.sender, silent.position, exact, used, radius, -1, True)


def _bound(channel: Channel, sender: Array, position: Array, covariance: Array, used: Array,
           radius: Array, side: int, silent: bool) -> Bound:
    limit = np.where(used, radius, 1.0)
    logarithmic = channel.radio.radio_model == 'lognormal'
    if logarithmic:
        std, limit = 1 / channel.path_loss(sender).slope, np.log10(limit)
    else:
        std = _LOGISTIC_STD * channel.softness(limit)
    return Bound(sender, position, covariance, used, limit, std, side, silent, logarithmic)
