"""A whole localizer, on hostile messages that decoders have nothing against."""

from __future__ import annotations

from random import Random

from clouds import TARGETS as CLOUDS
from harness import joined, split, Target
import numpy as np
from others import TARGETS as OTHERS
from poses import TARGETS as POSES
from tsmcl_ros import messages
from tsmcl_ros.config import build
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.inputs import InputConfig
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.types import MessageError

_MAKE = {target.name: target.make for target in (*CLOUDS, *POSES, *OTHERS)}
_INPUTS = build(InputConfig, {
    'anchors': ('1 0 0', '2 5 0', '3 0 9'), 'ranges': (r'range_(\d+)', 'range')})
_SETTINGS = {'max_particles': 60, 'min_particles': 50, 'seed': 1}
# What takes each topic's messages apart, in the order in which `_live` has them.
_KINDS = ('beacons', 'links', 'beacons', 'odometry', 'pose_covariance', 'range', 'range')


def _messages(rng: Random) -> bytes:
    """Return messages, each after the number of its topic, mostly one shortly after the other."""
    parts = []
    for time in range(rng.randrange(1, 9)):
        kind = rng.randrange(len(_KINDS))
        data = _MAKE[_KINDS[kind]](rng)
        if rng.random() < 0.9:
            data = data[:4] + time.to_bytes(4, 'little') + data[8:]
        parts.append(bytes([kind]) + data)
    return joined(parts)


def _live(data: bytes) -> None:
    """Take messages as a node does, which goes on after one that it refuses."""
    with np.errstate(all='ignore'):
        endpoint = Endpoint(Localizer(_SETTINGS), [''], inputs=_INPUTS)
        ranges = endpoint.ranges.discover({'/range': messages.RANGE, '/range_2': messages.RANGE})
        handlers = [handler for _, handler in (*endpoint.inputs.values(), *ranges.values())]
        refused: MessageError | None = None
        for part in filter(None, split(data)):
            try:
                handlers[part[0] % len(handlers)](part[1:])
            except MessageError as error:
                refused = error
            for estimate in endpoint.due():
                for _, pose in endpoint.poses(estimate):
                    messages.decode_pose(pose)
        if refused:
            raise refused


TARGETS = (Target('live', _live, _messages, share=0.25),)
