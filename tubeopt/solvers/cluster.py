"""A Dask cluster as an `Executor`; imported only if a scheduler is requested."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from contextlib import contextmanager
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

from ..errors import InputError
from .common_data import unpacked, using

try:
    from distributed import Client as _Client
    from distributed import WorkerPlugin
    from distributed.comm.registry import backends
except ImportError as error:
    raise InputError("scheduler: Dask is not installed; python -m pip install 'tubeopt[cluster]'") from error

Client: Any = _Client  # without types of its own

TIMEOUT = 10.0
"""Time limit (s) for the answer of a scheduler with a worker."""


class _Common(WorkerPlugin):
    """Common data on every worker, including those that join or restart later."""

    def __init__(self, token: str, packed: bytes) -> None:
        self.name = token
        self.packed = packed

    def setup(self, worker: Any) -> None:
        """Store the common data; Dask calls this once on every worker."""
        _received[self.name] = unpacked(self.packed)

    def teardown(self, worker: Any) -> None:
        """Remove the common data; Dask calls this at the end of the run."""
        _received.pop(self.name, None)


_received: dict[str, Any] = {}


def _with_common(token: str, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """Result of `fn` in a worker, with the common data of its run."""
    with using(_received[token]):
        return fn(*args, **kwargs)


class ClusterExecutor(Executor):
    """Tasks of one run on a cluster.

    Results are fetched after tasks have ended. Dask's own executor reads the state of a task after it has fetched the
    result, and takes a result for an error if the worker that held it died in between.

    Attributes:
        workers: number of threads of the cluster at the start.
    """

    def __init__(self, client: Any, token: str) -> None:
        self._client, self._token = client, token
        self._tasks: WeakKeyDictionary[Future[Any], Any] = WeakKeyDictionary()
        self.workers = sum(client.nthreads().values())

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Future of the call; Dask computes it again if a worker dies."""
        future: Future[Any] = Future()
        task = self._client.submit(_with_common, self._token, fn, args, kwargs, pure=False)
        self._tasks[future] = task
        task.add_done_callback(partial(_complete, future))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Cancel unfinished tasks, or wait for them."""
        unfinished = {future: task for future, task in list(self._tasks.items()) if not future.done()}
        if cancel_futures or not wait:
            self._client.cancel(list(unfinished.values()))
        else:
            wait_for(unfinished)


def _complete(future: Future[Any], task: Any) -> None:
    """Set the result or error of a future from its task on the cluster."""
    try:
        answer = task.result()
    except CancelledError:
        future.cancel()
        future.set_running_or_notify_cancel()
    except BaseException as error:  # the caller gets any error of the task
        future.set_exception(error)
    else:
        future.set_result(answer)


@contextmanager
def cluster_executor(scheduler: str, packed: bytes) -> Iterator[ClusterExecutor]:
    """Executor on the cluster of a scheduler; raises InputError without a scheduler or workers."""
    # For a malformed address Dask's client writes an error to stderr only when it is garbage-collected.
    if str(scheduler).partition("://")[0] not in backends or "://" not in str(scheduler):
        raise InputError(
            f"scheduler is {scheduler!r}; no Dask scheduler answers there; it must be an "
            "address such as tcp://host:8786"
        )
    try:
        client = Client(scheduler, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"scheduler is {scheduler!r}; no Dask scheduler answers there ({reason})") from None
    token = f"tubeopt-{uuid.uuid4().hex}"
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
        except TimeoutError:
            raise InputError(f"scheduler is {scheduler!r}; the cluster has no workers") from None
        client.register_plugin(_Common(token, packed))
        try:
            with ClusterExecutor(client, token) as tasks:
                try:
                    yield tasks
                except BaseException:  # also after a signal: no task may keep running
                    tasks.shutdown(cancel_futures=True)
                    raise
        finally:
            if client.status == "running":
                client.unregister_worker_plugin(token)
