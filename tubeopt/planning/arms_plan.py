"""Planning for several robots: one after the other past those that rest, then as much at a time as they leave each
other room for.

Each robot in an order is planned for with the arms before it where they end, and those after it where they begin: one
after the other these motions are a plan for all. Where no order has one, those that come later first make way: they
withdraw, and go on from there when it is their turn. Motions are then let begin as early as the distance between moving
arms allows (on fixed paths, delayed: Akella and Hutchinson 2002), and all is proved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations, islice, permutations
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.anatomy import seen_from
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, instance
from ..files.field_metadata import form, unit
from ..inverse.clock import Clock
from ..inverse.joints import joint_space, shift_of
from ..solvers.blas import small
from ..solvers.time_limit import LEAST_SECONDS
from ..typing import Array
from .arms import (
    ArmsProof,
    Lines,
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
from .goals import check_goal, goal_seen, start_equilibrium
from .motion import DEFAULT_RATES, RateLimits
from .plan import plan_trajectory
from .question import DEFAULT_PLAN, PlanOptions
from .trajectory import Trajectory

# Steps of a fortieth of the longest wait.
DELAYS = 41
"""Delays tried for a robot, from none to the rest of all earlier ones."""

# What happens between two instants is covered by ROOM, and then by the proof.
INSTANTS, POINTS = 80, 64
"""Instants of a motion, and points per arm, that determine delays."""

# The first value is enough for slow motions; four times that is tried next, and then no overlap at all.
ROOM = 3e-4
"""Reserve of the distance between moving arms, m, for the error between instants and points."""

# A capsule is thicker than the arm by its sagitta: 10 um for a curvature of 20 per m.
REST_CHORD = 2e-3
"""Longest piece of an arm at rest that is taken as straight, m."""

Move = tuple[int, Trajectory]
"""Of an arm, from time 0."""


@dataclass(frozen=True, eq=False)
class ArmsPlan(Displayed):
    """Motions of several robots on one clock, which keep away from each other."""

    _brief = ("arms", "status", "order")

    arms: tuple[PlacedRobot, ...]
    """The robots, and where they stand."""
    trajectories: tuple[Trajectory, ...]
    """One for each, in its own frame, its time (s) from when it begins to move; its obstacles are those that its path
    was planned past: with other arms at rest."""
    order: tuple[int, ...]
    """Numbers of arms, from 0, in which they were planned for."""
    obstacles: tuple[Obstacle, ...]
    """Obstacles in the shared frame."""
    min_margin: float
    """Smallest allowed margin."""
    min_clearance: float
    """Required clearance, m."""
    proof: ArmsProof
    """Proof of all motions together."""
    seconds: Annotated[float, unit("s"), form(".1f", label="run time"), "run time of planning and proof"]
    withdrawn_first: tuple[int, ...] = ()
    """Arms that first withdraw. Their trajectories have two parts with rest in between; the proof covers both."""

    @property
    def duration(self) -> float:
        """Time until the last arm rests, s."""
        return max(float(each.time[-1]) for each in self.trajectories)

    @property
    def value(self) -> tuple[Trajectory, ...]:
        """The trajectories."""
        return self.trajectories

    @property
    def proved(self) -> bool:
        """True if everything is proved."""
        return self.proof.holds

    @property
    def status(self) -> str:
        """Whether everything is proved, as a sentence."""
        return "proved" if self.proved else "; ".join(self.proof.faults)

    def rows_at(self, t: float) -> tuple[int, ...]:
        """Index of the sample nearest to a time (s), for every trajectory."""
        return tuple(int(np.abs(each.time - t).argmin()) for each in self.trajectories)

    def clearance(self, times: ArrayLike) -> Array:
        """Required clearance, m."""
        t = np.asarray(times, dtype=float)
        lines = [_moving(arm, each).at_times(t) for arm, each in zip(self.arms, self.trajectories, strict=True)]
        return np.stack([one.gaps(other) for one, other in combinations(lines, 2)], axis=1)


@typed
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
            in no order that was tried, nor with later arms withdrawn before: the message says for which.

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
    instance("options", options, PlanOptions)
    if options.roadmap is not None or options.max_force:
        raise InputError("roadmap and max_force are given; they are supported for plans of one robot only")
    clock, bodies = Clock(options.time_limit), checked_obstacles(obstacles)
    first = []
    for k, start in enumerate(starts):
        with of_arm(known, k):
            space = joint_space(known[k].robot, None, options.carriage_gap, options.section_length)
            first.append(start_equilibrium(space.holding(*shift_of(known[k].robot, start)), start))
    _check_starts(known, first, options.clearance)
    goals = [goal_seen(goal, arm.base) for arm, goal in zip(known, goals, strict=True)]
    for k, goal in enumerate(goals):
        with of_arm(known, k):
            check_goal(known[k].robot, goal)

    def planned(k: int, ends: Sequence[Equilibrium], limit: float, withdrawn: bool) -> Trajectory:
        arm = known[k]
        others: list[Obstacle] = []
        for j, end in enumerate(ends):
            if j != k:
                others += [plate_of(known[j]), *at_rest(end, known[j].base, REST_CHORD)]
        asked: dict[str, Any] = {
            "obstacles": seen_from(arm.base, [*bodies, *others]),
            "min_margin": min_margin,
            "rate_limits": rate_limits,
            "options": replace(options, time_limit=limit),
        }
        with of_arm(known, k):
            goal = _aside(arm, ends[k], options) if withdrawn else goals[k]
            return plan_trajectory(arm.robot, ends[k], goal, **asked)

    order, moves = _one_by_one(known, first, planned, clock)
    asks: dict[str, Any] = {"starts": first, "obstacles": bodies, "clearance": options.clearance}
    asks["min_margin"] = min_margin - 1e-6
    for motions in _sooner(known, first, moves, options.clearance):
        proof = verify_arms(known, motions, time_limit=max(clock.left, LEAST_SECONDS), **asks)
        if proof.holds or clock.over:
            break
    twice = tuple(k for k in order if sum(j == k for j, _ in moves) > 1)
    for k in twice:
        own = replace(motions[k], proof=proof.proofs[k], obstacles=seen_from(known[k].base, bodies))
        motions = (*motions[:k], own, *motions[k + 1 :])
    return ArmsPlan(known, motions, order, bodies, min_margin, options.clearance, proof, clock.seconds, twice)


def _check_starts(arms: Sequence[PlacedRobot], first: Sequence[Equilibrium], clearance: float) -> None:
    """Raise SolveError where two arms are too close before they move."""
    lines = [Lines.of([e], POINTS, arm.base) for arm, e in zip(arms, first, strict=True)]
    for i, j in combinations(range(len(arms)), 2):
        gap = min(float(lines[i].gaps(lines[j])[0]), between_plates(arms[i], arms[j]))
        if gap < clearance:
            raise SolveError(
                f"no plan exists: the clearance between {called(arms, i)} and "
                f"{called(arms, j)} at the start is {gap * 1e3:.3g} mm; it must be at least "
                f"{clearance * 1e3:g} mm"
            )


def _orders(n: int) -> list[tuple[int, ...]]:
    """Orders of n arms: first those in which each comes first, then others, six at least where there are."""
    turned = [tuple((k + j) % n for j in range(n)) for k in range(n)]
    return list(dict.fromkeys([*turned, *islice(permutations(range(n)), 6)]))[: max(n, 6)]


Planned = Callable[[int, Sequence[Equilibrium], float, bool], Trajectory]
"""The motion of an arm from where it rests, as all do, to its goal, within some seconds; or until it is withdrawn."""


def _one_by_one(
    arms: Sequence[PlacedRobot], first: Sequence[Equilibrium], planned: Planned, clock: Clock
) -> tuple[tuple[int, ...], list[Move]]:
    """An order in which each arm gets past the others at rest, and moves, one after the other: each to its goal; where
    no order has such moves, with later arms withdrawn before."""
    reasons: dict[str, None] = {}
    for aside in (False, True):
        for order in _orders(len(arms)):
            turns = [(k, True) for k in order[1:] if aside] + [(k, False) for k in order]
            try:
                return order, _moves(arms, first, turns, planned, clock.part(0.5))
            except SolveError as error:
                reasons[str(error)] = None
    raise SolveError(f"no plan was found that moves the arms one after the other: {'; '.join(reasons)}")


def _moves(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    turns: Sequence[tuple[int, bool]],
    planned: Planned,
    limit: Clock,
) -> list[Move]:
    """The moves of arms, one after the other, each to its goal or withdrawn.

    Raises:
        SolveError: one of them does not get to its goal; which cannot withdraw stays where it is.
    """
    ends, moves = list(first), list[Move]()
    for done, (k, withdrawn) in enumerate(turns):
        try:
            if limit.over:
                raise SolveError("the time limit was reached")
            moves.append((k, planned(k, ends, limit.left / (len(turns) - done), withdrawn)))
        except SolveError as error:
            if withdrawn:
                continue
            before = ", ".join(str(j + 1) for j, _ in moves)
            when = f" after arm {before}" if before else ""
            raise SolveError(f"{called(arms, k)}{when}: {error}") from None
        ends[k] = moves[-1][1].end
    return moves


def _aside(arm: PlacedRobot, at: Equilibrium, options: PlanOptions) -> tuple[Array, Array]:
    """Joint values of an arm with its tubes withdrawn, and turned as they are."""
    space, n = joint_space(arm.robot, None, options.carriage_gap, options.section_length), arm.robot.n_tubes
    space = space.holding(at.translations)
    q = space.join(at.rotations, at.translations)
    q[n:] += 0.9 * (space.lower[n:] - q[n:])
    rotations, translations = space.split(space.nearest(q))
    return rotations, np.array(translations)


def _sooner(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    moves: Sequence[Move],
    clearance: float,
) -> Iterator[tuple[Trajectory, ...]]:
    """Motions on one clock, each move begun as early as those before it leave room; then with more room; at last one
    after the other."""
    lines = [_moving(arms[k], motion) for k, motion in moves]
    for room in (ROOM, 4 * ROOM, np.inf):
        whole = [Lines.of([e], POINTS, arm.base) for arm, e in zip(arms, first, strict=True)]
        parts: list[list[Trajectory]] = [[] for _ in arms]
        for (k, motion), line in zip(moves, lines, strict=True):
            earliest, latest = float(whole[k].time[-1]), max(float(each.time[-1]) for each in whole)
            delays = np.linspace(earliest, latest, DELAYS)[:-1].tolist() if np.isfinite(room) else []
            others = [each for j, each in enumerate(whole) if j != k]
            moved = (at for at in delays if _clear(line.later(at), others, at, clearance + room))
            at = next(moved, latest)
            whole[k] = Lines.joined([whole[k], line.later(at)])  # with rest in between
            parts[k].append(replace(motion, time=motion.time + at))
        yield tuple(_joined(each) for each in parts)


def _moving(arm: PlacedRobot, motion: Trajectory) -> Lines:
    """An arm at all samples of its motion, in the frame that arms share."""
    return replace(Lines.of(motion.arms, POINTS, arm.base), time=motion.time)


def _clear(line: Lines, others: Sequence[Lines], since: float, room: float) -> bool:
    """Whether an arm that begins to move at a time keeps its distance from the others until they rest, as they did when
    it was planned for."""
    for other in others:
        if other.time[-1] > since:
            times = np.linspace(since, other.time[-1], INSTANTS)
            if line.at_times(times).gaps(other.at_times(times)).min() < room:
                return False
    return True


def _joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Motions of one robot, each from where the one before ends, as one, with rest in between."""
    whole = parts[0]
    for part in parts[1:]:
        rests = part.time[0] > whole.time[-1]
        kept = slice(0 if rests else 1, None)
        one, other = whole.statistics, part.statistics
        summed = {
            each.name: getattr(one, each.name) + getattr(other, each.name)
            for each in fields(one)
            if not isinstance(getattr(one, each.name), str)
        }
        tables = ("time", "rotations", "translations")
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(whole, name), getattr(part, name)[kept]]) for name in tables
        }
        turns = tuple(a + b for a, b in zip(whole.turns, part.turns, strict=True))
        arms, summary = (*whole.arms, *part.arms[kept]), replace(other, **summed)
        whole = replace(whole, **joined, arms=arms, turns=turns, statistics=summary)
    return whole
