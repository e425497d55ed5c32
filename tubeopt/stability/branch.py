"""Branch of equilibria through its folds while joints turn: the S-curve, by pseudo-arclength continuation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription.bundle import CLOSING, VanishingError, holding_forces, opened, rearranged
from ..display import Displayed
from ..equilibrium.bundle import NO_RIDGE, Bundled
from ..equilibrium.continuation import Family, SampledJointPath, path_rates
from ..equilibrium.kinematics import forward_kinematics, point_of, to_equilibrium
from ..equilibrium.member import AnyPoint, Member, Point
from ..equilibrium.result import Equilibrium, refuse_load
from ..errors import InputError, SolveError, positive, vector
from ..robots.limits import check_turn
from ..robots.robot import Robot, shifts
from ..solvers.blas import small
from ..solvers.newton import full_steps
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

FIRST_SECANT = 1e-3
"""First step along a branch to a place on it."""

UP_TO_MEETING = 0.8
"""Fraction of the way to a place where a section of a bundle closes that a step goes."""

OPEN = 1e-6
"""Length (m) of the elements of a section where it begins."""

# Forces on sections without length have a round-off of about 1e-7 N.
MET = 1e-7
"""Step along a branch below which a place on it is found."""


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


@dataclass(frozen=True, eq=False)
class _Curve:
    """Equilibria at the rotations of a path, with unknowns (x, t scale).

    t is measured in radians of the joint that turns most, so that all unknowns have one size.
    """

    family: Family

    @property
    def scale(self) -> float:
        """Rotation (rad) of the joint that turns most."""
        return float(np.abs(self.family.path.end - self.family.path.start).max())

    def member(self, known: Member[Any], t: float) -> Any:
        """Equations with the unknowns of known ones, at t, which may lie beyond the path."""
        path, n = self.family.path, known.robot.n_tubes
        return replace(known, rotations=path.start[:n] + t * (path.end - path.start)[:n])

    def system(self, known: Member[Any], unknowns: Array) -> tuple[Any, Array]:
        """State, and Jacobian (U, U + 1) of its residual; the column of t is a central difference."""
        t, x = float(unknowns[-1]) / self.scale, unknowns[:-1]
        state, rates = self.member(known, t).at(x), path_rates(lambda t: self.member(known, t).at, x, t)
        assert rates is not None
        return state, np.column_stack([state.hessian, rates.gradient / self.scale])

    def unknowns(self, point: AnyPoint) -> Array:
        """Unknowns (U + 1,) of a point."""
        return np.append(point.state.x, point.t * self.scale)

    def tangent(self, point: AnyPoint, towards: Array) -> Array:
        """Unit vector (U + 1,) along the curve, to the side of `towards`."""
        jacobian = self.system(point.member, self.unknowns(point))[1]
        tangent: Array = np.linalg.solve(np.vstack([jacobian, towards]), np.append(np.zeros(len(jacobian)), 1.0))
        return tangent / np.linalg.norm(tangent)

    def corrected(self, known: Member[Any], guess: Array, across: Array) -> tuple[AnyPoint, bool] | None:
        """Point in the plane of a guess across a direction, by Newton's method; and True if that took few iterations.

        None if it converges slowly: a shorter step stays on the same branch, a slow one may have left it.
        """
        direction, x, last = across / np.linalg.norm(across), guess, np.inf
        for iteration in range(7):
            state, jacobian = self.system(known, x)
            change = np.linalg.solve(np.vstack([jacobian, direction]), -np.append(state.gradient, 0.0))
            angle = known.largest_rotation(state, change[:-1])
            if not angle <= min(0.5 * last, 0.3):
                return None
            x, last = x + change, angle
            if angle < 1e-9:
                t = float(x[-1]) / self.scale
                return Point.at(self.member(known, t), x[:-1], t), iteration <= 2
        return None

    def at(self, known: Member[Any], x: Array, t: float) -> AnyPoint | None:
        """Point at t close to unknowns x (U,); None if it is not found."""
        found = self.corrected(known, np.append(x, t * self.scale), np.append(np.zeros(len(x)), 1.0))
        return None if found is None else found[0]

    def root(self, point: AnyPoint, tangent: Array, value: Callable[[AnyPoint], float]) -> AnyPoint | None:
        """Point close to another one at which a value is 0, by the secant method along the curve."""
        start, s, ahead, here = self.unknowns(point), 0.0, FIRST_SECANT, value(point)
        for _ in range(20):
            found = self.corrected(point.member, start + ahead * tangent, tangent)
            if found is None:
                return None
            there = value(found[0])
            if there == here or abs(ahead - s) < MET:
                return found[0]
            s, ahead, here = ahead, ahead - there * (ahead - s) / (there - here), there
        return None


def _continue(family: Family, start: AnyPoint, first_step: float) -> tuple[list[AnyPoint], list[AnyPoint]]:
    """Points on the branch, and those at folds, from t = 0 until t leaves [0, 1]."""
    curve, point, step = _Curve(family), start, first_step
    tangent = curve.tangent(start, np.append(np.zeros(len(start.state.x)), 1.0))
    points, folds = [start], list[AnyPoint]()
    while len(points) < MAX_POINTS:
        length = step / max(point.member.largest_rotation(point.state, tangent[:-1]), abs(float(tangent[-1])))
        length, closing = _up_to_meeting(point, tangent, length)
        met, after = None if closing is None else _closed(curve, point, closing), point
        if met is None:
            found = curve.corrected(point.member, curve.unknowns(point) + length * tangent, tangent)
            if found is None:
                step /= 2
                if step < 1e-8:
                    raise _lost(point)
                continue
            after, easily = found
            step = min(2 * first_step, step * (1.5 if easily else 1.0))
            met = _separated(curve, point, after, tangent)
        if met is None:
            point, last = _rescaled(after), point
            secant = curve.unknowns(point) - np.append(point.member.transfer(last), last.t * curve.scale)
            towards = curve.tangent(point, secant)
            turning = fold(family, point) if towards[-1] * tangent[-1] < 0 else None
            passed = [point] if turning is None else [turning.point, point]
        else:
            (*passed, point), towards = met
            passed.append(point)
        # At a fold, or where ends of tubes meet, the branch turns back: t begins to fall along it, or to rise again.
        if towards[-1] * tangent[-1] < 0 and (met is not None or len(passed) > 1):
            folds.append(passed[0])
        if not 0.0 <= point.t <= 1.0:
            end = curve.at(point.member, point.state.x, 0.0 if point.t < 0 else 1.0)
            return [*points, *passed[:-1], *([] if end is None else [end])], folds
        points += passed
        tangent = towards
    return points, folds


def _lost(point: AnyPoint) -> SolveError:
    """Error where a branch cannot be followed."""
    return SolveError(f"the branch was lost at {100 * point.t:.3f} % of the path")


# --- Where ends of tubes meet -----------------------------------------------------------------------------------------

# A branch of a bundle reaches the place where a section closes with no force on its length. From there the boundaries
# at its ends stay together, with the forces a and b by which a section of the one and of the other order resists being
# opened. Where both are positive the arm rests there, where both are negative it stands on a ridge of the energy. So
# the branch goes on from a = 0 to the side where a has the sign of b, until b = 0, where the other order begins.


def _up_to_meeting(point: AnyPoint, tangent: Array, length: float) -> tuple[float, int | None]:
    """Length of a step on which no section of a bundle closes, and the section that does if it is short already."""
    if not isinstance(point.member, Bundled):
        return length, None
    problem = point.member.problem
    h = problem.lengths(point.state.x)
    rate = problem.lengths_by_bend @ (problem.bend_map @ tangent[problem.split : -1])
    to_go = np.divide(-h, rate, out=np.full(len(h), np.inf), where=rate < 0)
    to_go[[*problem.held]] = np.inf
    section = int(np.argmin(to_go))
    if to_go[section] > length / UP_TO_MEETING:
        return length, None
    return min(length, UP_TO_MEETING * float(to_go[section])), section if h[section] < CLOSING else None


def _closed(curve: _Curve, point: AnyPoint, section: int) -> tuple[list[AnyPoint], Array]:
    """Point at which a section has closed, or passed to the other order, with the tangent from there."""
    state = point.state
    if section == 0 or {section - 1, section + 1} & set(state.problem.held):
        raise SolveError(f"at {100 * point.t:.3f} % of the path three ends of tubes meet; a branch is traced past two")
    problem, x = rearranged(state, state.problem.order, tuple(sorted({*state.problem.held, section})))
    held = curve.at(replace(point.member, problem=problem), x, point.t)
    tangent = None if held is None else curve.tangent(held, np.append(np.zeros(len(x)), 1.0))
    root = None if held is None or tangent is None else curve.root(held, tangent, partial(_holding, section))
    if root is None or tangent is None:
        raise _lost(point)
    beyond = _holding(section, root, exchange=True)
    if abs(beyond) < NO_RIDGE:
        begun, tangent = _opened(curve, root, section, exchange=True)
        return [begun], tangent
    tangent = curve.tangent(root, tangent)
    ahead = curve.corrected(root.member, curve.unknowns(root) + FIRST_SECANT * tangent, tangent)
    if ahead is None:
        raise _lost(point)
    rises = np.sign(_holding(section, ahead[0]) - _holding(section, root)) * np.sign(beyond)
    # The margin is that of the order that ends here: together the boundaries are stiffer.
    margin = _opened(curve, root, section, exchange=False)[0].margin
    return [replace(root, margin=margin)], tangent * rises


def _separated(curve: _Curve, before: AnyPoint, after: AnyPoint, tangent: Array) -> tuple[list[AnyPoint], Array] | None:
    """Points where boundaries that are together separate and behind that, with the tangent; None if none separate."""
    for section in before.member.problem.held if isinstance(before.member, Bundled) else ():
        for exchange in (True, False):
            force = partial(_holding, section, exchange=exchange)
            if abs(force(before)) > NO_RIDGE and force(before) * force(after) <= 0:
                root = curve.root(before, tangent, force)
                if root is None:
                    raise _lost(before)
                begun, along = _opened(curve, root, section, exchange=exchange)
                return [replace(root, margin=-np.inf) if force(before) < 0 else root, begun], along
    return None


def _holding(section: int, point: AnyPoint, *, exchange: bool = False) -> float:
    """Force (N) by which a closed section resists being opened, in the order of its boundaries or in the other one."""
    state = point.member.with_exchange(point.state, section) if exchange else point.state
    if state is None:
        raise _lost(point)
    return float(holding_forces(state)[state.problem.held.index(section)])


def ridges_beside(point: AnyPoint) -> Iterator[AnyPoint]:
    """Points at the joint values of an equilibrium of a bundle where the arm is on a ridge, with two ends together."""
    state, held = point.state, set(point.state.problem.held)
    for section in range(1, len(state.problem.order)):
        if held & {section - 1, section, section + 1}:
            continue
        problem, x = rearranged(state, state.problem.order, tuple(sorted({*held, section})))
        member = replace(point.member, problem=problem)
        try:
            result = full_steps(member.at(x), member.advanced, member.largest_rotation, member.residual, 30)
            ridge = Point.of(member, result, point.t)
        except VanishingError:
            continue
        if result.converged and np.isneginf(ridge.margin):
            yield ridge


def _opened(curve: _Curve, point: AnyPoint, section: int, *, exchange: bool) -> tuple[AnyPoint, Array]:
    """Point at which a closed section has the length OPEN, in the order of its boundaries or in the other one."""
    closed = point.member.with_exchange(point.state, section) if exchange else point.state
    if closed is None:
        raise _lost(point)
    known = closed.problem
    problem, x = rearranged(closed, known.order, tuple(k for k in known.held if k != section))
    member = replace(point.member, problem=problem)
    start = member.at_scale(opened(problem, x, OPEN))
    member = member.owner(start)
    longer = member.problem.lengths_by_bend[section] @ member.problem.bend_map
    across = np.concatenate([np.zeros(member.problem.split), longer, np.zeros(1)])
    found = curve.corrected(member, np.append(start.x, point.t * curve.scale), across)
    if found is None:
        raise _lost(point)
    return found[0], curve.tangent(found[0], across)


def _rescaled(point: AnyPoint) -> AnyPoint:
    """Same point, of a bundle in unknowns that are whitened for the lengths of its sections."""
    if not isinstance(point.member, Bundled):
        return point
    state = point.member.at_scale(point.state.x)
    return Point(point.t, point.member.owner(state), state, point.margin)
