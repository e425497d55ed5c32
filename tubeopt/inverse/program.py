"""Inverse kinematics as one nonlinear program: torsion of an arm with free joint values.

Beside the unknowns and equations of the torsion there are the joint values, in which base rotations, transmissions and
the lengths of the elements are linear as long as the breakpoints keep their order; the pose of the tip, integrated
along the elements; and the margin as a smooth constraint. The last is Jacobi's: with all torsional stiffnesses
reduced by the fraction mu, the fields

    (1 - mu) kt Y'' = V'' Y,   Y = 1, Y' = 0 at the tip

keep det Y > 0 along the arm and det(Y(0) - |beta| Y'(0)) > 0 if and only if the margin is above mu. The determinants
are smooth in all unknowns; the smallest eigenvalue is not where two of them cross, and is capped at 1 where nothing
couples. Shape and fields are marched and not lifted into unknowns, as in an `EquilibriumBlock`: a solve of this small
program, with first derivatives, then takes a tenth of the time.

The order of breakpoints is that of the start. Where a section closes at the solution, the two breakpoints change places
and the program of the new order continues.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..block.transcription.chain import shifted_columns
from ..block.transcription.collocated import Grid, shape_of, symbolic_element, torsion_of
from ..block.transcription.explicit import marched_fields
from ..block.transcription.functions import determinant_function
from ..block.transcription.model import TorsionModel
from ..block.transcription.program import (
    Structure,
    add_torsion,
    compliance_ratio_at_plate,
    structure_of,
    torsion_guess,
    torsion_numbers,
)
from ..bodies.obstacles import Obstacle
from ..equilibrium.kinematics import to_equilibrium
from ..equilibrium.member import Point, Unloaded
from ..errors import InputError
from ..physics.shape import GAUSS_POINTS, rotation_matrix
from ..solvers.ipopt import inside_points
from ..solvers.named_program import ProblemSolution, ProblemStatus
from ..solvers.problem import Problem
from ..solvers.settings import LARGEST_TWIST, Ipopt
from ..typing import Array
from .breakpoint_order import (
    CLOSED_SECTION,
    OrderConstraints,
    breakpoint_order,
    cross_breakpoints,
    separate_breakpoints,
)
from .gauss_newton import DescentSearch
from .goal import Goal
from .posture import Posture

# The program only needs the right basin: Newton's method on the fine mesh finishes its answer.
SHAPE_STEPS = 2
"""Steps of the shape per element: the fast path, and forward kinematics after it, integrate more finely."""

SHARPNESS = 30.0
"""Sharpness of the smooth least distance from an obstacle, over the length of the robot: on the safe side."""

SETTINGS = Ipopt(tolerance=1e-7, constraint_tolerance=1e-10, iterations=150, hessian="limited-memory", expand=True)
"""Second derivatives of shape and Jacobi fields take seconds to build for every order of breakpoints; IPOPT's
quasi-Newton approximation needs no more iterations with them than without."""


@dataclass(frozen=True)
class ProgramStructure:
    """Structure of a program: two goals with equal values share one program, with other numbers."""

    structure: Structure
    carriages: tuple[tuple[int, ...], ...]
    pointed: bool
    """True if the direction is a constraint."""
    aimed: bool
    """True if the direction is a cost."""
    objective: str
    """"nearest", "margin" or "curvature"."""
    obstacles: tuple[Obstacle, ...]
    """Obstacles that the arm avoids."""
    length: float
    """Length of the robot, the unit of distances, m."""
    closings: int
    """Number of constraints on the order of breakpoints and tubes."""


def inverse_program(question: ProgramStructure, thread: int) -> Problem:
    """Program of a question, cached while it is among the last ones; each `thread` has its own numbers.

    Variables: `rotations` (n,), `translations` (G,) of the carriages, `margin` where it is maximised, and the torsion.
    Parameters beside those of the torsion: `lengths at 0` (P,), `lengths per translation` (P, G), `transmission at 0`
    (n,) at translations 0; of tubes made of pieces `compliance ratio` (n,) at the plate, and `cuts` (P + 1,) between
    the elements where the `translations of the mesh` (n,) are those of the start, with the `lengths of the mesh` (P,);
    `position`, `direction`, `direction weight`, `least margin`, `clearance`, `radius` (P,); `reference` and `weights`
    of the joints; `order` (closings, G) and its `bound`.
    """
    return (_among_bodies if question.obstacles else _in_free_space)(question, thread)


def _program(question: ProgramStructure, _thread: int) -> Problem:
    structure, length = question.structure, question.length
    n, groups, elements = structure.grid.n_tubes, len(question.carriages), len(structure.section)
    problem = Problem("inverse kinematics")

    def parameter(name: str, rows: int = 1, columns: int = 1) -> Any:
        return ca.reshape(problem.parameter(name, np.zeros(rows * columns)), rows, columns)

    alpha, shift = problem.variable("rotations", n), problem.variable("translations", groups, scale=length / 2)
    margin = min_margin = parameter("least margin")
    if question.objective == "margin":
        margin = problem.variable("margin", lower=0.0, upper=0.999)
        problem.subject_to("margin above its bound", margin - min_margin)
        problem.maximize(margin)
    moved = ca.vertcat(*(shift[k] for i in range(n) for k, tubes in enumerate(question.carriages) if i in tubes))
    replaced = {
        "transmission": parameter("transmission at 0", n) - moved,
        "lengths": parameter("lengths at 0", elements) + parameter("lengths per translation", elements, groups) @ shift,
    }
    if structure.grid.detail:
        replaced["transmission"] += (1 - parameter("compliance ratio", n)) * moved
        passed = ca.vertcat(0, ca.cumsum(replaced["lengths"])) - parameter("cuts", elements + 1)
        out = moved - parameter("translations of the mesh", n)
        table = parameter("along", *structure.shapes["along"])
        replaced["along"] = shifted_columns(
            table, structure.grid.detail, parameter("lengths of the mesh", elements), passed, out
        )
    arm = add_torsion(problem, structure, alpha, replaced)
    frame, tip, points, bend = _shape(arm)
    direction, target, weight = frame[:, 2], parameter("direction", 3), parameter("direction weight")
    problem.subject_to("tip position", tip - parameter("position", 3), upper=0.0, scale=length)
    if question.pointed:
        problem.subject_to("tip direction", _lateral_deviation(direction, target), upper=0.0)
        problem.subject_to("tip direction, sense", ca.dot(direction, target))
    fields = _jacobi(arm, structure.coupled, margin)
    names = [f"margin, Jacobi fields at element {k + 1}" for k in range(elements - 1)] + ["margin"]
    problem.subject_to("Jacobi fields", fields, entries=names)
    order, bound = parameter("order", question.closings, groups), parameter("bound", question.closings)
    if question.closings:
        problem.subject_to("order of breakpoints", order @ shift - bound, scale=length)
    clearance, radius = parameter("clearance"), parameter("radius", elements)
    for k, obstacle in enumerate(question.obstacles):
        far = _soft_distance(obstacle, points.shape[1], length)
        thick = ca.reshape(ca.repmat(radius.T, 2 * SHAPE_STEPS, 1), 1, -1)
        clear = far(points, ca.horzcat(radius[0], thick))
        problem.subject_to(f"clearance of obstacle {k + 1}", clear - clearance, scale=length)
    off = parameter("weights", n + groups) * (ca.vertcat(alpha, shift) - parameter("reference", n + groups))
    cost = {"nearest": ca.sumsqr(off) / 2, "margin": -margin, "curvature": bend * length / 2}[question.objective]
    problem.minimize(cost + weight * ca.sumsqr(direction - target) / 2 if question.aimed else cost)
    return problem


_in_free_space = lru_cache(maxsize=64)(_program)

_among_bodies = lru_cache(maxsize=8)(_program)
"""Cached programs among obstacles: distances from the segments of a path, for points along an arm, take 60 MB."""


def _lateral_deviation(direction: Any, target: Any) -> Any:
    """(2,) components of a direction square to the target, in the basis of Duff et al. (JCGT 6(1), 2017)."""
    x, y, z = target[0], target[1], target[2]
    sign = ca.if_else(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = ca.vertcat(1 + sign * x**2 * a, sign * b, -sign * x)
    second = ca.vertcat(b, sign + y**2 * a, -y)
    return ca.vertcat(ca.dot(first, direction), ca.dot(second, direction))


@lru_cache(maxsize=8)  # not more: what is cached keeps its body, which may be a table of 100 MB
def has_formula(obstacle: Obstacle) -> bool:
    """Return whether the distance to an obstacle has a symbolic expression."""
    point = ca.SX.sym("p", 3)
    try:
        obstacle.distance(point[0], point[1], point[2])
    except InputError:
        return False
    return True


def _soft_distance(obstacle: Obstacle, count: int, length: float) -> ca.Function:
    """Function (points (3, count), radii (1, count)) -> smooth lower bound on the least distance from an obstacle, m.

    The bound is -log(sum exp(-k d)) / k.
    """
    sharp, points, radius = SHARPNESS * 10 / length, ca.SX.sym("p", 3, count), ca.SX.sym("r", 1, count)
    distance = [obstacle.distance(*ca.vertsplit(points[:, k])) - radius[k] for k in range(count)]
    return ca.Function("soft", [points, radius], [-ca.logsumexp(-sharp * ca.vertcat(*distance)) / sharp])


class _Shape(NamedTuple):
    """Shape of an arm as expressions."""

    frame: Any
    """Frame (3, 3) of the tip."""
    position: Any
    """Position (3,) of the tip, m."""
    points: Any
    """Points (3, 1 + 2 SHAPE_STEPS P) along the arm, m."""
    bending: Any
    """Integral of |u|^2 ds, 1/m."""


def _shape(arm: TorsionModel) -> _Shape:
    """Shape of an arm by Magnus steps over its P elements."""
    frame, position, bending = ca.MX(ca.DM.eye(3)), ca.MX(ca.DM.zeros(3)), ca.MX(0)
    points = [position]
    for k in range(arm.n_elements):
        frame, position, inside, part = _element_shape(arm.grid)(frame, position, *arm.element(k))
        points.append(inside)
        bending = bending + part
    return _Shape(frame, position, ca.horzcat(*points), bending)


@lru_cache(maxsize=16)
def _element_shape(grid: Grid) -> ca.Function:
    """Function (R, p, arguments of an element) -> pose at its end, points (3, 2 SHAPE_STEPS) in it, int |u|^2 ds."""
    torsion = torsion_of(symbolic_element(grid))
    frame, start = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3)
    h, points, before, ahead = torsion.element.length / SHAPE_STEPS, [], start, frame[:, 2]
    for rotation_vector, shift, _ in shape_of(torsion, steps=SHAPE_STEPS):
        position, turned = start + frame @ shift, frame @ rotation_matrix(rotation_vector)
        # Halfway on the cubic with the tangents at both ends.
        points += [(before + position) / 2 + h * (ahead - turned[:, 2]) / 8, position]
        before, ahead = position, turned[:, 2]
    u = torsion.curvature(((np.arange(SHAPE_STEPS)[:, None] + GAUSS_POINTS) / SHAPE_STEPS).ravel())
    bend = h * ca.dot(ca.repmat(ca.DM([5, 8, 5]) / 18, SHAPE_STEPS, 1), ca.sum1(u**2).T)
    outputs = [turned, position, ca.horzcat(*points), bend]
    return ca.Function("shape", [frame, start, *torsion.element.arguments], outputs, {"cse": True})


def _jacobi(arm: TorsionModel, coupled: tuple[bool, ...], margin: Any) -> Any:
    """Determinants of the Jacobi fields of tubes softened by `margin`.

    They are at the starts of elements, tip to base, then at the base with the transmissions.
    """
    n = arm.grid.n_tubes
    determinant = determinant_function(n)
    y, v = ca.MX(ca.DM.eye(n)), ca.MX(ca.DM.zeros(n, n))
    out = []
    for k in reversed(range(arm.n_elements)):
        if coupled[k] or arm.grid.detail:
            y, v = ca.vertsplit(_element_fields(arm.grid)(ca.vertcat(y, v), margin, *arm.element(k)), n)
        else:
            y = y - arm.lengths[k] * v
        if k:
            out.append(determinant(y))
    out.append(determinant(y - ca.repmat(arm.transmission, 1, n) * v))
    return ca.vertcat(*out)


@lru_cache(maxsize=16)
def _element_fields(grid: Grid) -> ca.Function:
    """Function (fields (2n, n) at the end of an element, margin, its arguments) -> fields at its start."""
    torsion, n = torsion_of(symbolic_element(grid)), grid.n_tubes
    fields, margin = ca.SX.sym("fields", 2 * n, n), ca.SX.sym("margin")
    marched = marched_fields(torsion, fields, margin)
    return ca.Function("fields", [fields, margin, *torsion.element.arguments], [marched], {"cse": True})


ORDERS = 6
"""Largest number of changes of the order of breakpoints in a solution."""

# Distances are written out for every point along the arm.
MAX_BODIES = 16
"""Largest number of obstacles in a program: each one costs as much as the arm."""

# CasADi's construction cannot be interrupted. A program is begun only where more time than this is left, so that a
# time limit is kept.
BUILDING = 0.025
"""Seconds that building it may take, per cube of the number of tubes, and per obstacle and one."""

# Forward kinematics, on a finer mesh, then finds the margin above its bound.
MARGIN_BEYOND = 1e-4
"""Margin that it keeps beyond the bound: its Jacobi fields take coarser steps than forward kinematics."""


def programmable(goal: Goal) -> bool:
    """True if the program can be stated: enough joints, few obstacles with formulas, and nothing custom."""
    if goal.extras.constraints or goal.extras.cost is not None or not goal.space.robot.fixed_sections:
        return False
    bodies = goal.scene.bodies
    few = len(bodies) <= MAX_BODIES
    return few and not goal.overdetermined and all(has_formula(body) for body in bodies)


def solve_program(goal: Goal, start: Posture) -> DescentSearch:
    """Solution of the program from an allowed posture, on target or not, with changes of the order of breakpoints."""
    current, iterations = separate_breakpoints(goal, start), 0
    best, best_score = current, (np.inf, np.inf)
    for _ in range(ORDERS + 1):
        if goal.clock.left < building(goal):
            break
        solution = _solve_order(goal, current)
        iterations += solution.iterations
        if solution.posture is None:
            break
        score = _score(goal, solution.posture)
        if score >= (best_score[0] * (1 - 1e-6), best_score[1] - 1e-9):
            break
        best, best_score = solution.posture, score
        crossed = next(cross_breakpoints(goal, best, solution.active_sections), None)
        if crossed is None:
            break
        current = crossed
    return DescentSearch(best, goal.reached(best, 1e-8, 1e-8) and goal.allowed(best, 1e-9), iterations, 0)


def building(goal: Goal) -> float:
    """Longest time, s, that building the program and starting its solve may take without a check of the clock."""
    return BUILDING * goal.space.robot.n_tubes**3 * (1 + len(goal.scene.bodies))


def _score(goal: Goal, at: Posture) -> tuple[float, float]:
    """Sort key, the better posture first: norm of the residual, rounded to 0 near the target, then the cost."""
    residual = float(np.linalg.norm(goal.residual(at)))
    return (0.0 if residual < 1e-6 else residual), goal.cost(at)


USABLE = (
    ProblemStatus.SOLVED,
    ProblemStatus.TOO_MANY_ITERATIONS,
    ProblemStatus.OUT_OF_TIME,
    ProblemStatus.INFEASIBLE,
)
"""Statuses with a usable result, which is checked afterwards.

An iterate that stopped before the optimum may be good enough. If this order of breakpoints does not reach the target,
the next one may.
"""


class _OrderSolution(NamedTuple):
    """Solution within one order of breakpoints."""

    posture: Posture | None
    """Posture of the solution; None if it is not usable."""
    iterations: int
    active_sections: list[tuple[Array, float]]
    """Rows and bounds of closed sections with multipliers: beyond them the cost decreases."""


def _solve_order(goal: Goal, at: Posture) -> _OrderSolution:
    """Solve the program within the order of breakpoints of a posture."""
    order = breakpoint_order(goal.space, at)
    if not len(at.problem.mesh.length):
        return _OrderSolution(None, 0, [])  # all tubes are withdrawn, and nothing is left to turn
    program = posed(goal, at, order)
    solution = program.attempt(_in_time(goal))
    if not all(np.isfinite(value).all() for value in solution.values.values()):
        return _OrderSolution(None, 0, [])
    posture = _read(goal, at, solution, order) if solution.status in USABLE else None
    if posture is None:
        return _OrderSolution(None, solution.statistics.iterations, [])
    length = order.rows @ solution.values["translations"] - order.bound
    multiplier = solution.multipliers.get("order of breakpoints", np.zeros(0)) * goal.space.length
    active = ((length <= 10 * CLOSED_SECTION) & (np.abs(multiplier) > 1e-7))[: order.changeable]
    sections = [(order.rows[k], float(order.bound[k])) for k in np.flatnonzero(active)]
    return _OrderSolution(posture, solution.statistics.iterations, sections)


def _in_time(goal: Goal) -> Ipopt:
    """Settings with the remaining time, rounded down to a power of two: a solver is built for every time limit."""
    left = max(goal.clock.left, building(goal))
    return SETTINGS if left == math.inf else replace(SETTINGS, time_limit=2.0 ** math.floor(math.log2(left)))


def _question(goal: Goal, at: Posture, order: OrderConstraints) -> ProgramStructure:
    return ProgramStructure(
        structure=structure_of(at.problem),
        carriages=goal.space.carriages,
        pointed=goal.pointed,
        aimed=goal.direction is not None and goal.direction_weight is not None,
        objective=goal.objective or "nearest",
        obstacles=goal.scene.bodies,
        length=goal.space.length,
        closings=len(order.bound),
    )


def posed(goal: Goal, at: Posture, order: OrderConstraints) -> Problem:
    """Program of a goal with its numbers, and a posture as the start."""
    space, problem = goal.space, at.problem
    program = inverse_program(_question(goal, at, order), threading.get_ident())
    n, mesh = space.robot.n_tubes, problem.mesh
    numbers = torsion_numbers(problem)
    shift = (space.spread @ at.q)[n:]
    if problem.assembly.general:
        cuts = np.append(mesh.start, problem.assembly.total_length)
        numbers |= {
            "compliance ratio": compliance_ratio_at_plate(problem),
            "cuts": cuts,
            "lengths of the mesh": mesh.length,
            "translations of the mesh": shift,
        }
    numbers["transmission at 0"] = numbers.pop("transmission") + numbers.get("compliance ratio", 1.0) * shift
    del numbers["lengths"]
    numbers |= {
        "lengths at 0": order.length,
        "lengths per translation": order.length_slope,
        "position": goal.position,
        "direction": np.zeros(3) if goal.direction is None else goal.direction,
        "direction weight": np.array(goal.direction_weight or 0.0),
        "least margin": np.array(goal.min_margin + MARGIN_BEYOND),
        "clearance": np.array(goal.kept_clearance),
        "radius": at.surface.radius(mesh.start + 0.5 * mesh.length),
        "reference": at.q if goal.objective is None else goal.reference,
        "weights": 1 / space.scale if goal.objective is None else goal.weights,
        "order": order.rows,
        "bound": order.bound,
    }
    for name, value in numbers.items():
        program.set_value(name, np.ravel(value, order="F"))
    for name, value in torsion_guess(problem, at.solution.torsion).items():
        program.set_guess(name, value)
    for name, part in (("rotations", slice(0, n)), ("translations", slice(n, None))):
        program.set_guess(name, at.q[part])
        program.set_bounds(name, space.lower[part], space.upper[part])
    if goal.objective == "margin":
        program.set_guess("margin", min(max(at.margin - 0.01, goal.kept_margin), 0.998))
    return program


def _read(goal: Goal, at: Posture, solution: ProblemSolution, order: OrderConstraints) -> Posture | None:
    """Posture at a solution of the program, by Newton's method from its rotations; None if that fails."""
    q = goal.space.clip(np.concatenate([solution.values["rotations"], solution.values["translations"]]))
    rotations, shift = goal.space.split(q)
    theta = inside_points(at.problem, solution.values["rotation inside"])
    try:
        member = Unloaded.of(goal.space.robot, rotations, shift)
    except InputError:
        return None
    # The mesh may be another one at other lengths: theta is carried over by arc length.
    mesh, problem = at.problem.mesh, member.problem
    length = order.length + order.length_slope @ q[goal.space.robot.n_tubes :]
    start = np.cumsum(length) - length
    s = (start[:, None] + length[:, None] * mesh.tableau.nodes)[mesh.collocated].ravel()
    guess = np.tile(rotations, (len(problem.arc_length), 1))
    if len(s):
        guess = np.column_stack([np.interp(problem.arc_length, s, column) for column in theta.T])
    result = member.solve(member.unknowns(guess))
    change = np.abs((result.state.theta - guess).ravel()[problem.flat]).max(initial=0.0)
    if not result.converged or change > LARGEST_TWIST:
        return None
    point = Point.of(member, result)
    if point.margin <= 0:
        return None
    equilibrium = to_equilibrium(point, "inverse kinematics")
    # Once more from there, on a mesh as fine as forward kinematics takes.
    return Posture(goal.space, q, equilibrium).to(q)
