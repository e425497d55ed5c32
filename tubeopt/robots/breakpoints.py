"""The order of the breakpoints of an arm: what its sections are made of, for numbers and for symbols alike.

As long as breakpoints keep their order, the lengths of the sections are linear in lengths and translations of the
tubes; which tubes are present and which are curved in a section does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..typing import Array
from .assembly import Assembly

DIMENSIONS = ("curvature", "straight_length", "curved_length", "bending_stiffness", "torsional_stiffness")
"""Dimensions of the tubes on which an equilibrium depends, (n,) each, SI."""


@dataclass(frozen=True)
class Breakpoint:
    """Where tubes that move together begin to curve, or end (`end`)."""

    tubes: tuple[int, ...]
    end: bool

    def __str__(self) -> str:
        what = "end" if self.end else "transition"
        first, last = self.tubes[0] + 1, self.tubes[-1] + 1
        return f"the {what} of tube {first}" if first == last else f"the common {what} of tubes {first} to {last}"


@dataclass(frozen=True, eq=False)
class Order:
    """Breakpoints in front of the plate in order, and those held behind it.

    Section k lies between breakpoint k - 1 (the plate for the first) and breakpoint k; `present`, `curved` (m, n) tell
    which tubes are there, and curved there. Sections may have no length.
    """

    front: tuple[Breakpoint, ...]
    behind: tuple[Breakpoint, ...]
    present: NDArray[np.bool_]
    curved: NDArray[np.bool_]

    def lengths(self, transition: Any, end: Any) -> Any:
        """(m,) lengths of the sections, from the places (n,) of the transitions and ends: arrays or expressions."""
        places = [_place(point, transition, end) for point in self.front]
        gaps = [b - a for a, b in zip([0.0, *places[:-1]], places, strict=True)]
        return ca.vertcat(*gaps) if any(isinstance(gap, (ca.SX, ca.MX)) for gap in gaps) else np.array(gaps)

    def held_back(self, transition: Any, end: Any) -> list[Any]:
        """How far the breakpoints behind the plate lie behind it, m, one each."""
        return [-_place(point, transition, end) for point in self.behind]


def _place(point: Breakpoint, transition: Any, end: Any) -> Any:
    return (end if point.end else transition)[point.tubes[0]]


def order_of(assembly: Assembly, carriages: Sequence[tuple[int, ...]], *, side: int = -1) -> Order:
    """The order of the breakpoints of an assembly.

    Args:
        carriages: tubes that move together; breakpoints that they share are one.
        side: where a transition lies at the plate: 1 takes it in front, -1 behind. Among other breakpoints that
            coincide outer tubes come first, so that an inner one may grow out of them.
    """
    n = assembly.n_tubes
    transition, end = assembly.transition, assembly.end
    groups: list[tuple[float, int, Breakpoint]] = []
    for tubes in carriages:
        for at_end, values in ((False, transition), (True, end)):
            # A tube without a curved part has no transition: it is straight to its end.
            mine = [i for i in tubes if at_end or _has_curve(assembly, i)]
            while mine:
                same = tuple(i for i in mine if abs(values[i] - values[mine[0]]) <= 1e-9)
                groups.append((float(values[mine[0]]), -max(same), Breakpoint(same, at_end)))
                mine = [i for i in mine if i not in same]
    nudge = side * 1e-9
    front = sorted(
        (g for g in groups if g[0] + (0.0 if g[2].end else nudge) > 0), key=lambda g: (round(g[0], 10), g[1])
    )
    kept = [point for *_, point in front]
    return arrange(kept, [point for *_, point in groups if point not in kept], n)


def arrange(front: Sequence[Breakpoint], behind: Sequence[Breakpoint], n_tubes: int) -> Order:
    """The order with these breakpoints in front of the plate, base to tip, and those behind it."""
    present, curved = (np.zeros((len(front), n_tubes), dtype=bool) for _ in range(2))
    rank = {(i, point.end): k for k, point in enumerate(front) for i in point.tubes}
    bent = {i for point in (*front, *behind) if not point.end for i in point.tubes}
    for i in range(n_tubes):
        last, first = rank.get((i, True), -1), rank.get((i, False), -1)
        present[: last + 1, i] = True
        curved[first + 1 : last + 1, i] = i in bent
    return Order(tuple(front), tuple(behind), present, curved)


def _has_curve(assembly: Assembly, tube: int) -> bool:
    return bool(assembly.end[tube] > assembly.transition[tube])


def places(translations: Any, straight_length: Any, curved_length: Any) -> tuple[Any, Any, Any]:
    """Transmission |beta|, transition and end (n,) of the tubes: arrays or expressions."""
    return straight_length - translations, translations, translations + curved_length


def dimensions_of(tubes: Sequence[Any]) -> dict[str, Array]:
    """The DIMENSIONS of tubes, (n,) each."""
    return {name: np.array([getattr(tube, name) for tube in tubes]) for name in DIMENSIONS}
