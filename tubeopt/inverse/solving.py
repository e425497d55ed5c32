"""Inverse kinematics: joint values whose equilibrium, stable by a margin, has its tip at a target.

Under a load the unloaded robot is aimed so that the loaded one arrives. How a load moves the tip changes little from
one posture to the next, so that aiming by what is missed converges like a geometric series. Every answer of the way is
one of the search without load, and the load is put on it as the robot would feel it: growing from none.

A session solves one target after another, each from the last on its branch, as a servo does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypedDict, Unpack, overload

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..bodies.obstacles import Obstacle
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, choice, instance, vector
from ..robots.limits import JointLimits, check_target
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..solvers.blas import small
from ..typing import Array
from .answer import DEFAULT_OPTIONS, InverseOptions, InverseSolution, InverseStatistics, InverseStatus, JointPath
from .arm_surface import ArmSurface
from .clock import Clock
from .gauss_newton import (
    FIRST_STEP,
    Model,
    Order,
    breakpoint_order,
    broyden,
    crossings,
    held_by,
    missed_by,
    moved,
    on_target,
    reach,
)
from .goal import Goal, angle, pose_question, unit_vector
from .joint_path import answer_at, joint_path_of, jump_between, with_a_way
from .joints import Configuration
from .multistart import Multistart, known_home
from .posture import Posture, posture_of, same_place, start_posture
from .program import programmable, solve_program

SHOTS = 40
"""Solutions without load, and rounds of corrections of margin and clearance, in search of one under a load."""

# A fifth of what an answer may miss by.
AIM_TOLERANCE, STALLED = 2e-9, 1e-7
"""Distance, m, and angle, rad, at which the aim is good; and the miss, as a share of the arm or as an angle, below
which round-off ends the iteration."""

# With larger ratios 40 shots gain less than two digits.
AIM_GAIN, POOR_SHOTS = 0.9, 4
"""Largest ratio of successive misses of a converging iteration, and shots above it after which it does not converge."""

# Without it corrections approach the bound from below without reaching it.
AIM_ROOM = 1e-3
"""Margin, and share of the arm's length as clearance, that are required beyond what was found missing."""


class Asked(TypedDict, total=False):
    """What `inverse_kinematics` may be asked besides, with one answer or all."""

    direction: ArrayLike | None
    start: Configuration | None
    reference: Configuration | None
    min_margin: float
    limits: JointLimits | None
    weights: tuple[ArrayLike, ArrayLike] | None
    obstacles: Sequence[Obstacle]
    load: Load | None
    on_failure: str
    reachable: bool
    options: InverseOptions


@overload
def inverse_kinematics(
    robot: Robot, position: ArrayLike, *, all_solutions: Literal[False] = ..., **asked: Unpack[Asked]
) -> InverseSolution: ...


@overload
def inverse_kinematics(
    robot: Robot, position: ArrayLike, *, all_solutions: Literal[True], **asked: Unpack[Asked]
) -> list[InverseSolution]: ...


@renamed(seed="start")
@typed
@small
def inverse_kinematics(  # noqa: PLR0913
    robot: Robot,
    position: ArrayLike,
    *,
    direction: ArrayLike | None = None,
    start: Configuration | None = None,
    reference: Configuration | None = None,
    min_margin: float = 0.05,
    limits: JointLimits | None = None,
    weights: tuple[ArrayLike, ArrayLike] | None = None,
    obstacles: Sequence[Obstacle] = (),
    load: Load | None = None,
    on_failure: str = "raise",
    all_solutions: bool = False,
    reachable: bool = False,
    options: InverseOptions = DEFAULT_OPTIONS,
) -> InverseSolution | list[InverseSolution]:
    """Joint values that bring the tip to a target, in a stable equilibrium with at least `min_margin`.

    Every step of the search is a solved, stable equilibrium. `.reachable` states whether a snap-free path from the
    start, or else from home, is known; `.path` is that path.

    Args:
        position: (3,) target position of the tip, m.
        direction: (3,) target direction of the tip, of any length; None leaves it free.
        start: current configuration: a pair (rotations, translations), an Equilibrium or an InverseSolution. The search
            starts there and follows its branch; if that fails, it starts elsewhere.
        reference: configuration to stay close to; by default the start.
        min_margin: smallest allowed stability margin, in [0, 1).
        limits: range of every joint; by default `robot.limits`. The order of the tubes is kept as well.
        weights: weights of the joint distances from the reference: (n,) per rad and (n,) per m; by default 1 per rad
            and 2 per length of the longest tube.
        obstacles: bodies that the whole arm avoids by `options.clearance`.
        load: dead forces on the robot: tip, margin and clearance are those under load. Gives one solution, without a
            path.
        on_failure: "raise", or "closest" to get the closest pose to a target out of reach.
        all_solutions: return all distinct solutions found, best first: nearest to the reference if there is one, else
            the largest margin.
        reachable: search a snap-free path to every returned solution, with work of about 10 s each: straight, through
            translations that exclude any snap, or by sampling.
        options: objective, weight of the direction, clearance, method, and so on.

    Raises:
        InputError: numbers that are missing, not finite or not allowed, limits that leave nothing, or a load without an
            energy (and so without a margin).
        SolveError: no solution was found. The message states the miss and the active constraints; `.solution` is the
            closest pose.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> found = tubeopt.inverse_kinematics(robot, [0.05, 0.03, 0.15])
        >>> found.reached, found.position_error < 1e-9
        (True, True)
    """
    check_robot(robot)
    instance("options", options, InverseOptions)
    clock = Clock(options.time_limit)
    choice("on_failure", on_failure, ("raise", "closest"))
    if load is not None and (all_solutions or reachable or on_failure != "raise"):
        raise InputError("all_solutions, reachable and on_failure 'closest' are for a robot without load")
    goal = pose_question(
        robot,
        (position, direction),
        (start, reference),
        min_margin=min_margin,
        limits=limits,
        weights=weights,
        obstacles=obstacles,
        options=options,
    )
    goal = replace(goal, clock=clock)
    if load is not None:
        return _under_load(goal, _without_load(start), load, held=reference is not None)
    found = answers_of(goal, start, every=all_solutions, on_failure=on_failure, reachable=reachable)
    return found if all_solutions else found[0]


def answers_of(
    goal: Goal,
    start: Configuration | None,
    *,
    every: bool = False,
    on_failure: str = "raise",
    reachable: bool = False,
) -> list[InverseSolution]:
    """The answer to a question, or `every` one."""
    if goal.objective == "nearest" and not goal.named:
        raise InputError("objective is 'nearest', but neither reference nor start is given; give one of them")
    if goal.direction_weight is not None and goal.direction is None:
        raise InputError("direction_weight is given without a direction; give the direction to point along")
    if goal.options.method == "nlp" and goal.overdetermined:
        raise InputError(
            "method is 'nlp', but the target has more conditions than the "
            f"{len(goal.space.lower)} independent joints of the robot; use auto or "
            "gauss_newton"
        )
    first = start_posture(goal.space, start) if start is not None else None
    search = Multistart(goal, first)
    found = (search.all() if every else search.one()) or [search.failure(on_failure)]
    if reachable:
        begin = first if first is not None else known_home(goal.space)
        found = [with_a_way(each, begin, goal) for each in found]
    return found


def _under_load(goal: Goal, start: Configuration | None, load: Load, *, held: bool) -> InverseSolution:
    """Joint values whose loaded equilibrium has its tip at a target, with margin and clearance under the load; near the
    start or, where its reference is `held`, that of the goal.

    Where the loaded arm falls short of the margin or the clearance, the unloaded one is asked for so much more.
    """
    if goal.direction_weight is not None:
        raise InputError("direction_weight is given; under load a direction is a constraint or free")
    wanted, last = goal, start
    for _ in range(SHOTS):
        last, e = _aim(wanted, last, load, held=held)
        answer = _loaded_answer(last, e, goal)
        short = goal.min_margin - e.margin
        near = goal.clearance - ArmSurface(e).clearance(goal.scene) if goal.scene.bodies else -1.0
        if short <= 0 and near <= 0:
            return answer
        floor = wanted.min_margin + max(short, 0.0) + (AIM_ROOM if short > 0 else 0.0)
        clearance = wanted.clearance + max(near, 0.0) + (AIM_ROOM * float(e.arc_length[-1]) if near > 0 else 0.0)
        if floor >= 1:
            break
        wanted = replace(wanted, min_margin=floor, options=replace(wanted.options, clearance=clearance))
    raise SolveError(
        f"the best solution under load has margin {e.margin:.3g}, and its clearance is "
        f"{1e3 * max(near, 0.0):.3g} mm too small",
        answer,
    )


def _without_load(start: Configuration | None) -> Configuration | None:
    """Where a robot is, without the load that it bears there."""
    known = getattr(start, "equilibrium", start)
    if isinstance(known, Equilibrium) and known.load is not None:
        return known.rotations, known.translations
    return start


def _aim(goal: Goal, last: Configuration | None, load: Load, *, held: bool) -> tuple[InverseSolution, Equilibrium]:
    """An answer without load whose loaded equilibrium is on target: by Broyden's method in where the unloaded tip is
    and, where it is wanted, in its direction, from as if the load moved all tips alike."""
    at, missed, poor = goal, np.inf, 0
    # At first as if the load moved all tips alike: then the miss changes as the aim does.
    slope: Array = np.eye(3 if goal.direction is None else 6)
    before: Array | None = None
    step = slope[0]
    for _ in range(SHOTS):
        if isinstance(last, InverseSolution) and not held:
            here = goal.space.join(last.rotations, last.translations)
            at = replace(at, named=True, objective=at.objective or "nearest", reference=here)
        (last,) = answers_of(at, last)
        e = forward_kinematics(
            last.equilibrium.robot, last.rotations, last.translations, load=load, start=last.equilibrium
        )
        gap = goal.position - e.tip_position
        turn = 0.0 if goal.direction is None else angle(e.tip_rotation[:, 2], goal.direction)
        last_miss, missed = missed, max(float(np.linalg.norm(gap)) / float(e.arc_length[-1]), turn)
        if max(float(np.linalg.norm(gap)), turn) <= AIM_TOLERANCE:
            return last, e
        # Counted and not refused at once: Broyden's slope may still be that of the start.
        poor += missed > AIM_GAIN * last_miss
        if poor and missed <= STALLED:
            return last, e
        if poor > POOR_SHOTS:
            break
        length, off = float(e.arc_length[-1]), gap
        if goal.direction is not None:
            # In m: a direction that is off by 1 rad counts as one length of the arm.
            off = np.concatenate([gap, length * (goal.direction - e.tip_rotation[:, 2])])
        if before is not None:
            slope = broyden(slope, step, before - off)
        before, step = off, np.linalg.solve(slope, off)
        at = replace(at, position=at.position + step[:3])
        if at.direction is not None:
            along = at.direction + step[3:] / length
            at = replace(at, direction=along / np.linalg.norm(along))
    raise SolveError(
        f"the loaded robot misses the target by {1e3 * np.linalg.norm(gap):.3g} mm; iterations did not converge"
    )


def _loaded_answer(found: InverseSolution, e: Equilibrium, goal: Goal) -> InverseSolution:
    at = posture_of(goal.space, e)
    return replace(
        found,
        target_position=goal.position,
        target_direction=goal.direction,
        equilibrium=e,
        position_error=goal.position_error(at),
        direction_error=goal.direction_error(at),
        cold_start_agrees=None,
        straight_from_seed=None,
        # The way of the unloaded robot: what the loaded one does on it nobody asked.
        reachable=None,
        path=None,
    )


# A fifth of what an answer may miss by.
STEP_TOLERANCE = 2e-9
"""Distance, m, and angle, rad, at which a step ends."""

# Derivatives of the last target are used for a whole step, so that its error grows with the square of the step.
MOVE = 0.02
"""Share of the robot's length; farther targets are approached in so long parts on a straight line."""

# Four halvings. Where the robot jumps even then, the branch most likely ends there.
LEAST_PART = 1 / 16
"""Smallest part, as a share of the longest, into which a step is divided to avoid a jump."""

# The motion in the null space stays below that towards the target, for which the linear model is trusted.
PUSH = 0.5
"""Length of the motion towards larger margin, over that of the motion towards the target."""

# Near a fold the margin falls like a square root, so that derivatives of earlier steps predict it too large.
CAREFUL = 0.15
"""Margin above its bound below which derivatives are computed anew for every step."""

# A point of the arm can move farther than the tip, which may only turn.
CLEARANCE_PER_MOVE, LEAST_CLEARANCE = 4.0, 2e-4
"""Spare clearance of a step that ignores obstacles: per distance that the tip moves, and besides, m."""

STALE_SOLVES, STALE_STEPS = 4, 8
"""Equilibria of a step, and steps, after which derivatives are computed anew."""

CLOSING_SECTION = 1e-3
"""Length, m, of a section that a step may close."""

LAST = "last target"
"""Where the way to an answer begins."""


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives of the residual and of the margin near a posture, and how many steps ago they were computed."""

    target: Array
    margin: Array
    age: int


class IkSession:
    """Inverse kinematics of one robot for a sequence of targets.

    Keeps the last equilibrium and its derivatives: a small step takes a few Newton solves. Each step follows the branch
    of the last one, keeps joint limits, order, margin and clearance, and uses the null space to raise the margin. Where
    it stalls, the nonlinear program continues from there. The straight joint path between two solutions is checked;
    targets are inserted where it would jump.

    Args:
        robot, min_margin, limits, weights, obstacles, options: as for `inverse_kinematics`.
        start: current configuration of the robot; without it, the first target starts from the table of configurations.

    Raises:
        InputError, SolveError: as `inverse_kinematics` does.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        start: Configuration | None = None,
        min_margin: float = 0.05,
        limits: JointLimits | None = None,
        weights: tuple[ArrayLike, ArrayLike] | None = None,
        obstacles: Sequence[Obstacle] = (),
        options: InverseOptions = DEFAULT_OPTIONS,
    ) -> None:
        self._goal = pose_question(
            robot,
            (np.zeros(3), None),
            (start, None),
            min_margin=min_margin,
            limits=limits,
            weights=weights,
            obstacles=obstacles,
            options=options,
        )
        self._solution: InverseSolution | None = None
        self._here: Posture | None = None
        self._near: _Slopes | None = None
        self._pointed = False
        if start is not None:
            self._here = self._allowed(start_posture(self._goal.space, start))

    @property
    def solution(self) -> InverseSolution | None:
        """The last answer, None before the first."""
        return self._solution

    @small
    def solve(self, position: ArrayLike, *, direction: ArrayLike | None = None) -> InverseSolution:
        """The solution for the next target, near the last one.

        `.path` leads from the last solution to it without a jump, with joint values inserted where the straight path
        would jump. If there is no such path, `.jump` gives the reason.

        Raises:
            InputError: a target that is not three finite numbers, a direction of length zero.
            SolveError: the branch does not reach the target; the message states the miss and the active constraints.
                The session keeps its last state.
        """
        answers = self.solve_path(position, direction=direction)
        if len(answers) == 1:
            return answers[0]
        last, ways = answers[-1], [each.path for each in answers]
        known = [way for way in ways if way is not None]
        whole = None
        if len(known) == len(ways):
            table = [np.concatenate([way.rotations, way.translations], axis=1) for way in known]
            rows = np.concatenate([table[0], *(each[1:] for each in table[1:])])
            whole = JointPath(LAST, *np.split(rows, 2, axis=1))
        statistics = _summed([each.statistics for each in answers])
        leaps = next((each.jump for each in answers if each.jump), "")
        self._solution = replace(
            last, reachable=None if whole is None else True, path=whole, jump=leaps, statistics=statistics
        )
        return self._solution

    @small
    def solve_path(self, position: ArrayLike, *, direction: ArrayLike | None = None) -> list[InverseSolution]:
        """Solutions for intermediate targets on the straight line from the last target, then for the next target.

        As many as are needed so that no straight joint path between two of them jumps. Where a jump remains, `.jump`
        has the reason. Raises as `solve` does.
        """
        target = vector("position", position, 3, "x, y, z in m")
        check_target(self._goal.space.robot.tubes, "position", target)
        pointing = None if direction is None else unit_vector("direction", direction)
        goal = replace(self._goal, position=target, direction=pointing, clock=Clock(self._goal.options.time_limit))
        if self._here is None:
            return [self._first(goal)]
        if goal.pointed != self._pointed:
            self._near, self._pointed = None, goal.pointed
        before = self._here, self._near, self._solution
        try:
            return self._led(goal, self._here)
        except SolveError:
            self._here, self._near, self._solution = before
            raise

    def _led(self, goal: Goal, first: Posture) -> list[InverseSolution]:
        """Answers along the line from a posture to a goal, in parts that are halved where the robot would leap."""
        answers: list[InverseSolution] = []
        most = 1 / _parts(goal, first)
        done, share, here = 0.0, most, first
        while done < 1:
            share = min(share, 1 - done)
            end = done + share if done + share < 1 - 1e-9 else 1.0
            began = time.perf_counter()
            if goal.clock.over:
                raise SolveError(_stalled(goal, here))
            part = goal if end == 1 else _between(goal, first, end)
            there, near, solves = self._step((part, goal), here, self._near)
            words, safe = jump_between(goal, here, there)
            if words and share > most * LEAST_PART and self._finer(goal, (first, here), done + share / 2):
                share /= 2
                continue
            answers.append(self._keep(part, (here, there), near, (words, safe, solves, began)))
            done, share, here = end, min(2 * share, most), there
        if len(answers) == 1:
            return answers
        # The last answer alone, where the straight way to it no longer leaps; small steps may have led elsewhere.
        words, safe = jump_between(goal, first, here)
        if words:
            return answers
        way = joint_path_of(LAST, goal.space, [first.q, here.q])
        self._solution = replace(
            answers[-1], path=way, straight_from_seed=safe, jump="", statistics=_summed([a.statistics for a in answers])
        )
        return [self._solution]

    def _finer(self, goal: Goal, postures: tuple[Posture, Posture], share: float) -> bool:
        """Whether the branch leads to a share of the way, too, from the first posture to the goal, and there from the
        second; a leap is better than no answer."""
        first, here = postures
        try:
            self._step((_between(goal, first, share), goal), here, self._near)
        except SolveError:
            return False
        return True

    def _allowed(self, start: Posture) -> Posture:
        """The start; raises InputError where it is not allowed itself."""
        if words := self._goal.space.outside(start.q):
            raise InputError(f"start is out of range: {words}")
        if start.margin < self._goal.floor:
            raise InputError(
                f"start has margin {start.margin:.3g}; it must have more than min_margin, {self._goal.min_margin:g}"
            )
        return start

    def _first(self, goal: Goal) -> InverseSolution:
        (answer,) = answers_of(goal, None)
        self._here, self._solution = posture_of(goal.space, answer.equilibrium), answer
        return answer

    def _step(
        self, goals: tuple[Goal, Goal], here: Posture, near: _Slopes | None
    ) -> tuple[Posture, _Slopes | None, int]:
        """The posture on the first of two goals, which lies on the way to the other; derivatives for the next step, and
        the equilibria solved."""
        goal, last = goals
        if here.margin < goal.floor + CAREFUL or (near is not None and near.age >= STALE_STEPS):
            near = None
        solves = 0
        for start, slopes, order, guarded in _attempts(goal, here, near):
            moved, after, count = _servo(goal, start, slopes, order, guarded=guarded)
            solves += count
            if moved is not None:
                return moved, after if count <= STALE_SOLVES else None, solves
        search = reach(goal, here)
        if search.reached:
            return search.posture, None, solves + search.solves
        if not programmable(goal):
            raise SolveError(_stalled(last, search.posture))
        other = solve_program(replace(goal, objective="nearest", reference=here.q), here)
        if not other.reached or not same_place(here.to(other.posture.q), other.posture):
            raise SolveError(_stalled(last, search.posture))
        return other.posture, None, solves + search.solves + other.solves

    def _keep(
        self, goal: Goal, postures: tuple[Posture, Posture], near: _Slopes | None, how: tuple[str, bool, int, float]
    ) -> InverseSolution:
        """The answer at the second of two postures, which the session is at from now on, after the first."""
        (before, at), (words, safe, solves, began) = postures, how
        answer = answer_at(
            goal,
            at,
            InverseStatus.REACHED,
            InverseStatistics("gauss_newton", "seed", 1, 1, solves, time.perf_counter() - began),
            cold_start_agrees=None,
            straight_from_seed=safe,
            reachable=True if safe else None,
            path=joint_path_of(LAST, goal.space, [before.q, at.q]) if safe else None,
            jump=words,
        )
        self._here, self._near, self._solution = at, near, answer
        return answer


def _summed(parts: Sequence[InverseStatistics]) -> InverseStatistics:
    """What answers one after another have cost."""
    iterations, solves = sum(each.iterations for each in parts), sum(each.solves for each in parts)
    return replace(parts[-1], iterations=iterations, solves=solves, seconds=sum(each.seconds for each in parts))


def _parts(goal: Goal, here: Posture) -> int:
    """Parts in which a target is approached on a straight line: one, unless it is far."""
    count = int(np.ceil(float(np.linalg.norm(goal.position - here.tip)) / (MOVE * goal.space.length)))
    turned = goal.direction_error(here) if goal.pointed else 0.0
    return max(1, count, int(np.ceil(turned / (10 * MOVE))))


def _between(goal: Goal, first: Posture, share: float) -> Goal:
    """The target on the way from a posture to a goal, `share` of the way on."""
    part = replace(goal, position=first.tip + (goal.position - first.tip) * share)
    if not goal.pointed:
        return part
    return replace(part, direction=scipy.spatial.geometric_slerp(first.direction, goal.direction, share))


def _attempts(goal: Goal, here: Posture, near: _Slopes | None) -> Iterator[tuple[Posture, _Slopes, Order | None, bool]]:
    """Where to step from, with which derivatives, and whether the step is guarded by obstacles and custom constraints:
    with derivatives of earlier steps, unguarded; with new ones, guarded if there is nothing to spare or else it failed;
    then, since derivatives change with the order of breakpoints, without a change of order, and from beyond each change
    that is close."""
    room = _roomy(goal, here)
    if near is not None and room:
        yield here, near, None, False
    fresh = _Slopes(goal.slope(here), here.margin_slope(), 0)
    if room:
        yield here, fresh, None, False
    if goal.hindered:
        yield here, fresh, None, True
    yield here, fresh, breakpoint_order(goal, here), True
    for other in crossings(goal, here, CLOSING_SECTION):
        yield other, _Slopes(goal.slope(other), other.margin_slope(), 0), breakpoint_order(goal, other), True


def _roomy(goal: Goal, here: Posture) -> bool:
    """Whether the arm is so far from all bodies that a step to the target will not bring it to them, as a rule."""
    if goal.extras.constraints:
        return False
    enough = goal.gap + LEAST_CLEARANCE + CLEARANCE_PER_MOVE * goal.position_error(here)
    return here.outline.clearance(goal.scene, enough) >= enough


def _servo(
    goal: Goal, here: Posture, near: _Slopes, order: Order | None, *, guarded: bool
) -> tuple[Posture | None, _Slopes, int]:
    """One step towards the target and, in what it leaves free, towards larger margin; then corrections. The posture is
    None where it is not allowed."""
    residual = goal.residual(here)
    if goal.reached(here, STEP_TOLERANCE, STEP_TOLERANCE):
        return here, near, 0
    rows, bounds = goal.space.inequalities(here.q)
    if here.margin < goal.floor + CAREFUL or (guarded and goal.hindered):
        rows, bounds = goal.inequalities(here)
    if order is not None:
        rows, bounds = order.kept(here.q, rows, bounds)
    scale = goal.space.scale
    # The shortest way, which says how far to go beside it.
    size = float(np.linalg.norm(np.linalg.pinv(near.target * scale) @ residual))
    push = near.margin * scale if here.margin < 1 - 1e-6 else np.zeros(len(scale))
    steep = float(np.linalg.norm(push))
    aside = push * (PUSH * size * min(1.0, 1.0 / steep)) if steep > 0 else push
    target = on_target(near.target, residual)
    chosen = Model(np.diag(1 / scale), aside, *target, rows, np.minimum(bounds, 0.0)).step(goal, FIRST_STEP)
    if chosen is None:
        return None, near, 1
    most = 4 if order is None else 8
    back = moved(goal, here, chosen.x, near.target, close=STEP_TOLERANCE, most=most, order=order)
    return back.posture, _Slopes(back.slope, near.margin, near.age + 1), back.solves


def _stalled(goal: Goal, at: Posture) -> str:
    if goal.clock.over:
        return f"the time limit was reached before the target: {missed_by(goal, at)}"
    why = ", ".join(held_by(goal, at)) or "the branch of equilibria does not lead on"
    return f"the target cannot be reached from here: {missed_by(goal, at)}: {why}"
