"""CasADi functions bound to NumPy arrays, which are not converted at each call."""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...physics.torsion import bent_functions, section_functions
from ...typing import Array


class Buffered:
    """Function of dense arguments bound to arrays: write `inputs`, call, read `outputs`.

    Every array is the transpose of the CasADi matrix, which is stored by columns, so a function mapped over N points
    has (N, rows) arrays. The next call overwrites them.
    """

    def __init__(self, function: ca.Function) -> None:
        buffer: Any
        buffer, self._trigger = function.buffer()
        # The buffer owns the memory of the function and points into the arrays: it must live as long as they do.
        self._buffer = buffer
        self.inputs = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self.outputs = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        for i, array in enumerate(self.inputs):
            buffer.set_arg(i, memoryview(array.data))
        for i, array in enumerate(self.outputs):
            buffer.set_res(i, memoryview(array.data))

    def __call__(self, *arguments: Any) -> list[Array]:
        """Outputs at `arguments`, one per input; None leaves an input unchanged."""
        for array, value in zip(self.inputs, arguments, strict=True):
            if value is not None:
                array[...] = value
        self._trigger()
        return self.outputs


class Empty:
    """Function mapped over no points, for an arm of length zero: CasADi has no map of size 0. Its outputs are empty."""

    def __init__(self, function: ca.Function) -> None:
        self.inputs = [np.zeros((0, function.size1_in(i))) for i in range(function.n_in())]
        self.outputs = [np.zeros((0, function.size1_out(i))) for i in range(function.n_out())]

    def __call__(self, *arguments: Any) -> list[Array]:
        """Empty outputs (0, rows)."""
        return self.outputs


def _bind(function: ca.Function, count: int, chained: bool = False) -> Buffered | Empty:
    """Function mapped over `count` points; if `chained`, its first output is the first input at the next point."""
    if not count:
        return Empty(function)
    return Buffered(function.mapaccum(count) if chained else function.map(count))


# Buffers are cached by thread: threads must not share arrays.


@lru_cache(maxsize=256)
def _section(kind: str, count: int, n_tubes: int, eccentric: bool, thread: int) -> Buffered | Empty:
    return _bind(section_functions(n_tubes, eccentric)[kind], count)


def section_function(kind: str, count: int, n_tubes: int, eccentric: bool) -> Buffered | Empty:
    """Function `kind` of `physics.torsion.section_functions`, `mapped` over `count` points."""
    return _section(kind, count, n_tubes, eccentric, threading.get_ident())


@lru_cache(maxsize=256)
def _bent(kind: str, count: int, n_tubes: int, thread: int) -> Buffered | Empty:
    return _bind(bent_functions(n_tubes)[kind], count)


def bent_function(kind: str, count: int, n_tubes: int) -> Buffered | Empty:
    """Function `kind` of `physics.torsion.bent_functions`, `mapped` over `count` points."""
    return _bent(kind, count, n_tubes, threading.get_ident())


@lru_cache(maxsize=320)
def _bound(function: ca.Function, count: int, chained: bool, thread: int) -> Buffered | Empty:
    return _bind(function, count, chained)


def mapped(function: ca.Function, count: int) -> Buffered | Empty:
    """Function mapped over `count` points, bound to arrays of this thread."""
    return _bound(function, count, False, threading.get_ident())


def chained(function: ca.Function, count: int) -> Buffered | Empty:
    """Function iterated `count` times on its first argument, bound to arrays of this thread."""
    return _bound(function, count, True, threading.get_ident())
