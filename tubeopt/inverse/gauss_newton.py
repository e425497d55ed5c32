"""Constrained Gauss-Newton method of inverse kinematics, with a trust region.

    minimise  |A x - b|^2 + |A' x - b'|^2   over motions x (m,) of the joints
    subject to  rows x >= bounds,  |x_k| <= size scale_k

A `DescentProblem` defines the objective; near an iterate its model is |A x - b|^2 / 2. A' and b' only guide the step,
as Levenberg-Marquardt damping does. A problem also defines how an iterate after a step is restored to its constraints.
A step is accepted if the objective decreases by a fraction of the decrease that the model predicts; else the trust
region shrinks (Nocedal and Wright, Numerical Optimization, 2006, algorithm 4.1).

Iterates of inverse kinematics are postures: solved, stable equilibria. Those of mirror actuation (`mirror.py`) are
postures in other coordinates.

Derivatives differ to either side where breakpoints along the arm coincide. So a descent ends only if neither side
promises a decrease, and neither does a posture beyond the next change of their order.

`reach` brings the tip to the target and out of obstacles. `improve` then lowers the cost in the null space.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np

from ..solvers.compiled.quadratic import LeastSquares, constrained_least_squares
from ..typing import Array, Index
from .breakpoint_order import SHORT_SECTION, OrderConstraints, breakpoint_order, crossings
from .clock import Clock
from .goal import Goal
from .posture import Posture

P = TypeVar("P")
"""Iterate of a descent."""

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
    """Quadratic program of a step near an iterate, in changes x (m,) of the unknowns."""

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

    def step(self, scale: Array, size: float) -> LeastSquares | None:
        """Solution in the trust region |x_k| <= size scale_k; None if the constraints exclude it."""
        unit = np.diag(1 / scale)
        return constrained_least_squares(
            np.vstack([self.matrix, self.guide_matrix]),
            np.concatenate([self.right, self.guide_right]),
            np.vstack([self.rows, unit, -unit]),
            np.concatenate([self.bounds, np.full(2 * len(unit), -size)]),
        )

    def decrease(self, x: Array) -> float:
        """Predicted decrease of the objective by a step."""
        residual = self.matrix @ x - self.right
        return 0.5 * float(self.right @ self.right - residual @ residual)


@dataclass(frozen=True, eq=False)
class AcceptedStep(Generic[P]):
    """Accepted step of the Gauss-Newton iteration."""

    model: StepModel
    x: Array
    """Change (m,) of the unknowns."""
    active: Index
    """Numbers of the active rows, and after them of the active sides of the trust region."""
    iterate: P
    """Iterate after the step."""
    value: float
    """Objective after the step."""
    size: float
    """Trust region of the next step."""


@dataclass(frozen=True, eq=False)
class Restored(Generic[P]):
    """Iterate after it was restored to its constraints."""

    iterate: P | None
    """Iterate that satisfies the constraints; None if none was found."""
    solves: int
    """Number of equilibria solved."""


class DescentProblem(Protocol[P]):
    """Objective and constraints of a descent."""

    @property
    def scale(self) -> Array:
        """Units (m,) of the unknowns."""

    @property
    def clock(self) -> Clock:
        """Time limit."""

    @property
    def touched(self) -> Collection[int]:
        """Numbers of the bodies that iterates came too close to; a model knows those when it is made."""

    def value(self, at: P) -> float:
        """Objective value at an iterate."""

    def min_decrease(self, value: float) -> float:
        """Smallest predicted decrease of the objective that is worth a step."""

    def converged(self, at: P, values: Sequence[float]) -> bool:
        """True if the descent may end, after these objectives of all iterates."""

    def model(self, at: P, side: int, last: AcceptedStep[P] | None) -> StepModel:
        """Model near an iterate, for translations that grow (side 1) or shrink (-1); `last` is the step before it."""

    def after(self, current: P, x: Array) -> Restored[P]:
        """Iterate after a step, restored to the constraints."""

    def two_sided(self, at: P) -> bool:
        """True if derivatives differ to either side, as where breakpoints coincide."""

    def across(self, at: P) -> Iterable[P]:
        """Iterates beyond the next changes of the order of breakpoints, restored to the constraints."""


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


@dataclass(frozen=True, eq=False)
class GaussNewtonDescent(Generic[P]):
    """Result of a descent."""

    iterate: P
    steps: int
    solves: int
    """Number of equilibria solved."""


def descend(
    problem: DescentProblem[P], start: P, *, size: float, max_steps: int, max_solves: float = np.inf
) -> GaussNewtonDescent[P]:
    """Minimise the objective of a problem from a start; `size` is the first trust region."""
    current, side, steps, solves = start, 1, 0, 0
    last: AcceptedStep[P] | None = None
    values = [problem.value(current)]
    while steps < max_steps and solves < max_solves and not problem.clock.over:
        if problem.converged(current, values):
            break
        step, count = _trust_region_step(problem, current, values[-1], size, side=side, last=last)
        solves += count
        if step is None and side > 0 and problem.two_sided(current):
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
        current, size, side = step.iterate, step.size, 1
        values.append(step.value)
        steps += 1
    return GaussNewtonDescent(current, steps, solves)


def _trust_region_step(
    problem: DescentProblem[P],
    current: P,
    value: float,
    size: float,
    *,
    side: int = 1,
    last: AcceptedStep[P] | None = None,
) -> tuple[AcceptedStep[P] | None, int]:
    """Largest step tried that decreases the objective enough, None without one, and the equilibria solved."""
    scale, solves = problem.scale, 0
    model, known_bodies = problem.model(current, side, last), len(problem.touched)
    while size > SHORTEST_STEP and not problem.clock.over:
        chosen = model.step(scale, size)
        predicted = 0.0 if chosen is None else model.decrease(chosen.x)
        if chosen is None or predicted <= problem.min_decrease(value):
            break
        trial = problem.after(current, chosen.x)
        solves += trial.solves
        trial_value = np.inf if trial.iterate is None else problem.value(trial.iterate)
        if trial.iterate is not None and value - trial_value >= ACCEPTED * predicted:
            faithful = value - trial_value >= FAITHFUL * predicted
            size = min(2 * size, 2 * FIRST_STEP) if faithful else size
            return AcceptedStep(model, chosen.x, chosen.active, trial.iterate, trial_value, size), solves
        size = SHRINK * min(size, float(np.abs(chosen.x / scale).max()))
        if len(problem.touched) > known_bodies:  # obstacles that the model did not know
            model, known_bodies = problem.model(current, side, last), len(problem.touched)
    return None, solves


def _step_across(problem: DescentProblem[P], current: P, value: float) -> tuple[AcceptedStep[P] | None, int]:
    """Step from beyond a change of the order of breakpoints to a smaller objective, and the equilibria solved."""
    solves = 0
    for start in problem.across(current):
        # Short, since the next change of order may be as close as this one was.
        step, count = _trust_region_step(problem, start, problem.value(start), 0.1 * FIRST_STEP)
        solves += count
        if step is not None and step.value < value - problem.min_decrease(value):
            return step, solves
    return None, solves


@dataclass(frozen=True, eq=False)
class GoalProblem:
    """Descent among the postures of a goal; subclasses add the objective."""

    goal: Goal

    @property
    def scale(self) -> Array:
        return self.goal.space.scale

    @property
    def clock(self) -> Clock:
        return self.goal.clock

    @property
    def touched(self) -> Collection[int]:
        return self.goal.touched

    def two_sided(self, at: Posture) -> bool:
        return at.two_sided

    def across(self, at: Posture) -> Iterator[Posture]:
        crossed = crossings(self.goal, at, SHORT_SECTION * self.goal.space.length)
        return (end for each in crossed if (end := self.after_crossing(each)) is not None)

    def after_crossing(self, crossed: Posture) -> Posture | None:
        """Posture beyond a change of the order of breakpoints, restored to the constraints."""
        raise NotImplementedError


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
    reached = goal.reached(end.iterate, 1e-8, 1e-8) and goal.allowed(end.iterate, SLACK)
    return DescentSearch(end.iterate, reached, end.steps, end.solves)


class _TargetProblem(GoalProblem):
    """Half the square of the residual and of the missing clearances."""

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

    def model(self, at: Posture, side: int, last: AcceptedStep[Posture] | None) -> StepModel:
        missing, collision_slope = self.goal.collisions(at)
        residual = np.concatenate([self.goal.residual(at), missing])
        jacobian = np.vstack([self.goal.slope(at, side=side), collision_slope])
        return StepModel(jacobian, -residual, *damping(self.goal, residual), *self.goal.inequalities(at))

    def after(self, current: Posture, x: Array) -> Restored[Posture]:
        """Posture after a motion; None if it violates a constraint: the step is too long then."""
        at = current.to(self.goal.space.clip(current.q + x))
        if at is None or at.margin < min(self.goal.kept_margin, current.margin):
            return Restored(None, 1)
        deeper = self.goal.violation(at) > self.goal.violation(current) + SLACK
        return Restored(None if deeper else at, 1)

    def across(self, at: Posture) -> Iterator[Posture]:
        """None, since other starts cover the other orders."""
        return iter(())


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
    return DescentSearch(end.iterate, True, end.steps, end.solves)


class _CostProblem(GoalProblem):
    """Cost among postures on target: each step is brought back to it, in the same order of breakpoints."""

    def value(self, at: Posture) -> float:
        return self.goal.cost(at)

    def min_decrease(self, value: float) -> float:
        return 1e-9 * max(abs(value), 1e-3)

    def converged(self, at: Posture, values: Sequence[float]) -> bool:
        return len(values) > 1 and values[-2] - values[-1] < 1e-7 * max(abs(values[-1]), 1e-3)

    def model(self, at: Posture, side: int, last: AcceptedStep[Posture] | None) -> StepModel:
        goal = self.goal
        cost, right = goal.cost_rows(at, 1e-3)
        right *= min(1.0, MAX_RIGHT / max(float(np.linalg.norm(right)), 1e-300))
        target = on_target(goal.slope(at, side=side), goal.residual(at))
        order = breakpoint_order(goal.space, at)
        return StepModel(cost, right, *target, *order.constrain(at.q, *goal.inequalities(at)))

    def after(self, current: Posture, x: Array) -> Restored[Posture]:
        order = breakpoint_order(self.goal.space, current)
        return moved(self.goal, current, x, self.goal.slope(current), tolerance=ON_TARGET, order=order)

    def after_crossing(self, crossed: Posture) -> Posture | None:
        return correct(self.goal, crossed, self.goal.slope(crossed), tolerance=ON_TARGET).iterate


def on_target(slope: Array, residual: Array) -> tuple[Array, Array]:
    """Rows and right-hand sides of the constraint that a step stays on target."""
    return TARGET_WEIGHT * slope, -TARGET_WEIGHT * residual


@dataclass(frozen=True, eq=False)
class ConstraintCorrection(Restored[Posture]):
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
        chosen = model.step(goal.space.scale, FIRST_STEP)
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
