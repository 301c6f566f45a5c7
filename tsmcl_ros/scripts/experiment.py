"""Try a claim of the papers: a table, findings, and files with rows, settings and figure."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys
import time
from typing import Any

from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.monte_carlo import (
    Experiment,
    Report,
    Result,
    run_experiment,
)
from tsmcl_ros.evaluation.pools import Cluster, Processes, processors
from tsmcl_ros.evaluation.reproduction import write_reproduction
from tsmcl_ros.evaluation.results import prepare_folder, read_results, write_results
from tsmcl_ros.scripts.cli import a_whole_number, add_quiet, align, progress, run_script


def main(arguments: Sequence[str] | None = None) -> int:
    """Run experiments from the command line and return the exit code."""
    return run_script(_experiment, arguments)


def _experiment(arguments: Sequence[str] | None) -> None:
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.list:
        print(align([[name, full.title] for name, (full, _) in EXPERIMENTS.items()]))
        return
    if options.name is None:
        parser.error('an experiment is missing, must be one of all, report, '
                     f'{", ".join(EXPERIMENTS)}')
    if options.again and options.runs:
        parser.error('--again judges the runs that are there, and takes no --runs')
    if options.name != 'report':
        prepare_folder(options.out)
        for name in EXPERIMENTS if options.name == 'all' else [options.name]:
            full, quick = EXPERIMENTS[name]
            _run(name, quick if options.quick else full, options)
    if options.name in ('all', 'report'):
        page = options.report or options.out / 'reproduction.md'
        missing = write_reproduction(options.out, list(EXPERIMENTS), page)
        print(f'{page} sets the claims beside what was measured'
              + (f', but for {", ".join(missing)}' if missing else ''))


def _run(name: str, experiment: Experiment, options: argparse.Namespace) -> None:
    results, record = (read_results(options.out, name, experiment) if options.again
                       else _measure(name, experiment, options))
    report = experiment.judge(results)
    written = write_results(options.out, name, experiment, results, report, record)
    print(f'{name}: {experiment.title}\n\n{format_report(report)}\n')
    if options.quick:
        print('note: a quick run is too small to judge by')
    if f'{name}.png' not in written:
        print('note: no figure, as matplotlib is missing: pip install tsmcl_ros[plot]',
              file=sys.stderr)
    print(f'{", ".join(written)} are in {options.out}, '
          f'after {record["duration_s"]:.0f} s')


def _measure(name: str, experiment: Experiment, options: argparse.Namespace
             ) -> tuple[list[Result], dict[str, Any]]:
    """Run an experiment; return its results, and what is to be told of the run."""
    runs = options.runs or experiment.runs
    workers = options.workers or processors()
    begin = time.monotonic()
    pool = Cluster(options.scheduler) if options.scheduler else Processes(workers)
    results = run_experiment(experiment, options.seed, runs, pool, progress(options.quiet, name))
    return results, {
        'quick': options.quick, 'seed': options.seed, 'runs': runs,
        'workers': options.scheduler or workers,
        'duration_s': round(time.monotonic() - begin, 1)}


def format_report(report: Report) -> str:
    """Return a report as lines of text."""
    lines = [align(report.table, left=report.labels), '']
    for finding in report.findings:
        limit = f'; limit: {finding.limit}' if finding.limit else ''
        lines.append(f'{finding.claim}\n    {finding.measured}{limit}: {finding.verdict}')
    return '\n'.join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='experiment',
        description='Try a claim of the papers: print what was measured, and write NAME.csv '
                    '(rows), NAME.json (settings, seed, versions, findings) and NAME.png.')
    parser.add_argument('name', nargs='?', metavar='NAME',
                        choices=['all', 'report', *EXPERIMENTS],
                        help='all; report, which only writes the page of all results that are '
                             f'there; or one of {", ".join(EXPERIMENTS)}')
    parser.add_argument('--list', action='store_true', help='say what there is, and end')
    parser.add_argument('--quick', action='store_true',
                        help='a small version that takes seconds and proves nothing')
    parser.add_argument('--again', action='store_true',
                        help='judge and draw anew the results that are there; run nothing')
    parser.add_argument('--runs', type=a_whole_number(1), metavar='N',
                        help="Monte-Carlo runs of each case (default: the experiment's)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument('--workers', type=a_whole_number(1), metavar='N',
                       help='processes, which results do not depend on (default: '
                            f'{processors()})')
    where.add_argument('--scheduler', metavar='ADDRESS',
                       help='run on the Dask cluster of this scheduler instead, such as '
                            'tcp://192.168.1.7:8786; needs tsmcl_ros[dask] on all its hosts')
    parser.add_argument('--seed', type=a_whole_number(0), default=0, metavar='S',
                        help='seed of all randomness (default: %(default)s)')
    parser.add_argument('--out', type=Path, default=Path('experiments'), metavar='DIR',
                        help='folder for the files (default: %(default)s)')
    parser.add_argument('--report', type=Path, metavar='FILE',
                        help='the page that all and report write (default: reproduction.md in '
                             'the folder)')
    add_quiet(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
