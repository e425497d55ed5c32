"""Breakpoints that move with the parameters of a derivative, and the cross-sections that they uncover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..robots.assembly import ROUND_OFF, where
from ..typing import Array

if TYPE_CHECKING:
    from .derivatives import Derivatives


@dataclass(frozen=True, eq=False)
class Jumps:
    """J breakpoints that parameters move: `column` of the parameter, `index` of the piece that begins there, and kb, m
    (J, n) of the cross-section that the motion uncovers (`gained`) and of what was there (`lost`)."""

    column: NDArray[np.intp]
    index: NDArray[np.intp]
    gained: tuple[Array, Array]
    lost: tuple[Array, Array]

    def __len__(self) -> int:
        return len(self.column)


def moving_breakpoints(of: Derivatives) -> Jumps:
    """Every breakpoint in front of the plate that a parameter moves."""
    assembly, n, nudge = of.assembly, of.arm.n_tubes, of.side * ROUND_OFF
    begin, end = assembly.transition.tolist(), assembly.end.tolist()
    least = -ROUND_OFF if of.side > 0 else ROUND_OFF
    if not of.arm.n_pieces:
        least = np.inf
    column, place = [], []
    begins, ends = (np.zeros((of.size, n), dtype=bool) for _ in range(2))
    for c, first, last in of.movers:
        begins[c, list(first)], ends[c, list(last)] = True, True
        own = sorted([end[i] for i in last] + [begin[i] for i in first if end[i] - begin[i] > ROUND_OFF])
        for k, s in enumerate(own):
            if s > least and not (k and s - own[k - 1] <= ROUND_OFF):
                column.append(c)
                place.append(s)
    at = np.array(place)[:, None] + nudge
    lost = where(assembly.transition, assembly.end, assembly.curvature, at)
    moved = (table[column] * (2 * nudge) for table in (begins, ends))
    transition, end_ = (a + b for a, b in zip((assembly.transition, assembly.end), moved, strict=True))
    gained = where(transition, end_, assembly.curvature, at)
    changed = np.flatnonzero((gained[0] != lost[0]).any(1) | (gained[1] != lost[1]).any(1))
    kb, m = assembly.bending_stiffness, assembly.bending_stiffness * assembly.curvature
    sections = [(kb * present[changed], m * curved[changed]) for present, curved in (gained, lost)]
    index = np.abs(of.cuts - at[changed]).argmin(axis=1) if len(changed) else changed
    return Jumps(np.array(column, dtype=np.intp)[changed], index, *sections)
