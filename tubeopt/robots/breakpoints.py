"""The order of the breakpoints of an arm: what its sections are made of, for numbers and for symbols alike.

As long as breakpoints keep their order, the lengths of the sections are linear in lengths and translations of the
tubes; which tubes are present and which are curved in a section does not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..typing import Array
from .assembly import ROUND_OFF, Assembly

DIMENSIONS = ("curvature", "straight_length", "curved_length", "bending_stiffness", "torsional_stiffness")
"""Dimensions of the tubes on which an equilibrium depends, (n,) each, SI."""


@dataclass(frozen=True)
class Breakpoint:
    """Where tubes that move together begin to curve, or end (`end`), or where panels of a tube made of pieces meet:
    the `joint`, counted from 1 from the first tube's held end on."""

    tubes: tuple[int, ...]
    end: bool
    joint: int = 0

    def place(self, n: int) -> int:
        """Where it is in a column of n transitions, n ends, and all joints."""
        return 2 * n + self.joint - 1 if self.joint else self.tubes[0] + (n if self.end else 0)

    def before(self, other: Breakpoint) -> bool:
        """Whether it is a place of the same tube nearer to its held end."""
        return bool(set(self.tubes) & set(other.tubes)) and (self.end, self.joint) < (other.end, other.joint)

    def __str__(self) -> str:
        if self.joint:
            return f"joint {self.joint} between pieces, of tube {self.tubes[0] + 1},"
        what = "end" if self.end else "transition"
        first, last = self.tubes[0] + 1, self.tubes[-1] + 1
        return f"the {what} of tube {first}" if first == last else f"the common {what} of tubes {first} to {last}"


@dataclass(frozen=True, eq=False)
class Order:
    """Breakpoints in front of the plate in order, and those held behind it.

    Section k lies between breakpoint k - 1 (the plate for the first) and breakpoint k; `present`, `curved` (m, n) tell
    which tubes are there, and curved there, `panel` (m, n) how many breakpoints of each lie behind it. Sections may
    have no length.
    """

    front: tuple[Breakpoint, ...]
    behind: tuple[Breakpoint, ...]
    present: NDArray[np.bool_]
    curved: NDArray[np.bool_]
    panel: NDArray[np.intp]

    def lengths(self, where: Array) -> Array:
        """(m,) lengths of the sections, from the places of the transitions, ends and joints."""
        n = self.present.shape[1]
        return np.diff([0.0, *(where[point.place(n)] for point in self.front)])


def joints_of(assembly: Assembly) -> list[Array]:
    """Arc lengths, m, where panels of each tube meet behind its transition; none of tubes of one curvature."""
    table = assembly.lengthwise
    if table is None:
        return [np.zeros(0)] * assembly.n_tubes
    places = table.breaks - assembly.transmission[:, None]
    first, last = assembly.transition + ROUND_OFF, assembly.end - ROUND_OFF
    return [own[(own > a) & (own < b)] for own, a, b in zip(places, first, last, strict=True)]


def where_of(assembly: Assembly) -> Array:
    """Arc lengths, m, of all transitions, ends and joints."""
    return np.concatenate([assembly.transition, assembly.end, *joints_of(assembly)])


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
            mine = [i for i in tubes if at_end or has_curve(assembly, i)]
            while mine:
                same = tuple(i for i in mine if abs(values[i] - values[mine[0]]) <= 1e-9)
                groups.append((float(values[mine[0]]), -max(same), Breakpoint(same, at_end)))
                mine = [i for i in mine if i not in same]
    joints = [(float(s), i) for i, own in enumerate(joints_of(assembly)) for s in own]
    groups += [(s, -i, Breakpoint((i,), False, k)) for k, (s, i) in enumerate(joints, start=1)]
    nudge = side * 1e-9
    front = sorted(
        (g for g in groups if g[0] + (0.0 if g[2].end else nudge) > 0), key=lambda g: (round(g[0], 10), g[1])
    )
    kept = [point for *_, point in front]
    return arrange(kept, [point for *_, point in groups if point not in kept], n)


def arrange(front: Sequence[Breakpoint], behind: Sequence[Breakpoint], n_tubes: int) -> Order:
    """The order with these breakpoints in front of the plate, base to tip, and those behind it."""
    present, curved = (np.zeros((len(front), n_tubes), dtype=bool) for _ in range(2))
    panel = np.zeros((len(front), n_tubes), dtype=np.intp)
    for i in range(n_tubes):
        panel[:, i] = sum(i in point.tubes for point in behind)
        panel[1:, i] += np.cumsum([i in point.tubes for point in front[:-1]], dtype=np.intp)
    rank = {(i, point.end): k for k, point in enumerate(front) if not point.joint for i in point.tubes}
    bent = {i for point in (*front, *behind) if not point.end for i in point.tubes}
    for i in range(n_tubes):
        last, first = rank.get((i, True), -1), rank.get((i, False), -1)
        present[: last + 1, i] = True
        curved[first + 1 : last + 1, i] = i in bent
    return Order(tuple(front), tuple(behind), present, curved, panel)


def has_curve(assembly: Assembly, tube: int) -> bool:
    """Whether a tube has a curved part."""
    return bool(assembly.end[tube] > assembly.transition[tube])


def places(translations: Any, straight_length: Any, curved_length: Any) -> tuple[Any, Any, Any]:
    """Transmission |beta|, transition and end (n,) of the tubes: arrays or expressions."""
    return straight_length - translations, translations, translations + curved_length


def dimensions_of(tubes: Sequence[Any]) -> dict[str, Array]:
    """The DIMENSIONS of tubes, (n,) each."""
    return {name: np.array([getattr(tube, name) for tube in tubes]) for name in DIMENSIONS}
