"""The fast path: descents of postures to the target, and along it to less cost.

`reach` brings the tip to the target and out of any obstacle, `improve` then moves in what the target leaves free: each
is a question to the descent of `gauss_newton`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..files.units import TO_MM
from ..typing import Array
from .arm_surface import MOST_CONTACTS
from .gauss_newton import FIRST_STEP, SLACK, Back, Descent, Model, Search, Step
from .goal import DIRECTION_TOLERANCE, POSITION_TOLERANCE, Goal
from .order import Order, breakpoint_order
from .posture import Posture

ON_TARGET = 1e-10
"""Distance (m) and angle (rad) at which the descent stops: a hundredth of what an answer may miss by, so that solving
again on a finer mesh leaves it an answer."""

LEAST_PROMISE = 1e-7
"""Relative decrease of what is left to the target that a step must promise."""

PATIENCE, STAGNANT = 5, 0.97
"""Steps in a row that together must bring the tip closer than this share of its distance."""

IMPROVING_STEPS = 60
"""Maximum number of steps that lower the cost of a solution on target."""

TARGET_WEIGHT = 1e4
"""Weight of the target relative to the cost, in an improving step."""

SMALL_MARGIN = 0.01
"""Margin below which a smaller one is no advice."""

HELD = 1e-5
"""Distance from a limit, in units of the joints' scales, up to which it counts as reached."""

LEAST_SHARE = 0.05
"""Share of the pull to the target that the limit has to carry which is the cause."""

MOST_PULL = 1e6
"""Right-hand side of the cost in a step: a larger one would drown the target in round-off."""


def reach(goal: Goal, start: Posture) -> Search:
    """From a stable posture towards the target, and out of any obstacle, by Levenberg's and Marquardt's damping."""
    descent = Descent(_Target(goal), FIRST_STEP, goal.options.steps)
    end = descent.last(start)
    return Search(end, _done(goal, end, 1e-8), descent.steps, descent.solves)


def _done(goal: Goal, at: Posture, close: float) -> bool:
    return goal.reached(at, close, close) and goal.allowed(at, SLACK)


@dataclass(frozen=True, eq=False)
class _Target:
    """Half the square of what is left to the target, and of the clearances that are missing."""

    goal: Goal

    def value(self, at: Posture) -> float:
        left = np.concatenate([self.goal.residual(at), self.goal.collisions(at)[0]])
        return 0.5 * float(left @ left)

    def least(self, value: float) -> float:
        return 2 * LEAST_PROMISE * value

    def ended(self, at: Posture, values: Sequence[float]) -> bool:
        """On target, or where the last steps together brought next to nothing."""
        # Values are half the squares of distances.
        stagnant = len(values) > PATIENCE and values[-1] > STAGNANT**2 * values[-1 - PATIENCE]
        return stagnant or _done(self.goal, at, ON_TARGET)

    def model(self, at: Posture, side: int, last: Step | None) -> Model:
        short, across = self.goal.collisions(at)
        missing = np.concatenate([self.goal.residual(at), short])
        slope = np.vstack([self.goal.slope(at, side=side), across])
        return Model(slope, -missing, *damping(self.goal, missing), *self.goal.inequalities(at))

    def back(self, here: Posture, x: Array) -> Back:
        """What is not kept is not brought back: the step is too long."""
        there = here.to(self.goal.space.clip(here.q + x))
        if there is None or there.margin < min(self.goal.floor, here.margin):
            return Back(None, 1)
        nearer = self.goal.violation(there) > self.goal.violation(here) + SLACK
        return Back(None if nearer else there, 1)

    def beyond(self, past: Posture) -> Posture | None:
        """Not looked at: other starts come from there."""
        return None


def damping(goal: Goal, residual: Array) -> tuple[Array, Array]:
    """(m, m) and (m,) the guide of a step that makes a residual 0: of the order of its square, which keeps quadratic
    convergence (Yamashita and Fukushima 2001)."""
    size = np.sqrt(min(1e-2 * float(residual @ residual), 1e-3) + 1e-14)
    return np.diag(size / goal.space.scale), np.zeros(len(goal.space.scale))


def improve(goal: Goal, start: Posture) -> Search:
    """Lower the cost from a posture on target, without leaving it."""
    if not goal.ranked:
        return Search(start, True, 0, 0)
    descent = Descent(_Cost(goal), 0.5 * FIRST_STEP, IMPROVING_STEPS)
    return Search(descent.last(start), True, descent.steps, descent.solves)


@dataclass(frozen=True, eq=False)
class _Cost:
    """The cost among postures on target: each step is brought back to it, in the same order of breakpoints."""

    goal: Goal

    def value(self, at: Posture) -> float:
        return self.goal.cost(at)

    def least(self, value: float) -> float:
        return 1e-9 * max(abs(value), 1e-3)

    def ended(self, at: Posture, values: Sequence[float]) -> bool:
        return len(values) > 1 and values[-2] - values[-1] < 1e-7 * max(abs(values[-1]), 1e-3)

    def model(self, at: Posture, side: int, last: Step | None) -> Model:
        goal = self.goal
        cost, right = goal.cost_rows(at, 1e-3)
        right *= min(1.0, MOST_PULL / max(float(np.linalg.norm(right)), 1e-300))
        target = on_target(goal.slope(at, side=side), goal.residual(at))
        return Model(cost, right, *target, *breakpoint_order(goal, at).kept(at.q, *goal.inequalities(at)))

    def back(self, here: Posture, x: Array) -> Back:
        order = breakpoint_order(self.goal, here)
        return moved(self.goal, here, x, self.goal.slope(here), close=ON_TARGET, order=order)

    def beyond(self, past: Posture) -> Posture | None:
        return correct(self.goal, past, self.goal.slope(past), close=ON_TARGET).posture


def on_target(slope: Array, residual: Array) -> tuple[Array, Array]:
    """Rows and right-hand sides of a step that ends on target whatever else it does."""
    return TARGET_WEIGHT * slope, -TARGET_WEIGHT * residual


@dataclass(frozen=True, eq=False)
class Correction(Back):
    """A posture brought back onto the target, or None where that leads nowhere or out of what is allowed."""

    slope: Array
    """As the steps have updated it."""


def moved(
    goal: Goal, here: Posture, x: Array, slope: Array, *, close: float, most: int = 8, order: Order | None = None
) -> Correction:
    """The posture after a motion, back on target."""
    there = here.to(goal.space.clip(here.q + x))
    if there is None:
        return Correction(None, 1, slope)
    slope = broyden(slope, there.q - here.q, goal.residual(there) - goal.residual(here), goal.space.scale)
    back = correct(goal, there, slope, close=close, most=most, order=order)
    return replace(back, solves=1 + back.solves)


def correct(
    goal: Goal,
    at: Posture,
    slope: Array,
    *,
    close: float,
    most: int = 8,
    order: Order | None = None,
) -> Correction:
    """Back onto the target with the derivatives of a posture near by: Broyden's method within the joints' limits, and
    without a change of the order of breakpoints where one is given."""
    residual, solves = goal.residual(at), 0
    while not goal.reached(at, close, close):
        if solves == most:
            return Correction(None, solves, slope)
        rows, bounds = goal.space.inequalities(at.q)
        if order is not None:
            rows, bounds = order.kept(at.q, rows, bounds)
        model = Model(slope, -residual, *damping(goal, residual), rows, np.minimum(bounds, 0.0))
        chosen = model.step(goal, FIRST_STEP)
        there = None if chosen is None else at.to(goal.space.clip(at.q + chosen.x))
        solves += 1
        if there is None:
            return Correction(None, solves, slope)
        new = goal.residual(there)
        if np.linalg.norm(new) > 0.5 * np.linalg.norm(residual) and not goal.reached(there, 1e-9, 1e-9):
            return Correction(None, solves, slope)
        slope = broyden(slope, there.q - at.q, new - residual, goal.space.scale)
        at, residual = there, new
    return Correction(at if goal.allowed(at, SLACK) else None, solves, slope)


def broyden(slope: Array, moved: Array, change: Array, scale: Array | float = 1.0) -> Array:
    """Broyden's update (r, m): the slope closest to `slope`, in units of `scale`, that explains a change (r,) of the
    residual by a motion (m,)."""
    weighted = moved / scale**2
    size = float(moved @ weighted)
    return slope if size <= 1e-20 else slope + np.outer(change - slope @ moved, weighted) / size


def held_most(goal: Goal, at: Posture) -> tuple[str, str]:
    """The limit with the largest multiplier where a search has ended, and what moves the tip beyond it, in words; empty
    where none holds the tip back.

    At a minimum the pull to the target is a sum of the limits' normals with multipliers that are not negative.
    """
    rows, bounds, names = goal.demands(at)
    normals = rows * goal.space.scale
    size = np.linalg.norm(normals, axis=1)
    held = np.flatnonzero((size > 0) & (bounds >= -HELD * size))
    pull = goal.slope(at).T @ goal.residual(at) * goal.space.scale
    if not len(held) or not pull.any():
        return "", ""
    force, _ = scipy.optimize.nnls((normals[held] / size[held, None]).T, pull)
    if force.max() < LEAST_SHARE * np.linalg.norm(pull):
        return "", ""
    k, ranges = int(held[np.argmax(force)]), len(at.room)
    if k < ranges:
        return goal.space.limit(k), "move the target"
    if k == ranges:
        least = f"margin at its bound ({goal.min_margin:g})"
        return least, "allow a smaller min_margin" if goal.min_margin > SMALL_MARGIN else "move the target"
    if names[k] < 0:
        return next(iter(goal.extras.broken(at)), ""), "relax that constraint"
    body = int(names[k]) // MOST_CONTACTS
    words = f"arm at obstacle {body + 1} ({type(goal.scene.bodies[body]).__name__.lower()})"
    return words, "allow a smaller clearance" if goal.clearance else "move the target away from it"


def millimetres(length: float) -> str:
    """A length (m) in mm, to three digits or whole."""
    size = length * TO_MM
    return f"{size:.3g} mm" if size < 1e3 else f"{size:.0f} mm"


def missed_by(goal: Goal, at: Posture) -> str:
    """In words, by how much a posture misses the target."""
    position, direction = goal.position_error(at), goal.direction_error(at)
    words = []
    if position > POSITION_TOLERANCE or not goal.pointed:
        words.append(f"{millimetres(position)} short")
    if goal.pointed and (direction > DIRECTION_TOLERANCE or not words):
        words.append(f"{np.degrees(direction):.3g} deg off the direction")
    return " and ".join(words)


def held_by(goal: Goal, at: Posture) -> list[str]:
    """In words, what keeps the tip from the target at a posture where the search has ended."""
    words = goal.space.active(at.q)
    if at.margin - goal.floor < 1e-3:
        words.append(f"margin at its bound ({goal.min_margin:g})")
    for k in np.unique(goal.contacts(at, goal.gap + 1e-5).body).tolist():
        words.append(f"arm at obstacle {k + 1} ({type(goal.scene.bodies[k]).__name__.lower()})")
    return words + goal.extras.broken(at)
