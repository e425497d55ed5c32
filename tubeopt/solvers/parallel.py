"""Many independent computations on the cores of this machine, or on a cluster, behind one `Executor`.

`each` is what most callers want: a function of one item, sent to every worker once, and an answer or a `Failure` for
every item, as they come. `executor` is the bare `concurrent.futures.Executor` below it.
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
from typing import Any, Generic, TypeVar

from ..errors import InputError, SolveError
from ..typing import Progress
from .common_data import COMMON, NotLoadedError, common_data, packed, unpacked, using
from .time_limit import LateError, timed

__all__ = ["Failure", "Outcome", "common_data", "each", "executor"]

A = TypeVar("A")
B = TypeVar("B")

AHEAD = 4
"""Items that wait at each worker: enough that none is idle, few enough that the items need no memory."""

AT_A_CLUSTER = 64
"""Items in flight at a cluster, at least: workers may join it at any time."""


@dataclass(frozen=True)
class Failure:
    """Why an item has no answer."""

    kind: str
    """Name of the exception, or `WorkerLost`."""
    reason: str
    """Its message."""

    def __str__(self) -> str:
        return f"{self.kind}: {self.reason}"


@dataclass(frozen=True)
class Outcome(Generic[B]):
    """Result of one item: its value, or its failure."""

    index: int
    """Its place among the items."""
    value: B | None
    failure: Failure | None
    seconds: float = float("nan")
    """How long the worker computed."""


class SerialExecutor(Executor):
    """An executor that computes in this process, when asked."""

    def __init__(self, common: object = None) -> None:
        self._common = common

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """A future that is done already."""
        future: Future[Any] = Future()
        try:
            with using(self._common):
                future.set_result(fn(*args, **kwargs))
        except Exception as error:  # as a worker does: whatever the function raises belongs to its future
            future.set_exception(error)
        return future


def number_of_workers(workers: int) -> int:
    """`workers`, or one per core for 0; raises InputError for what is no such number."""
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 0:
        raise InputError(f"workers is {workers!r}; it must be 0 (one per core) or a number of processes")
    return workers or os.cpu_count() or 1


@contextmanager
def executor(workers: int = 0, *, scheduler: str | None = None, common: object = None) -> Iterator[Executor]:
    """An executor: processes of this machine, this process for one worker, or a Dask cluster.

    Args:
        workers: processes; 0 is one per core, 1 this process. A cluster has its own.
        scheduler: address of a Dask scheduler, as tcp://host:8786 (needs the extra `cluster`).
        common: any object that can be pickled; every worker receives it once and gets it by `common_data()`.

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
        except BaseException:  # also where a signal comes: no process goes on
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def run_all(
    function: Callable[[A], B], items: Sequence[A], pool: Executor, progress: Progress | None = None
) -> list[B]:
    """`function` of every item, in order."""
    answers = map(function, items) if isinstance(pool, SerialExecutor) else pool.map(timed(function), items)
    out = []
    for answer in answers:
        out.append(answer)
        if progress is not None:
            progress(len(out), len(items))
    return out


def _processes(count: int, common: object) -> ProcessPoolExecutor:
    """Fresh processes that hold common data.

    They are not forked from this one, whose solvers may hold locks in other threads, but where the system can from a
    server that does nothing but import the library, once.
    """
    if "forkserver" in multiprocessing.get_all_start_methods():
        context: Any = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["__main__", "tubeopt"])
    else:
        context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, _begin, (packed(common),))


def _begin(packed: bytes) -> None:
    """Start of a worker process: its parent handles interrupts, and it does not outlive its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.getLogger("tubeopt").setLevel(logging.ERROR)  # what is to be warned of, the parent has seen
    warnings.simplefilter("ignore")
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    COMMON.set(unpacked(packed))


def _end_with(sentinel: int) -> None:
    wait_for_end([sentinel])
    os._exit(1)


def each(
    function: Callable[[A], B],
    items: Iterable[A],
    *,
    workers: int = 0,
    scheduler: str | None = None,
) -> Iterator[Outcome[B]]:
    """Results of `function` for all items, in the order in which they are ready; a failure costs its own item only.

    The function is sent to every worker once, with all that is bound to it: `functools.partial(function, robot)`, or
    an object with `__call__`. Items are taken from the iterable as workers become free, so that it may be endless.
    Whatever a worker raises becomes a `Failure`. If a process dies, its unfinished items are computed again,
    each in a process of its own. An item that ends its process again has failed.

    Args:
        workers, scheduler: as for `executor`.

    Raises:
        InputError: as `executor`; the function does not pickle, or workers cannot load it or cannot start.
        SolveError: the connection to the cluster is lost.
    """
    numbered = enumerate(items)
    while True:
        with executor(workers, scheduler=scheduler, common=timed(function)) as pool:
            run: _Run[A, B] = _Run(pool, _in_flight(pool, workers, scheduler))
            yield from run.all(numbered)
        if not run.lost:
            return
        _require_start()
        for item in run.lost:
            yield _alone(function, item)


class _Run(Generic[A, B]):
    """Items on their way through an executor, at most `limit` at a time; `lost` holds them if its processes die."""

    def __init__(self, pool: Executor, limit: int) -> None:
        self.pool, self.limit = pool, limit
        self.pending: dict[Future[Any], tuple[int, A]] = {}
        self.lost: list[tuple[int, A]] = []

    def all(self, numbered: Iterator[tuple[int, A]]) -> Iterator[Outcome[B]]:
        """Outcomes until there are no items left, or no processes."""
        self.fill(numbered)
        while self.pending:
            done, _ = wait(self.pending, return_when=FIRST_COMPLETED)
            for future in done:
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
        """What became of an item; None where it was lost with the processes."""
        index, item = self.pending.pop(future)
        try:
            value, failure, seconds = future.result()
        except BrokenProcessPool:
            self.lost = sorted([*self.lost, (index, item)], key=lambda lost: lost[0])
            return None
        except (NotLoadedError, LateError):
            raise
        except CancelledError:
            raise SolveError("the connection to the cluster is lost; finished points are kept") from None
        except Exception as error:  # of the executor: an item that does not pickle, a worker of the cluster lost thrice
            kind = "WorkerLost" if type(error).__name__ == "KilledWorker" else type(error).__name__
            return Outcome(index, None, Failure(kind, str(error) or "no message"))
        return Outcome(index, value, failure, seconds)


def _alone(function: Callable[[A], B], numbered: tuple[int, A]) -> Outcome[B]:
    """The outcome of an item in a process of its own, whose death is the item's own failure."""
    with _processes(1, timed(function)) as pool:
        run: _Run[A, B] = _Run(pool, 1)
        for outcome in run.all(iter([numbered])):
            return outcome
    return Outcome(numbered[0], None, Failure("WorkerLost", "the process that computed it ended without an answer"))


def _require_start() -> None:
    """Raise InputError where processes end before they begin: then it is not the items that end them."""
    with _processes(1, None) as pool:
        try:
            pool.submit(os.getpid).result()
        except BrokenProcessPool:
            raise InputError(
                "worker processes do not start; put the code of your script under `if "
                "__name__ == '__main__':`, or give workers=1"
            ) from None


def _compute(item: Any) -> tuple[Any, Failure | None, float]:
    """Answer, failure and seconds of an item, in a worker."""
    function = common_data()
    began = time.perf_counter()
    try:
        value, failure = function(item), None
    except LateError:
        raise
    except Exception as error:  # the failure of one item, whatever it is, leaves the others
        value, failure = None, Failure(type(error).__name__, str(error) or "no message")
    return value, failure, time.perf_counter() - began


def _in_flight(pool: Executor, workers: int, scheduler: str | None) -> int:
    if scheduler is not None:
        return max(AT_A_CLUSTER, AHEAD * int(getattr(pool, "workers", 0)))
    return 1 if isinstance(pool, SerialExecutor) else AHEAD * number_of_workers(workers)
