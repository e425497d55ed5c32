"""Following a branch of equilibria along a straight path of joint values, up to the fold where it ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.reduced import ReducedProblem, to_unknowns
from ..robots.assembly import ROUND_OFF
from ..robots.robot import Robot
from ..solvers.newton import newton
from ..solvers.settings import CONTINUATION
from ..typing import Array
from .solving import DEFAULT_DISCRETISATION, Discretisation, Solution, reduced_problem

SHORT_ARM = 0.1
"""Length of an arm, over that of the longest tube, up to which its tubes hardly couple."""


def largest_twist(margin: float) -> float:
    """Largest change (rad) of the twist at a point in one step from an equilibrium of this margin.

    The twist changes by up to 1/margin times as much as the joints do. Near a fold a step that is not short against the
    hysteresis ends on the branch beyond it, where Newton is at ease, and the snap would pass unseen.
    """
    return min(max(2 * abs(margin) * CONTINUATION.largest_twist, CONTINUATION.soft_twist), CONTINUATION.largest_twist)


@lru_cache(maxsize=64)
def shortest_arm(robot: Robot) -> float:
    """Length (m) of an arm such that shifts which are small for it are small for every shorter one, be it of length
    zero."""
    return SHORT_ARM * max(tube.length for tube in robot.tubes)


def small_motion(turn: Array, shift: Array, length: float) -> bool:
    """Whether a motion is so small that one step of Newton from an arm of this length (m) stays on its branch."""
    farthest = CONTINUATION.largest_shift * length
    turned, moved = turn.tolist(), shift.tolist()
    return all(abs(by) <= CONTINUATION.largest_turn for by in turned) and all(abs(by) <= farthest for by in moved)


@dataclass(frozen=True, eq=False)
class JointPath:
    """The straight path from `start` to `end`, (2n,) rotations then translations, for fractions t in [0, 1]."""

    robot: Robot
    start: Array
    end: Array
    discretisation: Discretisation = DEFAULT_DISCRETISATION

    def at(self, t: float) -> tuple[Array, Array]:
        """Rotations and translations at fraction t."""
        joint = self.end if t == 1.0 else self.start + t * (self.end - self.start)
        n = len(joint) // 2
        return joint[:n], joint[n:]

    def problem(self, t: float) -> ReducedProblem:
        """The reduced problem at fraction t."""
        return reduced_problem(self.robot, tuple(self.at(t)[1].tolist()), self.discretisation)

    def largest_step(self) -> float:
        """Largest fraction of the path in one step."""
        turn, shift = self._changes()
        return 1.0 / max(turn / CONTINUATION.largest_turn, shift / CONTINUATION.largest_shift, 1.0)

    def span(self) -> float:
        """How far the joints go: largest turn, rad, or shift over the longest tube."""
        return max(self._changes())

    def _changes(self) -> tuple[float, float]:
        """Largest turn, rad, and shift over the longest tube."""
        change, n = np.abs(self.end - self.start), len(self.start) // 2
        longest = max(tube.length for tube in self.robot.tubes)
        return float(change[:n].max()), float(change[n:].max()) / longest

    def events(self) -> list[float]:
        """Fractions, 1 included, at which the order of breakpoints may change: two meet, or one meets the plate."""
        n = len(self.start) // 2
        rates = self.end[n:] - self.start[n:]
        if not rates.any():
            return [1.0]
        assembly = self.robot.assembly(self.start[n:])
        points = np.array([*assembly.breakpoints, 0.0])
        speeds = np.append(rates[assembly.breakpoint_tubes], 0.0)
        gap, closing = points[:, None] - points, speeds - speeds[:, None]
        moving = np.abs(closing) > ROUND_OFF
        times = gap[moving] / closing[moving]
        return [*sorted({round(float(t), 12) for t in times if 1e-9 < t < 1 - 1e-9}), 1.0]


@dataclass(frozen=True, eq=False)
class Point:
    """A solved equilibrium at fraction t of a path."""

    t: float
    solution: Solution


def solve_at(path: JointPath, t: float, near: Point, before: Point | None = None) -> Point | None:
    """The equilibrium at fraction t on the branch of `near`, or None where Newton is not at ease.

    The guess is that the twist goes on changing as it did from `before` to `near`.
    """
    problem = path.problem(t)
    rotations = path.at(t)[0]
    twist = _twist(near, problem.arc_length)
    if before is not None and near.t > before.t:
        rate = (twist - _twist(before, problem.arc_length)) * ((t - near.t) / (near.t - before.t))
        twist = twist + np.clip(rate, -CONTINUATION.largest_twist, CONTINUATION.largest_twist)
    guess = rotations + twist
    result = newton(problem, rotations, to_unknowns(problem, rotations, guess), iterations=8)
    if not result.converged or result.contraction > CONTINUATION.largest_ratio:
        return None
    # Only the coupled tubes: theta of the others is carried along, not solved for.
    change = (result.state.theta - rotations - _twist(near, problem.arc_length)).ravel()[problem.flat]
    if np.abs(change).max(initial=0.0) > largest_twist(near.solution.margin):
        return None
    return Point(t, Solution.of(problem, rotations, result))


def _twist(point: Point, arc_length: Array) -> Array:
    """theta - alpha (len(arc_length), n); at its own points, of the coupled tubes only."""
    solution = point.solution
    if arc_length is solution.problem.arc_length:
        return np.asarray(solution.result.state.theta - solution.rotations)
    if not len(solution.problem.mesh.length):  # nothing twists an arm of length zero
        return np.zeros((len(arc_length), len(solution.rotations)))
    return arms.interpolate(solution.problem, solution.arm, arc_length) - solution.rotations


def follow_to(path: JointPath, start: Point, goal: float, *, stable: bool = True) -> tuple[list[Point], bool]:
    """Points of the branch from `start` up to fraction `goal`, or to just before it ends (if `stable`, turns unstable).

    Returns the points after `start`, and whether the goal was reached.
    """
    points: list[Point] = []
    longest = path.largest_step()
    here, before, step = start, None, longest
    while here.t < goal:
        t = goal if here.t + step >= goal - 1e-12 else here.t + step
        there = solve_at(path, t, here, before)
        if there is None or (stable and there.solution.margin <= 0):
            step /= 4 if there is None else 2
            if step < CONTINUATION.shortest_step:
                return points, False
            continue
        points.append(there)
        here, before = there, here
        step = min(2 * step, longest)
    return points, True
