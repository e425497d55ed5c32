"""Constrained Gauss-Newton method of inverse kinematics, with a trust region.

    minimise  |A x - b|^2 + |A' x - b'|^2   over motions x (m,) of the joints
    subject to  rows x >= bounds,  |x_k| <= size scale_k

Every iterate is a solved, stable equilibrium. A `DescentProblem` defines the objective; near a posture its model is |A
x - b|^2 / 2. A' and b' only guide the step, as Levenberg-Marquardt damping does. A problem also defines how a posture
after a step is restored to its constraints. A step is accepted if the objective decreases by a fraction of the decrease
that the model predicts; else the trust region shrinks (Nocedal and Wright, Numerical Optimization, 2006, algorithm
4.1).

Derivatives differ to either side where breakpoints along the arm coincide. So a descent ends only if neither side
promises a decrease, and neither does a posture beyond the next change of their order.

`reach` brings the tip to the target and out of obstacles. `improve` then lowers the cost in the null space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np

from ..solvers.compiled.quadratic import LeastSquares, constrained_least_squares
from ..typing import Array, Index
from .breakpoint_order import SHORT_SECTION, OrderConstraints, breakpoint_order, crossings
from .goal import Goal
from .posture import Posture

SLACK = 1e-9
"""Clearance (m) that may be missing by round-off."""

# Measured on 80 targets of two robots, of which 79 are reached: half takes 0.94 times as many equilibria, twice 0.99
# times.
FIRST_STEP = 0.6
"""Trust region of the first step, and half of the largest one later, in units of the joints' scales."""

SHORTEST_STEP = 1e-5
"""Trust region, in units of the joints' scales, below which a descent ends: far above the round-off, 1e-8."""

# Those of trust-region methods: Nocedal and Wright, Numerical Optimization (2006), algorithm 4.1, have 0 to 1/4, 3/4
# and 1/4.
ACCEPTED, FAITHFUL, SHRINK = 0.05, 0.7, 0.35
"""Smallest accepted ratio of actual to predicted decrease, ratio that doubles the trust region, and shrink factor.

The factor applies to the trust region after a rejected step.
"""


@dataclass(frozen=True, eq=False)
class StepModel:
    """Quadratic program of a step near a posture, in motions x (m,) of the joints."""

    matrix: Array
    """Matrix A (r, m) of the linear residuals A x - b."""
    right: Array
    """Right-hand side b (r,) of the linear residuals A x - b."""
    guide_matrix: Array
    """Matrix A' (g, m) of the guiding residuals: damping, or a target that all steps satisfy."""
    guide_right: Array
    """Right-hand side b' (g,) of the guiding residuals."""
    rows: Array
    """Constraints (c, m), rows x >= bounds."""
    bounds: Array
    """Lower bounds (c,) of the linear constraints."""

    def step(self, goal: Goal, size: float) -> LeastSquares | None:
        """Solution in the trust region |x_k| <= size scale_k; None if the constraints exclude it."""
        unit = np.diag(1 / goal.space.scale)
        return constrained_least_squares(
            np.vstack([self.matrix, self.guide_matrix]),
            np.concatenate([self.right, self.guide_right]),
            np.vstack([self.rows, unit, -unit]),
            np.concatenate([self.bounds, np.full(2 * len(unit), -size)]),
        )

    def decrease(self, x: Array) -> float:
        """Predicted decrease of the objective by a motion."""
        residual = self.matrix @ x - self.right
        return 0.5 * float(self.right @ self.right - residual @ residual)


@dataclass(frozen=True, eq=False)
class AcceptedStep:
    """Accepted step of the Gauss-Newton iteration."""

    model: StepModel
    x: Array
    """Motion (m,) of the joints."""
    active: Index
    """Numbers of the active rows, and after them of the active sides of the trust region."""
    posture: Posture
    """Posture after the step."""
    value: float
    """Objective after the step."""
    size: float
    """Trust region of the next step."""


@dataclass(frozen=True, eq=False)
class Restored:
    """Posture after it was restored to its constraints."""

    posture: Posture | None
    """Posture that satisfies the constraints; None if none was found."""
    solves: int
    """Number of equilibria solved."""


class DescentProblem(Protocol):
    """Objective and constraints of a descent."""

    @property
    def goal(self) -> Goal:
        """Target, constraints and clock."""

    def value(self, at: Posture) -> float:
        """Objective value at a posture."""

    def min_decrease(self, value: float) -> float:
        """Smallest predicted decrease of the objective that is worth a step."""

    def converged(self, at: Posture, values: Sequence[float]) -> bool:
        """True if the descent may end, after these objectives of all iterates."""

    def model(self, at: Posture, side: int, last: AcceptedStep | None) -> StepModel:
        """Model near a posture, for translations that grow (side 1) or shrink (-1); `last` is the step before it."""

    def after(self, current: Posture, x: Array) -> Restored:
        """Posture after a motion, restored to the constraints."""

    def after_crossing(self, crossed: Posture) -> Posture | None:
        """Posture beyond a change of the order of breakpoints, restored to the constraints."""


@dataclass(frozen=True, eq=False)
class DescentSearch:
    """Result of a search for the target."""

    posture: Posture
    """Best posture."""
    reached: bool
    """True if it is on target."""
    iterations: int
    solves: int
    """Number of equilibria solved."""


class GaussNewtonDescent(NamedTuple):
    """Result of a descent."""

    posture: Posture
    steps: int
    solves: int
    """Number of equilibria solved."""


def descend(
    problem: DescentProblem, start: Posture, *, size: float, max_steps: int, max_solves: float = np.inf
) -> GaussNewtonDescent:
    """Minimise the objective of a problem from a start; `size` is the first trust region."""
    current, side, steps, solves = start, 1, 0, 0
    last: AcceptedStep | None = None
    values = [problem.value(current)]
    while steps < max_steps and solves < max_solves and not problem.goal.clock.over:
        if problem.converged(current, values):
            break
        step, count = _trust_region_step(problem, current, values[-1], size, side=side, last=last)
        solves += count
        if step is None and side > 0 and current.two_sided:
            # Where a section is closed, derivatives differ to either side: the other side may still descend.
            side, size, last = -1, 0.5 * FIRST_STEP, None
            continue
        # A model of the other side does not continue that of this one.
        last = step if side > 0 else None
        if step is None:
            step, count = _step_across(problem, current, values[-1])
            solves += count
        if step is None:
            break
        current, size, side = step.posture, step.size, 1
        values.append(step.value)
        steps += 1
    return GaussNewtonDescent(current, steps, solves)


def _trust_region_step(
    problem: DescentProblem,
    current: Posture,
    value: float,
    size: float,
    *,
    side: int = 1,
    last: AcceptedStep | None = None,
) -> tuple[AcceptedStep | None, int]:
    """Largest step tried that decreases the objective enough, None without one, and the equilibria solved."""
    goal, solves = problem.goal, 0
    model, known_bodies = problem.model(current, side, last), len(goal.touched)
    while size > SHORTEST_STEP and not goal.clock.over:
        chosen = model.step(goal, size)
        predicted = 0.0 if chosen is None else model.decrease(chosen.x)
        if chosen is None or predicted <= problem.min_decrease(value):
            break
        trial = problem.after(current, chosen.x)
        solves += trial.solves
        trial_value = np.inf if trial.posture is None else problem.value(trial.posture)
        if trial.posture is not None and value - trial_value >= ACCEPTED * predicted:
            faithful = value - trial_value >= FAITHFUL * predicted
            size = min(2 * size, 2 * FIRST_STEP) if faithful else size
            return AcceptedStep(model, chosen.x, chosen.active, trial.posture, trial_value, size), solves
        size = SHRINK * min(size, float(np.abs(chosen.x / goal.space.scale).max()))
        if len(goal.touched) > known_bodies:  # obstacles that the model did not know
            model, known_bodies = problem.model(current, side, last), len(goal.touched)
    return None, solves


def _step_across(problem: DescentProblem, current: Posture, value: float) -> tuple[AcceptedStep | None, int]:
    """Step from beyond a change of the order of breakpoints to a smaller objective, and the equilibria solved."""
    solves = 0
    for crossed in crossings(problem.goal, current, SHORT_SECTION * problem.goal.space.length):
        start = problem.after_crossing(crossed)
        if start is None:
            continue
        # Short, since the next change of order may be as close as this one was.
        step, count = _trust_region_step(problem, start, problem.value(start), 0.1 * FIRST_STEP)
        solves += count
        if step is not None and step.value < value - problem.min_decrease(value):
            return step, solves
    return None, solves


# --- to the target ----------------------------------------------------------------------------------------------------

ON_TARGET = 1e-10
"""Distance (m) and angle (rad) that end the descent: a hundredth of the tolerance of a solution.

So the result remains a solution on a finer mesh.
"""

MIN_DECREASE = 1e-7
"""Relative decrease of the residual that a step must promise."""

# Steps past a kink gain little, and the next ones more. On the same targets 2 and 10 in place of 5 change the number
# of equilibria by 2 % at most.
PATIENCE, STAGNANT = 5, 0.97
"""Number of steps in a row that must reduce the residual below this fraction."""


def reach(goal: Goal, start: Posture) -> DescentSearch:
    """Levenberg-Marquardt descent from a stable posture to the target, and out of obstacles."""
    end = descend(_TargetProblem(goal), start, size=FIRST_STEP, max_steps=goal.options.steps)
    reached = goal.reached(end.posture, 1e-8, 1e-8) and goal.allowed(end.posture, SLACK)
    return DescentSearch(end.posture, reached, end.steps, end.solves)


@dataclass(frozen=True, eq=False)
class _TargetProblem:
    """Half the square of the residual and of the missing clearances."""

    goal: Goal

    def value(self, at: Posture) -> float:
        residual = np.concatenate([self.goal.residual(at), self.goal.collisions(at)[0]])
        return 0.5 * float(residual @ residual)

    def min_decrease(self, value: float) -> float:
        return 2 * MIN_DECREASE * value

    def converged(self, at: Posture, values: Sequence[float]) -> bool:
        """True if on target, or stagnant over the last steps."""
        # Values are half the squares of distances.
        if len(values) > PATIENCE and values[-1] > STAGNANT**2 * values[-1 - PATIENCE]:
            return True
        return self.goal.reached(at, ON_TARGET, ON_TARGET) and self.goal.allowed(at, SLACK)

    def model(self, at: Posture, side: int, last: AcceptedStep | None) -> StepModel:
        missing, collision_slope = self.goal.collisions(at)
        residual = np.concatenate([self.goal.residual(at), missing])
        jacobian = np.vstack([self.goal.slope(at, side=side), collision_slope])
        return StepModel(jacobian, -residual, *damping(self.goal, residual), *self.goal.inequalities(at))

    def after(self, current: Posture, x: Array) -> Restored:
        """Posture after a motion; None if it violates a constraint: the step is too long then."""
        at = current.to(self.goal.space.clip(current.q + x))
        if at is None or at.margin < min(self.goal.kept_margin, current.margin):
            return Restored(None, 1)
        deeper = self.goal.violation(at) > self.goal.violation(current) + SLACK
        return Restored(None if deeper else at, 1)

    def after_crossing(self, crossed: Posture) -> Posture | None:
        """None, since other starts cover the other orders."""
        return None


def damping(goal: Goal, residual: Array) -> tuple[Array, Array]:
    """Levenberg-Marquardt damping (m, m), with right-hand side 0 (m,), of a step that reduces a residual.

    It is of the order of the squared residual, which preserves quadratic convergence (Yamashita and Fukushima 2001).
    """
    # Far from the target the trust region limits the step, so that the damping is capped. 1e-14 keeps the matrix
    # regular on target.
    size = np.sqrt(min(1e-2 * float(residual @ residual), 1e-3) + 1e-14)
    return np.diag(size / goal.space.scale), np.zeros(len(goal.space.scale))


# --- to the smallest cost on target -----------------------------------------------------------------------------------

# Twice as many as lead to the target. Margin and curvature, of which only gradients are known, are lowered by steepest
# descent, which converges linearly and uses most of these steps.
IMPROVING_STEPS = 60
"""Maximum number of steps that lower the cost of a solution on target."""

# The weight takes the place of an equality in the quadratic program. Squared, 1e8, it leaves the cost eight of the
# sixteen digits of a double, and the target a miss of 1e-8 of the step, which `correct` takes away.
TARGET_WEIGHT = 1e4
"""Weight of the target relative to the cost, in an improving step."""

MAX_RIGHT = 1e6
"""Right-hand side of the cost in a step: a larger one would drown the target in round-off."""


def improve(goal: Goal, start: Posture) -> DescentSearch:
    """Lower the cost from a posture on target, without leaving it."""
    if not goal.ranked:
        return DescentSearch(start, True, 0, 0)
    end = descend(_CostProblem(goal), start, size=0.5 * FIRST_STEP, max_steps=IMPROVING_STEPS)
    return DescentSearch(end.posture, True, end.steps, end.solves)


@dataclass(frozen=True, eq=False)
class _CostProblem:
    """Cost among postures on target: each step is brought back to it, in the same order of breakpoints."""

    goal: Goal

    def value(self, at: Posture) -> float:
        return self.goal.cost(at)

    def min_decrease(self, value: float) -> float:
        return 1e-9 * max(abs(value), 1e-3)

    def converged(self, at: Posture, values: Sequence[float]) -> bool:
        return len(values) > 1 and values[-2] - values[-1] < 1e-7 * max(abs(values[-1]), 1e-3)

    def model(self, at: Posture, side: int, last: AcceptedStep | None) -> StepModel:
        goal = self.goal
        cost, right = goal.cost_rows(at, 1e-3)
        right *= min(1.0, MAX_RIGHT / max(float(np.linalg.norm(right)), 1e-300))
        target = on_target(goal.slope(at, side=side), goal.residual(at))
        order = breakpoint_order(goal.space, at)
        return StepModel(cost, right, *target, *order.constrain(at.q, *goal.inequalities(at)))

    def after(self, current: Posture, x: Array) -> Restored:
        order = breakpoint_order(self.goal.space, current)
        return moved(self.goal, current, x, self.goal.slope(current), tolerance=ON_TARGET, order=order)

    def after_crossing(self, crossed: Posture) -> Posture | None:
        return correct(self.goal, crossed, self.goal.slope(crossed), tolerance=ON_TARGET).posture


def on_target(slope: Array, residual: Array) -> tuple[Array, Array]:
    """Rows and right-hand sides of the constraint that a step stays on target."""
    return TARGET_WEIGHT * slope, -TARGET_WEIGHT * residual


@dataclass(frozen=True, eq=False)
class ConstraintCorrection(Restored):
    """Posture brought back onto the target; None if that fails or violates constraints."""

    slope: Array
    """Jacobian of the residual, updated by the steps."""


def moved(
    goal: Goal,
    current: Posture,
    x: Array,
    slope: Array,
    *,
    tolerance: float,
    max_steps: int = 8,
    order: OrderConstraints | None = None,
) -> ConstraintCorrection:
    """Posture after a motion, brought back onto the target."""
    at = current.to(goal.space.clip(current.q + x))
    if at is None:
        return ConstraintCorrection(None, 1, slope)
    slope = broyden(slope, at.q - current.q, goal.residual(at) - goal.residual(current), goal.space.scale)
    corrected = correct(goal, at, slope, tolerance=tolerance, max_steps=max_steps, order=order)
    return replace(corrected, solves=1 + corrected.solves)


def correct(
    goal: Goal,
    at: Posture,
    slope: Array,
    *,
    tolerance: float,
    max_steps: int = 8,
    order: OrderConstraints | None = None,
) -> ConstraintCorrection:
    """Bring a posture back onto the target by Broyden's method, within joint limits and order of breakpoints.

    Args:
        slope: Jacobian of the residual at a nearby posture.
        tolerance: distance, m, and angle, rad, from the target.
        order: order of breakpoints to keep; None allows changes.
    """
    residual, solves = goal.residual(at), 0
    while not goal.reached(at, tolerance, tolerance):
        if solves == max_steps:
            return ConstraintCorrection(None, solves, slope)
        rows, bounds = goal.space.inequalities(at.q)
        if order is not None:
            rows, bounds = order.constrain(at.q, rows, bounds)
        model = StepModel(slope, -residual, *damping(goal, residual), rows, np.minimum(bounds, 0.0))
        chosen = model.step(goal, FIRST_STEP)
        next_at = None if chosen is None else at.to(goal.space.clip(at.q + chosen.x))
        solves += 1
        if next_at is None:
            return ConstraintCorrection(None, solves, slope)
        new = goal.residual(next_at)
        # Close to the target each step gains far more: less means that the motion before was too long.
        if np.linalg.norm(new) > 0.5 * np.linalg.norm(residual) and not goal.reached(next_at, 1e-9, 1e-9):
            return ConstraintCorrection(None, solves, slope)
        slope = broyden(slope, next_at.q - at.q, new - residual, goal.space.scale)
        at, residual = next_at, new
    return ConstraintCorrection(at if goal.allowed(at, SLACK) else None, solves, slope)


def broyden(slope: Array, step: Array, change: Array, scale: Array | float = 1.0) -> Array:
    """Jacobian (r, m) closest to `slope`, in units of `scale`, that maps a step (m,) to a change (r,) of the residual.

    It is the smallest rank-one change in the metric of the joints' scales (Broyden 1965).
    """
    weighted = step / scale**2
    size = float(step @ weighted)
    return slope if size <= 1e-20 else slope + np.outer(change - slope @ step, weighted) / size
