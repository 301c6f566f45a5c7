"""Fit path losses to CSV logs with ground truth, as parameters for a localizer."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

from tsmcl_ros.csv_log import read_log
from tsmcl_ros.evaluation.path_loss import as_parameters, fit_anchors, gather, join, Samples
from tsmcl_ros.scripts.cli import a_number, add_quiet, command_line, progress, run_script
from tsmcl_ros.types import LogError, Progress


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit from the command line and return the exit code."""
    return run_script(_fit, arguments)


def _fit(arguments: Sequence[str] | None) -> None:
    options = _parser().parse_args(arguments)
    show = progress(options.quiet)
    pooled, single, left = fit_anchors(
        join([_read(path, options.min_distance, show) for path in options.logs]), show)
    for identity, reason in left.items():
        print(f'note: anchor {identity} has the path loss of all together: {reason}',
              file=sys.stderr)
    text = (f'# Path losses fitted to {pooled.beacons} beacons of {len(single) + len(left)} '
            f'anchors, P_0 at 1 m:\n#     {command_line("fit_path_loss", arguments)}\n'
            + as_parameters(pooled, single, options.inflate))
    if options.out is None:
        print(text, end='')
        return
    with options.out.open('x', encoding='utf-8') as file:
        file.write(text)
    print(f'{options.out}: the path loss of all anchors, and {len(single)} of single ones')


def _read(path: str, min_distance: float, show: Progress) -> Samples:
    """Read what one log has to fit to."""
    log = read_log(path, show)
    for note in log.notes:
        print(f'note: {note}', file=sys.stderr)
    try:
        return gather(log, min_distance)
    except LogError as error:
        raise LogError(f'{path}: {error}') from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='fit_path_loss',
        description='Fit the path loss of each anchor, and of all together, to the rssi in CSV '
                    'logs with ground truth, and print a ROS parameter file for the localizer.',
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument('logs', nargs='+', metavar='LOG', help='folder of a log')
    parser.add_argument('--inflate', type=a_number(above=0), default=1.0, metavar='FACTOR',
                        help='multiply each sigma_db: successive rssi share their shadowing, so '
                             'a beacon tells less than it would by itself')
    parser.add_argument('--min-distance', type=a_number(above=0, unit='m'), default=0.5,
                        metavar='M', help='shorter distances count as this one [m]')
    parser.add_argument('--out', type=Path, metavar='FILE',
                        help='write the parameters to this file, which must not exist, instead')
    add_quiet(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
