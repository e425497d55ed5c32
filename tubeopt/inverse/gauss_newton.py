"""Gauss and Newton's method with inequalities, in a box that is trusted: the one descent of inverse kinematics.

    x = argmin |A x - b|^2 + |A' x - b'|^2   over motions x of the joints with  rows x >= bounds,  |x_k| <= size scale_k

Every iterate is a solved, stable equilibrium. A `Question` says what is made small (A, b are its half square near a
posture), what only guides the step (A', b'), what is kept, and how a step is brought back to what is kept. A step is
shortened until it gains part of what |A x - b|^2 promises. Derivatives differ to either side where breakpoints along
the arm coincide, so that a descent ends when both sides promise nothing, and nothing beyond the next change of their
order does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..solvers.quadratic import LeastSquares, constrained_least_squares
from ..typing import Array, Index
from .goal import Goal
from .order import SHORT_SECTION, crossings
from .posture import Posture

SLACK = 1e-9
"""Clearance (m) that may be missing by round-off."""

FIRST_STEP = 0.6
"""Largest change of a joint in the first step, and half of the largest later on, in units of the joints' scales."""

SHORTEST_STEP = 1e-5
"""Step, in units of the joints' scales, below which a descent ends: far above the round-off of an equilibrium, 1e-8."""

ENOUGH, FAITHFUL, SHORTER = 0.05, 0.7, 0.35
"""Parts of the promised decrease from which a step is taken, and from which the next may be twice as long; by how much
a step is shortened that is not taken."""


@dataclass(frozen=True, eq=False)
class Model:
    """What a question is near a posture, in motions x (m,) of the joints."""

    matrix: Array
    right: Array
    """A (r, m) and b (r,)."""
    guide: Array
    aim: Array
    """A' (g, m) and b' (g,): damping, or a target that all steps keep."""
    rows: Array
    bounds: Array
    """rows x >= bounds, (c, m) and (c,)."""

    def step(self, goal: Goal, size: float) -> LeastSquares | None:
        """The motion of every joint by at most `size` of its scale; None where none keeps the rows."""
        matrix, right = np.vstack([self.matrix, self.guide]), np.concatenate([self.right, self.aim])
        return constrained_least_squares(matrix, right, *boxed(goal, self.rows, self.bounds, size))

    def promised(self, x: Array) -> float:
        """Decrease of the half square by a motion."""
        gap = self.matrix @ x - self.right
        return 0.5 * float(self.right @ self.right - gap @ gap)


@dataclass(frozen=True, eq=False)
class Step:
    """A step that was taken."""

    model: Model
    x: Array
    active: Index
    """Numbers of the rows that held it, and after them of the sides of the box."""
    there: Posture
    value: float
    """There."""
    size: float
    """That the next step may have."""


class Question(Protocol):
    """What a descent makes small, and what it keeps."""

    @property
    def goal(self) -> Goal:
        """The target, what is kept, and the clock."""

    def value(self, at: Posture) -> float:
        """What is made small."""

    def least(self, value: float) -> float:
        """The decrease of a value that a step must promise."""

    def ended(self, at: Posture, values: Sequence[float]) -> bool:
        """Whether nothing more is wanted, with the values of all postures so far."""

    def model(self, at: Posture, side: int, last: Step | None) -> Model:
        """Near a posture, for translations that grow (side 1) or shrink (-1); after a step, where that was smooth."""

    def back(self, here: Posture, x: Array) -> Back:
        """The posture after a motion, brought back to what is kept."""

    def beyond(self, past: Posture) -> Posture | None:
        """The same of a posture beyond a change of the order of breakpoints."""


@dataclass(frozen=True, eq=False)
class Back:
    """A posture brought back to what is kept."""

    posture: Posture | None
    """None where it cannot be."""
    solves: int
    """Equilibria."""


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


class Descent:
    """Postures of ever less value, until no step brings what counts; counts steps, and equilibria solved.

    Args:
        size: of the first step, in units of the joints' scales.   steps, postures: at most.
    """

    def __init__(self, question: Question, size: float, steps: int, postures: float = np.inf) -> None:
        self.question, self.size, self.limits = question, size, (steps, postures)
        self.goal, self.steps, self.solves = question.goal, 0, 0

    def last(self, start: Posture) -> Posture:
        """The last posture of the descent from a start."""
        here, side, size = start, 1, self.size
        before: Step | None = None
        values = [self.question.value(here)]
        while not self._over and not self.question.ended(here, values):
            step = self._step(here, values[-1], size, side=side, last=before)
            if step is None and side > 0 and here.two_sided:
                side, size, before = -1, 0.5 * FIRST_STEP, None
                continue
            before = step if side > 0 else None
            step = step or self._across(here, values[-1])
            if step is None:
                break
            self.steps += 1
            here, size, side = step.there, step.size, 1
            values.append(step.value)
        return here

    @property
    def _over(self) -> bool:
        steps, postures = self.limits
        return self.steps >= steps or self.solves >= postures or self.goal.clock.over

    def _step(
        self, here: Posture, value: float, size: float, *, side: int = 1, last: Step | None = None
    ) -> Step | None:
        """The longest step tried that gains enough of what its model promises; None without one."""
        question, goal = self.question, self.goal
        model, touched, least = question.model(here, side, last), len(goal.touched), question.least(value)
        while size > SHORTEST_STEP and not goal.clock.over:
            chosen = model.step(goal, size)
            promised = 0.0 if chosen is None else model.promised(chosen.x)
            if chosen is None or promised <= least:
                return None
            back = question.back(here, chosen.x)
            self.solves += back.solves
            there = np.inf if back.posture is None else question.value(back.posture)
            if back.posture is not None and value - there >= ENOUGH * promised:
                size = min(2 * size, 2 * FIRST_STEP) if value - there >= FAITHFUL * promised else size
                return Step(model, chosen.x, chosen.active, back.posture, there, size)
            size = SHORTER * min(size, float(np.abs(chosen.x / goal.space.scale).max()))
            if len(goal.touched) > touched:  # bodies that the model did not know
                model, touched = question.model(here, side, last), len(goal.touched)
        return None

    def _across(self, here: Posture, value: float) -> Step | None:
        """A step from beyond a change of the order of breakpoints to less than here; None without one."""
        least = self.question.least(value)
        for past in crossings(self.goal, here, SHORT_SECTION * self.goal.space.length):
            back = self.question.beyond(past)
            if back is None:
                continue
            step = self._step(back, self.question.value(back), 0.1 * FIRST_STEP)
            if step is not None and step.value < value - least:
                return step
        return None


def boxed(goal: Goal, rows: Array, bounds: Array, size: float) -> tuple[Array, Array]:
    """The inequalities with a motion of every joint by at most `size` of its scale."""
    unit = np.diag(1 / goal.space.scale)
    most = np.full(2 * len(unit), -size)
    return np.vstack([rows, unit, -unit]), np.concatenate([bounds, most])
