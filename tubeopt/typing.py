"""Array types, the protocol of answers, lazy imports and delegated attributes."""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from enum import Enum
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]

Progress = Callable[[int, int], object]
"""Callback with the finished and the total number of steps; 0 if the total is unknown."""


@functools.lru_cache(maxsize=256)
def lazy_import(name: str) -> Any:
    """Import a public function by its full name, for a method that is a shorthand for it.

    Data classes must not import the modules that use them. With this, `equilibrium.save(directory)` works nevertheless.
    """
    module, _, function = name.rpartition(".")
    return getattr(importlib.import_module(module), function)


class Delegate(Generic[T]):
    """Attribute of a part: with `lowest = Delegate[float]("outcome")`, `plan.lowest` is `plan.outcome.lowest`."""

    def __init__(self, part: str) -> None:
        self.part, self._name = part, ""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        return getattr(getattr(instance, self.part), self._name)  # type: ignore[no-any-return]


class StatusEnum(Enum):
    """Status of a solve; the text of a member is its value, a sentence."""

    def __str__(self) -> str:
        return str(self.value)


@runtime_checkable
class Result(Protocol):
    """Result of a solver or of a question."""

    @property
    def value(self) -> Any:
        """Main result in SI: a position, joint values, a robot, duties; values of a program by name."""

    @property
    def status(self) -> Any:
        """Result as a status; its text is a sentence."""

    @property
    def statistics(self) -> Any:
        """Effort as named numbers: iterations, solves, seconds."""
