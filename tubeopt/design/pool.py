"""Many independent computations, on this process or on several, in order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import TypeVar

from ..solvers.parallel.executors import SerialExecutor

A = TypeVar("A")
B = TypeVar("B")

Progress = Callable[[int, int], object]
"""Called with how much is done and how much there is."""


def run_all(
    function: Callable[[A], B], items: Sequence[A], pool: Executor, progress: Progress | None = None
) -> list[B]:
    """`function` of every item, in order."""
    answers = map(function, items) if isinstance(pool, SerialExecutor) else pool.map(function, items)
    out = []
    for answer in answers:
        out.append(answer)
        if progress is not None:
            progress(len(out), len(items))
    return out
