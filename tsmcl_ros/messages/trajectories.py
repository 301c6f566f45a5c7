"""The poses of many messages at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from tsmcl_ros import cdr
from tsmcl_ros.messages.poses import check_pose, FURTHEST, TWIST, UNMEASURED, yaw_of
from tsmcl_ros.messages.stamps import join_in_order, naming
from tsmcl_ros.types import Array, MessageError, Trajectory

_STAMPED_POSE = np.dtype([
    ('seconds', '<i4'), ('nanoseconds', '<u4'), ('doubles', '<f8', (43,)),
])


def decode_poses(messages: Sequence[bytes]) -> Trajectory:
    """
    Return the trajectory of many poses with covariance at once.

    A message stamped as the one before it adds nothing and is left out.

    Raises
    ------
    MessageError
        Naming the first message that is malformed, in another frame, or goes back in time.

    """
    trajectory, covariance = _decode_trajectory(messages, strings=1, tail=0)
    return replace(trajectory, covariance=covariance)


def decode_odometries(messages: Sequence[bytes]) -> Trajectory:
    """
    Return the trajectory of many odometry messages at once, as `decode_poses` does.

    Odometry and ground truth carry no covariance that is worth having: it is None.
    """
    trajectory, _ = _decode_trajectory(messages, strings=2, tail=TWIST)
    return trajectory


def _decode_trajectory(
    messages: Sequence[bytes], strings: int, tail: int,
) -> tuple[Trajectory, Array]:
    """
    Return the trajectory of messages of one layout, and its positions' covariances (T, 3, 3).

    Messages hold a stamp, texts (`strings` of them), a pose with its covariance, and a `tail` of
    doubles. As all have the same texts, they differ in what pads their ends at most.
    """
    blocks = []
    texts = None
    done = 0
    for _, group in groupby(messages, key=len):
        block = list(group)
        with naming(done):
            reader, found = _read_texts(block[0], strings)
            start = reader.align(8)
            reader.skip(8 * (43 + tail))
            reader.finish()
        texts = texts or found
        data = b''.join(block)
        raw = np.frombuffer(data, np.uint8).reshape(len(block), -1)
        fixed = [0, 1, *(at for at in range(12, start) if at not in reader.padding)]
        differs = (raw[:, fixed] != raw[0, fixed]).any(axis=1) | (found != texts)
        if differs.any():
            at = int(np.argmax(differs))
            _refuse_texts(block[at], done + at, strings, texts)
        view = np.dtype({
            'names': ['seconds', 'nanoseconds', 'doubles'],
            'formats': ['<i4', '<u4', '(43,)<f8'],
            'offsets': [4, 8, start],
            'itemsize': len(block[0]),
        })
        blocks.append(np.frombuffer(data, view).astype(_STAMPED_POSE))
        done += len(block)
    # Most bags have one block, which need not be copied.
    rows = blocks[0] if len(blocks) == 1 else np.concatenate(
        [np.empty(0, _STAMPED_POSE), *blocks])
    doubles = rows['doubles']
    _check_doubles(doubles)
    stamp = join_in_order(rows['seconds'].astype(np.int64), rows['nanoseconds'])
    new = np.diff(stamp, prepend=-1.0) > 0
    covariance = doubles[:, 7:].reshape(-1, 6, 6)
    yaw = np.where(covariance[:, 5, 5] >= UNMEASURED, np.nan, yaw_of(*doubles[:, 3:7].T))
    return Trajectory(stamp[new], doubles[new, :3], yaw[new]), covariance[new, :3, :3]


def _read_texts(data: bytes, strings: int) -> tuple[cdr.Reader, list[str]]:
    reader = cdr.Reader(data)
    reader.values('iI')
    return reader, [reader.string() for _ in range(strings)]


def _refuse_texts(data: bytes, number: int, strings: int, texts: list[str]) -> None:
    with naming(number):
        _, found = _read_texts(data, strings)
        raise MessageError(
            f'its frame is {" to ".join(map(repr, found))}, must be as before '
            f'{" to ".join(map(repr, texts))}'
        )


def _check_doubles(doubles: Array) -> None:
    """Refuse poses (T, 43) with their covariances that cannot be true, naming the first."""
    with np.errstate(over='ignore', invalid='ignore'):
        length = (doubles[:, 3:7] ** 2).sum(axis=1)
    near = (np.abs(doubles[:, :3]) <= FURTHEST).all(axis=1)
    wrong = ~(near & np.isfinite(doubles).all(axis=1) & (length > 0) & np.isfinite(length))
    if wrong.any():
        at = int(np.argmax(wrong))
        with naming(at):
            check_pose(doubles[at, :7].tolist())
            raise MessageError('pose.covariance is not allowed, must be finite')
