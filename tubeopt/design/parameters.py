"""Which dimensions of the tubes are free, between which bounds, and which of them change together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError, choice, finite
from ..robots.tubes import Tube, second_moment
from ..typing import Array
from .checks import items, whole

FIELDS = ("curvature", "straight_length", "curved_length", "outer_diameter", "inner_diameter")
"""Dimensions of a tube that may be free."""

TIES = ("each", "equal", "scaled")

NAMES = {field: field.replace("_", " ") for field in FIELDS}

UNITS = {
    "curvature": ("1/m", 1.0),
    **dict.fromkeys(FIELDS[1:], ("mm", 1000.0)),
}
"""How a dimension is shown: its unit, and what turns SI into it."""

GRADED = (*FIELDS, "bending_stiffness", "torsional_stiffness")
"""What a design is differentiated into, n each."""


@dataclass(frozen=True)
class Free:
    """A dimension of some tubes that the design may choose.

    field: one of `FIELDS`.  tubes: from 0, inner to outer.  lower, upper: SI; for "scaled", factors.
    tie: "each" gives every tube its own value, "equal" one value to all, "scaled" multiplies all by one factor.

    Raises:
        InputError: unknown field or tie, no tube, bounds that are not finite or crossed.
    """

    field: str
    tubes: tuple[int, ...]
    lower: float
    upper: float
    tie: str = "each"

    def __post_init__(self) -> None:
        choice("field of a free dimension", self.field, FIELDS)
        choice("tie of a free dimension", self.tie, TIES)
        what = f"tubes of the free {NAMES[self.field]}"
        numbers = items(what, self.tubes, object, "tubes, counted from 0")
        object.__setattr__(self, "tubes", tuple(whole(f"one of the {what}", i) for i in numbers))
        if not self.tubes:
            raise InputError(f"{what} is empty; there must be at least one")
        twice = [i for k, i in enumerate(self.tubes) if i in self.tubes[:k]]
        if twice:
            raise InputError(f"{what} name tube {twice[0] + 1} twice; they must be different tubes")
        low, high = (finite(f"{name} bound of {NAMES[self.field]}", getattr(self, name)) for name in ("lower", "upper"))
        if low > high:
            raise InputError(f"bounds of {NAMES[self.field]} are {low:g} and {high:g}; the lower must not be greater")
        if low < 0 and (self.field != "curvature" or self.tie == "scaled"):
            raise InputError(f"lower bound of {NAMES[self.field]} is {low:g}; it must be at least 0")


@dataclass(frozen=True, eq=False)
class DesignSpace:
    """The D unknowns of a design, one per free value; `unknowns` name the dimension and the tubes of each.

    start, lower, upper, scale: (D,) in SI (factors where scaled); scale is the size of a change that matters.
    """

    robot_tubes: tuple[Tube, ...]
    unknowns: tuple[tuple[str, tuple[int, ...], bool], ...]
    start: Array
    lower: Array
    upper: Array
    scale: Array

    @property
    def names(self) -> tuple[str, ...]:
        """What each unknown is, in words."""
        return tuple(
            f"{'factor of ' if scaled else ''}{NAMES[field]} of tube{'s' * (len(tubes) > 1)} "
            f"{', '.join(str(i + 1) for i in tubes)}"
            for field, tubes, scaled in self.unknowns
        )

    def tubes(self, x: Array) -> tuple[Tube, ...]:
        """The tubes at x (D,); raises InputError where they are no tubes."""
        values: list[dict[str, float]] = [{} for _ in self.robot_tubes]
        for (field, tubes, scaled), value in zip(self.unknowns, x, strict=True):
            for i in tubes:
                values[i][field] = float(value) * (getattr(self.robot_tubes[i], field) if scaled else 1.0)
        return tuple(
            replace(tube, **changes) if changes else tube  # type: ignore[arg-type]
            for tube, changes in zip(self.robot_tubes, values, strict=True)
        )

    def expressions(self, x: Any) -> dict[str, Any]:
        """Every one of GRADED (n,) as an expression of x (D,); what x does not move are numbers."""
        out: dict[str, Any] = {}
        for name in GRADED:
            column = ca.MX([getattr(tube, name) for tube in self.robot_tubes])
            for k, (field, chosen, scaled) in enumerate(self.unknowns):
                for i in chosen if field == name else ():
                    column[i] = x[k] * (getattr(self.robot_tubes[i], field) if scaled else 1.0)
            out[name] = column
        if any(field in ("outer_diameter", "inner_diameter") for field, _, _ in self.unknowns):
            second = second_moment(out["outer_diameter"], out["inner_diameter"])
            tubes = self.robot_tubes
            out["bending_stiffness"] = ca.DM([tube.material.youngs_modulus for tube in tubes]) * second
            out["torsional_stiffness"] = ca.DM([2 * tube.material.shear_modulus for tube in tubes]) * second
        return out

    def slopes(self, tubes: Sequence[Tube]) -> dict[str, Array]:
        """Change (n, D) of every one of GRADED with x, at these tubes."""
        n, count = len(tubes), len(self.unknowns)
        out = {name: np.zeros((n, count)) for name in GRADED}
        for column, (field, chosen, scaled) in enumerate(self.unknowns):
            for i in chosen:
                out[field][i, column] = getattr(self.robot_tubes[i], field) if scaled else 1.0
        for i, tube in enumerate(tubes):
            # I = pi / 64 (OD^4 - ID^4), J = 2 I
            moved = (
                tube.outer_diameter**3 * out["outer_diameter"][i] - tube.inner_diameter**3 * out["inner_diameter"][i]
            )
            area = np.pi / 16 * moved
            out["bending_stiffness"][i] = tube.material.youngs_modulus * area
            out["torsional_stiffness"][i] = tube.material.shear_modulus * 2 * area
        return out


def _entries(free: Sequence[Free], n: int) -> Iterator[tuple[Free, tuple[int, ...]]]:
    taken: set[tuple[str, int]] = set()
    for one in free:
        for i in one.tubes:
            if not 0 <= i < n:
                raise InputError(f"free {NAMES[one.field]} names tube {i + 1}; the robot has tubes 1 to {n}")
            if (one.field, i) in taken:
                raise InputError(f"{NAMES[one.field]} of tube {i + 1} is free twice; it must be named once")
            taken.add((one.field, i))
        groups = [(i,) for i in one.tubes] if one.tie == "each" else [one.tubes]
        for group in groups:
            yield one, group


def design_space(tubes: Sequence[Tube], free: Sequence[Free]) -> DesignSpace:
    """The unknowns of a design that starts from `tubes`; the start is brought within the bounds.

    Raises:
        InputError: a tube that is not there, a dimension that is free twice, none that is free.
    """
    entries = list(_entries(free, len(tubes)))
    if not entries:
        raise InputError("free is empty; a design needs at least one free dimension")
    lower = np.array([one.lower for one, _ in entries])
    upper = np.array([one.upper for one, _ in entries])
    start = [
        1.0 if one.tie == "scaled" else float(np.mean([getattr(tubes[i], one.field) for i in group]))
        for one, group in entries
    ]
    begin = np.clip(start, lower, upper)
    span = np.where(upper > lower, upper - lower, 1.0)
    scale = np.where(np.abs(begin) > 0, np.minimum(span, np.maximum(np.abs(begin), 0.1 * span)), span)
    unknowns = tuple((one.field, group, one.tie == "scaled") for one, group in entries)
    return DesignSpace(tuple(tubes), unknowns, begin, lower, upper, scale)
