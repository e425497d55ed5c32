"""Smoothing: the path that was found becomes the best motion nearby, by direct collocation over time.

A trajectory as one nonlinear program: direct collocation over time, one equilibrium block at every knot.

Time runs from 0 to 1; the duration T is an unknown. Unknowns at every knot are the joint values q, their rates
q' = T dq/dt, and the tip rotations z, in which the equilibrium block is explicit (see `explicit`): its equations are

    alpha(z_k, d_k) = rotations of q_k,   fields(z_k, d_k, margin) > 0.

Between knots q is cubic, so q'' is linear and q' is quadratic, and the bounds

    |q'| <= rate sqrt(S)   (on the three Bezier coefficients),   |q''| <= acceleration S   (at both ends)

hold everywhere, and are convex in the square of the duration, S = T^2. Length, int |q'|^2, and effort, int |q''|^2, are
quadratic in q and q'. Joint values alone could jump between knots to another branch with the same joint values: the tip
rotations change by a bounded amount per interval, and their motion counts as well. The Hessian that IPOPT is given is
exact but for the curvature of the equilibrium, of active margins and of obstacles. Blocks are mapped over the knots,
and so are their derivatives: CasADi by itself would pass through all knots once for every unknown that an equation has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import scipy
from scipy.interpolate import CubicHermiteSpline

from ..block.quantities import Expression
from ..block.transcription.explicit import Kind, explicit_arm, explicit_joints
from ..bodies.corridors import MeshObstacle
from ..bodies.distance_field import DistanceField
from ..bodies.obstacles import Obstacle
from ..equilibrium.result import Equilibrium
from ..inverse.arm_surface import cubic
from ..inverse.clock import Clock
from ..inverse.task import Arms
from ..solvers.settings import NO_SENSITIVITIES
from ..typing import Array, Mask
from .motion import Motion
from .question import WEIGHTS, PlanTask
from .timing import Limits, violated

# Distances come out a few millimetres too small on an arm of 200 mm, for all knots alike, which `_to_keep` takes out.
# Sharper ones bend faster than the steps of IPOPT, whose Hessian leaves obstacles out.
SHARPNESS = 400.0
"""Sharpness of the smooth minimum distance, over the length of the robot: it is at most log(points) / 400 too small."""

SPLITS = 4
"""Points per step of the arm at which its distance from bodies is measured."""

# Where joints hardly turn the tips may: without a weight they would wander.
TIP_WEIGHT = 0.05
"""Weight of the motion of the tip rotations relative to that of the joints, in the length."""

MOST_NODES = 1_000_000
"""Of a table of distances: its splines and their derivatives take 32 bytes for each."""

# Steps of voxels would be corners for Newton's method.
BLUR = 1.5
"""Nodes by which a table of distances is blurred."""

TABLES = (MeshObstacle, DistanceField)
"""Bodies without a formula for their distance."""

OPTIONS: dict[str, Any] = {
    **NO_SENSITIVITIES,
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    # The answer is followed and proved: four digits of the cost are enough, equations need more.
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
    """What makes two programs the same but for numbers."""

    kind: Kind
    """Of the arm."""
    carriages: tuple[tuple[int, ...], ...]
    """Groups of tubes, from 0."""
    intervals: int
    """Between knots."""
    rows: int
    """Of the order of the joints."""
    obstacles: tuple[Obstacle, ...]
    length: float
    """Of the robot, m."""
    extra: tuple[Expression, float] | None = None
    """Custom cost: an expression of the quantities of one pose, and its weight; negative if it is maximised."""


@dataclass(frozen=True, eq=False)
class PathProgram:
    """The program, its Hessian, and its constraints with their Jacobian. Unknowns, in units of the scale, by columns:
    joint values (m, K), rates (m, K), tip rotations (n, K), square of the duration, margin.
    """

    problem: dict[str, Any]
    hessian: ca.Function
    jacobian: ca.Function
    rows: dict[str, int]
    """Number of constraints of each kind, in order."""
    least: ca.Function
    """(unknowns, parameters) -> the smooth least distances by columns (rows, K), m."""
    body: list[int]
    """Of which obstacle every one of these rows is."""
    parameters: tuple[str, ...]
    """Their names, in order."""

    def values(self, **given: Any) -> Array:
        """The parameters in order: robot (7n,); offset (n,) of the translations; scale (m,); rate, acceleration (m,)
        over the scale, times the unit of time and its square; weights (4,) of length, time, effort and margin; order
        (rows, m) of the joints; step (intervals,) share of the time of each interval; twist (intervals,) largest change
        of a tip rotation, rad; radius (n,) of the arm, m."""
        return np.concatenate([np.ravel(np.asarray(given[name], dtype=float), order="F") for name in self.parameters])

    def solver(self, seconds: float) -> ca.Function:
        """IPOPT, to spend at most so many seconds."""
        options = {**OPTIONS, "ipopt.max_wall_time": max(seconds, 0.1)}
        options |= {"hess_lag": self.hessian, "jac_g": self.jacobian}
        return ca.nlpsol("path", "ipopt", self.problem, options)


def path_program(question: PathQuestion) -> PathProgram:
    """The program of a question, built once as long as it is among the last ones."""
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
    at = tip, shift, ca.repmat(margin, 1, knots), ca.repmat(p["robot"], 1, knots), ca.repmat(p["radius"], 1, knots)
    knot = _knot(question)
    # Symbols stand for what the arms are until all else is differentiated.
    arms = ca.MX.sym("arms", knot.size1_out(0), knots)
    rotations, fields, least = ca.vertsplit(arms, [0, n, n + question.kind.sections, arms.shape[0]])
    early, middle, late = _cubic(joints, rates, ca.repmat(p["step"].T, m, 1))
    speed, force = ca.repmat(p["rate"], 1, intervals), ca.repmat(p["acceleration"], 1, intervals)
    accelerations = ca.vertcat(early, late) / ca.vertcat(force, force)
    step = ca.repmat(p["step"].T, m, 1) / 3
    # The inner Bezier coefficients of q: where they keep ranges and order, so does all of the interval between knots.
    between = ca.horzcat(joints[:, :-1] + step * rates[:, :-1], joints[:, 1:] - step * rates[:, 1:])
    order = ca.reshape(p["order"], question.rows, m)
    turned, twist = tip[:, 1:] - tip[:, :-1], ca.repmat(p["twist"].T, n, 1)
    speeds = ca.vertcat(ca.vec(rates[:, 1:-1] / ca.repmat(p["rate"], 1, knots - 2)), ca.vec(middle / speed))
    # |x| <= y as x - y <= 0 and -x - y <= 0: smooth, and linear where y is.
    parts = {
        "equilibrium": ca.vec(rotations - q[:n, :]),
        "fields": ca.vec(fields),
        "ranges": ca.vec(between),
        "order": ca.vec(order @ (between * ca.repmat(p["scale"], 1, 2 * intervals))) / question.length,
        "speed": ca.vertcat(speeds, -speeds) - ca.sqrt(square),
        "force": ca.vertcat(ca.vec(accelerations), -ca.vec(accelerations)) - square,
        "twist": ca.vertcat(ca.vec(turned - twist), ca.vec(-turned - twist)),
    }
    if question.obstacles:
        parts["clearance"] = ca.vec(least) / question.length
    h = ca.repmat(p["step"].T, m, 1)
    w, along = p["weights"], TIP_WEIGHT * ca.sum1(ca.sum2(turned**2 / h[:n, :]))
    # q'' is linear between `early` and `late`: int q''^2 = h (early^2 + early late + late^2) / 3.
    moved, effort = _squares(joints, rates, h), ca.sum1(ca.sum2(h * (early**2 + early * late + late**2) / 3))
    objective = w[0] * (moved + along) + w[1] * square + w[2] * effort - w[3] * margin
    x = ca.vertcat(ca.vec(joints), ca.vec(rates), ca.vec(tip), square, margin)
    given = ca.vertcat(*p.values())
    problem = {"x": x, "f": objective, "p": given}
    bent: Any = 0
    if question.extra is not None:
        arm = explicit_arm(question.kind).map(knots)(*at[:4])[2:]
        extra, bent = _extra(question, {"rotations": q[:n, :], "translations": shift, "arm": arm}, p["step"], x)
        problem["f"] = objective + extra
    rows = {name: part.numel() for name, part in parts.items()}
    problem["g"], jacobian = _constraints(ca.vertcat(*parts.values()), arms, knot, at, x, given)
    distances = ca.Function("least", [x, given], [ca.vec(knot.map(knots)(*at)[n + question.kind.sections :, :])])
    hessian = _hessian({**problem, "f": objective}, rows, bent)
    return PathProgram(problem, hessian, jacobian, rows, distances, rows_of_bodies(question), tuple(sizes))


def _knot(question: PathQuestion) -> ca.Function:
    """(tip rotations, translations, margin, robot, radius of the arm) of one knot -> in one column joint rotations,
    determinants of the Jacobi fields, and least distances, m, of none where there are no bodies."""
    kind = question.kind
    sizes = {"tip": kind.n, "shift": kind.n, "margin": 1, "robot": kind.size, "radius": kind.n}
    tip, shift, margin, robot, radius = given = [ca.MX.sym(name, size) for name, size in sizes.items()]
    if not question.obstacles:
        rotations, fields = explicit_joints(kind)(tip, shift, margin, robot)
        least: Any = ca.MX(0, 1)
    else:
        rotations, fields, *arm = explicit_arm(kind)(tip, shift, margin, robot)
        least = _distance(question)(*arm, shift, robot, radius)
    return ca.Function("knot", given, [ca.densify(ca.vertcat(rotations, fields, least))])


def _constraints(g: Any, arms: Any, knot: ca.Function, at: tuple[Any, ...], x: Any, p: Any) -> tuple[Any, Any]:
    """The constraints, of which an expression has symbols for the `arms` that the function `knot` makes of `at`; and as
    a function (x, p) they and their Jacobian, in which every knot is differentiated by what it depends on."""
    # Chain rule: each knot's own small Jacobian, on the diagonal, times that of its arguments by the unknowns.
    count, chain = arms.shape[1], ca.jacobian(ca.vec(ca.vertcat(*at[:3])), x)
    one = [ca.MX.sym(knot.name_in(k), knot.sparsity_in(k)) for k in range(knot.n_in())]
    by = ca.vertcat(*one[:3])
    slopes = ca.Function("slopes", one, [ca.jacobian(knot(*one), by)])
    blocks = ca.diagcat(*ca.horzsplit(slopes.map(count)(*at), by.numel()))
    jacobian = ca.jacobian(g, x) + ca.jacobian(g, arms) @ (blocks @ chain)
    g, jacobian = ca.graph_substitute([g, jacobian], [arms], [knot.map(count)(*at)])
    return g, ca.Function("jac_g", [x, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"])


_in_free_space = lru_cache(maxsize=32)(_program)

_among_bodies = lru_cache(maxsize=4)(_program)
"""What is cached keeps its bodies, which may be tables of 100 MB."""


def _extra(question: PathQuestion, known: dict[str, Any], step: Any, x: Any) -> tuple[Any, Any]:
    """The mean of a custom cost along the path, times its weight, and its Hessian but for the curvature of the arm."""
    assert question.extra is not None
    (expression, weight), knots = question.extra, question.intervals + 1
    last = [known["arm"][0].shape[1] // knots * (k + 1) - 1 for k in range(knots)]
    known = {**known, "tip_position": known["arm"][0][:, last], "tip_direction": known["arm"][1][:, last]}
    given = ca.vertcat(*(known[one.name] for one in expression.quantities))
    share = (ca.vertcat(step, 0) + ca.vertcat(0, step)) / 2
    y, factor = ca.SX.sym("y", given.shape[0]), ca.SX.sym("share")
    bent = ca.densify(ca.hessian(factor * expression.value(y), y)[0])
    blocks = ca.Function("bent", [y, factor], [bent]).map(knots)(given, share.T)
    slope = ca.jacobian(ca.vec(given), x)
    mean = ca.dot(expression.value.map(knots)(given), share.T)
    return weight * mean, weight * slope.T @ ca.diagcat(*ca.horzsplit(blocks, given.shape[0])) @ slope


def _cubic(joints: Any, rates: Any, h: Any) -> tuple[Any, Any, Any]:
    """q'' at both ends of every interval, and the middle Bezier coefficient of q' in between (m, intervals)."""
    delta, a, b = (joints[:, 1:] - joints[:, :-1]) / h, rates[:, :-1], rates[:, 1:]
    # Hermite's cubic with slopes a, b and mean slope delta. The mean of Bezier coefficients of q' is delta: the middle
    # one is 3 delta - a - b.
    return (6 * delta - 4 * a - 2 * b) / h, 3 * delta - a - b, (2 * a + 4 * b - 6 * delta) / h


def _squares(joints: Any, rates: Any, h: Any) -> Any:
    """int |q'|^2 of cubics between knots."""
    delta, a, b = (joints[:, 1:] - joints[:, :-1]) / h, rates[:, :-1], rates[:, 1:]
    return ca.sum1(ca.sum2(h * (36 * delta**2 - 6 * delta * (a + b) + 4 * a**2 + 4 * b**2 - 2 * a * b) / 30))


def _hessian(problem: dict[str, Any], rows: dict[str, int], extra: Any) -> ca.Function:
    """Hessian of objective, custom cost and bounds on rates, in the form of CasADi's interface to IPOPT."""
    x, p = problem["x"], problem["p"]
    factor, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", problem["g"].numel())
    first = sum(size for name, size in list(rows.items())[: list(rows).index("speed")])
    # The only curved constraint of the joints has -sqrt(S), with the second derivative S^(-3/2) / 4.
    pressing = ca.sum1(multipliers[first : first + rows["speed"]])
    square = x[x.numel() - 2]
    table = factor * (ca.hessian(problem["f"], x)[0] + extra)
    bend = ca.MX(
        ca.Sparsity.triplet(x.numel(), x.numel(), [x.numel() - 2], [x.numel() - 2]), pressing / 4 / square**1.5
    )
    names = ["x", "p", "lam_f", "lam_g"]
    return ca.Function("hess_lag", [x, p, factor, multipliers], [ca.triu(table + bend)], names, ["hess_lag"])


def _distance(question: PathQuestion) -> ca.Function:
    """(rows,) smooth least distances of one arm, never larger than they are but by what a table blurs: one from every
    body with a formula, one in every step of the arm from a table, which as a rule is all around."""
    n = question.kind.n
    count = explicit_arm(question.kind).size2_out(2)
    inputs = [ca.MX.sym("p", 3, count), ca.MX.sym("t", 3, count), ca.MX.sym("s", count)]
    inputs += [ca.MX.sym("d", n), ca.MX.sym("robot", question.kind.size), ca.MX.sym("r", n)]
    places, thick = _places(question.kind, count)(*inputs)
    sharp = SHARPNESS / question.length
    x, y, z = (ca.SX.sym(axis) for axis in "xyz")
    least = []
    for k, obstacle in enumerate(question.obstacles):
        if isinstance(obstacle, TABLES):
            room = ca.reshape(_tabulated(obstacle, places) - thick, SPLITS, count - 1)
        else:
            body = ca.Function(f"body_{k}", [x, y, z], [obstacle.distance(x, y, z)]).map(places.shape[1])
            room = (body(places[0, :], places[1, :], places[2, :]) - thick).T
        least += [-ca.logsumexp(-sharp * part) / sharp for part in ca.horzsplit(room)]
    return ca.Function("least_distance", inputs, [ca.vertcat(*least)])


def rows_of_bodies(question: PathQuestion) -> list[int]:
    """Of every row of `_distance` the number of its body."""
    steps = explicit_arm(question.kind).size2_out(2) - 1
    counts = [steps if isinstance(body, TABLES) else 1 for body in question.obstacles]
    return [k for k, count in enumerate(counts) for _ in range(count)]


def _tabulated(body: MeshObstacle | DistanceField, places: Any) -> Any:
    """(1, a) distances of places (3, a) from a body that is a table, beyond its lattice those of its border."""
    lattice = body.lattice
    at = ca.DM(lattice.frame.axes.T) @ (places - ca.repmat(ca.DM(lattice.frame.origin), 1, places.shape[1]))
    last = ca.DM((np.array(lattice.values.shape) - 1) * lattice.spacing)
    inside = ca.fmin(ca.fmax(at, 0), ca.repmat(last, 1, places.shape[1]))
    return table_function(body).map(places.shape[1])(inside)


@lru_cache(maxsize=8)
def table_function(body: MeshObstacle | DistanceField) -> ca.Function:
    """Cubic B-splines with a body's distances as their weights, at a place (3,) of its lattice, m from the first node.

    A sum of weights needs no equations to be solved, so a table of millions is a function at once. The steps of voxels
    are blurred, which the bounds on distances, made at the knots that smoothing begins with, take into account. Tables
    of more than MOST_NODES lose every second node, or more.
    """
    lattice = body.lattice
    stride = int(np.ceil((lattice.values.size / MOST_NODES) ** (1 / 3)))
    few = lattice.values[::stride, ::stride, ::stride].astype(float)
    values = np.pad(scipy.ndimage.gaussian_filter(few, BLUR, mode="nearest"), (1, 1 + (stride > 1)), mode="edge")
    # The weight of node i belongs to the spline on the knots from i - 2 to i + 2.
    knots = [
        (np.arange(count + 4) - 3) * stride * step
        for count, step in zip(values.shape, lattice.spacing.tolist(), strict=True)
    ]
    return ca.Function.bspline("table", knots, values.ravel(order="F"), [3, 3, 3], 1)


def _places(kind: Kind, count: int) -> ca.Function:
    """Points along an arm (3, a), `SPLITS` per step, and its radius there (1, a)."""
    points, tangents, s = ca.SX.sym("p", 3, count), ca.SX.sym("t", 3, count), ca.SX.sym("s", count)
    shift, robot, radius = ca.SX.sym("d", kind.n), ca.SX.sym("robot", kind.size), ca.SX.sym("r", kind.n)
    end = shift + kind.reach(robot)
    places, thick = [], []
    for k in range(count - 1):
        h = s[k + 1] - s[k]
        for x in np.arange(1, SPLITS + 1) / SPLITS:
            places.append(cubic(points[:, k], points[:, k + 1], tangents[:, k], tangents[:, k + 1], x, h))
            # A tube shows on all of a section: steps do not reach across its end.
            thick.append(ca.mmax(radius * ((s[k] + s[k + 1]) / 2 < end)))
    out = [ca.horzcat(*places), ca.horzcat(*thick)]
    return ca.Function("places", [points, tangents, s, shift, robot, radius], out)


UNFINISHED = ("Maximum_WallTime_Exceeded", "Maximum_Iterations_Exceeded")

# Each halves the intervals that fail. What fails after three is no matter of knots.
REFINEMENTS = 3
"""Times that knots are added where the motion between them is not allowed."""

# Joint values alone could jump between knots to another branch, whose tip rotations differ by more.
TWIST = 0.3
"""Change of a tip rotation between knots that is always allowed, rad."""

# The margin between knots sags by the square of their distance; after a failure as much is added as was missing, and
# half.
MARGIN_RESERVE = 3e-3
"""Margin beyond that of the search that knots keep at first, for what is between them."""

# The smoothed motion stays close to the path, and every body adds rows for all knots.
BODY_REACH = 0.1
"""Distance of knots from obstacles, as a share of the longest tube, within which these count."""

# Every column of a knot's Jacobian costs about as much as the arm.
MOST_OPERATIONS = 150_000
"""Operations of one equilibrium, about those of six tubes, beyond which derivatives take too long."""

BUILD_PER_OPERATION, BUILD_PER_BODY, BUILD_PER_NODE = 5e-5, 5e-2, 1e-6
"""Upper limits on most machines, s, of the time to build the program, which nothing can cut short, and to begin to
solve it: per operation of an equilibrium, per obstacle, and per node of a table of distances."""

# A determinant of 0 is the fold itself, where IPOPT would converge to equilibria beyond it.
LEAST_FIELDS = 1e-3
"""Least determinant of the Jacobi fields, which begin as 1."""

ROUND_OFF = 1e-9
"""Excess over ranges that is none, in units of the scales."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A smoothed motion, its knots (K, m) in the chart, and how many iterations and knots it took."""

    motion: Motion
    points: Array
    iterations: int


def building(task: PlanTask) -> float:
    """Seconds of work that it may take to build the program of a task and to begin to solve it."""
    nodes = sum(min(body.lattice.values.size, MOST_NODES) for body in task.obstacles if isinstance(body, TABLES))
    return BUILD_PER_OPERATION * task.chart.size + BUILD_PER_BODY * len(task.obstacles) + BUILD_PER_NODE * nodes


def resample(task: PlanTask, points: Array, count: int) -> Array:
    """(count, m) points of a way, evenly spaced by the length of joint motion."""
    z = np.concatenate([points[:1], *(task.line(a, b)[1:] for a, b in pairwise(points))])
    q = task.chart.joints(z) / task.scale
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
    """The best motion near a way, from rest to rest; None where the program does not converge to an allowed one before
    the clock is over. How long it takes is told by objectives of time and effort only."""
    intervals, iterations = task.options.smoothing_intervals, 0
    z, share = resample(task, points, intervals + 1), np.full(intervals, 1 / intervals)
    room = np.array([task.margin_room + MARGIN_RESERVE, task.clearance_room])
    if task.chart.size > MOST_OPERATIONS:
        return None
    for _ in range(REFINEMENTS + 1):
        arms = task.chart.arms(z, 0.0)
        near = _near(task, arms)
        if clock.left < clock.parallel_slowdown * building(near):
            return None
        found = _solve(near, (z, arms), share, limits, objective, room, clock)
        if found is None:
            return None
        iterations += found.iterations
        bad, short = violated(task, start, found.motion, clock, (found.motion.time, found.points))
        if not bad.any():
            return replace(found, iterations=iterations)
        if clock.over:
            return None
        z, share = _split(found.points, share, bad)
        # What was missing and half, since the knots that are added shift where the least lies.
        room += 1.5 * short
    return None


def _near(task: PlanTask, arms: Arms) -> PlanTask:
    """The same with the bodies alone that the arm may meet near knots."""
    if not task.obstacles:
        return task
    reach = BODY_REACH * task.chart.space.length + task.clearance + float(task.chart.radius.max())
    points = arms.fine()[1]
    near = task.scene.close(points.reshape(-1, 3), reach)
    return replace(task, obstacles=tuple(task.obstacles[k] for k in near))


def _solve(
    task: PlanTask, knots: tuple[Array, Arms], share: Array, limits: Limits, objective: str, room: Array, clock: Clock
) -> Smoothed | None:
    """The program's solution from knots (K, m) in the chart and their arms, with so much room (2,) above the margin and
    the clearance (m) to keep, at knots."""
    z = knots[0]
    space, n = task.chart.space, task.chart.space.robot.n_tubes
    scale, rate, acceleration = task.scale, limits.rate, limits.acceleration
    question = PathQuestion(
        task.chart.kind,
        space.carriages,
        len(share),
        len(space.least),
        task.obstacles,
        space.length,
        task.cost,
    )
    program = path_program(question)
    q = task.chart.joints(z)
    time = np.concatenate([[0.0], np.cumsum(share)])
    unit = _duration(q, time, rate, acceleration)
    length = max(float(np.linalg.norm(np.diff(q / scale, axis=0), axis=1).sum()), 1e-9)
    weights = np.array(WEIGHTS[objective]) * [length**-2, 1.0, length**-2, 1.0]
    p = program.values(
        robot=task.chart.parameters,
        offset=space.offset[n:],
        scale=scale,
        rate=rate / scale * unit,
        acceleration=acceleration / scale * unit**2,
        weights=weights,
        order=space.rows,
        step=share,
        twist=np.maximum(TWIST, 1.3 * np.abs(np.diff(z[:, :n], axis=0)).max(1)),
        radius=task.chart.radius,
    )
    # A margin of 1 is the largest there is: bounds need an interior below it.
    floor = min(task.min_margin + float(room[0]), 0.998)
    x = np.concatenate([(q / scale).ravel(), (begin_rates(q, time) / scale).ravel(), z[:, :n].ravel(), [1.0, floor]])
    solver = program.solver(clock.left)
    least = _to_keep(task, program, np.asarray(program.least(x, p)), knots, float(room[1]))
    result = solver(x0=x, p=p, **_bounds(task, program, (q, z, least), objective, floor))
    stats = solver.stats()
    # What ran out of time or steps may still be allowed: following it tells.
    if not (stats["success"] or stats["return_status"] in UNFINISHED):
        return None
    sizes = np.cumsum([q.size, q.size, n * len(q)])
    *moved, tips, (square, _) = np.split(np.asarray(result["x"]).ravel(), sizes)
    joints, rates = (each.reshape(q.shape) * scale for each in moved)
    duration = float(np.sqrt(square)) * unit
    motion = Motion(CubicHermiteSpline(time * duration, joints, rates / duration))
    return Smoothed(motion, np.column_stack([tips.reshape(-1, n), joints[:, n:]]), int(stats["iter_count"]))


def begin_rates(q: Array, time: Array) -> Array:
    """(K, m) rates of knots by differences, at rest at both ends."""
    v = np.gradient(q, time, axis=0)
    v[0], v[-1] = 0.0, 0.0
    return np.asarray(v)


def _duration(q: Array, time: Array, rate: Array, acceleration: Array) -> float:
    """Seconds in which knots of joint values are passed without haste."""
    v, step = begin_rates(q, time), np.diff(time)[:, None]
    speed = (np.abs(np.diff(q, axis=0)) / step / rate).max()
    hard = (np.abs(np.diff(v, axis=0)) / step / acceleration).max()
    # More than the differences of knots ask for: between knots cubics are faster.
    return float(max(2.0 * speed, 1.5 * np.sqrt(hard), 1e-2))


def _to_keep(task: PlanTask, program: PathProgram, least: Array, knots: tuple[Array, Arms], room: float) -> Array:
    """(K, rows) least distances to keep, m, at knots (K, m) and their arms: of those of an obstacle, all that of the
    closest. It may fall to `room` above the clearance to keep; not at all where a knot has no more than that to spare;
    and it must grow where there is none.

    The smooth least distances of the program, `least`, are bounded by what they are now less this: where much of an arm
    is about as close as its closest point, they are a few millimetres too small, of all knots alike.
    """
    z, arms = knots
    alone = (replace(task, obstacles=(body,)).clearances(arms) for body in task.obstacles)
    spare = np.array([each - task.clearance for each in alone]).reshape(len(task.obstacles), len(z)).T
    falls = spare - np.minimum(room, np.maximum(spare, task.needed(z)[:, None]))
    body, found = np.array(program.body, dtype=int), least.reshape(len(z), -1)
    closest = np.empty_like(falls)
    for k in range(falls.shape[1]):
        closest[:, k] = found[:, body == k].min(axis=1)
    return np.asarray((closest - falls)[:, body])


def _bounds(
    task: PlanTask, program: PathProgram, start: tuple[Array, Array, Array], objective: str, floor: float
) -> dict[str, Array]:
    """Bounds of unknowns and constraints from knots: joint values, points of the chart, least distances (m) to keep.
    Both ends, which were checked before, are as they are."""
    (q, z, least), space, inf = start, task.chart.space, np.inf
    n, (knots, m) = space.robot.n_tubes, q.shape
    low, high = (np.tile(value / task.scale, (knots, 1)) for value in (space.lower, space.upper))
    low[[0, -1]] = high[[0, -1]] = (q / task.scale)[[0, -1]]
    rate, tip = np.full((knots, m), inf), np.full((knots, n), inf)
    rate[[0, -1]] = 0.0
    lowest = -tip
    lowest[[0, -1]] = tip[[0, -1]] = z[[0, -1], :n]
    most = 0.999 if objective == "margin" else floor
    rows = program.rows
    lower = {name: np.full(size, -inf) for name, size in rows.items()}
    upper = {name: np.full(size, inf) for name, size in rows.items()}
    for name in ("speed", "force", "twist"):
        upper[name][:] = 0.0
    inside = ((np.arange(knots) > 0) & (np.arange(knots) < knots - 1))[:, None]
    lower["order"] = np.tile(space.least / space.length - ROUND_OFF, 2 * (knots - 1))
    ends = q[[0, -1]] / task.scale
    lower["ranges"] = np.tile(np.minimum(space.lower / task.scale, ends.min(0)) - ROUND_OFF, 2 * (knots - 1))
    upper["ranges"] = np.tile(np.maximum(space.upper / task.scale, ends.max(0)) + ROUND_OFF, 2 * (knots - 1))
    limits: dict[str, float | Array] = {"fields": LEAST_FIELDS, "clearance": least / space.length}
    for name, value in limits.items():
        if rows.get(name):
            lower[name] = np.where(inside, value, np.full((knots, rows[name] // knots), -inf)).ravel()
    # The ends' equations hold to the accuracy of the integration; there is nothing to solve.
    free = np.where(inside, 0.0, np.full((knots, n), inf)).ravel()
    lower["equilibrium"], upper["equilibrium"] = -free, free
    return {
        "lbx": np.concatenate([low.ravel(), -rate.ravel(), lowest.ravel(), [1e-6, floor]]),
        # S is at most 4: a motion may take twice as long as the start.
        "ubx": np.concatenate([high.ravel(), rate.ravel(), tip.ravel(), [4.0, most]]),
        "lbg": np.concatenate([lower[name] for name in rows]),
        "ubg": np.concatenate([upper[name] for name in rows]),
    }


def _split(z: Array, share: Array, bad: Mask) -> tuple[Array, Array]:
    """Knots and shares of the time with a knot in the middle of each bad interval."""
    after = np.flatnonzero(bad) + 1
    points = np.insert(z, after, (z[after - 1] + z[after]) / 2, axis=0)
    return points, np.repeat(np.where(bad, share / 2, share), 1 + bad)
