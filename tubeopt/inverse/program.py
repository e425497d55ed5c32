"""The nonlinear program of inverse kinematics, solved by IPOPT: numbers in, posture out.

The order of breakpoints is that of the start. Where a section closes at the solution, the two breakpoints change places
and the program of the new order goes on.
"""

from __future__ import annotations

import numpy as np

from ..control.posture import Posture
from ..equilibrium.continuation import LARGEST_TWIST
from ..equilibrium.solving import DEFAULT_DISCRETISATION, Solution, reduced_problem, to_equilibrium
from ..errors import InputError
from ..solvers.ipopt import start_values
from ..solvers.newton import newton
from ..transcription.block import structure_of
from ..transcription.reduced import margin, to_unknowns
from ..typing import Array
from .collocated import Program, Question, given_values, has_formula, inverse_program
from .descent import Search
from .goal import Goal
from .order import CLOSED, Order, apart, beyond, breakpoint_order

MOST_SWITCHES = 6
"""Changes of the order of breakpoints on the way."""

MOST_BODIES = 16
"""Obstacles at most: every one costs as much as all of the arm."""

MARGIN_ROOM = 1e-4
"""Margin kept above the bound: more than the steps of the Jacobi fields are off."""


def programmable(goal: Goal) -> bool:
    """Whether the program can be written: enough joints for the target, few obstacles, a formula for every one, nothing
    own."""
    if goal.extras.constraints or goal.extras.cost is not None:
        return False
    bodies = goal.scene.bodies
    return not goal.overdetermined and len(bodies) <= MOST_BODIES and all(has_formula(body) for body in bodies)


def solve_program(goal: Goal, start: Posture) -> Search:
    """The program's solution from an allowed posture, on target or not, and through changes of order."""
    here, iterations = apart(goal, start), 0
    best, least = here, (np.inf, np.inf)
    for _ in range(MOST_SWITCHES + 1):
        found, count, crossed = _solve_order(goal, here)
        iterations += count
        if found is None:
            break
        score = _score(goal, found)
        if score >= (least[0] * (1 - 1e-6), least[1] - 1e-9):
            break
        best, least = found, score
        other = beyond(goal, found, crossed)
        if other is None:
            break
        here = other
    return Search(best, goal.reached(best, 1e-8, 1e-8) and goal.allowed(best, 1e-9), iterations, 0)


def _score(goal: Goal, at: Posture) -> tuple[float, float]:
    """What is left to the target, 0 where it is next to nothing, then the cost: less is better."""
    missing = float(np.linalg.norm(goal.residual(at)))
    return (0.0 if missing < 1e-6 else missing), goal.cost(at)


def _solve_order(goal: Goal, at: Posture) -> tuple[Posture | None, int, list[tuple[Array, float]]]:
    """Solve with the order of breakpoints of `at`; the posture reached, iterations, what to cross."""
    space, problem = goal.space, at.solution.problem
    order = breakpoint_order(goal, at)
    program, question = _program(goal, at, order)
    nlp = program.nlp
    if np.count_nonzero(nlp.bounds["lbg"] == nlp.bounds["ubg"]) > len(nlp.names):
        return None, 0, []  # as where all tubes are withdrawn, and nothing is left to turn
    x = start_values(question.structure, problem, at.solution.arm, "equations")
    free = [min(max(at.margin - 0.01, goal.floor), 0.998)] if question.objective == "margin" else []
    x = np.concatenate([at.q, free, x])
    bounds = _bounds(goal, program)
    parameters = _parameters(goal, at, order, question)
    result = program.solver(x0=x / nlp.scale, p=parameters, **bounds)
    stats = program.solver.stats()
    values = np.asarray(result["x"].full()).ravel() * nlp.scale
    if not np.isfinite(values).all():
        return None, 0, []
    iterations = int(stats["iter_count"])
    # Stopped short of the optimum, an iterate may still be a better answer than none, and where this order of
    # breakpoints does not reach the target, the next may: what follows checks.
    usable = stats["success"] or stats["return_status"] in (
        "Maximum_Iterations_Exceeded",
        "Infeasible_Problem_Detected",
    )
    posture = _read(goal, at, program, values, parameters, order) if usable else None
    if posture is None:
        return None, iterations, []
    gap = order.rows @ values[program.joints][space.robot.n_tubes :] - order.bound
    force = np.asarray(result["lam_g"].full()).ravel()[program.closing]
    pressed = ((gap <= 10 * CLOSED) & (np.abs(force) > 1e-7))[: order.changeable]
    return posture, iterations, [(order.rows[k], float(order.bound[k])) for k in np.flatnonzero(pressed)]


def _program(goal: Goal, at: Posture, order: Order) -> tuple[Program, Question]:
    question = Question(
        structure=structure_of(at.solution.problem),
        carriages=goal.space.carriages,
        pointed=goal.pointed,
        aimed=goal.direction is not None and goal.direction_weight is not None,
        objective=goal.objective or "nearest",
        obstacles=goal.scene.bodies,
        length=goal.space.length,
        closings=len(order.bound),
    )
    return inverse_program(question), question


def _bounds(goal: Goal, program: Program) -> dict[str, Array]:
    """Bounds of the scaled program with the ranges of the joints."""
    bounds = {key: value.copy() for key, value in program.nlp.bounds.items()}
    scale = program.nlp.scale[program.joints]
    bounds["lbx"][program.joints] = goal.space.lower / scale
    bounds["ubx"][program.joints] = goal.space.upper / scale
    return bounds


def _parameters(goal: Goal, at: Posture, order: Order, question: Question) -> Array:
    space, problem = goal.space, at.solution.problem
    assembly, mesh = problem.assembly, problem.mesh
    n = space.robot.n_tubes
    shift = (space.spread @ at.q)[n:]
    middle = mesh.start + 0.5 * mesh.length
    return given_values(
        length=order.length,
        length_slope=order.length_slope,
        transmission=assembly.transmission + shift,
        torsional=assembly.torsional_stiffness,
        stiffness=problem.piece_stiffness.T,
        moment=problem.piece_moment.T,
        place=(assembly.offset, assembly.offset_angle) if question.structure.eccentric else None,
        position=goal.position,
        direction=np.zeros(3) if goal.direction is None else goal.direction,
        direction_weight=goal.direction_weight or 0.0,
        min_margin=goal.min_margin + MARGIN_ROOM,
        clearance=goal.gap,
        radius=at.outline.radius(middle),
        reference=at.q if goal.objective is None else goal.reference,
        weights=1 / space.scale if goal.objective is None else goal.weights,
        order=order.rows,
        bound=order.bound,
    )


def _read(goal: Goal, at: Posture, program: Program, values: Array, parameters: Array, order: Order) -> Posture | None:
    """The posture at a solution of the program: solved by Newton's method from its rotations."""
    q = goal.space.clip(values[program.joints])
    rotations, shift = goal.space.split(q)
    theta = program.theta(values / program.nlp.scale, parameters).full().T
    try:
        problem = reduced_problem(goal.space.robot, shift, DEFAULT_DISCRETISATION)
    except InputError:
        return None
    # The mesh may be another one at other lengths: theta is carried over by arc length.
    mesh = at.solution.problem.mesh
    length = order.length + order.length_slope @ q[goal.space.robot.n_tubes :]
    start = np.cumsum(length) - length
    s = (start[:, None] + length[:, None] * mesh.tableau.nodes)[mesh.collocated].ravel()
    guess = np.tile(rotations, (len(problem.arc_length), 1))
    if len(s):
        guess = np.column_stack([np.interp(problem.arc_length, s, column) for column in theta.T])
    result = newton(problem, rotations, to_unknowns(problem, rotations, guess))
    change = np.abs((result.state.theta - guess).ravel()[problem.flat]).max(initial=0.0)
    if not result.converged or change > LARGEST_TWIST:
        return None
    solution = Solution(problem, rotations, result, margin(problem, result.state))
    if solution.margin <= 0:
        return None
    near = to_equilibrium(goal.space.robot, solution, shift, ("ipopt", "inverse kinematics", 0.0))
    # Once more from there, on a mesh as fine as forward kinematics takes.
    return Posture(goal.space, q, near).to(q)
