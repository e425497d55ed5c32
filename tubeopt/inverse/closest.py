"""The closest pose to a target out of reach: a constrained minimum of what is left to it.

The descent of `gauss_newton` among allowed postures. Its model of the Lagrangian starts from Gauss and Newton's and is
updated by Powell's damped BFGS, since far from the target the curvature of the tip counts, which Gauss and Newton leave
out. A step that leaves what is allowed is brought back by least motions of the joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array, Index
from .gauss_newton import FIRST_STEP, SLACK, Back, Descent, Model, Search, Step, apart, breakpoint_order
from .goal import Goal
from .posture import Posture

# Quasi-Newton updates need about as many steps as there are joints before they converge superlinearly; each step may
# take some equilibria to come back to what is allowed.
STEPS, POSTURES = 60, 150
"""Maximum numbers of steps and of equilibria of one descent."""

# 2 nm on an arm of 200 mm, which is the accuracy of forward kinematics.
PROMISE = 1e-8
"""Approach of a step to the target, as a share of the robot's length, that it must promise."""

# The first is ten times PROMISE, since two descents to one minimum end up to that far apart. The second compares
# searches that were not polished: 4 um on an arm of 200 mm.
GAIN, SAME_MISS = 1e-7, 2e-5
"""Approach by which a later end replaces an earlier one, and largest difference of distances from the target that count
as equal; both as shares of the robot's length."""

# Newton steps on the constraints: each about doubles the digits where they converge.
RETURNS = 12
"""Maximum number of steps back into the allowed set."""

# Cholesky's factorisation needs a positive definite matrix also where some motion of the joints does not move the tip.
CURVATURE = 1e-6
"""Smallest curvature of the model, per square of a joint's scale."""

SAME_END = 1e-3
"""Ends closer than this in every joint, in units of their scales, are one."""

# A minimum to which four further ends lead is most likely the global one. That is evidence, not a proof, and the
# message says no more than that the search ended.
AGREEING = 4
"""Number of further ends at the same distance after which no closer one is searched for."""


def approach(goal: Goal, start: Posture) -> Search | None:
    """The local minimum of what is left to the target that is found from a posture; None where no allowed posture is
    found near the start."""
    goal.touched.clear()  # so that what is found does not depend on what was looked for before
    first = restored(goal, start, most=RETURNS)
    if first is None:
        return None
    descent = Descent(_Miss(goal), FIRST_STEP, STEPS, POSTURES)
    here = descent.last(restored(goal, apart(goal, first), most=RETURNS) or first)
    return Search(here, goal.reached(here, 1e-8, 1e-8), descent.steps, descent.solves)


def closest_of(goal: Goal, groups: Sequence[Sequence[Posture]]) -> Search | None:
    """The allowed posture that misses the target least: of each group of ends, polished in their order until several
    agree. More ends at the end of a group never make it worse.

    One that is closer by no more than round-off does not take the place of an earlier one.
    """
    best: Search | None = None
    for ends in groups:
        least, agreeing = np.inf, 0
        for end in _distinct(goal, ends):
            if agreeing >= AGREEING or (best is not None and goal.clock.over):
                break
            found = approach(goal, end)
            if found is None:
                continue
            miss = left(goal, found.posture)
            agreeing = 0 if miss < least - SAME_MISS else agreeing + (miss < least + SAME_MISS)
            least = min(least, miss)
            if best is None or miss < left(goal, best.posture) - GAIN:
                best = found
    return best


def _distinct(goal: Goal, ends: Sequence[Posture]) -> Iterator[Posture]:
    """Postures without those that are one with an earlier one."""
    seen: list[Posture] = []
    for end in ends:
        if all(np.abs((end.q - other.q) / goal.space.scale).max() > SAME_END for other in seen):
            seen.append(end)
            yield end


def left(goal: Goal, at: Posture) -> float:
    """What is left to the target, as a share of the robot's length."""
    return float(np.linalg.norm(goal.residual(at)))


def restored(goal: Goal, at: Posture, *, most: int) -> Posture | None:
    """The nearest allowed posture, by least motions of the joints that keep the linearised constraints; None where that
    leads nowhere."""
    none = np.zeros((0, len(at.q))), np.zeros(0)
    for _ in range(most):
        if goal.allowed(at, SLACK):
            return at
        model = Model(np.diag(1 / goal.space.scale), np.zeros(len(at.q)), *none, *goal.demands(at)[:2])
        chosen = model.step(goal, FIRST_STEP)
        there = None if chosen is None else at.to(goal.space.clip(at.q + chosen.x))
        if there is None:
            return None
        at = there
    return at if goal.allowed(at, SLACK) else None


@dataclass(frozen=True, eq=False)
class _Lagrangian(Model):
    """A model whose Hessian is that of the Lagrangian, in units of the joints' scales."""

    at: Posture
    hessian: Array
    slope: Array
    """(m,) of half the square of what is left."""
    names: Index
    """(c,) of the demands, the first rows; those after them keep the order of breakpoints."""


@dataclass(frozen=True, eq=False)
class _Miss:
    """Half the square of what is left to the target, among allowed postures."""

    goal: Goal

    def value(self, at: Posture) -> float:
        return 0.5 * left(self.goal, at) ** 2

    def least(self, value: float) -> float:
        return float(PROMISE * max(np.sqrt(2 * value), PROMISE))

    def ended(self, at: Posture, values: Sequence[float]) -> bool:
        return False

    def model(self, at: Posture, side: int, last: Step | None) -> _Lagrangian:
        """The quadratic model of distance and constraints at a posture."""
        goal, scale, m = self.goal, self.goal.space.scale, len(at.q)
        residual, jacobian = goal.residual(at), goal.slope(at, side=side) * scale
        rows, bounds, names = goal.demands(at)
        rows, bounds = breakpoint_order(goal, at).kept(at.q, rows, np.minimum(bounds, 0.0))
        least = (CURVATURE + 1e-3 * float(residual @ residual)) * np.eye(m)
        hessian, slope = jacobian.T @ jacobian + least, jacobian.T @ residual
        if last is not None and isinstance(last.model, _Lagrangian):
            hessian = self._updated(last, last.model, at, slope, (rows, names))
        root = np.linalg.cholesky(hessian).T
        right = -np.linalg.solve(root.T, slope)
        none = np.zeros((0, m)), np.zeros(0)
        return _Lagrangian(root / scale, right, *none, rows, bounds, at, hessian, slope, names)

    def _updated(
        self, last: Step, before: _Lagrangian, at: Posture, slope: Array, demands: tuple[Array, Index]
    ) -> Array:
        """Powell's damped BFGS update with the change of the Lagrangian's gradient."""
        (rows, names), scale, hessian = demands, self.goal.space.scale, before.hessian
        force = _forces(before, hessian @ (last.x / scale) + before.slope, last.active, scale)
        step = (at.q - before.at.q) / scale
        _, mine, other = np.intersect1d(before.names, names, return_indices=True)
        change = slope - before.slope - force[mine] @ ((rows[other] - before.rows[mine]) * scale)
        bent = hessian @ step
        curved, own = float(step @ bent), float(step @ change)
        if curved <= 1e-16:
            return hessian
        if own < 0.2 * curved:
            share = 0.8 * curved / (curved - own)
            change = share * change + (1 - share) * bent
            own = float(step @ change)
        hessian = hessian - np.outer(bent, bent) / curved + np.outer(change, change) / own
        return np.asarray(hessian + CURVATURE * np.eye(len(hessian)))

    def back(self, here: Posture, x: Array) -> Back:
        there = here.to(self.goal.space.clip(here.q + x))
        return Back(None if there is None else restored(self.goal, there, most=4), 1)

    def beyond(self, past: Posture) -> Posture | None:
        return restored(self.goal, past, most=4)


def _forces(before: _Lagrangian, gradient: Array, active: Index, scale: Array) -> Array:
    """(c,) of every row, 0 where it does not hold: `gradient` of the program in the step as their combination."""
    force = np.zeros(len(before.rows))
    held = active[active < len(force)]
    if len(held):
        force[held] = scipy.optimize.nnls((before.rows[held] * scale).T, gradient)[0]
    return force
