"""Inverse kinematics: joint values of an equilibrium with its tip at a target and a sufficient margin.

Under a load the target of the unloaded robot is shifted until the tip of the loaded robot arrives. The displacement by
a load changes little from one posture to the next, so that the iteration converges like a geometric series. Each
iterate is a solution without load, on which the load then grows from 0.

A session solves one target after another, each on the branch of the solution before, as a servo does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypedDict, Unpack, overload

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..bodies.obstacles import Obstacle
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, choice, instance, vector
from ..robots.eccentric import by_model
from ..robots.limits import JointLimits, check_target
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..solvers.blas import small
from ..typing import Array
from .answer import DEFAULT_OPTIONS, InverseOptions, InverseSolution, InverseStatistics, InverseStatus, JointPath
from .breakpoint_order import OrderConstraints, breakpoint_order, crossings
from .clock import Clock
from .gauss_newton import FIRST_STEP, StepModel, broyden, moved, on_target, reach
from .goal import Goal, angle, pose_question, unit_vector
from .joint_path import answer_at, joint_path_of, jump_between, with_path
from .joints import Configuration
from .miss import active_constraints, miss_text
from .multistart import Multistart, known_home
from .posture import Posture, posture_of, same_posture, start_posture
from .program import programmable, solve_program

MAX_SHOTS = 40
"""Maximum number of solutions without load, and of corrections of margin and clearance, for a solution under load."""

# A fifth of the tolerance of a solution.
AIM_TOLERANCE, STALLED = 2e-9, 1e-7
"""Tolerance of the iteration, m and rad, and miss, relative to the arm or as an angle, of round-off."""

# With larger ratios 40 shots gain less than two digits.
AIM_GAIN, POOR_SHOTS = 0.9, 4
"""Largest ratio of successive misses of a converging iteration, and shots above it after which it does not converge."""

# Without it corrections approach the bound from below without reaching it.
AIM_EXCESS = 1e-3
"""Margin, and clearance relative to the arm's length, that are required beyond the amount that was missing."""


class InverseArguments(TypedDict, total=False):
    """Options of `inverse_kinematics`, with one solution or all."""

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
    robot: Robot, position: ArrayLike, *, all_solutions: Literal[False] = ..., **arguments: Unpack[InverseArguments]
) -> InverseSolution: ...


@overload
def inverse_kinematics(
    robot: Robot, position: ArrayLike, *, all_solutions: Literal[True], **arguments: Unpack[InverseArguments]
) -> list[InverseSolution]: ...


@renamed(seed="start")
@typed
@by_model
@small
def inverse_kinematics(  # noqa: PLR0913
    robot: Robot,
    position: ArrayLike,
    *,
    direction: ArrayLike | None = None,
    start: Configuration | None = None,
    reference: Configuration | None = None,
    min_margin: float = MIN_MARGIN,
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
        position,
        direction,
        start=start,
        reference=reference,
        min_margin=min_margin,
        limits=limits,
        weights=weights,
        obstacles=obstacles,
        options=options,
    )
    goal = replace(goal, clock=clock)
    if load is not None:
        return _under_load(goal, _without_load(start), load, fixed=reference is not None)
    solutions = answers_of(goal, start, every=all_solutions, on_failure=on_failure, reachable=reachable)
    return solutions if all_solutions else solutions[0]


def answers_of(
    goal: Goal,
    start: Configuration | None,
    *,
    every: bool = False,
    on_failure: str = "raise",
    reachable: bool = False,
) -> list[InverseSolution]:
    """Solution of a goal, or all of them."""
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
    solutions = (search.all() if every else search.one()) or [search.failure(on_failure)]
    if reachable:
        origin = first if first is not None else known_home(goal.space)
        solutions = [with_path(each, origin, goal) for each in solutions]
    return solutions


def _under_load(goal: Goal, start: Configuration | None, load: Load, *, fixed: bool) -> InverseSolution:
    """Solution with its loaded equilibrium on target, and margin and clearance under the load.

    It stays near the start, or near the reference of the goal if that is `fixed`. If the loaded arm lacks margin or
    clearance, that of the unloaded arm is raised by the missing amount.
    """
    if goal.direction_weight is not None:
        raise InputError("direction_weight is given; under load a direction is a constraint or free")
    unloaded_goal, last = goal, start
    for _ in range(MAX_SHOTS):
        last, e = _aim(unloaded_goal, last, load, fixed=fixed)
        answer = _loaded_answer(last, e, goal)
        lacking_margin = goal.min_margin - e.margin
        lacking_clearance = goal.clearance - ArmSurface(e).clearance(goal.scene) if goal.scene.bodies else -1.0
        if lacking_margin <= 0 and lacking_clearance <= 0:
            return answer
        min_margin, clearance = unloaded_goal.min_margin, unloaded_goal.clearance
        if lacking_margin > 0:
            min_margin = min_margin + lacking_margin + AIM_EXCESS
        if lacking_clearance > 0:
            clearance = clearance + lacking_clearance + AIM_EXCESS * float(e.arc_length[-1])
        if min_margin >= 1:
            break
        options = replace(unloaded_goal.options, clearance=clearance)
        unloaded_goal = replace(unloaded_goal, min_margin=min_margin, options=options)
    raise SolveError(
        f"the best solution under load has margin {e.margin:.3g}, and its clearance is "
        f"{1e3 * max(lacking_clearance, 0.0):.3g} mm too small",
        answer,
    )


def _without_load(start: Configuration | None) -> Configuration | None:
    """Start for inverse kinematics with its load removed."""
    known = getattr(start, "equilibrium", start)
    if isinstance(known, Equilibrium) and known.load is not None:
        return known.rotations, known.translations
    return start


def _aim(goal: Goal, last: Configuration | None, load: Load, *, fixed: bool) -> tuple[InverseSolution, Equilibrium]:
    """Solution without load that is on target after loading, by Broyden's method in the unloaded target.

    Unknowns are the position and, if it is required, the direction.
    """
    at, miss, poor = goal, np.inf, 0
    # The first slope assumes that the load moves all tips alike: the miss then changes as the target does.
    slope: Array = np.eye(3 if goal.direction is None else 6)
    before: Array | None = None
    step = slope[0]
    for _ in range(MAX_SHOTS):
        if isinstance(last, InverseSolution) and not fixed:
            q = goal.space.join(last.rotations, last.translations)
            at = replace(at, named=True, objective=at.objective or "nearest", reference=q)
        (last,) = answers_of(at, last)
        e = forward_kinematics(
            last.equilibrium.robot, last.rotations, last.translations, load=load, start=last.equilibrium
        )
        offset = goal.position - e.tip_position
        direction_error = 0.0 if goal.direction is None else angle(e.tip_rotation[:, 2], goal.direction)
        last_miss, miss = miss, max(float(np.linalg.norm(offset)) / float(e.arc_length[-1]), direction_error)
        if max(float(np.linalg.norm(offset)), direction_error) <= AIM_TOLERANCE:
            return last, e
        # Counted and not refused at once: Broyden's slope may still be that of the start.
        poor += miss > AIM_GAIN * last_miss
        if poor and miss <= STALLED:
            return last, e
        if poor > POOR_SHOTS:
            break
        length, residual = float(e.arc_length[-1]), offset
        if goal.direction is not None:
            # In m: a direction error of 1 rad counts as one length of the arm.
            residual = np.concatenate([offset, length * (goal.direction - e.tip_rotation[:, 2])])
        if before is not None:
            slope = broyden(slope, step, before - residual)
        before, step = residual, np.linalg.solve(slope, residual)
        at = replace(at, position=at.position + step[:3])
        if at.direction is not None:
            along = at.direction + step[3:] / length
            at = replace(at, direction=along / np.linalg.norm(along))
    raise SolveError(
        f"the loaded robot misses the target by {1e3 * np.linalg.norm(offset):.3g} mm; iterations did not converge"
    )


def _loaded_answer(unloaded: InverseSolution, e: Equilibrium, goal: Goal) -> InverseSolution:
    """Solution under load from that without."""
    at = posture_of(goal.space, e)
    return replace(
        unloaded,
        target_position=goal.position,
        target_direction=goal.direction,
        equilibrium=e,
        position_error=goal.position_error(at),
        direction_error=goal.direction_error(at),
        cold_start_agrees=None,
        straight_from_seed=None,
        # The path of the unloaded robot: the loaded robot was not followed along it.
        reachable=None,
        path=None,
    )


# A fifth of the tolerance of a solution.
STEP_TOLERANCE = 2e-9
"""Tolerance of a step, m and rad."""

# Derivatives of the last target are used for a whole step, so that its error grows with the square of the step.
MAX_MOVE = 0.02
"""Longest step of the tip, relative to the robot's length; farther targets are approached in parts along a
line."""

# Four halvings. Where the robot jumps even then, the branch most likely ends there.
MIN_PART = 1 / 16
"""Smallest part of a step that is divided to avoid a jump, relative to the longest part."""

# The motion in the null space stays below that towards the target, for which the linear model is trusted.
NULL_SPACE_STEP = 0.5
"""Length of the motion towards larger margin, relative to the motion towards the target."""

# Near a fold the margin falls like a square root, so that derivatives of earlier steps predict it too large.
CAREFUL = 0.15
"""Margin above its bound below which derivatives are computed anew for every step."""

# A point of the arm can move farther than the tip, which may only turn.
CLEARANCE_PER_MOVE, MIN_CLEARANCE = 4.0, 2e-4
"""Clearance above which a step ignores obstacles: per distance that the tip moves, and an additional constant, m."""

STALE_SOLVES, STALE_STEPS = 4, 8
"""Equilibria of a step, and steps, after which derivatives are computed anew."""

CLOSING_SECTION = 1e-3
"""Length, m, of a section that a step may close."""

LAST = "last target"
"""Origin of the path to a solution of a session."""


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives near a posture."""

    target: Array
    """Jacobian of the residual."""
    margin: Array
    """Gradient (m,) of the margin."""
    age: int
    """Number of steps since they were computed."""


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
        min_margin: float = MIN_MARGIN,
        limits: JointLimits | None = None,
        weights: tuple[ArrayLike, ArrayLike] | None = None,
        obstacles: Sequence[Obstacle] = (),
        options: InverseOptions = DEFAULT_OPTIONS,
    ) -> None:
        self._goal = pose_question(
            robot,
            np.zeros(3),
            start=start,
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
        """Last solution; None before the first."""
        return self._solution

    @small
    def solve(self, position: ArrayLike, *, direction: ArrayLike | None = None) -> InverseSolution:
        """The solution for the next target, near the last one.

        `.path` goes from the last solution to it without a jump, with joint values inserted where the straight path
        would jump. If there is no such path, `.jump` gives the reason.

        Raises:
            InputError: a target that is not three finite numbers, a direction of length zero.
            SolveError: the branch does not reach the target; the message states the miss and the active constraints.
                The session keeps its last state.
        """
        answers = self.solve_path(position, direction=direction)
        if len(answers) == 1:
            return answers[0]
        paths = [each.path for each in answers if each.path is not None]
        path = None
        if len(paths) == len(answers):
            tables = [np.concatenate([each.rotations, each.translations], axis=1) for each in paths]
            rows = np.concatenate([tables[0], *(table[1:] for table in tables[1:])])
            path = JointPath(LAST, *np.split(rows, 2, axis=1))
        self._solution = replace(
            answers[-1],
            reachable=None if path is None else True,
            path=path,
            jump=next((each.jump for each in answers if each.jump), ""),
            statistics=_summed([each.statistics for each in answers]),
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
            (answer,) = answers_of(goal, None)
            self._here, self._solution = posture_of(goal.space, answer.equilibrium), answer
            return [answer]
        if goal.pointed != self._pointed:
            self._near, self._pointed = None, goal.pointed
        before = self._here, self._near, self._solution
        try:
            return self._solve_line(goal, self._here)
        except SolveError:
            self._here, self._near, self._solution = before
            raise

    def _solve_line(self, goal: Goal, first: Posture) -> list[InverseSolution]:
        """Solutions along the line from a posture to a goal; parts with a jump of the robot are halved."""
        answers: list[InverseSolution] = []
        longest = 1 / _parts(goal, first)
        done, part, current = 0.0, longest, first
        while done < 1:
            part = min(part, 1 - done)
            end = done + part if done + part < 1 - 1e-9 else 1.0
            start_time = time.perf_counter()
            if goal.clock.over:
                raise SolveError(_stalled(goal, current))
            target = goal if end == 1 else _between(goal, first, end)
            step = self._step(target, goal, current)
            reason, safe = jump_between(goal, current, step.posture)
            if reason and part > longest * MIN_PART:
                try:
                    self._step(_between(goal, first, done + part / 2), goal, current)
                except SolveError:
                    pass  # a jump is better than no solution
                else:
                    part /= 2
                    continue
            answer = answer_at(
                target,
                step.posture,
                InverseStatus.REACHED,
                InverseStatistics(
                    method="gauss_newton",
                    start="seed",
                    tries=1,
                    iterations=1,
                    solves=step.solves,
                    seconds=time.perf_counter() - start_time,
                ),
                cold_start_agrees=None,
                straight_from_seed=safe,
                reachable=True if safe else None,
                path=joint_path_of(LAST, goal.space, [current.q, step.posture.q]) if safe else None,
                jump=reason,
            )
            answers.append(answer)
            self._here, self._near, self._solution = step.posture, step.slopes, answer
            done, part, current = end, min(2 * part, longest), step.posture
        if len(answers) == 1:
            return answers
        # The last solution alone if the straight path to it does not jump; small steps may end on another
        # branch.
        reason, safe = jump_between(goal, first, current)
        if reason:
            return answers
        path = joint_path_of(LAST, goal.space, [first.q, current.q])
        statistics = _summed([each.statistics for each in answers])
        self._solution = replace(answers[-1], path=path, straight_from_seed=safe, jump="", statistics=statistics)
        return [self._solution]

    def _allowed(self, start: Posture) -> Posture:
        """Start of the session; raises InputError if it is out of range or has too little margin."""
        if violation := self._goal.space.outside(start.q):
            raise InputError(f"start is out of range: {violation}")
        if start.margin < self._goal.kept_margin:
            raise InputError(
                f"start has margin {start.margin:.3g}; it must have more than min_margin, {self._goal.min_margin:g}"
            )
        return start

    def _step(self, goal: Goal, last: Goal, current: Posture) -> _SessionStep:
        """Step to a goal on the line to the `last` one; raises SolveError if the branch does not reach it."""
        slopes = self._near
        if current.margin < goal.kept_margin + CAREFUL or (slopes is not None and slopes.age >= STALE_STEPS):
            slopes = None
        solves = 0
        for attempt in _attempts(goal, current, slopes):
            end = _null_space_step(goal, attempt)
            solves += end.solves
            if end.posture is not None:
                return _SessionStep(end.posture, end.slopes if end.solves <= STALE_SOLVES else None, solves)
        search = reach(goal, current)
        if search.reached:
            return _SessionStep(search.posture, None, solves + search.solves)
        if not programmable(goal):
            raise SolveError(_stalled(last, search.posture))
        program = solve_program(replace(goal, objective="nearest", reference=current.q), current)
        if not program.reached or not same_posture(current.to(program.posture.q), program.posture):
            raise SolveError(_stalled(last, search.posture))
        return _SessionStep(program.posture, None, solves + search.solves + program.solves)


def _summed(parts: Sequence[InverseStatistics]) -> InverseStatistics:
    """Total cost of solving consecutive steps."""
    iterations, solves = sum(each.iterations for each in parts), sum(each.solves for each in parts)
    return replace(parts[-1], iterations=iterations, solves=solves, seconds=sum(each.seconds for each in parts))


def _parts(goal: Goal, current: Posture) -> int:
    """Number of parts of a straight approach to a target."""
    count = int(np.ceil(float(np.linalg.norm(goal.position - current.tip)) / (MAX_MOVE * goal.space.length)))
    turned = goal.direction_error(current) if goal.pointed else 0.0
    return max(1, count, int(np.ceil(turned / (10 * MAX_MOVE))))


def _between(goal: Goal, first: Posture, fraction: float) -> Goal:
    """Goal at a fraction of the line from a posture to a goal."""
    part = replace(goal, position=first.tip + (goal.position - first.tip) * fraction)
    if not goal.pointed:
        return part
    return replace(part, direction=scipy.spatial.geometric_slerp(first.direction, goal.direction, fraction))


class _SessionStep(NamedTuple):
    """Result of a session step to the next target."""

    posture: Posture
    slopes: _Slopes | None
    """Derivatives for the next step; None if they must be computed anew."""
    solves: int
    """Number of equilibria solved."""


class _Attempt(NamedTuple):
    """Settings of one step."""

    start: Posture
    slopes: _Slopes
    order: OrderConstraints | None
    """Order of breakpoints to keep; None allows changes."""
    guarded: bool
    """True if obstacles and custom constraints limit the step."""


def _attempts(goal: Goal, current: Posture, old_slopes: _Slopes | None) -> Iterator[_Attempt]:
    """Settings of a step, the fastest first.

    With derivatives of earlier steps, unguarded; with new ones, then guarded. Derivatives change with the order of
    breakpoints: so the last ones keep the order, from here and from beyond each near change.
    """
    clear = _is_clear(goal, current)
    if old_slopes is not None and clear:
        yield _Attempt(current, old_slopes, None, False)
    fresh = _Slopes(goal.slope(current), current.margin_slope(), 0)
    if clear:
        yield _Attempt(current, fresh, None, False)
    if goal.hindered:
        yield _Attempt(current, fresh, None, True)
    yield _Attempt(current, fresh, breakpoint_order(goal.space, current), True)
    for crossed in crossings(goal, current, CLOSING_SECTION):
        slopes = _Slopes(goal.slope(crossed), crossed.margin_slope(), 0)
        yield _Attempt(crossed, slopes, breakpoint_order(goal.space, crossed), True)


def _is_clear(goal: Goal, current: Posture) -> bool:
    """True if a step to the target is short compared with the distance from obstacles."""
    if goal.extras.constraints:
        return False
    enough = goal.kept_clearance + MIN_CLEARANCE + CLEARANCE_PER_MOVE * goal.position_error(current)
    return current.surface.clearance(goal.scene, enough) >= enough


class _StepEnd(NamedTuple):
    """Result of one step."""

    posture: Posture | None
    """Posture after the step; None if it violates a constraint."""
    slopes: _Slopes
    """Derivatives as the step has updated them."""
    solves: int
    """Number of equilibria solved."""


def _null_space_step(goal: Goal, attempt: _Attempt) -> _StepEnd:
    """Step to the target and, in the null space, towards larger margin, then corrections."""
    current, slopes, order, guarded = attempt
    residual = goal.residual(current)
    if goal.reached(current, STEP_TOLERANCE, STEP_TOLERANCE):
        return _StepEnd(current, slopes, 0)
    rows, bounds = goal.space.inequalities(current.q)
    if current.margin < goal.kept_margin + CAREFUL or (guarded and goal.hindered):
        rows, bounds = goal.inequalities(current)
    if order is not None:
        rows, bounds = order.constrain(current.q, rows, bounds)
    scale = goal.space.scale
    # The length of the shortest motion to the target limits that in the null space.
    size = float(np.linalg.norm(np.linalg.pinv(slopes.target * scale) @ residual))
    ascent = slopes.margin * scale if current.margin < 1 - 1e-6 else np.zeros(len(scale))
    steepness = float(np.linalg.norm(ascent))
    if steepness > 0:
        ascent = ascent * (NULL_SPACE_STEP * size * min(1.0, 1.0 / steepness))
    target = on_target(slopes.target, residual)
    chosen = StepModel(np.diag(1 / scale), ascent, *target, rows, np.minimum(bounds, 0.0)).step(scale, FIRST_STEP)
    if chosen is None:
        return _StepEnd(None, slopes, 1)
    max_steps = 4 if order is None else 8
    end = moved(goal, current, chosen.x, slopes.target, tolerance=STEP_TOLERANCE, max_steps=max_steps, order=order)
    return _StepEnd(end.iterate, _Slopes(end.slope, slopes.margin, slopes.age + 1), end.solves)


def _stalled(goal: Goal, at: Posture) -> str:
    """Message of a session that cannot reach its target."""
    if goal.clock.over:
        return f"the time limit was reached before the target: {miss_text(goal, at)}"
    why = ", ".join(active_constraints(goal, at)) or "the branch of equilibria does not continue"
    return f"the target cannot be reached from here: {miss_text(goal, at)}: {why}"
