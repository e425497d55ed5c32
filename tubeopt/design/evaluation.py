"""A design program at one vector of unknowns: rows of constraints, objective, violation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ..block.quantities import Quantity
from ..errors import InputError, SolveError, without_unit_warnings
from ..robots.eccentric import BundleRobot
from ..solvers.ipopt import Optimum
from ..solvers.time_limit import check_time
from ..typing import Array
from .constraints import Limit, Statement
from .objectives import AnyObjective, key_of
from .program import BOUNDED, PassedDesign, Program, slack_name
from .state import DesignState, FreePose, axes_slopes, sheath
from .task import DesignedRobot, DesignTask, order_distances, tube_distances, tube_order

# Fraction of a step by which limits are kept inside: IPOPT satisfies constraints to 1e-8, and a design that is off by
# that would fail its verification.
INSIDE = 5e-8

# The same for joints and the order of tubes, in steps of 10 mm: 0.9 nm. Inverse kinematics and planning allow no more
# than round-off.
ORDER_INSIDE = 9e-8

# Limits whose rows stay, though their derivative may be 0 for a while: where nothing softens.
POSED = ("margin in use", "certified margin")

# Tolerance (m) on the depth of the pose of reach_radius: an equation would leave IPOPT no interior.
DEPTH_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one group, >= 0 if the limit is satisfied, in units of `limit.size`."""

    requirement: int
    """Index of the requirement in the task."""
    part: int
    """Index among the groups of its requirement."""
    limit: Limit
    values: Array
    """Values (K,) of the rows, in units of `limit.size`."""
    jacobian: Array
    """Derivatives (K, X) of the values."""
    vector: tuple[Array, Array] | None = None
    """Vectors (K, 3) if their lengths are limited, and their derivatives (K, 3, X). From far away least squares reach 0
    faster with the vectors than with their lengths."""
    slack: tuple[float, int] | None = None
    """Steps that relax the limit per unit of slack, and the column of this slack."""
    always: bool = False
    """True if the rows stay where their derivatives are 0."""


def rows_of(program: Program, state: DesignState) -> list[Rows]:
    """Groups of rows that can be relaxed."""
    rows = [group for number, stated in enumerate(program.stated) for group in stated_rows(stated, number, state)]
    # A limit on dimensions that are not free, and is kept, is no constraint.
    rows = [
        group
        for group in rows
        if group.always or group.jacobian.any() or group.values.min() < 0 or group.limit.description in POSED
    ]
    if not program.elastic:
        return rows
    for k, group in enumerate(rows):
        column = state.layout.column(slack_name(k))
        slack = float(state.x[column])
        # A slack moves every row of its group by the same number of steps.
        jacobian = group.jacobian + np.eye(len(state.x))[column]
        rows[k] = replace(group, values=group.values + slack, jacobian=jacobian, slack=(slack, column))
    return rows


def stated_rows(statements: Sequence[Statement], number: int, state: DesignState) -> list[Rows]:
    """Groups of rows of the statements of requirement `number` of a task."""
    groups = []
    for statement in statements:
        size, vector = statement.limit.size, None
        values, jacobian = statement.expression.linear(state.quantity)
        if statement.vector is not None:
            v, slope = (part / size for part in statement.vector.linear(state.quantity))
            vector = v.reshape(-1, 3), slope.reshape(len(v) // 3, 3, -1)
        rows = np.atleast_1d(values) / size - INSIDE, np.atleast_2d(jacobian) / size
        groups.append(Rows(number, statement.part, statement.limit, *rows, vector, always=statement.always))
    return groups


def linear_rows(state: DesignState, task: DesignTask) -> tuple[Array, Array]:
    """Constraints that are linear in the unknowns, in steps of 10 mm, >= 0 if satisfied, and their derivatives.

    In every free pose: the order of the tubes, and the translation limits of the actuators. In addition, no tube is
    shorter than the next outer one, and the order holds at given translations. Rows that do not depend on the unknowns
    are omitted, since the task has checked them.
    """
    layout, unmoved, limits = state.layout, np.zeros((state.layout.n, 1)), task.robot.joint_limits
    order = tube_order(task.robot)
    straight, curved = (state.slopes[name] for name in ("straight_length", "curved_length"))
    length, longer = np.array([tube.length for tube in state.tubes]), straight + curved
    values: list[Array] = []
    slopes: list[Array] = []
    for k in (k for k, pose in enumerate(layout.poses) if isinstance(pose, FreePose)):
        shift, moved = state.joint_values(k)[1], state.joint_slopes(k)[1]
        values.append(tube_distances(order, state.tubes, shift, shift))
        slopes.append(order_distances(order, straight, curved, moved, moved))
        if len(layout.carriages) < layout.n:
            # A carriage moves with its first tube; the others stay clamped behind the plate, too.
            values.append(np.array([tube.straight_length for tube in state.tubes]) - shift)
            slopes.append(straight - moved)
        if limits is not None:
            low, high = np.array(limits.translations).T
            values += [shift - low, high - shift]
            slopes += [moved, -moved]
    inner, outer = list(order.inner), list(order.outer)
    values.append(length[inner] - length[outer])
    # An inner tube is at least as long as the next outer one, or their carriages could not be in order.
    slopes.append(longer[inner] - longer[outer])
    for translations in task.translation_ranges:
        values.append(tube_distances(order, state.tubes, translations.low, translations.high))
        slopes.append(order_distances(order, straight, curved, unmoved, unmoved))
    slope = np.concatenate(slopes)
    moves = slope.any(axis=1)
    return np.concatenate(values)[moves] / 1e-2 - ORDER_INSIDE, slope[moves] / 1e-2


# Part of the largest product of offset and precurvature, 1/4, that a bundle stays below.
SLENDER = 0.25 * (1 - 1e-6)


def fit_rows(state: DesignState) -> tuple[Array, Array]:
    """Constraints that a bundle can be built, in steps of 0.1 mm, >= 0 if satisfied, and their derivatives.

    Tubes side by side do not overlap, nested ones fit, the sheath contains all, and none is curved too tightly.
    """
    robot, given, slopes = state.robot, state.layout.space.robot, state.slopes
    if not (isinstance(robot, BundleRobot) and isinstance(given, BundleRobot)):
        return np.zeros(0), np.zeros((0, state.layout.size))
    values, changes = [], []
    radius, wider = np.array([tube.outer_diameter / 2 for tube in robot.tubes]), slopes["outer_diameter"] / 2
    axes, moved, (width, widened) = robot.axes, axes_slopes(state), sheath(state)
    together = {frozenset(pair) for stack in given.stacks for pair in combinations(stack, 2)}
    for i, j in combinations(range(robot.n_tubes), 2):
        if frozenset((i, j)) not in together:
            apart = axes[i] - axes[j]
            far = float(np.linalg.norm(apart))
            values.append(far - radius[i] - radius[j])
            changes.append(apart @ (moved[i] - moved[j]) / max(far, 1e-300) - wider[i] - wider[j])
    for i, o in given.nested_pairs:
        values.append(robot.tubes[o].inner_diameter - robot.tubes[i].outer_diameter)
        changes.append(slopes["inner_diameter"][o] - slopes["outer_diameter"][i])
    for i, tube in enumerate(robot.tubes):
        values.append(width / 2 - robot.offset[i] - radius[i])
        changes.append(widened / 2 - slopes["offset"][i] - wider[i])
        bend = robot.offset[i] * np.sign(tube.curvature) * slopes["curvature"][i]
        values.append(1e-2 * (SLENDER - robot.offset[i] * abs(tube.curvature)))
        changes.append(-1e-2 * (abs(tube.curvature) * slopes["offset"][i] + bend))
    slope = np.array(changes)
    moves = slope.any(axis=1)
    return np.array(values)[moves] / 1e-4 - INSIDE, slope[moves] / 1e-4


def fixed_rows(program: Program, state: DesignState) -> tuple[Array, Array]:
    """Constraints that are never relaxed, and their derivatives.

    They are the joint limits, the order and fit of the tubes, the depth of the reach, and the bounds by auxiliary
    unknowns.
    """
    parts, changes = map(list, zip(linear_rows(state, program.task), fit_rows(state), strict=True))
    for objective in program.task.built_in:
        if objective.depth is not None and program.depth_pose is not None:
            tip, slope = state.quantity(Quantity("tip_position", program.depth_pose))
            height = tip[2] - objective.depth
            # An equation as two inequalities, so that least squares and IPOPT treat it like all other rows.
            parts.append(np.array([DEPTH_TOLERANCE - height, DEPTH_TOLERANCE + height]) / 1e-2)
            changes.append(np.array([-slope[2], slope[2]]) / 1e-2)
        if objective.kind in program.layout.auxiliary:
            column, size = program.layout.column(objective.kind), BOUNDED[objective.kind][2]
            values, change = program.aims[objective].linear(state.quantity)
            change = -objective.sign * change
            change[:, column] += objective.sign
            # Least or greatest of many values: the auxiliary unknown bounds all of them, which is smooth.
            parts.append(objective.sign * (state.x[column] - values) / size)
            changes.append(change / size)
    return np.concatenate(parts), np.concatenate(changes)


def squared(group: Rows) -> Rows:
    """Rows in which limits on lengths of vectors are replaced by limits on their squares.

    The square has constant curvature, and the same first order where the limit is active. Limits with slack stay.
    """
    if group.vector is None or group.slack is not None:
        return group
    vector, change = group.vector
    radius = group.limit.value / group.limit.size
    # (r^2 - |v|^2) / (2 r) is r - |v| to first order at |v| = r, and smooth also at v = 0.
    values = (radius**2 - (vector**2).sum(1)) / (2 * radius) - INSIDE
    return replace(group, values=values, jacobian=-np.einsum("kc,kcx->kx", vector, change) / radius)


def cubed(group: Rows) -> Rows:
    """Rows in which limits on lengths of vectors are replaced by the sides of the inscribed cube: linear
    and stricter.
    """
    if group.vector is None:
        return group
    # The cube inside a ball of radius r has half the side r / sqrt(3).
    vector, change = np.sqrt(3) * group.vector[0], np.sqrt(3) * group.vector[1]
    half_side = group.limit.value / group.limit.size - INSIDE + (0.0 if group.slack is None else group.slack[0])
    values = np.concatenate([half_side - vector, half_side + vector], axis=1).ravel()
    jacobian = np.concatenate([-change, change], axis=1).reshape(len(values), -1)
    if group.slack is not None:
        jacobian[:, group.slack[1]] += 1.0
    return replace(group, values=values, jacobian=jacobian)


# Largest violation, in steps of each limit, of a feasible design: ten times the tolerance of IPOPT.
FEASIBLE = 1e-7

# Size (SI) of an objective that is next to 0, unless all unknowns together change it by less: dividing by its value
# would make its slope huge.
MIN_SIZE = 1e-3


Report = Callable[[str, float], object]
"""Called after every iteration with the stage ("feasibility" or "optimum") and its measure."""

MoreRows = Callable[[DesignState], tuple[Array, Array]]
"""Further constraints at a state, >= 0 if satisfied, and their derivatives."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Program at x: state, groups of rows that can be relaxed, and fixed rows with their derivatives."""

    program: Program
    state: DesignState
    groups: list[Rows]
    fixed: tuple[Array, Array]

    @cached_property
    def objective(self) -> tuple[float, Array]:
        """Minimised objective, and its gradient (X,)."""
        return total_objective(self.program, self.state)

    @property
    def size(self) -> float:
        """Scale of the objective for a solver: its value, or its largest change by the unknowns if that is larger.

        The value may vanish, and volumes and energies in SI are small numbers.
        """
        value, slope = self.objective
        moved = float(np.abs(slope * self.program.scale).max(initial=0.0))
        return max(abs(value), min(moved, MIN_SIZE)) or MIN_SIZE

    @property
    def violation(self) -> tuple[float, str]:
        """Largest violation, in steps of its limit, and the name of that limit."""
        worst = [(-float(group.values.min(initial=0.0)), group.limit.description) for group in self.groups]
        worst.append((-float(self.fixed[0].min(initial=0.0)), "limits of the joints, or order or fit of the tubes"))
        return max(worst)

    def note(self) -> None:
        """Store the design if it is the best up to now, as the result in case the time limit ends the search."""
        # Feasible designs are ranked by objective, all others by violation alone.
        short, worst = self.violation
        if short <= FEASIBLE:
            passed = PassedDesign(self.state.x, self.objective[0], 0.0, "")
        else:
            passed = PassedDesign(self.state.x, np.inf, short, worst)
        lately = self.program.lately
        if lately.best is None or passed.order < lately.best.order:
            lately.best = passed

    def rows(self, form: Callable[[Rows], Rows] | None = None, more: MoreRows | None = None) -> tuple[Array, Array]:
        """All constraints and their derivatives: the groups in a form, the fixed rows, and `more`."""
        groups = self.groups if form is None else [form(group) for group in self.groups]
        parts = [*((group.values, group.jacobian) for group in groups), self.fixed]
        if more is not None:
            parts.append(more(self.state))
        values, changes = zip(*parts, strict=True)
        return np.concatenate(values), np.concatenate(changes)


def evaluate(program: Program, x: Array) -> Evaluated | None:
    """Rows and objective of a program at unknowns x, SI; None if the robot or an equilibrium does not exist."""
    check_time()
    try:
        return evaluated_at(program, x)
    except (InputError, SolveError, np.linalg.LinAlgError, FloatingPointError):
        return None


def evaluated_at(program: Program, x: Array) -> Evaluated:
    """Rows and objective of a program at unknowns x, SI.

    Raises:
        SolveError: a pose has no equilibrium.
        InputError: the dimensions make no robot.
    """
    state = state_at(program, x)
    return Evaluated(program, state, rows_of(program, state), fixed_rows(program, state))


def state_at(program: Program, x: Array) -> DesignState:
    """State at x, SI; the solve of each pose starts at its last solution."""
    known, physical = program.lately.state, program.layout.size - len(program.layout.auxiliary)
    # Solvers ask for value and derivatives at the same x one after the other: poses are solved once.
    if known is not None and known.layout is program.layout and np.array_equal(known.x[:physical], x[:physical]):
        known = known if np.array_equal(known.x, x) else known.with_auxiliary(x.copy())
    else:
        known = DesignState(program.layout, x.copy(), program.guesses)
    program.lately.state = known
    return known


@without_unit_warnings()
def robot_at(program: Program, x: Array) -> DesignedRobot:
    """Robot at x; raises InputError if its tubes do not nest."""
    task = program.task
    dimensions = program.layout.space.fields(x[: program.layout.designs])
    return replace(task.robot, **dimensions, name=f"{task.robot.name}, {task.name}".strip(", "))


@dataclass(frozen=True, eq=False)
class Attempt:
    """End of a solve from one start."""

    program: Program
    x: Array
    """Unknowns (X,), SI."""
    objective: float
    """Minimised value."""
    violation: float
    """Largest violation, in steps of its limit."""
    worst: str
    """Name of the limit that is violated most; "" if none is."""
    optimum: Optimum | None
    """Result of IPOPT; None if feasibility was not reached."""
    out_of_time: bool = False
    """True if a time limit ended the search here."""

    @property
    def feasible(self) -> bool:
        """True if all limits are satisfied."""
        return self.violation <= FEASIBLE

    @property
    def robot(self) -> DesignedRobot:
        """Robot with the dimensions of x."""
        return robot_at(self.program, self.x)

    @property
    def state(self) -> DesignState:
        """Tubes and poses at x, solved on first use."""
        return state_at(self.program, self.x)

    @property
    def evaluated(self) -> Evaluated:
        """Rows and objective of the program at the unknowns; raises as `evaluated_at`."""
        return evaluated_at(self.program, self.x)

    def value(self, objective: AnyObjective) -> float:
        """An objective in its own sign, SI."""
        return objective_value(self.program, self.state, objective)[0]


def attempt(program: Program, x: Array, optimum: Optimum | None = None) -> Attempt:
    """Objective and violation at x."""
    evaluated = evaluate(program, x)
    if evaluated is None:
        return Attempt(program, x, np.inf, np.inf, NO_EQUILIBRIUM, optimum)
    size, name = evaluated.violation
    return Attempt(program, x, evaluated.objective[0], size, name if size > FEASIBLE else "", optimum)


# Name of the violated limit if a pose has no equilibrium.
NO_EQUILIBRIUM = "an equilibrium at every pose"


def violation(program: Program, x: Array) -> float:
    """Largest violation at x, in steps of its limit; infinity without an equilibrium."""
    evaluated = evaluate(program, x)
    return np.inf if evaluated is None else evaluated.violation[0]


def objective_value(program: Program, state: DesignState, objective: AnyObjective) -> tuple[float, Array]:
    """Value of an objective in its own sign, SI, and its gradient (X,)."""
    size = program.layout.size
    if key_of(objective) in program.layout.auxiliary:
        column = program.layout.column(key_of(objective))
        return float(state.x[column]), np.eye(size)[column]
    if objective in program.aims:
        values, changes = program.aims[objective].linear(state.quantity)
        worst = int(np.argmax(objective.sign * values))
        return float(values[worst]), changes[worst]
    space, x = program.layout.space, state.x[: program.layout.designs]
    base = np.where(np.abs(space.start) > 0, space.start, space.scale)
    change = np.pad((x - space.start) / base, (0, size - len(x)))
    return float(change @ change), 2 * change * np.pad(1 / base, (0, size - len(x)))


def total_objective(program: Program, state: DesignState) -> tuple[float, Array]:
    """Minimised objective, and its gradient (X,)."""
    total, slope = 0.0, np.zeros(program.layout.size)
    if program.elastic:
        slacks = [name for name in program.layout.auxiliary if name.startswith("slack")]
        slope[[program.layout.column(name) for name in slacks]] = 1.0
        return float(slope @ state.x), slope
    for objective in program.task.objectives:
        value, change = objective_value(program, state, objective)
        total += objective.sign * objective.weight * value
        slope = slope + objective.sign * objective.weight * change
    return total, slope


def prices(groups: Sequence[Rows], multipliers: Array) -> list[float]:
    """Change of the optimum per step of the limit of each group: the sum of the multipliers of its rows."""
    *parts, _ = np.split(multipliers, np.cumsum([len(group.values) for group in groups]))
    return [float(part.sum()) for part in parts]
