"""Names of array types, what every answer has, and methods that are functions of modules above."""

from __future__ import annotations

import functools
import importlib
from enum import Enum
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@functools.cache
def late(name: str) -> Any:
    """A public function by its full name, for a method of plain data that is a shorthand for it.

    Data do not know what is done with them: what saves or differentiates an equilibrium knows the equilibrium, not the
    other way. A method such as `equilibrium.save(directory)` is there all the same for who reads from left to right.
    """
    module, _, function = name.rpartition(".")
    return getattr(importlib.import_module(module), function)


class Sentence(Enum):
    """How a solve ended: members whose values are sentences, and who read as such."""

    def __str__(self) -> str:
        return str(self.value)


@runtime_checkable
class Result(Protocol):
    """What a solver or a question answers with.

    Attributes:
        value: what was asked for, SI: a place, joint values, a robot, duties; of a program what gives its values by
            name.
        status: how it ended; as text it is a sentence.
        statistics: what it took: iterations, solves, seconds, as named numbers.
    """

    @property
    def value(self) -> Any:
        """What was asked for."""

    @property
    def status(self) -> Any:
        """How it ended."""

    @property
    def statistics(self) -> Any:
        """What it took."""
