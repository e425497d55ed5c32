"""Custom requirements and objectives, defined by the user and treated like the built-in ones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, Self

from ..errors import InputError, finite, positive
from .quantities import Quantities


class Custom(ABC):
    """Base of custom requirements and objectives; a subclass is a frozen dataclass of its data."""

    description: str = ""
    """Description of the quantity, for messages and tables."""
    unit: str = ""
    """Unit of the displayed value."""
    factor: float = 1.0
    """Factor from SI to that unit."""

    @abstractmethod
    def expression(self, q: Quantities) -> Any:
        """CasADi expression of the quantity, SI."""

    def checked(self) -> None:
        """Raise InputError for an empty description or a number out of range."""
        name = type(self).__name__
        if not self.description:
            raise InputError(f"description of {name} is {self.description!r}; it must not be empty")
        if finite(f"factor of {name}", self.factor) == 0:
            raise InputError(f"factor of {name} is 0; it must turn SI into the unit that is shown")


class CustomRequirement(Custom):
    """A requirement: every number of its `expression` must be at least 0.

    Example:
        >>> import casadi
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True)
        ... class Height(CustomRequirement):
        ...     limit: float
        ...     description, unit, factor, size = "height of the tips", "mm", 1e3, 1e-3
        ...
        ...     def expression(self, q):
        ...         return casadi.vertcat(*(pose.tip_position[2] for pose in q.poses)) - self.limit
        >>> Height(0.1).relaxed(0.02)
        Height(limit=0.08)
    """

    limit: float = 0.0
    """Bound on the quantity in SI, compared by the expression; a field of the dataclass if it may be relaxed."""
    is_upper_bound: bool = False
    """True if relaxing the requirement increases `limit`."""
    size: float = 1.0
    """Change of `limit` that counts as one step when several limits are relaxed, SI."""

    def relaxed(self, amount: float) -> Self | None:
        """The requirement relaxed by `amount` > 0, SI; None if `limit` is no field."""
        if "limit" not in getattr(self, "__dataclass_fields__", ()):
            return None
        dataclass_self: Any = self
        eased: Self = replace(dataclass_self, limit=self.limit + (amount if self.is_upper_bound else -amount))
        return eased

    def checked(self) -> None:
        """Raise InputError for an empty description or a number out of range."""
        super().checked()
        positive(f"size of {type(self).__name__}", self.size)
        finite(f"limit of {type(self).__name__}", self.limit)


class CustomObjective(Custom):
    """An objective: `expression` is one number, SI."""

    sign: int = 1
    """1 to minimise the expression, -1 to maximise it."""
    weight: float = 1.0
    """Factor of the expression in a sum of several objectives, SI."""

    def checked(self) -> None:
        """Raise InputError for an empty description or a number out of range."""
        super().checked()
        if self.sign not in (1, -1):
            raise InputError(
                f"sign of {type(self).__name__} is {self.sign!r}; it must be 1 (minimise) or -1 (maximise)"
            )
        positive(f"weight of {type(self).__name__}", self.weight)
