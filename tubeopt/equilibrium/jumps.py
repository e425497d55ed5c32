"""Breakpoints that move with the parameters of a derivative, and the cross-sections that they uncover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..robots.assembly import ROUND_OFF, Assembly
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Jumps:
    """J breakpoints that parameters move: `column` of the parameter, `index` of the piece that begins there, and
    kb, m (2 J, n) of the cross-sections that the motion uncovers, then of what was there; `spread` (J, Q) is 1 in the
    column of each."""

    column: NDArray[np.intp]
    index: NDArray[np.intp]
    stiffness: Array
    moment: Array
    spread: Array

    def __len__(self) -> int:
        return len(self.column)

    @cached_property
    def solid(self) -> Array:
        """kb (2 J, n) where there is a tube, 1 where there is none and a cross-section cannot be asked."""
        return np.where(self.stiffness.any(1, keepdims=True), self.stiffness, 1.0)

    def twice(self, table: Array) -> Array:
        """(2 J, ...) of a table (P + 1, ...) between the pieces."""
        here = table[self.index]
        return np.concatenate([here, here])

    def gain(self, values: Array) -> Array:
        """(J, ...) of values (2 J, ...): of what the motion uncovers over what was there."""
        half = len(self.column)
        return np.asarray(values[:half] - values[half:])


Mover = tuple[int, tuple[int, ...], tuple[int, ...]]
"""Column of a parameter that moves breakpoints, with the tubes whose transitions and whose ends move along."""


def moving_breakpoints(assembly: Assembly, cuts: Array, movers: Sequence[Mover], side: int, size: int) -> Jumps:
    """Every breakpoint in front of the plate that a parameter, one of `size`, moves towards the tip (`side` 1) or the
    plate (-1); `cuts` (P + 1,) are the arc lengths between the pieces."""
    n, nudge = assembly.n_tubes, side * ROUND_OFF
    begin, end = assembly.transition.tolist(), assembly.end.tolist()
    least = -nudge if len(cuts) > 1 else np.inf
    column, place, gained, lost = [], [], [], []
    for c, first, last in movers:
        own = sorted([end[i] for i in last] + [begin[i] for i in first if end[i] - begin[i] > ROUND_OFF])
        begins = [s + 2 * nudge * (i in first) for i, s in enumerate(begin)]
        ends = [s + 2 * nudge * (i in last) for i, s in enumerate(end)]
        for k, s in enumerate(own):
            if s > least and not (k and s - own[k - 1] <= ROUND_OFF):
                after, before = _there(begins, ends, s + nudge), _there(begin, end, s + nudge)
                if after != before:
                    column.append(c)
                    place.append(s)
                    gained.append(after)
                    lost.append(before)
    there = np.array(gained + lost, dtype=bool).reshape(-1, 2, n)
    return Jumps(
        column=np.array(column, dtype=np.intp),
        index=np.searchsorted(cuts, np.array(place) - 2 * ROUND_OFF),
        stiffness=there[:, 0] * assembly.bending_stiffness,
        moment=there[:, 1] * (assembly.bending_stiffness * assembly.curvature),
        spread=(np.array(column)[:, None] == np.arange(size)).astype(float),
    )


def _there(transition: list[float], end: list[float], s: float) -> tuple[list[bool], list[bool]]:
    """Which tubes are there at arc length s between breakpoints, and which of them in their curved part."""
    return [s < last for last in end], [first < s < last for first, last in zip(transition, end, strict=True)]
