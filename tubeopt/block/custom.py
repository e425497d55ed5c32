"""Custom requirements and objectives: written outside of the library, treated like the built-in ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, Self

from ..errors import InputError, finite, positive
from .quantities import Quantities


class Custom(ABC):
    """What a custom requirement and a custom objective share; a subclass is a frozen dataclass of its data.

    words: what is limited or wanted.  unit, factor: how it is shown: the unit, and what turns SI into it.
    """

    words: str = ""
    unit: str = ""
    factor: float = 1.0

    @abstractmethod
    def expression(self, q: Quantities) -> Any:
        """The CasADi expression, SI."""

    def checked(self) -> None:
        """Raise InputError where its words or numbers make no sense."""
        what = type(self).__name__
        if not self.words:
            raise InputError(f"words of {what} is {self.words!r}; it must be a description")
        if finite(f"factor of {what}", self.factor) == 0:
            raise InputError(f"factor of {what} is 0; it must turn SI into the unit that is shown")


class CustomRequirement(Custom):
    """A requirement: every number of its `expression` is at least 0 where it is kept.

    limit: the number that the expression is compared with, in its own unit, SI: a field where it may be relaxed.
    most: whether `limit` is an upper one, so that relaxing raises it.
    size: change of `limit` that counts as one step when limits are relaxed against each other, SI.

    Example:
        >>> import casadi
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True)
        ... class Height(CustomRequirement):
        ...     limit: float
        ...     words, unit, factor, size = "height of the tips", "mm", 1e3, 1e-3
        ...
        ...     def expression(self, q):
        ...         return casadi.vertcat(*(pose.tip_position[2] for pose in q.poses)) - self.limit
        >>> Height(0.1).relaxed(0.02)
        Height(limit=0.08)
    """

    limit: float = 0.0
    most: bool = False
    size: float = 1.0

    def relaxed(self, amount: float) -> Self | None:
        """The requirement eased by `amount` > 0, SI; None where it cannot be eased: where `limit` is no field."""
        if "limit" not in getattr(self, "__dataclass_fields__", ()):
            return None
        inputs: Any = self
        eased: Self = replace(inputs, limit=self.limit + (amount if self.most else -amount))
        return eased

    def checked(self) -> None:
        """Raise InputError where its words or numbers make no sense."""
        super().checked()
        positive(f"size of {type(self).__name__}", self.size)
        finite(f"limit of {type(self).__name__}", self.limit)


class CustomObjective(Custom):
    """An objective: `expression` is one number, SI.

    sign: 1 where less of it is better, -1 where more is.  weight: where there are several objectives, what it is
    multiplied by before they are added, SI.
    """

    sign: int = 1
    weight: float = 1.0

    def checked(self) -> None:
        """Raise InputError where its words or numbers make no sense."""
        super().checked()
        if self.sign not in (1, -1):
            raise InputError(
                f"sign of {type(self).__name__} is {self.sign!r}; it must be 1 (minimise) or -1 (maximise)"
            )
        positive(f"weight of {type(self).__name__}", self.weight)
