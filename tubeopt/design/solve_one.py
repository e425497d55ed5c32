"""The two solvers of a design program: least squares to feasibility, IPOPT to the optimum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..errors import SolveError
from ..robots.concentric import ConcentricRobot
from ..solvers.smooth import Optimum, Values, minimise, nowhere
from ..typing import Array
from .objectives import KINDS, AnyObjective
from .program import (
    BOUNDED,
    Program,
    Reached,
    evaluate,
    fixed_rows,
    groups,
    objective_size,
    objective_value,
    robot_at,
    stack,
    state_at,
    total_objective,
)
from .state import State
from .statements import HELD, Rows

FEASIBLE = 1e-7
"""Largest violation, in steps of each limit, of what counts as kept."""

Found = tuple[State, list[Rows], tuple[Array, Array]]
MoreRows = Callable[[State], tuple[Array, Array]]

Report = Callable[[str, float], object]
"""Told the stage of a solve ("feasibility" or "optimum") and its measure after every iteration."""


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

    def value(self, one: AnyObjective) -> float:
        """An objective in its own sign, SI."""
        return objective_value(self.program, state_at(self.program, self.x), one)[0]


def violation(program: Program, x: Array) -> tuple[float, str]:
    """Largest violation at x, in steps of its limit, and the words of that limit."""
    found = evaluate(program, x)
    if found is None:
        return np.inf, "an equilibrium at every pose"
    return largest_violation(found)


def largest_violation(found: Found) -> tuple[float, str]:
    """The same, of rows."""
    worst = [(-float(group.values.min(initial=0.0)), group.limit.words) for group in found[1]]
    worst.append((-float(found[2][0].min(initial=0.0)), "limits of the joints and order of the tubes"))
    return max(worst)


def attempt(program: Program, x: Array, optimum: Optimum | None) -> Attempt:
    """What was reached at x."""
    size, words = violation(program, x)
    objective = np.inf
    if np.isfinite(size):
        objective = total_objective(program, state_at(program, x))[0]
    return Attempt(program, x, objective, size, words if size > FEASIBLE else "", optimum)


def shortfall(found: Found, inside: float) -> tuple[Array, Array]:
    """By how much rows fall short of being kept by `inside` steps, and its change; of a limited vector, along it."""
    values, slopes = [], []
    for group in found[1]:
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
    fixed = np.minimum(found[2][0] - inside, 0.0)
    return np.concatenate([*values, fixed]), np.concatenate([*slopes, found[2][1] * (fixed < 0)[:, None]])


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
        gap, jacobian = shortfall(found, program.task.solver.optimum.inside)
        rows_count = len(gap)
        slope.clear()
        slope[part.tobytes()] = jacobian[:, move] * scale[move]
        short, words = largest_violation(found)
        kept = short <= FEASIBLE
        cost = total_objective(program, found[0])[0] if kept else np.inf
        program.lately.note(Reached(full(part), cost, 0.0 if kept else short, "" if kept else words))
        if report is not None:
            report("feasibility", short)
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
    values, slopes = found[2]
    for name in names:
        column = program.layout.column(name)
        mine = slopes[:, column] != 0
        room = values[mine] / np.abs(slopes[mine, column])
        step = float(room.min()) - 1e-3 * program.scale[column]
        x[column] -= KINDS[name].sign * step
    return np.clip(x, program.lower, program.upper)


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
    """The optimum from a start that is nearly feasible; `rows` are further values and their change, to be kept >= 0,
    `strategy` one of `solvers.smooth.STRATEGIES`.

    Distances from targets are kept in the cube inside the tolerance, on which IPOPT is quicker and ends at better
    optima; with `exact` in the whole ball, and where the tolerance is eased by slack, by their length itself.
    """
    iterations = program.task.solver.optimum.iterations if iterations is None else iterations
    form = squared if exact else cubed
    scale = program.scale
    known = evaluate(program, start)
    if known is None:
        raise SolveError("no equilibrium was found at the start of a design")
    count = len(_all_rows(known, form, rows)[0])
    size = objective_size(program, known[0])

    seen: list[tuple[float, Array]] = []

    def values(x: Array) -> Values:
        """Objective and constraints at scaled unknowns x (k,), with derivatives; keeps the best feasible x."""
        found = evaluate(program, x * scale)
        if found is None:
            return nowhere(count, len(x))
        f, slope = total_objective(program, found[0])
        g, jacobian = _all_rows(found, form, rows)
        if g.min(initial=0.0) >= -FEASIBLE and (not seen or f < seen[0][0]):
            seen[:] = [(f, x * scale)]
            program.lately.note(Reached(x * scale, f, 0.0, ""))
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
        optimum = _folded(optimum, known[1])
    reached = attempt(program, optimum.x, optimum)
    if optimum.success or not seen or (reached.feasible and reached.objective <= seen[0][0]):
        return reached
    # Going round in circles, it has passed something better.
    inside = np.clip(seen[0][1], program.lower, program.upper)
    return attempt(program, inside, replace(optimum, x=inside))


def squared(group: Rows) -> Rows:
    """Rows that limit the length of a vector, in its square: of constant curvature, the same to first order where they
    bind; as they are where the limit is eased by slack."""
    if group.vector is None or group.slack is not None:
        return group
    vector, change = group.vector
    most = group.limit.value / group.limit.size
    values = (most**2 - (vector**2).sum(1)) / (2 * most) - HELD
    return replace(group, values=values, jacobian=-np.einsum("kc,kcx->kx", vector, change) / most)


def cubed(group: Rows) -> Rows:
    """Rows that limit the length of a vector, as the six sides of the cube inside: linear in it, and stricter."""
    if group.vector is None:
        return group
    vector, change = np.sqrt(3) * group.vector[0], np.sqrt(3) * group.vector[1]
    most = group.limit.value / group.limit.size - HELD + (0.0 if group.slack is None else group.slack[0])
    values = np.concatenate([most - vector, most + vector], axis=1).ravel()
    jacobian = np.concatenate([-change, change], axis=1).reshape(len(values), -1)
    if group.slack is not None:
        jacobian[:, group.slack[1]] += 1.0
    return replace(group, values=values, jacobian=jacobian)


def _folded(optimum: Optimum, groups: list[Rows]) -> Optimum:
    """The optimum with one multiplier for the six sides of every cube: the price of moving them all."""
    sides = [1 if group.vector is None else 6 for group in groups]
    counts = [each * len(group.values) for each, group in zip(sides, groups, strict=True)]
    *parts, rest = np.split(optimum.multipliers, np.cumsum(counts))
    folded = [part.reshape(-1, each).sum(1) for each, part in zip(sides, parts, strict=True)]
    return replace(optimum, multipliers=np.concatenate([*folded, rest]))


def prices(groups: Sequence[Rows], multipliers: Array) -> list[float]:
    """What each group of rows costs, per step of its limit: the sum of its multipliers, of all rows."""
    *parts, _ = np.split(multipliers, np.cumsum([len(group.values) for group in groups]))
    return [float(part.sum()) for part in parts]


def _all_rows(found: Found, form: Callable[[Rows], Rows], rows: MoreRows | None) -> tuple[Array, Array]:
    values, jacobian = stack([form(group) for group in found[1]], found[2])
    if rows is None:
        return values, jacobian
    more = rows(found[0])
    return np.concatenate([values, more[0]]), np.concatenate([jacobian, more[1]])


def rows_at(program: Program, x: Array) -> tuple[list[Rows], tuple[Array, Array]]:
    """Groups and fixed rows at x; raises SolveError where there are none."""
    state = state_at(program, x)
    return groups(program, state), fixed_rows(program, state)
