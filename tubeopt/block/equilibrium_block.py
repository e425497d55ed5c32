"""The equilibrium of a tube robot as a block of a nonlinear program that its user composes.

Every piece of the arm is the same function of the rotations and torsions where it begins, of the rotations at its
points, of the pose where it begins, and of the cross-section: lifted into unknowns, so that every derivative is local
and IPOPT has exact sparse Hessians. Joint values and dimensions of the tubes are numbers or expressions.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ..arguments import typed
from ..errors import InputError, SolveError, choice, undoubted
from ..robots.assembly import DIMENSIONS, dimensions_of, order_of
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ..robots.robot import Robot, is_general
from ..typing import Array
from .certificate import add_certificate, add_margin
from .composed import CLOSED, JOINTS, ComposedBlock
from .given import LENGTHS, assembly_at, numbers_at, symbolic
from .guess import InitialEquilibrium, N, Shape, fields_of, points_of, sample, shape_at_start
from .transcription.chain import OF_TUBE, chain_of, remade, tubes_at
from .transcription.external_load import arm_of
from .transcription.model import Layout, Model, gap_names, layout, may_swap, numbers_of, sides, swapped
from .violation import Violation, violations_of, worst

# --- From the solution of a program back to an equilibrium ------------------------------------------------------------

AGREEMENT = 1e-6
"""Largest difference of the tip between block and equilibrium, over the length of the arm."""

MISSED = 5e-5
"""Tolerance on a required margin: the accuracy of margins close to 1."""

CERTAIN = 1e-7
"""Tolerance on a required certificate: that of the nonlinear program."""


def confirmed(block: ComposedBlock[N], value: Callable[[Any], Any]) -> N:
    """The verified equilibrium of a block at the numbers that `value` gives to its expressions."""
    numbers = {name: np.array(value(part)).ravel() for name, part in block.dimensions.items()}
    robot = rebuilt(block.robot, numbers)
    rotations, translations = (np.array(value(part)).ravel() for part in (block.rotations, block.translations))
    translations = np.minimum(translations, numbers["straight_length"])
    model = block.model.at(value)
    result = _solved_again(block, (robot, rotations, translations), model)
    tip = np.array(value(block.tip_position)).ravel()
    apart = float(np.linalg.norm(tip - result.tip_position))
    if apart > AGREEMENT * float(result.arm.arc_length[-1]):
        raise SolveError(
            f"the tip of the program is {1e3 * apart:.2g} mm from that of the equilibrium: "
            "the mesh is too coarse (increase refinement), or the program was not solved",
            result,
        )
    for _, floor in block.margins:
        least = float(np.array(value(floor)).item())
        if result.margin < least - MISSED:
            raise SolveError(
                f"the margin is {result.margin:.4g}; it must be at least {least:.4g}: the "
                "program has left the branch where its margin constraint is valid; start it "
                "closer to its solution",
                result,
            )
    for bound in block.bounds:
        least, value_there = float(np.array(value(bound.floor)).item()), bound.value(model, block.chain)
        if value_there < least - CERTAIN:
            raise SolveError(
                f"the {bound.words} is {value_there:.4g}; it must be at least {least:.4g}: "
                "the program has left the branch of the largest eigenvalue; start it closer "
                "to its solution",
                result,
            )
    return result


def _solved_again(block: ComposedBlock[N], at: tuple[Robot, Array, Array], model: Model) -> N:
    """On a mesh of its own, verified by re-integration."""
    curvature_at = None if block.load is None else lambda s: sample(model, s)[2]
    initial = block.initial.at(*at, lambda s: sample(model, s)[0], load=block.load, curvature_at=curvature_at)
    return initial.verified()


@undoubted()
def rebuilt(robot: Robot, numbers: dict[str, Any]) -> Robot:
    """The robot with other DIMENSIONS of its tubes, (n,) each.

    A stiffness other than that of tube and material is a given one: diameters and material stay.
    """
    if is_general(robot):
        return _of_pieces(robot, numbers)
    inputs = dimensions_of(robot.tubes)
    if all(np.array_equal(numbers[name], inputs[name]) for name in DIMENSIONS):
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


@undoubted()
def _of_pieces(robot: Robot, numbers: dict[str, Any]) -> Robot:
    assert isinstance(robot, ConcentricRobot)
    own = {**dimensions_of(robot.tubes), **chain_of(robot.tubes).start}
    same = all(np.array_equal(numbers[name], own[name]) for name in own if name != "curvature")
    return robot if same else replace(robot, tubes=tubes_at(robot.tubes, numbers))


# --- Jacobian of the tip ----------------------------------------------------------------------------------------------

# The Jacobian of a block's tip inside of the program: derivatives of its unknowns, lifted into unknowns too.


def add_jacobian(block: ComposedBlock[Any], wrt: Sequence[str]) -> Any:
    """(3, Q) derivative of the tip's position: F_x dx + F_a da = 0 for every input a, with dx as unknowns."""
    names, inputs = (wrt,) if isinstance(wrt, str) else tuple(wrt), (*JOINTS, *block.dimensions)
    # What follows from the pieces of a tube is no input of its own.
    own = [name for name in inputs if block.chain is None or name not in (*OF_TUBE.values(), "curved_length")]
    for name in names:
        choice("wrt", name, own)
    if not names:
        raise InputError(f"wrt is empty; it must have at least one of {', '.join(own)}")
    seeds = {name: np.concatenate([_seed(block, name, other) for other in names], axis=1) for name in inputs}
    equations, scale, labels = _equations(block)
    count = seeds["rotations"].shape[1]
    sizes = [rows * columns for rows, columns in block.shapes.values()]
    unit = np.concatenate([np.full(size, typical) for size, typical in zip(sizes, block.typical, strict=True)])
    per = np.concatenate([np.full(_columns(block, name).shape[1], 1 / _typical(block, name)) for name in names])
    total = np.outer(unit, per)
    begin = answers_of(block, equations, seeds)
    tag = block.label + "answer to the inputs"
    flat = block.program.variable(tag, total.size, scale=total.ravel(order="F"), guess=begin)
    block.answers.append((flat, equations, seeds))
    lifted = ca.reshape(flat, len(unit), count)
    where = [ca.vertcat(*block.columns), *_parameters(block)]
    change = [lifted, *(ca.DM(seed) for seed in seeds.values()), ca.DM.zeros(where[-1].shape[0], count)]
    out = equations(*where)
    residual, tip = equations.forward(count)(*where, *out, *change)
    entries = [f"answer to input {q + 1}: {word}" for q in range(count) for word in labels]
    size = np.outer(scale, per).ravel(order="F")
    block.demand("equations of the answer to the inputs", ca.vec(residual), upper=0.0, scale=size, entries=entries)
    return tip


def _columns(block: ComposedBlock[Any], name: str) -> Any:
    """(N, ...) how the N numbers of an input change with those that are free of each other: tubes of one segment are
    equal and move together, but turn alone, and so does every piece of a tube."""
    count = block.begin_numbers[name].size
    if name == "rotations" or count != block.robot.n_tubes:
        return np.eye(count)
    return np.array([[float(i in tubes) for tubes in block.robot.moving_together] for i in range(count)])


def _seed(block: ComposedBlock[Any], name: str, column: str) -> Any:
    """(N, ...) how the input `name` changes with each of `column`."""
    own, size = _columns(block, column), block.begin_numbers[name].size
    if (name, column) == ("curved_length", "piece_length") and block.chain is not None:
        return (np.arange(size)[:, None] == block.chain.owner).astype(float)
    return own if name == column else np.zeros((size, own.shape[1]))


def _typical(block: ComposedBlock[Any], name: str) -> float:
    """A typical size of an input, by which its derivatives are scaled."""
    if name == "rotations":
        return 1.0
    if name in LENGTHS:
        return block.reach
    return float(np.abs(block.begin_numbers[name]).max()) or 1 / block.reach


def _parameters(block: ComposedBlock[Any]) -> list[Any]:
    """What the equations of a block depend on beside its unknowns: joints first."""
    numbers = block.numbers if block.numbers is not None else ca.DM(block.layout.numbers())
    return [block.rotations, block.translations, *block.dimensions.values(), numbers]


def _equations(block: ComposedBlock[Any]) -> tuple[ca.Function, Any, list[str]]:
    """(unknowns, parameters...) -> (equations, tip position), with sizes and words of the equations."""
    rows = [size[0] * size[1] for size in block.shapes.values()]
    x = ca.MX.sym("x", sum(rows))
    parts = ca.vertsplit(x, np.cumsum([0, *rows]).tolist())
    n = block.robot.n_tubes
    names = [*JOINTS, *block.dimensions]
    symbols = {name: ca.MX.sym(name, n if name in JOINTS else block.dimensions[name].numel()) for name in names}
    numbers = ca.MX.sym("layout", len(block.layout.numbers()))
    unknowns = block.matrices(parts)
    model = arm_of(block.model.grid, numbers_of(block.layout, numbers), unknowns, {**symbols, **block.fittings})
    table = model.equations(symbols["rotations"], block.reach)
    scale = np.concatenate([np.full(each.expression.numel(), each.scale) for each in table])
    labels = [word for each in table for word in each.entries]
    outputs = [ca.vertcat(*(each.expression for each in table)), model.pose_ends[1][:, -1]]
    return ca.Function("equations", [x, *symbols.values(), numbers], outputs), scale, labels


def answers_of(block: ComposedBlock[Any], equations: ca.Function, seeds: dict[str, Any]) -> Any:
    """The lifted derivatives where the solve begins, by columns."""
    x, count = block.begin_column, seeds["rotations"].shape[1]
    numbers = [block.begin_numbers[name] for name in (*JOINTS, *block.dimensions)]
    where = [x, *numbers, block.layout.numbers()]
    out, zero = equations(*where), np.zeros((len(where[-1]), count))
    forced = equations.forward(count)(*where, *out, np.zeros((len(x), count)), *seeds.values(), zero)[0]
    slope = equations.jacobian()(*where, *out)[0]
    return -np.linalg.solve(np.array(slope), np.array(forced)).ravel(order="F")


class OrderWarning(UserWarning):
    """A solution at which breakpoints meet: behind the meeting another order of them may be better."""


@typed
class EquilibriumBlock(ComposedBlock[N]):
    """One equilibrium of a robot in a nonlinear program.

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
        >>> near = tubeopt.forward_kinematics(robot, [0.0, 1.0])
        >>> opti = casadi.Opti()
        >>> turn = opti.variable(2)
        >>> block = tubeopt.EquilibriumBlock(opti, near, rotations=turn)
        >>> opti.set_initial(turn, near.rotations)
        >>> opti.minimize(casadi.sumsqr(turn - near.rotations))
        >>> opti.subject_to(block.tip_position[0] == near.tip_position[0] + 1e-3)
        >>> opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
        >>> found = block.equilibrium(opti.solve())
        >>> round(1e3 * (found.tip_position[0] - near.tip_position[0]), 6)
        1.0
    """

    # --- demands ------------------------------------------------------------------------------------------------------

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
        tried = hasattr(solution, "multipliers") and self.pressing(solution) is None
        for text in () if tried else self.meetings(solution):
            better = "another order may be better: Problem.solve tries it, with casadi.Opti ask block.reorder"
            warnings.warn(f"{text}; {better}", OrderWarning, stacklevel=2)
        return confirmed(self, solution.value)

    def violations(self, solution: Any, *, tolerance: float = 1e-8, count: int = 5) -> tuple[Violation, ...]:
        """Constraints of this block that a solution violates by more than `tolerance` of their scale, worst first.

        At most `count` of them. After a failed solve of `casadi.Opti` pass `opti.debug`.
        """
        result: list[Violation] = []
        for name, expression, upper, scale in self._checked:
            labels = self._words[name]
            values = np.array(solution.value(expression)).ravel(order="F")
            result += violations_of(labels, values, (np.zeros(len(labels)), upper), scale, tolerance)
        return worst(result, count)

    def meetings(self, solution: Any) -> list[str]:
        """Names of the free breakpoints that meet at a solution."""
        return [f"{gap_names(self.layout.order)[row]}, and they meet" for row in self.closed(solution)]

    def closed(self, solution: Any) -> list[int]:
        """Rows of the gaps between breakpoints that are closed at a solution and may be opened in the other order."""
        if not self._moving:
            return []
        gaps = np.array(solution.value(self.model.gaps)).ravel()
        rows = np.flatnonzero(np.abs(gaps) < CLOSED * self.reach).tolist()
        shifted, stretched = self._given.free("translations"), self._given.free("curved_length", "piece_length")
        free = [shifted or (stretched and any(p.end or p.joint for p in sides(self.layout.order, row))) for row in rows]
        return [row for row, moves in zip(rows, free, strict=True) if moves and may_swap(self.layout.order, row)]

    def pressing(self, solution: Any) -> int | None:
        """The row of the gaps that is closed and presses most at a solution with multipliers, None where none does."""
        rows = self.closed(solution)
        if not rows:
            return None
        # In the scale of the solver: at a strict optimum a multiplier is large where its gap is small.
        gaps = solution.value(self.model.gaps) / self.reach
        forces = solution.multipliers[f"{self.label}order of breakpoints"] * self.reach
        pressed = [row for row in rows if abs(forces[row]) > max(abs(gaps[row]), 1e-7)]
        return max(pressed, key=lambda row: float(abs(forces[row])), default=None)

    def reorder(self, solution: Any, row: int | None = None) -> None:
        """Let breakpoints that meet at a solution change places, and start the next solve there.

        Only numbers of the program change. With `casadi.Opti` the start of your own variables is set by
        `opti.set_initial(solution.value_variables())` before.

        Args:
            row: of `closed`; None is the first of them.

        Raises:
            InputError: breakpoints do not meet there, or the block has too few pieces for the new order.
        """
        rows = self.closed(solution)
        if not rows or (row is not None and row not in rows):
            raise InputError("no breakpoints meet there that could change places")
        solved = self.model.at(solution.value)
        numbers = {key: np.array(solution.value(part)).ravel() for key, part in self._given.values.items()}
        order = swapped(self.layout.order, rows[0] if row is None else row)
        self.restore(layout(assembly_at(self.robot, self._bundle, numbers), order, pieces=self.layout.n_pieces))
        begin = self._start_model(numbers)
        start, inside = points_of(begin)
        floors = [float(np.array(solution.value(margin)).item()) for _, margin in self.margins]
        if self.load is not None:
            shape = shape_at_start(confirmed(self, solution.value), begin)
        else:
            shape = (*sample(solved, start)[:2], sample(solved, inside)[0])
        self._begin_with(begin, shape, floors)

    def start(self, equilibrium: InitialEquilibrium) -> None:
        """Start the next solve at another equilibrium of the robot; its dimensions may differ.

        Set the start of your own variables yourself.

        Raises:
            InputError: an order of breakpoints that the block cannot take.
        """
        numbers = numbers_at(equilibrium, self._given.chain)
        if self._moving:
            bundle = assembly_at(self.robot, self._bundle, numbers)
            order = order_of(bundle, self.robot.moving_together, side=self._side)
            if not order.front:
                raise InputError("no tube is in front of the base plate; an arm without length has no equilibrium")
            self.restore(layout(bundle, order, pieces=self.layout.n_pieces))
        begin = self._start_model(numbers)
        floors = [equilibrium.margin - 0.1 if symbolic(m) else float(m) for _, m in self.margins]
        self._begin_with(begin, shape_at_start(equilibrium, begin), floors)

    def start_at(self, value: Callable[[Any], Any]) -> None:
        """Start the next solve at the equilibrium of the numbers that `value` gives to joint values and dimensions.

        Raises:
            InputError: no tube has these dimensions, or breakpoints an order that the block cannot take.
            SolveError: there is no stable equilibrium.
        """
        numbers = {key: np.array(value(part)).ravel() for key, part in self._given.values.items()}
        robot = rebuilt(self.robot, numbers)
        self.start(self.initial.at(robot, numbers["rotations"], numbers["translations"], load=self.load))

    def owns(self, name: str) -> bool:
        """True if the variable with this name belongs to the block."""
        return bool(self.label) and name.startswith(self.label)

    def _begin_with(self, begin: Model, shape: Shape, floors: Sequence[float]) -> None:
        """Start all that the block has added to the program at these numbers."""
        self._set_guess(begin, shape)
        for (columns, _), floor in zip(self.margins, floors, strict=True):
            for column, value in zip(columns, fields_of(self.begin, min(floor, 0.9)), strict=True):
                self.program.set_guess(column, value)
        for bound in self.bounds:
            bound.start(self)
        for flat, equations, seeds in self.answers:
            self.program.set_guess(flat, answers_of(self, equations, seeds))

    def restore(self, laid: Layout) -> None:
        """Lay the pieces as in a layout that the block had."""
        self.layout = laid
        self.program.set_value(self.numbers, laid.numbers())
        name = self.label + "order of breakpoints"
        labels = [self.label + entry for entry in gap_names(laid.order)]
        self.program.rename(name, labels)
        self._words[name] = labels
