"""Gauss and Newton's method with inequalities, in a box that is trusted: the one descent of inverse kinematics.

    x = argmin |A x - b|^2 + |A' x - b'|^2   over motions x of the joints with  rows x >= bounds,  |x_k| <= size scale_k

Every iterate is a solved, stable equilibrium. A `Question` says what is made small (A, b are its half square near a
posture), what only guides the step (A', b'), what is kept, and how a step is brought back to what is kept. A step is
shortened until it gains part of what |A x - b|^2 promises. Derivatives differ to either side where breakpoints along
the arm coincide, so that a descent ends when both sides promise nothing, and nothing beyond the next change of their
order does.

`reach` brings the tip to the target and out of any obstacle, `improve` then moves in what the target leaves free.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy

from ..files.units import TO_MM
from ..robots.assembly import Assembly
from ..solvers.quadratic import LeastSquares, constrained_least_squares
from ..typing import Array, Index
from .arm_surface import MOST_CONTACTS
from .goal import DIRECTION_TOLERANCE, POSITION_TOLERANCE, Goal
from .posture import Posture

# Ten times the distance at which a target counts as met: breakpoints that are closer make no difference to an answer.
CLOSED_SECTION = 1e-7
"""Length, m, of a section between breakpoints that counts as none."""

# Derivatives hold up to the end of a section only. On an arm of 200 mm one of 20 um stops a step so soon that a
# descent looks converged although the next order of breakpoints leads on.
SHORT_SECTION = 1e-4
"""Length of a section, as a share of the robot's length, that may block a step like a closed one."""

# More than CLOSED_SECTION (2 um against 0.1 um on an arm of 200 mm), or the first step beyond a change of order would
# close the section again and lead back.
MOVED_PAST = 1e-5
"""Distance that breakpoints are moved past each other, as a share of the robot's length."""


@dataclass(frozen=True, eq=False)
class Order:
    """The order of breakpoints at translations d (G,) of the carriages, as numbers."""

    length: Array
    """(P,) of the pieces at translations 0, m."""
    length_slope: Array
    """(P, G) of the lengths, which are length + slope d."""
    rows: Array
    """(c, G) rows d >= bound keeps the order: of breakpoints, which may be another one, then of the tubes."""
    bound: Array
    """(c,) m."""
    changeable: int
    """Rows of the order of breakpoints."""

    def kept(self, q: Array, rows: Array, bounds: Array) -> tuple[Array, Array]:
        """Rows and bounds of a step from joint values q (m,), with those that keep the order of breakpoints."""
        own = np.zeros((self.changeable, len(q)))
        own[:, len(q) - self.rows.shape[1] :] = self.rows[: self.changeable]
        gap = np.minimum(self.bound[: self.changeable] - own @ q, 0.0)
        return np.vstack([rows, own]), np.concatenate([bounds, gap])

    def closed(self, shift: Array, section: float) -> list[tuple[Array, float]]:
        """Changes of the order that are next: rows and bounds that translations (G,) keep by no more than `section`."""
        gap = self.rows[: self.changeable] @ shift - self.bound[: self.changeable]
        return [(self.rows[k], float(self.bound[k])) for k in np.flatnonzero(gap <= section)]


def breakpoint_order(goal: Goal, at: Posture) -> Order:
    """The order of breakpoints of a posture."""
    space, problem = goal.space, at.problem
    n, groups = space.robot.n_tubes, len(space.carriages)
    assembly, shift = problem.assembly, at.q[n:]
    marks = [(0.0, np.zeros(groups))]
    rows, bound = [], []
    for k, tubes in enumerate(space.carriages):
        unit = np.eye(groups)[k]
        for s in _breakpoints(assembly, tubes):
            if s > 0:
                marks.append((s, unit))
            else:
                rows.append(-unit)
                bound.append(float(s - shift[k]))
    marks.sort(key=lambda mark: mark[0])
    place = np.array([mark[0] for mark in marks])
    slope = np.array([mark[1] for mark in marks])
    cuts = np.append(assembly.start, assembly.total_length)
    owner = slope[np.abs(place[:, None] - cuts).argmin(0)]
    section = np.diff(owner, axis=0)
    counts = np.bincount(problem.mesh.section, minlength=assembly.n_sections)
    length_slope = (section / counts[:, None])[problem.mesh.section]
    for first, second, row in zip(place[:-1], place[1:], np.diff(slope, axis=0), strict=True):
        if row.any():
            rows.append(row)
            bound.append(float(row @ shift - (second - first)))
    length = problem.mesh.length - length_slope @ shift
    rows, bound, changeable = [*rows, *space.rows[:, n:]], [*bound, *space.least], len(bound)
    return Order(length, length_slope, np.reshape(rows, (-1, groups)), np.array(bound), changeable)


def _breakpoints(assembly: Assembly, tubes: tuple[int, ...]) -> list[float]:
    """Transitions, ends, and places where pieces meet, of the tubes of one carriage, each place once."""
    mine = list(tubes)
    ends, transitions = assembly.end[mine], assembly.transition[mine]
    bent = ends - transitions > 1e-12
    joints = zip(assembly.breakpoints, assembly.breakpoint_tubes, strict=True)
    cuts = [s for s, i in joints if i in mine] if assembly.general else []
    return sorted({round(float(s), 12) for s in [*ends, *transitions[bent], *cuts]})


def apart(goal: Goal, at: Posture) -> Posture:
    """The posture with breakpoints that coincide moved apart a little, where the limits allow."""
    space = goal.space
    n = space.robot.n_tubes
    # A step of its own for each carriage: with equal ones breakpoints that coincide would stay together.
    step = MOVED_PAST * space.length * np.arange(1, len(space.carriages) + 1)[::-1]
    place = np.sort(np.append([s for g in space.carriages for s in _breakpoints(at.problem.assembly, g)], 0.0))
    if (np.diff(place) > CLOSED_SECTION).all():
        return at
    for sign in (1.0, -1.0):
        q = at.q.copy()
        q[n:] += sign * step
        if space.admissible(q):
            moved = at.to(q)
            if moved is not None:
                return moved
    return at


def crossings(goal: Goal, at: Posture, section: float) -> Iterator[Posture]:
    """The posture beyond every change of the order that a section of no more than this (m) keeps it from."""
    return beyond(goal, at, breakpoint_order(goal, at).closed(at.q[goal.space.robot.n_tubes :], section))


def beyond(goal: Goal, at: Posture, crossed: Sequence[tuple[Array, float]]) -> Iterator[Posture]:
    """The posture with breakpoints moved past each other, for each pair (row, bound) of an `Order` for which the limits
    allow it."""
    space = goal.space
    n = space.robot.n_tubes
    for row, bound in crossed:
        q = at.q.copy()
        past = max(float(row @ at.q[n:] - bound), 0.0) + 2 * MOVED_PAST * space.length
        # The shortest motion of the carriages that takes the row past its bound.
        q[n:] -= past * row / float(row @ row)
        q = space.clip(q)
        if not space.admissible(q):
            continue
        moved = at.to(q)
        if moved is not None and moved.margin >= goal.floor:
            yield moved


SLACK = 1e-9
"""Clearance (m) that may be missing by round-off."""

# Measured on 80 targets of two robots, of which 79 are reached: half takes 0.94 times as many equilibria, twice 0.99
# times.
FIRST_STEP = 0.6
"""Largest change of a joint in the first step, and half of the largest later on, in units of the joints' scales."""

SHORTEST_STEP = 1e-5
"""Step, in units of the joints' scales, below which a descent ends: far above the round-off of an equilibrium, 1e-8."""

# Those of trust-region methods: Nocedal and Wright, Numerical Optimization (2006), algorithm 4.1, have 0 to 1/4, 3/4
# and 1/4.
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
                # Where a section is closed, derivatives differ to either side: the other side may still descend.
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
            # Short, since the next change of order may be as close as this one was.
            step = self._step(back, self.question.value(back), 0.1 * FIRST_STEP)
            if step is not None and step.value < value - least:
                return step
        return None


def boxed(goal: Goal, rows: Array, bounds: Array, size: float) -> tuple[Array, Array]:
    """The inequalities with a motion of every joint by at most `size` of its scale."""
    unit = np.diag(1 / goal.space.scale)
    most = np.full(2 * len(unit), -size)
    return np.vstack([rows, unit, -unit]), np.concatenate([bounds, most])


ON_TARGET = 1e-10
"""Distance (m) and angle (rad) at which the descent stops: a hundredth of what an answer may miss by, so that solving
again on a finer mesh leaves it an answer."""

LEAST_PROMISE = 1e-7
"""Relative decrease of what is left to the target that a step must promise."""

# Steps past a kink gain little, and the next ones more. On the same targets 2 and 10 in place of 5 change the number
# of equilibria by 2 % at most.
PATIENCE, STAGNANT = 5, 0.97
"""Steps in a row that together must bring the tip closer than this share of its distance."""

# Twice as many as lead to the target. Margin and curvature, of which only gradients are known, are lowered by steepest
# descent, which converges linearly and uses most of these steps.
IMPROVING_STEPS = 60
"""Maximum number of steps that lower the cost of a solution on target."""

# The weight takes the place of an equality in the quadratic program. Squared, 1e8, it leaves the cost eight of the
# sixteen digits of a double, and the target a miss of 1e-8 of the step, which `correct` takes away.
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
    # Far from the target the box limits the step, so that the damping is capped. 1e-14 keeps the matrix regular on
    # target.
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
        # Close to the target each step gains far more: less means that the motion before was too long.
        if np.linalg.norm(new) > 0.5 * np.linalg.norm(residual) and not goal.reached(there, 1e-9, 1e-9):
            return Correction(None, solves, slope)
        slope = broyden(slope, there.q - at.q, new - residual, goal.space.scale)
        at, residual = there, new
    return Correction(at if goal.allowed(at, SLACK) else None, solves, slope)


def broyden(slope: Array, moved: Array, change: Array, scale: Array | float = 1.0) -> Array:
    """Broyden's update (r, m): the slope closest to `slope`, in units of `scale`, that explains a change (r,) of the
    residual by a motion (m,)."""
    # The least rank-one change in the metric of the joints' scales (Broyden 1965).
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
    # Karush, Kuhn and Tucker: multipliers are not negative. Least squares, since a search ends near a minimum only.
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
