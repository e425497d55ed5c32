"""An arm in a program, all elements side by side: its equations as expressions, or its numbers at a solution.

Every element is the same function of its state at its start; these states are unknowns, so that all derivatives are
local. Boundary conditions are theta(0) = alpha + |beta| w(0) at the plate, and w = 0 at the tip for every tube: beyond
its end a tube has no moment, so that this is w = 0 at its own end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...robots.assembly import Assembly, Breakpoint, Order, arrange, has_curve, joints_of, tube_positions, where_of
from ...typing import Array
from . import functions
from .chain import columns, joints, panels, transmissions
from .collocated import Grid
from .mesh import element_counts

# --- Elements in the sections of an arm -------------------------------------------------------------------------------

# The elements of a block lie in the sections of an arm. Their lengths are linear in the positions of the breakpoints,
# and which tubes are present and curved on each are numbers too. A new order of the breakpoints changes these numbers
# only, so that one program serves every order.

FREE_REFINEMENT = 1
"""Number of times that elements are halved if lengths, curvatures or stiffnesses are free: they may grow in a solve."""


@dataclass(frozen=True, eq=False)
class Layout:
    """P elements of an arm with b breakpoints.

    Columns of `length` and `distance` are transitions and ends of n tubes, then joints of tubes made of pieces.
    """

    order: Order
    """Order of the breakpoints."""
    section: tuple[int, ...]
    """Section (P,) of each element."""
    length: Array
    """Coefficients (P, 2n) of breakpoint positions in the lengths of the elements."""
    distance: Array
    """Coefficients (b, 2n) of breakpoint positions in section lengths, then in distances behind the plate; all >= 0."""
    present: Array
    """1 where a tube is present on an element, else 0, (n, P)."""
    curved: Array
    """(n, P) 1 for a curved tube on an element, else 0; (B, P) panel of each tube for tubes made of pieces."""

    @property
    def n_elements(self) -> int:
        """Number of elements P."""
        return len(self.section)

    def numbers(self) -> Array:
        """Numbers that depend on the order, as one column: length, distance, present, curved, each by columns."""
        parts = (self.length, self.distance, self.present, self.curved)
        return np.concatenate([part.ravel(order="F") for part in parts])


def layout(
    assembly: Assembly, order: Order, *, elements: int | None = None, refinement: int = 0, min_elements: int = 0
) -> Layout:
    """Elements in every section, short enough for coupling and bend; sections without length get one element.

    Args:
        elements: total number of elements; None is the number needed, but at least `min_elements`.

    Raises:
        InputError: the order has more sections than `elements`.
    """
    positions = where_of(assembly)
    lengths = np.maximum(order.lengths(positions), 0.0)
    start = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    # The order may belong to other joint values: sections whose length would be negative have none.
    cut = replace(assembly, start=start, length=lengths, present=order.present, curved=order.curved)
    counts = element_counts(cut, refinement)
    if elements is not None:
        if elements < len(counts):
            raise InputError(f"the block has {elements} elements; the order of its breakpoints needs {len(counts)}")
        counts = _fit(counts, lengths, elements)
    elif counts.sum() < min_elements:
        counts = _fit(counts, lengths, min_elements)
    section = np.repeat(np.arange(len(counts)), counts)
    distance = _distance_rows(order, assembly.n_tubes, len(positions))
    curved = _selected_panels(order, assembly) if assembly.general else order.curved
    return Layout(
        order=order,
        section=tuple(section.tolist()),
        length=distance[: len(order.front)][section] / counts[section][:, None],
        distance=distance,
        present=order.present[section].T.astype(float),
        curved=curved[section].T.astype(float),
    )


def _selected_panels(order: Order, assembly: Assembly) -> Array:
    """(m, B) 1 for the panel of each tube that contains a section, else 0.

    B panels, tube by tube, the straight part first; beyond the end of a tube its last panel is selected.
    """
    counts = [1 + (len(joints) + 1) * has_curve(assembly, i) for i, joints in enumerate(joints_of(assembly))]
    out = np.zeros((len(order.front), sum(counts)))
    for i, first in enumerate(np.cumsum([0, *counts[:-1]]).tolist()):
        out[np.arange(len(out)), first + np.minimum(order.panel[:, i], counts[i] - 1)] = 1.0
    return out


def _fit(counts: NDArray[np.intp], lengths: Array, elements: int) -> NDArray[np.intp]:
    """Numbers of elements per section with the sum `elements`, chosen to minimise the longest element."""
    counts = counts.copy()
    while counts.sum() != elements:
        if counts.sum() < elements:
            counts[int(np.argmax(lengths / counts))] += 1
        else:
            # Remove an element from the section whose elements stay shortest; every section keeps one.
            shorter = np.where(counts > 1, lengths / np.maximum(counts - 1, 1), np.inf)
            counts[int(np.argmin(shorter))] -= 1
    return counts


def _distance_rows(order: Order, n: int, width: int) -> Array:
    """Coefficients (b, width) of `Layout.distance`."""
    rows = np.zeros((len(order.front) + len(order.behind), width))
    for k, point in enumerate(order.front):
        rows[k, point.index(n)] += 1.0
        if k:
            rows[k, order.front[k - 1].index(n)] -= 1.0
    for k, point in enumerate(order.behind, start=len(order.front)):
        # Behind the plate the arc length is negative.
        rows[k, point.index(n)] = -1.0
    return rows


def order_labels(order: Order) -> list[str]:
    """Names of the constraints that the rows of `Layout.distance` are >= 0."""
    names = []
    for k, point in enumerate(order.front):
        before = "the plate" if not k else str(order.front[k - 1])
        names.append(f"order of breakpoints: {point} is not before {before}")
    return names + [f"order of breakpoints: {point} is not in front of the plate" for point in order.behind]


def neighbours(order: Order, row: int) -> tuple[Breakpoint, ...]:
    """Breakpoints at both ends of a row of `Layout.distance`; one if the row is the distance from the plate."""
    front = len(order.front)
    if row >= front:
        return (order.behind[row - front],)
    return order.front[max(row - 1, 0) : row + 1]


def may_swap(order: Order, row: int) -> bool:
    """True if the breakpoint of a row of `Layout.distance` may be swapped with its neighbour, or with the plate.

    Breakpoints of one tube keep their order, and some tube stays in front of the plate.
    """
    front = len(order.front)
    if row >= front:
        return not any(order.behind[row - front].before(other) for other in order.behind)
    return not order.front[row - 1].before(order.front[row]) if row else front > 1


def swapped(order: Order, row: int) -> Order:
    """Order after the breakpoint of a row of `Layout.distance` is swapped with its neighbour, or with the plate."""
    front, behind = list(order.front), list(order.behind)
    if row >= len(front):
        front.insert(0, behind.pop(row - len(front)))
    elif row == 0:
        behind.append(front.pop(0))
    else:
        # Neighbours that meet are swapped without a jump: the section between them has no length.
        front[row - 1], front[row] = front[row], front[row - 1]
    return arrange(front, behind, order.present.shape[1])


@dataclass(frozen=True)
class Equation:
    """Equation expression == 0 of typical size `scale`, with a label for each entry."""

    name: str
    entries: tuple[str, ...]
    expression: Any
    scale: float


class ElementEnds(NamedTuple):
    """Torsion at the ends of P elements."""

    defect: Any
    """Defect (n, P K) of the collocated equations."""
    theta: Any
    """Rotations (n, P) where elements end, rad."""
    twist: Any
    """Torsion (n, P) where elements end, rad/m."""


@dataclass(frozen=True, eq=False)
class TorsionModel:
    """The torsion of P elements with K points and n tubes; expressions or arrays.

    theta, twist: rotations and torsion (n, P) where elements begin.  inner: theta (n, P K) at their points.
    stiffness, moment, torsional_stiffness: kb of the tubes present, m of the tubes curved, kt, (n, P).
    lengths: (P,) of elements.  transmission: |beta| (n,).  offsets: offset and angle (n,) of eccentric tubes, or ().
    along: coefficients (X, P) of tubes made of pieces, for which stiffness and moment are None; else None.
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
    offsets: tuple[Any, ...]
    along: Any

    @property
    def n_elements(self) -> int:
        """Number of elements P."""
        return int(self.theta.shape[1])

    @property
    def data(self) -> list[Any]:
        """Constants of all elements side by side, in the order of `Piece.data`."""
        if self.along is not None:
            return [self.torsional_stiffness, self.lengths.reshape((1, -1)), self.along]
        offsets = [ca.repmat(ca.vec(v), 1, self.n_elements) for v in self.offsets]
        return [self.stiffness, self.moment, self.torsional_stiffness, self.lengths.reshape((1, -1)), *offsets]

    @property
    def arguments(self) -> list[Any]:
        """Arguments of the functions of an element, all elements side by side."""
        return [self.theta, self.twist, self.inner, *self.data]

    def element(self, k: int) -> list[Any]:
        """Arguments of one element."""
        inner = self.inner[:, k * self.grid.degree : (k + 1) * self.grid.degree]
        return [self.theta[:, k], self.twist[:, k], inner, *(part[:, k] for part in self.data)]

    def mapped(self, name: str) -> ca.Function:
        """Function of `transcription.functions` for all elements at once."""
        return mapped(name, self.grid, self.n_elements)

    @cached_property
    def ends(self) -> ElementEnds:
        """Defects of the torsion, and theta and w where elements end."""
        return ElementEnds(*self.mapped("torsion")(*self.arguments))

    def softness(self, margin: Any) -> tuple[Any, ...]:
        """Coefficients of the Jacobi fields of tubes softened by `margin`, side by side for all points."""
        count, degree = self.n_elements, self.grid.degree
        data = [ca.horzcat(*(ca.repmat(part[:, k], 1, degree) for k in range(count))) for part in self.data]
        nodes = ca.DM(np.tile(self.grid.tableau.nodes, count)[None])
        # The torsion w enters through w dg/dtheta only, which is 0 on the centreline.
        twist = self.mapped("twist")(*self.arguments) if self.offsets else ca.DM.zeros(*self.inner.shape)
        function = mapped("softness", self.grid, count * degree)
        return tuple(function.call([ca.repmat(margin, 1, count * degree), self.inner, twist, nodes, *data]))

    @property
    def plate_compliance(self) -> Any:
        """Ratio (n,) of a Jacobi field to its rate at the plate: a transmission twists by |beta| w."""
        return self.transmission

    @property
    def energy(self) -> Any:
        """Elastic energy of the arm and of the transmissions, J."""
        arm = ca.sum2(self.mapped("energy")(*self.arguments))
        return arm + ca.dot(self.torsional_stiffness[:, 0] * self.transmission, self.twist[:, 0] ** 2) / 2

    def torsion_equations(self, rotations: Any, reach: float, sections: Sequence[int] | None = None) -> list[Equation]:
        """Equations of an equilibrium of tubes clamped at `rotations` (n,), rad.

        Args:
            reach: typical length, m.
            sections: section (P,) of each element, from 0, for labels; by default labels count elements.
        """
        defect, theta, twist = self.ends
        tubes = [f"tube {i + 1}" for i in range(self.theta.shape[0])]
        after, points = location_labels(self.n_elements, self.grid.degree, sections)
        # theta(0) = alpha + |beta| w(0), the straight part below the plate under constant torque.
        transmission_twist = self.transmission * self.twist[:, 0]
        return [
            equation("torsion equation", tubes, points, defect, 1.0),
            equation("continuity of rotation", tubes, after, self.theta[:, 1:] - theta[:, :-1], 1.0),
            equation("continuity of torsion", tubes, after, self.twist[:, 1:] - twist[:, :-1], 1 / reach),
            equation("base rotation", tubes, None, self.theta[:, 0] - rotations - transmission_twist, 1.0),
            equation("torsion at the end", tubes, None, twist[:, -1], 1 / reach),
        ]


@dataclass(frozen=True, eq=False)
class Model(TorsionModel):
    """An arm with its shape, and b breakpoints.

    q, p: quaternions (4, P - 1) and positions (3, P - 1) where all elements but the first begin.
    natural: precurvature (n, P); 0 for tubes made of pieces, whose precurvature is in `along`.
    present: 1 where a tube is present, (n, P).  distances: of breakpoints (b,), m, see `Layout.distance`.
    clamp_distance: distance (n,) of the clamps from the plate, m; `transmission` is that times kt and the mean of 1/kt.
    """

    q: Any
    p: Any
    natural: Any
    present: Any
    distances: Any
    clamp_distance: Any

    @property
    def poses(self) -> tuple[Any, Any]:
        """Quaternions (4, P) and positions (3, P) where elements begin."""
        return ca.horzcat(ca.DM([1, 0, 0, 0]), self.q), ca.horzcat(ca.DM.zeros(3), self.p)

    @cached_property
    def pose_ends(self) -> tuple[Any, Any]:
        """Quaternions (4, P) and positions (3, P) where elements end."""
        q, p = self.mapped("pose")(*self.poses, *self.arguments)
        return q, p

    def equations(self, rotations: Any, reach: float) -> list[Equation]:
        """Equations of torsion and shape, with `reach` as typical length, m."""
        q, p = self.pose_ends
        after, _ = location_labels(self.n_elements, self.grid.degree)
        return [
            *self.torsion_equations(rotations, reach),
            equation("continuity of orientation", list("wxyz"), after, self.q - q[:, :-1], 1.0),
            equation("continuity of position", list("xyz"), after, self.p - p[:, :-1], reach),
        ]

    def at(self, value: Callable[[Any], Any]) -> Model:
        """This arm in numbers; `value` evaluates its expressions."""
        names = [name for name in self.__dataclass_fields__ if name not in ("grid", "offsets", "bending_stiffness")]
        parts = {name: getattr(self, name) for name in names}
        present = {name: part for name, part in parts.items() if part is not None}
        # One expression: a function is built for each that is evaluated.
        column = np.array(value(ca.veccat(*present.values()))).ravel()
        stops = np.cumsum([np.prod(part.shape, dtype=int) for part in present.values()])[:-1]
        numbers: dict[str, Any] = dict.fromkeys(parts)
        for (name, part), values in zip(present.items(), np.split(column, stops), strict=True):
            numbers[name] = values.reshape(part.shape, order="F")
        for name in ("lengths", "distances", "transmission", "clamp_distance"):
            numbers[name] = numbers[name].ravel()
        return replace(self, **numbers)


def location_labels(elements: int, degree: int, sections: Sequence[int] | None = None) -> tuple[list[str], list[str]]:
    """Labels of the starts of all elements but the first, and of all points; by their `sections` if passed."""
    if sections is None:
        after = [f"after element {k + 1}" for k in range(elements - 1)]
        return after, [f"element {k + 1}, point {c + 1}" for k in range(elements) for c in range(degree)]
    rank = [k - list(sections).index(section) for k, section in enumerate(sections)]
    points = [
        f"section {section + 1}, point {rank[k] * degree + c + 1}"
        for k, section in enumerate(sections)
        for c in range(degree)
    ]
    return [f"section {section + 1}" for section in sections[1:]], points


def equation(name: str, rows: list[str], columns: list[str] | None, expression: Any, scale: float) -> Equation:
    """Equation that a matrix is 0, with labels by rows and columns; a single column needs no label."""
    tails = [""] if columns is None else [f", {column}" for column in columns]
    labels = tuple(f"{name}, {row}{tail}" for tail in tails for row in rows)
    return Equation(name, labels, ca.vec(expression), scale)


@lru_cache(maxsize=256)
def mapped(name: str, grid: Grid, elements: int) -> ca.Function:
    """Function of `transcription.functions`, by name, mapped over elements; arms share it and its derivatives."""
    function: ca.Function = getattr(functions, f"{name}_function")(grid)
    return side_by_side(function, elements) if function.is_a("SXFunction") else function.map(elements)


def side_by_side(function: ca.Function, count: int) -> ca.Function:
    """Function of `count` elements side by side, whose Jacobian is that of one element, in scalar operations, mapped.

    CasADi's own pass through all elements once for every unknown of one, which takes four times as long.
    """
    symbols, inputs, outputs = function.sx_in(), range(function.n_in()), range(function.n_out())
    whole = ca.jacobian(ca.veccat(*function.call(symbols)), ca.veccat(*symbols))
    rows, columns = (
        np.cumsum([0, *(size(k) for k in span)]).tolist()
        for size, span in ((function.numel_out, outputs), (function.numel_in, inputs))
    )
    parts = [part for row in ca.vertsplit(whole, rows) for part in ca.horzsplit(row, columns)]
    blocks = ca.Function("slopes", symbols, parts).map(count)
    x = [ca.MX.sym("x", function.size1_in(k), count * function.size2_in(k)) for k in inputs]
    y = [ca.MX.sym("y", function.size1_out(k), count * function.size2_out(k)) for k in outputs]
    sides = [ca.diagcat(*ca.horzsplit(part, part.shape[1] // count)) for part in cast("list[Any]", blocks.call(x))]
    # CasADi looks up derivatives by their names in the cache of a function before it makes them.
    name, of_x, of_y = f"elements_{function.name()}", [f"x{k}" for k in inputs], [f"y{k}" for k in outputs]
    names = [f"jac_{row}_{column}" for row in of_y for column in of_x]
    known = [*of_x, *(f"out_{row}" for row in of_y)]
    jacobian = ca.Function(f"jac_{name}", [*x, *y], sides, known, names, {"always_inline": True})
    # Forward derivatives are products with the Jacobian; backward ones are CasADi's own.
    options: dict[str, Any] = {"never_inline": True, "enable_forward": False, "jac_penalty": -1}
    options |= {"reverse_options": {"never_inline": True, "enable_forward": True}}
    values = function.map(count).call(x, True, False)
    return ca.Function(name, x, values, of_x, of_y, {**options, "cache": {jacobian.name(): jacobian}})


def unknowns_of(grid: Grid, elements: int) -> dict[str, tuple[int, int]]:
    """Shapes of the unknowns of an arm, by name; under load they include the bending moment."""
    n, degree = grid.n_tubes, grid.degree
    torsion = {"rotation": (n, elements), "torsion": (n, elements), "rotation inside": (n, elements * degree)}
    pose = {"orientation": (4, elements - 1), "position": (3, elements - 1)}
    bending = {"bending moment": (2, elements), "bending moment inside": (2 * degree, elements)}
    return {**torsion, **pose, **(bending if grid.loaded else {})}


class LayoutNumbers(NamedTuple):
    """Matrices of a `Layout`, as numbers or expressions."""

    length: Any
    distance: Any
    present: Any
    curved: Any


def layout_numbers(layout: Layout, column: Any = None) -> LayoutNumbers:
    """Matrices of a layout, as numbers, or as parts of `column`, a parameter with `Layout.numbers`."""
    parts = (layout.length, layout.distance, layout.present, layout.curved)
    if column is None:
        return LayoutNumbers(*(ca.DM(part) for part in parts))
    columns = ca.vertsplit(column, np.cumsum([0, *(part.size for part in parts)]).tolist())
    return LayoutNumbers(*(ca.reshape(each, *part.shape) for each, part in zip(columns, parts, strict=True)))


def model_of(grid: Grid, numbers: LayoutNumbers, unknowns: tuple[Any, ...], inputs: Mapping[str, Any]) -> Model:
    """Model of an arm at joint values and dimensions, with its unknowns as matrices in the order of `unknowns_of`.

    Args:
        inputs: joint values and dimensions by name, the `offsets` of eccentric tubes, and the `chain` of tubes made of
            pieces with their PIECES.
    """
    length, distance, present, curved = numbers
    clamped, transition, end = tube_positions(
        inputs["translations"], inputs["straight_length"], inputs["curved_length"]
    )
    chain, elements = inputs.get("chain"), present.shape[1]
    stiffness, moment, natural, along, transmission = None, None, ca.DM.zeros(present.shape), None, clamped
    if chain is None:
        positions = ca.vertcat(transition, end)
        lengths = length @ positions
        kb = ca.repmat(inputs["bending_stiffness"], 1, elements)
        # Masks are numbers, so the expression is the same for every order of breakpoints.
        natural = ca.repmat(inputs["curvature"], 1, elements) * curved
        stiffness, moment = kb * present, kb * natural
    else:
        laid = panels(chain, inputs)
        positions = ca.vertcat(transition, end, *joints(chain, laid, clamped))
        lengths = length @ positions
        transmission = transmissions(chain, laid, clamped, curved[:, 0], inputs["torsional_stiffness"])
        along = columns(chain, laid, curved, present, clamped, ca.vertcat(0, ca.cumsum(lengths)))
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
        torsional_stiffness=ca.repmat(inputs["torsional_stiffness"], 1, elements),
        natural=natural,
        present=present,
        lengths=lengths,
        distances=distance @ positions,
        transmission=transmission,
        clamp_distance=clamped,
        offsets=inputs.get("offsets", ()),
        along=along,
    )
