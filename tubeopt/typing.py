"""Names of array types, what every answer has, and attributes and methods that are elsewhere."""

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
"""Called with how much is done, and how much there is, 0 where nobody knows."""


@functools.lru_cache(maxsize=256)
def lazy_import(name: str) -> Any:
    """A public function by its full name, for a method of plain data that is a shorthand for it.

    Data do not know what is done with them: what saves or differentiates an equilibrium knows the equilibrium, not the
    other way. A method such as `equilibrium.save(directory)` is there all the same for who reads from left to right.
    """
    module, _, function = name.rpartition(".")
    return getattr(importlib.import_module(module), function)


class Delegate(Generic[T]):
    """A value of a part, read at the whole: with `lowest = Delegate[float]("outcome")`, `plan.outcome.lowest`."""

    def __init__(self, part: str) -> None:
        self.part, self._name = part, ""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, whole: Any, owner: type) -> T:
        if whole is None:
            return self  # type: ignore[return-value]
        return getattr(getattr(whole, self.part), self._name)  # type: ignore[no-any-return]


class StatusEnum(Enum):
    """How a solve ended: members whose values are sentences, and who read as such."""

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
