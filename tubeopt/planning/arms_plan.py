"""Planning for several robots: one after the other past those that rest, then as much at a time as they leave each
other room for.

Each robot in an order is planned for with the arms before it where they end, and those after it where they begin: one
after the other these motions are a plan for all. Where no order has one, those that come later first make way: they
withdraw, and go on from there when it is their turn. Motions are then let begin as early as the distance between moving
arms allows (on fixed paths, delayed: Akella and Hutchinson 2002), and all is proved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, islice, permutations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..bodies.obstacles import Obstacle, checked_obstacles
from ..bodies.placed import seen_from
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, instance
from ..inverse.clock import Clock
from ..inverse.question import prepared
from ..inverse.way_settings import DEFAULT_WAY
from ..solvers.parallel.blas import small
from ..typing import Array
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
from .arms_clock import Lines, Move, sooner
from .goals import goal_seen
from .motion import DEFAULT_RATES, RateLimits
from .options import DEFAULT_PLAN, PlanOptions
from .plan import plan_trajectory
from .trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class ArmsPlan(Displayed):
    """Motions of several robots on one clock, which keep away from each other.

    Attributes:
        arms: the robots, and where they stand.
        trajectories: one for each, in its own frame, its time (s) from when it begins to move; its obstacles are those
            that its path was planned past: with other arms at rest.
        order: numbers of arms, from 0, in which they were planned for.   made_way: those that first withdrew: their
            trajectories are of two parts, with rest in between, and their proof is that of all of it.
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
    made_way: tuple[int, ...] = ()

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
        """(T, pairs) distances between arms at times (T,), s, of points of either, m: the proof bounds what lies
        between them."""
        t = np.asarray(times, dtype=float)
        lines = [
            Lines.of(arm, each, DEFAULT_WAY.delay_points).at_times(t)
            for arm, each in zip(self.arms, self.trajectories, strict=True)
        ]
        return np.stack([one.gaps(other) for one, other in combinations(lines, 2)], axis=1)


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
        raise InputError("roadmap and max_force are of one robot; a plan of several arms has none")
    clock, bodies = Clock(options.time_limit), checked_obstacles(obstacles)
    first = []
    for k, start in enumerate(starts):
        with of_arm(known, k):
            first.append(_start(known[k], start))
    _check_starts(known, first, options.clearance, options.effort.delay_points)
    goals = [goal_seen(goal, arm.base) for arm, goal in zip(known, goals, strict=True)]

    def planned(k: int, ends: Sequence[Equilibrium], limit: float, withdrawn: bool) -> Trajectory:
        arm = known[k]
        others: list[Obstacle] = []
        for j, end in enumerate(ends):
            if j != k:
                others += [plate_of(known[j]), *at_rest(end, known[j].base, options.effort.rest_chord)]
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
    motions, proof = _proved(known, first, moves, bodies, min_margin, options, clock)
    twice = tuple(k for k in order if sum(j == k for j, _ in moves) > 1)
    for k in twice:
        own = replace(motions[k], proof=proof.proofs[k], obstacles=seen_from(known[k].base, bodies))
        motions = (*motions[:k], own, *motions[k + 1 :])
    return ArmsPlan(known, motions, order, bodies, min_margin, options.clearance, proof, clock.seconds, twice)


def _proved(
    arms: tuple[PlacedRobot, ...],
    first: Sequence[Equilibrium],
    moves: Sequence[Move],
    bodies: tuple[Obstacle, ...],
    min_margin: float,
    options: PlanOptions,
    clock: Clock,
) -> tuple[tuple[Trajectory, ...], ArmsProof]:
    """Moves on one clock, as soon as their proof holds or time is over, with it."""
    motions: tuple[Trajectory, ...] = ()
    proof = None
    for motions in sooner(arms, first, moves, options.clearance, options.effort):
        proof = verify_arms(
            arms,
            motions,
            starts=first,
            obstacles=bodies,
            min_margin=min_margin - 1e-6,
            clearance=options.clearance,
            clock=clock,
            effort=options.effort,
        )
        if proof.holds or clock.over:
            break
    assert proof is not None
    return motions, proof


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


def _check_starts(arms: Sequence[PlacedRobot], first: Sequence[Equilibrium], clearance: float, points: int) -> None:
    """Raise SolveError where two arms are too close before they move."""
    lines = [Lines.at(arm, [e], points) for arm, e in zip(arms, first, strict=True)]
    for i, j in combinations(range(len(arms)), 2):
        gap = min(float(lines[i].gaps(lines[j])[0]), between_plates(arms[i], arms[j]))
        if gap < clearance:
            raise SolveError(
                f"no plan exists: at their starts {called(arms, i)} and {called(arms, j)} are {gap * 1e3:.3g} mm "
                f"apart; they must keep {clearance * 1e3:g} mm"
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
            ends, moves, limit = list(first), list[Move](), clock.part(0.5)
            try:
                _move(arms, [(k, True) for k in order[1:]] if aside else [], (ends, moves), planned, limit)
                _move(arms, [(k, False) for k in order], (ends, moves), planned, limit)
            except SolveError as error:
                reasons[str(error)] = None
            else:
                return order, moves
    raise SolveError(f"no plan was found for all arms, one after the other past those at rest: {'; '.join(reasons)}")


def _move(
    arms: Sequence[PlacedRobot],
    turns: Sequence[tuple[int, bool]],
    so_far: tuple[list[Equilibrium], list[Move]],
    planned: Planned,
    limit: Clock,
) -> None:
    """Add the moves of arms, each to its goal or withdrawn, to those so far, and to where all rest after them.

    Raises:
        SolveError: one of them does not get to its goal; which cannot withdraw stays where it is.
    """
    ends, moves = so_far
    for done, (k, withdrawn) in enumerate(turns):
        try:
            if limit.over:
                raise SolveError("time was over")
            left = len(turns) - done + (len(arms) if withdrawn else 0)
            moves.append((k, planned(k, ends, limit.left / left, withdrawn)))
        except SolveError as error:
            if withdrawn:
                continue
            before = ", ".join(str(j + 1) for j, _ in moves)
            when = f" after arm {before}" if before else ""
            raise SolveError(f"{called(arms, k)}{when}: {error}") from None
        ends[k] = moves[-1][1].end


def _aside(arm: PlacedRobot, at: Equilibrium, options: PlanOptions) -> tuple[Array, Array]:
    """Joint values of an arm with its tubes withdrawn, and turned as they are."""
    space, n = prepared(arm.robot, None, options.carriage_gap, options.section_length), arm.robot.n_tubes
    q = space.join(at.rotations, at.translations)
    q[n:] += 0.9 * (space.lower[n:] - q[n:])
    rotations, translations = space.split(space.nearest(q))
    return rotations, np.array(translations)
