"""Breakpoints of the tubes, and the strips with other tubes that they uncover as they move."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..robots.assembly import ROUND_OFF, Assembly
from ..robots.lengthwise import CrossSections
from ..robots.order import outermost
from ..typing import Array, Index, Mask

SAME_SPEED = 1e-12
"""Part of the greatest speed below which speeds of breakpoints that coincide differ by round-off alone."""


@dataclass(frozen=True, eq=False)
class Breakpoints:
    """J breakpoints in front of the plate or at it: the `tube` that has each, its `place` (m), whether it is the `end`
    of the tube, the `index` of the piece that begins there, and numbers of those that coincide, `together`."""

    tube: Index
    place: Array
    end: Mask
    index: Index
    together: tuple[tuple[int, ...], ...]
    of_tubes: Array
    """(J, n) 1 where a tube has the breakpoint, 0 elsewhere."""


@lru_cache(maxsize=64)
def breakpoints_of(assembly: Assembly, between: bytes) -> Breakpoints:
    """Those of all tubes; `between` are the arc lengths (P + 1,) between the pieces."""
    each = [_places(assembly, i) for i in range(assembly.n_tubes)]
    own = [(i, s, k == len(row) - 1) for i, row in enumerate(each) for k, s in enumerate(row) if s > -ROUND_OFF]
    place = np.array([s for _, s, _ in own])
    index = np.searchsorted(np.frombuffer(between), place - 2 * ROUND_OFF)
    where: dict[int, list[int]] = {}
    for j, k in enumerate(index.tolist()):
        where.setdefault(k, []).append(j)
    tube, end = np.array([i for i, _, _ in own], dtype=np.intp), np.array([last for _, _, last in own], dtype=bool)
    together = tuple(tuple(some) for _, some in sorted(where.items()))
    return Breakpoints(tube, place, end, index, together, np.eye(assembly.n_tubes)[tube])


class Strip(NamedTuple):
    """What breakpoints that coincide uncover between two of their shifted places: those of `past` moved beyond it. It
    lies on the side of the tip or, with `plate_side`, of the plate; places are numbers of breakpoints."""

    together: tuple[int, ...]
    past: tuple[int, ...]
    plate_side: bool


@lru_cache(maxsize=64)
def strips_of(points: Breakpoints, columns: int, speeds: bytes) -> tuple[tuple[Strip, ...], Array]:
    """The strips (T,) that Q `columns` of directions uncover and their widths (T, Q), if breakpoints move towards the
    tip at `speeds` (J, Q). The order in which the places are then decides which tubes are in a strip."""
    speed = np.frombuffer(speeds).reshape(-1, columns)
    widths: dict[Strip, Array] = {}
    for own in points.together:
        in_front, rows = bool(points.place[own[0]] > ROUND_OFF), speed[[*own]]
        if len(own) == 1:
            widths[Strip(own, own, False)] = rows[0] if in_front else np.maximum(rows[0], 0.0)
            continue
        alike: dict[tuple[float, ...], list[int]] = {}
        for column in np.flatnonzero(rows.any(0)).tolist():
            alike.setdefault(tuple(rows[:, column].tolist()), []).append(column)
        for pace, those in alike.items():
            levels = sorted([0.0, *pace])
            least = SAME_SPEED * max(levels[-1], -levels[0])
            for low, high in pairwise(levels):
                if high - low > least and (high > 0 or in_front):
                    past = tuple(j for j, one in zip(own, pace, strict=True) if one >= high - least)
                    widths.setdefault(Strip(own, past, high <= 0), np.zeros(columns))[those] += high - low
    widths = {strip: width for strip, width in widths.items() if width.any()}
    return tuple(widths), np.array([*widths.values()]).reshape(len(widths), columns)


@dataclass(frozen=True, eq=False)
class Uncovered:
    """Of T strips: the `index` of the piece that begins there and 2 T cross-sections, of what the motion uncovers, then
    of what was there; `there` (2 T,) whether there is any tube, and the `outermost` one."""

    index: Index
    sections: CrossSections
    there: Mask
    outermost: Index
    onto: Array
    """(P + 1, T) 1 where the piece of a row begins, 0 elsewhere."""

    @cached_property
    def rate(self) -> Array:
        """(2 T, n) 1 / kt."""
        return np.asarray(1 / self.sections.torsional_stiffness)

    @cached_property
    def stiffness(self) -> Array:
        """(2 T, n) kb; 1 where there is no tube, where a cross-section cannot be asked."""
        return np.where(self.there[:, None], self.sections.stiffness, 1.0)

    @cached_property
    def grown(self) -> Array:
        """(T,) 1 where a strip that the tip uncovers is new, -1 where there is none any more, else 0."""
        new, old = self.there.reshape(2, -1)
        return np.asarray(new * 1.0 - old)


@lru_cache(maxsize=64)
def uncovered_by(assembly: Assembly, between: bytes, strips: tuple[Strip, ...]) -> Uncovered:
    """What strips uncover; `between` as for `breakpoints_of`."""
    points, count = breakpoints_of(assembly, between), len(strips)
    first = np.array([strip.together[0] for strip in strips], dtype=np.intp)
    place = points.place[first]
    # Breakpoints that have moved beyond each cross-section: of what is uncovered, then of what was there.
    each = [strip.past for strip in strips] + [strip.together if strip.plate_side else () for strip in strips]
    row = [k for k, moved in enumerate(each) for _ in moved]
    beyond = np.zeros((2 * count, len(points.place)))
    beyond[row, [j for moved in each for j in moved]] = 1.0
    both = np.concatenate([place, place])
    side = both[:, None] + ROUND_OFF
    near = side - 2 * ROUND_OFF * (beyond @ points.of_tubes)
    # Where a curved part begins to grow its end moves alone.
    bends = side - 2 * ROUND_OFF * ((beyond * ~points.end) @ points.of_tubes)
    present = near < assembly.end
    return Uncovered(
        index=points.index[first],
        sections=_sections(assembly, both, bends, present),
        there=np.asarray(present.any(1)),
        outermost=outermost(present),
        onto=np.asarray(np.arange(len(between) // 8)[:, None] == points.index[first], dtype=float),
    )


def _places(assembly: Assembly, tube: int) -> list[float]:
    """Arc lengths (m) of the breakpoints of a tube in their order."""
    if assembly.lengthwise is None:
        return [float(assembly.transition[tube]), float(assembly.end[tube])]
    own = sorted(cut - float(assembly.transmission[tube]) for cut in assembly.lengthwise.cuts[tube])
    return [s for k, s in enumerate(own) if not k or s - own[k - 1] > ROUND_OFF]


def _sections(assembly: Assembly, s: Array, near: Array, present: Mask) -> CrossSections:
    """The tubes at arc lengths (X,), each on the side of (X, n), straight behind where it is held, and (X, n) which are
    there."""
    if assembly.lengthwise is not None:
        side = near + assembly.transmission
        here = assembly.lengthwise.at(s[:, None] + assembly.transmission, side, present)
        return replace(here, moment=here.moment * (side >= 0))
    kb = assembly.bending_stiffness * present
    none = np.zeros(kb.shape)
    moment = kb * assembly.curvature * (near > assembly.transition)
    return CrossSections(kb, moment, none, none + assembly.torsional_stiffness, none, none)
