"""What hearing and not hearing say of distances: that they lie below or above a radio range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Observation

# A logistic edge of width s lies within 0.01 of a Gaussian one of this std.
LOGISTIC_STD = 1.702


@dataclass(frozen=True, eq=False)
class Bounds:
    """
    Distances of V vehicles to B senders each that lie below (side 1) or above (side -1) limits.

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
    side : (B,) int
        1 or -1.
    silent : (B,) bool
        Whether it is about anchors that were not heard.
    logarithmic : bool
        Whether edges are soft on a logarithmic scale of distance, as under shadowing.
    missed : (V, B) float
        How probable it is that nothing is heard within the limit either.

    """

    sender: Array
    position: Array
    covariance: Array
    used: Array
    limit: Array
    std: Array
    side: Array
    silent: Array
    logarithmic: bool
    missed: Array


def bounds(channel: Channel, observation: Observation, measured: Array) -> Bounds:
    """
    Return what an observation says of distances beside what it measures.

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
    never = np.zeros(heard.shape)
    groups = [(*said, heard, np.where(relayed, 2 * radius, radius), never, 1, False),
              (*said, relayed, radius, never, -1, False)]
    silent = observation.silent
    if silent is not None and channel.switches.silence != 'none':
        radius = channel.radius(silent.max_range, silent.sender)
        exact = np.zeros((*silent.position.shape, silent.position.shape[2]))
        used = silent.known & (radius > 0) & observation.heard.any(axis=1, keepdims=True)
        missed = np.zeros(used.shape) if silent.miss_rate is None else silent.miss_rate
        groups.append((silent.sender, silent.position, exact, used, radius, missed, -1, True))
    *columns, side, silence = zip(
        *([group for group in groups if group[3].any()] or groups[:1]), strict=True)
    sender, position, covariance, used, radius, missed = (
        np.concatenate(parts, axis=1) for parts in columns)
    width = [part.shape[1] for part in columns[0]]
    limit = np.where(used, radius, 1.0)
    logarithmic = channel.radio.radio_model == 'lognormal'
    if logarithmic:
        std, limit = 1 / channel.path_loss(sender).slope, np.log10(limit)
    else:
        std = LOGISTIC_STD * channel.softness(limit)
    return Bounds(sender, position, covariance, used, limit, std, np.repeat(side, width),
                  np.repeat(silence, width), logarithmic, missed)
