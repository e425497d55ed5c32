"""Plan motions of several robots: one after the other past the arms at rest, then overlapped in time.

In an order of the arms, each motion is planned with the arms before it at their goals and those after it at their
starts (prioritised planning). If no order has such motions, later arms first retract and continue from there when it is
their turn. Then each motion starts as early as the distance between moving arms allows, on fixed paths with delays
(Akella and Hutchinson 2002), and everything is proved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations, islice, permutations
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.anatomy import bodies_in_frame
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..display import Displayed
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, instance
from ..files.field_metadata import form, unit
from ..inverse.clock import Clock
from ..inverse.joints import joint_space, shift_of
from ..solvers.blas import small
from ..solvers.time_limit import MIN_SECONDS
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
"""Number of delays tried for a motion, from none to the end of all earlier motions."""

# Between two instants, RESERVE covers the error; in the end the proof decides.
INSTANTS, POINTS = 80, 64
"""Number of instants of a motion, and of points per arm, for the choice of delays."""

# The first value is enough for slow motions; four times that is tried next, and then no overlap at all.
RESERVE = 3e-4
"""Reserve of the distance between moving arms, m, for the error between instants and points."""

# A capsule is thicker than the arm by its sagitta: 10 um for a curvature of 20 per m.
REST_CHORD = 2e-3
"""Longest straight segment that replaces an arm at rest, m."""


class Move(NamedTuple):
    """A motion of one arm, from time 0."""

    arm: int
    motion: Trajectory


@dataclass(frozen=True, eq=False)
class ArmsPlan(Displayed):
    """Proved motions of several robots with a common time, and a distance between arms at all times."""

    _brief = ("arms", "status", "order")

    arms: tuple[PlacedRobot, ...]
    """Robots with the frames of their plates."""
    trajectories: tuple[Trajectory, ...]
    """Motion of each arm in its own frame, on the common clock; its obstacles include other arms at rest."""
    order: tuple[int, ...]
    """Numbers of the arms, from 0, in the order of planning."""
    obstacles: tuple[Obstacle, ...]
    """Obstacles in the shared frame."""
    min_margin: float
    """Required margin."""
    min_clearance: float
    """Required clearance, m."""
    proof: ArmsProof
    """Proof of all motions together."""
    seconds: Annotated[float, unit("s"), form(".1f", label="run time"), "run time of planning and proof"]
    withdrawn_first: tuple[int, ...] = ()
    """Arms that first retract. Their trajectories have two parts with a rest in between; the proof covers both."""

    @property
    def duration(self) -> float:
        """Time until the last arm rests, s."""
        return max(float(each.time[-1]) for each in self.trajectories)

    @property
    def value(self) -> tuple[Trajectory, ...]:
        """Motion of each arm."""
        return self.trajectories

    @property
    def proved(self) -> bool:
        """True if everything is proved."""
        return self.proof.holds

    @property
    def status(self) -> str:
        """Result of the proof: "proved", or its faults."""
        return "proved" if self.proved else "; ".join(self.proof.faults)

    def rows_at(self, t: float) -> tuple[int, ...]:
        """Index of the sample nearest to a time (s), for every trajectory."""
        return tuple(int(np.abs(each.time - t).argmin()) for each in self.trajectories)

    def clearance(self, times: ArrayLike) -> Array:
        """(T, P) distances of the P pairs of arms at times (T,), m."""
        t = np.asarray(times, dtype=float)
        lines = [_moving(arm, each).at_times(t) for arm, each in zip(self.arms, self.trajectories, strict=True)]
        return np.stack([first.distances(second) for first, second in combinations(lines, 2)], axis=1)


@typed
@small
def plan_arms(
    arms: Sequence[PlacedRobot],
    starts: Sequence[Any],
    goals: Sequence[Any],
    *,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = MIN_MARGIN,
    rate_limits: RateLimits = DEFAULT_RATES,
    options: PlanOptions = DEFAULT_PLAN,
) -> ArmsPlan:
    """Proved motions of several robots to goals, each on one stable branch, without contact between arms.

    Args:
        starts, goals: one for every arm, as in `plan_trajectory`; positions and directions of tips are in the frame
            that the arms share.
        obstacles: in that frame: every arm keeps `options.clearance` from them, and from all other arms.
        min_margin, rate_limits: of every arm.
        options: of the plan of each; the time limit is for all of it.

    Raises:
        InputError: as `plan_trajectory`; fewer than two arms; a roadmap or a force, which are not supported here.
        SolveError: arms are too close at their starts; or no order of motions past the other arms at rest was found,
            also with later arms retracted before. The message names the arm.

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
    _check_starts(known, first, options.kept_clearance)
    goals = [goal_seen(goal, arm.base) for arm, goal in zip(known, goals, strict=True)]
    for k, goal in enumerate(goals):
        with of_arm(known, k):
            check_goal(known[k].robot, goal)

    def planned(k: int, ends: Sequence[Equilibrium], limit: float, withdrawn: bool) -> Trajectory:
        arm = known[k]
        resting: list[Obstacle] = []
        for j, end in enumerate(ends):
            if j != k:
                resting += [plate_of(known[j]), *at_rest(end, known[j].base, REST_CHORD)]
        arguments: dict[str, Any] = {
            "obstacles": bodies_in_frame(arm.base, [*bodies, *resting]),
            "min_margin": min_margin,
            "rate_limits": rate_limits,
            "options": replace(options, time_limit=limit),
        }
        with of_arm(known, k):
            goal = _retracted(arm, ends[k], options) if withdrawn else goals[k]
            return plan_trajectory(arm.robot, ends[k], goal, **arguments)

    order, moves = _one_by_one(known, first, planned, clock)
    requirements: dict[str, Any] = {
        "obstacles": bodies,
        "clearance": options.kept_clearance,
        "min_margin": min_margin - 1e-6,
    }
    for motions in _overlapped(known, first, moves, options.kept_clearance):
        limit = max(clock.left, MIN_SECONDS)
        proof = verify_arms(known, motions, starts=first, time_limit=limit, **requirements)
        if proof.holds or clock.over:
            break
    twice = tuple(k for k in order if sum(move.arm == k for move in moves) > 1)
    for k in twice:
        final = replace(motions[k], proof=proof.proofs[k], obstacles=bodies_in_frame(known[k].base, bodies))
        motions = (*motions[:k], final, *motions[k + 1 :])
    return ArmsPlan(
        arms=known,
        trajectories=motions,
        order=order,
        obstacles=bodies,
        min_margin=min_margin,
        min_clearance=options.kept_clearance,
        proof=proof,
        seconds=clock.seconds,
        withdrawn_first=twice,
    )


def _check_starts(arms: Sequence[PlacedRobot], first: Sequence[Equilibrium], clearance: float) -> None:
    """Raise SolveError if two arms are too close before they move."""
    lines = [Lines.of([e], POINTS, arm.base) for arm, e in zip(arms, first, strict=True)]
    for i, j in combinations(range(len(arms)), 2):
        distance = min(float(lines[i].distances(lines[j])[0]), between_plates(arms[i], arms[j]))
        if distance < clearance:
            raise SolveError(
                f"no plan exists: the clearance between {called(arms, i)} and "
                f"{called(arms, j)} at the start is {distance * 1e3:.3g} mm; it must be at least "
                f"{clearance * 1e3:g} mm"
            )


def _orders(n: int) -> list[tuple[int, ...]]:
    """Orders in which n arms move: cyclic orders, then others; at least six if there are as many."""
    cyclic = [tuple((k + j) % n for j in range(n)) for k in range(n)]
    return list(dict.fromkeys([*cyclic, *islice(permutations(range(n)), 6)]))[: max(n, 6)]


Planned = Callable[[int, Sequence[Equilibrium], float, bool], Trajectory]
"""Function that plans the motion of an arm to its goal or until it is retracted.

Its arguments are (arm, equilibria of all arms at rest, time limit in s, retract).
"""


def _one_by_one(
    arms: Sequence[PlacedRobot], first: Sequence[Equilibrium], planned: Planned, clock: Clock
) -> tuple[tuple[int, ...], list[Move]]:
    """First order that lets each arm move past the others at rest, and its moves.

    If there is none, later arms are retracted first.
    """
    reasons: dict[str, None] = {}
    for retract in (False, True):
        for order in _orders(len(arms)):
            sequence = [(k, True) for k in order[1:] if retract] + [(k, False) for k in order]
            try:
                return order, _moves(arms, first, sequence, planned, clock.part(0.5))
            except SolveError as error:
                reasons[str(error)] = None
    raise SolveError(f"no plan was found that moves the arms one after the other: {'; '.join(reasons)}")


def _moves(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    sequence: Sequence[tuple[int, bool]],
    planned: Planned,
    limit: Clock,
) -> list[Move]:
    """Moves of arms in a `sequence`, one after the other: each to its goal, or, if marked True, until it is retracted.

    Raises:
        SolveError: an arm does not reach its goal. An arm that cannot retract remains in place.
    """
    ends, moves = list(first), list[Move]()
    for count, (k, withdrawn) in enumerate(sequence):
        try:
            if limit.over:
                raise SolveError("the time limit was reached")
            moves.append(Move(k, planned(k, ends, limit.left / (len(sequence) - count), withdrawn)))
        except SolveError as error:
            if withdrawn:
                continue
            before = ", ".join(str(move.arm + 1) for move in moves)
            when = f" after arm {before}" if before else ""
            raise SolveError(f"{called(arms, k)}{when}: {error}") from None
        ends[k] = moves[-1].motion.end
    return moves


def _retracted(arm: PlacedRobot, at: Equilibrium, options: PlanOptions) -> tuple[Array, Array]:
    """Joint values of an arm after 90 % of its possible retraction, at unchanged rotations."""
    space, n = joint_space(arm.robot, None, options.carriage_gap, options.section_length), arm.robot.n_tubes
    space = space.holding(at.translations)
    q = space.join(at.rotations, at.translations)
    q[n:] += 0.9 * (space.lower[n:] - q[n:])
    rotations, translations = space.split(space.nearest(q))
    return rotations, np.array(translations)


def _overlapped(
    arms: Sequence[PlacedRobot],
    first: Sequence[Equilibrium],
    moves: Sequence[Move],
    clearance: float,
) -> Iterator[tuple[Trajectory, ...]]:
    """Motions on one clock, each started as early as the distance allows, with a larger reserve on failure."""
    lines = [_moving(arms[k], motion) for k, motion in moves]
    for reserve in (RESERVE, 4 * RESERVE, np.inf):
        moved = [Lines.of([e], POINTS, arm.base) for arm, e in zip(arms, first, strict=True)]
        parts: list[list[Trajectory]] = [[] for _ in arms]
        for (k, motion), line in zip(moves, lines, strict=True):
            earliest, latest = float(moved[k].time[-1]), max(float(each.time[-1]) for each in moved)
            delays = np.linspace(earliest, latest, DELAYS)[:-1].tolist() if np.isfinite(reserve) else []
            other_lines = [each for j, each in enumerate(moved) if j != k]
            valid = (at for at in delays if _clear(line.later(at), other_lines, at, clearance + reserve))
            at = next(valid, latest)
            moved[k] = Lines.concatenated([moved[k], line.later(at)])  # with rest in between
            parts[k].append(replace(motion, time=motion.time + at))
        yield tuple(_joined(each) for each in parts)


def _moving(arm: PlacedRobot, motion: Trajectory) -> Lines:
    """Arm at all samples of its motion, in the shared frame."""
    return replace(Lines.of(motion.arms, POINTS, arm.base), time=motion.time)


def _clear(line: Lines, lines: Sequence[Lines], since: float, distance: float) -> bool:
    """True if an arm that starts at a time keeps a distance from the other arms until these rest.

    After that they are at rest, as in its plan.
    """
    for obstacle_line in lines:
        if obstacle_line.time[-1] > since:
            times = np.linspace(since, obstacle_line.time[-1], INSTANTS)
            if line.at_times(times).distances(obstacle_line.at_times(times)).min() < distance:
                return False
    return True


def _joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Motion composed of consecutive motions of a robot, with rests in between."""
    plan = parts[0]
    for part in parts[1:]:
        rests = part.time[0] > plan.time[-1]
        # Without a rest, the first sample equals the last one before.
        new = slice(0 if rests else 1, None)
        before, after = plan.statistics, part.statistics
        summed = {
            each.name: getattr(before, each.name) + getattr(after, each.name)
            for each in fields(before)
            if not isinstance(getattr(before, each.name), str)
        }
        tables = ("time", "rotations", "translations")
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(plan, name), getattr(part, name)[new]]) for name in tables
        }
        turns = tuple(a + b for a, b in zip(plan.turns, part.turns, strict=True))
        arms, summary = (*plan.arms, *part.arms[new]), replace(after, **summed)
        plan = replace(plan, **joined, arms=arms, turns=turns, statistics=summary)
    return plan
