"""Experiments on a Dask cluster, whose workers are processes of their own."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import closing
import json
from pathlib import Path
import sys
import time
from typing import Any

import dask
from distributed import Client, LocalCluster
import pytest
from tsmcl_ros.evaluation.experiments import EXPERIMENTS
from tsmcl_ros.evaluation.monte_carlo import Result, run_experiment
from tsmcl_ros.evaluation.pools import Cluster, Processes
from tsmcl_ros.scripts.experiment import main
from tsmcl_ros.types import TsmclError

sys.path.append(str(Path(__file__).parent))
from draws import Dies, Draws, Mortal, once  # noqa: E402, I100


def local_cluster(**settings: Any) -> LocalCluster:
    """Return a cluster on the loopback interface, which is all that a test may use."""
    return LocalCluster(host='127.0.0.1', protocol='tcp://', dashboard_address=':0', **settings)


@pytest.fixture(scope='module')
def scheduler() -> Iterator[str]:
    """Return the address of a scheduler of two worker processes, which takes one death a call."""
    with dask.config.set({'distributed.scheduler.allowed-failures': 1}), \
            local_cluster(n_workers=2, threads_per_worker=1, processes=True) as cluster:
        yield cluster.scheduler_address


def values(results: list[Result]) -> list[Any]:
    return [(result.case, result.run, result.outcome.rows['value'].tolist())
            for result in results]


def test_a_cluster_has_the_results_of_one_process(scheduler: str) -> None:
    alone = run_experiment(Draws(), 7, 5)

    assert values(run_experiment(Draws(), 7, 5, Cluster(scheduler))) == values(alone)


def test_a_worker_that_is_killed_half_way_loses_no_result(scheduler: str, tmp_path: Path) -> None:
    grave = tmp_path / 'killed'

    results = run_experiment(Mortal(grave=str(grave)), 7, 10, Cluster(scheduler))

    assert grave.exists()
    assert values(results) == values(run_experiment(Draws(), 7, 10))


def test_what_kills_every_worker_is_one_clear_error(scheduler: str) -> None:
    with pytest.raises(TsmclError, match='were killed, .* try fewer a host'):
        run_experiment(Dies(), 0, 1, Cluster(scheduler))


def test_a_scheduler_that_goes_meanwhile_is_one_clear_error(
        monkeypatch: pytest.MonkeyPatch) -> None:
    def cancel(*_: object) -> None:
        raise CancelledError

    monkeypatch.setattr('tsmcl_ros.evaluation.pools._as_they_come', cancel)
    with local_cluster(n_workers=1, threads_per_worker=1, processes=False) as cluster:
        address = cluster.scheduler_address
        with pytest.raises(TsmclError, match=f'the scheduler at {address} has gone'):
            run_experiment(Draws(), 0, 1, Cluster(address))


def test_a_process_of_this_machine_that_is_killed_is_one_clear_error() -> None:
    error = 'a process was killed, perhaps for lack of memory: try fewer workers, now 2'
    with pytest.raises(TsmclError, match=error):
        run_experiment(Dies(), 0, 1, Processes(2))


def test_who_has_seen_enough_leaves_nothing_to_the_workers(scheduler: str) -> None:
    with closing(Cluster(scheduler)(once, {step: (step,) for step in range(2000)})) as results:
        next(results)

    end = time.monotonic() + 90
    with Client(scheduler, set_as_default=False) as client:
        while client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)):
            assert time.monotonic() < end


def test_the_script_writes_the_same_rows_by_a_cluster(
    scheduler: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(EXPERIMENTS, 'draws', (Draws(), Draws()))
    for name, where in (('here', ['--workers', '1']), ('there', ['--scheduler', scheduler])):
        assert main(['draws', '--out', str(tmp_path / name), *where]) == 0

    here, there = ((tmp_path / name / 'draws.csv').read_bytes() for name in ('here', 'there'))
    assert there == here
    document = json.loads((tmp_path / 'there' / 'draws.json').read_text())
    assert document['workers'] == scheduler


@pytest.mark.parametrize(('settings', 'reason'), [
    ({'n_workers': 0}, "has no workers: 'dask worker tcp://.* --nthreads 1' starts"),
    ({'n_workers': 1, 'threads_per_worker': 2, 'processes': False}, 'has 2 threads, must have 1'),
])
def test_a_cluster_that_cannot_do_it_is_told_what_to_mend(
    settings: dict[str, Any], reason: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr('tsmcl_ros.evaluation.pools.PATIENCE', 0.5)
    with local_cluster(**settings) as cluster, pytest.raises(TsmclError, match=reason):
        run_experiment(Draws(), 0, 1, Cluster(cluster.scheduler_address))


@pytest.mark.parametrize(('address', 'reason'), [
    ('nonsense', 'nonsense is not allowed, must be tcp://HOST:PORT'),
    ('tcp://here:x', 'tcp://here:x is not allowed'),
    ('udp://127.0.0.1:9', 'udp://127.0.0.1:9 is not allowed'),
    ('tcp://127.0.0.1:9', r"no scheduler answers at tcp://127.0.0.1:9 \(Connection refused\): "
     "'dask scheduler' starts one and prints its address"),
])
def test_an_address_without_a_scheduler_is_one_clear_error(address: str, reason: str) -> None:
    with pytest.raises(TsmclError, match=reason):
        run_experiment(Draws(), 0, 1, Cluster(address))


def test_without_dask_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'distributed', None)

    with pytest.raises(TsmclError, match=r'pip install tsmcl_ros\[dask\]'):
        run_experiment(Draws(), 0, 1, Cluster('tcp://127.0.0.1:9'))


def test_processes_of_this_machine_and_of_a_cluster_are_not_to_be_mixed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(['period_factor', '--workers', '2', '--scheduler', 'tcp://127.0.0.1:9'])

    assert stop.value.code == 2
    assert 'not allowed with' in capsys.readouterr().err
