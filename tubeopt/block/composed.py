"""The unknowns and equations of one equilibrium in a program, and expressions of its arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from .guess import N, StartValues, poses_of, start_values
from .inputs import LENGTHS, assembly_at, block_inputs, block_load
from .transcription import external_load, functions
from .transcription.collocated import Grid
from .transcription.model import FREE_REFINEMENT, Layout, Model, layout, layout_numbers, order_labels, unknowns_of
from .transcription.program import Program

# --- Program to which a block is added --------------------------------------------------------------------------------


class OptiProgram:
    """A `casadi.Opti` as a `Program`; names are dropped, since Opti has none."""

    def __init__(self, opti: ca.Opti) -> None:
        self.opti = opti

    def variable(self, name: str, size: int = 1, *, guess: ArrayLike = 0.0, scale: ArrayLike = 1.0) -> Any:
        """Column of unknowns in their own units; Opti solves for them divided by `scale`."""
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
        """Constrain 0 <= expression <= upper, all divided by `scale`."""
        high, factor = (np.broadcast_to(np.asarray(v, dtype=float), (expression.numel(),)) for v in (upper, scale))
        scaled = ca.vec(expression) / ca.DM(factor)
        self.opti.subject_to(self.opti.bounded(0.0, scaled, high / factor) if high.any() else scaled == 0)

    def parameter(self, name: str, value: ArrayLike) -> Any:
        """Column of numbers that may be changed between solves."""
        numbers = np.asarray(value, dtype=float).ravel()
        symbol = self.opti.parameter(len(numbers))
        self.opti.set_value(symbol, numbers)
        return symbol

    def set_value(self, parameter: Any, value: ArrayLike) -> None:
        """Set the value of a parameter."""
        self.opti.set_value(parameter, np.asarray(value, dtype=float).ravel())

    def set_guess(self, variable: Any, value: ArrayLike) -> None:
        """Set the start value of a variable."""
        if variable.numel():
            self.opti.set_initial(variable, ca.DM(np.broadcast_to(np.asarray(value, dtype=float), (variable.numel(),))))

    def rename(self, name: str, entries: Sequence[str]) -> None:
        """Do nothing: Opti has no names."""

    def enter(self, block: Any) -> str:
        """Return no name: Opti has no list of blocks."""
        return ""


def as_program(opti: Any) -> Program:
    """A `casadi.Opti` or `tubeopt.Problem` as a `Program`; raises InputError for anything else."""
    if isinstance(opti, ca.Opti):
        return OptiProgram(opti)
    if all(hasattr(opti, name) for name in ("variable", "subject_to", "parameter", "enter")):
        return opti  # type: ignore[no-any-return]
    raise InputError(f"opti is a {type(opti).__name__}; it must be a casadi.Opti or a tubeopt.Problem")


POINT = 1e-12
"""Length (m) below which an element is a point."""

CLOSED = 1e-6
"""Distance of breakpoints, relative to the length of the arm, below which they meet."""

JOINTS = ("rotations", "translations")


@dataclass(eq=False)
class _Constraint:
    """Constraint 0 <= expression <= upper, row by row."""

    expression: Any
    upper: Array
    scale: Array
    labels: list[str]


class ComposedBlock(Generic[N]):
    """An arm in a program; `EquilibriumBlock` documents arguments and attributes."""

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
        self._inputs = block_inputs(initial, rotations, translations, tubes or {})
        self.rotations, self.translations = (self._inputs.values[key] for key in ("rotations", "translations"))
        self.dimensions = {key: part for key, part in self._inputs.values.items() if key not in JOINTS}
        self._set_up(initial.load if load is None else load)
        self._side, self.layout = side, self._lay_out(side, refinement)
        # Length of the arm at the start, m: lengths and torsions are scaled by it.
        self.reach = max(float(self.layout.length.sum(0) @ where_of(self._bundle)), 1e-3)
        default = self.program.enter(self)
        self.name = name or default
        # Prefix of the names of its variables and constraints.
        self.label = f"{self.name}: " if self.name else ""
        self._constraints: dict[str, _Constraint] = {}
        # `MarginBound`, `CertificateBound`, `TipSensitivities` of each such expression; they start anew with the block.
        self.margins: list[Any] = []
        self.bounds: list[Any] = []
        self.jacobians: list[Any] = []
        self._add_unknowns()
        self._add_equations()

    def _set_up(self, load: Load | None) -> None:
        """Set all quantities that are independent of the sections of the arm."""
        self._bundle = assembly_at(self.robot, self.robot.assembly(self.initial.translations), self._inputs.start)
        self.chain, self.load = self._inputs.chain, load
        modelled = block_load(self.initial, self._bundle, load)
        self._grid = Grid(
            self.robot.n_tubes,
            eccentric=self._bundle.eccentric,
            detail=self.chain.detail if self.chain is not None else 0,
            loaded=modelled is not None,
        )
        # Inputs of `arm_of` besides joint values and dimensions.
        self.constants: dict[str, Any] = {"offsets": self._bundle.offsets, "chain": self.chain, "load": modelled}
        self._moving = self._inputs.free(*LENGTHS)
        self._fixed = not self._inputs.free("translations", *self.dimensions)

    def _lay_out(self, side: int, refinement: int | None) -> Layout:
        if side not in (-1, 1):
            raise InputError(f"side is {side}; it must be -1 (behind the plate) or 1 (in front of it)")
        if refinement is not None and refinement < 0:
            raise InputError(f"refinement is {refinement}; it must be at least 0")
        default = 0 if self._fixed and self.load is None else FREE_REFINEMENT
        halvings = default if refinement is None else refinement
        order = order_of(self._bundle, self.robot.moving_together, side=side)
        if not order.front:
            raise InputError("no tube is in front of the base plate; an arm without length has no equilibrium")
        # If breakpoints may change places, each of them may come in front of the plate and end a section there.
        min_elements = len(order.front) + len(order.behind) if self._moving else 0
        return layout(self._bundle, order, refinement=halvings, min_elements=min_elements)

    def _add_unknowns(self) -> None:
        """Add the unknowns of the arm as columns, and build its model from them."""
        reach, load = self.reach, self.constants["load"]
        bending = 1.0 if load is None else load.stiffness / reach
        scale = {"torsion": 1 / reach, "position": reach, "bending moment": bending, "bending moment inside": bending}
        self.shapes = unknowns_of(self._grid, self.layout.n_elements)
        # Typical size of every unknown of the arm.
        self.typical = [scale.get(name, 1.0) for name in self.shapes]
        self.columns = [
            self.program.variable(self.label + name, rows * columns, scale=typical)
            for (name, (rows, columns)), typical in zip(self.shapes.items(), self.typical, strict=True)
        ]
        self.numbers = None
        if self._moving:
            self.numbers = self.program.parameter(self.label + "layout", self.layout.numbers())
        unknowns = self.matrices(self.columns)
        values = {**self._inputs.values, **self.constants}
        self.model = external_load.arm_of(self._grid, layout_numbers(self.layout, self.numbers), unknowns, values)
        initial = self._start_model(self._inputs.start)
        self._set_guess(initial, start_values(self.initial, initial))

    def matrices(self, columns: Sequence[Any]) -> tuple[Any, ...]:
        """Unknowns of the arm as matrices, from their columns."""
        return tuple(ca.reshape(each, *shape) for each, shape in zip(columns, self.shapes.values(), strict=True))

    def _start_model(self, numbers: Mapping[str, Array]) -> Model:
        """Model of the arm at numeric joint values and dimensions, with all unknowns 0."""
        self.initial_numbers = dict(numbers)
        values = {**{key: ca.DM(value) for key, value in numbers.items()}, **self.constants}
        zero = tuple(ca.DM.zeros(*shape) for shape in self.shapes.values())
        return external_load.arm_of(self._grid, layout_numbers(self.layout), zero, values).at(lambda part: part)

    def _set_guess(self, model: Model, start: StartValues) -> None:
        """Set the start values of the unknowns, on the elements of `model`."""
        theta, twist, inner, moments = start
        numbers: dict[str, Any] = {"theta": theta, "twist": twist, "inner": inner}
        if moments:
            numbers["moment_start"], numbers["moment_inside"] = moments
        model = replace(model, **numbers)
        flat = [np.asarray(value).ravel(order="F") for value in (theta, twist, inner, *poses_of(model), *moments)]
        for column, value in zip(self.columns, flat, strict=True):
            self.program.set_guess(column, value)
        self.initial_model, self.initial_column = model, np.concatenate(flat)

    def demand(
        self,
        name: str,
        expression: Any,
        *,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] = (),
    ) -> None:
        """Constrain 0 <= expression <= upper in the program; `violations` checks it again.

        Args:
            scale: typical size of the expression.
            entries: names of its rows; by default the name itself.
        """
        name, labels = self.label + name, [self.label + entry for entry in (entries or (name,))]
        self.program.subject_to(name, expression, upper=upper, scale=scale, entries=labels)
        high, size = (np.broadcast_to(v, expression.numel()).astype(float) for v in (upper, scale))
        self._constraints[name] = _Constraint(expression, high, size, labels)

    def _add_equations(self) -> None:
        model, reach = self.model, self.reach
        for each in model.equations(self.rotations, reach):
            self.demand(each.name, each.expression, upper=0.0, scale=each.scale, entries=each.entries)
        q, p = model.pose_ends
        self.tip_position, self.tip_rotation = p[:, -1], rotation_matrix(q[:, -1])
        self.tip_rotations = model.ends.theta[:, -1]
        if model.along is not None:
            # Tubes made of pieces: theta is the elastic rotation, to which the natural turn is added.
            start, last = [part[:, -1] for part in model.poses], model.n_elements - 1
            self.tip_rotations += functions.inside_function(self._grid)(*start, 1.0, *model.element(last))[5]
        self.energy, self.length = model.energy, ca.sum1(model.lengths)
        if self._moving:
            self.demand("order of breakpoints", model.distances, scale=reach, entries=order_labels(self.layout.order))
        if self._inputs.free("translations", "straight_length"):
            labels = [f"tube {i + 1} is not pulled out of its actuator" for i in range(self.robot.n_tubes)]
            self.demand("transmissions", model.clamp_distance, scale=reach, entries=labels)
        if not self._moving:
            distances = self.layout.distance @ where_of(self._bundle)
            if distances.min(initial=0.0) < -CLOSED * reach:
                label = order_labels(self.layout.order)[int(np.argmin(distances))]
                raise InputError(f"{label}: violated at the joint values and dimensions that were passed")

    # --- expressions of the arm ---------------------------------------------------------------------------------------

    def position(self, fraction: float) -> Any:
        """Position (3,), m, at a fraction of the arm's length in front of the plate: 0 the plate, 1 the tip."""
        return self.tip_position if fraction == 1.0 else self._inside(fraction)[1]

    def orientation(self, fraction: float) -> Any:
        """Bishop frame (3, 3) at a fraction of the arm's length."""
        return rotation_matrix(self._inside(fraction)[0])

    def curvature(self, fraction: float) -> Any:
        """Curvature (2,) of the arm in its Bishop frame, 1/m, at a fraction of its length."""
        return self._inside(fraction)[4]

    def rotation(self, fraction: float) -> Any:
        """Rotations theta (n,) of the tubes, rad, at a fraction of the arm's length."""
        _, _, theta, _, _, *natural = self._inside(fraction)
        return theta + natural[0] if natural else theta

    def torsion(self, fraction: float) -> Any:
        """Torsion (n,) of the tubes per length of each tube, rad/m, at a fraction of the arm's length."""
        _, _, _, w, _, *natural = self._inside(fraction)
        return natural[2] * w + natural[1] if natural else w

    def _inside(self, fraction: float) -> list[Any]:
        """Outputs of `inside_function` at a fraction of the arm's length: q, p, theta, w, u, ..."""
        if not 0 <= fraction <= 1:
            raise InputError(f"fraction is {fraction:g}; it must be from 0 (base plate) to 1 (tip)")
        model, elements = self.model, self.model.n_elements
        inside = functions.inside_function(model.grid)
        if not self._moving:
            # Lengths are numbers, so the element at this fraction is known.
            length = np.array(ca.DM(model.lengths)).ravel()
            ends = np.cumsum(length)
            k = min(int(np.searchsorted(ends, fraction * ends[-1])), elements - 1)
            while length[k] <= POINT and k + 1 < elements:
                k += 1
            x = (fraction * ends[-1] - (ends[k] - length[k])) / length[k]
            q, p = model.poses
            return list(inside(q[:, k], p[:, k], x, *model.element(k)))
        # Lengths are unknown: the element is selected by weights that are 0 or 1.
        start = ca.cumsum(model.lengths) - model.lengths
        s = fraction * self.length
        travelled = ca.fmin(ca.fmax(s - start, 0), model.lengths)
        x = travelled / ca.if_else(model.lengths > POINT, model.lengths, 1.0)
        # The last element that begins before s, but none without length.
        entered = ca.logic_and(start <= s, model.lengths > POINT)
        selected, weights = ca.DM.zeros(1), []
        for k in reversed(range(elements)):
            weights.append(ca.logic_and(entered[k], ca.logic_not(selected)))
            selected = ca.logic_or(selected, entered[k])
        weight = ca.vertcat(*reversed(weights))
        n, degree = self.robot.n_tubes, model.grid.degree
        inner = ca.reshape(model.inner, n * degree, elements)
        tables = [*model.poses, x.T, model.theta, model.twist, inner, *model.data]
        element = [table @ weight for table in tables]
        element[5] = ca.reshape(element[5], n, degree)
        return list(inside(*element))

    def strain(self, tube: int) -> Any:
        """Bending strain (points,) r |u - u*| / (1 - r |u*|) at the surface of a tube, at the collocation points.

        Tube 0 is the innermost. If lengths are free, the strain is 0 at points beyond the end of the tube.
        """
        if tube not in range(self.robot.n_tubes):
            raise InputError(f"tube is {tube}; the robot has tubes 0 to {self.robot.n_tubes - 1}")
        model, degree = self.model, self.model.grid.degree
        bend, natural = (part[tube, :] for part in model.mapped("bend")(*model.arguments, model.natural))
        radius = self.robot.tubes[tube].outer_diameter / 2
        present = ca.reshape(ca.repmat(model.present[tube, :], degree, 1), 1, -1)
        strain = ca.vec(present * surface_strain(radius, bend, natural))
        if self._moving:
            return strain
        return strain[np.flatnonzero(np.repeat(self.layout.present[tube], degree)).tolist()]

    def points(self) -> Any:
        """Shape points (3, m) of the arm, m: four per element, the tip last."""
        return self.model.mapped("positions")(*self.model.poses, *self.model.arguments)

    def clearance(self, body: Any) -> Any:
        """Distance (m,) of the arm's surface from a body at its shape points, m.

        A constraint `>= 0` is valid at these points only; `verify_trajectory` proves clearance between them.

        Args:
            body: one of `tubeopt.bodies`, or an object with `distance(x, y, z)` in arithmetic that CasADi evaluates.
        """
        if not hasattr(body, "distance"):
            raise InputError(f"body is {body!r}; it must be one of tubeopt.bodies, or have distance(x, y, z)")
        points = self.points()
        radii = np.array([tube.outer_diameter / 2 for tube in self.robot.tubes]) + self._bundle.offset
        radius: Any = ca.DM.zeros(1, self.model.n_elements)
        for i, tube_radius in enumerate(radii.tolist()):
            radius = ca.fmax(radius, tube_radius * self.model.present[i, :])
        per_element = points.shape[1] // self.model.n_elements
        x, y, z = (ca.SX.sym(axis) for axis in "xyz")
        function = ca.Function("distance", [x, y, z], [body.distance(x, y, z)]).map(points.shape[1])
        distance = function(points[0, :], points[1, :], points[2, :])
        return ca.vec(distance - ca.reshape(ca.repmat(radius, per_element, 1), 1, -1))
