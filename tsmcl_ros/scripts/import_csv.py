"""Turn a CSV log folder into a bag."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import heapq
from operator import itemgetter
import sys

from tsmcl_ros import messages
from tsmcl_ros.bag import STORAGES, Writer
from tsmcl_ros.csv_log import CsvLog, read_log
from tsmcl_ros.scripts.cli import (
    a_number,
    a_whole_number,
    add_quiet,
    command_line,
    progress,
    run_script,
)
from tsmcl_ros.types import Observation, Odometry, Progress, Trajectory

Record = tuple[float, str, bytes]
MAP, ODOM, BASE_LINK = 'map', 'odom', 'base_link'


def main(arguments: Sequence[str] | None = None) -> int:
    """Import a log from the command line and return the exit code."""
    return run_script(_import_log, arguments)


def _import_log(arguments: Sequence[str] | None) -> None:
    options = _parser().parse_args(arguments)
    show = progress(options.quiet)
    log = read_log(options.log, show)
    if options.threshold is not None:
        log = log.range_free(options.threshold)
    for note in log.notes:
        print(f'note: {note}', file=sys.stderr)
    epochs = list(show(log.epochs(options.epoch), None, 'epoch', 'gathering'))
    about = {'command': command_line('import_csv', arguments)}
    with Writer(options.bag, options.storage, about) as bag:
        _write(bag, log, epochs, f'/veh_{options.id}', show)
    counts = [
        f'{log.anchors.sender.size} anchors',
        f'{log.stamp.size} beacons in {len(epochs)} epochs',
        *(
            f'{part.stamp.size} poses of {name}'
            for name, part in (('odometry', log.odometry), ('ground truth', log.truth))
            if part is not None
        ),
    ]
    print(f'{options.bag}: {", ".join(counts)}')


def _write(
    bag: Writer, log: CsvLog, epochs: list[Observation], vehicle: str, show: Progress,
) -> None:
    """Write all messages in order of time, the anchor map first."""
    bag.topic('/anchor_map', messages.POINT_CLOUD, latched=True)
    bag.write('/anchor_map', log.anchors.stamp, messages.encode_beacons(log.anchors, MAP)[0])
    streams, total = [], len(epochs)
    for name, trajectory, frame_id in (
        (f'{vehicle}/odom', log.odometry, ODOM),
        (f'{vehicle}/ground_truth', log.truth, MAP),
    ):
        if trajectory is not None:
            bag.topic(name, messages.ODOMETRY)
            streams.append(_poses(name, trajectory, frame_id))
            total += len(trajectory.stamp)
    bag.topic(f'{vehicle}/beacons', messages.POINT_CLOUD)
    streams.append(_scans(f'{vehicle}/beacons', epochs))
    merged = heapq.merge(*streams, key=itemgetter(0))
    for stamp, name, data in show(merged, total, 'msg', 'writing'):
        bag.write(name, stamp, data)


def _poses(name: str, trajectory: Trajectory, frame_id: str) -> Iterator[Record]:
    for stamp, position, yaw in zip(
        trajectory.stamp.tolist(), trajectory.position, trajectory.yaw.tolist(), strict=True,
    ):
        pose = Odometry(stamp, position, yaw)
        yield stamp, name, messages.encode_odometry(pose, frame_id, BASE_LINK)


def _scans(name: str, epochs: list[Observation]) -> Iterator[Record]:
    for scan in epochs:
        yield scan.stamp, name, messages.encode_beacons(scan, MAP)[0]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='import_csv',
        description='Turn a CSV log folder (anchors.csv, beacons.csv, and odometry.csv and '
                    'truth.csv if any) into a bag.',
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument('log', help='folder of the log')
    parser.add_argument('bag', help='folder of the bag to make; must not exist')
    parser.add_argument('--epoch', type=a_number(above=0, unit='s'), default=0.5, metavar='S',
                        help='beacons of this period become one scan [s]')
    parser.add_argument('--threshold', type=a_number(unit='dBm'), metavar='DBM',
                        help='make the log range-free: keep beacons of at least this rssi [dBm] '
                             'and nothing of them but that they were heard')
    parser.add_argument('--storage', choices=STORAGES, default=STORAGES[0],
                        help='storage of the bag')
    parser.add_argument('--id', type=a_whole_number(0), default=0, metavar='N',
                        help='number of the vehicle, whose topics are /veh_N/...')
    add_quiet(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
