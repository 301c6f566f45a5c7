"""
Path loss calibrated by how references hear each other (Liu, R-MCL).

The paper ranges to a reference J by D_{J,Jk} 10^((rssi_{J,Jk} - rssi_{W,J}) / (10 n)), as a
geometric mean over the links of J with its k nearest neighbours. That is a P_0 of J's own, the
mean of rssi + 10 n log10(D) over its links, which errs by the shadowing over sqrt(k). Here links
count for the one who is heard, whose transmit power it is, and the references share what they
have in common: each P_0 is drawn towards the mean of all, as far as chance explains why they
differ (DerSimonian and Laird 1986). Where they do differ it is the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from tsmcl_ros.types import Array, Links

LEAST_EXPONENT = 0.1


@dataclass(frozen=True, eq=False)
class Fit:
    """
    Path losses of senders, and last that of anybody else.

    Attributes
    ----------
    identity : (S,) int64
        The senders, increasing.
    reference : (S + 1,) float64
        P_0 at 1 m [dBm].
    exponent : float
        n, common to all.
    sigma : (S + 1,) float64
        Shadowing and the error of P_0 together [dB].

    """

    identity: Array
    reference: Array
    exponent: float
    sigma: Array


def fit_links(links: Links, reference: float, exponent: float, sigma: float,
              exponent_std: float, neighbours: int) -> Fit:
    """
    Fit P_0 of every sender, and n, to links.

    Parameters
    ----------
    links : Links
        At least one.
    reference, exponent, sigma : float
        P_0 at 1 m [dBm], n, and sigma_db as they were taken to be; of P_0 nothing is left.
    exponent_std : float
        How far off n may be; the fewer links, and the more of one length, the more it matters.
    neighbours : int
        So many of a sender's links count, the shortest; 0 for all.

    """
    identity, sender, distance, rssi = _shortest(links, neighbours)
    loss = -10 * np.log10(np.maximum(distance, 1e-3))
    excess = rssi - reference - exponent * loss
    total = len(rssi)
    normal = np.array([[total, loss.sum()],
                       [loss.sum(), np.square(loss).sum() + (sigma / exponent_std) ** 2]])
    common, steeper = np.linalg.solve(normal, [excess.sum(), (excess * loss).sum()])
    count = np.bincount(sender)
    off = np.bincount(sender, excess - common - steeper * loss) / count
    # What the senders' means differ by beyond chance.
    freedom = total - np.square(count).sum() / total
    beyond = (count * off ** 2).sum() - (len(count) - 1) * sigma ** 2
    apart = max(beyond / freedom, 0.0) if freedom > 0 else 0.0
    chance = sigma ** 2 / count
    share = apart / (apart + chance)
    left = np.append(share * chance, apart) + sigma ** 2 / total
    return Fit(identity, reference + common + np.append(share * off, 0.0),
               max(exponent + float(steeper), LEAST_EXPONENT), np.sqrt(sigma ** 2 + left))


def _shortest(links: Links, neighbours: int) -> tuple[Array, Array, Array, Array]:
    """Return ids (S,), and index, length [m] and rssi [dBm] (L,) of the links that count."""
    distance = links.distance
    order = np.lexsort((distance, links.sender))
    identity, first, sender = np.unique(
        links.sender[order], return_index=True, return_inverse=True)
    rank = np.arange(len(order)) - first[sender]
    near = rank < (neighbours or len(order))
    order, sender = order[near], sender[near]
    return identity, sender, distance[order], links.rssi[order].astype(np.float64)
