"""Where a branch of equilibria ends, exactly, and where a robot lands that follows it: downhill in elastic energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy

from ..block.transcription.mesh import make_mesh
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, reduce, to_unknowns
from ..block.transcription.second_variation import margin, softest
from ..equilibrium.continuation import JointPath, Point
from ..equilibrium.solving import Solution
from ..solvers.flow import downhill, flow
from ..solvers.newton import NewtonResult, newton
from ..solvers.settings import CONTINUATION
from ..typing import Array


class Equations(Protocol):
    """Residual (U,) and its Jacobian (U, U)."""

    @property
    def gradient(self) -> Array: ...
    @property
    def hessian(self) -> Array: ...


@dataclass(frozen=True, eq=False)
class Turning:
    """Where a branch turns back: t, unknowns x (U,) there, the direction (U,) without stiffness, and Newton's steps."""

    t: float
    x: Array
    direction: Array
    steps: int


def turning_point(
    at: Callable[[float], Callable[[Array], Equations] | None],
    turn: Callable[[Array], float],
    t: float,
    x: Array,
    border: Array,
) -> Turning | None:
    """Newton on g(x, t) = 0 and sigma(x, t) = 0, the bordered determinant [H p; p' 0] [v; sigma] = [0; 1] that vanishes
    where H is singular (Griewank, Reddien 1984; Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria,
    2000), from close by; None where it does not converge.

    Slopes of H and by t are differences, which shape the steps, not the result; by t to one side where there are no
    equations at the other.

    Args:
        at: the equations in x at t; None where they are of another structure.
        turn: of a step in x, rad.   border: p (U,), the softest direction.
    """
    begin, size = t, len(x)
    for iteration in range(1, CONTINUATION.fold_steps + 1):
        here = at(t)
        if here is None:
            return None
        state, by = here(x), 1e-6 * max(1.0, abs(t))
        sides = [(place, there(x)) for place in (t - by, t + by) if (there := at(place)) is not None]
        if not sides:
            return None
        (first, one), (second, other) = [*sides, (t, state)][:2]
        try:
            bordered = np.block([[state.hessian, border[:, None]], [border, np.zeros(1)]])
            unit = np.append(np.zeros(size), 1.0)
            left, right = np.linalg.solve(bordered.T, unit)[:-1], np.linalg.solve(bordered, unit)
            v, sigma = right[:-1], right[-1]
            push = CONTINUATION.fold_difference / turn(v)
            along = (here(x + push * v).hessian - here(x - push * v).hessian) / (2 * push)
            pull = (other.gradient - one.gradient) / (second - first)
            stiffer = (other.hessian - one.hessian) @ v / (second - first)
            matrix = np.block([[state.hessian, pull[:, None]], [-left @ along, -left @ stiffer]])
            step = np.linalg.solve(matrix, -np.append(state.gradient, sigma))
        except np.linalg.LinAlgError:
            return None
        turned = turn(step[:-1])
        x, t = x + step[:-1], t + float(step[-1])
        if not np.isfinite(turned) or turned > np.pi / 2 or abs(t - begin) > 0.5:
            return None
        if turned < 1e-9:
            return Turning(t, x, v, iteration)
    return None


@dataclass(frozen=True, eq=False)
class Fold:
    """A fold at fraction t: the equilibrium, and the direction (U,) in z in which it has no stiffness."""

    t: float
    solution: Solution
    direction: Array


def polish_fold(path: JointPath, near: Point) -> Fold | None:
    """The fold of a branch near a point of it; None where it is not found."""
    known, state = near.solution.problem, near.solution.result.state

    def at(t: float) -> Callable[[Array], Evaluation] | None:
        problem = _problem_like(path, t, known)
        if problem is None or problem.size != known.size:
            return None
        return lambda z: evaluate(problem, path.at(t)[0], z)

    def turn(step: Array) -> float:
        return float(np.abs(known.factor @ step).max())

    found = turning_point(at, turn, near.t, state.z, softest(known, state))
    problem = None if found is None else _problem_like(path, found.t, known)
    if found is None or problem is None:
        return None
    return Fold(found.t, Solution.at(problem, path.at(found.t)[0], found.x), found.direction)


def _problem_like(path: JointPath, t: float, known: ReducedProblem) -> ReducedProblem | None:
    """The problem at t on a mesh with the pieces of a known one of the path; None where the sections are others."""
    n = path.robot.n_tubes
    if (path.start[n:] == path.end[n:]).all():
        return known
    assembly, count = path.robot.assembly(path.at(t)[1]), known.assembly.n_sections
    if assembly.n_sections != count:
        return None
    return reduce(assembly, make_mesh(assembly, np.bincount(known.mesh.section, minlength=count)))


def land(solution: Solution, direction: Array) -> Solution | None:
    """The minimum to which the energy falls from a fold or an unstable equilibrium, at its joint values.

    The robot is pushed along `direction` (U,) in z to the sides that lead down: one at a fold, both at an unstable
    equilibrium, of which the one that ends lower is taken. From there it takes the way of steepest descent in the norm
    of the torsional energy. None where that leads to no stable equilibrium.

    Of tubes off the centreline the torsional energy leaves out that they are stretched: it only chooses between sides.
    """
    problem, rotations = solution.problem, solution.rotations
    z = to_unknowns(problem, rotations, solution.result.state.theta)
    push = CONTINUATION.nudge / float(np.abs(problem.factor @ direction).max()) * direction
    starts = downhill(z, push, lambda x: evaluate(problem, rotations, x).gradient)
    ends = [result for result in (slide(problem, rotations, start) for start in starts) if result.converged]
    rests = [Solution(problem, rotations, end, margin(problem, end.state)) for end in ends]
    return min((one for one in rests if one.margin > 0), key=lambda one: one.result.state.energy, default=None)


def slide(problem: ReducedProblem, rotations: Array, z: Array) -> NewtonResult[Evaluation]:
    """The gradient flow of the energy from z (U,) to the minimum where it ends.

    Tubes off the centreline flow down what stands for the gradient, their residual: at their fold the same tubes on the
    centreline may still have a minimum close by, in which a descent of that energy would be caught.
    """
    eccentric = problem.assembly.eccentric

    def step(state: Evaluation, time: float) -> tuple[Array, float, bool]:
        change, not_convex = _step(problem, state, np.eye(len(z)) / time)
        return change, float(np.abs(problem.factor @ change).max(initial=0.0)), not_convex

    def moved(state: Evaluation, change: Array) -> Evaluation | None:
        there = evaluate(problem, rotations, state.z + change)
        rises = there.energy > state.energy + 1e-13 * (problem.energy_parts + abs(state.energy))
        return None if rises and not eccentric else there

    return flow(
        evaluate(problem, rotations, z), step, moved, lambda state: newton(problem, rotations, state.z, iterations=4)
    )


def _step(problem: ReducedProblem, state: Evaluation, shift: Array) -> tuple[Array, bool]:
    """Step of the shifted Newton matrix, and whether that is not positive."""
    matrix = state.hessian + shift
    if problem.assembly.eccentric:
        failed = scipy.linalg.lapack.dpotrf((matrix + matrix.T) / 2)[1]
        step = scipy.linalg.lapack.dgesv(matrix, -state.gradient)[2]
    else:
        _, step, failed = scipy.linalg.lapack.dposv(matrix, -state.gradient)
    return np.asarray(step), failed != 0


def distance(a: Solution, b: Solution) -> float:
    """Largest difference (rad) of the rotations of two solutions of the same problem."""
    return float(np.abs(a.result.state.theta - b.result.state.theta).max(initial=0.0))
