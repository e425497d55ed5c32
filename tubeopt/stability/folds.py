"""Where a stable branch of equilibria ends, exactly, and where a robot lands that follows it: downhill in energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy

from ..equilibrium.continuation import Family, bifurcates
from ..equilibrium.member import Member, Place, Point
from ..solvers.newton import NewtonResult, downhill, flow
from ..solvers.settings import LEAST_STIFFNESS
from ..typing import Array, Delegate

NEUTRAL = 1e-9
"""A margin within this of 0 may be that of a minimum that is free to turn, as a buckled round column about its axis."""


# Newton's method with differences converges linearly at worst: from 1e-4 rad to 1e-9 rad takes about five steps.
FOLD_ITERATIONS = 25
"""Maximum number of Newton iterations to a fold."""

# A central difference of the Hessian has the error h^2 of truncation and 1e-15 / h of round-off: at most 1e-8 in all.
FOLD_DIFFERENCE = 1e-4
"""Step of the differences along the softest direction, as a turn (rad) of a tube or of the arm."""

# A step that fails is divided by three down to `SHORTEST_STEP`, so that the end is much closer than this. A fold
# farther away belongs to another branch.
WIDEST = 1e-3
"""Largest distance, in t, between the last stable point that was found and the one where stability is lost."""

# The push is small against the hysteresis, and its energy, of the order of the cube at a fold, still far above
# round-off.
NUDGE = 1e-2
"""Push (rad) along the softest direction that starts a fall."""

# Beyond this distance the two branches of a bifurcation are distinct by its square root, 0.01 rad.
PAST = 1e-4
"""Distance in t, or fraction of a load, to a point beyond a smooth change of branch."""


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
    for iteration in range(1, FOLD_ITERATIONS + 1):
        here = at(t)
        if here is None:
            return None
        state, by = here(x), 1e-6 * max(1.0, abs(t))
        # To one side there may be no equations of the same structure, as at the end of a path: then the difference is
        # one-sided. It only shapes the steps.
        sides = [(place, there(x)) for place in (t - by, t + by) if (there := at(place)) is not None]
        if not sides:
            return None
        (first, one), (second, other) = [*sides, (t, state)][:2]
        try:
            bordered = np.block([[state.hessian, border[:, None]], [border, np.zeros(1)]])
            unit = np.append(np.zeros(size), 1.0)
            left, right = np.linalg.solve(bordered.T, unit)[:-1], np.linalg.solve(bordered, unit)
            v, sigma = right[:-1], right[-1]
            push = FOLD_DIFFERENCE / turn(v)
            along = (here(x + push * v).hessian - here(x - push * v).hessian) / (2 * push)
            pull = (other.gradient - one.gradient) / (second - first)
            stiffer = (other.hessian - one.hessian) @ v / (second - first)
            matrix = np.block([[state.hessian, pull[:, None]], [-left @ along, -left @ stiffer]])
            step = np.linalg.solve(matrix, -np.append(state.gradient, sigma))
        except np.linalg.LinAlgError:
            return None
        turned = turn(step[:-1])
        x, t = x + step[:-1], t + float(step[-1])
        # The fold that is searched is close; such a step leads to another one, or to none.
        if not np.isfinite(turned) or turned > np.pi / 2 or abs(t - begin) > 0.5:
            return None
        if turned < 1e-9:
            return Turning(t, x, v, iteration)
    return None


@dataclass(frozen=True, eq=False)
class Loss:
    """Where a stable branch is lost: the equilibrium there, "fold", "bifurcation" or "flutter", and the softest
    direction."""

    point: Place
    kind: str
    direction: Array

    t = Delegate[float]("point")


def branch_end(family: Family, last: Place, goal: float) -> Loss | None:
    """Where the branch is lost of which `last` is the last stable point that was found; None where nothing is found."""
    far = min(goal, last.t + WIDEST * max(1.0, abs(last.t)))
    if bifurcates(family, last):
        return bifurcation(family, last, goal) or fold_ahead(family, last, far)
    return fold_ahead(family, last, far) or bifurcation(family, last, goal)


def _equations(family: Family, known: Member[Any]) -> Callable[[float], Callable[[Array], Any] | None]:
    """The equations at t with the unknowns of a known problem."""

    def at(t: float) -> Callable[[Array], Any] | None:
        there = family.like(known, t)
        return None if there is None else there.at

    return at


def fold_ahead(family: Family, last: Place, far: float) -> Loss | None:
    """The fold close ahead of a point of a stable branch, up to t = `far`; None where none is found."""
    result = fold(family, last)
    return result if result is not None and last.t - 1e-6 * max(1.0, abs(last.t)) <= result.t <= far else None


def fold(family: Family, point: Place) -> Loss | None:
    """The fold of a branch close to a point of it; None where it is not found."""
    known = point.member

    def turn(step: Array) -> float:
        return float(known.turn(point.state, step))

    result = turning_point(_equations(family, known), turn, point.t, point.state.x, point.softest)
    there = None if result is None else family.like(known, result.t)
    if result is None or there is None:
        return None
    state = there.at(result.x)
    return Loss(Point(result.t, there, state, there.margin(state), result.steps), "fold", result.direction)


def bifurcation(family: Family, point: Place, goal: float) -> Loss | None:
    """The root of the margin on the branch of `point`, which goes on beyond it; None where it does not."""

    def at(t: float) -> Place | None:
        there = family.member(t)
        result = there.solve(there.carried(point))
        return Point.of(there, result, t) if result.converged else None

    # Short distances first: beyond a bifurcation Newton's method finds the old branch only from close by.
    ahead = 1e-7
    while ahead < WIDEST:
        t = min(goal, point.t + ahead * max(1.0, abs(goal)))
        beyond = at(t)
        if beyond is None:
            return None
        if beyond.margin < 0:
            solution = _root(at, point.t, t)
            if solution is None:
                return None
            kind = "flutter" if solution.member.flutters(solution.state) else "bifurcation"
            return Loss(solution, kind, solution.softest)
        if t == goal:
            return None
        ahead *= 10
    return None


def _root(at: Callable[[float], Place | None], low: float, high: float) -> Place | None:
    def margin(t: float) -> float:
        point = at(t)
        return float("nan") if point is None else point.margin

    if not margin(low) > 0:
        return at(low)
    try:
        result = at(float(scipy.optimize.brentq(margin, low, high, xtol=1e-14, rtol=1e-14)))
    except ValueError:
        return None
    # Where the margin jumps, there are two branches, not a root on one.
    return result if result is not None and abs(result.margin) <= LEAST_STIFFNESS else None


def fall(lost: Place, direction: Array) -> Place | None:
    """The minimum to which potential energy falls from a point after a push along `direction` (U,), at its joint values
    and load: to the side that leads down, or to both if both do, of which the one that ends lower is taken. None where
    that leads to no stable equilibrium.

    Energy falls on the path of steepest descent in the norm of the torsional and bending energy. Of tubes off the
    centreline that energy leaves out that they are stretched: it only chooses between sides. Under loads without an
    energy the path is that of tubes of a viscous material, x' = -g; of two sides it is the first.
    """
    member, x = lost.member, lost.state.x
    push = NUDGE / member.turn(lost.state, direction) * direction
    along = lost.unresisted * np.copysign(1.0, lost.unresisted @ direction)

    def uphill(x: Array) -> Array:
        gradient = member.at(x).gradient
        return np.asarray(gradient if member.descends else (gradient @ along) * direction)

    ends = [slide(member, start) for start in downhill(x, push, uphill)]
    points = [Point.of(member, end, lost.t) for end in ends if end.converged]
    rests = [point for point in points if point.margin > -NEUTRAL]
    # Of two that are alike, as beside a bifurcation, the first.
    lowest = min((rest.state.potential for rest in rests), default=0.0)
    return next((rest for rest in rests if not rest.state.potential > lowest + 1e-12), None)


def slide(member: Member[Any], x: Array) -> NewtonResult[Any]:
    """The gradient flow of the potential energy from x (U,) to the minimum where it ends."""
    begin = member.at(x)
    round_off = 1e-13 * member.round_off(begin)

    def step(state: Any, time: float) -> tuple[Array, float, bool]:
        change, not_convex = member.downhill(state, time)
        return change, member.turn(state, change), not_convex

    def moved(state: Any, change: Array) -> Any:
        there = member.at(state.x + change)
        return None if member.descends and there.potential > state.potential + round_off else there

    return flow(begin, step, moved, lambda state: member.solve(state.x, iterations=4))
