"""
How fast localize_bag is on a real recording, and where its time goes.

    python test/benchmark/run.py bag

The recording is the robot mower's, ../shared/data/plaza1.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import io
from pathlib import Path
import tempfile
from typing import Any

from goals import Section
from timing import seconds
from tsmcl_ros import messages
from tsmcl_ros.bag import Message, Reader, Writer
from tsmcl_ros.endpoint import Endpoint
from tsmcl_ros.localizer import Localizer
from tsmcl_ros.scripts import import_csv
from tsmcl_ros.scripts.localize_bag import localize_bag

LOG = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'plaza1'
NAME = '/veh_0'
DECODERS: dict[str, Callable[[bytes], Any]] = {
    '/anchor_map': messages.decode_beacons,
    f'{NAME}/beacons': messages.decode_beacons,
    f'{NAME}/odom': messages.decode_odometry,
}


def measure() -> Section:
    """Time localize_bag, and each part of its work by itself."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, 'bag')
        with contextlib.redirect_stdout(io.StringIO()):
            if import_csv.main([str(LOG), str(bag)]):
                raise SystemExit(1)
        with Reader(bag) as reader:
            recorded = list(reader.messages())
            duration = reader.duration
        outs = (Path(folder, f'out{number}') for number in range(100))
        whole = seconds(lambda: localize_bag(str(bag), str(next(outs)), {'seed': 1}))
        parts = _parts(bag, recorded, outs)
    rows = [['', 's', 'share', 'times real time']]
    rows += [[name, f'{part:.2f}', f'{100 * part / whole:.0f} %', f'{duration / part:.0f}']
             for name, part in {'localize_bag': whole, **parts}.items()]
    return Section(
        'Bags',
        f'`localize_bag` on {LOG.name}: {len(recorded)} messages in {duration:.0f} s; by '
        'processor time.', [rows])


def _parts(bag: Path, recorded: list[Message], outs: Any) -> dict[str, float]:
    """Return what each part of the work takes by itself [s]."""
    inputs = [message for message in recorded if message.topic in DECODERS]
    decoded = [(message.topic, DECODERS[message.topic](message.data)) for message in inputs]
    estimates = _localize(decoded)
    endpoint = Endpoint(Localizer({}, 1), [NAME])
    poses = [(estimate.stamp, data)
             for estimate in estimates for _, data in endpoint.poses(estimate)]

    def read() -> None:
        with Reader(bag) as reader:
            for _ in reader.messages():
                pass

    def write() -> None:
        with Writer(next(outs)) as writer:
            writer.topic(f'{NAME}/pose', messages.POSE)
            kept = [message for message in recorded if not message.topic.endswith('/odom')]
            for message in kept:
                writer.topic(message.topic, message.type)
                writer.write(message.topic, message.stamp, message.data)
            for stamp, data in poses:
                writer.write(f'{NAME}/pose', stamp, data)

    return {
        'reading': seconds(read, 3),
        'decoding': seconds(
            lambda: [DECODERS[message.topic](message.data) for message in inputs], 3),
        'filter': seconds(lambda: _localize(decoded), 3),
        'encoding': seconds(
            lambda: [list(endpoint.poses(estimate)) for estimate in estimates], 3),
        'writing': seconds(write, 3),
    }


def _localize(decoded: list[tuple[str, Any]]) -> list[Any]:
    """Return the estimates from decoded messages."""
    localizer = Localizer({'seed': 1}, 1)
    estimates = []
    for topic, content in decoded:
        if topic.endswith('odom'):
            localizer.odometry(0, content)
        elif topic.endswith('beacons'):
            localizer.beacons(0, content[0])
        else:
            localizer.anchor_map(content[0])
        estimates += localizer.due()
    return estimates + localizer.finish()

