"""The unknowns and equations of one equilibrium in a program, to which demands may be added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Generic

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..physics.shape import rotation_matrix
from ..physics.strain import surface_strain
from ..robots.assembly import order_of, where_of
from ..robots.load import Load
from ..typing import Array
from .given import LENGTHS, assembly_at, given_of, push_of
from .guess import N, Shape, columns_of, poses_of, shape_at_start
from .transcription import external_load, functions
from .transcription.collocated import Grid
from .transcription.model import FREE_REFINEMENT, Layout, Model, gap_names, layout, numbers_of, unknowns_of
from .transcription.program import Program

# --- Program to which a block is added --------------------------------------------------------------------------------

# The program to which a block is added: a `casadi.Opti`, or a `tubeopt.Problem`.


class OptiProgram:
    """A `casadi.Opti` as a Program. Names are not kept, since Opti has none."""

    def __init__(self, opti: ca.Opti) -> None:
        self.opti = opti

    def variable(self, name: str, size: int = 1, *, guess: ArrayLike = 0.0, scale: ArrayLike = 1.0) -> Any:
        """A column of unknowns, in its own units; Opti is given it over its scale."""
        factor = ca.DM(np.broadcast_to(np.asarray(scale, dtype=float), (size,)))
        column = self.opti.variable(size) * factor
        self.set_guess(column, guess)
        return column

    def subject_to(
        self,
        name: str,
        expression: Any,
        *,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] | None = None,
    ) -> None:
        """Demand 0 <= expression <= upper, divided by their scale."""
        high, factor = (np.broadcast_to(np.asarray(v, dtype=float), (expression.numel(),)) for v in (upper, scale))
        scaled = ca.vec(expression) / ca.DM(factor)
        self.opti.subject_to(self.opti.bounded(0.0, scaled, high / factor) if high.any() else scaled == 0)

    def parameter(self, name: str, value: ArrayLike) -> Any:
        """Numbers that may be changed."""
        numbers = np.asarray(value, dtype=float).ravel()
        symbol = self.opti.parameter(len(numbers))
        self.opti.set_value(symbol, numbers)
        return symbol

    def set_value(self, parameter: Any, value: ArrayLike) -> None:
        """Give a parameter other numbers."""
        self.opti.set_value(parameter, np.asarray(value, dtype=float).ravel())

    def set_guess(self, variable: Any, value: ArrayLike) -> None:
        """Start there; Opti solves for the variable behind the scale."""
        if variable.numel():
            self.opti.set_initial(variable, ca.DM(np.broadcast_to(np.asarray(value, dtype=float), (variable.numel(),))))

    def rename(self, name: str, entries: Sequence[str]) -> None:
        """Opti keeps no names."""

    def enter(self, block: Any) -> str:
        """Opti keeps no list of blocks."""
        return ""


def as_program(opti: Any) -> Program:
    """The Program behind a `casadi.Opti` or a `tubeopt.Problem`."""
    if isinstance(opti, ca.Opti):
        return OptiProgram(opti)
    if all(hasattr(opti, name) for name in ("variable", "subject_to", "parameter", "enter")):
        return opti  # type: ignore[no-any-return]
    raise InputError(f"opti is a {type(opti).__name__}; it must be a casadi.Opti or a tubeopt.Problem")


POINT = 1e-12
"""A piece shorter than this (m) is a point."""

CLOSED = 1e-6
"""Breakpoints closer than this part of the arm's length meet."""

JOINTS = ("rotations", "translations")

STATE = ("theta", "twist", "inner", "bend", "bent")
"""What of a model an equilibrium tells, the last two under load."""


class ComposedBlock(Generic[N]):
    """An arm in a program; see `EquilibriumBlock` for what it is given and tells."""

    def __init__(  # noqa: PLR0913
        self,
        opti: Any,
        initial: N,
        *,
        rotations: Any = None,
        translations: Any = None,
        tubes: Mapping[str, Any] | None = None,
        load: Load | None = None,
        side: int = -1,
        refinement: int | None = None,
        name: str = "",
    ) -> None:
        if not hasattr(initial, "robot"):
            raise InputError(
                f"initial is a {type(initial).__name__}; it must be an Equilibrium, solved by forward_kinematics"
            )
        self.initial, self.robot, self.program = initial, initial.robot, as_program(opti)
        self._given = given_of(initial, rotations, translations, tubes or {})
        self.rotations, self.translations = (self._given.values[key] for key in ("rotations", "translations"))
        self.dimensions = {key: part for key, part in self._given.values.items() if key not in JOINTS}
        self._set_up(initial.load if load is None else load)
        self._side, self.layout = side, self._lay_out(side, refinement)
        # Length of the arm where the solve begins, m: what everything is scaled by.
        self.reach = max(float(self.layout.length.sum(0) @ where_of(self._bundle)), 1e-3)
        called = self.program.enter(self)
        self.name = name or called
        # With which the names of all that it adds begin.
        self.label = f"{self.name}: " if self.name else ""
        self._words: dict[str, list[str]] = {}
        self._checked: list[tuple[Any, ...]] = []
        # Unknowns of every margin that is demanded, and how much it is.
        self.margins: list[tuple[tuple[Any, ...], Any]] = []
        # Certificates under force that are demanded.
        self.bounds: list[Any] = []
        # Unknowns of every Jacobian, its equations, and its seeds.
        self.answers: list[tuple[Any, Any, dict[str, Any]]] = []
        self._add_unknowns()
        self._add_equations()

    def _set_up(self, load: Load | None) -> None:
        """What is known of the arm before its sections are."""
        self._bundle = assembly_at(self.robot, self.robot.assembly(self.initial.translations), self._given.start)
        self.chain, self.load = self._given.chain, load
        push = push_of(self.initial, self._bundle, load)
        self._grid = Grid(
            self.robot.n_tubes,
            eccentric=self._bundle.eccentric,
            detail=self.chain.detail if self.chain is not None else 0,
            loaded=push is not None,
        )
        # What `model_of` needs beside joint values and dimensions.
        self.fittings: dict[str, Any] = {"place": self._bundle.place, "chain": self.chain, "push": push}
        self._moving = self._given.free(*LENGTHS)
        self._fixed = not self._given.free("translations", *self.dimensions)

    def _lay_out(self, side: int, refinement: int | None) -> Layout:
        if side not in (-1, 1):
            raise InputError(f"side is {side}; it must be -1 (behind the plate) or 1 (in front of it)")
        if refinement is not None and refinement < 0:
            raise InputError(f"refinement is {refinement}; it must be at least 0")
        usual = 0 if self._fixed and self.load is None else FREE_REFINEMENT
        halvings = usual if refinement is None else refinement
        order = order_of(self._bundle, self.robot.moving_together, side=side)
        if not order.front:
            raise InputError("no tube is in front of the base plate; an arm without length has no equilibrium")
        # Where breakpoints may change places every one of them may come to the front.
        least = len(order.front) + len(order.behind) if self._moving else 0
        return layout(self._bundle, order, refinement=halvings, least=least)

    def _add_unknowns(self) -> None:
        """Unknowns in columns, and the arm that they make."""
        reach, push = self.reach, self.fittings["push"]
        bending = 1.0 if push is None else push.typical / reach
        scale = {"torsion": 1 / reach, "position": reach, "bending moment": bending, "bending moment inside": bending}
        self.shapes = unknowns_of(self._grid, self.layout.n_pieces)
        # What every unknown of the arm typically is.
        self.typical = [scale.get(name, 1.0) for name in self.shapes]
        self.columns = [
            self.program.variable(self.label + name, rows * columns, scale=typical)
            for (name, (rows, columns)), typical in zip(self.shapes.items(), self.typical, strict=True)
        ]
        self.numbers = None
        if self._moving:
            self.numbers = self.program.parameter(self.label + "layout", self.layout.numbers())
        unknowns = self.matrices(self.columns)
        values = {**self._given.values, **self.fittings}
        self.model = external_load.arm_of(self._grid, numbers_of(self.layout, self.numbers), unknowns, values)
        begin = self._start_model(self._given.start)
        self._set_guess(begin, shape_at_start(self.initial, begin))

    def matrices(self, columns: Sequence[Any]) -> tuple[Any, ...]:
        """The unknowns of the arm as matrices."""
        return tuple(ca.reshape(each, *shape) for each, shape in zip(columns, self.shapes.values(), strict=True))

    def _start_model(self, numbers: Mapping[str, Array]) -> Model:
        """The arm at joint values and dimensions in numbers, its unknowns nought."""
        self.begin_numbers = dict(numbers)
        values = {**{key: ca.DM(value) for key, value in numbers.items()}, **self.fittings}
        zero = tuple(ca.DM.zeros(*shape) for shape in self.shapes.values())
        return external_load.arm_of(self._grid, numbers_of(self.layout), zero, values).at(lambda part: part)

    def _set_guess(self, model: Model, shape: Shape) -> None:
        """Start from these rotations and torsions on the pieces of `model`."""
        bending = [shape[3], columns_of(shape[4], model.n_pieces)] if len(shape) > 3 else []
        numbers: dict[str, Any] = dict(zip(STATE, (*shape[:3], *bending), strict=False))
        model = replace(model, **numbers)
        flat = [np.asarray(value).ravel(order="F") for value in (*shape[:3], *poses_of(model), *bending)]
        for column, value in zip(self.columns, flat, strict=True):
            self.program.set_guess(column, value)
        self.begin, self.begin_column = model, np.concatenate(flat)

    def demand(
        self,
        name: str,
        expression: Any,
        *,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] = (),
    ) -> None:
        """Demand 0 <= expression <= upper of the program, in words of the block: `entries` for its rows.

        What does not hold of it `violations` tells, whatever the program; `scale` is its typical size.
        """
        name, labels = self.label + name, [self.label + entry for entry in (entries or (name,))]
        self.program.subject_to(name, expression, upper=upper, scale=scale, entries=labels)
        size = expression.numel()
        self._words[name] = labels
        self._checked.append((name, expression, *(np.broadcast_to(v, size).astype(float) for v in (upper, scale))))

    def _add_equations(self) -> None:
        model, reach = self.model, self.reach
        for each in model.equations(self.rotations, reach):
            self.demand(each.name, each.expression, upper=0.0, scale=each.scale, entries=each.entries)
        q, p = model.pose_ends
        self.tip_position, self.tip_rotation = p[:, -1], rotation_matrix(q[:, -1])
        self.tip_rotations = model.ends[1][:, -1] + self._natural_turn()
        self.energy, self.length = model.energy, ca.sum1(model.lengths)
        if self._moving:
            self.demand("order of breakpoints", model.gaps, scale=reach, entries=gap_names(self.layout.order))
        if self._given.free("translations", "straight_length"):
            held = [f"tube {i + 1} is not pulled out of its actuator" for i in range(self.robot.n_tubes)]
            self.demand("transmissions", model.held, scale=reach, entries=held)
        if not self._moving:
            gaps = self.layout.gap @ where_of(self._bundle)
            if gaps.min(initial=0.0) < -CLOSED * reach:
                raise InputError(f"{gap_names(self.layout.order)[int(np.argmin(gaps))]}, at the numbers given")

    # --- what it tells of its arm ------------------------------------------------------------------------------------

    def position(self, fraction: float) -> Any:
        """(3,) position, m, at a fraction of the arm's length in front of the plate: 0 the plate, 1 the tip."""
        return self.tip_position if fraction == 1.0 else self._inside(fraction)[1]

    def orientation(self, fraction: float) -> Any:
        """(3, 3) Bishop frame at a fraction of the arm's length."""
        return rotation_matrix(self._inside(fraction)[0])

    def curvature(self, fraction: float) -> Any:
        """(2,) curvature of the arm in its Bishop frame, 1/m, at a fraction of its length."""
        return self._inside(fraction)[4]

    def rotation(self, fraction: float) -> Any:
        """(n,) rotations theta_i of the tubes, rad, at a fraction of the arm's length."""
        _, _, theta, _, _, *natural = self._inside(fraction)
        return theta + natural[0] if natural else theta

    def torsion(self, fraction: float) -> Any:
        """(n,) torsion of the tubes per length of each, rad/m, at a fraction of the arm's length."""
        _, _, _, w, _, *natural = self._inside(fraction)
        return natural[2] * w + natural[1] if natural else w

    def _inside(self, fraction: float) -> list[Any]:
        """q, p, theta, w and u at a fraction of the arm's length."""
        if not 0 <= fraction <= 1:
            raise InputError(f"fraction is {fraction:g}; it must be from 0 (base plate) to 1 (tip)")
        return self._where_it_is(fraction) if self._moving else self._in_piece(fraction)

    def _in_piece(self, fraction: float) -> list[Any]:
        """In the piece that is known to hold it, since no length is free."""
        length = np.array(ca.DM(self.model.lengths)).ravel()
        behind = np.cumsum(length)
        k = min(int(np.searchsorted(behind, fraction * behind[-1])), len(length) - 1)
        while length[k] <= POINT and k + 1 < len(length):
            k += 1
        x = (fraction * behind[-1] - (behind[k] - length[k])) / length[k]
        q, p = self.model.poses
        return list(functions.inside_function(self.model.grid)(q[:, k], p[:, k], x, *self.model.piece(k)))

    def _where_it_is(self, fraction: float) -> list[Any]:
        """In the piece that holds it at the lengths of the moment, which is picked out of all."""
        model, pieces = self.model, self.model.n_pieces
        behind = ca.cumsum(model.lengths)
        start = behind - model.lengths
        s = fraction * self.length
        there = ca.fmin(ca.fmax(s - start, 0), model.lengths)
        x = there / ca.if_else(model.lengths > POINT, model.lengths, 1.0)
        # The last piece that begins before it, but none without length.
        begun = ca.logic_and(start <= s, model.lengths > POINT)
        later = ca.DM.zeros(1)
        picked = []
        for k in reversed(range(pieces)):
            picked.append(ca.logic_and(begun[k], ca.logic_not(later)))
            later = ca.logic_or(later, begun[k])
        weight = ca.vertcat(*reversed(picked))
        n, degree = self.robot.n_tubes, model.grid.degree
        every = [*model.poses, x.T, model.theta, model.twist, ca.reshape(model.inner, n * degree, pieces), *model.data]
        one = [part @ weight for part in every]
        one[5] = ca.reshape(one[5], n, degree)
        return list(functions.inside_function(model.grid)(*one))

    def _natural_turn(self) -> Any:
        """Of tubes made of pieces where the arm ends, rad."""
        if self.model.along is None:
            return 0.0
        q, p = self.model.poses
        last = self.model.n_pieces - 1
        return functions.inside_function(self.model.grid)(q[:, last], p[:, last], 1.0, *self.model.piece(last))[5]

    def strain(self, tube: int) -> Any:
        """(points,) bending strain r |u - u*| / (1 - r |u*|) at the surface of a tube (0 is the innermost), at the
        collocation points; where lengths are free, 0 where the tube is not."""
        if tube not in range(self.robot.n_tubes):
            raise InputError(f"tube is {tube}; the robot has tubes 0 to {self.robot.n_tubes - 1}")
        model, degree = self.model, self.model.grid.degree
        bend, natural = (part[tube, :] for part in model.mapped("bend")(*model.arguments, model.natural))
        radius = self.robot.tubes[tube].outer_diameter / 2
        there = ca.reshape(ca.repmat(model.present[tube, :], degree, 1), 1, -1)
        strain = ca.vec(there * surface_strain(radius, bend, natural))
        if self._moving:
            return strain
        kept = np.flatnonzero(np.repeat(self.layout.present[tube], degree)).tolist()
        return strain[kept]

    def points(self) -> Any:
        """(3, m) shape points of the arm, four per piece, the tip last, m."""
        return self.model.mapped("places")(*self.model.poses, *self.model.arguments)

    def clearance(self, body: Any) -> Any:
        """(m,) distance of the arm's surface from a body at its shape points, m: at least 0 keeps them apart there.

        `body` is any of `tubeopt.bodies`, or whatever has `distance(x, y, z)` written with arithmetic alone. Between
        the points nothing is known: `verify_trajectory` proves clearance.
        """
        if not hasattr(body, "distance"):
            raise InputError(f"body is {body!r}; it must be one of tubeopt.bodies, or have distance(x, y, z)")
        places = self.points()
        thick = np.array([tube.outer_diameter / 2 for tube in self.robot.tubes]) + self._bundle.offset
        radius: Any = ca.DM.zeros(1, self.model.n_pieces)
        for i, own in enumerate(thick.tolist()):
            radius = ca.fmax(radius, own * self.model.present[i, :])
        each = places.shape[1] // self.model.n_pieces
        x, y, z = (ca.SX.sym(axis) for axis in "xyz")
        far = ca.Function("distance", [x, y, z], [body.distance(x, y, z)]).map(places.shape[1])
        distance = far(places[0, :], places[1, :], places[2, :])
        return ca.vec(distance - ca.reshape(ca.repmat(radius, each, 1), 1, -1))
