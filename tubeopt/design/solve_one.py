"""The two solvers of a design program: least squares to feasibility, IPOPT to the optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from ..errors import SolveError
from ..robots.assembly import Array
from ..solvers.smooth import Optimum, Values, minimise
from .program import Program, evaluate, fixed_rows, groups, nowhere, stack, state_at, total_objective
from .rows import Rows
from .state import State

FEASIBLE = 1e-7
"""Largest violation, in steps of each limit, of what counts as kept."""

INSIDE = 1e-3
"""By how many steps least squares aims inside every limit, so that IPOPT starts in the interior."""

Found = tuple[State, list[Rows], tuple[Array, Array]]
MoreRows = Callable[[State], tuple[Array, Array]]

Report = Callable[[str, float], object]
"""Told the stage of a solve ("feasibility" or "optimum") and its measure after every iteration."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """Where a solve from one start ended.

    x (X,) SI; objective: as minimised; violation: largest, in steps of its limit; worst: words of the limit that is
    violated most, "" where none is; optimum: IPOPT's answer, None where feasibility was not reached.
    """

    program: Program
    x: Array
    objective: float
    violation: float
    worst: str
    optimum: Optimum | None

    @property
    def feasible(self) -> bool:
        """Whether every limit is kept."""
        return self.violation <= FEASIBLE


def violation(program: Program, x: Array) -> tuple[float, str]:
    """Largest violation at x, in steps of its limit, and the words of that limit."""
    found = evaluate(program, x)
    if found is None:
        return np.inf, "an equilibrium at every pose"
    return largest_violation(found[1], found[2][0])


def largest_violation(found: list[Rows], fixed: Array) -> tuple[float, str]:
    """The same, of rows."""
    worst = [(-float(group.values.min(initial=0.0)), group.limit.words) for group in found]
    worst.append((-float(fixed.min(initial=0.0)), "limits of the joints"))
    return max(worst)


def attempt(program: Program, x: Array, optimum: Optimum | None) -> Attempt:
    """What was reached at x."""
    size, words = violation(program, x)
    objective = np.inf
    if np.isfinite(size):
        objective = total_objective(program, state_at(program, x))[0]
    return Attempt(program, x, objective, size, words if size > FEASIBLE else "", optimum)


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
        nonlocal rows_count
        found = evaluate(program, full(part))
        if found is None:
            return np.full(rows_count, np.nan)
        values, jacobian = stack(found[1], found[2])
        rows_count = len(values)
        gap = np.minimum(values - INSIDE, 0.0)
        slope.clear()
        slope[part.tobytes()] = jacobian[:, move] * scale[move] * (gap < 0)[:, None]
        if report is not None:
            report("feasibility", float(-values.min(initial=0.0)))
        return gap

    def jacobian(part: Array) -> Array:
        if part.tobytes() not in slope:
            residual(part)
        return slope[part.tobytes()]

    if evaluate(program, full(begin[move])) is None:
        return start
    inside = np.clip(begin[move], lower[move] + 1e-9, upper[move] - 1e-9)
    if not np.isfinite(residual(inside)).all() or not (residual(inside) < 0).any():
        return full(inside)
    result = least_squares(
        residual, inside, jacobian, bounds=(lower[move], upper[move]), x_scale="jac", max_nfev=150, ftol=1e-10,
        xtol=1e-10, gtol=1e-10,
    )  # fmt: skip
    return _settle_auxiliary(program, full(result.x))


def _settle_auxiliary(program: Program, x: Array) -> Array:
    """x with the auxiliary unknowns where the rows behind them are kept, and not more."""
    x = x.copy()
    names = [name for name in program.layout.auxiliary if name in ("strain", "margin")]
    for name in names:
        column = program.layout.column(name)
        x[column] = program.upper[column] if name == "strain" else program.lower[column]
    found = evaluate(program, x) if names else None
    if found is None:
        return x
    values, slopes = found[2]
    for name in names:
        column = program.layout.column(name)
        mine = slopes[:, column] != 0
        room = values[mine] / np.abs(slopes[mine, column])
        step = float(room.min()) - 1e-3 * program.scale[column]
        x[column] += -step if name == "strain" else step
    return np.clip(x, program.lower, program.upper)


def improve(
    program: Program,
    start: Array,
    report: Report | None = None,
    iterations: int = 150,
    *,
    rows: MoreRows | None = None,
    strategy: str = "quick",
) -> Attempt:
    """The optimum from a start that is nearly feasible; `rows` are further values and their change, to be kept >= 0,
    `strategy` one of `solvers.smooth.STRATEGIES`."""
    scale = program.scale
    known = evaluate(program, start)
    if known is None:
        raise SolveError("no equilibrium was found at the start of a design")
    count = len(_all_rows(known, rows)[0])
    size = max(abs(total_objective(program, known[0])[0]), 1e-3)

    seen: list[tuple[float, Array]] = []

    def values(x: Array) -> Values:
        found = evaluate(program, x * scale)
        if found is None:
            return nowhere(count, len(x))
        f, slope = total_objective(program, found[0])
        g, jacobian = _all_rows(found, rows)
        if g.min(initial=0.0) >= -FEASIBLE and (not seen or f < seen[0][0]):
            seen[:] = [(f, x * scale)]
        return Values(f / size, slope * scale / size, g, jacobian * scale)

    optimum = minimise(
        values, start / scale, program.lower / scale, program.upper / scale, iterations=iterations,
        strategy=strategy, report=None if report is None else lambda f: report("optimum", f * size),
    )  # fmt: skip
    optimum = Optimum(
        optimum.x * scale, optimum.values, optimum.multipliers * size, optimum.bound_multipliers * size / scale,
        optimum.success, optimum.status, optimum.iterations,
    )  # fmt: skip
    reached = attempt(program, optimum.x, optimum)
    if optimum.success or not seen or (reached.feasible and reached.objective <= seen[0][0]):
        return reached
    # Going round in circles, it has passed something better.
    inside = np.clip(seen[0][1], program.lower, program.upper)
    return attempt(program, inside, replace(optimum, x=inside))


def _all_rows(found: Found, rows: MoreRows | None) -> tuple[Array, Array]:
    values, jacobian = stack(found[1], found[2])
    if rows is None:
        return values, jacobian
    more = rows(found[0])
    return np.concatenate([values, more[0]]), np.concatenate([jacobian, more[1]])


def rows_at(program: Program, x: Array) -> tuple[list[Rows], tuple[Array, Array]]:
    """Groups and fixed rows at x; raises SolveError where there are none."""
    state = state_at(program, x)
    return groups(program, state), fixed_rows(program, state)
