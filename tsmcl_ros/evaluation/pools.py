"""
Where calls are worked on side by side: by processes of this machine, or by a cluster of Dask.

A pool takes a function and the arguments of its calls by key, and yields each key with what the
function returned, as it comes. Calls that come first are begun first.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Hashable, Mapping
from concurrent.futures import as_completed, CancelledError, Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass
import multiprocessing
import os
import signal
import socket
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

from tsmcl_ros.types import TsmclError

K = TypeVar('K', bound=Hashable)
R = TypeVar('R')

PATIENCE = 30  # s, for a scheduler, and for its first worker, which may be starting again


class Pool(Protocol):
    """Works on calls of a function that every process can import."""

    def __call__(self, function: Callable[..., R], calls: Mapping[K, tuple[Any, ...]]
                 ) -> Generator[tuple[K, R], None, None]:
        """
        Yield what each call returns, as it comes; closing it lets go of all that is not done.

        Raises
        ------
        TsmclError
            If the pool cannot do it.

        """


@dataclass(frozen=True)
class Processes:
    """Processes of this machine; with one worker all is done in the process that asks."""

    workers: int

    def __call__(self, function: Callable[..., R], calls: Mapping[K, tuple[Any, ...]]
                 ) -> Generator[tuple[K, R], None, None]:
        """See `Pool`; an error is that a process was killed."""
        workers = min(self.workers, len(calls))
        if workers == 1:
            for key, arguments in calls.items():
                yield key, function(*arguments)
            return
        others = set(multiprocessing.active_children())
        # A spawned process shares nothing with this one that could make a difference.
        executor = ProcessPoolExecutor(
            workers, multiprocessing.get_context('spawn'),
            initializer=signal.signal, initargs=(signal.SIGINT, signal.SIG_IGN))
        try:
            yield from _as_they_come(executor, function, calls)
        except BrokenProcessPool:
            raise TsmclError('a process was killed, perhaps for lack of memory: try fewer '
                             f'workers, now {workers}') from None
        except BaseException:
            # A call may take minutes; nobody waits for it any more.
            executor.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            raise
        executor.shutdown()


@dataclass(frozen=True)
class Cluster:
    """
    Workers of a Dask cluster, on which this package is installed as it is here.

    What a worker had that dies is done again by the others.

    Parameters
    ----------
    scheduler : str
        Its address, such as tcp://192.168.1.7:8786.

    """

    scheduler: str

    def __call__(self, function: Callable[..., R], calls: Mapping[K, tuple[Any, ...]]
                 ) -> Generator[tuple[K, R], None, None]:
        """See `Pool`; an error is that no scheduler or worker is there, or none stays alive."""
        with closing(self._connect()) as client:
            from distributed import KilledWorker
            self._refuse_threads(client)
            # Not pure: a call is made as often as it is asked for.
            executor = client.get_executor(pure=False)
            try:
                yield from _as_they_come(executor, function, calls)
            except KilledWorker as error:
                raise TsmclError(
                    f'workers of {self.scheduler} were killed, the last at '
                    f'{error.last_worker.address}, perhaps for lack of memory: try fewer a host'
                ) from None
            except CancelledError:
                raise TsmclError(f'the scheduler at {self.scheduler} has gone') from None
            finally:
                executor.shutdown(wait=False)

    def _connect(self) -> Any:
        """Return a client of the scheduler, which has a worker."""
        try:
            from distributed import Client
        except ModuleNotFoundError as error:
            raise TsmclError(f'a cluster needs Dask, and {error.name} is not installed: '
                             'pip install tsmcl_ros[dask]') from None
        self._knock()
        client = Client(self.scheduler, timeout=PATIENCE, set_as_default=False)
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            client.close()
            raise TsmclError(f'the scheduler at {self.scheduler} has no workers: '
                             f"'{self._worker_command()}' starts those of a host") from None
        return client

    def _knock(self) -> None:
        """Refuse an address where nobody listens; a client would go on trying for long."""
        try:
            parts = urlsplit(self.scheduler)
            port = parts.port
        except ValueError:
            port = None
        if not port or not parts.hostname or parts.scheme not in ('tcp', 'tls'):
            raise TsmclError(f'scheduler {self.scheduler} is not allowed, must be tcp://HOST:PORT '
                             'or tls://HOST:PORT')
        try:
            socket.create_connection((parts.hostname, port), PATIENCE).close()
        except OSError as error:
            raise TsmclError(
                f'no scheduler answers at {self.scheduler} ({error.strerror or error}): '
                "'dask scheduler' starts one and prints its address") from None

    def _refuse_threads(self, client: Any) -> None:
        """Refuse workers of several threads: what is timed is the time of a process."""
        for address, threads in client.nthreads().items():
            if threads != 1:
                raise TsmclError(f'worker {address} has {threads} threads, must have 1: '
                                 f"start it as '{self._worker_command()}'")

    def _worker_command(self) -> str:
        return f'dask worker {self.scheduler} --nworkers {processors()} --nthreads 1'


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _as_they_come(executor: Executor, function: Callable[..., R],
                  calls: Mapping[K, tuple[Any, ...]]) -> Generator[tuple[K, R], None, None]:
    started = {executor.submit(function, *arguments): key for key, arguments in calls.items()}
    for future in as_completed(started):
        yield started[future], future.result()
