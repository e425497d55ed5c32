"""Planning for several robots: one after the other past those that rest, then as much at a time as they leave each
other room for.

Each robot in an order is planned for with the arms before it where they end, and those after it where they begin: one
after the other these motions are a plan for all. They are then let begin as early as the distance between moving arms
allows (motions on fixed paths, delayed: Akella and Hutchinson 2002), and all is proved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..bodies.obstacles import Obstacle
from ..bodies.placed import seen_from
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, vector
from ..inverse.arguments import checked_obstacles, kind_of
from ..inverse.clock import Clock
from ..inverse.outline import Outline
from ..solvers.parallel.blas import small
from ..typing import Array, Index
from .arms import (
    ArmsProof,
    PlacedRobot,
    at_rest,
    between_plates,
    called,
    checked_arms,
    of_arm,
    one_each,
    plate_of,
    verify_arms,
)
from .goals import TipGoal
from .motion import DEFAULT_RATES, RateLimits
from .options import DEFAULT_PLAN, PlanOptions
from .plan import plan_trajectory
from .trajectory import Trajectory

ORDERS = 6
"""Orders in which robots are planned for, at most, or as many as there are arms."""

DELAYS = 41
"""Delays that are tried for a robot, from none to when all before it have come to rest."""

INSTANTS, ALONG = 80, 64
"""Instants of a motion, and points along an arm, by which delays are told."""

ROOM = 3e-4
"""Distance (m) to spare between arms that move at a time, for what lies between instants and points; more is asked
where the proof finds a fault."""

SHARE_OF_ORDER = 0.5
"""Share of the time that is left which one order gets."""


@dataclass(frozen=True, eq=False)
class ArmsPlan(Displayed):
    """Motions of several robots on one clock, which keep away from each other.

    Attributes:
        arms: the robots, and where they stand.
        trajectories: one for each, in its own frame, its time (s) from when it begins to move; its obstacles are those
            that its path was planned past: with other arms at rest.
        order: numbers of arms, from 0, in which they were planned for.
        obstacles: in the frame that all share.   min_margin, min_clearance (m): what is kept.
        proof: of all of this.   seconds: that it took.
    """

    _brief = ("arms", "status", "order")

    arms: tuple[PlacedRobot, ...]
    trajectories: tuple[Trajectory, ...]
    order: tuple[int, ...]
    obstacles: tuple[Obstacle, ...]
    min_margin: float
    min_clearance: float
    proof: ArmsProof
    seconds: float

    @property
    def duration(self) -> float:
        """Until the last arm rests, s."""
        return max(float(each.time[-1]) for each in self.trajectories)

    @property
    def value(self) -> tuple[Trajectory, ...]:
        """The motions."""
        return self.trajectories

    @property
    def proved(self) -> bool:
        """Whether all of it is proved."""
        return self.proof.holds

    @property
    def status(self) -> str:
        """Whether it is proved, in words."""
        return "proved" if self.proved else "; ".join(self.proof.faults)

    def rows_at(self, t: float) -> tuple[int, ...]:
        """Of every trajectory the number of the sample next to a time, s."""
        return tuple(int(np.abs(each.time - t).argmin()) for each in self.trajectories)

    def clearance(self, times: ArrayLike) -> Array:
        """(T, pairs) distances between arms at times (T,), s, of ALONG points of either, m: the proof bounds what lies
        between them."""
        t = np.asarray(times, dtype=float)
        lines = [_Lines.of(arm, each).at_times(t) for arm, each in zip(self.arms, self.trajectories, strict=True)]
        every, pairs = np.arange(len(t)), combinations(range(len(self.arms)), 2)
        return np.stack([lines[i].gaps(lines[j], every, every) for i, j in pairs], axis=1)


@small
def plan_arms(
    arms: Sequence[PlacedRobot],
    starts: Sequence[Any],
    goals: Sequence[Any],
    *,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = 0.05,
    rate_limits: RateLimits = DEFAULT_RATES,
    options: PlanOptions = DEFAULT_PLAN,
) -> ArmsPlan:
    """Motions of several robots from equilibria to goals, each on one stable branch, none touching another; proved.

    Args:
        starts, goals: one for every arm, as in `plan_trajectory`; positions and directions of tips are in the frame
            that the arms share.
        obstacles: in that frame: every arm keeps `options.clearance` from them, and from all other arms.
        min_margin, rate_limits: of every arm.
        options: of the plan of each; the time limit is for all of it.

    Raises:
        InputError: as `plan_trajectory`; fewer than two arms, a roadmap or a force, which several arms do not have.
        SolveError: arms that are too close at their starts, or no motion of one arm past the others at rest was found,
            in no order that was tried: the message says for which.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> from tubeopt.bodies.frames import base_frame
        >>> robot = tubeopt.load_robot("configs/robots/crl_ctr.yaml")
        >>> arms = [tubeopt.PlacedRobot(robot, base_frame([x, 0, 0], [0, 0, 1])) for x in (-0.01, 0.01)]
        >>> rest = (np.zeros(3), [-0.02, -0.08, -0.09])
        >>> tubeopt.plan_arms(arms, [rest] * 2, [([0.5, 0, 0], rest[1]), rest]).proved
        True
    """
    known = checked_arms(arms)
    one_each("starts", starts, known)
    one_each("goals", goals, known)
    kind_of("options", options, PlanOptions)
    if options.roadmap is not None or options.max_force:
        raise InputError("roadmap and max_force are of one robot; a plan of several arms has none")
    clock, bodies = Clock(options.time_limit), checked_obstacles(obstacles)
    first = []
    for k, start in enumerate(starts):
        with of_arm(known, k):
            first.append(_start(known[k], start))
    _check_starts(known, first, options.clearance)
    goals = [_in_frame(arm, goal) for arm, goal in zip(known, goals, strict=True)]

    def planned(k: int, ends: Sequence[Equilibrium], limit: float) -> Trajectory:
        arm = known[k]
        others: list[Obstacle] = []
        for j, end in enumerate(ends):
            if j != k:
                others += [plate_of(known[j]), *at_rest(end, known[j].base)]
        asked: dict[str, Any] = {
            "obstacles": seen_from(arm.base, [*bodies, *others]),
            "min_margin": min_margin,
            "rate_limits": rate_limits,
            "options": replace(options, time_limit=limit),
        }
        with of_arm(known, k):
            return plan_trajectory(arm.robot, first[k], goals[k], **asked)

    order, motions = _one_by_one(known, first, planned, clock)
    proof = None
    for moved in _sooner(known, motions, order, options.clearance):
        motions = moved
        proof = verify_arms(
            known,
            motions,
            starts=first,
            obstacles=bodies,
            min_margin=min_margin - 1e-6,
            clearance=options.clearance,
            clock=clock,
        )
        if proof.holds or clock.over:
            break
    assert proof is not None
    return ArmsPlan(known, motions, order, bodies, min_margin, options.clearance, proof, clock.seconds)


def _start(arm: PlacedRobot, start: Any) -> Equilibrium:
    known = getattr(start, "equilibrium", start)
    if isinstance(known, Equilibrium):
        if known.robot != arm.robot:
            raise InputError(f"start of {arm.called} is an equilibrium of another robot")
        return known
    try:
        rotations, translations = start
    except (TypeError, ValueError):
        raise InputError(f"start of {arm.called} is {start!r}; it must be an equilibrium or joint values") from None
    return forward_kinematics(arm.robot, rotations, translations)


def _in_frame(arm: PlacedRobot, goal: Any) -> Any:
    """A goal of the tip as the arm's own plate has it; any other as it is."""
    if isinstance(goal, TipGoal):
        towards = goal.direction
        if towards is not None:
            towards = vector("direction of the goal", towards, 3, "x, y, z") @ arm.base.axes
        return TipGoal(arm.base.seen(goal.position), towards)
    joints = isinstance(goal, (tuple, list)) and len(goal) == 2
    if joints or hasattr(goal, "robot") or hasattr(goal, "equilibrium"):
        return goal
    return arm.base.seen(vector("goal", goal, 3, "x, y, z"))


def _check_starts(arms: Sequence[PlacedRobot], first: Sequence[Equilibrium], clearance: float) -> None:
    """Raise SolveError where two arms are too close before they move."""
    lines = [_Lines.at(arm, [e]) for arm, e in zip(arms, first, strict=True)]
    for i, j in combinations(range(len(arms)), 2):
        gap = min(float(lines[i].gaps(lines[j], np.array([0]), np.array([0]))[0]), between_plates(arms[i], arms[j]))
        if gap < clearance:
            raise SolveError(
                f"no plan exists: at their starts {called(arms, i)} and {called(arms, j)} are {gap * 1e3:.3g} mm "
                f"apart; they must keep {clearance * 1e3:g} mm"
            )


def _orders(n: int) -> list[tuple[int, ...]]:
    """Orders of n arms: first those in which each comes first, then others, `ORDERS` at least where there are."""
    turned = [tuple((k + j) % n for j in range(n)) for k in range(n)]
    return list(dict.fromkeys([*turned, *islice(permutations(range(n)), ORDERS)]))[: max(n, ORDERS)]


def _one_by_one(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    planned: Callable[[int, Sequence[Equilibrium], float], Trajectory],
    clock: Clock,
) -> tuple[tuple[int, ...], tuple[Trajectory, ...]]:
    """An order in which each arm gets past the others at rest, and the motions, each from time 0."""
    reasons: dict[str, None] = {}
    for order in _orders(len(arms)):
        limit = clock.part(SHARE_OF_ORDER)
        ends, found = list(first), dict[int, Trajectory]()
        for done, k in enumerate(order):
            if limit.over:
                break
            try:
                found[k] = planned(k, ends, limit.left / (len(order) - done))
            except SolveError as error:
                before = ", ".join(str(j + 1) for j in order[:done])
                when = f" after arm {before}" if before else ""
                reasons[f"{called(arms, k)}{when}: {error}"] = None
                break
            ends[k] = found[k].end
        else:
            return order, tuple(found[k] for k in range(len(arms)))
    told = "; ".join(reasons) or "time was over"
    raise SolveError(f"no plan was found for all arms, one after the other past those at rest: {told}")


def _sooner(
    arms: Sequence[PlacedRobot], motions: Sequence[Trajectory], order: Sequence[int], clearance: float
) -> Iterator[tuple[Trajectory, ...]]:
    """Motions on one clock, each begun as early as those before it in the order leave room; then with more room; at
    last one after the other."""
    lines = [_Lines.of(arm, motion) for arm, motion in zip(arms, motions, strict=True)]
    for room in (ROOM, 4 * ROOM, np.inf):
        begin: dict[int, float] = {}
        for k in order:
            latest = max((begin[j] + motions[j].time[-1] for j in begin), default=0.0)
            delays = np.linspace(0.0, latest, DELAYS)[:-1].tolist() if np.isfinite(room) else []
            begin[k] = next((at for at in delays if _clear(lines, k, at, begin, clearance + room)), latest)
        yield tuple(replace(each, time=each.time + begin[k]) for k, each in enumerate(motions))


def _clear(lines: Sequence[_Lines], k: int, at: float, begin: Mapping[int, float], room: float) -> bool:
    """Whether an arm that begins to move at a time keeps its distance from all that move by then."""
    return all(lines[k].clear_of(lines[j], at - begin[j]) >= room for j in begin)


@dataclass(frozen=True, eq=False)
class _Lines:
    """An arm at T instants in the frame that arms share: times (T,), s, points (T, P, 3) and radii (T, P), m."""

    time: Array
    points: Array
    radius: Array

    @staticmethod
    def at(arm: PlacedRobot, equilibria: Sequence[Equilibrium], time: Array | None = None) -> _Lines:
        """Those of equilibria."""
        told = []
        for e in equilibria:
            outline = Outline(e)
            told.append(outline.at(np.linspace(0.0, e.arc_length[-1], ALONG)))
        points = arm.base.placed(np.array([each for each, _ in told]))
        return _Lines(np.zeros(len(told)) if time is None else time, points, np.array([r for _, r in told]))

    @staticmethod
    def of(arm: PlacedRobot, motion: Trajectory) -> _Lines:
        """Those of a motion, at all of its samples."""
        return _Lines.at(arm, motion.arms, motion.time)

    def at_times(self, times: Array) -> _Lines:
        """The same at other times (T,), linear between instants, at rest before and after."""
        row = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 1)
        after = np.minimum(row + 1, len(self.time) - 1)
        step = np.where(after > row, self.time[after] - self.time[row], 1.0)
        share = np.clip((times - self.time[row]) / step, 0.0, 1.0)[:, None]
        parts = [
            a[row] + share.reshape(-1, *[1] * (a.ndim - 1)) * (a[after] - a[row]) for a in (self.points, self.radius)
        ]
        return _Lines(times, *parts)

    def gaps(self, other: _Lines, rows: Index, others: Index) -> Array:
        """(r,) distances between the surfaces of two arms at rows (r,) of either, m."""
        out = []
        for a, b in zip(rows, others, strict=True):
            away = np.linalg.norm(self.points[a][:, None] - other.points[b], axis=2)
            out.append((away - self.radius[a][:, None] - other.radius[b]).min())
        return np.array(out)

    def clear_of(self, other: _Lines, delay: float) -> float:
        """Least distance from an arm that moves too, m, if this one begins to move `delay` s after it."""
        end = max(self.time[-1] + delay, other.time[-1])
        times = np.linspace(min(delay, 0.0), end, INSTANTS)
        every = np.arange(len(times))
        return float(self.at_times(times - delay).gaps(other.at_times(times), every, every).min())
