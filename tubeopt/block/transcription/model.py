"""An arm in a program, all its pieces side by side: its equations as expressions, or its numbers at a solution.

Every piece is the same function of what holds where it begins: lifted into unknowns, so that all derivatives are local.
The base gives theta(0) = alpha + |beta| w(0), the tip w = 0 for every tube (a tube that has ended feels no moment, so
w = 0 at the tip is w = 0 at its own end).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...robots.assembly import Assembly, Breakpoint, Order, arrange, has_curve, joints_of, places, where_of
from ...typing import Array
from . import functions
from .chain import columns, joints, panels, transmissions
from .collocated import Grid
from .mesh import piece_counts

# --- Pieces in the sections of an arm ---------------------------------------------------------------------------------

# How the pieces of a block lie in the sections of an arm: numbers that change where breakpoints change their order.
#
# The lengths of the pieces are linear in the places of the breakpoints, and which tubes are present and curved on each
# are numbers too, so that one program serves every order.

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
    # The order may be one of other numbers than these: sections that would be negative have no length.
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
            # The piece that grows least when a section loses one; a section keeps at least one.
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
        # Behind the plate a place is negative: the gap is minus that.
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
        # Neighbours that meet change places without a jump: the section between them has no length.
        front[row - 1], front[row] = front[row], front[row - 1]
    return arrange(front, behind, order.present.shape[1])


@dataclass(frozen=True)
class Equation:
    """expression == 0, of size `scale`, with words for each entry."""

    name: str
    entries: tuple[str, ...]
    expression: Any
    scale: float


@dataclass(frozen=True, eq=False)
class TorsionModel:
    """The torsion of P pieces with K points and n tubes; expressions or arrays.

    theta, twist: (n, P) where pieces begin.  inner: (n, P K) theta at their points.
    stiffness, moment, torsional_stiffness: (n, P) kb_i of the tubes present, m_i of the tubes curved, kt_i.
    lengths: (P,).  transmission: (n,).  place: offset and angle (n,), or nothing.
    along: (X, P) what varies along tubes made of pieces, for which stiffness and moment are None; else None.
    """

    grid: Grid
    theta: Any
    twist: Any
    inner: Any
    stiffness: Any
    moment: Any
    torsional_stiffness: Any
    lengths: Any
    transmission: Any
    place: tuple[Any, ...]
    along: Any

    @property
    def n_pieces(self) -> int:
        """Number of pieces P."""
        return int(self.theta.shape[1])

    @property
    def data(self) -> list[Any]:
        """What is given of the pieces to their functions, side by side."""
        if self.along is not None:
            return [self.torsional_stiffness, self.lengths.reshape((1, -1)), self.along]
        beside = [ca.repmat(ca.vec(v), 1, self.n_pieces) for v in self.place]
        return [self.stiffness, self.moment, self.torsional_stiffness, self.lengths.reshape((1, -1)), *beside]

    @property
    def arguments(self) -> list[Any]:
        """Of the functions of a piece, all pieces side by side."""
        return [self.theta, self.twist, self.inner, *self.data]

    def piece(self, k: int) -> list[Any]:
        """The arguments of one piece."""
        degree = self.grid.degree
        own = [self.theta[:, k], self.twist[:, k], self.inner[:, k * degree : (k + 1) * degree]]
        return [*own, *(part[:, k] for part in self.data)]

    def mapped(self, name: str) -> ca.Function:
        """A function of `transcription.functions` for all pieces at once."""
        return mapped(name, self.grid, self.n_pieces)

    @cached_property
    def ends(self) -> tuple[Any, Any, Any]:
        """Defect (n, P K), theta and w (n, P) where pieces end."""
        defect, theta, twist = self.mapped("torsion")(*self.arguments)
        return defect, theta, twist

    def softness(self, margin: Any) -> tuple[Any, ...]:
        """What the Jacobi fields of tubes softened by `margin` need, side by side for all points."""
        count, degree = self.n_pieces, self.grid.degree
        data = [ca.horzcat(*(ca.repmat(part[:, k], 1, degree) for k in range(count))) for part in self.data]
        places = ca.DM(np.tile(self.grid.tableau.nodes, count)[None])
        # Where g is 1, nothing depends on the torsion.
        # dg/dtheta is multiplied by w; on the centreline that term is 0.
        twist = self.mapped("twist")(*self.arguments) if self.place else ca.DM.zeros(*self.inner.shape)
        function = mapped("softness", self.grid, count * degree)
        out = function.call([ca.repmat(margin, 1, count * degree), self.inner, twist, places, *data])
        return tuple(out)

    @property
    def held_at_the_plate(self) -> Any:
        """(n,) by how much of its rate a Jacobi field of each tube is away from 0 at the plate."""
        return self.transmission

    @property
    def energy(self) -> Any:
        """Elastic energy of the arm and of the transmissions, J."""
        bending = ca.sum2(self.mapped("energy")(*self.arguments))
        return bending + ca.dot(self.torsional_stiffness[:, 0] * self.transmission, self.twist[:, 0] ** 2) / 2

    def torsion_equations(self, rotations: Any, reach: float, sections: Sequence[int] | None = None) -> list[Equation]:
        """All that hold at an equilibrium whose tubes are held at `rotations`; `reach`: a typical length, m.

        Where the `sections` (from 0) are given of which the pieces are parts, words are of them."""
        defect, theta, twist = self.ends
        tubes = [f"tube {i + 1}" for i in range(self.theta.shape[0])]
        after, points = places_in_words(self.n_pieces, self.grid.degree, sections)
        # theta(0) = alpha + |beta| w(0), the straight part below the plate under constant torque.
        wound = self.transmission * self.twist[:, 0]
        return [
            equation("torsion equation", tubes, points, defect, 1.0),
            equation("continuity of rotation", tubes, after, self.theta[:, 1:] - theta[:, :-1], 1.0),
            equation("continuity of torsion", tubes, after, self.twist[:, 1:] - twist[:, :-1], 1 / reach),
            equation("base rotation", tubes, None, self.theta[:, 0] - rotations - wound, 1.0),
            equation("torsion at the end", tubes, None, twist[:, -1], 1 / reach),
        ]


@dataclass(frozen=True, eq=False)
class Model(TorsionModel):
    """An arm with its shape, and b breakpoints.

    q, p: (4, P - 1), (3, P - 1), where pieces but the first begin.  natural: (n, P) precurvature, of tubes made of
    pieces 0, since `along` tells it.  present: (n, P).  gaps: (b,).  held: (n,) lengths from where the tubes are held
    to the plate, m; `transmission` is that times kt and the mean of 1 / kt.
    """

    q: Any
    p: Any
    natural: Any
    present: Any
    gaps: Any
    held: Any

    @property
    def poses(self) -> tuple[Any, Any]:
        """Quaternions (4, P) and positions (3, P) where the pieces begin."""
        return ca.horzcat(ca.DM([1, 0, 0, 0]), self.q), ca.horzcat(ca.DM.zeros(3), self.p)

    @cached_property
    def pose_ends(self) -> tuple[Any, Any]:
        """Quaternions (4, P) and positions (3, P) where pieces end."""
        q, p = self.mapped("pose")(*self.poses, *self.arguments)
        return q, p

    def equations(self, rotations: Any, reach: float) -> list[Equation]:
        """Those of the torsion, and of the shape."""
        q, p = self.pose_ends
        after, _ = places_in_words(self.n_pieces, self.grid.degree)
        return [
            *self.torsion_equations(rotations, reach),
            equation("continuity of orientation", list("wxyz"), after, self.q - q[:, :-1], 1.0),
            equation("continuity of position", list("xyz"), after, self.p - p[:, :-1], reach),
        ]

    def at(self, value: Callable[[Any], Any]) -> Model:
        """The numbers of this arm that `value` gives to its expressions."""
        names = [name for name in self.__dataclass_fields__ if name not in ("grid", "place", "typical")]
        parts = {name: getattr(self, name) for name in names}
        numbers: dict[str, Any] = {
            name: None if part is None else np.array(value(part)).reshape(part.shape) for name, part in parts.items()
        }
        for name in ("lengths", "gaps", "transmission", "held"):
            numbers[name] = numbers[name].ravel()
        return replace(self, **numbers)


def places_in_words(pieces: int, degree: int, sections: Sequence[int] | None = None) -> tuple[list[str], list[str]]:
    """Words for where pieces but the first begin, and for all points; of the `sections` of which they are parts."""
    if sections is None:
        after = [f"after piece {k + 1}" for k in range(pieces - 1)]
        return after, [f"piece {k + 1}, point {c + 1}" for k in range(pieces) for c in range(degree)]
    begun = [k - list(sections).index(section) for k, section in enumerate(sections)]
    points = [
        f"section {section + 1}, point {begun[k] * degree + c + 1}"
        for k, section in enumerate(sections)
        for c in range(degree)
    ]
    return [f"section {section + 1}" for section in sections[1:]], points


def equation(name: str, rows: list[str], columns: list[str] | None, expression: Any, scale: float) -> Equation:
    """A matrix that is 0, with words for its entries by columns; a single column needs none."""
    tails = [""] if columns is None else [f", {column}" for column in columns]
    labels = tuple(f"{name}, {row}{tail}" for tail in tails for row in rows)
    return Equation(name, labels, ca.vec(expression), scale)


@lru_cache(maxsize=256)
def mapped(name: str, grid: Grid, pieces: int) -> ca.Function:
    """A function of `transcription.functions`, by name, for so many pieces side by side: one for all arms, and so are
    its derivatives."""
    function: ca.Function = getattr(functions, f"{name}_function")(grid)
    return function.map(pieces)


def unknowns_of(grid: Grid, pieces: int) -> dict[str, tuple[int, int]]:
    """Shapes of the columns of unknowns of an arm: theta and w where pieces begin, theta at their points, and the pose
    where all pieces but the first begin; under load the bending moment where pieces begin, and at their points."""
    n, degree = grid.n_tubes, grid.degree
    torsion = {"rotation": (n, pieces), "torsion": (n, pieces), "rotation inside": (n, pieces * degree)}
    pose = {"orientation": (4, pieces - 1), "position": (3, pieces - 1)}
    bending = {"bending moment": (2, pieces), "bending moment inside": (2 * degree, pieces)}
    return {**torsion, **pose, **(bending if grid.loaded else {})}


def numbers_of(layout: Layout, column: Any = None) -> tuple[Any, Any, Any, Any]:
    """length, gap, present and curved of a layout, as numbers, or read off the `column` of a parameter."""
    parts = (layout.length, layout.gap, layout.present, layout.curved)
    if column is None:
        return ca.DM(layout.length), ca.DM(layout.gap), ca.DM(layout.present), ca.DM(layout.curved)
    stops = np.cumsum([0, *(part.size for part in parts)]).tolist()
    own = ca.vertsplit(column, stops)
    length, gap, present, curved = (ca.reshape(own[k], *part.shape) for k, part in enumerate(parts))
    return length, gap, present, curved


def model_of(grid: Grid, numbers: tuple[Any, ...], unknowns: tuple[Any, ...], inputs: Mapping[str, Any]) -> Model:
    """The arm with these unknowns, as matrices, on a layout's `numbers`, with these joint values and dimensions.

    `inputs` has also the `place` of eccentric tubes, and the `chain` of tubes made of pieces, with their PIECES.
    """
    length, gap, present, curved = numbers
    held, transition, end = places(inputs["translations"], inputs["straight_length"], inputs["curved_length"])
    chain, pieces = inputs.get("chain"), present.shape[1]
    stiffness, moment, natural, along, transmission = None, None, ca.DM.zeros(present.shape), None, held
    if chain is None:
        where = ca.vertcat(transition, end)
        lengths = length @ where
        kb = ca.repmat(inputs["bending_stiffness"], 1, pieces)
        # Masks are numbers, so the expression is the same for every order of breakpoints.
        natural = ca.repmat(inputs["curvature"], 1, pieces) * curved
        stiffness, moment = kb * present, kb * natural
    else:
        laid = panels(chain, inputs)
        where = ca.vertcat(transition, end, *joints(chain, laid, held))
        lengths = length @ where
        transmission = transmissions(chain, laid, (held, curved[:, 0]), inputs["torsional_stiffness"])
        along = columns(chain, laid, (curved, present), (held, ca.vertcat(0, ca.cumsum(lengths))))
    theta, twist, inner, q, p = unknowns[:5]
    return Model(
        grid,
        theta=theta,
        twist=twist,
        inner=inner,
        q=q,
        p=p,
        stiffness=stiffness,
        moment=moment,
        torsional_stiffness=ca.repmat(inputs["torsional_stiffness"], 1, pieces),
        natural=natural,
        present=present,
        lengths=lengths,
        gaps=gap @ where,
        transmission=transmission,
        held=held,
        place=inputs.get("place", ()),
        along=along,
    )
