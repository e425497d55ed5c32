"""Many independent computations, on this process or on several, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from typing import TypeVar

from ..errors import InputError
from ..solvers.parallel import executors as parallel

A = TypeVar("A")
B = TypeVar("B")

Progress = Callable[[int, int], object]
"""Called with how much is done and how much there is."""


@contextmanager
def executor(workers: int) -> Iterator[Executor | None]:
    """Processes to compute on; None, this one, for one worker.

    Raises:
        InputError: fewer than one worker.
    """
    if workers < 1:
        raise InputError(f"workers is {workers}; it must be at least 1")
    if workers == 1:
        yield None
        return
    with parallel.executor(workers) as pool:
        yield pool


def run_all(
    function: Callable[[A], B], items: Sequence[A], pool: Executor | None, progress: Progress | None = None
) -> list[B]:
    """`function` of every item, in order."""
    answers = map(function, items) if pool is None else pool.map(function, items)
    out = []
    for answer in answers:
        out.append(answer)
        if progress is not None:
            progress(len(out), len(items))
    return out
