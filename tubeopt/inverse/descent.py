"""The fast path: Gauss-Newton on the implicit derivatives of the equilibrium, with active bounds.

Every iterate is a solved, stable equilibrium that keeps joints, order, margin and clearance. A step is a small
least-squares problem with the linearised constraints as inequalities; it is shortened until the real arm agrees with
its prediction. `reach` brings the tip to the target, `improve` then moves in the null space of the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..files.units import TO_MM
from ..typing import Array
from .goal import Goal
from .least_squares import LeastSquares, constrained_least_squares
from .order import Order, breakpoint_order, crossings
from .posture import Posture

SLACK = 1e-9
"""Clearance (m) that may be missing by round-off."""


@dataclass(frozen=True, eq=False)
class Search:
    """Where a search ended."""

    posture: Posture
    """The best."""
    reached: bool
    """Whether it is on target."""
    iterations: int
    solves: int
    """Equilibria."""


def reach(goal: Goal, start: Posture) -> Search:
    """Levenberg-Marquardt with inequalities from a stable posture towards the target, and out of any obstacle."""
    solver = goal.solver.descent
    here, step, solves, side = start, solver.first_step, 0, 1
    sizes = [float(np.linalg.norm(_missing(goal, here)))]
    for iteration in range(solver.steps):
        if _done(goal, here, solver.tolerance):
            return Search(here, True, iteration, solves)
        short, across = goal.collisions(here)
        missing = np.concatenate([goal.residual(here), short])
        slope = np.vstack([goal.slope(here, side=side), across])
        rows, bounds = goal.inequalities(here)
        there, promised, touched = None, 0.0, len(goal.touched)
        while there is None and not goal.clock.over:
            chosen = _towards(goal, slope, missing, rows, bounds, step)
            promised = sizes[-1] - float(np.linalg.norm(missing + slope @ chosen.x)) if chosen is not None else 0.0
            if chosen is None or promised <= solver.least_promise * sizes[-1] or step < solver.shortest_step:
                break
            there = _tried(goal, here, chosen.x, sizes[-1] - 0.1 * promised)
            solves += 1
            if there is None:
                step = 0.35 * min(step, _length(goal, chosen.x))
                if len(goal.touched) > touched:
                    (rows, bounds), touched = goal.inequalities(here), len(goal.touched)
        if there is None and side > 0 and not goal.clock.over and not _done(goal, here, 1e-8):
            # Breakpoints may coincide: what holds forwards may not hold backwards.
            side, step = -1, 0.5 * solver.first_step
            continue
        if there is None or _stagnant(sizes, solver.patience) or goal.clock.over:
            here = here if there is None else there
            return Search(here, _done(goal, here, 1e-8), iteration, solves)
        here, side = there, 1
        sizes.append(float(np.linalg.norm(_missing(goal, here))))
        if sizes[-2] - sizes[-1] >= 0.7 * promised:
            step = min(2 * step, 2 * solver.first_step)
    return Search(here, _done(goal, here, 1e-8), solver.steps, solves)


def _missing(goal: Goal, at: Posture) -> Array:
    """What is left to the target, and the clearances that are missing."""
    return np.concatenate([goal.residual(at), goal.collisions(at)[0]])


def _done(goal: Goal, at: Posture, close: float) -> bool:
    return goal.reached(at, close, close) and goal.allowed(at, SLACK)


def _tried(goal: Goal, here: Posture, step: Array, most: float) -> Posture | None:
    """The posture after a step, if it keeps what must be kept, and leaves no more missing than `most`."""
    there = here.to(goal.space.clip(here.q + step))
    if there is None or there.margin < min(goal.floor, here.margin):
        return None
    if goal.violation(there) > goal.violation(here) + SLACK:
        return None
    return there if np.linalg.norm(_missing(goal, there)) <= most else None


def _stagnant(sizes: list[float], patience: int) -> bool:
    """Whether the last steps together brought next to nothing."""
    return len(sizes) > patience and sizes[-1] > 0.97 * sizes[-1 - patience]


def _length(goal: Goal, step: Array) -> float:
    return float(np.abs(step / goal.space.scale).max())


def boxed(goal: Goal, rows: Array, bounds: Array, step: float) -> tuple[Array, Array]:
    """The inequalities with a step of at most `step` in every joint."""
    unit = np.diag(1 / goal.space.scale)
    most = np.full(2 * len(unit), -step)
    return np.vstack([rows, unit, -unit]), np.concatenate([bounds, most])


def _towards(goal: Goal, slope: Array, residual: Array, rows: Array, bounds: Array, step: float) -> LeastSquares | None:
    """The step that brings the tip nearest to the target: the shortest one, where several do."""
    # Damping by the square of the residual keeps quadratic convergence (Yamashita and Fukushima 2001).
    damping = np.sqrt(min(1e-2 * float(residual @ residual), 1e-3) + 1e-14)
    matrix = np.vstack([slope, np.diag(damping / goal.space.scale)])
    right = np.concatenate([-residual, np.zeros(len(goal.space.scale))])
    return constrained_least_squares(matrix, right, *boxed(goal, rows, bounds, step))


def improve(goal: Goal, start: Posture) -> Search:
    """Lower the cost from a posture on target, without leaving it: a feasible path, each step corrected back.

    Between changes of the order of breakpoints everything is smooth. Steps end where the order changes, slide along,
    and cross where it is lower beyond.
    """
    if not goal.ranked:
        return Search(start, True, 0, 0)
    path, solver = _Path(goal, goal.cost(start)), goal.solver.descent
    here, step = start, 0.5 * solver.first_step
    for iteration in range(solver.improving_steps):
        cost = path.cost
        there, step = path.step(here, step)
        if there is None:
            there = path.across(here)
            step = 0.1 * solver.first_step
        if there is None:
            return Search(here, True, iteration, path.solves)
        here = there
        if cost - path.cost < 1e-7 * max(abs(path.cost), 1e-3) or goal.clock.over:
            return Search(here, True, iteration + 1, path.solves)
        step = min(1.8 * step, solver.first_step)
    return Search(here, True, solver.improving_steps, path.solves)


class _Path:
    """Postures on target with ever lower cost; counts the equilibria solved."""

    def __init__(self, goal: Goal, cost: float) -> None:
        self.goal, self.cost, self.solves = goal, cost, 0

    def step(self, here: Posture, step: float) -> tuple[Posture | None, float]:
        """The posture after a step that lowers the cost, None without one, and the length that a step may have."""
        goal = self.goal
        slope, residual = goal.slope(here), goal.residual(here)
        order = breakpoint_order(goal, here)
        limits, touched = order.kept(here.q, *goal.inequalities(here)), len(goal.touched)
        while step > 1e-4 and not goal.clock.over:
            chosen = _downhill(goal, here, (slope, residual), limits, step)
            if chosen is None or _length(goal, chosen.x) < 1e-7:
                return None, step
            trial = here.to(goal.space.clip(here.q + chosen.x))
            self.solves += 1
            if trial is not None:
                back = correct(goal, trial, slope, close=goal.solver.descent.tolerance, order=order)
                self.solves += back.solves
                if back.posture is not None and goal.cost(back.posture) < self.cost - 1e-9 * max(abs(self.cost), 1e-3):
                    self.cost = goal.cost(back.posture)
                    return back.posture, step
            step = 0.35 * min(step, _length(goal, chosen.x))
            if len(goal.touched) > touched:
                limits, touched = order.kept(here.q, *goal.inequalities(here)), len(goal.touched)
        return None, step

    def across(self, here: Posture) -> Posture | None:
        """The posture after a step beyond a change of order that holds the cost up; None where it rises beyond."""
        goal = self.goal
        for other in crossings(goal, here, goal.solver.order.short_section * goal.space.length):
            back = correct(goal, other, goal.slope(other), close=goal.solver.descent.tolerance).posture
            there = None if back is None else self.step(back, 0.1 * goal.solver.descent.first_step)[0]
            if there is not None:
                return there
        return None


def _downhill(
    goal: Goal, here: Posture, target: tuple[Array, Array], limits: tuple[Array, Array], step: float
) -> LeastSquares | None:
    (slope, residual), weight = target, goal.solver.descent.target_weight
    cost, right = goal.cost_rows(here, 1e-3)
    size = max(float(np.linalg.norm(right)), 1e-12)
    matrix = np.vstack([weight * slope, cost])
    rightmost = np.concatenate([-weight * residual, right])
    if size > 1e6:
        rightmost[len(residual) :] *= 1e6 / size
    return constrained_least_squares(matrix, rightmost, *boxed(goal, *limits, step))


@dataclass(frozen=True, eq=False)
class Correction:
    """A way back onto the target."""

    posture: Posture | None
    """On target; None where that leads nowhere or out of what is allowed."""
    slope: Array
    """As it was updated on the way."""
    solves: int
    """Equilibria."""


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
            return Correction(None, slope, solves)
        rows, bounds = goal.space.inequalities(at.q)
        if order is not None:
            rows, bounds = order.kept(at.q, rows, bounds)
        chosen = _towards(goal, slope, residual, rows, np.minimum(bounds, 0.0), goal.solver.descent.first_step)
        there = None if chosen is None else at.to(goal.space.clip(at.q + chosen.x))
        solves += 1
        if there is None:
            return Correction(None, slope, solves)
        new = goal.residual(there)
        if np.linalg.norm(new) > 0.5 * np.linalg.norm(residual) and not goal.reached(there, 1e-9, 1e-9):
            return Correction(None, slope, solves)
        slope = broyden(goal, slope, there.q - at.q, new - residual)
        at, residual = there, new
    return Correction(at if goal.allowed(at, SLACK) else None, slope, solves)


def broyden(goal: Goal, slope: Array, moved: Array, change: Array) -> Array:
    """The slope closest to `slope` that explains a change of the residual by a motion of the joints."""
    weighted = moved / goal.space.scale**2
    size = float(moved @ weighted)
    return slope if size <= 1e-20 else slope + np.outer(change - slope @ moved, weighted) / size


def millimetres(length: float) -> str:
    """A length (m) in mm, to three digits or whole."""
    size = length * TO_MM
    return f"{size:.3g} mm" if size < 1e3 else f"{size:.0f} mm"


def missed_by(goal: Goal, at: Posture) -> str:
    """In words, by how much a posture misses the target."""
    position, direction = goal.position_error(at), goal.direction_error(at)
    words = []
    if position > goal.solver.position_tolerance or not goal.pointed:
        words.append(f"{millimetres(position)} short")
    if goal.pointed and (direction > goal.solver.direction_tolerance or not words):
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
