"""A design program at one vector of unknowns: rows of constraints, objective, violation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..block.quantities import Quantity
from ..errors import InputError, SolveError, without_unit_warnings
from ..robots.concentric import ConcentricRobot
from ..solvers.ipopt import Optimum
from ..solvers.time_limit import check_time
from ..typing import Array
from .constraints import Limit, Statement
from .objectives import AnyObjective, key_of
from .program import BOUNDED, Program, Reached, slack_name
from .state import FreePose, State
from .task import DesignTask, gaps_of, order_gaps

# Fraction of a step by which limits are kept inside: IPOPT satisfies constraints to 1e-8, and a design that is off by
# that would fail its verification.
HELD = 5e-8

# The same for joints and the order of tubes, in steps of 10 mm: 0.9 nm. Inverse kinematics and planning allow no more
# than round-off.
ORDERED = 9e-8

# Limits whose rows stay, though their derivative may be 0 for a while: where nothing softens.
POSED = ("margin in use", "certified margin")

# Tolerance (m) on the depth of the pose of reach_radius: an equation would leave IPOPT no interior.
DEPTH_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one group, >= 0 where the limit is kept, in units of `limit.size`."""

    requirement: int
    """Its number in the task."""
    part: int
    """Tells the groups of a requirement apart."""
    limit: Limit
    values: Array
    """(K,)."""
    jacobian: Array
    """(K, X)."""
    vector: tuple[Array, Array] | None = None
    """(K, 3) whose length is limited, and its change (K, 3, X), where it is such a limit: it leads least squares to 0
    from far away faster than its length does."""
    slack: tuple[float, int] | None = None
    """Steps by which the limit is eased, and their column."""
    always: bool = False
    """Whether the rows stay where no unknown moves them for a while."""


def rows_of(program: Program, state: State) -> list[Rows]:
    """All groups of rows that can be relaxed."""
    out = [group for number, stated in enumerate(program.stated) for group in stated_rows(stated, number, state)]
    # A limit on dimensions that are not free, and is kept, is no constraint.
    out = [one for one in out if one.always or one.jacobian.any() or one.values.min() < 0 or one.limit.words in POSED]
    return [_eased(state, group, k) for k, group in enumerate(out)] if program.elastic else out


def _eased(state: State, group: Rows, k: int) -> Rows:
    column = state.layout.column(slack_name(k))
    jacobian = group.jacobian.copy()
    # A slack moves every row of its group by the same number of steps.
    jacobian[:, column] += 1.0
    slack = float(state.x[column])
    return replace(group, values=group.values + slack, jacobian=jacobian, slack=(slack, column))


def stated_rows(found: Sequence[Statement], number: int, state: State) -> list[Rows]:
    """Groups of rows of what a requirement, the `number`-th of its task, states as expressions."""
    out = []
    for one in found:
        size, vector = one.limit.size, None
        values, jacobian = one.expression.linear(state.quantity)
        if one.vector is not None:
            gap, slope = (part / size for part in one.vector.linear(state.quantity))
            vector = gap.reshape(-1, 3), slope.reshape(len(gap) // 3, 3, -1)
        rows = np.atleast_1d(values) / size - HELD, np.atleast_2d(jacobian) / size
        out.append(Rows(number, one.part, one.limit, *rows, vector, always=one.always))
    return out


def linear_rows(state: State, task: DesignTask) -> tuple[Array, Array]:
    """Rows that are linear in the unknowns, >= 0 where kept, in steps of 10 mm: in every free pose the order of the
    tubes, and the ranges of the translations that the robot's actuators have; that no tube is shorter than the next
    outer one; the order at given translations. What no unknown moves is left out, as the task has checked it."""
    layout, unmoved, limits = state.layout, np.zeros((state.layout.n, 1)), task.robot.joint_limits
    straight, curved = (state.slopes[name] for name in ("straight_length", "curved_length"))
    length, longer = np.array([tube.length for tube in state.tubes]), straight + curved
    values: list[Array] = []
    slopes: list[Array] = []
    for k in (k for k, pose in enumerate(layout.poses) if isinstance(pose, FreePose)):
        shift, moved = state.joint_values(k)[1], state.joint_slopes(k)[1]
        values.append(gaps_of(state.tubes, shift, shift))
        slopes.append(order_gaps(straight, curved, moved, moved))
        if limits is not None:
            low, high = np.array(limits.translations).T
            values += [shift - low, high - shift]
            slopes += [moved, -moved]
    values.append(length[:-1] - length[1:])
    # An inner tube is at least as long as the next outer one, or their carriages could not be in order.
    slopes.append(longer[:-1] - longer[1:])
    for place in task.places:
        values.append(gaps_of(state.tubes, place.low, place.high))
        slopes.append(order_gaps(straight, curved, unmoved, unmoved))
    slope = np.concatenate(slopes)
    moves = slope.any(axis=1)
    return np.concatenate(values)[moves] / 1e-2 - ORDERED, slope[moves] / 1e-2


def fixed_rows(program: Program, state: State) -> tuple[Array, Array]:
    """Rows that are never relaxed: joint limits, the order of the tubes, the depth of the reach, the bounds behind
    strain and margin."""
    values, change = linear_rows(state, program.task)
    parts, changes = [values], [change]
    for one in program.task.built_in:
        if one.depth is not None and program.depth_pose is not None:
            place, slope = state.quantity(Quantity("tip_position", program.depth_pose))
            height = place[2] - one.depth
            # An equation as two inequalities, so that least squares and IPOPT treat it like all other rows.
            parts.append(np.array([DEPTH_TOLERANCE - height, DEPTH_TOLERANCE + height]) / 1e-2)
            changes.append(np.array([-slope[2], slope[2]]) / 1e-2)
        if one.kind in program.layout.auxiliary:
            column, size = program.layout.column(one.kind), BOUNDED[one.kind][2]
            values, change = program.aims[one].linear(state.quantity)
            change = -one.sign * change
            change[:, column] += one.sign
            # Least or greatest of many values: the auxiliary unknown bounds all of them, which is smooth.
            parts.append(one.sign * (state.x[column] - values) / size)
            changes.append(change / size)
    return np.concatenate(parts), np.concatenate(changes)


def squared(group: Rows) -> Rows:
    """Rows that limit the length of a vector, in its square: of constant curvature, the same to first order where they
    bind; as they are where the limit is eased by slack."""
    if group.vector is None or group.slack is not None:
        return group
    vector, change = group.vector
    most = group.limit.value / group.limit.size
    # (r^2 - |v|^2) / (2 r) is r - |v| to first order at |v| = r, and smooth also at v = 0.
    values = (most**2 - (vector**2).sum(1)) / (2 * most) - HELD
    return replace(group, values=values, jacobian=-np.einsum("kc,kcx->kx", vector, change) / most)


def cubed(group: Rows) -> Rows:
    """Rows that limit the length of a vector, as the six sides of the cube inside: linear in it, and stricter."""
    if group.vector is None:
        return group
    # The cube inside a ball of radius r has half the side r / sqrt(3).
    vector, change = np.sqrt(3) * group.vector[0], np.sqrt(3) * group.vector[1]
    most = group.limit.value / group.limit.size - HELD + (0.0 if group.slack is None else group.slack[0])
    values = np.concatenate([most - vector, most + vector], axis=1).ravel()
    jacobian = np.concatenate([-change, change], axis=1).reshape(len(values), -1)
    if group.slack is not None:
        jacobian[:, group.slack[1]] += 1.0
    return replace(group, values=values, jacobian=jacobian)


# Largest violation, in steps of each limit, of a feasible design: ten times the tolerance of IPOPT.
FEASIBLE = 1e-7

# Size (SI) of an objective that is next to 0, unless all unknowns together change it by less: dividing by its value
# would make its slope huge.
LEAST_SIZE = 1e-3


Report = Callable[[str, float], object]
"""Told the stage of a solve ("feasibility" or "optimum") and its measure after every iteration."""

MoreRows = Callable[[State], tuple[Array, Array]]
"""Further values at a state and their change, to be kept >= 0."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A program at x: its state, the groups of rows that can be relaxed, and the fixed rows with their change."""

    program: Program
    state: State
    groups: list[Rows]
    fixed: tuple[Array, Array]

    @cached_property
    def objective(self) -> tuple[float, Array]:
        """What is minimised, and its change (X,)."""
        return total_objective(self.program, self.state)

    @property
    def size(self) -> float:
        """By what the objective is divided for a solver: its value, or what the unknowns change it by where that is
        more, since it may vanish; volumes and energies in SI are small numbers."""
        value, slope = self.objective
        moved = float(np.abs(slope * self.program.scale).max(initial=0.0))
        return max(abs(value), min(moved, LEAST_SIZE)) or LEAST_SIZE

    @property
    def violation(self) -> tuple[float, str]:
        """The largest one, in steps of its limit, and the words of that limit."""
        worst = [(-float(group.values.min(initial=0.0)), group.limit.words) for group in self.groups]
        worst.append((-float(self.fixed[0].min(initial=0.0)), "limits of the joints and order of the tubes"))
        return max(worst)

    def note(self) -> None:
        """Keep the design where it is the best that the search passed: the answer, where time ends it."""
        # Feasible designs are ranked by objective, all others by violation alone.
        short, words = self.violation
        if short <= FEASIBLE:
            found = Reached(self.state.x, self.objective[0], 0.0, "")
        else:
            found = Reached(self.state.x, np.inf, short, words)
        lately = self.program.lately
        if lately.best is None or found.order < lately.best.order:
            lately.best = found

    def rows(self, form: Callable[[Rows], Rows] | None = None, more: MoreRows | None = None) -> tuple[Array, Array]:
        """All rows and their change: the groups, each in a form, the fixed ones, and `more`."""
        groups = self.groups if form is None else [form(group) for group in self.groups]
        parts = [*((group.values, group.jacobian) for group in groups), self.fixed]
        if more is not None:
            parts.append(more(self.state))
        values, changes = zip(*parts, strict=True)
        return np.concatenate(values), np.concatenate(changes)


def evaluate(program: Program, x: Array) -> Evaluated | None:
    """The program at x, SI; None where there is no such robot or no equilibrium."""
    check_time()
    try:
        return evaluated_at(program, x)
    except (InputError, SolveError, np.linalg.LinAlgError, FloatingPointError):
        return None


def evaluated_at(program: Program, x: Array) -> Evaluated:
    """The program at x, SI; raises SolveError where a pose has no equilibrium, InputError where there is no robot."""
    state = state_at(program, x)
    return Evaluated(program, state, rows_of(program, state), fixed_rows(program, state))


def state_at(program: Program, x: Array) -> State:
    """The state at x, SI; poses begin near the last ones solved."""
    known = program.lately.state
    # Solvers ask for value and derivatives at the same x one after the other: poses are solved once.
    if known is None or not np.array_equal(known.x, x):
        known = program.lately.state = State(program.layout, x.copy(), program.guesses)
    return known


@without_unit_warnings()
def robot_at(program: Program, x: Array) -> ConcentricRobot:
    """The robot at x; raises InputError where its tubes do not fit into one another."""
    task = program.task
    tubes = program.layout.space.tubes(x[: program.layout.designs])
    return replace(task.robot, tubes=tubes, name=f"{task.robot.name}, {task.name}".strip(", "))


@dataclass(frozen=True, eq=False)
class Attempt:
    """Where a solve from one start ended."""

    program: Program
    x: Array
    """(X,) SI."""
    objective: float
    """As minimised."""
    violation: float
    """Largest, in steps of its limit."""
    worst: str
    """Words of the limit that is violated most; "" where none is."""
    optimum: Optimum | None
    """IPOPT's answer; None where feasibility was not reached."""
    late: bool = False
    """Whether a time limit ended the search here."""

    @property
    def feasible(self) -> bool:
        """Whether every limit is kept."""
        return self.violation <= FEASIBLE

    @property
    def robot(self) -> ConcentricRobot:
        """The robot."""
        return robot_at(self.program, self.x)

    @property
    def state(self) -> State:
        """Its tubes and poses, solved when asked for."""
        return state_at(self.program, self.x)

    @property
    def evaluated(self) -> Evaluated:
        """The program there; raises as `evaluated_at`."""
        return evaluated_at(self.program, self.x)

    def value(self, one: AnyObjective) -> float:
        """An objective in its own sign, SI."""
        return objective_value(self.program, self.state, one)[0]


def attempt(program: Program, x: Array, optimum: Optimum | None = None) -> Attempt:
    """What was reached at x."""
    found = evaluate(program, x)
    if found is None:
        return Attempt(program, x, np.inf, np.inf, NO_EQUILIBRIUM, optimum)
    size, words = found.violation
    return Attempt(program, x, found.objective[0], size, words if size > FEASIBLE else "", optimum)


# What is violated where there is none.
NO_EQUILIBRIUM = "an equilibrium at every pose"


def violation(program: Program, x: Array) -> float:
    """Largest violation at x, in steps of its limit; infinity where there is no equilibrium."""
    found = evaluate(program, x)
    return np.inf if found is None else found.violation[0]


def objective_value(program: Program, state: State, one: AnyObjective) -> tuple[float, Array]:
    """An objective in its own sign, SI, and its change (X,)."""
    size = program.layout.size
    if key_of(one) in program.layout.auxiliary:
        column = program.layout.column(key_of(one))
        return float(state.x[column]), np.eye(size)[column]
    if one in program.aims:
        values, changes = program.aims[one].linear(state.quantity)
        worst = int(np.argmax(one.sign * values))
        return float(values[worst]), changes[worst]
    space, x = program.layout.space, state.x[: program.layout.designs]
    base = np.where(np.abs(space.start) > 0, space.start, space.scale)
    gap = np.pad((x - space.start) / base, (0, size - len(x)))
    return float(gap @ gap), 2 * gap * np.pad(1 / base, (0, size - len(x)))


def total_objective(program: Program, state: State) -> tuple[float, Array]:
    """What is minimised, and its change (X,)."""
    total, slope = 0.0, np.zeros(program.layout.size)
    if program.elastic:
        slacks = [name for name in program.layout.auxiliary if name.startswith("slack")]
        slope[[program.layout.column(name) for name in slacks]] = 1.0
        return float(slope @ state.x), slope
    for one in program.task.objectives:
        value, change = objective_value(program, state, one)
        total += one.sign * one.weight * value
        slope = slope + one.sign * one.weight * change
    return total, slope


def prices(groups: Sequence[Rows], multipliers: Array) -> list[float]:
    """What each group of rows costs, per step of its limit: the sum of its multipliers, of all rows."""
    *parts, _ = np.split(multipliers, np.cumsum([len(group.values) for group in groups]))
    return [float(part.sum()) for part in parts]
