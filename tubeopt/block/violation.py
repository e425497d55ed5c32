"""Violated constraints by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..typing import Array


@dataclass(frozen=True)
class Violation:
    """A violated constraint."""

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
    """Constraints lower <= values <= upper that are violated by more than `tolerance` times their scale."""
    lower, upper = bounds
    amount = np.maximum(lower - values, values - upper)
    amount = np.where(np.isfinite(values), amount, np.inf)
    violated = np.flatnonzero(amount > tolerance * scale)
    return [Violation(names[k], float(amount[k]), float(amount[k] / scale[k])) for k in violated.tolist()]


def worst(violations: Iterable[Violation], count: int) -> tuple[Violation, ...]:
    """The `count` largest violations relative to their scales, largest first."""
    return tuple(sorted(violations, key=lambda each: -each.relative)[:count])
