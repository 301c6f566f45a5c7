"""Who hears whom in a simulated world, and what is measured of it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree
from tsmcl_ros.model.radio import Channel
from tsmcl_ros.types import Array, Links, Observation


def receive(
    channel: Channel,
    position: Array,
    senders: Observation,
    rng: np.random.Generator,
    stamp: float,
    drop_rate: float = 0.0,
) -> Observation:
    """
    Return what vehicles hear of what was transmitted.

    Parameters
    ----------
    channel : Channel
        The radio.
    position : (V, D) float
        Where the vehicles are [m].
    senders : Observation
        V = 1: the K transmitted rows; each is sent from the position that it claims, of which
        the first D coordinates count.
    rng : numpy.random.Generator
        For what the channel and losses draw.
    stamp : float
        Reception time [s].
    drop_rate : float
        Share of beacons lost however near they are.

    Returns
    -------
    Observation
        V vehicles, padded to the most that one of them heard; each one's rows in the order of
        `senders`. Max_range, range, range_std and rssi are the channel's.

    Raises
    ------
    ConfigError
        If the channel has no radio range.

    """
    vehicles, dimension = position.shape
    sent = senders.vehicle(0).project(dimension)
    pairs = _within(channel.reach, position, sent.position[0])
    vehicle, _, rows = hear(channel, pairs, sent, rng, drop_rate)
    return Observation.tabulate(vehicle, rows, vehicles, dimension, stamp)


def hear_each_other(channel: Channel, anchors: Observation, rng: np.random.Generator) -> Links:
    """
    Return with which rssi anchors hear each other, of those of which both hear the other.

    Parameters
    ----------
    channel : Channel
        A radio that measures rssi.
    anchors : Observation
        V = 1: see `anchor_table`.
    rng : numpy.random.Generator
        For what the channel draws.

    Raises
    ------
    ConfigError
        If the channel has no radio range.

    """
    position, identity = anchors.position[0], anchors.sender[0]
    receiver, sender, distance = apart(channel.reach, position)
    measured = channel.hear(distance[None], rng, identity[None, sender])
    mask = measured.mask[0]
    there, back = receiver * len(identity) + sender, sender * len(identity) + receiver
    both = mask & np.isin(there, back[mask])
    receiver, sender = receiver[both], sender[both]
    return Links(identity[receiver], identity[sender], position[receiver], position[sender],
                 measured.rssi[0, both])


def hear(channel: Channel, pairs: tuple[Array, Array, Array], sent: Observation,
          rng: np.random.Generator, drop_rate: float) -> tuple[Array, Array, dict[str, Array]]:
    """
    Return who hears whom, of the pairs that `_within` found, as what rows of an observation.

    `sent` (V = 1) has no padding; vehicle and sender are indices (M,), rows (M, ...) by field.
    """
    vehicle, sender, distance = pairs
    measured = channel.hear(distance[None], rng, sent.sender[:, sender])
    mask = measured.mask[0]
    if drop_rate > 0:
        mask = mask & (rng.random(mask.shape) >= drop_rate)
    vehicle, sender = vehicle[mask], sender[mask]
    measures = (['range', 'range_std'] * channel.radio.measure_range
                + ['rssi'] * channel.radio.measure_rssi)
    return vehicle, sender, {
        'max_range': np.full(len(vehicle), channel.radio_range),
        **{name: getattr(sent, name)[0].take(sender, axis=0)
           for name in ('sender', 'kind', 'hops', 'position', 'covariance')},
        **{name: getattr(measured, name)[0, mask] for name in measures},
    }


def _within(reach: float, vehicles: Array, senders: Array) -> tuple[Array, Array, Array]:
    """
    Find the pairs of a vehicle (V, D) and a sender (A, D) that are within reach [m].

    Returns indices of vehicles and of senders, and distances [m], sorted in that order.
    """
    pairs = _tree(vehicles).sparse_distance_matrix(
        _tree(senders), _beyond(reach), output_type='ndarray')
    return _measured(pairs['i'] * len(senders) + pairs['j'], vehicles, senders)


def apart(reach: float, vehicles: Array) -> tuple[Array, Array, Array]:
    """Find, as `_within` does, the pairs of two vehicles (V, D), either of them first."""
    one, other = _tree(vehicles).query_pairs(_beyond(reach), output_type='ndarray').T
    count = len(vehicles)
    return _measured(
        np.concatenate([one * count + other, other * count + one]), vehicles, vehicles)


def _tree(points: Array) -> KDTree:
    """Return a tree that serves one search: to balance it would cost more than it saves."""
    return KDTree(points, balanced_tree=False, compact_nodes=False)


def _beyond(reach: float) -> float:
    """Return a little more than the reach: its very edge is the channel's to judge."""
    return reach * (1 + 1e-9)


def _measured(pairs: Array, vehicles: Array, senders: Array) -> tuple[Array, Array, Array]:
    """Sort pairs, numbered row by row, into indices and distances: see `_within`."""
    vehicle, sender = np.divmod(np.sort(pairs), len(senders))
    return vehicle, sender, np.linalg.norm(
        vehicles.take(vehicle, axis=0) - senders.take(sender, axis=0), axis=1)
