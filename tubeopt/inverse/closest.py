"""Closest pose to a target out of reach: a constrained minimum of the residual, by sequential quadratic programming.

The descent of `gauss_newton` among allowed postures. The Hessian of the Lagrangian starts from that of Gauss-Newton and
is updated by Powell's damped BFGS (Nocedal and Wright, 2006, procedure 18.2): far from the target the curvature of the
tip counts, which Gauss-Newton leaves out. A step that violates constraints is restored by smallest joint motions.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..typing import Array, Index
from .breakpoint_order import breakpoint_order, separate_breakpoints
from .gauss_newton import FIRST_STEP, SLACK, AcceptedStep, DescentSearch, GoalProblem, Restored, StepModel, descend
from .goal import Goal
from .posture import Posture

# Quasi-Newton updates need about as many steps as there are joints before they converge superlinearly; each step may
# take some equilibria to come back to what is allowed.
MAX_STEPS, MAX_SOLVES = 60, 150
"""Maximum numbers of steps and of equilibria of one descent."""

# 2 nm on an arm of 200 mm, which is the accuracy of forward kinematics.
MIN_APPROACH = 1e-8
"""Approach to the target, relative to the robot's length, that a step must promise."""

# The first is ten times MIN_APPROACH, since two descents to one minimum end up to that far apart. The second compares
# searches that were not polished: 4 um on an arm of 200 mm.
GAIN, SAME_MISS = 1e-7, 2e-5
"""Approach at which a later end replaces an earlier one, and largest difference of equal distances from the target.

Both are relative to the robot's length.
"""

# Newton steps on the constraints: each about doubles the digits where they converge.
RESTORATIONS = 12
"""Maximum number of steps back into the allowed set."""

# Cholesky's factorisation needs a positive definite matrix also where some motion of the joints does not move the tip.
CURVATURE = 1e-6
"""Smallest curvature of the model, per square of a joint's scale."""

# Where breakpoints meet, the gradient jumps: a short step across such a kink has a slope like 1e11, with which
# Cholesky's factorisation fails.
STEEPEST = 1e6
"""Largest curvature that an update takes over, per square of a joint's scale."""

SAME_END = 1e-3
"""Ends closer than this in every joint, in units of their scales, are one."""

# A minimum to which four further ends lead is most likely the global one. That is evidence, not a proof, and the
# message says no more than that the search ended.
AGREEING = 4
"""Number of further ends at the same distance that stop the search for a closer one."""


def approach(goal: Goal, start: Posture) -> DescentSearch | None:
    """Local minimum of the residual from a start; None if no allowed posture is found near the start."""
    goal.touched.clear()  # the result must not depend on earlier searches
    first = restored(goal, start, max_steps=RESTORATIONS)
    if first is None:
        return None
    start = restored(goal, separate_breakpoints(goal, first), max_steps=RESTORATIONS) or first
    end = descend(_MissProblem(goal), start, size=FIRST_STEP, max_steps=MAX_STEPS, max_solves=MAX_SOLVES)
    return DescentSearch(end.iterate, goal.reached(end.iterate, 1e-8, 1e-8), end.steps, end.solves)


def closest_of(goal: Goal, groups: Sequence[Sequence[Posture]], starts: Iterable[Posture] = ()) -> DescentSearch | None:
    """Allowed posture with the smallest residual.

    Each group of ends is polished in order, until several agree; then descents are made from all `starts`. More ends at
    the end of a group never make it worse. A later end replaces an earlier one only if it is closer by more than
    round-off.
    """
    best: DescentSearch | None = None
    for ends, enough in [*((ends, AGREEING) for ends in groups), (starts, np.inf)]:
        smallest, agreeing = np.inf, 0
        for end in _distinct(goal, ends):
            if agreeing >= enough or (best is not None and goal.clock.over):
                break
            nearest = approach(goal, end)
            if nearest is None:
                continue
            miss = _miss(goal, nearest.posture)
            agreeing = 0 if miss < smallest - SAME_MISS else agreeing + (miss < smallest + SAME_MISS)
            smallest = min(smallest, miss)
            if best is None or miss < _miss(goal, best.posture) - GAIN:
                best = nearest
    return best


def _distinct(goal: Goal, ends: Iterable[Posture]) -> Iterator[Posture]:
    """Postures without those equal to an earlier one in the list."""
    distinct: list[Posture] = []
    for end in ends:
        if all(np.abs((end.q - each.q) / goal.space.scale).max() > SAME_END for each in distinct):
            distinct.append(end)
            yield end


def _miss(goal: Goal, at: Posture) -> float:
    """Norm of the residual, relative to the robot's length."""
    return float(np.linalg.norm(goal.residual(at)))


def restored(goal: Goal, at: Posture, *, max_steps: int) -> Posture | None:
    """Nearest allowed posture, by smallest joint motions to the linearised constraints; None if this fails."""
    none = np.zeros((0, len(at.q))), np.zeros(0)
    for _ in range(max_steps):
        if goal.allowed(at, SLACK):
            return at
        model = StepModel(np.diag(1 / goal.space.scale), np.zeros(len(at.q)), *none, *goal.constraints(at)[:2])
        chosen = model.step(goal.space.scale, FIRST_STEP)
        nearer = None if chosen is None else at.to(goal.space.clip(at.q + chosen.x))
        if nearer is None:
            return None
        at = nearer
    return at if goal.allowed(at, SLACK) else None


@dataclass(frozen=True, eq=False)
class _Lagrangian(StepModel):
    """Model with the Hessian of the Lagrangian, in units of the joints' scales."""

    at: Posture
    hessian: Array
    slope: Array
    """Gradient (m,) of half the squared residual."""
    names: Index
    """Identifiers (c,) of the constraints; rows after them are the order of breakpoints."""


class _MissProblem(GoalProblem):
    """Half the squared residual, among allowed postures."""

    def value(self, at: Posture) -> float:
        return 0.5 * _miss(self.goal, at) ** 2

    def min_decrease(self, value: float) -> float:
        return float(MIN_APPROACH * max(np.sqrt(2 * value), MIN_APPROACH))

    def converged(self, at: Posture, values: Sequence[float]) -> bool:
        return False

    def model(self, at: Posture, side: int, last: AcceptedStep[Posture] | None) -> _Lagrangian:
        """Quadratic model of the residual and linearised constraints at a posture."""
        goal, scale, m = self.goal, self.goal.space.scale, len(at.q)
        residual, jacobian = goal.residual(at), goal.slope(at, side=side) * scale
        rows, bounds, names = goal.constraints(at)
        rows, bounds = breakpoint_order(goal.space, at).constrain(at.q, rows, np.minimum(bounds, 0.0))
        regularisation = (CURVATURE + 1e-3 * float(residual @ residual)) * np.eye(m)
        hessian, slope = jacobian.T @ jacobian + regularisation, jacobian.T @ residual
        if last is not None and isinstance(last.model, _Lagrangian):
            hessian = self._updated(last, last.model, at, slope, rows, names)
        root = np.linalg.cholesky(hessian).T
        right = -np.linalg.solve(root.T, slope)
        none = np.zeros((0, m)), np.zeros(0)
        return _Lagrangian(root / scale, right, *none, rows, bounds, at, hessian, slope, names)

    def _updated(
        self, last: AcceptedStep[Posture], before: _Lagrangian, at: Posture, slope: Array, rows: Array, names: Index
    ) -> Array:
        """Powell's damped BFGS update of the Hessian B by a step s and the change y of the Lagrangian's gradient."""
        scale, B = self.goal.space.scale, before.hessian
        # Multipliers of the active rows: the gradient of the quadratic program at its solution is their combination.
        multiplier = np.zeros(len(before.rows))
        active = last.active[last.active < len(multiplier)]
        if len(active):
            gradient = B @ (last.x / scale) + before.slope
            multiplier[active] = scipy.optimize.nnls((before.rows[active] * scale).T, gradient)[0]
        s = (at.q - before.at.q) / scale
        # Only constraints known at both postures contribute: their normals change by the second difference.
        _, old, new = np.intersect1d(before.names, names, return_indices=True)
        y = slope - before.slope - multiplier[old] @ ((rows[new] - before.rows[old]) * scale)
        Bs = B @ s
        sBs, sy = float(s @ Bs), float(s @ y)
        if sBs <= 1e-16:
            return B
        if sy < 0.2 * sBs:
            # Damping keeps B positive definite: y is mixed with B s until s y = 0.2 s B s.
            theta = 0.8 * sBs / (sBs - sy)
            y = theta * y + (1 - theta) * Bs
            sy = float(s @ y)
        if float(y @ y) > STEEPEST * sy:
            return B
        B = B - np.outer(Bs, Bs) / sBs + np.outer(y, y) / sy
        return np.asarray(B + CURVATURE * np.eye(len(B)))

    def after(self, current: Posture, x: Array) -> Restored[Posture]:
        at = current.to(self.goal.space.clip(current.q + x))
        return Restored(None if at is None else restored(self.goal, at, max_steps=4), 1)

    def after_crossing(self, crossed: Posture) -> Posture | None:
        return restored(self.goal, crossed, max_steps=4)
