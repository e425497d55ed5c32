"""Following a branch of equilibria along a straight path of joint values, up to the fold where it ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..kinematics import DEFAULT_DISCRETISATION, Solution, reduced_problem
from ..robots.assembly import ROUND_OFF, Array
from ..robots.robot import Robot
from ..solvers.newton import NewtonResult, newton
from ..transcription import arm as arms
from ..transcription.buffered import section_function
from ..transcription.mesh import make_mesh
from ..transcription.reduced import Evaluation, ReducedProblem, evaluate, margin, reduce, second_variation, to_unknowns

LARGEST_RATIO = 0.3
"""Newton must shrink its steps at least so much: beyond that it may be on its way to another branch."""

LARGEST_TURN = 0.3
"""Largest change (rad) of a joint rotation in one step of the path: small against a turn, after which another branch
looks like the one that is followed."""

LARGEST_TWIST = 0.6
"""Largest change (rad) of the twist theta - alpha at a point in one step."""

LARGEST_SHIFT = 0.05
"""Largest change of a translation in one step, as a fraction of the longest tube."""

SHORTEST_STEP = 1e-7
"""Fraction of the path below which a step that fails means that the branch has ended."""

FOLD_ITERATIONS = 25


@dataclass(frozen=True, eq=False)
class JointPath:
    """The straight path from `start` to `end`, (2n,) rotations then translations, for fractions t in [0, 1]."""

    robot: Robot
    start: Array
    end: Array

    def at(self, t: float) -> tuple[Array, Array]:
        """Rotations and translations at fraction t."""
        joint = self.end if t == 1.0 else self.start + t * (self.end - self.start)
        rotations, translations = np.split(joint, 2)
        return rotations, translations

    def problem(self, t: float) -> ReducedProblem:
        """The reduced problem at fraction t."""
        return reduced_problem(self.robot, tuple(self.at(t)[1].tolist()), DEFAULT_DISCRETISATION)

    def largest_step(self) -> float:
        """Largest fraction of the path in one step."""
        turn, shift = np.split(np.abs(self.end - self.start), 2)
        longest = max(tube.length for tube in self.robot.tubes)
        steps = max(turn.max() / LARGEST_TURN, shift.max() / (LARGEST_SHIFT * longest), 1.0)
        return 1.0 / float(steps)

    def events(self) -> list[float]:
        """Fractions, 1 included, at which the order of breakpoints may change: two meet, or one meets the plate."""
        rates = np.split(self.end - self.start, 2)[1]
        assembly = self.robot.assembly(np.split(self.start, 2)[1])
        points = np.concatenate([assembly.transition, assembly.end, [0.0]])
        speeds = np.concatenate([rates, rates, [0.0]])
        gap, closing = points[:, None] - points, speeds - speeds[:, None]
        moving = np.abs(closing) > ROUND_OFF
        times = gap[moving] / closing[moving]
        return [*sorted({round(float(t), 12) for t in times if 1e-9 < t < 1 - 1e-9}), 1.0]


@dataclass(frozen=True, eq=False)
class Point:
    """A solved equilibrium at fraction t of a path."""

    t: float
    solution: Solution


def solve_at(path: JointPath, t: float, near: Point, before: Point | None = None) -> Point | None:
    """The equilibrium at fraction t on the branch of `near`, or None where Newton is not at ease.

    The guess is that the twist goes on changing as it did from `before` to `near`.
    """
    problem = path.problem(t)
    rotations = path.at(t)[0]
    twist = _twist(near, problem.arc_length)
    if before is not None and near.t > before.t:
        rate = (twist - _twist(before, problem.arc_length)) * ((t - near.t) / (near.t - before.t))
        twist = twist + np.clip(rate, -LARGEST_TWIST, LARGEST_TWIST)
    guess = rotations + twist
    result = newton(problem, rotations, to_unknowns(problem, rotations, guess), iterations=8)
    if not result.converged or result.contraction > LARGEST_RATIO:
        return None
    # Only the coupled tubes: theta of the others is carried along, not solved for.
    change = (result.state.theta - rotations - _twist(near, problem.arc_length)).ravel()[problem.flat]
    if np.abs(change).max(initial=0.0) > LARGEST_TWIST:
        return None
    return Point(t, Solution(problem, rotations, result, margin(problem, result.state)))


def _twist(point: Point, arc_length: Array) -> Array:
    """theta - alpha (len(arc_length), n); at its own points, of the coupled tubes only."""
    solution = point.solution
    if arc_length is solution.problem.arc_length:
        return solution.result.state.theta - solution.rotations
    return arms.interpolate(solution.problem, solution.arm, arc_length) - solution.rotations


def follow_to(path: JointPath, start: Point, goal: float) -> tuple[list[Point], bool]:
    """Points of the stable branch from `start` up to fraction `goal`, or to just before it ends.

    Between `start` and `goal` the order of breakpoints must not change. Returns the points after `start`, and whether
    the goal was reached.
    """
    points: list[Point] = []
    longest = path.largest_step()
    here, before, step = start, None, longest
    while here.t < goal:
        t = goal if here.t + step >= goal - 1e-12 else here.t + step
        there = solve_at(path, t, here, before)
        if there is None or there.solution.margin <= 0:
            step /= 4 if there is None else 2
            if step < SHORTEST_STEP:
                return points, False
            continue
        points.append(there)
        here, before = there, here
        step = min(2 * step, longest)
    return points, True


@dataclass(frozen=True, eq=False)
class Fold:
    """A fold at fraction t: the equilibrium, and the direction (U,) in z in which it has no stiffness."""

    t: float
    solution: Solution
    direction: Array


def polish_fold(path: JointPath, near: Point) -> Fold | None:
    """Newton on the augmented system  g(z, t) = 0, H(z, t) v = 0, v.v = 1  (Moore and Spence 1980); None where it
    does not converge.

    Derivatives with respect to t are central differences; they shape the steps, not the result.
    """
    known = near.solution.problem
    pieces = np.bincount(known.mesh.section, minlength=known.assembly.n_sections)
    z, t = near.solution.result.state.z, near.t
    v = np.linalg.eigh(second_variation(known, near.solution.result.state))[1][:, 0]
    size = len(z)
    for _ in range(FOLD_ITERATIONS):
        problem = _problem_like(path, t, pieces)
        if problem is None or problem.size != size:
            return None
        state = evaluate(problem, path.at(t)[0], z)
        residual = np.concatenate([state.gradient, state.hessian @ v, [(v @ v - 1) / 2]])
        matrix = np.zeros((2 * size + 1, 2 * size + 1))
        matrix[:size, :size] = state.hessian
        matrix[size : 2 * size, :size] = _hessian_slope(problem, path.at(t)[0], state, v)
        matrix[size : 2 * size, size : 2 * size] = state.hessian
        matrix[2 * size, size : 2 * size] = v
        slope = _t_slope(path, t, pieces, z, v)
        if slope is None:
            return None
        matrix[: 2 * size, 2 * size] = slope
        try:
            step = np.linalg.solve(matrix, -residual)
        except np.linalg.LinAlgError:
            return None
        turn = float(np.abs(problem.factor @ step[:size]).max())
        if not np.isfinite(turn) or turn > np.pi / 2 or abs(t + step[-1] - near.t) > 0.5:
            return None
        z, v, t = z + step[:size], v + step[size:-1], t + float(step[-1])
        if turn < 1e-11 and abs(step[-1]) < 1e-13:
            break
    else:
        if turn > 1e-7:
            return None
    return _fold(path, t, pieces, z, v)


def _fold(path: JointPath, t: float, pieces: NDArray[np.intp], z: Array, v: Array) -> Fold | None:
    problem = _problem_like(path, t, pieces)
    if problem is None:
        return None
    rotations = path.at(t)[0]
    state = evaluate(problem, rotations, z)
    solution = Solution(problem, rotations, NewtonResult(state, True, 0, 0.0), margin(problem, state))
    return Fold(t, solution, v)


def _problem_like(path: JointPath, t: float, pieces: NDArray[np.intp]) -> ReducedProblem | None:
    """The problem at t on a mesh with the same pieces; None where the sections are others."""
    assembly = path.robot.assembly(path.at(t)[1])
    return reduce(assembly, make_mesh(assembly, pieces)) if assembly.n_sections == len(pieces) else None


def _t_slope(path: JointPath, t: float, pieces: NDArray[np.intp], z: Array, v: Array) -> Array | None:
    """d(g, H v)/dt by central differences within the same structure, one-sided where a side leaves it."""
    values: list[Array] = []
    places: list[float] = []
    for at in (t - 1e-6, t + 1e-6, t):
        problem = _problem_like(path, at, pieces)
        if problem is None or problem.size != len(z) or len(values) == 2:
            continue
        state = evaluate(problem, path.at(at)[0], z)
        values.append(np.concatenate([state.gradient, state.hessian @ v]))
        places.append(at)
    return (values[1] - values[0]) / (places[1] - places[0]) if len(values) == 2 else None


def _hessian_slope(problem: ReducedProblem, rotations: Array, state: Evaluation, v: Array) -> Array:
    """(U, U) derivative of H v with respect to z; for tubes off the centreline by central differences."""
    count, n = state.theta.shape
    if problem.assembly.eccentric:
        steps = 1e-6 * np.eye(len(v))
        pairs = ((evaluate(problem, rotations, state.z + s), evaluate(problem, rotations, state.z - s)) for s in steps)
        return np.column_stack([(up.hessian - down.hessian) @ v / 2e-6 for up, down in pairs])
    y = np.zeros((count, n))
    y.ravel()[problem.flat] = problem.factor @ v
    slope = section_function("stiffness_slope", count, n, False)(state.theta, problem.stiffness, problem.moment, y)[0]
    second = np.zeros(problem.size**2)
    second[problem.places] = slope.ravel()[problem.entries] * problem.entry_weight
    return np.asarray(problem.factor.T @ second.reshape(problem.size, -1) @ problem.factor)
