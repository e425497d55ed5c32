"""Constraints that a point violates, in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..typing import Array


@dataclass(frozen=True)
class Violation:
    """A constraint that does not hold."""

    name: str
    amount: float
    """Amount of the violation, in its own units."""
    relative: float
    """Amount of the violation relative to its scale."""

    def __str__(self) -> str:
        return f"{self.name}: violated by {self.amount:.1e}"


def violations_of(
    names: Sequence[str], values: Array, bounds: tuple[Array, Array], scale: Array, tolerance: float
) -> list[Violation]:
    """Those of the constraints lower <= values <= upper that are violated by more than `tolerance` of their scale."""
    lower, upper = bounds
    amount = np.maximum(lower - values, values - upper)
    amount = np.where(np.isfinite(values), amount, np.inf)
    wrong = np.flatnonzero(amount > tolerance * scale)
    return [Violation(names[k], float(amount[k]), float(amount[k] / scale[k])) for k in wrong.tolist()]


def worst(violations: Iterable[Violation], count: int) -> tuple[Violation, ...]:
    """The largest, over their scales, first."""
    return tuple(sorted(violations, key=lambda each: -each.relative)[:count])
