"""What a limit of a design is: its words, its value, and the step in which it is relaxed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limit:
    """What a group of rows is about.

    words: what is limited.  value: the limit, SI.  most: whether the limit is an upper one.  unit, factor: how it is
    shown.  size: SI change that counts as one step when limits are relaxed against each other.  movable: whether it
    may be relaxed.
    """

    words: str
    value: float
    most: bool
    unit: str
    factor: float
    size: float
    movable: bool = True

    def shown(self, value: float | None = None) -> str:
        """The limit, or another value of the same kind, with its unit."""
        number = f"{(self.value if value is None else value) * self.factor:.4g}"
        return f"{number} {self.unit}".strip()
