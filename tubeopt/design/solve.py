"""Solve a design program from one start or many.

A start has the dimensions of a design and, for every target, the best of many random joint values. Least squares find
a feasible design, IPOPT the optimum.

The program is smooth within one order of breakpoints, and has a kink where a section between two of them closes. Optima
often lie on kinks: two tubes that end together, a transition just at the plate. No gradient method converges there. So
the order is fixed, which makes the lengths of the sections constraints. At the optimum, the order is swapped where the
multiplier of a closed section shows that the objective decreases beyond it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from ..errors import InputError, SolveError, without_unit_warnings
from ..robots.eccentric import BundleRobot
from ..robots.limits import JointLimits
from ..robots.order import demands, in_order, translation_ranges
from ..robots.robot import Robot
from ..solvers.ipopt import Values, minimise, nowhere
from ..solvers.parallel import executor, run_all
from ..solvers.sampling import sobol
from ..solvers.time_limit import OutOfTimeError
from ..typing import Array, Progress
from .evaluation import FEASIBLE, Attempt, Evaluated, MoreRows, Report, attempt, cubed, evaluate, prices, squared
from .objectives import KINDS
from .pose import AnyPose, draft, posed
from .program import BOUNDED, Program
from .requirements import Avoid, of_kind
from .state import DesignState, FreePose

# Steps of a limit. The sum of slacks is an L1 norm, whose optimum has most of them at 0 up to the tolerance of IPOPT.
SLACK_TOLERANCE = 1e-5


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
    """Best design from a start (X,), SI: feasible by least squares, then optimal by IPOPT."""
    x = to_feasibility(program, np.clip(start, program.lower, program.upper), report)
    best = attempt(program, x)
    # Dimensions stay where least squares left them; joint values alone are drawn again.
    for kick in range(POSE_RESTARTS if program.layout.free_poses else 0):
        if best.violation <= NEARLY_FEASIBLE:
            break
        random = np.random.default_rng([kick, program.layout.size])
        redrawn = with_joints(program, best.x[: program.layout.designs], random)
        x = to_feasibility(program, redrawn, report)
        best = min(best, attempt(program, x), key=lambda end: end.violation)
    return best if best.violation > NEARLY_FEASIBLE else best_from(program, best.x, report)


def best_from(program: Program, x: Array, report: Report | None = None) -> Attempt:
    """Optimum from a design that is nearly feasible.

    Targets are first kept in cubes inside their tolerances, on which IPOPT is quicker and ends at better optima. Where
    these cost something, a second run has the whole balls.
    """
    in_cubes = _optimum_in_cubes(program, x, report)
    if not np.isfinite(in_cubes.violation) or _price_of_cubes(program, in_cubes) <= CUBE_PRICE:
        return in_cubes
    iterations = round(BALL_ITERATIONS * program.task.solver.iterations)
    in_balls = improve(program, in_cubes.x, report, iterations, exact=True)
    if in_cubes.feasible and in_balls.feasible:
        gain = ORDER_GAIN * max(abs(in_cubes.objective), 1e-3)
        return in_balls if in_balls.objective < in_cubes.objective - gain else in_cubes
    return min(in_cubes, in_balls, key=_rank)


def _optimum_in_cubes(program: Program, x: Array, report: Report | None) -> Attempt:
    """Optimum by IPOPT across changes of the breakpoint order; if that fails, in one order after the other."""
    optimum = improve(program, x, report)
    if optimum.feasible and optimum.optimum is not None and optimum.optimum.success:
        return optimum
    # The start too, since IPOPT may end worse than it began where it does not converge.
    candidates = [optimum, attempt(program, x)]
    if np.isfinite(optimum.violation) and not optimum.feasible:
        # IPOPT ended just outside.
        x = to_feasibility(program, optimum.x, report)
        candidates.append(attempt(program, x))
    best = min(candidates, key=_rank)
    # Sections of a bundle end where its shape decides; they have no order to search.
    if not program.task.robot.fixed_sections:
        return best
    return min(best, _through_cells(best, report), key=_rank)


def _price_of_cubes(program: Program, in_cubes: Attempt) -> float:
    """Relative improvement of the objective, to first order, with balls instead of the inscribed cubes.

    Without multipliers infinite if a cube is active, else 0.
    """
    groups = in_cubes.evaluated.groups
    balls = [group for group in groups if group.vector is not None]
    is_close = any((cubed(group).values < CUBE_PRICE * group.limit.value / group.limit.size).any() for group in balls)
    if not is_close:
        return 0.0
    if program.elastic:
        return np.inf if any(group.slack is not None and group.slack[0] > SLACK_TOLERANCE for group in balls) else 0.0
    if not in_cubes.feasible or in_cubes.optimum is None or not in_cubes.optimum.success:
        return np.inf
    gains = [
        price * (np.sqrt(3) - 1) * group.limit.value / group.limit.size
        for group, price in zip(groups, prices(groups, in_cubes.optimum.multipliers), strict=True)
        if group.vector is not None
    ]
    return float(sum(gains) / max(abs(in_cubes.objective), 1e-3))


def _rank(end: Attempt) -> tuple[bool, float]:
    """Sort key: feasible designs first, by objective, then the others by violation."""
    return not end.feasible, end.objective if end.feasible else end.violation


# --- joint values of targets: the best of many random ones ------------------------------------------------------------


# Distance (m) from a target that counts as much as a rotation by 1 rad from the pose before. It only breaks ties: among
# configurations whose tips are equally near, the one reached with the least rotation leads to paths without detours.
PER_RADIAN = 5e-3


def with_joints(program: Program, design: Array, random: np.random.Generator) -> Array:
    """Start (X,) with dimensions (D,) and every free pose at the best of random joint values."""
    layout = program.layout
    x = np.clip(np.zeros(layout.size), program.lower, program.upper)
    x[: layout.designs] = design
    if not layout.free_poses:
        return x
    try:
        robot = draft(layout.space, design)
    except InputError:
        return x
    joints, poses = _sample(robot, program.task.robot.joint_limits, random, program.task.solver.poses)
    if not poses:
        return x
    tips = np.array([pose.arm.position[-1] for pose in poses])
    # Penetration of the worst point of each arm into obstacles, m.
    penalty = np.zeros(len(poses))
    for avoid in of_kind(program.task.requirements, Avoid):
        depth = [avoid.clearance - float(avoid.signed_distance(pose.arm.position).min()) for pose in poses]
        penalty += np.maximum(0.0, depth)
    # The first target has no pose before it.
    turned = np.zeros(len(poses))
    for index, target in program.targets.items():
        pose = layout.poses[index]
        assert isinstance(pose, FreePose)
        # A target of one number is a height.
        offsets = tips[:, 2:] - target[0] if len(target) == 1 else tips - np.array(target)
        distance = np.linalg.norm(offsets, axis=1)
        best = int(np.argmin(distance + penalty + PER_RADIAN * turned))
        turned = np.array([np.abs((row - joints[best])[: layout.n]).max() for row in joints])
        x[layout.joints(pose)[0]], x[layout.joints(pose)[1]] = np.split(joints[best], [layout.n])
        program.guesses[index] = poses[best].guess
    return np.clip(x, program.lower, program.upper)


def _sample(
    robot: Robot, limits: JointLimits | None, random: np.random.Generator, count: int
) -> tuple[list[Array], list[AnyPose]]:
    """Random joint values (n + C,), rotations then beta of the carriages, and their stable poses.

    Carriages and ends are in order, and within the limits of translations where these leave a range.
    """
    tubes, n = robot.tubes, robot.n_tubes
    length = np.array([tube.length for tube in tubes])
    straight = np.array([tube.straight_length for tube in tubes])
    joints: list[Array] = []
    poses: list[AnyPose] = []
    first = [group[0] for group in robot.moving_together]
    for _ in range(count if isinstance(robot, BundleRobot) else 0):
        rotations = random.uniform(-np.pi, np.pi, n)
        with suppress(InputError, SolveError):
            ranges = translation_ranges(tubes, robot.limits)
            # At the ends of a range that round-off has closed, there is nothing to draw.
            shift = in_order(robot, ranges, demands(robot), lambda low, high: random.uniform(low, max(low, high)))
            if shift is None:
                break
            pose = posed(robot, rotations, shift)
            if pose.margin > 0:
                joints.append(np.concatenate([rotations, (shift - straight)[first]]))
                poses.append(pose)
    for _ in range(0 if isinstance(robot, BundleRobot) else count):
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
            pose = posed(robot, rotations, beta + straight)
        except (InputError, SolveError):
            continue
        if pose.margin > 0:
            joints.append(np.concatenate([rotations, beta]))
            poses.append(pose)
    return joints, poses


# --- least squares to a feasible design -------------------------------------------------------------------------------


# Steps inside every limit that least squares aim for, since IPOPT needs a start in the interior: on the limits
# themselves it moves the start by its own rule, far from feasible where limits are many.
INTERIOR = 1e-3


def to_feasibility(program: Program, start: Array, report: Report | None = None) -> Array:
    """Feasible unknowns (X,) near a start, by least squares of the violations in a trust region within the bounds."""
    scale = program.scale
    lower, upper = program.lower / scale, program.upper / scale
    fixed = upper - lower < 1e-12
    x0 = _settle_auxiliary(program, start) / scale
    move = np.flatnonzero(~fixed)
    rows_count = 0
    # scipy asks for values and Jacobian apart, while one evaluation has both.
    slope: dict[bytes, Array] = {}

    def full(part: Array) -> Array:
        x = x0.copy()
        x[move] = part
        return x * scale

    def residual(part: Array) -> Array:
        """Violations (r,) at the free unknowns `part`; NaN without an equilibrium."""
        nonlocal rows_count
        evaluated = evaluate(program, full(part))
        if evaluated is None:
            # scipy's trust region shrinks after a step to values that are not finite.
            return np.full(rows_count, np.nan)
        shortfall, jacobian = _shortfall(evaluated, INTERIOR)
        rows_count = len(shortfall)
        slope.clear()
        slope[part.tobytes()] = jacobian[:, move] * scale[move]
        evaluated.note()
        if report is not None:
            report("feasibility", evaluated.violation[0])
        return shortfall

    def jacobian(part: Array) -> Array:
        if part.tobytes() not in slope:
            residual(part)
        return slope[part.tobytes()]

    if evaluate(program, full(x0[move])) is None:
        return start
    inside = np.clip(x0[move], lower[move] + 1e-9, upper[move] - 1e-9)
    missed = residual(inside)
    if not np.isfinite(missed).all() or not missed.any():
        return full(inside)
    result = scipy.optimize.least_squares(
        residual, inside, jacobian, bounds=(lower[move], upper[move]), x_scale="jac", max_nfev=150, ftol=1e-10,
        xtol=1e-10, gtol=1e-10,
    )  # fmt: skip
    return _settle_auxiliary(program, full(result.x))


def _shortfall(evaluated: Evaluated, inside: float) -> tuple[Array, Array]:
    """Violation of rows that must be at least `inside` steps, and its derivative; for a limited vector, along the
    vector.
    """
    values, slopes = [], []
    for group in evaluated.groups:
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
    fixed = np.minimum(evaluated.fixed[0] - inside, 0.0)
    return np.concatenate([*values, fixed]), np.concatenate([*slopes, evaluated.fixed[1] * (fixed < 0)[:, None]])


def _settle_auxiliary(program: Program, x: Array) -> Array:
    """Unknowns with auxiliary ones at their smallest feasible values."""
    x = x.copy()
    names = [name for name in program.layout.auxiliary if name in BOUNDED]
    for name in names:
        column = program.layout.column(name)
        x[column] = program.upper[column] if KINDS[name].sign > 0 else program.lower[column]
    evaluated = evaluate(program, x) if names else None
    if evaluated is None:
        return x
    values, slopes = evaluated.fixed
    for name in names:
        column = program.layout.column(name)
        mine = slopes[:, column] != 0
        distance = values[mine] / np.abs(slopes[mine, column])
        # A thousandth of the scale inside, since IPOPT needs a start in the interior.
        step = float(distance.min()) - 1e-3 * program.scale[column]
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
    """Optimum by IPOPT from a nearly feasible start, or the start if it has no equilibrium.

    Args:
        rows: further constraints, >= 0 if satisfied.
        strategy: one of `solvers.ipopt.STRATEGIES`.
        exact: limit distances from targets by balls, not by the cubes inside them.
    """
    iterations = program.task.solver.iterations if iterations is None else iterations
    form = squared if exact else cubed
    scale = program.scale
    known = evaluate(program, start)
    if known is None:
        return attempt(program, start)
    count, size = len(known.rows(form, rows)[0]), known.size
    best: list[tuple[float, Array]] = []

    def values(x: Array) -> Values:
        """Objective and constraints at scaled unknowns x (k,), with derivatives; keeps the best feasible x."""
        evaluated = evaluate(program, x * scale)
        if evaluated is None:
            return nowhere(count, len(x))
        f, slope = evaluated.objective
        g, jacobian = evaluated.rows(form, rows)
        if g.min(initial=0.0) >= -FEASIBLE and (not best or f < best[0][0]):
            best[:] = [(f, x * scale)]
            evaluated.note()
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
        # One multiplier for the six sides of every cube: the price of moving them all.
        sides = [1 if group.vector is None else 6 for group in known.groups]
        counts = [each * len(group.values) for each, group in zip(sides, known.groups, strict=True)]
        *parts, fixed = np.split(optimum.multipliers, np.cumsum(counts))
        of_cubes = [part.reshape(-1, each).sum(1) for each, part in zip(sides, parts, strict=True)]
        optimum = replace(optimum, multipliers=np.concatenate([*of_cubes, fixed]))
    reached = attempt(program, optimum.x, optimum)
    if optimum.success or not best or (reached.feasible and reached.objective <= best[0][0]):
        return reached
    # Where IPOPT cycles, it has passed a better design.
    inside = np.clip(best[0][1], program.lower, program.upper)
    return attempt(program, inside, replace(optimum, x=inside))


# --- orders of breakpoints --------------------------------------------------------------------------------------------


# Relative gain below which another order of breakpoints is no better: the tolerance of IPOPT. Less would cycle.
ORDER_GAIN = 1e-7


# Lengths, m. Below the first a section between breakpoints is closed: IPOPT ends within 1e-6 of a limit, in steps of
# 10 mm. The second opens it on the other side of the kink: large enough to be off the kink, small enough to keep the
# design feasible to the tolerance of its limits.
CLOSED_SECTION, OPENED_SECTION = 1e-5, 2e-6


@dataclass(frozen=True)
class PoseOrder:
    """Breakpoint order of one pose or certificate: in front of the plate, base to tip, and behind it.

    Breakpoint 2 i is the transition of tube i, 2 i + 1 its end.
    """

    beyond: tuple[int, ...]
    behind: tuple[int, ...]


Cell = tuple[PoseOrder, ...]
"""Order of breakpoints of every pose, then of every translation of the certificate."""


def _breakpoints(state: DesignState, k: int) -> tuple[Array, Array]:
    """Places (2 n,) of the breakpoints of one pose or certificate, m, and their derivatives (2 n, X)."""
    layout = state.layout
    if k < len(layout.poses):
        transition, moved = state.joint_values(k)[1], state.joint_slopes(k)[1]
    else:
        transition = np.array(layout.certified[k - len(layout.poses)])
        moved = np.zeros((layout.n, layout.size))
    curved = np.array([tube.curved_length for tube in state.tubes])
    positions = np.stack([transition, transition + curved], axis=1).ravel()
    slopes = np.stack([moved, moved + state.slopes["curved_length"]], axis=1)
    return positions, slopes.reshape(-1, layout.size)


def cell_of(state: DesignState) -> Cell:
    """Breakpoint orders of all poses and certificates at a state."""
    orders = []
    for k in range(len(state.layout.poses) + len(state.layout.certified)):
        positions, _ = _breakpoints(state, k)
        ranked = np.argsort(positions, kind="stable").tolist()
        orders.append(
            PoseOrder(tuple(i for i in ranked if positions[i] > 0), tuple(i for i in ranked if positions[i] <= 0))
        )
    return tuple(orders)


class SectionEnds(NamedTuple):
    """Breakpoints at both ends of a section; -1 is the plate."""

    pose: int
    proximal: int
    distal: int


class Sections(NamedTuple):
    """Sections of a cell with lengths that depend on unknowns."""

    lengths: Array
    """Lengths (K,) in steps of 10 mm, >= 0 in the cell."""
    slopes: Array
    """Derivatives (K, X) of the lengths."""
    ends: list[SectionEnds]
    """Breakpoints of each section."""


def cell_rows(state: DesignState, cell: Cell) -> Sections:
    """Sections of a cell as constraints: with a fixed order of breakpoints their lengths are >= 0."""
    values, slopes, ends = [], [], []
    for k, order in enumerate(cell):
        positions, moved = _breakpoints(state, k)
        positions, moved = np.append(positions, 0.0), np.vstack([moved, np.zeros(moved.shape[1])])
        pairs = [*pairwise((-1, *order.beyond)), *((i, -1) for i in order.behind)]
        for a, b in pairs:
            slope = moved[b] - moved[a]
            if np.abs(slope).max() > 1e-12:
                values.append((positions[b] - positions[a]) / 1e-2)
                slopes.append(slope / 1e-2)
                ends.append(SectionEnds(k, a, b))
    return Sections(np.array(values), np.reshape(slopes, (len(values), state.layout.size)), ends)


def swapped(cell: Cell, pose: int, a: int, b: int) -> Cell:
    """Breakpoint order after breakpoints a and b of a pose are swapped."""
    order = cell[pose]
    if a == -1:
        swap = PoseOrder(order.beyond[1:], (*order.behind, b))
    elif b == -1:
        swap = PoseOrder((a, *order.beyond), tuple(i for i in order.behind if i != a))
    else:
        k = order.beyond.index(a)
        swap = PoseOrder((*order.beyond[:k], b, a, *order.beyond[k + 2 :]), order.behind)
    return (*cell[:pose], swap, *cell[pose + 1 :])


def _through_cells(start: Attempt, report: Report | None) -> Attempt:
    """Optimum in the breakpoint order of a start, then in neighbouring orders while these are better."""
    program, cell = start.program, cell_of(start.state)
    best = _in_cell(program, start.x, cell, report)
    tried = {cell}
    for _ in range(program.task.solver.orders):
        lengths, slopes, ends = cell_rows(best.state, cell)
        if not best.feasible or not ends:
            break
        prices = np.zeros(len(lengths)) if best.optimum is None else best.optimum.multipliers[-len(lengths) :]
        # Beyond a closed section the objective decreases only if its constraint has a multiplier.
        closed = [k for k in np.argsort(-prices) if lengths[k] * 1e-2 < CLOSED_SECTION and prices[k] > 1e-8]
        for k in closed:
            neighbour = swapped(cell, *ends[k])
            if neighbour in tried:
                continue
            tried.add(neighbour)
            # The shortest step in scaled unknowns that opens the section on the other side: along the gradient of its
            # length.
            slope = slopes[k] * program.scale
            step = -(lengths[k] + OPENED_SECTION / 1e-2) / float(slope @ slope)
            across = np.clip(best.x + step * slope * program.scale, program.lower, program.upper)
            optimum = _in_cell(program, across, neighbour, report)
            if optimum.feasible and optimum.objective < best.objective - ORDER_GAIN * max(abs(best.objective), 1e-3):
                cell, best = neighbour, optimum
                break
        else:
            break
    return replace(best, program=program)


def _in_cell(program: Program, start: Array, cell: Cell, report: Report | None) -> Attempt:
    """Optimum within one order of breakpoints."""

    def rows(state: DesignState) -> tuple[Array, Array]:
        return cell_rows(state, cell)[:2]

    optimum = improve(program, start, report, rows=rows)
    if program.layout.free_poses or (optimum.optimum is not None and optimum.optimum.success):
        return optimum
    patient = improve(program, start, report, rows=rows, strategy="patient")
    return min(optimum, patient, key=lambda end: (not end.feasible, end.objective))


# Random dimensions per start; only those whose tubes nest and fit become starts, which random diameters rarely do.
DESIGNS_PER_START = 32

# Steps of their scale. Far above the tolerance to which starts reach one optimum, far below what can be made.
SAME_DESIGN = 1e-3

# Name of the violated limit if no design was evaluated.
NOTHING = "a first design, which time did not suffice for"


@dataclass(frozen=True, eq=False)
class Ranking:
    """Designs of all starts, ranked, and failures counted by the limit violated most."""

    designs: tuple[Attempt, ...]
    """Feasible designs, the best first, each once."""
    found: tuple[int, ...]
    """Number of starts that reached each design."""
    failures: dict[str, int]
    """Number of infeasible starts, by the limit violated most."""
    failed: tuple[Attempt, ...]
    """Final designs of infeasible starts, the smallest violation first."""

    out_of_time: int = 0
    """Number of starts that a time limit ended."""
    rounds: int = 0
    """Number of rounds that added worst cases to the best design."""

    @property
    def starts(self) -> int:
        """Number of starts, feasible or not."""
        return sum(self.found) + sum(self.failures.values())


def solve_from(program: Program, start: Array, report: Report | None = None, *, keep: bool = False) -> Attempt:
    """Best design from a start, or the best one up to now if a time limit ends the search.

    With poses of other starts as guesses, a design would depend on the order of starts: it is solved without them
    unless `keep` is set.
    """
    program_alone = program if keep else replace(program, guesses={})
    try:
        return solve(program_alone, start, report)
    except OutOfTimeError:
        best = program_alone.lately.best
        if best is None:
            return Attempt(
                program=program_alone,
                x=program_alone.lower,
                objective=np.inf,
                violation=np.inf,
                worst=NOTHING,
                optimum=None,
                out_of_time=True,
            )
        x = np.clip(best.x, program_alone.lower, program_alone.upper)
        return Attempt(program_alone, x, best.objective, best.violation, best.worst, None, out_of_time=True)


def rank(attempts: Sequence[Attempt]) -> Ranking:
    """Feasible designs in order, duplicates merged; the others counted."""
    designs: list[Attempt] = []
    counts: list[int] = []
    for end in sorted((a for a in attempts if a.feasible), key=lambda a: a.objective):
        k = next((k for k, design in enumerate(designs) if _same(end, design)), None)
        if k is None:
            designs.append(end)
            counts.append(1)
        else:
            counts[k] += 1
    failed = sorted((a for a in attempts if not a.feasible), key=lambda a: a.violation)
    failures = Counter(a.worst for a in failed)
    timed_out = sum(a.out_of_time for a in attempts)
    return Ranking(tuple(designs), tuple(counts), dict(failures.most_common()), tuple(failed), timed_out)


def _same(a: Attempt, b: Attempt) -> bool:
    count = a.program.layout.designs
    distance = np.abs(a.x[:count] - b.x[:count]) / a.program.scale[:count]
    return bool(distance.max() < SAME_DESIGN)


def multistart(
    program: Program,
    *,
    starts: int = 1,
    seed: int = 0,
    workers: int = 1,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Ranking:
    """Designs from the dimensions of the task and from `starts` - 1 random start dimensions.

    Args:
        seed: random seed of the dimensions and of the first joint values.
        workers: number of processes.
        report: called after every iteration, with one worker only.
    """
    values, workers = start_values(program, seed, starts), min(workers, starts)
    solve_start = partial(solve_from, program, report=report if workers == 1 else None)
    with executor(workers) as pool:
        return rank(run_all(solve_start, values, pool, progress))


def start_values(program: Program, seed: int, count: int) -> list[Array]:
    """`count` starts x (X,), SI: the first at the task's own dimensions, the others from a scrambled Sobol sequence."""
    layout = program.layout
    space = layout.space
    if count == 1:
        return [with_joints(program, space.start, np.random.default_rng([seed, 0]))]
    unit = sobol(layout.designs, DESIGNS_PER_START * count, seed)
    drawn = [space.lower + row * (space.upper - space.lower) for row in unit]
    # Dimensions of tubes that nest come first.
    designs = [space.start, *sorted(drawn, key=lambda design: not _nests(program, design))]
    return [with_joints(program, design, np.random.default_rng([seed, k])) for k, design in enumerate(designs[:count])]


@without_unit_warnings()
def _nests(program: Program, design: Array) -> bool:
    """True if dimensions make tubes that nest."""
    try:
        replace(program.task.robot, **program.layout.space.fields(design), joint_limits=None)
    except InputError:
        return False
    return True
