"""Smoothing: the best motion near a path, by direct collocation over time with one equilibrium block at every knot.

Time runs from 0 to 1; the duration T is an unknown. Unknowns at every knot are the joint values q, their rates
q' = T dq/dt, and the tip rotations z, in which the equilibrium block is explicit (see `explicit`): its equations are

    alpha(z_k, d_k) = rotations of q_k,   fields(z_k, d_k, margin) > 0.

Between knots q is cubic, so q'' is linear and q' is quadratic, and the bounds

    |q'| <= rate sqrt(S)   (on the three Bezier coefficients),   |q''| <= acceleration S   (at both ends)

hold everywhere, and are convex in the square of the duration, S = T^2. Length, int |q'|^2, and effort, int |q''|^2, are
quadratic in q and q'. Joint values alone could jump between knots to another branch with the same joint values. So the
change of the tip rotations per interval is bounded, and their motion is part of the length. The Hessian for IPOPT is
exact except for the curvature of the equilibrium, of active margins and of obstacles. Blocks and their derivatives are
mapped over the knots: CasADi by itself would pass through all knots once for every unknown of an equation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..block.quantities import Expression
from ..block.transcription.explicit import Kind, explicit_arm, explicit_joints
from ..bodies.obstacles import Obstacle
from ..equilibrium.result import Equilibrium
from ..inverse.clock import Clock
from ..inverse.task import ArmBatch, TipCoordinates
from ..solvers.settings import NO_SENSITIVITIES
from ..typing import Array
from .knots import (
    MAX_NODES,
    SPLITS,
    TABLES,
    Cubics,
    KnotFunction,
    ample_duration,
    arm_at_knot,
    body_distances,
    differences,
    knot_inputs,
)
from .motion import JointMotion
from .question import WEIGHTS, PlanTask
from .timing import Limits, violated

# Distances are a few millimetres too small on an arm of 200 mm, at all knots alike, which `_required` compensates.
# Sharper ones curve too fast for the steps of IPOPT, whose Hessian omits obstacles.
SHARPNESS = 400.0
"""Sharpness of the smooth minimum distance, over the length of the robot: it is at most log(points) / 400 too small."""

# Where joints hardly move the tips may: without a weight they would drift.
TIP_WEIGHT = 0.05
"""Weight of the motion of the tip rotations in the length, relative to the motion of the joints."""

OPTIONS: dict[str, Any] = {
    **NO_SENSITIVITIES,
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    # The motion is followed and proved: four digits of the cost are enough, equations need more.
    "ipopt.tol": 1e-4,
    "ipopt.constr_viol_tol": 1e-7,
    "ipopt.acceptable_tol": 1e-2,
    "ipopt.acceptable_iter": 5,
    "ipopt.acceptable_constr_viol_tol": 1e-7,
    "ipopt.acceptable_obj_change_tol": 1e-3,
    "ipopt.max_iter": 80,
    # The start is a motion that was checked; a larger barrier would move it away from its path.
    "ipopt.mu_init": 1e-2,
}


@dataclass(frozen=True)
class PathQuestion:
    """Structure of a program; programs of equal structure differ only in their parameters."""

    kind: Kind
    """Structure of the arm."""
    carriages: tuple[tuple[int, ...], ...]
    """Groups of tubes, from 0."""
    intervals: int
    """Number of intervals between knots."""
    rows: int
    """Number of constraints on the order of the joints."""
    obstacles: tuple[Obstacle, ...]
    length: float
    """Length of the robot, m."""
    extra: tuple[Expression, float] | None = None
    """Custom cost: an expression of the quantities of one pose, and its weight; negative if it is maximised."""


@dataclass(frozen=True, eq=False)
class PathProgram:
    """Nonlinear program of a path with its derivatives.

    Unknowns, in units of the scale, by columns: joint values (m, K), rates (m, K), tip rotations (n, K), square of the
    duration, margin.
    """

    problem: dict[str, Any]
    derivatives: dict[str, ca.Function]
    """Derivatives by the names of IPOPT's options."""
    rows: dict[str, int]
    """Number of constraints of each kind, in order."""
    least: ca.Function
    """(unknowns, parameters) -> smooth minimum distances by columns (rows, K), m."""
    body: list[int]
    """Index of the obstacle of each clearance row."""
    parameters: tuple[str, ...]
    """Names of the parameters, in order."""

    def values(self, **parameters: Any) -> Array:
        """Parameters in order, as one vector.

        robot (7n,); offset (n,) of the translations; scale (m,); rate, acceleration (m,) over the scale, times the unit
        of time and its square; weights (4,) of length, time, effort and margin; order (rows, m) of the joints; step
        (intervals,) duration of each interval as a fraction of the time; twist (intervals,) largest change of a tip
        rotation, rad; radius (n,) of the arm, m.
        """
        return np.concatenate(
            [np.ravel(np.asarray(parameters[name], dtype=float), order="F") for name in self.parameters]
        )

    def solver(self, seconds: float) -> ca.Function:
        """IPOPT with a time limit, s."""
        options = {**OPTIONS, **self.derivatives, "ipopt.max_wall_time": max(seconds, 0.1)}
        return ca.nlpsol("path", "ipopt", self.problem, options)


def path_program(question: PathQuestion) -> PathProgram:
    """Program of a structure, from a cache of the last programs."""
    return (_among_bodies if question.obstacles else _in_free_space)(question)


def _program(question: PathQuestion) -> PathProgram:
    n, groups, intervals = question.kind.n, len(question.carriages), question.intervals
    m, knots = n + groups, question.intervals + 1
    sizes = {"robot": question.kind.size, "offset": n, "scale": m, "rate": m, "acceleration": m, "weights": 4}
    sizes |= {"order": question.rows * m, "step": intervals, "twist": intervals, "radius": n}
    p = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
    joints, rates, tip = ca.MX.sym("q", m, knots), ca.MX.sym("v", m, knots), ca.MX.sym("z", n, knots)
    square, margin = ca.MX.sym("S"), ca.MX.sym("mu")
    q = joints * ca.repmat(p["scale"], 1, knots)
    spread = ca.DM(np.array([[float(i in g) for g in question.carriages] for i in range(n)]))
    shift = spread @ q[n:, :] + ca.repmat(p["offset"], 1, knots)
    at, arm = ca.vertcat(tip, shift, ca.repmat(margin, 1, knots)), ca.vertcat(p["robot"], p["radius"])
    arms = KnotFunction.of(_knot(question), 0).at(knots)(at, arm)
    rotations, fields, minima = ca.vertsplit(arms, [0, n, n + question.kind.sections, arms.shape[0]])
    h = ca.repmat(p["step"].T, m, 1)
    path = Cubics(joints, rates, h)
    speed, force = ca.repmat(p["rate"], 1, intervals), ca.repmat(p["acceleration"], 1, intervals)
    accelerations = ca.vertcat(path.early, path.late) / ca.vertcat(force, force)
    # If the inner Bezier coefficients of q satisfy ranges and order, so does all of the interval between knots.
    between = path.inner
    order = ca.reshape(p["order"], question.rows, m)
    dtip, twist = tip[:, 1:] - tip[:, :-1], ca.repmat(p["twist"].T, n, 1)
    speeds = ca.vertcat(ca.vec(rates[:, 1:-1] / ca.repmat(p["rate"], 1, knots - 2)), ca.vec(path.middle / speed))
    # |x| <= y as x - y <= 0 and -x - y <= 0: smooth, and linear where y is.
    parts = {
        "equilibrium": ca.vec(rotations - q[:n, :]),
        "fields": ca.vec(fields),
        "ranges": ca.vec(between),
        "order": ca.vec(order @ (between * ca.repmat(p["scale"], 1, 2 * intervals))) / question.length,
        "speed": ca.vertcat(speeds, -speeds) - ca.sqrt(square),
        "force": ca.vertcat(ca.vec(accelerations), -ca.vec(accelerations)) - square,
        "twist": ca.vertcat(ca.vec(dtip - twist), ca.vec(-dtip - twist)),
    }
    if question.obstacles:
        parts["clearance"] = ca.vec(minima) / question.length
    w, tip_length = p["weights"], TIP_WEIGHT * ca.sum1(ca.sum2(dtip**2 / h[:n, :]))
    objective = w[0] * (path.length + tip_length) + w[1] * square + w[2] * path.effort - w[3] * margin
    x = ca.vertcat(ca.vec(joints), ca.vec(rates), ca.vec(tip), square, margin)
    parameters = ca.vertcat(*p.values())
    problem = {"x": x, "f": objective, "p": parameters}
    if question.extra is not None:
        tips = arm_at_knot(question.kind, "tip").at(knots)(at, arm)
        known = {
            "rotations": q[:n, :],
            "translations": shift,
            "tip_position": tips[:3, :],
            "tip_direction": tips[3:, :],
        }
        expression, weight = question.extra
        quantities = ca.vertcat(*(known[quantity.name] for quantity in expression.quantities))
        # Trapezoidal rule.
        weights = (ca.vertcat(p["step"], 0) + ca.vertcat(0, p["step"])) / 2
        problem["f"] += weight * ca.dot(expression.value.map(knots)(quantities), weights.T)
    problem["g"] = ca.vertcat(*parts.values())
    solver = ca.nlpsol("path", "ipopt", problem, OPTIONS)
    names = {"grad_f": "nlp_grad_f", "jac_g": "nlp_jac_g", "hess_lag": "nlp_hess_l"}
    derivatives = {option: solver.get_function(name) for option, name in names.items()}
    rows = {name: part.numel() for name, part in parts.items()}
    distances = ca.Function("least", [x, parameters], [ca.vec(minima)])
    return PathProgram(problem, derivatives, rows, distances, _body_of_rows(question), tuple(sizes))


_in_free_space = lru_cache(maxsize=32)(_program)

_among_bodies = lru_cache(maxsize=4)(_program)
"""Smaller cache: its programs contain bodies, which may be tables of 100 MB."""


def _knot(question: PathQuestion) -> ca.Function:
    """Function of one knot: (tip rotations, translations, margin; robot, radius of the arm) -> column.

    The column has joint rotations, determinants of the Jacobi fields, and minimum distances from bodies, m.
    """
    kind = question.kind
    x, p, tip, shift, margin, robot, radius = knot_inputs(kind)
    if not question.obstacles:
        rotations, fields = explicit_joints(kind)(tip, shift, margin, robot)
        minima: Any = ca.MX(0, 1)
    else:
        rotations, fields, *arm = explicit_arm(kind)(tip, shift, margin, robot)
        minima = _distance(question)(*arm, shift, robot, radius)
    return ca.Function("knot", [x, p], [ca.densify(ca.vertcat(rotations, fields, minima))])


def _distance(question: PathQuestion) -> ca.Function:
    """Function of one arm: (rows,) smooth minimum distances, lower bounds except for the blur of a table, m.

    One row for every body with a formula, and one per step of the arm for a table, which usually surrounds the arm.
    """
    kind = question.kind
    count = explicit_arm(kind).size2_out(2)
    distances = body_distances(kind, count, question.obstacles)
    inputs = distances.mx_in()
    sharp = SHARPNESS / question.length
    minima = []
    for body, column in zip(question.obstacles, ca.horzsplit(distances(*inputs)), strict=True):
        distance = ca.reshape(column, SPLITS, count - 1) if isinstance(body, TABLES) else column
        minima += [-ca.logsumexp(-sharp * part) / sharp for part in ca.horzsplit(distance)]
    return ca.Function("least_distance", inputs, [ca.vertcat(*minima)])


def _body_of_rows(question: PathQuestion) -> list[int]:
    """Number of the body of every row of `_distance`."""
    steps = explicit_arm(question.kind).size2_out(2) - 1
    counts = [steps if isinstance(body, TABLES) else 1 for body in question.obstacles]
    return [k for k, count in enumerate(counts) for _ in range(count)]


UNFINISHED = ("Maximum_WallTime_Exceeded", "Maximum_Iterations_Exceeded")

# Each bisects the intervals that fail. What fails after three does not depend on knots.
REFINEMENTS = 3
"""Maximum number of times that knots are added where the motion between them violates a requirement."""

# Joint values alone could jump between knots to another branch, whose tip rotations differ by more.
TWIST = 0.3
"""Smallest limit on the change of a tip rotation between knots, rad."""

# Between knots the margin is lower, by the square of their distance; after a failure 1.5 times the shortfall is added.
MARGIN_RESERVE = 3e-3
"""First reserve of the margin at knots, added to the reserve of the search."""

# The smoothed motion stays close to the path, and every body adds rows for all knots.
BODY_REACH = 0.1
"""Distance of the arm from obstacles, relative to the longest tube, within which these are constraints."""

# Every column of a knot's Jacobian costs about as much as the arm.
MAX_OPERATIONS = 150_000
"""Largest number of operations of one equilibrium, about six tubes; beyond it derivatives take too long."""

BUILD_PER_OPERATION, BUILD_PER_BODY, BUILD_PER_NODE = 5e-5, 5e-2, 1e-6
"""Build and start-up time of the program on a slow machine, s.

Per operation of an equilibrium, per obstacle, and per node of a table of distances. The build cannot be interrupted.
"""

# A determinant of 0 is the fold itself, where IPOPT would converge to equilibria beyond it.
LEAST_FIELDS = 1e-3
"""Smallest determinant of the Jacobi fields, which is 1 at the tip."""

JOINT_ROUND_OFF = 1e-9
"""Round-off in joint ranges, in units of the scales."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Result of smoothing: a motion with its knots."""

    motion: JointMotion
    points: Array
    """(K, m) knots in tip coordinates."""
    iterations: int
    """Number of iterations of IPOPT."""


def building(task: PlanTask) -> float:
    """Time, s, that building the program of a task and starting its solution may take."""
    nodes = sum(min(body.lattice.values.size, MAX_NODES) for body in task.obstacles if isinstance(body, TABLES))
    return BUILD_PER_OPERATION * task.coordinates.size + BUILD_PER_BODY * len(task.obstacles) + BUILD_PER_NODE * nodes


def resample(task: PlanTask, points: Array, count: int) -> Array:
    """(count, m) points of a path, evenly spaced by the length of joint motion."""
    z = np.concatenate([points[:1], *(task.line(a, b)[1:] for a, b in pairwise(points))])
    q = task.coordinates.joints(z) / task.scale
    # Both metrics count: where the joints hardly move, the arm may.
    step = np.linalg.norm(np.diff(q, axis=0), axis=1) + 0.3 * np.linalg.norm(np.diff(z / task.scale, axis=0), axis=1)
    mark = np.concatenate([[0.0], np.cumsum(step)])
    at = np.linspace(0, mark[-1], count)
    out = np.column_stack([np.interp(at, mark, column) for column in z.T])
    out[0], out[-1] = points[0], points[-1]
    return out


def smooth(
    task: PlanTask, start: Equilibrium, points: Array, limits: Limits, objective: str, clock: Clock
) -> Smoothed | None:
    """Best motion near a path, from rest to rest; None if no valid motion is found within the time.

    Its duration is optimal for the objectives time and effort only.
    """
    intervals, iterations = task.options.smoothing_intervals, 0
    z, step = resample(task, points, intervals + 1), np.full(intervals, 1 / intervals)
    reserve = np.array([task.margin_reserve + MARGIN_RESERVE, task.clearance_reserve])
    if task.coordinates.size > MAX_OPERATIONS:
        return None
    for _ in range(REFINEMENTS + 1):
        arms = task.coordinates.arms(z, 0.0)
        near_task = _near(task, arms)
        if clock.left < clock.parallel_slowdown * building(near_task):
            return None
        result = _solve(near_task, (z, arms), step, limits, objective, reserve, clock)
        if result is None:
            return None
        iterations += result.iterations
        violations = violated(task, start, result.motion, clock, (result.motion.time, result.points))
        if not violations.intervals.any():
            return replace(result, iterations=iterations)
        if clock.over:
            return None
        # Add a knot in the middle of each bad interval.
        bad, z = violations.intervals, result.points
        after = np.flatnonzero(bad) + 1
        z = np.insert(z, after, (z[after - 1] + z[after]) / 2, axis=0)
        step = np.repeat(np.where(bad, step / 2, step), 1 + bad)
        # 1.5 times the shortfall, since the added knots shift the minimum.
        reserve += 1.5 * violations.shortfall
    return None


def _near(task: PlanTask, arms: ArmBatch) -> PlanTask:
    """Task with only the bodies close to the arms at the knots."""
    if not task.obstacles:
        return task
    reach = BODY_REACH * task.coordinates.space.length + task.clearance + float(task.coordinates.radius.max())
    points = arms.fine()[1]
    near = task.scene.close(points.reshape(-1, 3), reach)
    return replace(task, obstacles=tuple(task.obstacles[k] for k in near))


def _solve(
    task: PlanTask,
    knots: tuple[Array, ArmBatch],
    step: Array,
    limits: Limits,
    objective: str,
    reserve: Array,
    clock: Clock,
) -> Smoothed | None:
    """Solution of the program from knots (K, m) in tip coordinates and their arms; None if IPOPT fails.

    `step`: durations of the intervals, as fractions of the time; `reserve` (2,) of margin and clearance (m) at knots.
    """
    z, chart = knots[0], task.coordinates
    assert isinstance(chart, TipCoordinates)  # `plan` smooths motions of robots with fixed sections only
    space, n = chart.space, chart.space.robot.n_tubes
    scale, rate, acceleration = task.scale, limits.rate, limits.acceleration
    question = PathQuestion(
        kind=chart.kind,
        carriages=space.carriages,
        intervals=len(step),
        rows=len(space.row_lower),
        obstacles=task.obstacles,
        length=space.length,
        extra=task.cost,
    )
    program = path_program(question)
    q = task.coordinates.joints(z)
    time = np.concatenate([[0.0], np.cumsum(step)])
    unit = ample_duration(q, time, rate, acceleration)
    length = max(float(np.linalg.norm(np.diff(q / scale, axis=0), axis=1).sum()), 1e-9)
    weights = np.array(WEIGHTS[objective]) * [length**-2, 1.0, length**-2, 1.0]
    p = program.values(
        robot=chart.parameters,
        offset=space.offset[n:],
        scale=scale,
        rate=rate / scale * unit,
        acceleration=acceleration / scale * unit**2,
        weights=weights,
        order=space.rows,
        step=step,
        twist=np.maximum(TWIST, 1.3 * np.abs(np.diff(z[:, :n], axis=0)).max(1)),
        radius=task.coordinates.radius,
    )
    # No margin is above 1: bounds need an interior below it.
    required = min(task.min_margin + float(reserve[0]), 0.998)
    x = np.concatenate([(q / scale).ravel(), (differences(q, time) / scale).ravel(), z[:, :n].ravel(), [1.0, required]])
    solver = program.solver(clock.left)
    minima = _required(task, program, np.asarray(program.least(x, p)), knots, float(reserve[1]))
    result = solver(x0=x, p=p, **_bounds(task, program, (q, z, minima), objective, required))
    stats = solver.stats()
    # After the last step or second the motion may still be valid, which `violated` decides.
    if not (stats["success"] or stats["return_status"] in UNFINISHED):
        return None
    sizes = np.cumsum([q.size, q.size, n * len(q)])
    *moved, tips, (square, _) = np.split(np.asarray(result["x"]).ravel(), sizes)
    joints, rates = (each.reshape(q.shape) * scale for each in moved)
    duration = float(np.sqrt(square)) * unit
    motion = JointMotion(CubicHermiteSpline(time * duration, joints, rates / duration))
    return Smoothed(motion, np.column_stack([tips.reshape(-1, n), joints[:, n:]]), int(stats["iter_count"]))


def _required(
    task: PlanTask, program: PathProgram, values: Array, knots: tuple[Array, ArmBatch], reserve: float
) -> Array:
    """(K, rows) required smooth minimum distances, m, at knots (K, m) and their arms.

    The exact distance from an obstacle may decrease to `reserve` above the required clearance; a knot with less may not
    come closer, and must recede where it violates the clearance. The smooth distances of the program, now `values`, may
    decrease by as much: where much of an arm is about as close as its closest point, they are a few millimetres too
    small, at all knots alike. All rows of an obstacle have the requirement of its closest row.
    """
    z, arms = knots
    alone = (replace(task, obstacles=(body,)).clearances(arms) for body in task.obstacles)
    excess = np.array([each - task.clearance for each in alone]).reshape(len(task.obstacles), len(z)).T
    decrease = excess - np.minimum(reserve, np.maximum(excess, task.needed(z)[:, None]))
    body, smooth_least = np.array(program.body, dtype=int), values.reshape(len(z), -1)
    closest = np.empty_like(decrease)
    for k in range(decrease.shape[1]):
        closest[:, k] = smooth_least[:, body == k].min(axis=1)
    return np.asarray((closest - decrease)[:, body])


def _bounds(
    task: PlanTask, program: PathProgram, start: tuple[Array, Array, Array], objective: str, required: float
) -> dict[str, Array]:
    """Bounds of unknowns and constraints; both ends, which were checked before, are fixed.

    `start`: joint values and tip coordinates at knots, and required smooth distances, m.
    """
    (q, z, minima), space, inf = start, task.coordinates.space, np.inf
    n, (knots, m) = space.robot.n_tubes, q.shape
    low, high = (np.tile(value / task.scale, (knots, 1)) for value in (space.lower, space.upper))
    low[[0, -1]] = high[[0, -1]] = (q / task.scale)[[0, -1]]
    rate, tip = np.full((knots, m), inf), np.full((knots, n), inf)
    rate[[0, -1]] = 0.0
    lowest = -tip
    lowest[[0, -1]] = tip[[0, -1]] = z[[0, -1], :n]
    largest = 0.999 if objective == "margin" else required
    rows = program.rows
    lower = {name: np.full(size, -inf) for name, size in rows.items()}
    upper = {name: np.full(size, inf) for name, size in rows.items()}
    for name in ("speed", "force", "twist"):
        upper[name][:] = 0.0
    inside = ((np.arange(knots) > 0) & (np.arange(knots) < knots - 1))[:, None]
    lower["order"] = np.tile(space.row_lower / space.length - JOINT_ROUND_OFF, 2 * (knots - 1))
    ends = q[[0, -1]] / task.scale
    lower["ranges"] = np.tile(np.minimum(space.lower / task.scale, ends.min(0)) - JOINT_ROUND_OFF, 2 * (knots - 1))
    upper["ranges"] = np.tile(np.maximum(space.upper / task.scale, ends.max(0)) + JOINT_ROUND_OFF, 2 * (knots - 1))
    limits: dict[str, float | Array] = {"fields": LEAST_FIELDS, "clearance": minima / space.length}
    for name, value in limits.items():
        if rows.get(name):
            lower[name] = np.where(inside, value, np.full((knots, rows[name] // knots), -inf)).ravel()
    # The equations at the ends are satisfied to the accuracy of the integration; nothing is left to solve.
    free = np.where(inside, 0.0, np.full((knots, n), inf)).ravel()
    lower["equilibrium"], upper["equilibrium"] = -free, free
    return {
        "lbx": np.concatenate([low.ravel(), -rate.ravel(), lowest.ravel(), [1e-6, required]]),
        # S is at most 4: a motion may take twice as long as the start.
        "ubx": np.concatenate([high.ravel(), rate.ravel(), tip.ravel(), [4.0, largest]]),
        "lbg": np.concatenate([lower[name] for name in rows]),
        "ubg": np.concatenate([upper[name] for name in rows]),
    }
