"""Data common to all computations of a run, sent to every worker once and read by its tasks."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from ..errors import InputError

COMMON: ContextVar[Any] = ContextVar("common data of the run of this thread")


class NotLoadedError(InputError):
    """Common data arrived at a worker that cannot load them, since it does not know their module."""


def unpacked(packed: bytes) -> Any:
    """Common data in a worker; if they cannot be loaded, the error that `common_data` will raise."""
    try:
        return pickle.loads(packed)
    except Exception as error:  # unpickling runs code of the user's modules, which may raise anything
        reason = str(error) or type(error).__name__
        return NotLoadedError(
            f"the function cannot be loaded by the workers ({reason}); it must be of a module they can import"
        )


def common_data() -> Any:
    """Argument `common` of the `executor` that runs this function in a worker.

    Raises:
        NotLoadedError: the worker cannot load them.
    """
    common = COMMON.get()
    if isinstance(common, NotLoadedError):
        raise common
    return common


@contextmanager
def using(common: object) -> Iterator[None]:
    """Context in which `common_data` returns `common` in this thread."""
    token = COMMON.set(common)
    try:
        yield
    finally:
        COMMON.reset(token)


def packed(common: object) -> bytes:
    """Common data as bytes for workers; raises InputError if they cannot be pickled."""
    try:
        return pickle.dumps(common)
    except Exception as error:  # pickling runs `__reduce__` of the user's classes, which may raise anything
        what = getattr(common, "__qualname__", type(common).__name__)
        raise InputError(f"{what} cannot be sent to other processes: {error}") from None
