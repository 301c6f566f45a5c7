"""Poses, odometry and trajectories of them."""

from __future__ import annotations

from functools import partial
from random import Random

from harness import joined, number, split, Target, text
from tsmcl_ros import cdr, messages

_PARTS = {messages.POSE: (1, 43), messages.POSE_STAMPED: (1, 7), messages.ODOMETRY: (2, 85)}


def _message(kind: str, rng: Random, stamp: int = -1, frame: str | None = None) -> bytes:
    strings, doubles = _PARTS[kind]
    writer = cdr.Writer()
    writer.values('iI', rng.randrange(2**31) if stamp < 0 else stamp, rng.randrange(10**9))
    for _ in range(strings):
        writer.string(text(rng) if frame is None else frame)
    covariance = [0.0] * 36
    if rng.random() < 0.3:
        for at in range(6):
            covariance[7 * at] = abs(number(rng))
        covariance[1] = covariance[6] = number(rng, -1, 1)
    values = [*(number(rng) for _ in range(7)), *covariance, *[0.0] * 42]
    writer.values(f'{doubles}d', *values[:doubles])
    return writer.finish()


def _several(kind: str, rng: Random) -> bytes:
    """Return messages of which most are alike, each after its length."""
    frame = text(rng)
    parts = [_message(kind, rng, stamp, frame if rng.random() < 0.97 else None)
             + bytes(rng.choice((0, 0, 0, 3))) for stamp in range(rng.randrange(1, 6))]
    return joined(parts)


TARGETS = (
    Target('odometry', messages.decode_odometry, partial(_message, messages.ODOMETRY), share=5),
    *(Target(f'pose_{name}', partial(messages.decode_any_pose, kind), partial(_message, kind),
             share=4)
      for name, kind in (('covariance', messages.POSE), ('stamped', messages.POSE_STAMPED),
                         ('odometry', messages.ODOMETRY))),
    Target('trajectory', lambda data: messages.decode_poses(split(data)),
           partial(_several, messages.POSE), share=5),
    Target('trajectory_odometry', lambda data: messages.decode_odometries(split(data)),
           partial(_several, messages.ODOMETRY), share=5),
)
