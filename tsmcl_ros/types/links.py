"""How anchors hear each other."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from tsmcl_ros.types.arrays import Array


@dataclass(frozen=True, eq=False)
class Links:
    """
    How anchors hear each other, which tells what rssi means.

    Attributes
    ----------
    receiver, sender : (L,) int64
        Identities of who hears, and of who is heard.
    receiver_position, sender_position : (L, D) float32
        [m].
    rssi : (L,) float32
        Received power [dBm].

    """

    receiver: Array
    sender: Array
    receiver_position: Array
    sender_position: Array
    rssi: Array

    @classmethod
    def none(cls) -> Links:
        """Return no links."""
        nobody, nowhere = np.zeros(0, np.int64), np.zeros((0, 3), np.float32)
        return cls(nobody, nobody, nowhere, nowhere, np.zeros(0, np.float32))

    @property
    def distance(self) -> Array:
        """(L,) float64: lengths [m]."""
        return np.asarray(np.linalg.norm(
            self.receiver_position.astype(np.float64) - self.sender_position, axis=1))

    def without(self, sender: Array) -> Links:
        """Return the links in which none of these (S,) is heard."""
        return self.picked(~np.isin(self.sender, sender))

    def updated(self, news: Links) -> Links:
        """Return the links of both; where both have one, the news win."""
        if not len(self.rssi):
            return news
        ends = np.concatenate([[news.receiver, news.sender], [self.receiver, self.sender]], axis=1)
        _, first = np.unique(ends, axis=1, return_index=True)
        return Links(*(
            np.concatenate([getattr(news, field.name), getattr(self, field.name)])
            for field in fields(Links))).picked(first)

    def picked(self, rows: Array) -> Links:
        """Return some of the links: an index, or (L,) bool."""
        return Links(*(getattr(self, field.name)[rows] for field in fields(Links)))
