"""A Dask cluster as an `Executor`; imported only where a scheduler is asked for."""

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
"""Seconds in which a scheduler must answer, and have a worker."""


class _Common(WorkerPlugin):
    """Common data on every worker, those that join or restart later included."""

    def __init__(self, token: str, packed: bytes) -> None:
        self.name = token
        self.packed = packed

    def setup(self, worker: Any) -> None:
        """Called by Dask on every worker once."""
        _received[self.name] = unpacked(self.packed)

    def teardown(self, worker: Any) -> None:
        """Called by Dask when the run is over."""
        _received.pop(self.name, None)


_received: dict[str, Any] = {}


def _with_common(token: str, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """Call `fn` in a worker with the common data of its run in place."""
    with using(_received[token]):
        return fn(*args, **kwargs)


class ClusterExecutor(Executor):
    """Tasks of one run on a cluster.   workers: threads that the cluster has at the start.

    Answers are fetched once tasks have ended. Dask's own executor looks at the state of a task after it has fetched the
    answer, and takes an answer for an error where the worker that held it died in between.
    """

    def __init__(self, client: Any, token: str) -> None:
        self._client, self._token = client, token
        self._tasks: WeakKeyDictionary[Future[Any], Any] = WeakKeyDictionary()
        self.workers = sum(client.nthreads().values())

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """A future of the call; Dask computes it again where a worker dies."""
        future: Future[Any] = Future()
        task = self._client.submit(_with_common, self._token, fn, args, kwargs, pure=False)
        self._tasks[future] = task
        task.add_done_callback(partial(_tell, future))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Give up what is not done yet, or wait for it."""
        left = {future: task for future, task in list(self._tasks.items()) if not future.done()}
        if cancel_futures or not wait:
            self._client.cancel(list(left.values()))
        else:
            wait_for(left)


def _tell(future: Future[Any], task: Any) -> None:
    """Tell a future how its task on the cluster has ended."""
    try:
        answer = task.result()
    except CancelledError:
        future.cancel()
        future.set_running_or_notify_cancel()
    except BaseException as error:  # whatever ended the task there, who waits for it gets it
        future.set_exception(error)
    else:
        future.set_result(answer)


@contextmanager
def cluster_executor(scheduler: str, packed: bytes) -> Iterator[ClusterExecutor]:
    """An executor on the cluster of a scheduler; raises InputError where there is none, or none with workers."""
    # Of what is no address, Dask's client says so only when it is collected, on stderr.
    if str(scheduler).partition("://")[0] not in backends or "://" not in str(scheduler):
        raise InputError(
            f"scheduler is {scheduler!r}; no Dask scheduler answers there; it must be an "
            "address such as tcp://host:8786"
        )
    try:
        client = Client(scheduler, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"scheduler is {scheduler!r}; no Dask scheduler answers there ({said})") from None
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
                except BaseException:  # also where a signal comes: no task goes on there
                    tasks.shutdown(cancel_futures=True)
                    raise
        finally:
            if client.status == "running":
                client.unregister_worker_plugin(token)
