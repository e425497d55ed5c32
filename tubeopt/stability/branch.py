"""Branch of equilibria through its folds while joints turn: the S-curve, by pseudo-arclength continuation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.continuation import Family, SampledJointPath, path_rates
from ..equilibrium.kinematics import forward_kinematics, point_of, to_equilibrium
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
    """Curve of equilibria, P points in order along it, stable and unstable."""

    fraction: Array
    """(P,) fraction of the path from start to end."""
    rotations: Array
    """(P, n) joint values, rad."""
    tip_rotations: Array
    """(P, n) rotations of the tubes at the tip, rad."""
    margin: Array
    """(P,) margin, negative between two folds."""
    folds: tuple[Equilibrium, ...]
    """Equilibria where the curve turns back, where a robot that follows it snaps."""


# A step turns a point by at most twice the first step: with the default this is at least tens of turns of a tube.
MAX_POINTS = 4000
"""Maximum number of points of a branch."""


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
    """Trace the branch of equilibria from rotations `start` through folds until it leaves the path to `end`.

    Pseudo-arclength continuation (Keller 1977) in the rotations along the arm and the fraction of the path. The branch
    may leave the path at either end.

    Args:
        start, end: (n,) rotations, rad; translations (n,) m, default home.
        equilibrium: start, at rotations `start`; by default that of `forward_kinematics`.
        step: first step of a rotation along the arm or of the joint that turns most, rad; at most half the largest.
        time_limit: maximum run time, s.

    Raises:
        InputError: wrong number of joint values, equal start and end, a step that is not positive, a bundle.
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
    if not robot.fixed_sections:
        raise InputError("kind is bundle; its branch is not traced through folds, follow leads to the first")
    shift = shifts(robot, translations)
    alpha, beta = vector("start", start, robot.n_tubes), vector("end", end, robot.n_tubes)
    check_turn(np.stack([alpha, beta]))
    if np.allclose(alpha, beta, rtol=0, atol=1e-12):
        raise InputError("start and end are the same rotations; they must differ")
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, alpha, shift)
    family = Family(SampledJointPath(robot, np.concatenate([alpha, shift]), np.concatenate([beta, shift])))
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


def _continue(family: Family, start: PlainPoint, first_step: float) -> tuple[list[PlainPoint], list[PlainPoint]]:
    """Points on the branch, and those at folds, from t = 0 until t leaves [0, 1].

    Unknowns are (x, t scale), with t measured in radians of the joint that turns most, so that all have one size.
    """
    path, known = family.path, start.member
    n, scale, factor = path.robot.n_tubes, float(np.abs(path.end - path.start).max()), known.problem.factor

    def member(t: float) -> Unloaded:
        return replace(known, rotations=path.start[:n] + t * (path.end - path.start)[:n])

    def system(unknowns: Array) -> tuple[Array, Array]:
        """Residual (U,) and its Jacobian (U, U + 1); the column of t is a central difference."""
        t, x = unknowns[-1] / scale, unknowns[:-1]
        state, rates = member(t).at(x), path_rates(lambda t: member(t).at, x, t)
        assert rates is not None
        return state.gradient, np.column_stack([state.hessian, rates.gradient / scale])

    def largest_turn(step: Array) -> float:
        return float(np.abs(factor @ step[:-1]).max(initial=0.0))

    unknowns, step = np.append(start.state.x, 0.0), first_step
    tangent = _tangent(system(unknowns)[1], np.append(np.zeros(len(unknowns) - 1), 1.0))
    points, folds = [start], list[PlainPoint]()
    while len(points) < MAX_POINTS:
        angle = max(largest_turn(tangent), abs(float(tangent[-1])))
        corrected = _correct(system, largest_turn, unknowns, tangent * (step / angle))
        if corrected is None:
            step /= 2
            if step < 1e-8:
                raise SolveError(f"the branch was lost at {100 * unknowns[-1] / scale:.3f} % of the path")
            continue
        unknowns, easily = corrected
        t, next_tangent = float(unknowns[-1]) / scale, _tangent(system(unknowns)[1], tangent)
        point = Point.at(member(t), unknowns[:-1], t)
        # At a fold the branch turns back: t begins to fall along it, or to rise again.
        if next_tangent[-1] * tangent[-1] < 0:
            turning = fold(family, point)
            if turning is not None:
                folds.append(turning.point)
                points.append(turning.point)
        if not 0.0 <= t <= 1.0:
            points.append(_at_end(family, points[-1], point))
            break
        tangent = next_tangent
        points.append(point)
        step = min(2 * first_step, step * (1.5 if easily else 1.0))
    return points, folds


def _at_end(family: Family, inside: PlainPoint, outside: PlainPoint) -> PlainPoint:
    """Point where the branch crosses the end of the path, between two points of it."""
    t = 0.0 if outside.t < 0 else 1.0
    fraction = (t - inside.t) / (outside.t - inside.t)
    member = replace(inside.member, rotations=family.path.at(t)[0])
    result = member.solve(inside.state.x + fraction * (outside.state.x - inside.state.x))
    return Point.of(member, result, t) if result.converged else inside


def _tangent(jacobian: Array, previous: Array) -> Array:
    """Unit vector (U + 1,) along the branch, in the direction of the tangent before."""
    tangent: Array = np.linalg.solve(np.vstack([jacobian, previous]), np.append(np.zeros(len(jacobian)), 1.0))
    return tangent / np.linalg.norm(tangent)


def _correct(
    system: Callable[[Array], tuple[Array, Array]],
    largest_turn: Callable[[Array], float],
    unknowns: Array,
    step: Array,
) -> tuple[Array, bool] | None:
    """Point of the branch in the plane across a step, by Newton's method; and True if that took few iterations.

    None if it converges slowly: a shorter step stays on the same branch, a slow one may have left it.
    """
    direction, x, last = step / np.linalg.norm(step), unknowns + step, np.inf
    for iteration in range(7):
        residual, jacobian = system(x)
        change = np.linalg.solve(np.vstack([jacobian, direction]), -np.append(residual, 0.0))
        angle = largest_turn(change)
        if angle > 0.5 * last or angle > 0.3:
            return None
        x, last = x + change, angle
        if angle < 1e-9:
            return x, iteration <= 2
    return None
