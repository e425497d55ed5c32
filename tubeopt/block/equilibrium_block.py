"""The equilibrium of a tube robot as a block of a nonlinear program that its user composes.

Every piece of the arm is the same function of rotations, torsions and pose where it begins, of the rotations at its
collocation points, and of its cross-section. These are lifted into unknowns, so that every derivative is local and
IPOPT has exact sparse Hessians. Joint values and dimensions of the tubes are numbers or expressions.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..arguments import typed
from ..errors import InputError, SolveError, choice, without_unit_warnings
from ..robots.assembly import DIMENSIONS, dimensions_of, order_of
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.robot import Robot, is_general
from ..typing import Array
from .certificate import add_certificate, add_margin
from .composed import CLOSED, JOINTS, ComposedBlock
from .guess import InitialEquilibrium, N, StartValues, collocation_points, jacobi_fields, sample, start_values
from .inputs import LENGTHS, assembly_at, numbers_at, symbolic
from .transcription.chain import OF_TUBE, chain_of, remade, tubes_at
from .transcription.external_load import arm_of
from .transcription.model import (
    Equation,
    Layout,
    Model,
    layout,
    layout_numbers,
    may_swap,
    neighbours,
    order_labels,
    swapped,
)
from .transcription.program import Violation, violations_of, worst

# --- From the solution of a program back to an equilibrium ------------------------------------------------------------

TIP_TOLERANCE = 1e-6
"""Largest difference of the tip between block and equilibrium, relative to the length of the arm."""

MARGIN_TOLERANCE = 5e-5
"""Tolerance on a required margin: the accuracy of margins close to 1."""

CERTIFICATE_TOLERANCE = 1e-7
"""Tolerance on a required certificate: that of the nonlinear program."""


def verified_equilibrium(block: ComposedBlock[N], value: Callable[[Any], Any]) -> N:
    """Equilibrium of a block at a solution, solved again on its own mesh and verified by re-integration.

    Args:
        value: evaluates an expression of the block at the solution of the program.

    Raises:
        SolveError: the tip differs from that of the block, or a required margin or certificate is not reached.
    """
    numbers = {name: np.array(value(part)).ravel() for name, part in block.dimensions.items()}
    robot = rebuilt(block.robot, numbers)
    rotations, translations = (np.array(value(part)).ravel() for part in (block.rotations, block.translations))
    translations = np.minimum(translations, numbers["straight_length"])
    model = block.model.at(value)
    curvature_at = None if block.load is None else lambda s: sample(model, s).curvature
    result = block.initial.at(
        robot,
        rotations,
        translations,
        lambda s: sample(model, s).rotation,
        load=block.load,
        curvature_at=curvature_at,
    ).verified()
    tip = np.array(value(block.tip_position)).ravel()
    difference = float(np.linalg.norm(tip - result.tip_position))
    if difference > TIP_TOLERANCE * float(result.arm.arc_length[-1]):
        raise SolveError(
            f"the tip of the program is {1e3 * difference:.2g} mm from that of the equilibrium: "
            "the mesh is too coarse (increase refinement), or the program was not solved",
            result,
        )
    for bound in block.margins:
        min_margin = float(np.array(value(bound.min_margin)).item())
        if result.margin < min_margin - MARGIN_TOLERANCE:
            raise SolveError(
                f"the margin is {result.margin:.4g}; it must be at least {min_margin:.4g}: the "
                "program has left the branch where its margin constraint is valid; start it "
                "closer to its solution",
                result,
            )
    for bound in block.bounds:
        min_margin, certificate = float(np.array(value(bound.min_margin)).item()), bound.value(model, block.chain)
        if certificate < min_margin - CERTIFICATE_TOLERANCE:
            raise SolveError(
                f"the {bound.name} is {certificate:.4g}; it must be at least {min_margin:.4g}: "
                "the program has left the branch of the largest eigenvalue; start it closer "
                "to its solution",
                result,
            )
    return result


@without_unit_warnings()
def rebuilt(robot: Robot, numbers: dict[str, Any]) -> Robot:
    """A robot with other DIMENSIONS of its tubes, (n,) each, or PIECES.

    Diameters and material do not change; a stiffness that does not follow from them is stored with the tube.
    """
    current = dimensions_of(robot.tubes)
    if is_general(robot):
        assert isinstance(robot, ConcentricRobot)
        current |= chain_of(robot.tubes).start
        # The curvature of a tube made of pieces is only its largest.
        same = all(np.array_equal(numbers[name], current[name]) for name in current if name != "curvature")
        return robot if same else replace(robot, tubes=tubes_at(robot.tubes, numbers))
    if all(np.array_equal(numbers[name], current[name]) for name in DIMENSIONS):
        return robot
    tubes = tuple(
        remade(tube, **{name: float(numbers[name][i]) for name in DIMENSIONS}) for i, tube in enumerate(robot.tubes)
    )
    if isinstance(robot, ConcentricRobot):
        return replace(robot, tubes=tubes)
    if isinstance(robot, SegmentedEccentricRobot):
        return replace(robot, segments=tubes[::3])
    assert isinstance(robot, EccentricRobot)
    straight = tubes[0].straight_length - robot.transmission_length
    if straight >= 0:
        return replace(robot, tube=replace(tubes[0], straight_length=straight))
    return replace(robot, tube=tubes[0], transmission_length=0.0)


# --- Jacobian of the tip ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TipSensitivities:
    """Linear equations F_x dx + F_a da = 0 of a block, whose sensitivities dx are unknowns of the program."""

    unknown: Any
    """Sensitivities dx (X Q,) of all X unknowns by Q inputs, by columns."""
    equations: ca.Function
    """Function (unknowns, joints, dimensions, layout) -> equations F, tip position."""
    seeds: dict[str, Array]
    """Changes da (N, Q) of every input by name."""

    def start(self, block: ComposedBlock[Any]) -> Array:
        """Sensitivities dx (X Q,) at the start of the block."""
        x, count = block.initial_column, self.seeds["rotations"].shape[1]
        numbers = [block.initial_numbers[name] for name in (*JOINTS, *block.dimensions)]
        at = [x, *numbers, block.layout.numbers()]
        out, zero = self.equations(*at), np.zeros((len(at[-1]), count))
        forced = self.equations.forward(count)(*at, *out, np.zeros((len(x), count)), *self.seeds.values(), zero)[0]
        slope = self.equations.jacobian()(*at, *out)[0]
        return np.asarray(-np.linalg.solve(np.array(slope), np.array(forced)).ravel(order="F"))


def add_jacobian(block: ComposedBlock[Any], wrt: Sequence[str]) -> Any:
    """Derivative (3, Q) of the tip's position by Q inputs; adds the sensitivities of the arm as unknowns."""
    names, inputs = (wrt,) if isinstance(wrt, str) else tuple(wrt), (*JOINTS, *block.dimensions)
    # Dimensions that follow from the pieces of a tube are no independent inputs.
    independent = [name for name in inputs if block.chain is None or name not in (*OF_TUBE.values(), "curved_length")]
    for name in names:
        choice("wrt", name, independent)
    if not names:
        raise InputError(f"wrt is empty; it must have at least one of {', '.join(independent)}")
    seeds = {name: np.concatenate([_seed(block, name, column) for column in names], axis=1) for name in inputs}
    equations, table = _equations(block)
    count = seeds["rotations"].shape[1]
    sizes = [rows * columns for rows, columns in block.shapes.values()]
    unit = np.concatenate([np.full(size, typical) for size, typical in zip(sizes, block.typical, strict=True)])
    per = np.concatenate([np.full(_columns(block, name).shape[1], 1 / _typical(block, name)) for name in names])
    total = np.outer(unit, per)
    flat = block.program.variable(block.label + "sensitivities", total.size, scale=total.ravel(order="F"))
    jacobian = TipSensitivities(flat, equations, seeds)
    block.program.set_guess(flat, jacobian.start(block))
    block.jacobians.append(jacobian)
    # The layout is a parameter; it changes with no input.
    layout_column = block.numbers if block.numbers is not None else ca.DM(block.layout.numbers())
    at = [ca.vertcat(*block.columns), block.rotations, block.translations, *block.dimensions.values(), layout_column]
    change = [ca.reshape(flat, len(unit), count), *(ca.DM(seed) for seed in seeds.values())]
    change.append(ca.DM.zeros(layout_column.shape[0], count))
    out = equations(*at)
    residual, tip = equations.forward(count)(*at, *out, *change)
    labels = [
        f"sensitivity to input {q + 1}: {label}" for q in range(count) for each in table for label in each.entries
    ]
    scale = np.concatenate([np.full(each.expression.numel(), each.scale) for each in table])
    size = np.outer(scale, per).ravel(order="F")
    block.demand("equations of the sensitivities", ca.vec(residual), upper=0.0, scale=size, entries=labels)
    return tip


def _columns(block: ComposedBlock[Any], name: str) -> Array:
    """Change (N, Q) of the N numbers of an input with its independent entries.

    Tubes of one segment are equal and move together, but turn independently; so do the pieces of a tube.
    """
    count = block.initial_numbers[name].size
    if name == "rotations" or count != block.robot.n_tubes:
        return np.eye(count)
    return np.array([[float(i in tubes) for tubes in block.robot.moving_together] for i in range(count)])


def _seed(block: ComposedBlock[Any], name: str, column: str) -> Array:
    """Change (N, Q) of the input `name` with each entry of the input `column`."""
    entries, size = _columns(block, column), block.initial_numbers[name].size
    if (name, column) == ("curved_length", "piece_length") and block.chain is not None:
        return np.asarray(np.arange(size)[:, None] == block.chain.owner, dtype=float)
    return entries if name == column else np.zeros((size, entries.shape[1]))


def _typical(block: ComposedBlock[Any], name: str) -> float:
    """Typical size of an input, which scales its derivatives."""
    if name == "rotations":
        return 1.0
    if name in LENGTHS:
        return block.reach
    return float(np.abs(block.initial_numbers[name]).max()) or 1 / block.reach


def _equations(block: ComposedBlock[Any]) -> tuple[ca.Function, list[Equation]]:
    """Function (unknowns, joints, dimensions, layout) -> (equations, tip position), and the table of the equations."""
    sizes = [rows * columns for rows, columns in block.shapes.values()]
    x = ca.MX.sym("x", sum(sizes))
    n = block.robot.n_tubes
    names = [*JOINTS, *block.dimensions]
    symbols = {name: ca.MX.sym(name, n if name in JOINTS else block.dimensions[name].numel()) for name in names}
    numbers = ca.MX.sym("layout", len(block.layout.numbers()))
    unknowns = block.matrices(ca.vertsplit(x, np.cumsum([0, *sizes]).tolist()))
    model = arm_of(block.model.grid, layout_numbers(block.layout, numbers), unknowns, {**symbols, **block.constants})
    table = model.equations(symbols["rotations"], block.reach)
    outputs = [ca.vertcat(*(each.expression for each in table)), model.pose_ends[1][:, -1]]
    return ca.Function("equations", [x, *symbols.values(), numbers], outputs), table


class OrderWarning(UserWarning):
    """Warning that breakpoints coincide at a solution, so that another order of them may be better."""


@typed
class EquilibriumBlock(ComposedBlock[N]):
    """Equilibrium of a robot in a nonlinear program.

    Args:
        opti: a `casadi.Opti` or a `tubeopt.Problem`; receives the unknowns and equations.
        initial: a solved equilibrium of the robot; the start, and the order of the breakpoints.
        rotations, translations: (n,) rad and m, numbers or expressions of the program; None keeps those of `initial`.
            Tubes of one segment move together and share one entry of an expression for their translation.
        tubes: dimensions of the tubes by name, (n,) each, numbers or expressions: any of `curvature`,
            `straight_length`, `curved_length`, `bending_stiffness`, `torsional_stiffness`. Omitted dimensions stay. For
            tubes made of pieces they scale the whole tube; PIECES (`block.transcription.chain`) may be named too, one
            entry per piece: `piece_length`, `piece_curvature`, `piece_plane`, `piece_twist`, `piece_bending_factor`,
            `piece_torsion_factor`.
        load: external load on concentric tubes: force and moment at the tip, weight, a constant force per length; None
            takes that of `initial`. Moments and follower loads have no energy, so no margin.
        side: direction in which a transition at the plate may move: -1 behind the plate, 1 in front.
        refinement: number of times that the mesh is halved; None halves it once if lengths, curvatures or stiffnesses
            are free.
        name: name of the block in messages.

    Attributes:
        chain: the pieces of tubes made of pieces, else None.
        tip_position (3,) m, tip_rotation (3, 3): pose of the tip in the plate frame.
        tip_rotations: (n,) rad, theta of the tubes at the end of the arm.
        energy: elastic energy, J.  length: arc length of the arm in front of the plate, m.
        rotations, translations, dimensions: as passed, or taken from `initial`.

    Raises:
        InputError: an unknown name, a vector of the wrong length, or breakpoints in another order than those of the
            numbers in use.

    Example:
        >>> import casadi, tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> start = tubeopt.forward_kinematics(robot, [0.0, 1.0])
        >>> opti = casadi.Opti()
        >>> turn = opti.variable(2)
        >>> block = tubeopt.EquilibriumBlock(opti, start, rotations=turn)
        >>> opti.set_initial(turn, start.rotations)
        >>> opti.minimize(casadi.sumsqr(turn - start.rotations))
        >>> opti.subject_to(block.tip_position[0] == start.tip_position[0] + 1e-3)
        >>> opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
        >>> result = block.equilibrium(opti.solve())
        >>> round(1e3 * (result.tip_position[0] - start.tip_position[0]), 6)
        1.0
    """

    # --- constraints --------------------------------------------------------------------------------------------------

    def margin_at_least(self, margin: Any) -> None:
        """Constrain the stability margin to at least `margin`.

        A number or an expression below 1; a variable that is maximised is typical. The constraint is Jacobi's condition
        on softened tubes: its determinants are smooth where an eigenvalue is not. Eccentric robots use their own
        equations; a dead load includes the bending that it causes. `equilibrium` computes the margin itself, and
        reports a solution on another branch of the condition.

        Raises:
            InputError: a number that is not below 1, or a load without an energy.
        """
        add_margin(self, margin)

    def certificate_at_least(self, margin: Any, *, max_force: float = 0.0) -> None:
        """Constrain the snap-free certificate at these translations and dimensions to at least `margin`.

        A number or an expression below 1. With 0 the robot cannot snap at any rotations. Concentric robots only.

        `max_force` (N) selects the certificate under all dead forces on the tip up to that size: with 0 none of them
        can make the robot snap or buckle at any rotations. The eigenvalue and eigenfunction of that certificate become
        unknowns of the program; `equilibrium` computes the bound again.

        Raises:
            InputError: a number that is not below 1, a negative force, an eccentric robot, or a load other than a tip
                force within `max_force`. With a force also: tubes made of pieces. Without one: tubes that vary along
                their length other than by a natural twist.
        """
        add_certificate(self, margin, max_force)

    def jacobian(self, wrt: Sequence[str] = ("rotations", "translations")) -> Any:
        """(3, ...) derivative of the tip position with respect to joint values and dimensions, SI, as expressions.

        Columns: n for "rotations" and for each named dimension. Equal tubes of a segment and their "translations" have
        one column per segment; PIECES have one per piece.

        By the implicit function theorem: the sensitivities of the arm become unknowns of further linear equations.
        Where breakpoints meet it is the derivative in their present order.

        Raises:
            InputError: an unknown name.
        """
        return add_jacobian(self, wrt)

    # --- solutions ----------------------------------------------------------------------------------------------------

    def equilibrium(self, solution: Any) -> N:
        """The equilibrium of a solution, solved again on its own mesh and verified by adaptive re-integration.

        Args:
            solution: result of `casadi.Opti.solve` or `tubeopt.Problem.solve` (`casadi.Opti.debug` after a failed
                solve).

        Raises:
            SolveError: Newton's method leaves the solution, or a required margin is not reached. Or the tip differs by
                more than 1e-6 of the length: the mesh is too coarse, raise `refinement`.
            InputError: dimensions that are not those of a tube.

        Warns:
            OrderWarning: breakpoints meet at the solution, so another order may be better; `reorder` swaps them. A
                `Problem` swaps them by itself, and warns only if they still press on each other.
        """
        if not hasattr(solution, "value"):
            raise InputError(
                f"solution is a {type(solution).__name__}; it must be what casadi.Opti.solve or Problem.solve returned"
            )
        best_order = hasattr(solution, "multipliers") and self.pressing(solution) is None
        for text in () if best_order else self.meetings(solution):
            advice = "another order may be better: Problem.solve tries it, with casadi.Opti call block.reorder"
            warnings.warn(f"{text}; {advice}", OrderWarning, stacklevel=2)
        return verified_equilibrium(self, solution.value)

    def violations(self, solution: Any, *, tolerance: float = 1e-8, count: int = 5) -> tuple[Violation, ...]:
        """Constraints of this block that a solution violates by more than `tolerance` of their scale, worst first.

        At most `count` of them. After a failed solve of `casadi.Opti` pass `opti.debug`.
        """
        result: list[Violation] = []
        for each in self._constraints.values():
            values = np.array(solution.value(each.expression)).ravel(order="F")
            bounds = np.zeros(len(each.labels)), each.upper
            result += violations_of(each.labels, values, bounds, each.scale, tolerance)
        return worst(result, count)

    def meetings(self, solution: Any) -> list[str]:
        """Names of the free breakpoints that coincide at a solution."""
        labels = order_labels(self.layout.order)
        return [f"{labels[row]}, and they meet" for row in self.closed(solution)]

    def swappable(self) -> list[int]:
        """Rows of `Layout.distance` with breakpoints that may be swapped."""
        if not self._moving:
            return []
        order = self.layout.order
        shifted, stretched = self._inputs.free("translations"), self._inputs.free("curved_length", "piece_length")
        # Transitions move with the translations only; ends and joints also with the lengths.
        moves = [
            shifted or (stretched and any(p.end or p.joint for p in neighbours(order, row)))
            for row in range(len(order_labels(order)))
        ]
        return [row for row, free in enumerate(moves) if free and may_swap(order, row)]

    def closed(self, solution: Any) -> list[int]:
        """Rows of `Layout.distance` that are 0 at a solution, if their breakpoints may be swapped."""
        if not self._moving:
            return []
        distances = np.array(solution.value(self.model.distances)).ravel()
        return [row for row in self.swappable() if abs(distances[row]) < CLOSED * self.reach]

    def pressing(self, solution: Any, *, but: Collection[object] = ()) -> int | None:
        """Row of `closed` with the largest multiplier at a solution, None if no multiplier is active.

        Args:
            but: pairs of breakpoints, as `pair` gives them, that are left out.
        """
        rows = [row for row in self.closed(solution) if self.pair(row) not in but]
        if not rows:
            return None
        # In the scale of the solver: at a strict optimum a multiplier is large where its distance is small.
        distances = solution.value(self.model.distances) / self.reach
        forces = solution.multipliers[f"{self.label}order of breakpoints"] * self.reach
        pressed = [row for row in rows if abs(forces[row]) > max(abs(distances[row]), 1e-7)]
        return max(pressed, key=lambda row: float(abs(forces[row])), default=None)

    def pair(self, row: int) -> object:
        """Breakpoints at both ends of a row of distances, in both orders; a single one if the other end
        is the plate.
        """
        return self.name, frozenset(neighbours(self.layout.order, row))

    def reorder(self, solution: Any, rows: int | Sequence[int] | None = None) -> None:
        """Swap breakpoints that coincide at a solution, and start the next solve there.

        Only numbers of the program change. With `casadi.Opti` the start of your own variables is set by
        `opti.set_initial(solution.value_variables())` before.

        Args:
            rows: one or several of `closed`, or of `swappable` near a meeting; None is the first of `closed`. A pair
                that is not adjacent after the other swaps keeps its order.

        Raises:
            InputError: breakpoints do not meet there, or the block has too few elements for the new order.
        """
        chosen = self.closed(solution)[:1] if rows is None else list(np.atleast_1d(rows))
        if not chosen or (rows is not None and not set(chosen) <= set(self.swappable())):
            raise InputError("no breakpoints meet at this solution that can be swapped")
        solved = self.model.at(solution.value)
        numbers = {key: np.array(solution.value(part)).ravel() for key, part in self._inputs.values.items()}
        order, pairs = self.layout.order, [frozenset(neighbours(self.layout.order, row)) for row in chosen]
        while pairs:
            adjacent = {
                frozenset(neighbours(order, k)): k for k in range(len(order_labels(order))) if may_swap(order, k)
            }
            ready = [pair for pair in pairs if pair in adjacent]
            if not ready:
                break
            order = swapped(order, adjacent[ready[0]])
            pairs.remove(ready[0])
        self.restore(layout(assembly_at(self.robot, self._bundle, numbers), order, elements=self.layout.n_elements))
        model = self._start_model(numbers)
        min_margins = [float(np.array(solution.value(bound.min_margin)).item()) for bound in self.margins]
        if self.load is not None:
            values = start_values(verified_equilibrium(self, solution.value), model)
        else:
            start, inside = collocation_points(model)
            at_start = sample(solved, start)
            values = StartValues(at_start.rotation, at_start.torsion, sample(solved, inside).rotation)
        self._set_start(model, values, min_margins)

    def start(self, equilibrium: InitialEquilibrium) -> None:
        """Start the next solve at another equilibrium of the robot; its dimensions may differ.

        Set the start of your own variables yourself.

        Raises:
            InputError: an order of breakpoints that the block cannot take.
        """
        numbers = numbers_at(equilibrium, self._inputs.chain)
        if self._moving:
            bundle = assembly_at(self.robot, self._bundle, numbers)
            order = order_of(bundle, self.robot.moving_together, side=self._side)
            if not order.front:
                raise InputError("no tube is in front of the base plate; an arm without length has no equilibrium")
            self.restore(layout(bundle, order, elements=self.layout.n_elements))
        model = self._start_model(numbers)
        min_margins = [
            equilibrium.margin - 0.1 if symbolic(b.min_margin) else float(b.min_margin) for b in self.margins
        ]
        self._set_start(model, start_values(equilibrium, model), min_margins)

    def start_at(self, value: Callable[[Any], Any]) -> None:
        """Start the next solve at the equilibrium of given joint values and dimensions.

        Args:
            value: evaluates an expression of joint values or dimensions.

        Raises:
            InputError: no tube has these dimensions, or breakpoints an order that the block cannot take.
            SolveError: there is no stable equilibrium.
        """
        numbers = {key: np.array(value(part)).ravel() for key, part in self._inputs.values.items()}
        robot = rebuilt(self.robot, numbers)
        self.start(self.initial.at(robot, numbers["rotations"], numbers["translations"], load=self.load))

    def owns(self, name: str) -> bool:
        """True if the variable with this name belongs to the block."""
        return bool(self.label) and name.startswith(self.label)

    def _set_start(self, first: Model, values: StartValues, min_margins: Sequence[float]) -> None:
        """Set the start values of all unknowns of the block."""
        self._set_guess(first, values)
        for margin, min_margin in zip(self.margins, min_margins, strict=True):
            for column, value in zip(
                margin.fields, jacobi_fields(self.initial_model, min(min_margin, 0.9)), strict=True
            ):
                self.program.set_guess(column, value)
        for bound in self.bounds:
            bound.start(self)
        for jacobian in self.jacobians:
            self.program.set_guess(jacobian.unknown, jacobian.start(self))

    def restore(self, laid: Layout) -> None:
        """Set the layout of the elements to an earlier layout of the block."""
        self.layout = laid
        self.program.set_value(self.numbers, laid.numbers())
        name = self.label + "order of breakpoints"
        labels = [self.label + label for label in order_labels(laid.order)]
        self.program.rename(name, labels)
        self._constraints[name].labels = labels
