"""
Which senders contradict what all others agree on, where no prediction can tell.

A vehicle that is to be placed has nothing but what it hears, of which some may be lies. Sound
senders agree on a place, and liars seldom on another, so what most agree on is looked for as
RANSAC does (Fischler and Bolles 1981): places that few of them tell are held against the others.
By ranges those come from D + 1 references each, and once more from all that agree with them; range
free they are the corners where the edges of two radio disks meet, one of which lies in the most
disks that have a point in common.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from tsmcl_ros.model import gaussian
from tsmcl_ros.model.bounds import LOGISTIC_STD
from tsmcl_ros.model.consistency import deviations
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.model.recollection import Disks
from tsmcl_ros.model.sampling import subsets
from tsmcl_ros.types import Array, Observation, Silence

# Further hypotheses add little: of 60 triples 18 are sound where a third of the senders lies.
_HYPOTHESES = 60
_SHARPEST = 1e-6  # m^2, of what is certain to be at a hard edge


def outvoted_by_ranges(channel: Channel, observation: Observation, limit: float) -> Array:
    """
    Return the rows (V, K) bool that contradict what most of the others agree on.

    Where there is no telling, as several majorities are possible or there is none, nobody does.

    Parameters
    ----------
    channel : Channel
        Tells what ranges mean.
    observation : Observation
        Of V vehicles.
    limit : float
        By how many standard deviations who contradicts is off.

    """
    against = np.zeros(observation.sender.shape, bool)
    distance, std, ranged = channel.distances(observation)
    vehicle = np.flatnonzero(ranged.sum(axis=1) > observation.position.shape[2] + 1)
    fits = gaussian.multilaterate(
        observation.position[vehicle], distance[vehicle], std[vehicle] ** 2, ranged[vehicle])
    # Mostly all agree.
    vehicle = vehicle[~fits.solved | _contradicted(
        channel, observation.of(vehicle), *_place(fits), limit).any(axis=1)]
    if len(vehicle):
        against[vehicle] = _by_ranges(channel, observation.of(vehicle), limit)
    return against


def supported_by_ranges(channel: Channel, observation: Observation, mean: Array,
                        covariance: Array, limit: float) -> Array:
    """
    Return the vehicles (V,) bool with whose beliefs as many ranges agree as with any other place.

    And at least D of them: who is elsewhere has that many agree by chance seldom, and then has as
    many as are heard agree on where it is.

    Parameters
    ----------
    channel, observation, limit
        As for `outvoted_by_ranges`.
    mean, covariance : (V, D), (V, D, D) float
        The beliefs [m, m^2].

    """
    ranged = channel.distances(observation)[2]
    contradicted = ranged & _contradicted(channel, observation, mean, covariance, limit)
    number = (ranged & ~contradicted).sum(axis=1)
    supported = np.asarray(number >= mean.shape[1])
    asked = np.flatnonzero(supported)
    against, sound = _tried(channel, observation.of(asked), limit)
    elsewhere = (ranged[asked][:, None] & ~against).sum(axis=2)
    supported[asked] = number[asked] >= np.where(sound, elsewhere, 0).max(axis=1, initial=0)
    return supported


@dataclass(frozen=True, eq=False)
class Verdict:
    """
    Whom the majority of V vehicles' disks contradicts.

    Attributes
    ----------
    against : (V, M) bool
        The senders that it does.
    disputed : (V, M) bool
        The senders that some majority contradicts, where several are possible; the same if that
        leaves less than three to believe.
    missing : (V, M) bool
        The senders that contradict the belief.
    refutation : (V,) int
        How many more senders contradict the belief than where most agree; 0 where all do.
    mean, covariance : (V, 2), (V, 2, 2) float64
        Of the corners of where most agree [m, m^2].

    """

    against: Array
    disputed: Array
    missing: Array
    refutation: Array
    mean: Array
    covariance: Array


def outvoted_by_disks(channel: Channel, disks: Disks, silent: Silence | None, limit: float,
                      mean: Array, variance: Array) -> Verdict:
    """
    Return which senders' disks miss where most of the others agree that V vehicles are.

    Parameters
    ----------
    channel : Channel
        Tells how soft the disks' edges are.
    disks : Disks
        Of M senders each, in the plane.
    silent : Silence or None
        In whose disks they are not.
    limit : float
        As for ranges.
    mean, variance : (V, 2), (V,) float
        The belief [m, m^2]; NaN where there is none.

    """
    columns = disks.sender.shape[1]
    centre, radius, used = (np.concatenate(parts, axis=1) for parts in (
        disks.centre, [disks.radius] * 2, [disks.used] * 2))
    corners, sound = _corners(centre, radius, used)
    places = np.concatenate([mean[:, None], corners], axis=1)
    belief = np.zeros(places.shape[:2])
    belief[:, 0] = variance
    missed = used[:, None] & (_excess(
        channel, places, centre, radius, belief, np.concatenate(disks.variance, axis=1)) > limit)
    missed = missed[:, :, :columns] | missed[:, :, columns:]
    further = np.zeros(places.shape[:2], int)
    if silent is not None:
        radius = channel.radius(silent.max_range, silent.sender)
        known = silent.known & (radius > 0)
        further += (known[:, None] & (-_excess(
            channel, places, silent.position, np.where(known, radius, 1), belief) > limit)
        ).sum(axis=2)
    against, alike, best, majority = _agreed(missed[:, 1:], further[:, 1:], sound, disks.used)
    disputed = (missed[:, 1:] & alike[:, :, None]).any(axis=1) & majority[:, None]
    enough = (disks.used & ~disputed).sum(axis=1) >= 3
    disputed = np.where(enough[:, None], disputed, against)
    number = missed[:, 0].sum(axis=1) + further[:, 0]
    # Where several majorities are possible, the belief's own is the likely one.
    against = np.where((majority & (number == best))[:, None], missed[:, 0], against)
    refutation, number = number - best, np.maximum(alike.sum(axis=1), 1)
    middle = np.einsum('vh,vhd->vd', alike, corners) / number[:, None]
    apart = (corners - middle[:, None]) * alike[:, :, None]
    covariance = np.einsum('vhi,vhj->vij', apart, apart) / number[:, None, None]
    edge = channel.softness(disks.radius).max(axis=1, initial=0)
    covariance += (LOGISTIC_STD * edge)[:, None, None] ** 2 * np.eye(2)
    return Verdict(against, disputed, missed[:, 0], refutation, middle, covariance)


def _excess(channel: Channel, places: Array, centre: Array, radius: Array, belief: Array,
            variance: Array | float = 0.0) -> Array:
    """
    Return how many standard deviations places (V, H, 2) are outside of disks (V, M).

    Places are uncertain by variances `belief` (V, H), and disks by `variance` (V, M) [m^2].
    """
    apart = np.linalg.norm(places[:, :, None] - centre[:, None], axis=3)
    uncertain = (LOGISTIC_STD * channel.softness(radius)) ** 2 + variance
    variance = np.maximum(uncertain[:, None] + belief[..., None], _SHARPEST)
    return np.asarray((apart - radius[:, None]) / np.sqrt(variance))


def _by_ranges(channel: Channel, observation: Observation, limit: float) -> Array:
    """Return the rows (V, K) bool that contradict the majority by their ranges."""
    against, sound = _tried(channel, observation, limit)
    return _agreed(against, np.array(0), sound, observation.heard)[0]


def _tried(channel: Channel, observation: Observation, limit: float) -> tuple[Array, Array]:
    """Return the rows (V, H, K) bool that contradict places, and which of these (V, H) are any."""
    vehicles, rows = observation.sender.shape
    distance, std, ranged = channel.distances(observation)
    owner = np.repeat(np.arange(vehicles), _HYPOTHESES)
    several = observation.of(owner)
    used = subsets(ranged, observation.position.shape[2] + 1, _HYPOTHESES).reshape(-1, rows)
    for _ in range(2):
        fix = gaussian.multilaterate(several.position, distance[owner], std[owner] ** 2, used)
        against = _contradicted(channel, several, *_place(fix), limit)
        used = ranged[owner] & ~against
    return (against.reshape(vehicles, _HYPOTHESES, rows),
            fix.solved.reshape(vehicles, _HYPOTHESES))


def _corners(centre: Array, radius: Array, used: Array) -> tuple[Array, Array]:
    """Return where circles meet (V, H, 2) [m], and their centres, and which are there (V, H)."""
    first, second = np.array(list(combinations(range(centre.shape[1]), 2))).T
    way = centre[:, second] - centre[:, first]
    length = np.maximum(np.linalg.norm(way, axis=2), 1e-9)
    way /= length[:, :, None]
    along = (length ** 2 + radius[:, first] ** 2 - radius[:, second] ** 2) / (2 * length)
    squared = radius[:, first] ** 2 - along ** 2
    foot = centre[:, first] + along[:, :, None] * way
    aside = np.sqrt(np.maximum(squared, 0))[:, :, None] * np.stack(
        [-way[:, :, 1], way[:, :, 0]], axis=2)
    meet = used[:, first] & used[:, second] & (squared >= 0)
    return (np.concatenate([foot + aside, foot - aside, centre], axis=1),
            np.concatenate([meet, meet, used], axis=1))


def _contradicted(channel: Channel, observation: Observation, mean: Array, covariance: Array,
                  limit: float) -> Array:
    """Return the rows (V, K) bool whose sender contradicts a place (V, D), NaN where none is."""
    found = deviations(channel, observation, mean, covariance)
    against = found.contradicts(limit) & ~found.silent
    return np.asarray(
        (against[:, :, None] & (found.sender[:, :, None] == observation.sender[:, None])
         ).any(axis=1) & observation.heard)


def _place(fix: gaussian.Fix) -> tuple[Array, Array]:
    """Return mean (V, D) and covariance (V, D, D) of fixes, NaN where there is none."""
    return np.where(fix.solved[:, None], fix.position, np.nan), fix.covariance


def _agreed(against: Array, further: Array, sound: Array, heard: Array
            ) -> tuple[Array, Array, Array, Array]:
    """
    Return the rows (V, K) bool that all the best of the hypotheses (V, H) contradict.

    Further reasons (V, H) speak against hypotheses as well. Nobody where the best still have half
    of the rows (V, K) that count against them. Next are which hypotheses are the best, how many
    (V,) they contradict, and whether that is a minority.
    """
    number = np.where(sound, against.sum(axis=2) + further, np.iinfo(int).max)
    best = number.min(axis=1, keepdims=True)
    alike = number == best
    most = np.where(alike & sound, against.sum(axis=2), 0).max(axis=1, initial=0)
    majority = 2 * most < heard.sum(axis=1)
    against = (against | ~alike[:, :, None]).all(axis=1) & majority[:, None]
    return against, alike & sound, best[:, 0], majority
