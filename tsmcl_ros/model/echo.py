"""
The echo guard: what a vehicle may believe of others that may know it from itself.

Vehicles that take each other for references send an estimate round: it comes back as if it were
news, again and again, and all become sure of what nobody has measured. How much of a reference's
knowledge is one's own cannot be told from a beacon, so the guard lets knowledge flow downhill
only. Along the line of sight, with own variance s_i^2 and the reference's s_j^2, a reference of
q = s_j^2 / s_i^2 >= 1 is left out, and the covariance of others is divided by 1 - q, as covariance
intersection does with a weight (Julier and Uhlmann 1997): however often it is heard, a vehicle
comes to know its distance as well as the reference does, and not better.

Several references can still teach more than each of them knows, as if their errors were news of
their own, which they are not where all have them from the same others. What an estimate owes to
the errors of its references is therefore kept apart and added to its covariance (`Hearsay`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tsmcl_ros.types import Array, Estimate, Observation, PADDED, VEHICLE

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


class Hearsay:
    """
    What the estimates of V vehicles owe to the errors of the vehicles that they have ranges to.

    A split covariance, as Julier and Uhlmann (Split covariance intersection, 2001) have it: to
    the independent part, which is the method's, comes one that never averages out, however many
    references there are and however often they are heard. An epoch whose ranges have the gain K,
    those to vehicles K_v, turns an inherited error e into (I - K) e + K_v e', with e' the
    references' error. Both terms may be one and the same error: their standard deviations add.

    Attributes
    ----------
    covariance : (V, D, D) float64
        Of the inherited errors [m^2].

    """

    def __init__(self, vehicles: int, dimension: int):
        self.covariance = np.zeros((vehicles, dimension, dimension))

    def forget(self, vehicle: int) -> None:
        """Begin again with a vehicle whose belief is replaced."""
        self.covariance[vehicle] = 0

    def add(self, estimate: Estimate, claimed: Observation, believed: Observation, std: Array,
            ranged: Array) -> Estimate:
        """
        Return the estimate with what is inherited in its covariance.

        Parameters
        ----------
        estimate : Estimate
            By what was believed.
        claimed, believed : Observation
            What the references said of themselves, and what the guard made of it.
        std : (V, K) float
            Of normal errors that would tell as much as the ranges' [m].
        ranged : (V, K) bool
            The rows whose range counts.

        """
        known = np.isfinite(estimate.mean).all(axis=1)
        self.covariance[estimate.reinitialized | ~known] = 0
        ranged = ranged & known[:, None]
        vehicles = ranged & (believed.kind == VEHICLE)
        if not (vehicles.any() or self.covariance.any()):
            return estimate
        sight, variance = _along(estimate, believed, ranged)
        precision = ranged / (np.square(std) + variance)
        own = np.where(known[:, None, None], estimate.covariance, 0)
        rest = np.eye(sight.shape[2]) - _gain(own, precision, sight)
        learnt = _gain(own, precision * vehicles, sight)
        share = precision * vehicles
        share = share / np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
        theirs = np.einsum('vk,vkij->vij', share, np.where(
            vehicles[:, :, None, None], claimed.covariance, 0))
        self.covariance = _correlated_sum(
            rest @ self.covariance @ np.swapaxes(rest, 1, 2),
            learnt @ theirs @ np.swapaxes(learnt, 1, 2))
        return replace(estimate, covariance=estimate.covariance + self.covariance)


def handed_on(estimate: Estimate, observation: Observation, std: Array, ranged: Array) -> Array:
    """
    Return what of a covariance (V, D, D) [m^2] comes by the errors of references.

    That is of an estimate by ranges alone, and to first order. The rest is by the ranges' own
    errors, which nobody shares; see `Hearsay.add` for the parameters.
    """
    known = np.isfinite(estimate.mean).all(axis=1)
    ranged = ranged & known[:, None]
    sight, variance = _along(estimate, observation, ranged)
    total = np.square(std) + variance
    own = np.where(known[:, None, None], estimate.covariance, 0)
    # K S K of every reference, summed, where K is the covariance times its information.
    return _gain(own, ranged * variance / np.square(total), sight) @ own


def _along(estimate: Estimate, observation: Observation, ranged: Array) -> tuple[Array, Array]:
    """Return unit vectors (V, K, D) to estimates, references' variance (V, K) [m^2] along them."""
    sight = np.where(
        ranged[:, :, None], observation.position - np.nan_to_num(estimate.mean)[:, None], 0)
    sight = sight / np.maximum(np.linalg.norm(sight, axis=2, keepdims=True), 1e-3)
    said = np.where(ranged[:, :, None, None], observation.covariance, 0)
    return sight, np.einsum('vki,vkij,vkj->vk', sight, said, sight)


def _gain(covariance: Array, precision: Array, sight: Array) -> Array:
    """
    Return by how much (V, D, D) an estimate goes along with its references.

    That is the covariance (V, D, D) after the ranges times their information: precision (V, K)
    [1/m^2] along unit vectors (V, K, D). A covariance that is more than the ranges leave, as that
    of several modes, would make more than all of it.
    """
    gain = covariance @ np.einsum('vk,vki,vkj->vij', precision, sight, sight)
    most = np.linalg.norm(gain, ord=2, axis=(1, 2))
    return np.asarray(gain / np.maximum(most, 1)[:, None, None])


def _correlated_sum(one: Array, other: Array) -> Array:
    """Return the covariance (V, D, D) of a sum of errors, however correlated they are."""
    first, second = (np.sqrt(np.maximum(np.trace(each, axis1=1, axis2=2), 1e-12))[:, None, None]
                     for each in (one, other))
    return np.asarray((first + second) * (one / first + other / second))


def certain(observation: Observation) -> tuple[Array, str]:
    """
    Return which vehicles' rows claim a position that is exact along an axis, as anchors' may be.

    Returns
    -------
    rows : (V, K) bool
        Those that do.
    fault : str
        What is wrong with the first, '' if none does.

    """
    rows = observation.kind == VEHICLE
    if not rows.any():
        return rows, ''
    rows &= observation.heard
    values = np.linalg.eigvalsh(observation.covariance[rows].astype(np.float64))
    singular = values[:, 0] <= _SINGULAR * values[:, -1]
    rows[rows] = singular
    if not singular.any():
        return rows, ''
    return rows, (
        f'vehicle {observation.sender[rows][0]} claims a singular covariance, with eigenvalues '
        f'{values[singular][0].tolist()} m^2, must be positive definite')
