"""How anchors hear each other, one row of a PointCloud2 a link."""

from __future__ import annotations

import numpy as np
from tsmcl_ros.messages.clouds import (
    COORDINATE,
    encode_cloud,
    encode_layout,
    FAR,
    FLOAT,
    MAX_COORDINATE,
    NUMBER,
    parse_layout,
    read_cloud,
)
from tsmcl_ros.types import Array, Links, MessageError

LINK = np.dtype(
    [(name, '<f4') for name in ('x', 'y', 'z')]
    + [('id', '<u4'), ('peer_id', '<u4'), ('rssi', '<f4')],
)
"""One link as a row of a PointCloud2: anchor `id`, at x, y, z, hears `peer_id` with this rssi."""

_FIELDS = {
    **dict.fromkeys(('x', 'y', 'z'), COORDINATE), 'id': NUMBER, 'peer_id': NUMBER, 'rssi': FLOAT,
}
_LAYOUT = encode_layout(LINK, _FIELDS)


def decode_links(data: bytes) -> tuple[Links, str]:
    """
    Return how anchors hear each other (D = 3), and the frame of the positions.

    All fields of `LINK` must be there, read as those of beacons are. A row says where its own
    anchor is, so that every peer needs a row of its own.

    Raises
    ------
    MessageError
        If the bytes are not such links, or say what cannot be true: a position or rssi that is
        not finite, a position beyond 100 km, an anchor that hears itself or has two positions, a
        peer without a position, or a link that comes twice.

    """
    _, frame_id, cloud = read_cloud(
        data, lambda reader: parse_layout(reader, _FIELDS, tuple(_FIELDS)))
    position = np.stack([cloud[axis] for axis in 'xyz'], axis=1)
    receiver, sender = (cloud[name].astype(np.int64) for name in ('id', 'peer_id'))
    _check_links(receiver, sender, position, cloud['rssi'])
    position = position.astype(np.float32)
    identity, first = np.unique(receiver, return_index=True)
    return Links(
        receiver, sender, position, position[first[np.searchsorted(identity, sender)]],
        cloud['rssi'].astype(np.float32)), frame_id


def encode_links(stamp: float, links: Links, frame_id: str) -> bytes:
    """Return how anchors hear each other; a missing third dimension becomes zero."""
    rows = np.zeros(len(links.rssi), LINK)
    for axis, values in zip('xyz', links.receiver_position.T, strict=False):
        rows[axis] = values
    rows['id'], rows['peer_id'], rows['rssi'] = links.receiver, links.sender, links.rssi
    return encode_cloud(stamp, frame_id, _LAYOUT, rows, True)


def _check_links(receiver: Array, sender: Array, position: Array, rssi: Array) -> None:
    """Refuse links (L,) that cannot be true, naming the first; see `decode_links`."""
    def first(wrong: Array) -> int:
        return int(np.argmax(wrong)) if wrong.any() else -1

    far = ~(np.abs(position) <= MAX_COORDINATE)
    if (at := first(far.any(axis=1))) >= 0:
        axis = int(np.argmax(far[at]))
        raise MessageError(
            f'{"xyz"[axis]} {position[at, axis]:g} of id {receiver[at]} is not allowed, must be a '
            f'number {FAR}')
    if (at := first(~np.isfinite(rssi))) >= 0:
        raise MessageError(
            f'rssi {rssi[at]:g} of the link from id {receiver[at]} to peer_id {sender[at]} is not '
            'allowed, must be finite')
    if (at := first(receiver == sender)) >= 0:
        raise MessageError(
            f'peer_id {sender[at]} of id {receiver[at]} is not allowed, must be another anchor')
    if (at := first(~np.isin(sender, receiver))) >= 0:
        raise MessageError(
            f'peer_id {sender[at]} of id {receiver[at]} is unknown, must have a row of its own, '
            'which says where it is')
    identity, where = np.unique(receiver, return_index=True)
    own = where[np.searchsorted(identity, receiver)]
    if (at := first((position != position[own]).any(axis=1))) >= 0:
        raise MessageError(
            f'id {receiver[at]} stands at {position[own[at]].tolist()} and at '
            f'{position[at].tolist()}: an id must have one position')
    _, kept = np.unique([receiver, sender], axis=1, return_index=True)
    if (at := first(~np.isin(np.arange(len(receiver)), kept))) >= 0:
        raise MessageError(
            f'the link from id {receiver[at]} to peer_id {sender[at]} comes twice, must come once')
