"""CasADi functions on NumPy arrays without the cost of converting them at each call."""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...physics.torsion import bent_functions, section_functions
from ...typing import Array


class Buffered:
    """A function of dense arguments bound to arrays of its own: write `inputs`, call, read `outputs`.

    Every array is the transpose of the CasADi matrix (whose storage is by columns), so a function mapped over N points
    has (N, rows) arrays. The arrays are overwritten by the next call.
    """

    def __init__(self, function: ca.Function) -> None:
        buffer: Any
        buffer, self._trigger = function.buffer()
        # The buffer holds the function's memory and pointers into the arrays: it must live as long as they do.
        self._buffer = buffer
        self.inputs = [np.zeros(function.size_in(i)[::-1]) for i in range(function.n_in())]
        self.outputs = [np.zeros(function.size_out(i)[::-1]) for i in range(function.n_out())]
        for i, array in enumerate(self.inputs):
            buffer.set_arg(i, memoryview(array.data))
        for i, array in enumerate(self.outputs):
            buffer.set_res(i, memoryview(array.data))

    def __call__(self, *arguments: Any) -> list[Array]:
        """Outputs at `arguments`, one per input; None leaves an input as it is."""
        for array, value in zip(self.inputs, arguments, strict=True):
            if value is not None:
                array[...] = value
        self._trigger()
        return self.outputs


class Empty:
    """A function mapped over no points, as on an arm of length zero, which CasADi has no map for: empty outputs."""

    def __init__(self, function: ca.Function) -> None:
        self.inputs = [np.zeros((0, function.size1_in(i))) for i in range(function.n_in())]
        self.outputs = [np.zeros((0, function.size1_out(i))) for i in range(function.n_out())]

    def __call__(self, *arguments: Any) -> list[Array]:
        """Outputs (0, rows), whatever the arguments."""
        return self.outputs


def _bind(function: ca.Function, count: int, chained: bool = False) -> Buffered | Empty:
    """A function over `count` points, each on its own or, if `chained`, from the first output of the one before."""
    if not count:
        return Empty(function)
    return Buffered(function.mapaccum(count) if chained else function.map(count))


@lru_cache(maxsize=256)
def _section(kind: str, count: int, n_tubes: int, eccentric: bool, thread: int) -> Buffered | Empty:
    return _bind(section_functions(n_tubes, eccentric)[kind], count)


def section_function(kind: str, count: int, n_tubes: int, eccentric: bool) -> Buffered | Empty:
    """`physics.torsion.section_functions` mapped over `count` points, bound to arrays of this thread."""
    return _section(kind, count, n_tubes, eccentric, threading.get_ident())


@lru_cache(maxsize=256)
def _bent(kind: str, count: int, n_tubes: int, thread: int) -> Buffered | Empty:
    return _bind(bent_functions(n_tubes)[kind], count)


def bent_function(kind: str, count: int, n_tubes: int) -> Buffered | Empty:
    """`physics.torsion.bent_functions` mapped over `count` points, bound to arrays of this thread."""
    return _bent(kind, count, n_tubes, threading.get_ident())


@lru_cache(maxsize=320)
def _bound(function: ca.Function, count: int, chained: bool, thread: int) -> Buffered | Empty:
    return _bind(function, count, chained)


def mapped(function: ca.Function, count: int) -> Buffered | Empty:
    """A function mapped over `count` points, bound to arrays of this thread."""
    return _bound(function, count, False, threading.get_ident())


def chained(function: ca.Function, count: int) -> Buffered | Empty:
    """A function whose first output is its next first input, `count` times in a row, bound to arrays of this thread."""
    return _bound(function, count, True, threading.get_ident())
