"""
The echo guard: what a vehicle may believe of others that may know it from itself.

Vehicles that take each other for references send an estimate round: it comes back as if it were
news, again and again, and all become sure of what nobody has measured. How much of a reference's
knowledge is one's own cannot be told from a beacon, so the guard lets knowledge flow downhill
only. Along the line of sight, with own variance s_i^2 and the reference's s_j^2, a reference of
q = s_j^2 / s_i^2 >= 1 is left out, and the covariance of others is divided by 1 - q, as covariance
intersection does with a weight (Julier and Uhlmann 1997): however often it is heard, a vehicle
comes to know its distance as well as the reference does, and not better.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tsmcl_ros.types import Array, MessageError, Observation, PADDED, VEHICLE

# Of the largest variance: less than this is a covariance that FLOAT32 has made of nothing.
_SINGULAR = 1e-6


def guard(observation: Observation, mean: Array, covariance: Array, strength: float
          ) -> Observation:
    """
    Return an observation whose vehicles are fewer, and less certain.

    Anchors stay as they are, and so do all rows of a vehicle that has no estimate yet.

    Parameters
    ----------
    observation : Observation
        Of V vehicles.
    mean, covariance : (V, D), (V, D, D) float
        Their last estimates [m, m^2]; NaN where there is none.
    strength : float
        A factor on q: 1 as above, more to be warier, 0 for no guard.
    """
    rows = observation.heard & (observation.kind == VEHICLE)
    if strength == 0 or not rows.any():
        return observation
    sight = np.where(rows[:, :, None], observation.position - mean[:, None], 0)
    own = np.einsum('vki,vij,vkj->vk', sight, covariance, sight)
    theirs = np.einsum('vki,vkij,vkj->vk', sight, observation.covariance, sight)
    # Written so that NaN, no estimate, leaves a row in as it is.
    left = np.where(np.isfinite(own), own - strength * theirs, 1)
    share = np.where(np.isfinite(own) & (own > 0), left / np.where(own > 0, own, 1), left)
    usable = ~rows | (share > 0)
    factor = np.where(rows & usable, share, 1).astype(np.float32)
    return replace(
        observation, sender=np.where(usable, observation.sender, PADDED),
        covariance=observation.covariance / factor[:, :, None, None])


def refuse_certainty(observation: Observation) -> None:
    """
    Hold that no vehicle claims to know its position exactly along any axis, as anchors may.

    Raises
    ------
    MessageError
        Naming the first one that does.
    """
    rows = observation.heard & (observation.kind == VEHICLE)
    if not rows.any():
        return
    values = np.linalg.eigvalsh(observation.covariance[rows].astype(np.float64))
    singular = np.flatnonzero(values[:, 0] <= _SINGULAR * values[:, -1])
    if len(singular):
        sender = observation.sender[rows][singular[0]]
        raise MessageError(
            f'beacons: vehicle {sender} claims a singular covariance, with eigenvalues '
            f'{values[singular[0]].tolist()} m^2, must be positive definite')
