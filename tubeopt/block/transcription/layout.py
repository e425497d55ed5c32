"""How the pieces of a block lie in the sections of an arm: numbers that change where breakpoints change their order.

The lengths of the pieces are linear in the places of the breakpoints, and which tubes are present and curved on each
are numbers too, so that one program serves every order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...robots.assembly import Assembly
from ...robots.breakpoints import Breakpoint, Order, arrange, has_curve, joints_of, where_of
from ...typing import Array
from .mesh import piece_counts

FREE_REFINEMENT = 1
"""How often pieces are halved where lengths, curvatures or stiffnesses are free, so that they may grow."""


@dataclass(frozen=True, eq=False)
class Layout:
    """P pieces of an arm with b breakpoints.

    order: of the breakpoints.  section: (P,) the section of each piece.  length: (P, 2n) coefficients of (transition,
    end) in the lengths of the pieces.  gap: (b, 2n) of those in the lengths of the sections and in how far breakpoints
    behind the plate lie behind it: all must be >= 0.  present, curved: (n, P), 0 or 1. Where tubes are made of pieces
    length and gap have further columns, for their joints, and (B, P) `curved` picks the panel of each tube, 0 or 1.
    """

    order: Order
    section: tuple[int, ...]
    length: Array
    gap: Array
    present: Array
    curved: Array

    @property
    def n_pieces(self) -> int:
        """Number of pieces P."""
        return len(self.section)

    def numbers(self) -> Array:
        """All that a reordering changes, as one column: length, gap, present, curved, each by columns."""
        parts = (self.length, self.gap, self.present, self.curved)
        return np.concatenate([part.ravel(order="F") for part in parts])


def layout(
    assembly: Assembly, order: Order, *, pieces: int | None = None, refinement: int = 0, least: int = 0
) -> Layout:
    """Pieces in every section, short enough for coupling and bend at the given places; sections without length get one.
    `pieces`: how many there must be in all; None is as many as are needed, and `least` at least."""
    where = where_of(assembly)
    lengths = np.maximum(order.lengths(where), 0.0)
    start = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    cut = replace(assembly, start=start, length=lengths, present=order.present, curved=order.curved)
    counts = piece_counts(cut, refinement)
    if pieces is not None:
        if pieces < len(counts):
            raise InputError(f"the block has {pieces} pieces; the order of its breakpoints needs {len(counts)}")
        counts = _fit(counts, lengths, pieces)
    elif counts.sum() < least:
        counts = _fit(counts, lengths, least)
    section = np.repeat(np.arange(len(counts)), counts)
    gap = gap_rows(order, assembly.n_tubes, len(where))
    curved = picked(order, assembly) if assembly.general else order.curved
    return Layout(
        order=order,
        section=tuple(section.tolist()),
        length=gap[: len(order.front)][section] / counts[section][:, None],
        gap=gap,
        present=order.present[section].T.astype(float),
        curved=curved[section].T.astype(float),
    )


def picked(order: Order, assembly: Assembly) -> Array:
    """(m, B) in which panel of each tube every section lies, 0 or 1: B panels, tube by tube, the straight part first;
    the last one where a tube has ended."""
    counts = [1 + (len(own) + 1) * has_curve(assembly, i) for i, own in enumerate(joints_of(assembly))]
    out = np.zeros((len(order.front), sum(counts)))
    for i, first in enumerate(np.cumsum([0, *counts[:-1]]).tolist()):
        out[np.arange(len(out)), first + np.minimum(order.panel[:, i], counts[i] - 1)] = 1.0
    return out


def _fit(counts: NDArray[np.intp], lengths: Array, pieces: int) -> NDArray[np.intp]:
    """Counts whose sum is `pieces`: of too many the longest pieces are spared, too few halve the longest."""
    counts = counts.copy()
    while counts.sum() != pieces:
        if counts.sum() < pieces:
            counts[int(np.argmax(lengths / counts))] += 1
        else:
            shorter = np.where(counts > 1, lengths / np.maximum(counts - 1, 1), np.inf)
            counts[int(np.argmin(shorter))] -= 1
    return counts


def gap_rows(order: Order, n: int, width: int) -> Array:
    """(b, width) coefficients of the places of transitions, ends and joints in the lengths of the sections, then in how
    far behind the plate the other breakpoints lie."""
    rows = np.zeros((len(order.front) + len(order.behind), width))
    for k, point in enumerate(order.front):
        rows[k, point.place(n)] += 1.0
        if k:
            rows[k, order.front[k - 1].place(n)] -= 1.0
    for k, point in enumerate(order.behind, start=len(order.front)):
        rows[k, point.place(n)] = -1.0
    return rows


def gap_names(order: Order) -> list[str]:
    """What each row of `gap` says, in words."""
    names = []
    for k, point in enumerate(order.front):
        before = "the plate" if not k else str(order.front[k - 1])
        names.append(f"order of breakpoints: {point} is not before {before}")
    return names + [f"order of breakpoints: {point} is not in front of the plate" for point in order.behind]


def sides(order: Order, row: int) -> tuple[Breakpoint, ...]:
    """The breakpoints between which a row of the gaps lies; one alone where the other side is the plate."""
    front = len(order.front)
    if row >= front:
        return (order.behind[row - front],)
    return order.front[max(row - 1, 0) : row + 1]


def may_swap(order: Order, row: int) -> bool:
    """Whether the breakpoint of a row of the gaps may change places with its neighbour, or with the plate: those of one
    tube stay in their order, and some tube in front of the plate."""
    front = len(order.front)
    if row >= front:
        return not any(order.behind[row - front].before(other) for other in order.behind)
    return not order.front[row - 1].before(order.front[row]) if row else front > 1


def swapped(order: Order, row: int) -> Order:
    """The order after the breakpoint of `row` of the gaps has changed places with its neighbour, or with the plate."""
    front, behind = list(order.front), list(order.behind)
    if row >= len(front):
        front.insert(0, behind.pop(row - len(front)))
    elif row == 0:
        behind.append(front.pop(0))
    else:
        front[row - 1], front[row] = front[row], front[row - 1]
    return arrange(front, behind, order.present.shape[1])
