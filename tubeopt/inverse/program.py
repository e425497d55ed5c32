"""The nonlinear program of inverse kinematics, solved by IPOPT: numbers in, posture out.

The order of breakpoints is that of the start. Where a section closes at the solution, the two breakpoints change places
and the program of the new order goes on.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np

from ..block.transcription.program import ease_at_plate, structure_of, torsion_guess, torsion_numbers
from ..equilibrium.answer import to_equilibrium
from ..equilibrium.member import Point, Unloaded
from ..errors import InputError
from ..solvers.ipopt import inside_points
from ..solvers.named_program import ProblemSolution, ProblemStatus
from ..solvers.problem import Problem
from ..solvers.settings import LARGEST_TWIST, Ipopt
from ..typing import Array
from .collocated import SETTINGS, Question, has_formula, inverse_program
from .gauss_newton import Search
from .goal import Goal
from .order import CLOSED_SECTION, Order, apart, beyond, breakpoint_order
from .posture import Posture

ORDERS = 6
"""Changes of the order of breakpoints that a solution goes through at most."""

MOST_BODIES = 16
"""Obstacles for which a program is built: every one costs as much as all of the arm."""

BUILDING = 0.025
"""Seconds that building it may take, per cube of the number of tubes, and per obstacle and one."""

MARGIN_BEYOND = 1e-4
"""Margin that it keeps beyond the bound: its Jacobi fields take coarser steps than forward kinematics."""


def programmable(goal: Goal) -> bool:
    """Whether the program can be written: enough joints for the target, few obstacles, a formula for every one, nothing
    own."""
    if goal.extras.constraints or goal.extras.cost is not None:
        return False
    bodies = goal.scene.bodies
    few = len(bodies) <= MOST_BODIES
    return few and not goal.overdetermined and all(has_formula(body) for body in bodies)


def solve_program(goal: Goal, start: Posture) -> Search:
    """The program's solution from an allowed posture, on target or not, and through changes of order."""
    here, iterations = apart(goal, start), 0
    best, least = here, (np.inf, np.inf)
    for _ in range(ORDERS + 1):
        if goal.clock.left < building(goal):
            break
        found, count, crossed = _solve_order(goal, here)
        iterations += count
        if found is None:
            break
        score = _score(goal, found)
        if score >= (least[0] * (1 - 1e-6), least[1] - 1e-9):
            break
        best, least = found, score
        other = next(beyond(goal, found, crossed), None)
        if other is None:
            break
        here = other
    return Search(best, goal.reached(best, 1e-8, 1e-8) and goal.allowed(best, 1e-9), iterations, 0)


def building(goal: Goal) -> float:
    """Seconds that it may take to build the program and to begin to solve it, which nothing can cut short."""
    return BUILDING * goal.space.robot.n_tubes**3 * (1 + len(goal.scene.bodies))


def _score(goal: Goal, at: Posture) -> tuple[float, float]:
    """What is left to the target, 0 where it is next to nothing, then the cost: less is better."""
    missing = float(np.linalg.norm(goal.residual(at)))
    return (0.0 if missing < 1e-6 else missing), goal.cost(at)


USABLE = (
    ProblemStatus.SOLVED,
    ProblemStatus.TOO_MANY_ITERATIONS,
    ProblemStatus.OUT_OF_TIME,
    ProblemStatus.INFEASIBLE,
)
"""Stopped short of the optimum, an iterate may still be a better answer than none, and where this order of breakpoints
does not reach the target, the next may: what follows checks."""


def _solve_order(goal: Goal, at: Posture) -> tuple[Posture | None, int, list[tuple[Array, float]]]:
    """Solve with the order of breakpoints of `at`; the posture reached, iterations, what to cross."""
    order = breakpoint_order(goal, at)
    if not len(at.problem.mesh.length):
        return None, 0, []  # all tubes are withdrawn, and nothing is left to turn
    program = posed(goal, at, order)
    found = program.attempt(_in_time(goal))
    if not all(np.isfinite(value).all() for value in found.values.values()):
        return None, 0, []
    posture = _read(goal, at, found, order) if found.status in USABLE else None
    if posture is None:
        return None, found.statistics.iterations, []
    gap = order.rows @ found.values["translations"] - order.bound
    force = found.multipliers.get("order of breakpoints", np.zeros(0)) * goal.space.length
    pressed = ((gap <= 10 * CLOSED_SECTION) & (np.abs(force) > 1e-7))[: order.changeable]
    crossed = [(order.rows[k], float(order.bound[k])) for k in np.flatnonzero(pressed)]
    return posture, found.statistics.iterations, crossed


def _in_time(goal: Goal) -> Ipopt:
    """Settings with the time that is left, cut to a power of two: a solver is built for every time limit."""
    left = max(goal.clock.left, building(goal))
    return SETTINGS if left == math.inf else replace(SETTINGS, time_limit=2.0 ** math.floor(math.log2(left)))


def _question(goal: Goal, at: Posture, order: Order) -> Question:
    return Question(
        structure=structure_of(at.problem),
        carriages=goal.space.carriages,
        pointed=goal.pointed,
        aimed=goal.direction is not None and goal.direction_weight is not None,
        objective=goal.objective or "nearest",
        obstacles=goal.scene.bodies,
        length=goal.space.length,
        closings=len(order.bound),
    )


def posed(goal: Goal, at: Posture, order: Order) -> Problem:
    """The program of a goal, with its numbers, that starts at a posture."""
    space, problem = goal.space, at.problem
    program = inverse_program(_question(goal, at, order), threading.get_ident())
    n, mesh = space.robot.n_tubes, problem.mesh
    numbers = torsion_numbers(problem)
    shift = (space.spread @ at.q)[n:]
    if problem.assembly.general:
        cuts = np.append(mesh.start, problem.assembly.total_length)
        numbers |= {
            "ease": ease_at_plate(problem),
            "cuts": cuts,
            "lengths of the mesh": mesh.length,
            "translations of the mesh": shift,
        }
    numbers["transmission at 0"] = numbers.pop("transmission") + numbers.get("ease", 1.0) * shift
    del numbers["lengths"]
    numbers |= {
        "lengths at 0": order.length,
        "lengths per translation": order.length_slope,
        "position": goal.position,
        "direction": np.zeros(3) if goal.direction is None else goal.direction,
        "direction weight": np.array(goal.direction_weight or 0.0),
        "least margin": np.array(goal.min_margin + MARGIN_BEYOND),
        "clearance": np.array(goal.gap),
        "radius": at.outline.radius(mesh.start + 0.5 * mesh.length),
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
        program.set_guess("margin", min(max(at.margin - 0.01, goal.floor), 0.998))
    return program


def _read(goal: Goal, at: Posture, found: ProblemSolution, order: Order) -> Posture | None:
    """The posture at a solution of the program: solved by Newton's method from its rotations."""
    q = goal.space.clip(np.concatenate([found.values["rotations"], found.values["translations"]]))
    rotations, shift = goal.space.split(q)
    theta = inside_points(at.problem, found.values["rotation inside"])
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
    near = to_equilibrium(point, "inverse kinematics")
    # Once more from there, on a mesh as fine as forward kinematics takes.
    return Posture(goal.space, q, near).to(q)
