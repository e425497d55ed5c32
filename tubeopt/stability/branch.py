"""The whole branch of equilibria while joints turn, through its folds: the S-curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..block.transcription.reduced import ReducedProblem, evaluate
from ..display import Displayed
from ..equilibrium.continuation import JointPath, Point
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..equilibrium.solving import Solution, polish, to_equilibrium
from ..errors import InputError, SolveError, positive, vector
from ..robots.robot import Robot, shifts
from ..solvers.newton import newton
from ..solvers.parallel.blas import small
from ..solvers.settings import CONTINUATION
from ..typing import Array
from .folds import Fold, polish_fold


@dataclass(frozen=True, eq=False)
class Branch(Displayed):
    """A curve of equilibria, P points in order along it, stable and unstable.

    fraction (P,): of the way from start to end.  rotations (P, n): joint values.  tip_rotations (P, n), margin (P,).
    folds: the equilibria where the curve turns back, where a robot that follows it snaps.
    """

    fraction: Array
    rotations: Array
    tip_rotations: Array
    margin: Array
    folds: tuple[Equilibrium, ...]


@small
def trace_branch(
    robot: Robot,
    start: ArrayLike,
    end: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    equilibrium: Equilibrium | None = None,
    step: float = 0.06,
) -> Branch:
    """Follow the branch through folds from rotations `start` until it leaves the way to `end` at either side.

    Pseudo-arclength continuation (Keller 1977) in the rotations along the arm and the fraction of the way.

    Args:
        start, end: (n,) rotations, rad; translations (n,) m, default home.
        equilibrium: where to begin, at rotations `start`; default that of `forward_kinematics`.
        step: first change of a rotation along the arm or of the joint that turns most, rad, and half the largest.

    Raises:
        InputError: wrong number of joint values, start and end the same, a step that is not positive.
        SolveError: the branch could not be followed.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> branch = tubeopt.trace_branch(robot, [0, 0, 0], np.radians([360, 0, 0]))
        >>> len(branch.folds)
        2
    """
    shift = shifts(robot, translations)
    alpha, beta = vector("start", start, robot.n_tubes), vector("end", end, robot.n_tubes)
    if np.allclose(alpha, beta, rtol=0, atol=1e-12):
        raise InputError("start and end are the same rotations; a branch needs a way")
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, alpha, shift)
    path = JointPath(robot, np.concatenate([alpha, shift]), np.concatenate([beta, shift]))
    solution = polish(first)
    problem = solution.problem
    points, folds = _continue(path, problem, solution.result.state.z, positive("step", step))
    how, solutions = ("newton", "arclength", 0.0), [Solution.at(problem, path.at(t)[0], z) for t, z in points]
    equilibria = [to_equilibrium(robot, each, tuple(shift.tolist()), how) for each in solutions]
    return Branch(
        fraction=np.array([t for t, _ in points]),
        rotations=np.array([e.rotations for e in equilibria]),
        tip_rotations=np.array([e.tip_rotations for e in equilibria]),
        margin=np.array([e.margin for e in equilibria]),
        folds=tuple(
            to_equilibrium(robot, fold.solution, tuple(shift.tolist()), ("newton", "fold", 0.0)) for fold in folds
        ),
    )


def _system(path: JointPath, problem: ReducedProblem, t: float, z: Array) -> tuple[Array, Array, Array]:
    """Residual (U,), Jacobian (U, U), and derivative with respect to t (U,), of the equations."""
    n = problem.assembly.n_tubes
    way = (path.end - path.start)[:n]
    here, ahead, behind = (evaluate(problem, path.start[:n] + at * way, z) for at in (t, t + 1e-6, t - 1e-6))
    return here.gradient, here.hessian, (ahead.gradient - behind.gradient) / 2e-6


def _continue(
    path: JointPath, problem: ReducedProblem, z: Array, first: float
) -> tuple[list[tuple[float, Array]], list[Fold]]:
    """Points (t, z) and folds, from t = 0 until t leaves [0, 1]."""
    # t is measured in radians of the joint that turns most, so that both kinds of unknowns have one size.
    scale = float(np.abs(path.end - path.start).max())
    t, step = 0.0, first
    _, hessian, slope = _system(path, problem, t, z)
    tangent = _tangent(hessian, slope / scale, np.append(np.zeros(len(z)), 1.0))
    points, folds = [(t, z)], []
    while len(points) < CONTINUATION.branch_points:
        turn = max(float(np.abs(problem.factor @ tangent[:-1]).max(initial=0.0)), abs(float(tangent[-1])))
        trial = _correct(path, problem, t, z, tangent * (step / turn), scale)
        if trial is None:
            step /= 2
            if step < 1e-8:
                raise SolveError(f"the branch was lost at {100 * t:.3f} % of the way")
            continue
        t_new, z_new, easy = trial
        _, hessian, slope = _system(path, problem, t_new, z_new)
        following = _tangent(hessian, slope / scale, tangent)
        if following[-1] * tangent[-1] < 0:
            fold = polish_fold(path, Point(t_new, Solution.at(problem, path.at(t_new)[0], z_new)))
            if fold is not None:
                folds.append(fold)
                points.append((fold.t, fold.solution.result.state.z))
        if not 0.0 <= t_new <= 1.0:
            points.append(_last(path, problem, (t, z), (t_new, z_new)))
            break
        t, z, tangent = t_new, z_new, following
        points.append((t, z))
        step = min(2 * first, step * (1.5 if easy else 1.0))
    return points, folds


def _last(
    path: JointPath, problem: ReducedProblem, inside: tuple[float, Array], outside: tuple[float, Array]
) -> tuple[float, Array]:
    """The point of the branch where it crosses the end of the way, between two points of it."""
    t = 0.0 if outside[0] < 0 else 1.0
    share = (t - inside[0]) / (outside[0] - inside[0])
    result = newton(problem, path.at(t)[0], inside[1] + share * (outside[1] - inside[1]))
    return (t, result.state.z) if result.converged else inside


def _tangent(hessian: Array, slope: Array, like: Array) -> Array:
    """Unit vector (z, scaled t) along the branch, on the side of `like`."""
    matrix = np.vstack([np.column_stack([hessian, slope]), like])
    tangent: Array = np.linalg.solve(matrix, np.append(np.zeros(len(hessian)), 1.0))
    return tangent / np.linalg.norm(tangent)


def _correct(
    path: JointPath, problem: ReducedProblem, t: float, z: Array, step: Array, scale: float
) -> tuple[float, Array, bool] | None:
    """Newton back to the branch in the plane across it; None where it does not converge quickly."""
    direction = step / np.linalg.norm(step)
    z_new, t_new = z + step[:-1], t + float(step[-1]) / scale
    last = np.inf
    for iteration in range(7):
        residual, hessian, slope = _system(path, problem, t_new, z_new)
        matrix = np.vstack([np.column_stack([hessian, slope / scale]), direction])
        change = np.linalg.solve(matrix, -np.append(residual, 0.0))
        size = float(np.abs(problem.factor @ change[:-1]).max(initial=0.0))
        if size > 0.5 * last or size > 0.3:
            return None
        z_new, t_new, last = z_new + change[:-1], t_new + float(change[-1]) / scale, size
        if size < 1e-9:
            return t_new, z_new, iteration <= 2
    return None
