"""The whole branch of equilibria while joints turn, through its folds: the S-curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.answer import point_of, to_equilibrium
from ..equilibrium.continuation import Family, JointPath
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.member import PlainPoint, Point, Unloaded
from ..equilibrium.result import Equilibrium, refuse_load
from ..errors import InputError, SolveError, positive, vector
from ..robots.limits import check_turn
from ..robots.robot import Robot, shifts
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import Array
from .folds import fold


@dataclass(frozen=True, eq=False)
class Branch(Displayed):
    """A curve of equilibria, P points in order along it, stable and unstable."""

    fraction: Array
    """(P,) fractions of the path from start to end."""
    rotations: Array
    """(P, n) joint values, rad."""
    tip_rotations: Array
    """(P, n) rotations of the tubes at the tip, rad."""
    margin: Array
    """(P,) margins."""
    folds: tuple[Equilibrium, ...]
    """Equilibria where the curve turns back, where a robot that follows it snaps."""


# A step turns no point by more than twice the first step, so that this is at least tens of turns of a tube.
MOST_POINTS = 4000
"""Maximum number of points of a branch that is traced through its folds."""


@typed
@small
@limited
def trace_branch(
    robot: Robot,
    start: ArrayLike,
    end: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    equilibrium: Equilibrium | None = None,
    step: float = 0.06,
    time_limit: float = TIME_LIMIT,
) -> Branch:
    """The branch of equilibria from rotations `start`, through folds, until it leaves the path to `end` on either side.

    Pseudo-arclength continuation (Keller 1977) in the rotations along the arm and the fraction of the path.

    Args:
        start, end: (n,) rotations, rad; translations (n,) m, default home.
        equilibrium: start, at rotations `start`; by default that of `forward_kinematics`.
        step: first step of a rotation along the arm or of the joint that turns most, rad; at most half the largest.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of joint values, equal start and end, a step that is not positive.
        SolveError: the branch could not be followed.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

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
    check_turn(np.stack([alpha, beta]))
    if np.allclose(alpha, beta, rtol=0, atol=1e-12):
        raise InputError("start and end are the same rotations; they must differ")
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, alpha, shift)
    family = Family(JointPath(robot, np.concatenate([alpha, shift]), np.concatenate([beta, shift])))
    refuse_load(first)
    origin = point_of(first)
    points, folds = _continue(family, origin, positive("step", step))
    equilibria = [to_equilibrium(point, "arclength") for point in points]
    return Branch(
        fraction=np.array([point.t for point in points]),
        rotations=np.array([e.rotations for e in equilibria]),
        tip_rotations=np.array([e.tip_rotations for e in equilibria]),
        margin=np.array([e.margin for e in equilibria]),
        folds=tuple(to_equilibrium(point, "fold") for point in folds),
    )


System = Callable[[Array], tuple[Array, Array]]
"""Residual (U,) and its Jacobian (U, U + 1) at unknowns z and t (U + 1,), t measured in radians of the joint that turns
most, so that both kinds of unknowns have one size."""


def _continue(family: Family, start: PlainPoint, first: float) -> tuple[list[PlainPoint], list[PlainPoint]]:
    """Points, and those at folds, from t = 0 until t leaves [0, 1]."""
    path, known = family.path, start.member
    n, scale, factor = path.robot.n_tubes, float(np.abs(path.end - path.start).max()), known.problem.factor

    def member(t: float) -> Unloaded:
        return replace(known, rotations=path.start[:n] + t * (path.end - path.start)[:n])

    def point(t: float, x: Array) -> PlainPoint:
        return Point.at(member(t), x, t)

    def system(x: Array) -> tuple[Array, Array]:
        t = x[-1] / scale
        here, ahead, behind = (member(at).at(x[:-1]) for at in (t, t + 1e-6, t - 1e-6))
        return here.gradient, np.column_stack([here.hessian, (ahead.gradient - behind.gradient) / (2e-6 * scale)])

    t, x, step = 0.0, np.append(start.state.x, 0.0), first
    tangent = _tangent(system(x)[1], np.append(np.zeros(len(x) - 1), 1.0))
    points, folds = [start], list[PlainPoint]()
    while len(points) < MOST_POINTS:
        turn = max(float(np.abs(factor @ tangent[:-1]).max(initial=0.0)), abs(float(tangent[-1])))
        trial = _correct(system, factor, x, tangent * (step / turn))
        if trial is None:
            step /= 2
            if step < 1e-8:
                raise SolveError(f"the branch was lost at {100 * t:.3f} % of the path")
            continue
        ahead, easy = trial
        t_new, following = float(ahead[-1]) / scale, _tangent(system(ahead)[1], tangent)
        there = point(t_new, ahead[:-1])
        if following[-1] * tangent[-1] < 0:
            turning = fold(family, there)
            if turning is not None:
                folds.append(turning.point)
                points.append(turning.point)
        if not 0.0 <= t_new <= 1.0:
            points.append(_last(family, points[-1], there))
            break
        t, x, tangent = t_new, ahead, following
        points.append(there)
        step = min(2 * first, step * (1.5 if easy else 1.0))
    return points, folds


def _last(family: Family, inside: PlainPoint, outside: PlainPoint) -> PlainPoint:
    """The point of the branch where it crosses the end of the path, between two points of it."""
    t = 0.0 if outside.t < 0 else 1.0
    fraction = (t - inside.t) / (outside.t - inside.t)
    there = replace(inside.member, rotations=family.path.at(t)[0])
    result = there.solve(inside.state.x + fraction * (outside.state.x - inside.state.x))
    return Point.of(there, result, t) if result.converged else inside


def _tangent(jacobian: Array, like: Array) -> Array:
    """Unit vector (U + 1,) along the branch, on the side of `like`."""
    tangent: Array = np.linalg.solve(np.vstack([jacobian, like]), np.append(np.zeros(len(jacobian)), 1.0))
    return tangent / np.linalg.norm(tangent)


def _correct(system: System, factor: Array, x: Array, step: Array) -> tuple[Array, bool] | None:
    """Newton back to the branch in the plane across a step, and whether that is easy; None where it does not converge
    quickly."""
    direction, x, last = step / np.linalg.norm(step), x + step, np.inf
    for iteration in range(7):
        residual, jacobian = system(x)
        change = np.linalg.solve(np.vstack([jacobian, direction]), -np.append(residual, 0.0))
        size = float(np.abs(factor @ change[:-1]).max(initial=0.0))
        if size > 0.5 * last or size > 0.3:
            return None
        x, last = x + change, size
        if size < 1e-9:
            return x, iteration <= 2
    return None
