"""Beacons and links: the PointCloud2 decoders."""

from __future__ import annotations

from random import Random

from harness import number, Target, text
import numpy as np
from tsmcl_ros import cdr, messages
from tsmcl_ros.types import Links, Observation

_FORMATS = {1: 'i1', 2: 'u1', 3: '<i2', 4: '<u2', 5: '<i4', 6: '<u4', 7: '<f4', 8: '<f8'}
_USUAL = {'id': 6, 'peer_id': 6, 'kind': 2, 'hops': 2}


def _cloud(rng: Random, names: list[str]) -> bytes:
    """Return a cloud of rows with these fields in any order, at any offset."""
    rng.shuffle(names)
    kinds = [_USUAL.get(name, 7 if rng.random() < 0.9 else 8) for name in names]
    if rng.random() < 0.05:
        kinds[rng.randrange(len(kinds))] = rng.randrange(1, 9)
    offsets, step = [], 0
    for kind in kinds:
        offsets.append(step)
        step += np.dtype(_FORMATS[kind]).itemsize + rng.choice((0, 0, 0, 1, 4))
    if rng.random() < 0.05:
        offsets[rng.randrange(len(offsets))] = rng.choice((0, step, 2**32 - 1))
    rows = np.zeros(rng.randrange(9) if rng.random() < 0.98 else rng.randrange(5000), np.dtype(
        {'names': names, 'formats': [_FORMATS[kind] for kind in kinds],
         'offsets': [min(offset, step) for offset in offsets], 'itemsize': step + 16}))
    for name in names:
        if name in ('id', 'peer_id'):
            rows[name] = np.array(
                rng.sample(range(len(rows) + 3), len(rows)), int) if rng.random() < 0.7 else 7
        elif name in ('kind', 'hops'):
            rows[name] = rng.choice((0, 1, 1, 2, 255)) % 128
        elif not name.startswith('cov') or rng.random() < 0.2:
            rows[name] = np.resize([number(rng) for _ in range(8)], len(rows))
    writer = cdr.Writer()
    writer.values('iI', rng.randrange(2**31), rng.randrange(10**9))
    writer.string(text(rng))
    height = rng.choice((1, 1, 1, 1, 0, 2, 2**16))
    writer.values('II', height, len(rows) if rng.random() < 0.97 else rng.choice((0, 2**32 - 1)))
    writer.values('I', len(names))
    for name, kind, offset in zip(names, kinds, offsets, strict=True):
        writer.string(name if rng.random() < 0.99 else text(rng, 'x'))
        writer.values('I', offset)
        writer.values('B', kind)
        writer.values('I', 1)
    writer.values('B', rng.random() < 0.01)
    writer.values('I', step + 16)
    writer.values('II', rng.randrange(9), len(rows) * (step + 16))
    writer.raw(rows.tobytes())
    writer.values('?', True)
    return writer.finish()


def _beacons(rng: Random) -> bytes:
    if rng.random() < 0.5:
        names = list(messages.BEACON.names or ())
        if rng.random() < 0.7:
            names = ['x', 'y', 'z', 'id', *rng.sample(names[4:], rng.randrange(len(names) - 3))]
        return _cloud(rng, names)
    scan = Observation.empty(1, rng.randrange(7), 3, rng.uniform(0, 100))
    shape = scan.sender.shape
    scan.sender[:] = np.arange(shape[1])
    scan.position[:] = np.reshape([number(rng) for _ in range(3 * shape[1])], (1, -1, 3))
    scan.covariance[:] = np.eye(3) * abs(number(rng))
    scan.range[:] = abs(number(rng))
    return messages.encode_beacons(scan, text(rng))[0]


def _links(rng: Random) -> bytes:
    if rng.random() < 0.3:
        return _cloud(rng, ['x', 'y', 'z', 'id', 'peer_id', 'rssi'])
    count = rng.randrange(2, 6)
    place = np.reshape([number(rng) for _ in range(3 * count)], (-1, 3))
    receiver, sender = np.nonzero(~np.eye(count, dtype=bool))
    return messages.encode_links(1.0, Links(
        receiver, sender, place[receiver], place[sender],
        np.array([number(rng, -100, 0) for _ in receiver])), text(rng))


_NAMES = [name.encode() + b'\0' for name in (*messages.BEACON.names, 'peer_id', 'intensity')]

TARGETS = (
    Target('beacons', messages.decode_beacons, _beacons, _NAMES, 18),
    Target('scan', messages.decode_scan, _beacons, _NAMES, 18),
    Target('links', messages.decode_links, _links, _NAMES, 6),
)
