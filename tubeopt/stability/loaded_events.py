"""Where an equilibrium under load is lost, exactly, and where the robot goes from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.loaded import LoadedState
from ..equilibrium.load_continuation import Family, LoadedPoint, Member, carry
from ..equilibrium.loaded import bifurcates
from ..solvers.flow import downhill, flow
from ..solvers.newton import NewtonResult, loaded_margin, turn_of
from ..solvers.settings import CONTINUATION
from ..typing import Array, Of
from .folds import turning_point

NEUTRAL = 1e-9
"""A margin within this of 0 may be that of a minimum that is free to turn, as a buckled round column about its axis."""


@dataclass(frozen=True, eq=False)
class Loss:
    """Where a stable branch is lost: the equilibrium there, "fold" or "bifurcation", and the softest direction."""

    point: LoadedPoint
    kind: str
    direction: Array

    t = Of[float]("point")


def branch_end(family: Family, last: LoadedPoint, goal: float) -> Loss | None:
    """Where the branch is lost of which `last` is the last stable point that was found; None where nothing is found."""
    if bifurcates(last):
        return bifurcation(family, last, goal) or fold(family, last)
    return fold(family, last) or bifurcation(family, last, goal)


def fold(family: Family, near: LoadedPoint) -> Loss | None:
    """The fold of a branch close to a point of it; None where it is not found."""

    def at(t: float) -> Callable[[Array], LoadedState] | None:
        there = family.member(t)
        return there.at if there.problem.size == near.member.problem.size else None

    def turn(step: Array) -> float:
        return turn_of(near.member.problem, near.state, step)

    found = turning_point(at, turn, near.t, near.state.x, near.softest)
    if found is None or abs(found.t - near.t) > CONTINUATION.widest * max(1.0, abs(found.t)):
        return None
    there = family.member(found.t)
    state = there.at(found.x)
    point = LoadedPoint(found.t, there, state, loaded_margin(there.problem, state), found.steps)
    return Loss(point, "fold", found.direction)


def bifurcation(family: Family, near: LoadedPoint, goal: float) -> Loss | None:
    """The root of the margin on the branch of `near`, which goes on beyond it; None where it does not."""

    def at(t: float) -> LoadedPoint | None:
        there = family.member(t)
        result = there.solve(carry(near, there))
        return LoadedPoint.of(there, result, t) if result.converged else None

    ahead = 1e-7
    while ahead < CONTINUATION.widest:
        t = min(goal, near.t + ahead * max(1.0, abs(goal)))
        beyond = at(t)
        if beyond is None:
            return None
        if beyond.margin < 0:
            found = _root(at, near.t, t)
            return None if found is None else Loss(found, "bifurcation", found.softest)
        if t == goal:
            return None
        ahead *= 10
    return None


def _root(at: Callable[[float], LoadedPoint | None], low: float, high: float) -> LoadedPoint | None:
    def margin(t: float) -> float:
        point = at(t)
        return float("nan") if point is None else point.margin

    if not margin(low) > 0:
        return at(low)
    try:
        return at(float(scipy.optimize.brentq(margin, low, high, xtol=1e-14, rtol=1e-14)))
    except ValueError:
        return None


def fall(member: Member, x: Array, direction: Array) -> LoadedPoint | None:
    """The minimum to which potential energy falls from x (U + 2 N,) after a push along `direction`, to the side that
    leads down, or to both if both do; None where that leads to no stable equilibrium."""
    push = CONTINUATION.nudge / turn_of(member.problem, member.at(x), direction) * direction
    ends = [slide(member, start) for start in downhill(x, push, lambda x: member.at(x).gradient)]
    points = [LoadedPoint.of(member, end) for end in ends if end.converged]
    rests = [point for point in points if point.margin > -NEUTRAL]
    # Of two that are alike, as beside a bifurcation, the first.
    lowest = min((rest.state.potential for rest in rests), default=0.0)
    return next((rest for rest in rests if rest.state.potential <= lowest + 1e-12), None)


def slide(member: Member, x: Array) -> NewtonResult[LoadedState]:
    """The gradient flow of the potential energy from x to the minimum where it ends."""
    problem, begin = member.problem, member.at(x)
    scale = begin.energy + abs(begin.work)

    def step(state: LoadedState, time: float) -> tuple[Array, float, bool]:
        matrix = state.hessian + np.eye(problem.size) / time
        _, change, failed = scipy.linalg.lapack.dposv(matrix, -state.gradient)
        return change, turn_of(problem, state, change), failed != 0

    def moved(state: LoadedState, change: Array) -> LoadedState | None:
        there = member.at(state.x + change)
        return None if there.potential > state.potential + 1e-13 * scale else there

    return flow(begin, step, moved, lambda state: member.solve(state.x, iterations=4))
