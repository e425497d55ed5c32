"""Continuation of a branch of equilibria along a family of problems: joints move, a load grows, or both.

Natural-parameter continuation: `step_to` predicts along the tangent or the secant and corrects by Newton's method;
`follow` controls the step length. The step lengthens while Newton's method converges well and shortens towards a fold,
which the last margins predict.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.load import Load, between
from ..robots.robot import Robot
from ..solvers.settings import LARGEST_EXCHANGE, LARGEST_RATIO, LARGEST_SHIFT, LARGEST_TURN, LARGEST_TWIST, SOFT_TWIST
from ..typing import Array, Index
from .bundle import Bundled
from .member import AnyPoint, Loaded, Member, Point, Unloaded
from .problem import DEFAULT_DISCRETISATION, Discretisation
from .result import Equilibrium

P = TypeVar("P", bound=AnyPoint)


# Close to a fold the state moves by the square root of the distance to it: a fold is known to 1e-4 rad here.
SHORTEST_STEP = 1e-8
"""Fraction of a path or a load below which a failing step means that the branch has ended."""

SHARPEST_STEP = 1e-11
"""Smallest step fraction before the branch counts as ended without a fold or bifurcation: it may only bend sharply."""

# The margin (or its square) falls linearly only close to the end: a step of the whole distance often fails, and a
# failed step costs as much as a good one. With 0.8 five steps leave 0.03 % of the distance.
TOWARDS_END = 0.8
"""Fraction of the predicted distance to the end of a branch that one step covers."""

# At a bifurcation the change of the equations is orthogonal to the softest direction; differences leave 1e-6.
SYMMETRIC = 1e-5
"""Cosine between the change of the equations and the softest direction below which a branch ends in a bifurcation."""


def largest_twist(margin: float) -> float:
    """Largest change (rad) of the twist at a point in one step from an equilibrium of this margin.

    The twist changes by up to 1 / margin times as much as the joints do. Near a fold a step that is not short against
    the hysteresis ends on the branch beyond it, where Newton's method converges well, and the snap would be missed.
    """
    return min(max(2 * abs(margin) * LARGEST_TWIST, SOFT_TWIST), LARGEST_TWIST)


@dataclass(frozen=True, eq=False)
class SampledJointPath:
    """Straight path between joint values (2n,), rotations then translations, for fractions t in [0, 1]."""

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
        """Length of the path: largest rotation, rad, or translation over the longest tube."""
        return max(self._changes())

    @property
    def moves(self) -> bool:
        """True if joint values change."""
        return bool((self.start != self.end).any())

    @property
    def slides(self) -> bool:
        """True if translations change."""
        n = len(self.start) // 2
        return bool((self.start[n:] != self.end[n:]).any())

    def _changes(self) -> tuple[float, float]:
        """Largest change of a rotation, rad, and of a translation over the longest tube."""
        change, n = np.abs(self.end - self.start), len(self.start) // 2
        longest = max(tube.length for tube in self.robot.tubes)
        return float(change[:n].max()), float(change[n:].max()) / longest

    def events(self, cuts: ArrayLike = ()) -> list[float]:
        """Fractions of the path with coinciding breakpoints, or one at the plate or at `cuts` (m); the last is 1.

        The order of the breakpoints may change there.
        """
        if not self.slides or not self.robot.fixed_sections:
            return [1.0]
        n = len(self.start) // 2
        rates = self.end[n:] - self.start[n:]
        assembly = self.robot.assembly(self.start[n:])
        points, moved = np.array(assembly.breakpoints), rates[assembly.breakpoint_tubes]
        fixed = np.append(cuts, 0.0)
        ends = np.array([np.concatenate([each, fixed]) for each in (points, points + moved)])
        return _inner(meetings(ends).get(0))


def _inner(fractions: Array | None) -> list[float]:
    """Fractions inside of a path, and 1."""
    return [*(t for t in ([] if fractions is None else fractions.tolist()) if 1e-9 < t < 1 - 1e-9), 1.0]


def meetings(points: Array) -> dict[int, Array]:
    """Fractions between waypoints at which some of P points (T, P) coincide, by number of the waypoint.

    There the order of the sections changes, and with it the motion of the arm. Points closer than LENGTH_ROUND_OFF are
    one to the solver; meetings at the same time, except for round-off, are one fraction.
    """
    difference = points[:, :, None] - points[:, None, :]
    before, after = difference[:-1], difference[1:]
    result: dict[int, Array] = {}
    crossed = (before > LENGTH_ROUND_OFF) & (after < -LENGTH_ROUND_OFF)
    for k in np.flatnonzero(crossed.any((1, 2))):
        a = before[k][crossed[k]]
        passed = a - after[k][crossed[k]]
        order, distinct = np.argsort(a / passed), list[float]()
        for x, same in zip((a / passed)[order].tolist(), (LENGTH_ROUND_OFF / passed)[order].tolist(), strict=True):
            if not distinct or x - distinct[-1] > same:
                distinct.append(x)
        result[int(k)] = np.array(distinct)
    return result


def steps_along(robot: Robot, joints: Array) -> tuple[Array, Index]:
    """Joint values (S, 2n) after steps along rows (T, 2n), and the indices (T,) of the rows.

    Steps are those of `SampledJointPath.largest_step`, with one at each meeting of breakpoints.
    """
    n = joints.shape[1] // 2
    home = robot.assembly(robot.home_translations)
    moved = joints[:, n:] - robot.home_translations
    points = np.array(home.breakpoints) + moved[:, home.breakpoint_tubes]
    turn, shift = (np.abs(np.diff(part, axis=0)).max(1) for part in (joints[:, :n], joints[:, n:]))
    longest = LARGEST_SHIFT * max(tube.length for tube in robot.tubes)
    met = meetings(np.concatenate([points, np.zeros((len(joints), 1))], axis=1)) if robot.fixed_sections else {}
    rows = [joints[:1]]
    for k, step in enumerate((1 / np.maximum(np.maximum(turn / LARGEST_TURN, shift / longest), 1.0)).tolist()):
        fractions, t = list[float](), 0.0
        for event in _inner(met.get(k)):
            while t < event:
                t = event if t + step >= event - 1e-12 else t + step
                fractions.append(t)
        between = joints[k] + np.array(fractions)[:, None] * (joints[k + 1] - joints[k])
        rows.append(np.concatenate([between[:-1], joints[k + 1 : k + 2]]))
    return np.concatenate(rows), np.cumsum([len(part) for part in rows]) - 1


@dataclass(frozen=True, eq=False)
class Family:
    """Problems with one parameter t: from t = 0 to 1 joints move along a path, while one load changes into another.

    A load that grows from 0 may grow beyond t = 1.
    """

    path: SampledJointPath
    load: Load | None = None
    """Load at t = 1; None without a load at any t."""
    before: Load | None = None
    """Load at t = 0, or None."""

    @property
    def loads(self) -> tuple[Load | None, Load | None]:
        """Loads at t = 0 and t = 1."""
        return self.before, self.load

    @staticmethod
    def growing(member: Loaded) -> Family:
        """Family at constant joint values with t as the factor on the load of a problem."""
        joints = np.concatenate([member.rotations, member.translations])
        return Family(SampledJointPath(member.robot, joints, joints, member.discretisation), member.problem.load)

    def events(self) -> list[float]:
        """`SampledJointPath.events` of the path, also where a breakpoint passes a place where a load jumps."""
        return self.path.events(np.concatenate([np.zeros(0) if each is None else each.cuts() for each in self.loads]))

    def load_at(self, t: float) -> Load | None:
        """Load at t."""
        if self.load is None or t == 1 or self.before == self.load:
            return self.load
        return self.load.scaled(t) if self.before is None else between(self.before, self.load, t)

    def _factored(self, t: float) -> tuple[Load | None, float]:
        """Load at t as a constant load and a factor, if it grows from 0."""
        return (self.load, t) if self.before is None else (self.load_at(t), 1.0)

    def member(self, t: float, point: AnyPoint) -> Member[Any]:
        """Problem at t, for a solution near another one."""
        rotations, translations = self.path.at(t)
        shift, (load, factor) = tuple(translations.tolist()), self._factored(t)
        if isinstance(point.member, Bundled):
            # The start of the path may be an equilibrium of another robot.
            member = replace(point.member, robot=self.path.robot)
            return member.near(point, rotations, shift, load, factor)
        if load is None:
            return Unloaded.of(self.path.robot, rotations, shift, self.path.discretisation)
        return Loaded.of(self.path.robot, rotations, shift, load, self.path.discretisation, factor)

    def like(self, known: Member[Any], t: float) -> Member[Any] | None:
        """Problem at t with the unknowns of a known problem; None if the unknowns differ.

        None also beyond the ends of a path on which tubes translate: one may be out of its actuator there.
        """
        rotations, translations = self.path.at(t)
        if not 0.0 <= t <= 1.0 and self.path.slides:
            return None
        return known.with_inputs(rotations, tuple(translations.tolist()), *self._factored(t))

    def under_load(self, t: float) -> Loaded:
        """Problem at t under its full load, with factor 1; only for families with a load."""
        (rotations, translations), load = self.path.at(t), self.load_at(t)
        assert load is not None
        return Loaded.of(self.path.robot, rotations, tuple(translations.tolist()), load)

    def span(self) -> float:
        """Length of the path: largest rotation, rad, or relative translation; at least 1 if the load changes."""
        return max(self.path.span(), float(self.before != self.load))


@dataclass(frozen=True, eq=False)
class Milestone:
    """Equilibrium at t of a family."""

    t: float
    pose: Equilibrium


def step_to(family: Family, t: float, point: P, before: P | None = None) -> P | None:
    """Equilibrium at t on the branch of `point`, stable or not; None if the step is too long or the branch ends.

    Predictor: the tangent at `point`, or the secant from `before`. Corrector: Newton's method.
    """
    member = family.member(t, point)
    x = member.transfer(point)
    change = member.tangent(point)
    # Where only the load grows, the tangent costs one solve with the known Hessian. Where joints move, the secant of
    # the last two points is as good, and free.
    if change is not None:
        x = x + change
    elif before is not None and point.t > before.t:
        x = x + (x - member.transfer(before)) * ((t - point.t) / (point.t - before.t))
    # A guess on the branch converges in three to five steps; more than eight, or slow contraction, are a sign of
    # another branch.
    result = member.solve(x, iterations=8)
    if not result.converged:
        return None
    # Where ends pass each other the first iterations open a section, and say nothing about the branch.
    reorders = member.reorders(point, result.state)
    if result.contraction > LARGEST_RATIO and not reorders:
        return None
    # Newton's method may converge well to a neighbouring branch, but not within this distance.
    limit = largest_twist(point.margin)
    if reorders:
        limit = min(limit, LARGEST_EXCHANGE)
    if member.distance(point, result.state) > limit:
        return None
    return Point.of(member, result, t)  # type: ignore[return-value]


def follow(
    family: Family,
    start: P,
    goal: float = 1.0,
    *,
    stable: bool = True,
    shortest: float = SHORTEST_STEP,
) -> Iterator[P]:
    """Points of the branch after `start`, up to t = `goal` or to just before the branch ends.

    Args:
        stable: stop where the branch turns unstable, too.
        shortest: fraction of the path, or of the goal, below which a failed step means the end.
    """
    point, before = start, None
    step = longest = min(family.path.largest_step(), goal - start.t)
    min_step, near_end, power = shortest * max(1.0, abs(goal)), False, 0
    while point.t < goal:
        t = goal if point.t + step >= goal - 1e-12 * max(1.0, abs(goal)) else point.t + step
        point_next = step_to(family, t, point, before)
        if point_next is None or (stable and point_next.margin <= 0):
            # A first failure may be due to a long step. If a step up to a predicted bifurcation (power 1) fails, the
            # end is a fold (power 2). A third, not a half: where a branch ends, every failed step is wasted.
            step, near_end, power = step / 3, True, 2 if power else 0
            if step < min_step:
                return
            continue
        yield point_next
        point, before = point_next, point
        step = min(2 * step, longest)
        if near_end:
            power = max(power, 1)
            # The prediction is poor far from the end: it shortens one step to a twentieth at most.
            to_end = distance_to_end(point.t - before.t, before.margin, point.margin, power)
            step = min(step, max(TOWARDS_END * to_end, step / 20, min_step))


def distance_to_end(step: float, before: float, margin: float, power: int) -> float:
    """Distance in t to the point where the margin vanishes, from margins a step apart; infinity if the margin grows.

    margin^power falls linearly with t: the first power towards a bifurcation, the second towards a fold.
    """
    if not 0 < margin < before:
        return np.inf
    # m^p falls linearly: t_end - t = (t - t_0) m^p / (m_0^p - m^p).
    return step / ((before / margin) ** power - 1)


def reach(
    family: Family,
    start: P,
    goal: float = 1.0,
    *,
    stable: bool = True,
    shortest: float = SHORTEST_STEP,
) -> P:
    """Last point of `follow`; `start` where the branch ends at once."""
    return [start, *follow(family, start, goal, stable=stable, shortest=shortest)][-1]


class Equations(Protocol):
    """Residual (U,) and its Jacobian (U, U) at unknowns x (U,)."""

    @property
    def gradient(self) -> Array: ...
    @property
    def hessian(self) -> Array: ...


EquationsAt = Callable[[float], Callable[[Array], Equations] | None]
"""Function of the parameter t that returns the equations there, a function of x; None if their unknowns differ."""


class PathRates(NamedTuple):
    """Derivatives of the equations by the parameter t of a path, at constant unknowns."""

    gradient: Array
    """Derivative (U,) of the residual."""
    hessian: Array
    """Derivative (U, U) of its Jacobian."""


def path_rates(at: EquationsAt, x: Array, t: float, here: Equations | None = None) -> PathRates | None:
    """Derivatives at unknowns x (U,) by central differences; `here` are the equations at t.

    At the end of a path the equations may exist on one side only: the difference is one-sided. None if they exist on
    neither.
    """
    # The round-off 1e-16 / 1e-6 is far below SYMMETRIC.
    dt = 1e-6 * max(1.0, abs(t))
    sides = [(t_side, side(x)) for t_side in (t - dt, t + dt) if (side := at(t_side)) is not None]
    if len(sides) == 1 and here is not None:
        sides.append((t, here))
    if len(sides) < 2:
        return None
    (t_low, low), (t_high, high) = sides
    return PathRates(
        *((b - a) / (t_high - t_low) for a, b in ((low.gradient, high.gradient), (low.hessian, high.hessian)))
    )


def bifurcates(family: Family, last: AnyPoint) -> bool:
    """True if the branch ends in a bifurcation: w . g_t = 0 at its last point.

    w is the left null vector.

    At a fold w . g_t is not 0: the change of the equations pushes the robot along its softest direction.
    """

    def at(t: float) -> Callable[[Array], Equations] | None:
        member = family.like(last.member, t)
        return None if member is None else member.at

    rates = path_rates(at, last.state.x, last.t, last.state)
    if rates is None:
        return False
    g_t, w = rates.gradient, last.unresisted
    return bool(abs(w @ g_t) <= SYMMETRIC * np.linalg.norm(w) * np.linalg.norm(g_t))
