"""Following a branch of equilibria along a family of problems: joints move, a load grows, or both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from ..robots.assembly import ROUND_OFF
from ..robots.load import Load, between
from ..robots.robot import Robot
from ..solvers.settings import LARGEST_RATIO, LARGEST_SHIFT, LARGEST_TURN, LARGEST_TWIST, SOFT_TWIST
from ..typing import Array, Index
from .member import Loaded, Member, Place, Point, Unloaded
from .problem import DEFAULT_DISCRETISATION, Discretisation
from .result import Equilibrium

P = TypeVar("P", bound=Place)

# A shift is compared with the length of the arm. Without this lower bound an arm of length zero, as at full retraction,
# could not move at all.
SHORT_ARM = 0.1
"""Length of an arm over that of the longest tube: in shorter arms tubes hardly couple."""


# The state moves by the square root of what is left of a path before a fold, so that a fold is found to 1e-4 rad here.
SHORTEST_STEP = 1e-8
"""Fraction of a path or a load below which a failing step means that the branch has ended."""

SHARPEST_STEP = 1e-11
"""The same where no fold and no bifurcation is found there: the branch may only bend sharply."""

# The margin (or its square) falls linearly only close to the end: a step of the whole distance often fails, and a
# failed step costs as much as a good one. With 0.8 five steps leave 0.03 % of the distance.
TOWARDS_END = 0.8
"""Fraction of the distance to where the margin seems to vanish that one step covers."""

# At a bifurcation the load (or the motion) does not push along the softest direction at all; differences leave 1e-6.
SYMMETRIC = 1e-5
"""Cosine between the push and the softest direction below which a branch ends in a bifurcation, not in a fold."""


def largest_twist(margin: float) -> float:
    """Largest change (rad) of the twist at a point in one step from an equilibrium of this margin.

    The twist changes by up to 1/margin times as much as the joints do. Near a fold a step that is not short against the
    hysteresis ends on the branch beyond it, where Newton is at ease, and the snap would pass unseen.
    """
    return min(max(2 * abs(margin) * LARGEST_TWIST, SOFT_TWIST), LARGEST_TWIST)


@lru_cache(maxsize=64)
def shortest_arm(robot: Robot) -> float:
    """Length (m) of an arm such that shifts which are small for it are small for every shorter one, be it of length
    zero."""
    return SHORT_ARM * max(tube.length for tube in robot.tubes)


def small_motion(turn: Array, shift: Array, length: float) -> bool:
    """Whether a motion is so small that one step of Newton from an arm of this length (m) stays on its branch."""
    turned, moved = (max(map(abs, by.tolist())) for by in (turn, shift))
    return bool(turned <= LARGEST_TURN and moved <= LARGEST_SHIFT * length)


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

    def largest_step(self) -> float:
        """Largest fraction of the path in one step."""
        turn, shift = self._changes()
        return 1.0 / max(turn / LARGEST_TURN, shift / LARGEST_SHIFT, 1.0)

    def span(self) -> float:
        """How far the joints go: largest turn, rad, or shift over the longest tube."""
        return max(self._changes())

    @property
    def moves(self) -> bool:
        """Whether joint values change."""
        return bool((self.start != self.end).any())

    @property
    def slides(self) -> bool:
        """Whether translations change."""
        n = len(self.start) // 2
        return bool((self.start[n:] != self.end[n:]).any())

    def _changes(self) -> tuple[float, float]:
        """Largest turn, rad, and shift over the longest tube."""
        change, n = np.abs(self.end - self.start), len(self.start) // 2
        longest = max(tube.length for tube in self.robot.tubes)
        return float(change[:n].max()), float(change[n:].max()) / longest

    def rows(self) -> list[Array]:
        """Joint values (2n,) of all steps: no longer than `largest_step`, and one at each of the `events`."""
        step, at, rows = self.largest_step(), 0.0, []
        for event in self.events():
            while at < event:
                at = event if at + step >= event - 1e-12 else at + step
                rows.append(np.concatenate(self.at(at)))
        return rows

    def events(self) -> list[float]:
        """Fractions, 1 included, where two breakpoints meet, or one meets the plate: there their order may change."""
        if not self.slides:
            return [1.0]
        n = len(self.start) // 2
        rates = self.end[n:] - self.start[n:]
        assembly = self.robot.assembly(self.start[n:])
        points = np.array([*assembly.breakpoints, 0.0])
        speeds = np.append(rates[assembly.breakpoint_tubes], 0.0)
        # Points p + v t and q + w t meet at t = (p - q) / (w - v); the plate is a point at rest.
        gap, closing = points[:, None] - points, speeds - speeds[:, None]
        moving = np.abs(closing) > ROUND_OFF
        # Tubes that move with equal speed never meet.
        times = gap[moving] / closing[moving]
        return [*sorted({round(float(t), 12) for t in times if 1e-9 < t < 1 - 1e-9}), 1.0]


def steps_along(robot: Robot, joints: Array) -> tuple[Array, Index]:
    """The rows of joint values (T, 2n) with `JointPath.rows` between them (S, 2n), and where the rows (T,) are among
    them."""
    n = joints.shape[1] // 2
    home = robot.assembly(robot.home_translations)
    moved = joints[:, n:] - robot.home_translations
    points = np.array(home.breakpoints) + moved[:, home.breakpoint_tubes]
    points = np.concatenate([points, np.zeros((len(joints), 1))], axis=1)
    order = np.sign(points[:, :, None] - points[:, None])
    # A sign that changes is a pair that passed; one that becomes 0 is a meeting at the row itself.
    meet = (order[1:] * order[:-1] < 0).any((1, 2))
    turn, shift = (np.abs(np.diff(part, axis=0)).max(1) for part in (joints[:, :n], joints[:, n:]))
    longest = LARGEST_SHIFT * max(tube.length for tube in robot.tubes)
    several = meet | (turn > LARGEST_TURN) | (shift > longest)
    rows = [joints[:1]]
    for k, split in enumerate(several.tolist()):
        rows.append(np.array(JointPath(robot, joints[k], joints[k + 1]).rows()) if split else joints[k + 1 : k + 2])
    return np.concatenate(rows), np.cumsum([len(part) for part in rows]) - 1


@dataclass(frozen=True, eq=False)
class Family:
    """Problems that depend on one number t: from t = 0 to 1 the joints move along a path while one load becomes
    another; a load that grows from none may grow on."""

    path: JointPath
    load: Load | None = None
    """At t = 1; None where there is none at any t."""
    before: Load | None = None
    """At the start; None is no load."""

    @property
    def loads(self) -> tuple[Load | None, Load | None]:
        """At the start and at the end."""
        return self.before, self.load

    @staticmethod
    def growing(member: Loaded) -> Family:
        """The load of a problem grows from nothing where the joints are: t is the factor on it."""
        here = np.concatenate([member.rotations, member.translations])
        return Family(JointPath(member.robot, here, here, member.discretisation), member.problem.load)

    def load_at(self, t: float) -> Load | None:
        """The load at t."""
        if self.load is None or t == 1 or self.before == self.load:
            return self.load
        return self.load.scaled(t) if self.before is None else between(self.before, self.load, t)

    def _factored(self, t: float) -> tuple[Load | None, float]:
        """The load at t as a load and a factor on it: of one that grows from none, only the factor changes."""
        return (self.load, t) if self.before is None else (self.load_at(t), 1.0)

    def member(self, t: float) -> Member[Any]:
        """The problem at t."""
        rotations, translations = self.path.at(t)
        shift, (load, factor) = tuple(translations.tolist()), self._factored(t)
        if load is None:
            return Unloaded.of(self.path.robot, rotations, shift, self.path.discretisation)
        return Loaded.of(self.path.robot, rotations, shift, load, self.path.discretisation, factor)

    def like(self, known: Member[Any], t: float) -> Member[Any] | None:
        """The problem at t with the same unknowns as a known one; None where it has others, or where the arm is beyond
        the ends of the path, where a tube may be out of its actuator."""
        rotations, translations = self.path.at(t)
        if not 0.0 <= t <= 1.0 and self.path.slides:
            return None
        return known.beside(rotations, tuple(translations.tolist()), *self._factored(t))

    def under_load(self, t: float) -> Loaded:
        """The problem at t, where there is a load, under the whole of it."""
        (rotations, translations), load = self.path.at(t), self.load_at(t)
        assert load is not None
        return Loaded.of(self.path.robot, rotations, tuple(translations.tolist()), load)

    def span(self) -> float:
        """How far the joints go: largest turn, rad, or shift over the longest tube; at least 1 where the load
        changes."""
        return max(self.path.span(), float(self.before != self.load))


@dataclass(frozen=True, eq=False)
class Milestone:
    """An equilibrium at t of a family."""

    t: float
    pose: Equilibrium


def step_to(family: Family, t: float, point: P, before: P | None = None) -> P | None:
    """The equilibrium at t on the branch of `point`, stable or not; None where Newton's method is not at ease.

    The guess is that it goes on changing along the tangent, or else as it did from `before` to `point`.
    """
    there = family.member(t)
    x = there.carried(point)
    change = there.tangent(point)
    # Where only the load grows, the tangent costs one solve with the known Hessian. Where joints move, the secant of
    # the last two points is as good, and free.
    if change is not None:
        x = x + change
    elif before is not None and point.t > before.t:
        # Secant through both last points, for a step of another length.
        x = x + (x - there.carried(before)) * ((t - point.t) / (point.t - before.t))
    # A guess that is on the branch converges in three to five steps; more than eight are a sign of another branch.
    result = there.solve(x, iterations=8)
    if not result.converged or result.contraction > LARGEST_RATIO:
        return None
    # Newton's method may converge well to a neighbouring branch: only a short way from the last point is the same
    # branch.
    if there.moved(point, result.state) > largest_twist(point.margin):
        return None
    return Point.of(there, result, t)  # type: ignore[return-value]


def follow(
    family: Family,
    start: P,
    goal: float = 1.0,
    *,
    stable: bool = True,
    shortest: float = SHORTEST_STEP,
) -> Iterator[P]:
    """Points of the branch after `start`, up to t = `goal`, or to just before it ends (if `stable`, turns unstable),
    where steps of part `shortest` fail."""
    here, before = start, None
    step = longest = min(family.path.largest_step(), goal - start.t)
    least, ends, power = shortest * max(1.0, abs(goal)), False, 0
    while here.t < goal:
        t = goal if here.t + step >= goal - 1e-12 * max(1.0, abs(goal)) else here.t + step
        there = step_to(family, t, here, before)
        if there is None or (stable and there.margin <= 0):
            # The first failure may be that of a long step; one of a step to before a bifurcation tells of a fold.
            # A third, not a half: where a branch ends, every failed step is wasted.
            step, ends, power = step / 3, True, 2 if power else 0
            if step < least:
                return
            continue
        yield there
        here, before = there, here
        step = min(2 * step, longest)
        if ends:
            power = max(power, 1)
            # The prediction is poor far from the end: one step is not shortened to less than a twentieth by it.
            step = min(step, max(TOWARDS_END * _left(here, before, power), step / 20, least))


def _left(here: Place, before: Place, power: int) -> float:
    """How far ahead of `here`, in t, the margin vanishes; infinity where it grows.

    A power of the margin falls linearly with t: the first power towards a bifurcation, the second towards a fold.
    """
    if not 0 < here.margin < before.margin:
        return np.inf
    # m^p falls linearly: t_end - t = (t - t_0) m^p / (m_0^p - m^p).
    return (here.t - before.t) / ((before.margin / here.margin) ** power - 1)


def reach(
    family: Family,
    start: P,
    goal: float = 1.0,
    *,
    stable: bool = True,
    shortest: float = SHORTEST_STEP,
) -> P:
    """The last point of `follow`; `start` where the branch ends at once."""
    return [start, *follow(family, start, goal, stable=stable, shortest=shortest)][-1]


def bifurcates(family: Family, last: Place) -> bool:
    """Whether what changes along a family does not push along the softest direction of a point close to the end of its
    branch."""
    # A central difference of the gradient, whose round-off 1e-16 / 1e-6 is far below SYMMETRIC.
    by = 1e-6 * max(1.0, abs(last.t))
    point = [there for t in (last.t - by, last.t + by, last.t) if (there := family.like(last.member, t)) is not None]
    if len(point) < 2:
        return False
    one, other = (there.at(last.state.x).gradient for there in point[:2])
    pull = other - one
    soft = last.unresisted
    return bool(abs(soft @ pull) <= SYMMETRIC * np.linalg.norm(soft) * np.linalg.norm(pull))
