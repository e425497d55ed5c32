"""The closest pose to a target out of reach: a constrained minimum of what is left to it.

Sequential quadratic programming in joint space. Every iterate is a solved, stable equilibrium that keeps joints, order,
margin and clearance; the model of the Lagrangian starts from Gauss and Newton's and is updated by Powell's damped BFGS,
since far from the target the curvature of the tip counts, which Gauss and Newton leave out. A step that leaves what is
allowed is brought back by least motions of the joints. Between changes of the order of breakpoints everything is
smooth: steps keep the order, and where it holds the minimum up, what lies beyond is tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array, Index, Mask
from .descent import SLACK, Search, boxed
from .goal import Goal
from .least_squares import constrained_least_squares
from .order import apart, breakpoint_order, crossings
from .posture import Posture


def approach(goal: Goal, start: Posture) -> Search | None:
    """The local minimum of what is left to the target that is found from a posture; None where no allowed posture is
    found near the start."""
    goal.touched.clear()  # so that what is found does not depend on what was looked for before
    solver, descent = goal.solver.closest, _Descent(goal)
    first = restored(goal, start, most=solver.returns)
    if first is None:
        return None
    here = descent.minimum(restored(goal, apart(goal, first), most=solver.returns) or first)
    for _ in range(solver.orders):
        there = descent.across(here) if descent.solves < solver.postures and not goal.clock.over else None
        if there is None:
            break
        here = descent.minimum(there)
    reached = goal.reached(here, 1e-8, 1e-8)
    return Search(here, reached, descent.steps, descent.solves)


def closest_of(goal: Goal, groups: Sequence[Sequence[Posture]]) -> Search | None:
    """The allowed posture that misses the target least: of each group of ends, polished in their order until several
    agree. More ends at the end of a group never make it worse.

    One that is closer by no more than round-off does not take the place of an earlier one.
    """
    best: Search | None = None
    same = goal.solver.starts.same_miss
    for ends in groups:
        least, agreeing = np.inf, 0
        for end in _distinct(goal, ends):
            if agreeing >= goal.solver.closest.agreeing or (best is not None and goal.clock.over):
                break
            found = approach(goal, end)
            if found is None:
                continue
            miss = left(goal, found.posture)
            agreeing = 0 if miss < least - same else agreeing + (miss < least + same)
            least = min(least, miss)
            if best is None or miss < left(goal, best.posture) - goal.solver.closest.gain:
                best = found
    return best


def _distinct(goal: Goal, ends: Sequence[Posture]) -> Iterator[Posture]:
    """Postures without those that are one with an earlier one."""
    seen: list[Posture] = []
    for end in ends:
        if all(np.abs((end.q - other.q) / goal.space.scale).max() > goal.solver.closest.same_end for other in seen):
            seen.append(end)
            yield end


def left(goal: Goal, at: Posture) -> float:
    """What is left to the target, as a share of the robot's length: what is made small."""
    return float(np.linalg.norm(goal.residual(at)))


def restored(goal: Goal, at: Posture, *, most: int) -> Posture | None:
    """The nearest allowed posture, by least motions of the joints that keep the linearised constraints; None where that
    leads nowhere."""
    for _ in range(most):
        if goal.allowed(at, SLACK):
            return at
        chosen = constrained_least_squares(
            np.diag(1 / goal.space.scale),
            np.zeros(len(at.q)),
            *boxed(goal, *goal.demands(at)[:2], goal.solver.descent.first_step),
        )
        there = None if chosen is None else at.to(goal.space.clip(at.q + chosen.x))
        if there is None:
            return None
        at = there
    return at if goal.allowed(at, SLACK) else None


@dataclass(frozen=True, eq=False)
class _Model:
    """An allowed posture with derivatives in units of the joints' scales: `slope` (m,) of half the square of what is
    left; rows, bounds (c, m), (c,) of what is to be kept, in joint values: demands, with their `names`, then the order
    of breakpoints."""

    at: Posture
    value: float
    slope: Array
    square: Array
    rows: Array
    bounds: Array
    names: Index


class _Descent:
    """Postures with ever less left to the target; counts steps, and the equilibria solved."""

    def __init__(self, goal: Goal) -> None:
        self.goal, self.steps, self.solves = goal, 0, 0

    def minimum(self, start: Posture) -> Posture:
        """Where steps that keep the order of breakpoints end."""
        here, size, side = self._model(start), self.goal.solver.descent.first_step, 1
        hessian = here.square
        for _ in range(self.goal.solver.closest.steps):
            if self.solves >= self.goal.solver.closest.postures or self.goal.clock.over:
                break
            there, size, force = self._step(here, hessian, size)
            if there is None and side > 0 and len(here.at.q) > self.goal.space.robot.n_tubes:
                # Breakpoints may coincide: what holds forwards may not hold backwards.
                side, size = -1, 0.5 * self.goal.solver.descent.first_step
                here = self._model(here.at, side)
                hessian = here.square
                continue
            if there is None:
                break
            self.steps += 1
            after = self._model(there)
            hessian = after.square if side < 0 else _updated(hessian, here, after, force, self.goal)
            here, side = after, 1
        return here.at

    def _model(self, at: Posture, side: int = 1) -> _Model:
        goal = self.goal
        residual, slope = goal.residual(at), goal.slope(at, side=side) * goal.space.scale
        rows, bounds, names = goal.demands(at)
        rows, bounds = breakpoint_order(goal, at).kept(at.q, rows, np.minimum(bounds, 0.0))
        square = slope.T @ slope
        square += (goal.solver.closest.curvature + 1e-3 * float(residual @ residual)) * np.eye(len(square))
        return _Model(at, 0.5 * float(residual @ residual), slope.T @ residual, square, rows, bounds, names)

    def _step(self, here: _Model, hessian: Array, size: float) -> tuple[Posture | None, float, Array]:
        """The posture after a step that brings the tip closer, None without one; the size that the next may have; and
        the forces (c,) of the constraints in the step's quadratic program."""
        goal, scale = self.goal, self.goal.space.scale
        root = np.linalg.cholesky(hessian).T
        right = -np.linalg.solve(root.T, here.slope)
        promise = goal.solver.closest.promise
        least = promise * max(np.sqrt(2 * here.value), promise)
        while size > goal.solver.descent.shortest_step:
            chosen = constrained_least_squares(root / scale, right, *boxed(goal, here.rows, here.bounds, size))
            if chosen is None:
                break
            step = chosen.x / scale
            promised = -float(here.slope @ step + 0.5 * step @ hessian @ step)
            if promised <= least:
                break
            trial = here.at.to(goal.space.clip(here.at.q + chosen.x))
            there = None if trial is None else restored(goal, trial, most=4)
            self.solves += 1
            gained = -np.inf if there is None else here.value - 0.5 * left(goal, there) ** 2
            if there is not None and gained >= 0.05 * promised:
                longest = float(np.abs(step).max())
                grown = 2 * size if gained >= 0.7 * promised and longest > 0.9 * size else size
                force = _forces(here, hessian @ step + here.slope, chosen.active, scale)
                return there, min(grown, 2 * goal.solver.descent.first_step), force
            size = 0.35 * min(size, float(np.abs(step).max()))
        return None, size, np.zeros(0)

    def across(self, here: Posture) -> Posture | None:
        """The posture beyond a change of order that holds the minimum up; None where none is closer beyond."""
        goal, now = self.goal, left(self.goal, here)
        for past in crossings(goal, here, goal.solver.order.short_section * goal.space.length):
            other = restored(goal, past, most=4)
            if other is None:
                continue
            model = self._model(other)
            there, _, _ = self._step(model, model.square, 0.1 * goal.solver.descent.first_step)
            if there is not None and left(goal, there) < now - goal.solver.closest.gain:
                return there
        return None


def _forces(here: _Model, gradient: Array, active: Mask, scale: Array) -> Array:
    """(c,) of every row, 0 where it does not hold: `gradient` of the program in the step as their combination."""
    force = np.zeros(len(here.rows))
    held = np.flatnonzero(active[: len(force)])
    if len(held):
        force[held] = scipy.optimize.nnls((here.rows[held] * scale).T, gradient)[0]
    return force


def _updated(hessian: Array, before: _Model, after: _Model, force: Array, goal: Goal) -> Array:
    """Powell's damped BFGS update with the change of the Lagrangian's gradient."""
    scale = goal.space.scale
    step = (after.at.q - before.at.q) / scale
    _, mine, other = np.intersect1d(before.names, after.names, return_indices=True)
    change = after.slope - before.slope - force[mine] @ ((after.rows[other] - before.rows[mine]) * scale)
    bent = hessian @ step
    curved, own = float(step @ bent), float(step @ change)
    if curved <= 1e-16:
        return hessian
    if own < 0.2 * curved:
        share = 0.8 * curved / (curved - own)
        change = share * change + (1 - share) * bent
        own = float(step @ change)
    hessian = hessian - np.outer(bent, bent) / curved + np.outer(change, change) / own
    return np.asarray(hessian + goal.solver.closest.curvature * np.eye(len(hessian)))
