"""
The main job in one command: a fleet that finds itself over DDS, recorded and evaluated.

Anchors, simulator, fleet and recorder run as processes of their own, in a ROS domain of their
own, so that nothing else on the host takes part.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
import ctypes
import json
import math
import os
from pathlib import Path
import re
import signal
import socket
import subprocess
import sys
import time
from typing import Any

from tsmcl_ros.bag import STORAGES
from tsmcl_ros.methods import METHODS
from tsmcl_ros.nodes.process import session, Stopped
from tsmcl_ros.nodes.watch import Watch
from tsmcl_ros.scripts.cli import (
    a_number,
    a_whole_number,
    add_quiet,
    command_line,
    progress,
    progress_bar,
    run_script,
)
from tsmcl_ros.scripts.evaluate import format_table, read_all, write_evaluation
from tsmcl_ros.scripts.scenario import RANGE_FREE, read_scenario, Scenario
from tsmcl_ros.types import ConfigError, TsmclError

_START_PATIENCE = 60.0  # s, for four processes that import and find each other
_LAST_PATIENCE = 10.0  # s, for the last estimates
_STOP_PATIENCE = 60.0  # s, for one to close what it has open, a recorder of 500 topics among them


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo and return the exit code."""
    return run_script(_demonstrate, arguments)


def _demonstrate(arguments: Sequence[str] | None) -> None:
    options, scenario = _read(arguments)
    out = options.out or _unused(Path('out', 'demo'))
    if out.exists():
        raise ConfigError(f'--out: {out} exists already, must be a folder to be made')
    bag = out / 'bag'
    nodes = _nodes(options, scenario)
    with Processes(out / 'log') as processes:
        duration = _simulate(processes, options, nodes, bag)
        runs = {f'{options.method}, over DDS': bag} | _compare(processes, options, scenario, bag)
    _report(options, nodes, runs, duration, out, arguments)


def _read(arguments: Sequence[str] | None) -> tuple[argparse.Namespace, Scenario]:
    """Return options and scenario; what the scenario says is the default of the options."""
    parser = _parser()
    path = parser.parse_args(arguments).config
    if path is None:
        return parser.parse_args(arguments), RANGE_FREE
    scenario = read_scenario(path)
    parser.set_defaults(**scenario.defaults)
    return parser.parse_args(arguments), scenario


def _nodes(options: argparse.Namespace, scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that simulate and localize."""
    common = {'use_sim_time': True, 'seed': options.seed}
    fleet = {'vehicles': options.vehicles, 'seed': options.seed}
    world = {'mobility': 'trace', 'trace': options.trace} if options.trace else {}
    return {
        'anchor': {**scenario.anchor, **common},
        'fleet': {**scenario.fleet, **common, **fleet, 'method': options.method},
        'simulator': {
            **scenario.simulator, **fleet, **world, 'duration': options.duration,
            'rate': options.rate,
            'wait_for': 2,  # the fleet and the recorder
        },
    }


def _simulate(
    processes: Processes, options: argparse.Namespace, nodes: Mapping[str, Mapping[str, Any]],
    bag: Path,
) -> float:
    """Record a fleet that is localized over DDS, and return how long it took [simulated s]."""
    os.environ.update(
        ROS_DOMAIN_ID=str(_free_domain()),
        ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST',
        ROS_LOG_DIR=str(processes.folder),
    )
    processes.start_node(
        'recorder', {'use_sim_time': True, 'output': bag, 'storage': options.storage})
    for name in ('anchor', 'fleet'):
        processes.start_node(name, nodes[name])
    try:
        with (
            session(), closing(Watch(options.vehicles)) as watch,
            progress_bar(
                options.quiet, total=options.duration, leave=True, desc='starting',
                bar_format='{desc} {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} s simulated',
            ) as bar,
        ):
            # Last, once all that anchors and fleet say gets recorded.
            _await(processes, watch, watch.is_recorded)
            processes.start_node('simulator', nodes['simulator'])
            _await(processes, watch, lambda: not math.isnan(watch.time))
            _show(bar, watch, processes, options.vehicles)
            duration = watch.time
    except Stopped:
        raise KeyboardInterrupt from None
    for name in ('recorder', 'fleet', 'anchor'):
        processes.stop(name)
    return duration


def _await(processes: Processes, watch: Watch, condition: Callable[[], bool]) -> None:
    """Wait for something that healthy nodes do soon."""
    end = time.monotonic() + _START_PATIENCE
    while not watch.spin(condition, 0.2):
        processes.check()
        if time.monotonic() > end:
            raise TsmclError(
                f'the nodes have not found each other within {_START_PATIENCE:g} s, what they say '
                f'is in {processes.folder}')


def _show(bar: Any, watch: Watch, processes: Processes, vehicles: int) -> None:
    """Show the progress until the simulation is over and the last estimate has come."""
    while processes.is_running('simulator'):
        watch.spin(timeout=0.2)
        processes.check()
        bar.set_description(f'{watch.localized}/{vehicles} vehicles localized', False)
        bar.update(watch.time - bar.n)
    watch.drain(quiet=0.2, timeout=2.0)  # the last time it showed may not have been handled yet
    watch.spin(lambda: watch.estimated >= watch.time, _LAST_PATIENCE)


def _compare(
    processes: Processes, options: argparse.Namespace, scenario: Scenario, bag: Path,
) -> dict[str, Path]:
    """Run the recording through the localizer in process, otherwise set up, side by side."""
    others = {
        label: settings for label, settings in scenario.others.items() if label != options.method
    }
    if not options.quiet:
        print(f'the same recording, for comparison: {"; ".join(others)}', file=sys.stderr)
    runs = {}
    for label, settings in others.items():
        name = re.sub(r'\W+', '_', label)
        runs[label] = bag.with_name(name)
        given = {**scenario.localizer, 'method': options.method, 'seed': options.seed, **settings}
        processes.start(name, 'scripts.localize_bag', [
            str(bag), '--out', str(runs[label]), '--storage', options.storage, '--quiet',
            *(f'--{name.replace("_", "-")}={_as_text(value)}' for name, value in given.items()),
        ])
    with progress_bar(options.quiet, total=len(runs), unit='run', desc='comparing') as bar:
        while running := sum(processes.is_running(path.name) for path in runs.values()):
            bar.update(len(runs) - running - bar.n)
            bar.refresh()  # its clock goes on
            processes.check()
            time.sleep(0.1)
    processes.check()
    return runs


def _report(
    options: argparse.Namespace, nodes: Mapping[str, Mapping[str, Any]],
    runs: Mapping[str, Path], duration: float, out: Path, arguments: Sequence[str] | None,
) -> None:
    """Print the table and write the report."""
    skip = duration / 2 if options.skip is None else options.skip
    show = progress(options.quiet)
    found = read_all(list(runs.values()), list(runs), skip, show=show)
    print(format_table(found))
    written = write_evaluation(out, found, command_line('demo', arguments), {
        'vehicles': options.vehicles,
        'simulated time': f'{duration:g} s, the first {skip:g} s of it left out',
        'seed': options.seed,
        'recordings': ', '.join(map(str, runs.values())),
    } | {
        f'parameters of {name}': ', '.join(f'{key}: {value}' for key, value in given.items())
        for name, given in nodes.items()
    }, show=show)
    print(f'{", ".join(written)} are in {out}; the first {skip:g} s are left out')


class Processes:
    """
    Processes that end when this one does, however it does; a context manager.

    Parameters
    ----------
    folder
        Where to write what they write.

    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        folder.mkdir(parents=True)

    def start_node(self, name: str, parameters: Mapping[str, Any]) -> None:
        """Start one of the package's nodes."""
        given = [word for key, value in parameters.items()
                 for word in ('-p', f'{key}:={_as_yaml(value)}')]
        self.start(name, f'nodes.{name}', ['--ros-args', *given])

    def start(self, name: str, module: str, arguments: Sequence[str]) -> None:
        """Start one of the package's modules."""
        parent = os.getpid()
        with self._log(name).open('wb') as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, '-m', f'tsmcl_ros.{module}', *arguments],
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                # A Ctrl-C is this process's to pass on, in the right order.
                start_new_session=True,
                preexec_fn=lambda: _die_with(parent),
            )

    def is_running(self, name: str) -> bool:
        """Tell whether a process has not ended."""
        return self._running[name].poll() is None

    def check(self) -> None:
        """Raise TsmclError, saying what it said, if a process has failed."""
        for name, process in self._running.items():
            if process.poll():
                lines = self._log(name).read_text(errors='replace').split('\n')
                said = next(filter(None, reversed(lines)), f'exit code {process.returncode}')
                raise TsmclError(
                    f'{said.removeprefix("error: ")} (from {self._log(name)})')

    def stop(self, name: str) -> None:
        """End a process: ask, and if it does not heed, insist."""
        process = self._running[name]
        for how in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if process.poll() is None:
                os.killpg(process.pid, how)
            try:
                process.wait(_STOP_PATIENCE)
                return
            except subprocess.TimeoutExpired:
                continue

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        handlers = {number: signal.signal(number, signal.SIG_IGN)
                    for number in (signal.SIGINT, signal.SIGTERM)}
        # The recorder was started first, to record all, and so ends last.
        for name in reversed(self._running):
            self.stop(name)
        for number, handler in handlers.items():
            signal.signal(number, handler)

    def _log(self, name: str) -> Path:
        return self.folder / f'{name}.txt'


def _die_with(parent: int) -> None:
    """Have Linux end this process when its parent dies in whatever way."""
    if sys.platform == 'linux':
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)  # PR_SET_PDEATHSIG
        if os.getppid() != parent:
            os.kill(os.getpid(), signal.SIGTERM)


def _free_domain() -> int:
    """
    Return a ROS domain that no other demo on this host uses.

    The claim is a name among Linux's abstract sockets, which the kernel gives once and takes back
    however the process ends. People choose small domains; those above 101 are not safe.
    """
    for domain in range(101, 0, -1):
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            claim.bind(f'\0tsmcl_ros_domain_{domain}')
        except OSError:
            claim.close()
            continue
        _claims.append(claim)
        return domain
    raise TsmclError('all 101 ROS domains are in use by other demos')


_claims: list[socket.socket] = []


def _unused(path: Path) -> Path:
    """Return a path, numbered if it is there already."""
    number, found = 1, path
    while found.exists():
        number += 1
        found = path.with_name(f'{path.name}_{number}')
    return found


def _as_yaml(value: object) -> str:
    # As JSON, where a text such as 'off' stays one.
    return str(value) if isinstance(value, Path) else json.dumps(value)


def _as_text(value: object) -> str:
    return ','.join(value) if isinstance(value, list) else str(value)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='demo',
        description='Vehicles find themselves among anchors over DDS: simulate, localize, record, '
                    'evaluate, and compare with other methods on the same recording.',
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument('--config', type=Path, metavar='FILE',
                        help='scenario: parameters of anchor, simulator and fleet; other options '
                             'win over it (default: range-free among sixteen anchors)')
    parser.add_argument('--vehicles', type=a_whole_number(1, 1000), default=40, metavar='N',
                        help='how many')
    parser.add_argument('--duration', type=a_number(above=0, unit='s'), default=200.0, metavar='S',
                        help='simulated time')
    parser.add_argument('--rate', type=a_number(above=0), default=8.0, metavar='X',
                        help='simulated time against real time')
    parser.add_argument('--seed', type=int, default=1, help='of the world and of the localizers')
    parser.add_argument('--method', choices=tuple(METHODS), default='ts_mcl',
                        help='what the localizers run')
    parser.add_argument('--trace', '--fcd', type=Path, metavar='FILE',
                        help='trace that the vehicles follow: of SUMO (fcd-export), ns-2 or '
                             'BonnMotion')
    parser.add_argument('--out', type=Path, metavar='DIR',
                        help='folder to make for recording and report; out/demo if not given, or '
                             'out/demo_2 and so on')
    parser.add_argument('--storage', choices=STORAGES, default=STORAGES[0],
                        help='format of the recording')
    parser.add_argument('--skip', type=float, metavar='S',
                        help='leave out the first seconds, in which the vehicles are still lost; '
                             'half of the duration if not given')
    add_quiet(parser)
    return parser


if __name__ == '__main__':
    sys.exit(main())
