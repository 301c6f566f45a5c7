"""
Write test/golden.json: the poses of each method for a bag of the package and a fixed seed.

    python tools/golden.py                        # after a change that is meant to change poses
    python tools/golden.py --show [METHOD ...]    # what it would write, for comparisons

Every bit of a pose follows from the bag, the seed, this package, and how numpy rounds. Its exp,
its sums and its BLAS differ in the last bit from version to version and with what the processor
has, so the file tells with which rounding it was made. Where that is the same poses must be equal
bit for bit, elsewhere to a millimetre in these twenty epochs: over longer runs a particle filter
may take another way after a difference in the last bit.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
import hashlib
import json
from pathlib import Path
import tempfile
from typing import Any

import numpy as np
from tsmcl_ros import messages
from tsmcl_ros.bag import Reader
from tsmcl_ros.config import load_yaml
from tsmcl_ros.methods import METHODS
from tsmcl_ros.scripts.localize_bag import localize_bag
from tsmcl_ros.types import Array

ROOT = Path(__file__).resolve().parents[1]
GOLDEN = ROOT / 'test' / 'golden.json'
BAG = ROOT / 'bags' / 'sumo'
SEED = 1


def rounding() -> str:
    """Return a text that is the same where numpy rounds in the same way."""
    rng = np.random.Generator(np.random.SFC64(0))
    digest = hashlib.sha256()
    for kind in (np.float32, np.float64):
        for size in (3, 17, 1000):
            values: Array = rng.uniform(0.1, 30.0, (size, 4)).astype(kind)
            square: Array = values.T @ values + np.eye(4, dtype=kind)
            for result in (
                np.exp(-values), np.log(values), np.log1p(values), np.sqrt(values),
                np.sin(values), np.cos(values), np.arctan2(values, 7), values ** 1.7,
                np.hypot(values, 3), values.sum(axis=0), values.sum(), np.cumsum(values),
                square, np.einsum('ni,nj->ij', values, values), np.linalg.norm(values, axis=1),
                np.linalg.inv(square), np.linalg.cholesky(square), np.linalg.eigvalsh(square),
                rng.standard_normal(size).astype(kind),
            ):
                digest.update(np.ascontiguousarray(result).tobytes())
    return f'numpy {np.__version__}, {digest.hexdigest()[:16]}'


def poses(method: str) -> dict[str, Any]:
    """Return the digest of a method's serialized poses, and where they are [m]."""
    settings = load_yaml(ROOT / 'config' / 'range_free.yaml') | {'seed': SEED, 'method': method}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder, 'out')
        localize_bag(str(BAG), str(out), settings)
        with Reader(out) as reader:
            topics = [topic for topic in reader.topics if topic.endswith('/pose')]
            data = [message.data for message in reader.messages(topics)]
    position = [messages.decode_pose(pose).position[:2] for pose in data]
    return {'sha256': hashlib.sha256(b''.join(data)).hexdigest(),
            'position': np.round(position, 6).tolist()}


def golden(methods: Iterable[str] = tuple(METHODS)) -> dict[str, Any]:
    """Return what test/golden.json should hold."""
    return {
        'written by': 'python tools/golden.py', 'bag': str(BAG.relative_to(ROOT)), 'seed': SEED,
        'rounding': rounding(), 'poses': {method: poses(method) for method in methods}}


def as_text(content: dict[str, Any]) -> str:
    """Return it as JSON, a method's positions on one line."""
    lines = [f'  {json.dumps(name)}: {json.dumps(value)}' for name, value in content.items()]
    return '{\n' + ',\n'.join(lines).replace('}, "', '},\n    "') + '\n}\n'


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--show', nargs='*', choices=METHODS, metavar='METHOD',
                        help='print it, of some methods or all, and write nothing')
    options = parser.parse_args()
    if options.show is None:
        GOLDEN.write_text(as_text(golden()), encoding='utf-8')
    else:
        print(as_text(golden(options.show or METHODS)), end='')
