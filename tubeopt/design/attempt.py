"""A design program at one vector of unknowns, and its solvers: least squares to feasibility, IPOPT to the optimum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from ..errors import InputError, SolveError, undoubted
from ..robots.concentric import ConcentricRobot
from ..solvers.ipopt import Optimum, Values, minimise, nowhere
from ..solvers.time_limit import check_time
from ..typing import Array
from .objectives import KINDS, AnyObjective, key_of
from .program import BOUNDED, Program, Reached
from .rows import Rows, cubed, fixed_rows, rows_of, squared
from .state import State

FEASIBLE = 1e-7
"""Largest violation, in steps of each limit, of what counts as kept."""

LEAST_SIZE = 1e-3
"""Size (SI) of an objective that is next to 0, unless all unknowns together change it by less."""


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
    if known is None or not np.array_equal(known.x, x):
        known = program.lately.state = State(program.layout, x.copy(), program.guesses)
    return known


@undoubted()
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
    remark: str = ""
    """What is worth knowing of how it was found."""

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


NO_EQUILIBRIUM = "an equilibrium at every pose"
"""What is violated where there is none."""


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


def to_feasibility(program: Program, start: Array, report: Report | None = None) -> Array:
    """Least squares of the violations from a start: Gauss and Newton in a trust region within the bounds."""
    scale = program.scale
    lower, upper = program.lower / scale, program.upper / scale
    fixed = upper - lower < 1e-12
    begin = _settle_auxiliary(program, start) / scale
    move = np.flatnonzero(~fixed)
    rows_count = 0
    slope: dict[bytes, Array] = {}

    def full(part: Array) -> Array:
        x = begin.copy()
        x[move] = part
        return x * scale

    def residual(part: Array) -> Array:
        """(r,) what the free unknowns `part` violate; NaN where there is no equilibrium."""
        nonlocal rows_count
        found = evaluate(program, full(part))
        if found is None:
            return np.full(rows_count, np.nan)
        gap, jacobian = _shortfall(found, program.task.solver.optimum.inside)
        rows_count = len(gap)
        slope.clear()
        slope[part.tobytes()] = jacobian[:, move] * scale[move]
        found.note()
        if report is not None:
            report("feasibility", found.violation[0])
        return gap

    def jacobian(part: Array) -> Array:
        if part.tobytes() not in slope:
            residual(part)
        return slope[part.tobytes()]

    if evaluate(program, full(begin[move])) is None:
        return start
    inside = np.clip(begin[move], lower[move] + 1e-9, upper[move] - 1e-9)
    missed = residual(inside)
    if not np.isfinite(missed).all() or not missed.any():
        return full(inside)
    result = scipy.optimize.least_squares(
        residual, inside, jacobian, bounds=(lower[move], upper[move]), x_scale="jac", max_nfev=150, ftol=1e-10,
        xtol=1e-10, gtol=1e-10,
    )  # fmt: skip
    return _settle_auxiliary(program, full(result.x))


def _shortfall(found: Evaluated, inside: float) -> tuple[Array, Array]:
    """By how much rows fall short of being kept by `inside` steps, and its change; of a limited vector, along it."""
    values, slopes = [], []
    for group in found.groups:
        short = np.minimum(group.values - inside, 0.0)
        slope = group.jacobian * (short < 0)[:, None]
        if group.vector is not None:
            vector, change = group.vector
            size = np.maximum(np.linalg.norm(vector, axis=1), 1e-12)[:, None]
            along = vector / size
            across = change - along[:, :, None] * np.einsum("kc,kcx->kx", along, change)[:, None]
            slope = (along[:, :, None] * slope[:, None] + (short[:, None] / size)[:, :, None] * across).reshape(
                -1, slope.shape[1]
            )
            short = (short[:, None] * along).ravel()
        values.append(short)
        slopes.append(slope)
    fixed = np.minimum(found.fixed[0] - inside, 0.0)
    return np.concatenate([*values, fixed]), np.concatenate([*slopes, found.fixed[1] * (fixed < 0)[:, None]])


def _settle_auxiliary(program: Program, x: Array) -> Array:
    """x with the auxiliary unknowns where the rows behind them are kept, and not more."""
    x = x.copy()
    names = [name for name in program.layout.auxiliary if name in BOUNDED]
    for name in names:
        column = program.layout.column(name)
        x[column] = program.upper[column] if KINDS[name].sign > 0 else program.lower[column]
    found = evaluate(program, x) if names else None
    if found is None:
        return x
    values, slopes = found.fixed
    for name in names:
        column = program.layout.column(name)
        mine = slopes[:, column] != 0
        room = values[mine] / np.abs(slopes[mine, column])
        step = float(room.min()) - 1e-3 * program.scale[column]
        x[column] -= KINDS[name].sign * step
    return np.clip(x, program.lower, program.upper)


def _folded(optimum: Optimum, groups: list[Rows]) -> Optimum:
    """The optimum with one multiplier for the six sides of every cube: the price of moving them all."""
    sides = [1 if group.vector is None else 6 for group in groups]
    counts = [each * len(group.values) for each, group in zip(sides, groups, strict=True)]
    *parts, rest = np.split(optimum.multipliers, np.cumsum(counts))
    of_cubes = [part.reshape(-1, each).sum(1) for each, part in zip(sides, parts, strict=True)]
    return replace(optimum, multipliers=np.concatenate([*of_cubes, rest]))


def prices(groups: Sequence[Rows], multipliers: Array) -> list[float]:
    """What each group of rows costs, per step of its limit: the sum of its multipliers, of all rows."""
    *parts, _ = np.split(multipliers, np.cumsum([len(group.values) for group in groups]))
    return [float(part.sum()) for part in parts]


def improve(
    program: Program,
    start: Array,
    report: Report | None = None,
    iterations: int | None = None,
    *,
    rows: MoreRows | None = None,
    strategy: str = "quick",
    exact: bool = False,
) -> Attempt:
    """The optimum from a start that is nearly feasible, or the start where it has no equilibrium.

    `rows` are further values and their change, to be kept >= 0; `strategy` is one of `solvers.ipopt.STRATEGIES`.
    Distances from targets are kept in the cube inside the tolerance, on which IPOPT is quicker and ends at better
    optima; with `exact` in the whole ball, and where the tolerance is eased by slack, by their length itself.
    """
    iterations = program.task.solver.optimum.iterations if iterations is None else iterations
    form = squared if exact else cubed
    scale = program.scale
    known = evaluate(program, start)
    if known is None:
        return attempt(program, start)
    count, size = len(known.rows(form, rows)[0]), known.size
    seen: list[tuple[float, Array]] = []

    def values(x: Array) -> Values:
        """Objective and constraints at scaled unknowns x (k,), with derivatives; keeps the best feasible x."""
        found = evaluate(program, x * scale)
        if found is None:
            return nowhere(count, len(x))
        f, slope = found.objective
        g, jacobian = found.rows(form, rows)
        if g.min(initial=0.0) >= -FEASIBLE and (not seen or f < seen[0][0]):
            seen[:] = [(f, x * scale)]
            found.note()
        return Values(f / size, slope * scale / size, g, jacobian * scale)

    optimum = minimise(
        values, start / scale, program.lower / scale, program.upper / scale, iterations=iterations,
        strategy=strategy, report=None if report is None else lambda f: report("optimum", f * size),
    )  # fmt: skip
    optimum = replace(
        optimum, x=optimum.x * scale, multipliers=optimum.multipliers * size,
        bound_multipliers=optimum.bound_multipliers * size / scale,
    )  # fmt: skip
    if form is cubed:
        optimum = _folded(optimum, known.groups)
    reached = attempt(program, optimum.x, optimum)
    if optimum.success or not seen or (reached.feasible and reached.objective <= seen[0][0]):
        return reached
    # Going round in circles, it has passed something better.
    inside = np.clip(seen[0][1], program.lower, program.upper)
    return attempt(program, inside, replace(optimum, x=inside))
