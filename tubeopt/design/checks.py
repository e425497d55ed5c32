"""Checks of what a task is made of: parts of the right kind, whole numbers, rows of numbers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..errors import InputError

Rows = tuple[tuple[float, ...], ...]


def items(name: str, values: Any, kinds: Any, what: str) -> tuple[Any, ...]:
    """`values` as a tuple whose every member is of `kinds`, or InputError naming it; `what` says what they must be."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise InputError(f"{name} is {values!r}; it must be a list of {what}")
    found = tuple(values)
    for one in found:
        if not isinstance(one, kinds):
            raise InputError(f"{name} holds {one!r}; it must be a list of {what}")
    return found


def table(name: str, values: Any, columns: int) -> Rows:
    """`values` as a tuple of rows of finite numbers, or InputError naming it; `columns` 0 allows any number."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {values!r}; it must be rows of {columns or 'equally many'} numbers") from None
    if array.ndim != 2 or not array.size or (columns and array.shape[1] != columns) or not np.isfinite(array).all():
        shown = np.array2string(array, separator=", ", threshold=12)
        raise InputError(f"{name} is {shown}; it must be rows of {columns or 'equally many'} finite numbers")
    return tuple(tuple(row) for row in array.tolist())


def row(name: str, values: Any) -> tuple[float, ...]:
    """`values` as finite numbers, or InputError naming them."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros((0, 0))
    if array.ndim != 1 or not array.size or not np.isfinite(array).all():
        raise InputError(f"{name} is {values!r}; it must be finite numbers")
    return tuple(array.tolist())


def triple(name: str, values: Any) -> tuple[float, float, float]:
    """`values` as three finite numbers, or InputError naming it."""
    found = row(name, values)
    if len(found) != 3:
        raise InputError(f"{name} is {values!r}; it must be 3 numbers")
    return found[0], found[1], found[2]
