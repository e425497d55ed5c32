"""Where an equilibrium under load is lost, exactly, and where the robot goes from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from ..block.transcription.loaded import LoadedState
from ..equilibrium.load_continuation import Family, LoadedPoint, Member, carry
from ..equilibrium.loaded import bifurcates
from ..solvers.flow import flow
from ..solvers.loaded import loaded_margin, turn_of
from ..solvers.newton import NewtonResult
from ..solvers.settings import CONTINUATION
from ..typing import Array

NEUTRAL = 1e-9
"""A margin within this of 0 may be that of a minimum that is free to turn, as a buckled round column about its axis."""


@dataclass(frozen=True, eq=False)
class Loss:
    """Where a stable branch is lost: t, the equilibrium there, "fold" or "bifurcation", and the softest direction."""

    t: float
    point: LoadedPoint
    kind: str
    direction: Array


def branch_end(family: Family, last: LoadedPoint, goal: float) -> Loss | None:
    """Where the branch is lost of which `last` is the last stable point that was found; None where nothing is found."""
    if bifurcates(last):
        found = bifurcation(family, last, goal) or fold(family, last)
    else:
        found = fold(family, last) or bifurcation(family, last, goal)
    return found


def fold(family: Family, near: LoadedPoint) -> Loss | None:
    """Newton on grad = 0 and sigma = 0, the bordered determinant [H p; p' 0] [v; sigma] = [0; 1] that vanishes where H
    is singular (Griewank, Reddien 1984; Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria, 2000).

    Slopes of sigma are differences along v, which shape the steps, not the result; None where it does not converge.
    """
    t, x = near.t, near.state.x
    border = np.linalg.eigh(near.state.hessian)[1][:, 0]
    size = len(x)
    for iteration in range(CONTINUATION.loaded_fold_steps):
        here = family.member(t)
        if here.problem.size != size:
            return None
        state = here.at(x)
        bordered = np.block([[state.hessian, border[:, None]], [border, np.zeros(1)]])
        solution = np.linalg.solve(bordered, np.append(np.zeros(size), 1.0))
        v, sigma = solution[:-1], float(solution[-1])
        pull = _slope(family, t, x)
        if pull is None:
            return None
        by_x, by_t = _sigma_slopes(family, t, x, v, state)
        matrix = np.block([[state.hessian, pull[:, None]], [by_x, np.array([by_t])]])
        try:
            step = np.linalg.solve(matrix, -np.append(state.gradient, sigma))
        except np.linalg.LinAlgError:
            return None
        turn = turn_of(here.problem, state, step[:-1])
        if not np.isfinite(turn) or turn > np.pi or abs(step[-1]) > 0.1 * max(1.0, abs(t)):
            return None
        x, t = x + step[:-1], t + float(step[-1])
        if turn < 1e-9 and iteration:
            break
    else:
        return None
    if abs(t - near.t) > CONTINUATION.widest * max(1.0, abs(t)):
        return None
    there = family.member(t)
    state = there.at(x)
    point = LoadedPoint(t, there, state, loaded_margin(there.problem, state), iteration + 1)
    return Loss(t, point, "fold", v)


def _slope(family: Family, t: float, x: Array) -> Array | None:
    """Derivative of the gradient by t at fixed unknowns."""
    step = 1e-6 * max(1.0, abs(t))
    values = []
    for place in (t + step, t - step):
        there = family.member(place)
        if there.problem.size != len(x):
            return None
        values.append(there.at(x).gradient)
    return np.asarray((values[0] - values[1]) / (2 * step))


def _sigma_slopes(family: Family, t: float, x: Array, v: Array, state: LoadedState) -> tuple[Array, float]:
    """Derivatives of sigma = -v'Hv by x and by t."""
    here = family.member(t)
    push = CONTINUATION.fold_difference / turn_of(here.problem, state, v)
    sides = [here.at(x + sign * push * v) for sign in (1, -1)]
    by_x = -(sides[0].gradient - 2 * state.gradient + sides[1].gradient) / push**2
    slopes = [_slope(family, t, x + sign * push * v) for sign in (1, -1)]
    if slopes[0] is None or slopes[1] is None:
        return by_x, 0.0
    return by_x, -float(v @ (slopes[0] - slopes[1])) / (2 * push)


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
            root = _root(at, near.t, t)
            found = None if root is None else at(root)
            if root is None or found is None:
                return None
            return Loss(root, found, "bifurcation", np.linalg.eigh(found.state.hessian)[1][:, 0])
        if t == goal:
            return None
        ahead *= 10
    return None


def _root(at: Callable[[float], LoadedPoint | None], low: float, high: float) -> float | None:
    def margin(t: float) -> float:
        point = at(t)
        return float("nan") if point is None else point.margin

    if not margin(low) > 0:
        return low
    try:
        return float(scipy.optimize.brentq(margin, low, high, xtol=1e-14, rtol=1e-14))
    except ValueError:
        return None


def fall(member: Member, x: Array, direction: Array) -> LoadedPoint | None:
    """The minimum to which potential energy falls from x (U + 2 N,) after a push along `direction`, to the side that
    leads down, or to both if both do; None where that leads to no stable equilibrium."""
    state = member.at(x)
    push = CONTINUATION.nudge / turn_of(member.problem, state, direction) * direction
    sides = [side for side in (push, -push) if member.at(x + side).gradient @ side < 0] or [push, -push]
    best: LoadedPoint | None = None
    for side in sides:
        result = slide(member, x + side)
        if not result.converged:
            continue
        there = LoadedPoint.of(member, result)
        if there.margin > -NEUTRAL and (best is None or there.state.potential < best.state.potential - 1e-12):
            best = there
    return best


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

    rest = flow(begin, step, moved)
    if rest is None:
        return NewtonResult(begin, False, CONTINUATION.flow_steps, 0.0)
    last = member.solve(rest[0].x, iterations=4)
    return NewtonResult(last.state, last.converged, rest[1], 0.0)
