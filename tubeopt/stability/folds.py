"""Ends of a stable branch of equilibria, and the equilibrium that the robot reaches after them.

A stable branch ends in a fold, which `turning_point` solves for as a root of the bordered determinant, or becomes
unstable at a bifurcation, a root of the margin on the branch. From there the robot follows the gradient flow of its
potential energy (`fall`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ..equilibrium.continuation import EquationsAt, Family, bifurcates, path_rates
from ..equilibrium.member import AnyPoint, Member, Point
from ..solvers.newton import NewtonResult, downhill, flow
from ..solvers.settings import LEAST_STIFFNESS
from ..typing import Array, Delegate

NEUTRAL = 1e-9
"""Margin below 0 that a minimum may have by round-off: a buckled round column turns freely about its axis, margin 0."""


# Newton's method with differenced derivatives converges linearly at worst; from 1e-4 rad to 1e-9 rad it takes about
# five steps.
FOLD_ITERATIONS = 25
"""Maximum number of Newton iterations to a fold."""

# A central difference of the Hessian has the error h^2 of truncation and 1e-15 / h of round-off: at most 1e-8 in all.
FOLD_DIFFERENCE = 1e-4
"""Step of the differences along the softest direction, as a rotation (rad) of a tube or of the arm."""

# Continuation divides a failed step by three down to `SHORTEST_STEP`, so that the end of the branch is much closer than
# this. A fold farther away belongs to another branch.
WIDEST = 1e-3
"""Largest distance, in t, between the last stable point and the end of its branch."""

# Small against the hysteresis of a snap; at a fold the energy falls only with the cube of the push, which is still far
# above round-off.
NUDGE = 1e-2
"""Push (rad) along the softest direction that starts a fall."""

MIN_JUMP = 1e-3
"""Rotation (rad) of a point above which the equilibrium after a fall differs from the one that was lost."""

# Beyond this distance the two branches of a bifurcation are distinct by its square root, 0.01 rad.
PAST = 1e-4
"""Distance in t, or fraction of a load, to a point beyond a smooth change of branch."""


@dataclass(frozen=True, eq=False)
class TurningPoint:
    """Turning point of a branch."""

    t: float
    x: Array
    """(U,) unknowns."""
    direction: Array
    """(U,) null vector of the Jacobian."""
    steps: int
    """Number of Newton iterations."""


def turning_point(
    at: EquationsAt,
    size_of: Callable[[Array], float],
    t: float,
    x: Array,
    border: Array,
) -> TurningPoint | None:
    """Solution of g(x, t) = 0 and sigma(x, t) = 0 by Newton's method from a close guess; None if it does not converge.

    sigma is the bordered determinant, [H p; p' 0] [v; sigma] = [0; 1], which vanishes exactly where H is singular, and
    whose matrix is regular there (Griewank, Reddien 1984; Govaerts, Numerical Methods for Bifurcations of Dynamical
    Equilibria, 2000). The derivatives of H and by t are differences: they shape the steps, not the result.

    Args:
        at: the equations in x at t; None if they are of another structure.
        size_of: largest rotation of a step in x, rad.   border: p (U,), the softest direction.
    """
    start, size = t, len(x)
    for iteration in range(1, FOLD_ITERATIONS + 1):
        equations = at(t)
        if equations is None:
            return None
        state = equations(x)
        by_t = path_rates(at, x, t, state)
        if by_t is None:
            return None
        try:
            bordered = np.block([[state.hessian, border[:, None]], [border, np.zeros(1)]])
            unit = np.append(np.zeros(size), 1.0)
            # sigma' = -w' H' v with the solutions v and w of the bordered system and of its transpose.
            w, right = np.linalg.solve(bordered.T, unit)[:-1], np.linalg.solve(bordered, unit)
            v, sigma = right[:-1], right[-1]
            h = FOLD_DIFFERENCE / size_of(v)
            hessian_v = (equations(x + h * v).hessian - equations(x - h * v).hessian) / (2 * h)
            matrix = np.block([[state.hessian, by_t.gradient[:, None]], [-w @ hessian_v, -w @ by_t.hessian @ v]])
            step = np.linalg.solve(matrix, -np.append(state.gradient, sigma))
        except np.linalg.LinAlgError:
            return None
        largest_turn = size_of(step[:-1])
        x, t = x + step[:-1], t + float(step[-1])
        # The fold is close: a step this long leads to another one, or to none.
        if not np.isfinite(largest_turn) or largest_turn > np.pi / 2 or abs(t - start) > 0.5:
            return None
        if largest_turn < 1e-9:
            return TurningPoint(t, x, v, iteration)
    return None


@dataclass(frozen=True, eq=False)
class Loss:
    """Point where a stable branch ends."""

    point: AnyPoint
    """Equilibrium at the loss of stability, with margin 0 but for the kind "ends"."""
    kind: str
    """"fold", "bifurcation", "flutter" or "ends"."""
    direction: Array
    """(U,) softest direction."""
    landed: AnyPoint | None = None
    """Stable point after a loss of kind "ends"."""

    t = Delegate[float]("point")


def branch_end(family: Family, last: AnyPoint, goal: float) -> Loss | None:
    """End of the stable branch just beyond its last stable point; None without a fold or bifurcation close by.

    The sign of the slope at `last` predicts the kind that is tried first (see `bifurcates`).
    """
    far = min(goal, last.t + WIDEST * max(1.0, abs(last.t)))
    if bifurcates(family, last):
        return bifurcation(family, last, goal) or fold_ahead(family, last, far)
    return fold_ahead(family, last, far) or bifurcation(family, last, goal)


def across(family: Family, last: AnyPoint, t: float) -> AnyPoint | None:
    """Stable point at t that the robot reaches from a stable one at which its branch ends; None without one.

    Where ends of tubes of a bundle meet, a branch may end although the energy is convex there: a little farther their
    order changes, or they separate, at a slope of the energy that leads down. The way down is its gradient flow.
    """
    member = family.member(t, last)
    if not member.descends:
        return None
    end = slide(member, member.transfer(last))
    point = None if end is None else Point.of(member, end, t)
    return point if point is not None and point.margin > 0 else None


def fold_ahead(family: Family, last: AnyPoint, far: float) -> Loss | None:
    """Fold close after a point of a stable branch, up to t = `far`; None if none is found."""
    result = fold(family, last)
    return result if result is not None and last.t - 1e-6 * max(1.0, abs(last.t)) <= result.t <= far else None


def fold(family: Family, point: AnyPoint) -> Loss | None:
    """Fold of a branch close to a point of it; None if Newton's method does not converge to one."""
    known = point.member

    def equations(t: float) -> Callable[[Array], Any] | None:
        member = family.like(known, t)
        return None if member is None else member.at

    def size_of(step: Array) -> float:
        return float(known.largest_rotation(point.state, step))

    result = turning_point(equations, size_of, point.t, point.state.x, point.softest)
    member = None if result is None else family.like(known, result.t)
    if result is None or member is None:
        return None
    state = member.at(result.x)
    return Loss(Point(result.t, member, state, member.margin(state), result.steps), "fold", result.direction)


def bifurcation(family: Family, point: AnyPoint, goal: float) -> Loss | None:
    """Root of the margin on the branch of `point`, which continues beyond it; None if it does not continue."""

    def solved(t: float) -> AnyPoint | None:
        member = family.member(t, point)
        result = member.solve(member.transfer(point))
        return Point.of(member, result, t) if result.converged else None

    # Short distances first: beyond a bifurcation Newton's method finds the old branch only from close by.
    distance = 1e-7
    while distance < WIDEST:
        t = min(goal, point.t + distance * max(1.0, abs(goal)))
        beyond = solved(t)
        if beyond is None:
            return None
        if beyond.margin < 0:
            root = _margin_root(solved, point.t, t)
            if root is None:
                return None
            kind = "flutter" if root.member.flutters(root.state) else "bifurcation"
            return Loss(root, kind, root.softest)
        if t == goal:
            return None
        distance *= 10
    return None


def _margin_root(solved: Callable[[float], AnyPoint | None], low: float, high: float) -> AnyPoint | None:
    """Point between t = `low` and `high` with margin 0."""

    def margin(t: float) -> float:
        point = solved(t)
        return float("nan") if point is None else point.margin

    try:
        t = float(scipy.optimize.brentq(margin, low, high, xtol=1e-14, rtol=1e-14)) if margin(low) > 0 else low
    except ValueError:
        return None
    root = solved(t)
    # Where the margin jumps, there is no root: its ends lie on two branches, or ends of tubes separate.
    return root if root is not None and abs(root.margin) <= LEAST_STIFFNESS else None


def fall(lost: AnyPoint, direction: Array) -> AnyPoint | None:
    """Equilibrium that the robot reaches after losing stability and a push along `direction` (U,); None without one.

    Joint values and load stay. Of the two signs of the direction the one that leads down is taken; if both do, the one
    that ends lower. The path is that of steepest descent in the norm of the torsional and bending energy. For tubes off
    the centreline this norm leaves out that they are stretched, which affects only the choice between the two sides.
    Under loads without an energy the path is that of viscous tubes, x' = -g, to the first of two sides.
    """
    member, x = lost.member, lost.state.x
    push = NUDGE / member.largest_rotation(lost.state, direction) * direction
    along = lost.unresisted * np.copysign(1.0, lost.unresisted @ direction)

    def uphill(x: Array) -> Array:
        gradient = member.at(x).gradient
        return np.asarray(gradient if member.descends else (gradient @ along) * direction)

    ends = [slide(member, start) for start in downhill(x, push, uphill)]
    points = [Point.of(member, end, lost.t) for end in ends if end is not None]
    minima = [point for point in points if point.margin > -NEUTRAL]
    # Next to a symmetric bifurcation both sides have the same energy to round-off: the first is taken.
    lowest = min((point.state.potential for point in minima), default=0.0)
    return next((point for point in minima if not point.state.potential > lowest + 1e-12), None)


def slide(member: Member[Any], x: Array) -> NewtonResult[Any] | None:
    """Minimum of the potential energy at the end of its gradient flow from x (U,); None if it is not found."""
    start = member.at(x)
    round_off = 1e-13 * member.round_off(start)

    def step(state: Any, time: float) -> Array | None:
        change, not_convex = member.downhill(state, time)
        return None if not_convex else change

    def moved(state: Any, change: Array) -> Any:
        result = member.moved(state, change)
        # A section of a bundle that closes changes the unknowns, and the energy by more than round-off.
        same = len(result.x) == len(state.x) or not np.isfinite(result.potential)
        return None if same and member.descends and result.potential > state.potential + round_off else result

    def rest(state: Any, turn: float, time: float, count: int) -> NewtonResult[Any] | None:
        # A long time step that hardly moves is Newton's step close to rest, or passes a fold.
        last = member.owner(state).at_rest(state) if turn < 1e-6 and time > 1e6 else None
        return last and (replace(last, iterations=count, contraction=0.0) if last.converged else None)

    steps = step, member.largest_rotation, moved, rest
    result, freed = flow(start, *steps), list[object]()
    while result is not None and (start := member.owner(result.state).released(result.state, freed)) is not None:
        result = flow(start, *steps)
    return result
