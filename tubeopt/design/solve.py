"""Solving a design program from one start or many: joints, feasibility, the optimum, rims of targets, its kinks.

A start has the dimensions of a design and, for every target, the best of many random joint values. Least squares find
a feasible design, IPOPT the optimum.

Inside one order of breakpoints everything is smooth in the unknowns; where a section between two of them closes there
is a kink. Optima often lie on kinks: two tubes that end together, a transition just at the plate. There no gradient
method converges. So the order is fixed, which makes the lengths of the sections constraints, and swapped where one that
is closed at the optimum would rather be passed.

Of many starts feasible designs are ranked, and failures counted by what failed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from ..errors import InputError, SolveError, without_unit_warnings
from ..robots.limits import JointLimits
from ..robots.tubes import Tube
from ..solvers.ipopt import Optimum, Values, minimise, nowhere
from ..solvers.parallel import executor, run_all
from ..solvers.sampling import sobol
from ..solvers.time_limit import LateError
from ..typing import Array, Progress
from .evaluation import FEASIBLE, Attempt, Evaluated, MoreRows, Report, Rows, attempt, cubed, evaluate, prices, squared
from .objectives import KINDS
from .pose import Pose, solve_pose
from .program import BOUNDED, Program
from .requirements import Avoid
from .state import FreePose, State

# Steps of a limit. The sum of slacks is an L1 norm, whose optimum has most of them at 0 up to the tolerance of IPOPT.
LEAST_SLACK = 1e-5


# Violation, in steps of its limit, below which IPOPT takes over. From farther away it spends its iterations on
# restoring feasibility, which least squares do better.
NEARLY_FEASIBLE = 0.5


# Other joint values for targets that least squares did not come near: they end in local minima of the distance, of
# which a pose has a few. Each costs as much as the first try.
POSE_RESTARTS = 2


# Relative cost of the objective that staying in the cubes inside the tolerances may have, and the part of a cube's side
# within which it counts as active. Below it a second run of IPOPT in the balls gains nothing that can be made.
CUBE_PRICE = 1e-3


# Part of the iterations for the run in the balls: it begins at the optimum in the cubes and is near its own.
BALL_ITERATIONS = 0.4


def solve(program: Program, start: Array, report: Report | None = None) -> Attempt:
    """The best design from a start (X,), SI: feasible by least squares, then optimal by IPOPT."""
    x = to_feasibility(program, np.clip(start, program.lower, program.upper), report)
    found = attempt(program, x)
    # Dimensions stay where least squares left them; joint values alone are drawn again.
    for kick in range(POSE_RESTARTS if program.layout.free_poses else 0):
        if found.violation <= NEARLY_FEASIBLE:
            break
        random = np.random.default_rng([kick, program.layout.size])
        begin = with_joints(program, found.x[: program.layout.designs], random)
        x = to_feasibility(program, begin, report)
        found = min(found, attempt(program, x), key=lambda one: one.violation)
    return found if found.violation > NEARLY_FEASIBLE else best_from(program, found.x, report)


def best_from(program: Program, x: Array, report: Report | None = None) -> Attempt:
    """The optimum from a design that is nearly feasible.

    IPOPT is let loose across all kinks first; where it does not converge, it ends in one order of breakpoints after the
    other.
    """
    return _to_the_rim(program, _in_the_cubes(program, x, report), report)


def _in_the_cubes(program: Program, x: Array, report: Report | None) -> Attempt:
    found = improve(program, x, report)
    if found.feasible and found.optimum is not None and found.optimum.success:
        return found
    # The start too, since IPOPT may end worse than it began where it does not converge.
    candidates = [found, attempt(program, x)]
    if np.isfinite(found.violation) and not found.feasible:
        # IPOPT ended just outside.
        x = to_feasibility(program, found.x, report)
        candidates.append(attempt(program, x))
    best = min(candidates, key=_worse)
    return min(best, _through_cells(best, report), key=_worse)


def _to_the_rim(program: Program, found: Attempt, report: Report | None) -> Attempt:
    """The optimum with whole balls around the targets, where the cubes inside them cost something."""
    if not np.isfinite(found.violation) or _price_of_cubes(program, found) <= CUBE_PRICE:
        return found
    other = improve(program, found.x, report, round(BALL_ITERATIONS * program.task.solver.iterations), exact=True)
    if found.feasible and other.feasible:
        least = ORDER_GAIN * max(abs(found.objective), 1e-3)
        return other if other.objective < found.objective - least else found
    return min(found, other, key=_worse)


def _price_of_cubes(program: Program, found: Attempt) -> float:
    """Relative gain of the objective, to first order, were the cubes to hold the balls; without prices inf where a cube
    binds, and 0 where none does."""
    groups = found.evaluated.groups
    balls = [group for group in groups if group.vector is not None]
    near = any((cubed(one).values < CUBE_PRICE * one.limit.value / one.limit.size).any() for one in balls)
    if not near:
        return 0.0
    if program.elastic:
        return np.inf if any(one.slack is not None and one.slack[0] > LEAST_SLACK for one in balls) else 0.0
    if not found.feasible or found.optimum is None or not found.optimum.success:
        return np.inf
    gains = [
        price * (np.sqrt(3) - 1) * group.limit.value / group.limit.size
        for group, price in zip(groups, prices(groups, found.optimum.multipliers), strict=True)
        if group.vector is not None
    ]
    return float(sum(gains) / max(abs(found.objective), 1e-3))


def _worse(one: Attempt) -> tuple[bool, float]:
    return not one.feasible, one.objective if one.feasible else one.violation


# --- joint values of targets: the best of many random ones ------------------------------------------------------------


# Distance (m) from a target that counts as much as a rotation by 1 rad from the pose before. It only breaks ties: among
# configurations whose tips are equally near, the one reached with the least rotation leads to paths without detours.
PER_RADIAN = 5e-3


def with_joints(program: Program, design: Array, random: np.random.Generator) -> Array:
    """A start (X,) with these dimensions (D,), every free pose at the best of random joint values."""
    layout = program.layout
    x = np.clip(np.zeros(layout.size), program.lower, program.upper)
    x[: layout.designs] = design
    if not layout.free_poses:
        return x
    try:
        tubes = layout.space.tubes(design)
    except InputError:
        return x
    joints, poses = _sample(tubes, program.task.robot.joint_limits, random, program.task.solver.poses)
    if not poses:
        return x
    tips = np.array([pose.arm.position[-1] for pose in poses])
    penalty = _outside(program, poses)
    # Before the first target is no pose that tubes would turn from.
    turned = np.zeros(len(poses))
    for index, target in program.targets.items():
        pose = layout.poses[index]
        assert isinstance(pose, FreePose)
        best = int(np.argmin(_gap(tips, target) + penalty + PER_RADIAN * turned))
        turned = np.array([np.abs((row - joints[best])[: layout.n]).max() for row in joints])
        x[layout.joints(pose)[0]], x[layout.joints(pose)[1]] = np.split(joints[best], 2)
        program.guesses[index] = poses[best].twist
    return np.clip(x, program.lower, program.upper)


def _gap(tips: Array, target: tuple[float, ...]) -> Array:
    """Distance of tips (N, 3) from a point, or from a height where that is all that is given."""
    return np.abs(tips[:, 2] - target[0]) if len(target) == 1 else np.linalg.norm(tips - np.array(target), axis=1)


def _sample(
    tubes: tuple[Tube, ...], limits: JointLimits | None, random: np.random.Generator, count: int
) -> tuple[list[Array], list[Pose]]:
    """Joint values (2 n,), rotations then beta, with carriages and ends in order, within the limits of translations
    where that leaves a range, and their poses."""
    n = len(tubes)
    length = np.array([tube.length for tube in tubes])
    straight = np.array([tube.straight_length for tube in tubes])
    joints: list[Array] = []
    poses: list[Pose] = []
    for _ in range(count):
        rotations = random.uniform(-np.pi, np.pi, n)
        beta = np.zeros(n)
        ahead, behind = 0.0, 0.0
        for i in reversed(range(n)):
            # beta_i <= beta_{i+1}, end_i >= end_{i+1}
            low, high = max(-length[i] + behind, -length[i]), ahead
            if limits is not None:
                first, last = np.array(limits.translations[i]) - straight[i]
                low, high = max(low, first), min(high, last)
            beta[i] = random.uniform(low, high) if high > low else high
            ahead, behind = beta[i], max(beta[i] + length[i], 0.0)
        try:
            solved = solve_pose(tubes, rotations, beta + straight)
        except (InputError, SolveError):
            continue
        if solved.margin > 0:
            joints.append(np.concatenate([rotations, beta]))
            poses.append(Pose(solved))
    return joints, poses


def _outside(program: Program, poses: Sequence[Pose]) -> Array:
    """(N,) how far, m, the worst point of each arm is where it must not be."""
    out = np.zeros(len(poses))
    for one in program.task.requirements:
        for k, pose in enumerate(poses):
            if isinstance(one, Avoid):
                out[k] += max(0.0, one.clearance - float(one.signed_distance(pose.arm.position).min()))
    return out


# --- least squares to a feasible design -------------------------------------------------------------------------------


# Steps inside every limit that least squares aim for, since IPOPT needs a start in the interior: on the limits
# themselves it moves the start by its own rule, far from feasible where limits are many.
INTERIOR = 1e-3


def to_feasibility(program: Program, start: Array, report: Report | None = None) -> Array:
    """Least squares of the violations from a start: Gauss and Newton in a trust region within the bounds."""
    scale = program.scale
    lower, upper = program.lower / scale, program.upper / scale
    fixed = upper - lower < 1e-12
    begin = _settle_auxiliary(program, start) / scale
    move = np.flatnonzero(~fixed)
    rows_count = 0
    # scipy asks for values and Jacobian apart, while one evaluation has both.
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
            # scipy's trust region shrinks after a step to values that are not finite.
            return np.full(rows_count, np.nan)
        gap, jacobian = _shortfall(found, INTERIOR)
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
            # A direction changes by what the vector changes by across it, over its length.
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
        # A thousandth of the scale inside, since IPOPT needs a start in the interior.
        step = float(room.min()) - 1e-3 * program.scale[column]
        x[column] -= KINDS[name].sign * step
    return np.clip(x, program.lower, program.upper)


# --- IPOPT to the optimum ---------------------------------------------------------------------------------------------


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
    iterations = program.task.solver.iterations if iterations is None else iterations
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
        # In units of the objective at the start, so that IPOPT's tolerance is relative.
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


def _folded(optimum: Optimum, groups: list[Rows]) -> Optimum:
    """The optimum with one multiplier for the six sides of every cube: the price of moving them all."""
    sides = [1 if group.vector is None else 6 for group in groups]
    counts = [each * len(group.values) for each, group in zip(sides, groups, strict=True)]
    *parts, rest = np.split(optimum.multipliers, np.cumsum(counts))
    of_cubes = [part.reshape(-1, each).sum(1) for each, part in zip(sides, parts, strict=True)]
    return replace(optimum, multipliers=np.concatenate([*of_cubes, rest]))


# --- orders of breakpoints --------------------------------------------------------------------------------------------


# Relative gain below which another order of breakpoints is no better: the tolerance of IPOPT. Less would cycle.
ORDER_GAIN = 1e-7


# Lengths, m. Below the first a section between breakpoints is closed: IPOPT ends within 1e-6 of a limit, in steps of
# 10 mm. The second opens it on the other side of the kink: large enough to be off the kink, small enough to keep the
# design feasible to the tolerance of its limits.
CLOSED_SECTION, OPENED_SECTION = 1e-5, 2e-6


@dataclass(frozen=True)
class Order:
    """Order of the breakpoints of one pose or certificate: those beyond the plate, base to tip, and those behind it.

    Breakpoint 2 i is the transition of tube i, 2 i + 1 its end.
    """

    beyond: tuple[int, ...]
    behind: tuple[int, ...]


Cell = tuple[Order, ...]
"""An order for every pose, then for every translation of the certificate."""


def _breakpoints(state: State, k: int) -> tuple[Array, Array]:
    """Places (2 n,) of the breakpoints of one pose or certificate, m, and their change (2 n, X)."""
    layout = state.layout
    if k < len(layout.poses):
        transition, moved = state.joint_values(k)[1], state.joint_slopes(k)[1]
    else:
        transition = np.array(layout.certified[k - len(layout.poses)])
        moved = np.zeros((layout.n, layout.size))
    curved = np.array([tube.curved_length for tube in state.tubes])
    places = np.stack([transition, transition + curved], axis=1).ravel()
    slopes = np.stack([moved, moved + state.slopes["curved_length"]], axis=1)
    return places, slopes.reshape(-1, layout.size)


def cell_of(state: State) -> Cell:
    """The orders in which breakpoints are."""
    orders = []
    for k in range(len(state.layout.poses) + len(state.layout.certified)):
        places, _ = _breakpoints(state, k)
        ranked = np.argsort(places, kind="stable").tolist()
        orders.append(Order(tuple(i for i in ranked if places[i] > 0), tuple(i for i in ranked if places[i] <= 0)))
    return tuple(orders)


class Sections(NamedTuple):
    """Sections of a cell that can change."""

    lengths: Array
    """(K,) in steps of 10 mm, >= 0 in the cell."""
    slopes: Array
    """(K, X)."""
    ends: list[tuple[int, int, int]]
    """Pose, and breakpoints before and behind; -1 for the plate."""


def cell_rows(state: State, cell: Cell) -> Sections:
    """Sections of a cell as constraints: with a fixed order of breakpoints their lengths are >= 0."""
    values, slopes, what = [], [], []
    for k, order in enumerate(cell):
        places, moved = _breakpoints(state, k)
        places, moved = np.append(places, 0.0), np.vstack([moved, np.zeros(moved.shape[1])])
        pairs = [*pairwise((-1, *order.beyond)), *((i, -1) for i in order.behind)]
        for a, b in pairs:
            slope = moved[b] - moved[a]
            if np.abs(slope).max() > 1e-12:
                values.append((places[b] - places[a]) / 1e-2)
                slopes.append(slope / 1e-2)
                what.append((k, a, b))
    return Sections(np.array(values), np.reshape(slopes, (len(values), state.layout.size)), what)


def swapped(cell: Cell, pose: int, a: int, b: int) -> Cell:
    """The cell beyond the kink where breakpoints a and b of a pose meet."""
    order = cell[pose]
    if a == -1:
        other = Order(order.beyond[1:], (*order.behind, b))
    elif b == -1:
        other = Order((a, *order.beyond), tuple(i for i in order.behind if i != a))
    else:
        k = order.beyond.index(a)
        other = Order((*order.beyond[:k], b, a, *order.beyond[k + 2 :]), order.behind)
    return (*cell[:pose], other, *cell[pose + 1 :])


def _through_cells(start: Attempt, report: Report | None) -> Attempt:
    """The optimum in the cell of a start, then in its neighbours for as long as they are better."""
    program, cell = start.program, cell_of(start.state)
    best = _in_cell(program, start.x, cell, report)
    tried = {cell}
    for _ in range(program.task.solver.orders):
        lengths, slopes, ends = cell_rows(best.state, cell)
        if not best.feasible or not ends:
            break
        prices = np.zeros(len(lengths)) if best.optimum is None else best.optimum.multipliers[-len(lengths) :]
        # Only a closed section whose constraint has a price would rather be passed.
        closed = [k for k in np.argsort(-prices) if lengths[k] * 1e-2 < CLOSED_SECTION and prices[k] > 1e-8]
        better = None
        for k in closed:
            other = swapped(cell, *ends[k])
            if other in tried:
                continue
            tried.add(other)
            begin = _across(program, best.x, lengths[k], slopes[k])
            found = _in_cell(program, begin, other, report)
            if found.feasible and found.objective < best.objective - ORDER_GAIN * max(abs(best.objective), 1e-3):
                better = other, found
                break
        if better is None:
            break
        cell, best = better
    return replace(best, program=program)


def _in_cell(program: Program, start: Array, cell: Cell, report: Report | None) -> Attempt:
    """The optimum in one cell."""

    def rows(state: State) -> tuple[Array, Array]:
        return cell_rows(state, cell)[:2]

    found = improve(program, start, report, rows=rows)
    if program.layout.free_poses or (found.optimum is not None and found.optimum.success):
        return found
    other = improve(program, start, report, rows=rows, strategy="patient")
    return min(found, other, key=lambda one: (not one.feasible, one.objective))


def _across(program: Program, x: Array, value: float, slope: Array) -> Array:
    """x moved as little as possible to where a section is open on the other side."""
    scaled = slope * program.scale
    # Along the gradient of the section's length in scaled unknowns: the shortest step that opens it.
    step = -(value + OPENED_SECTION / 1e-2) / float(scaled @ scaled)
    return np.clip(x + step * scaled * program.scale, program.lower, program.upper)


# Random dimensions per start; only those whose tubes nest and fit become starts, which random diameters rarely do.
DESIGNS_PER_START = 32

# Steps of their scale. Far above the tolerance to which starts reach one optimum, far below what can be made.
SAME_DESIGN = 1e-3

# Where no design was looked at.
NOTHING = "a first design, which time did not suffice for"


@dataclass(frozen=True, eq=False)
class Ranking:
    """What became of all starts."""

    designs: tuple[Attempt, ...]
    """Feasible ones, the best first, each once."""
    found: tuple[int, ...]
    """From how many starts each was reached."""
    failures: dict[str, int]
    """How many starts ended infeasible, by the limit violated most."""
    failed: tuple[Attempt, ...]
    """Where, the least violated first."""

    late: int = 0
    """How many starts a time limit ended."""

    @property
    def starts(self) -> int:
        """Number of starts."""
        return sum(self.found) + sum(self.failures.values())


def solve_from(program: Program, start: Array, report: Report | None = None, *, keep: bool = False) -> Attempt:
    """`solve` on a copy of the program that remembers no poses of other starts, unless it is to `keep` them; the best
    on its way where a time limit ends it."""
    # With poses of other starts as guesses a design would depend on the order of starts.
    own = program if keep else replace(program, guesses={})
    try:
        return solve(own, start, report)
    except LateError:
        return cut_short(own)


def cut_short(program: Program) -> Attempt:
    """The best design that a search had passed when its time was over."""
    best = program.lately.best
    if best is None:
        return Attempt(program, program.lower, np.inf, np.inf, NOTHING, None, late=True)
    x = np.clip(best.x, program.lower, program.upper)
    return Attempt(program, x, best.objective, best.violation, best.worst, None, late=True)


def rank(attempts: Sequence[Attempt]) -> Ranking:
    """Feasible designs in order, duplicates merged; the others counted."""
    designs: list[Attempt] = []
    found: list[int] = []
    for one in sorted((a for a in attempts if a.feasible), key=lambda a: a.objective):
        k = next((k for k, other in enumerate(designs) if _same(one, other)), None)
        if k is None:
            designs.append(one)
            found.append(1)
        else:
            found[k] += 1
    failed = sorted((a for a in attempts if not a.feasible), key=lambda a: a.violation)
    failures = Counter(a.worst for a in failed)
    late = sum(a.late for a in attempts)
    return Ranking(tuple(designs), tuple(found), dict(failures.most_common()), tuple(failed), late)


def _same(a: Attempt, b: Attempt) -> bool:
    count = a.program.layout.designs
    gap = np.abs(a.x[:count] - b.x[:count]) / a.program.scale[:count]
    return bool(gap.max() < SAME_DESIGN)


def multistart(
    program: Program,
    *,
    starts: int = 1,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Ranking:
    """Solve from the task's own dimensions and from `starts` - 1 others, on so many processes; with one only, `report`
    is told of every iteration. `seed` is of the other dimensions and of the first joint values."""
    begin, workers = start_values(program, seed, starts), min(workers, starts)
    one = partial(solve_from, program, report=report if workers == 1 else None)
    with executor(workers) as pool:
        return rank(run_all(one, begin, pool, progress))


def start_values(program: Program, seed: int, count: int) -> list[Array]:
    """`count` starts x (X,), SI: the first at the task's own dimensions, the others from a scrambled Sobol sequence."""
    layout = program.layout
    space = layout.space
    if count == 1:
        return [with_joints(program, space.start, np.random.default_rng([seed, 0]))]
    unit = sobol(layout.designs, DESIGNS_PER_START * count, seed)
    drawn = [space.lower + row * (space.upper - space.lower) for row in unit]
    # Dimensions of tubes that make a robot come first.
    designs = [space.start, *sorted(drawn, key=lambda design: not _makes_robot(program, design))]
    return [with_joints(program, design, np.random.default_rng([seed, k])) for k, design in enumerate(designs[:count])]


@without_unit_warnings()
def _makes_robot(program: Program, design: Array) -> bool:
    try:
        replace(program.task.robot, tubes=program.layout.space.tubes(design), joint_limits=None)
    except InputError:
        return False
    return True
