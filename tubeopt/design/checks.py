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


def table(name: str, values: Any) -> Rows:
    """`values` as a tuple of rows of equally many finite numbers, or InputError naming it."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {values!r}; it must be rows of equally many numbers") from None
    if array.ndim != 2 or not array.size or not np.isfinite(array).all():
        shown = np.array2string(array, separator=", ", threshold=12)
        raise InputError(f"{name} is {shown}; it must be rows of equally many finite numbers")
    return tuple(tuple(row) for row in array.tolist())
