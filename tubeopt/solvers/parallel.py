"""Many independent computations on the cores of this machine, or on a cluster, behind one `Executor`.

Most callers need `each`: it sends a function of one item to every worker once, and yields a value or a `Failure` for
every item, as they are ready. `executor` is the plain `concurrent.futures.Executor` below it.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait as wait_for_end
from typing import Any, Generic, NamedTuple, TypeVar

from ..errors import InputError, SolveError
from ..typing import Progress
from .common_data import COMMON, NotLoadedError, common_data, packed, unpacked, using
from .time_limit import OutOfTimeError, timed

__all__ = ["Failure", "Outcome", "common_data", "each", "executor"]

A = TypeVar("A")
B = TypeVar("B")

AHEAD = 4
"""Items queued per worker: enough that none is idle, few enough that the items need no memory."""

MIN_QUEUED_AT_CLUSTER = 64
"""Minimum number of items queued at a cluster, since workers may join it at any time."""


@dataclass(frozen=True)
class Failure:
    """Reason why an item has no value."""

    kind: str
    """Name of the exception, or `WorkerLost`."""
    reason: str
    """Message of the exception."""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}"


@dataclass(frozen=True)
class Outcome(Generic[B]):
    """Result of one item: its value, or its failure."""

    index: int
    """Number of the item, from 0."""
    value: B | None
    """Value of the function; None for a failure."""
    failure: Failure | None
    """Failure, or None."""
    seconds: float = float("nan")
    """Time of the computation in the worker, s; NaN if the worker was lost."""


class SerialExecutor(Executor):
    """Executor that computes in this process, as items are submitted."""

    def __init__(self, common: object = None) -> None:
        self._common = common

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Finished future of the call."""
        future: Future[Any] = Future()
        try:
            with using(self._common):
                future.set_result(fn(*args, **kwargs))
        except Exception as error:  # as in a worker: an exception of the function is the result of its future
            future.set_exception(error)
        return future


def number_of_workers(workers: int) -> int:
    """Number of processes: `workers`, or one per core for 0; raises InputError for other values."""
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
        raise InputError(f"workers is {workers!r}; it must be 0 (one per core) or a number of processes")
    return workers or os.cpu_count() or 1


@contextmanager
def executor(workers: int = 0, *, scheduler: str | None = None, common: object = None) -> Iterator[Executor]:
    """Executor on processes of this machine, in this process for one worker, or on a Dask cluster.

    Args:
        workers: number of processes; 0 is one per core, 1 this process. Not used with a cluster.
        scheduler: address of a Dask scheduler, such as tcp://host:8786 (needs the extra `cluster`).
        common: any object that can be pickled; every worker receives it once, and reads it by `common_data()`.

    Raises:
        InputError: a wrong number of workers; no scheduler at that address, or one without workers; Dask is not
            installed.
    """
    if scheduler is not None:
        from .cluster import cluster_executor

        with cluster_executor(scheduler, packed(common)) as pool:
            yield pool
        return
    count = number_of_workers(workers)
    if count == 1:
        yield SerialExecutor(common)
        return
    with _processes(count, common) as pool:
        try:
            yield pool
        except BaseException:  # also KeyboardInterrupt: no process may go on
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def run_all(
    function: Callable[[A], B], items: Sequence[A], pool: Executor, progress: Progress | None = None
) -> list[B]:
    """Values of `function` for all items, in order."""
    values = map(function, items) if isinstance(pool, SerialExecutor) else pool.map(timed(function), items)
    out = []
    for value in values:
        out.append(value)
        if progress is not None:
            progress(len(out), len(items))
    return out


def _processes(count: int, common: object) -> ProcessPoolExecutor:
    """Pool of fresh processes with common data.

    They are not forked from this process, whose solvers may hold locks in other threads. Where the system allows it,
    they are forked from a server process that has imported the library and does nothing else.
    """
    if "forkserver" in multiprocessing.get_all_start_methods():
        context: Any = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["__main__", "tubeopt"])
    else:
        context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, _start_worker, (packed(common),))


def _start_worker(packed: bytes) -> None:
    """Initialise a worker process: it leaves interrupts to its parent, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.getLogger("tubeopt").setLevel(logging.ERROR)  # the parent has shown the warnings
    warnings.simplefilter("ignore")
    parent = multiprocessing.parent_process()
    if parent is not None:

        def end_with_parent() -> None:
            wait_for_end([parent.sentinel])
            os._exit(1)

        threading.Thread(target=end_with_parent, daemon=True).start()
    COMMON.set(unpacked(packed))


def each(
    function: Callable[[A], B],
    items: Iterable[A],
    *,
    workers: int = 0,
    scheduler: str | None = None,
) -> Iterator[Outcome[B]]:
    """Results of `function` for all items, in order of completion; a failure affects its own item only.

    The function is sent to every worker once, with its bound arguments: `functools.partial(function, robot)`, or an
    object with `__call__`. Items are taken from the iterable as workers become free, so that it may be infinite. An
    exception in a worker becomes a `Failure`. If a process dies, its unfinished items are computed again, each in a
    process of its own. An item that ends its process again has failed.

    Args:
        workers, scheduler: as for `executor`.

    Raises:
        InputError: as for `executor`; the function cannot be pickled, or workers cannot load it or cannot start.
        SolveError: the connection to the cluster is lost.
    """
    numbered = enumerate(items)
    while True:
        with executor(workers, scheduler=scheduler, common=timed(function)) as pool:
            if scheduler is not None:
                limit = max(MIN_QUEUED_AT_CLUSTER, AHEAD * int(getattr(pool, "workers", 0)))
            else:
                limit = 1 if isinstance(pool, SerialExecutor) else AHEAD * number_of_workers(workers)
            run: _Run[A, B] = _Run(pool, limit)
            yield from run.all(numbered)
        if not run.lost:
            return
        _require_start()
        for item in run.lost:
            yield _alone(function, item)


class _Run(Generic[A, B]):
    """Execution of items in an executor, at most `limit` at a time, with the items `lost` when processes die."""

    def __init__(self, pool: Executor, limit: int) -> None:
        self.pool, self.limit = pool, limit
        self.pending: dict[Future[Any], tuple[int, A]] = {}
        self.lost: list[tuple[int, A]] = []

    def all(self, numbered: Iterator[tuple[int, A]]) -> Iterator[Outcome[B]]:
        """Outcomes of items until none are left, or no processes."""
        self.fill(numbered)
        while self.pending:
            for future in wait(self.pending, return_when=FIRST_COMPLETED).done:
                outcome = self.outcome(future)
                if outcome is not None:
                    yield outcome
            if not self.lost:
                self.fill(numbered)

    def fill(self, numbered: Iterator[tuple[int, A]]) -> None:
        """Submit items up to the limit."""
        while len(self.pending) < self.limit:
            item = next(numbered, None)
            if item is None:
                return
            try:
                self.pending[self.pool.submit(_compute, item[1])] = item
            except BrokenProcessPool:
                self.lost.append(item)
                return

    def outcome(self, future: Future[Any]) -> Outcome[B] | None:
        """Outcome of an item; None if it was lost with the processes."""
        index, item = self.pending.pop(future)
        try:
            value, failure, seconds = future.result()
        except BrokenProcessPool:
            self.lost = sorted([*self.lost, (index, item)], key=lambda lost: lost[0])
            return None
        except (NotLoadedError, OutOfTimeError):
            raise
        except CancelledError:
            raise SolveError("the connection to the cluster is lost; finished points are kept") from None
        except Exception as error:  # of the executor: an item that cannot be pickled, a cluster worker lost three times
            kind = "WorkerLost" if type(error).__name__ == "KilledWorker" else type(error).__name__
            return Outcome(index, None, Failure(kind, str(error) or "no message"))
        return Outcome(index, value, failure, seconds)


def _alone(function: Callable[[A], B], numbered: tuple[int, A]) -> Outcome[B]:
    """Outcome of an item in a process of its own; the death of the process is a failure of the item."""
    with _processes(1, timed(function)) as pool:
        run: _Run[A, B] = _Run(pool, 1)
        for outcome in run.all(iter([numbered])):
            return outcome
    return Outcome(numbered[0], None, Failure("WorkerLost", "the process that computed it ended without an answer"))


def _require_start() -> None:
    """Raise InputError if processes end before they receive an item: then the items are not the cause."""
    with _processes(1, None) as pool:
        try:
            pool.submit(os.getpid).result()
        except BrokenProcessPool:
            raise InputError(
                "worker processes do not start; put the code of your script under `if "
                "__name__ == '__main__':`, or give workers=1"
            ) from None


class _Computed(NamedTuple):
    """Result of an item in a worker."""

    value: Any
    failure: Failure | None
    seconds: float


def _compute(item: Any) -> _Computed:
    """Compute an item in a worker."""
    function = common_data()
    start = time.perf_counter()
    try:
        value, failure = function(item), None
    except OutOfTimeError:
        raise
    except Exception as error:  # any failure of one item leaves the other items unaffected
        value, failure = None, Failure(type(error).__name__, str(error) or "no message")
    return _Computed(value, failure, time.perf_counter() - start)
