"""Start and goals of a plan as equilibria, and tests of a tip goal before any search.

No tip can be in an obstacle, farther than the longest arm, or behind a box that no arm can pass. Beyond that, a relaxed
problem is tested: without margin, branch, ranges of rotations, obstacles and direction of the tip, but with ranges of
the translations and the order of the tubes. A place that is unreachable there is unreachable; but if only the best of
some local searches fails, that is evidence, not a proof.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..bodies.frames import Frame
from ..bodies.obstacles import Box
from ..display import Displayed
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.kinematics import forward_kinematics, under_load
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, vector
from ..inverse import InverseOptions, InverseSolution, inverse_kinematics
from ..inverse.clock import Clock
from ..inverse.gauss_newton import reach
from ..inverse.goal import Goal, unit_vector
from ..inverse.joints import JointSpace, joints_of
from ..inverse.multistart import known_starts, nearest_starts, spread_starts
from ..inverse.posture import start_at
from ..inverse.task import TipCoordinates
from ..robots.limits import check_target
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.compiled.quadratic import constrained_least_squares
from ..stability.equilibria import find_equilibria
from ..typing import Array
from .question import PlanTask

# The test ends at the first start that comes near, so it costs little where a place is reachable.
STARTS, GAUSS_NEWTON_STEPS = 8, 20
"""Starts of the reachability test, half of them nearest in the table, half spread; and Gauss-Newton steps from each."""

SHORTER = 0.5 ** np.arange(5)
"""Fractions of a step that are tried."""

LONGEST_STEP = 0.4
"""Largest change of a coordinate, in units of the joints' scales."""

# At this distance the margin or the ranges may decide, which this test omits.
NEAR = 0.02
"""Distance from a target, relative to the robot's length, below which inverse kinematics decides."""

DIFFERENCE = 1e-5
"""Step of finite differences, in units of the scales."""


def check_position(task: PlanTask, position: Array) -> None:
    """Raise SolveError if the tip cannot be at a position (3,): in an obstacle, too far, or behind a box."""
    for k, obstacle in enumerate(task.obstacles):
        # No arm is thinner at its tip than the thinnest tube.
        clear = float(obstacle.signed_distance(position[None])[0] - task.coordinates.radius.min())
        if clear < task.clearance:
            raise SolveError(
                "no plan exists: with its tip at the goal, the clearance of the arm from "
                f"obstacle {k + 1} ({type(obstacle).__name__}) is at most {clear * 1e3:.4g} "
                f"mm; it must be at least {task.clearance * 1e3:g} mm"
            )
    longest, far = task.coordinates.space.longest, float(np.linalg.norm(position))
    if far > longest:
        raise SolveError(
            f"no plan exists: the goal is {far * 1e3:.4g} mm from the base plate; the "
            f"longest arm is {longest * 1e3:.4g} mm"
        )
    for k, body in enumerate(task.obstacles):
        around = path_around(body, position) if isinstance(body, Box) else 0.0
        if around > longest:
            raise SolveError(
                f"no plan exists: obstacle {k + 1} (Box) is between base plate and goal; a "
                f"path around it is at least {around * 1e3:.4g} mm long; the longest arm is "
                f"{longest * 1e3:.4g} mm"
            )


def path_around(box: Box, position: Array) -> float:
    """Lower bound on the length (m) of a path from the plate around a box to a position (3,).

    0 if the box is not between them.

    Where plate and position are on opposite sides of the box along an axis, a path passes the plane in the middle of
    the box beyond one of its four sides: at best on the edge of that side, unfolded about it.
    """
    low, high, longest = np.array(box.low), np.array(box.high), 0.0
    for k in range(3):
        if not min(0.0, position[k]) < low[k] < high[k] < max(0.0, position[k]):
            continue
        middle, lengths = (low[k] + high[k]) / 2, []
        for i in range(3):
            for edge, side in ((low[i], -1.0), (high[i], 1.0)) if i != k else ():
                # From a point that is itself beyond the side, the plane is reached along a straight line.
                reach = [np.hypot(max(side * (edge - p[i]), 0.0), middle - p[k]) for p in (np.zeros(3), position)]
                along = position[3 - i - k]
                # Unfolded about the edge both parts are in one plane. Across the edge they add up; `along` is the other
                # side of the right triangle.
                lengths.append(float(np.hypot(sum(reach), along)))
        # Every axis gives a lower bound; the largest one counts.
        longest = max(longest, min(lengths))
    return longest


def least_miss(task: PlanTask, position: Array, clock: Clock | None = None) -> float:
    """Distance (m) of the tip from a position (3,) after the best of some searches; 0 if near, or without time."""
    space = task.coordinates.space
    target = (position, None)
    known = nearest_starts(space, known_starts(space, clock), target, min_margin=0.0, reference=None)
    smallest = np.inf
    for q in spread_starts(space, known, STARTS, first=STARTS // 2):
        if clock is not None and clock.over:
            return 0.0
        smallest = min(smallest, approach(task, q, position, enough=NEAR * space.length)[0])
        if smallest <= NEAR * space.length:
            return 0.0
    return float(smallest) if np.isfinite(smallest) else 0.0


def approach(
    task: PlanTask, start: Array, position: Array, *, enough: float, valid: bool = False
) -> tuple[float, Array]:
    """Distance of the tip from a position (3,), m, after Gauss-Newton from tip coordinates (m,), and the last ones.

    Args:
        enough: distance at which the search ends, m.
        valid: stay where margin, clearance and ranges hold, as they must at the start.
    """
    z, tips = start, tips_about(task, start)
    miss = float(np.linalg.norm(tips[0] - position))
    for _ in range(GAUSS_NEWTON_STEPS):
        step = None if miss <= enough else step_towards(task, z, tips, position)
        if step is None:
            break
        tried = z + SHORTER[:, None] * step
        arms = task.arms(tried) if valid else task.coordinates.arms(tried, 0.0)
        left = np.linalg.norm(arms.tip - position, axis=1)
        if valid:
            left[task.reserves(tried, arms=arms) < 0] = np.inf
        best = int(left.argmin())
        # A step that gains less than a thousandth is at a local minimum, or at a limit.
        if left[best] > (1 - 1e-3) * miss:
            break
        z, miss = tried[best], float(left[best])
        tips = tips_about(task, z)
    return miss, z


def tips_about(task: PlanTask, z: Array) -> Array:
    """(m + 1, 3) tips at tip coordinates z (m,), and after a step of DIFFERENCE along each coordinate, m."""
    return task.coordinates.arms(z + np.vstack([np.zeros(len(z)), DIFFERENCE * np.diag(task.scale)]), 0.0).tip


def step_towards(task: PlanTask, z: Array, tips: Array, position: Array) -> Array | None:
    """(m,) damped Gauss-Newton step of a point towards a tip position, from its `tips_about`; None if infeasible."""
    residual = (tips - position) / task.coordinates.space.length
    constraints = step_constraints(task, z, LONGEST_STEP)
    step = damped_step(residual, DIFFERENCE, 1e-3, constraints)
    return None if step is None else np.asarray(step * task.scale)


def damped_step(residuals: Array, difference: float, damping: float, constraints: tuple[Array, Array]) -> Array | None:
    """(m,) damped Gauss-Newton step, in units of the scales; None if the constraints are infeasible.

    `residuals` (m + 1, r): at the point, and a `difference` farther along each coordinate.
    """
    slope, m = ((residuals[1:] - residuals[0]) / difference).T, len(residuals) - 1
    # |J d + g|^2 + damping^2 |d|^2 as rows of one least-squares problem.
    weights = np.vstack([slope, damping * np.eye(m)])
    solution = constrained_least_squares(weights, np.append(-residuals[0], np.zeros(m)), *constraints)
    return None if solution is None else solution.x


def step_constraints(task: PlanTask, z: Array, longest: float) -> tuple[Array, Array]:
    """Constraints, rows d >= bounds, of a step d in units of the scales: ranges of translations, order, step size."""
    space = task.coordinates.space
    n, m = space.robot.n_tubes, len(z)
    unit = np.eye(m)
    rows = [unit[n:], -unit[n:], space.rows * space.scale, unit, -unit]
    bounds = [(space.lower - z)[n:] / space.scale[n:], (z - space.upper)[n:] / space.scale[n:]]
    bounds += [space.row_lower - space.rows @ z, np.full(2 * m, -longest)]
    # At most 0: the step 0 is allowed even from a point that is slightly out of range.
    return np.vstack(rows), np.minimum(np.concatenate(bounds), 0.0)


# Files have joint values to six digits.
ROUNDED = 1e-6
"""Excess of an end over the range of a joint, in units of its scale, that is rounding of a file."""

FINISHED = 1e-6
"""Shortfall of the margin of an end that is round-off of forward kinematics."""


# A time limit has to be positive.
MIN_SECONDS = 1e-3
"""Time limit of inverse kinematics when no time is left, s: it only evaluates its start."""


MAX_ENDS = 12
"""Largest number of final equilibria of a plan, nearest to the start first."""

# Turns farther from the start only make paths longer.
MAX_TURNS = 3
"""Maximum number of full turns of one tube that are tried, nearest to the start first."""

# The first point of a region and the one farthest from it.
SEARCHED_TARGETS = 2
"""Number of points of a region with a search for other configurations."""

# Far above the accuracy of inverse kinematics, far below the distance of two configurations.
SAME_END = 1e-3
"""Ends closer than this in every coordinate, in units of the joints' scales, are one."""

# The grid of tip rotations grows exponentially with the tubes.
SEARCHED_TUBES, SEARCH_SECONDS = 3, 30.0
"""Largest number of tubes with a search for all equilibria at joint values, and remaining time, s, required otherwise.

The search cannot be interrupted. With less time, only forward kinematics is tried.
"""

# A second end shortens short paths by a tenth.
NEAR_POINTS, ENOUGH_ENDS = 8, 2
"""Roadmap nodes, nearest tip first, that start the inverse kinematics of the goal; and solutions that suffice."""

# Without joint values of the goal no path can be searched, so most of the time is for them.
GOALS_FRACTION = 0.6
"""Fraction of the remaining time after which no further starts are tried for joint values of a tip goal."""


def checked_points(targets: ArrayLike, name: str = "targets") -> Array:
    """(N, 3) positions, m; raises InputError for a table of another shape or without numbers."""
    try:
        points = np.array(targets, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not a table of numbers; it must have rows of x, y, z in m") from None
    if points.ndim != 2 or not len(points) or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"{name} has shape {points.shape}; it must be rows of finite x, y, z in m, at least one")
    return points


@dataclass(frozen=True, eq=False)
class TipGoal(Displayed):
    """Goal for the position and direction of the tip.

    Raises:
        InputError: a position that is not three finite numbers, or a table of such rows; a direction without length.
    """

    position: Array
    """(3,) position of the tip, m. A table (N, 3) is a region: any row meets the goal; rows are tried in order."""
    direction: Array | None = None
    """(3,) direction of the tip; None if free."""

    def __post_init__(self) -> None:
        try:
            table = np.ndim(self.position) == 2
        except ValueError:  # rows of several lengths
            table = True
        if table:
            object.__setattr__(self, "position", checked_points(self.position, "position of the goal"))
        else:
            position = vector("position of the goal", self.position, 3, "x, y, z of the tip in m")
            object.__setattr__(self, "position", position)
        if self.direction is not None:
            object.__setattr__(self, "direction", unit_vector("direction of the goal", self.direction))

    def single_goals(self) -> list[TipGoal]:
        """Goals of one position each: for a region, the first position and five that are as far apart as possible."""
        position = self.position
        if position.ndim != 2:
            return [self]
        chosen = [0]
        far = np.linalg.norm(position - position[0], axis=1)
        while len(chosen) < 6 and far.max() > 0:
            chosen.append(int(far.argmax()))
            far = np.minimum(far, np.linalg.norm(position - position[chosen[-1]], axis=1))
        return [TipGoal(position[k], self.direction) for k in chosen]


@dataclass(frozen=True, eq=False)
class End:
    """Equilibrium in which a plan may end."""

    point: Array
    """(m,) tip coordinates."""
    joints: Array
    """(m,) joint values."""
    turns: tuple[int, ...]
    """Full turns added to the rotations of the goal."""


def start_equilibrium(space: JointSpace, start: Any, load: Load | None = None, name: str = "start") -> Equilibrium:
    """Equilibrium at the start of a plan, under the load; raises InputError or SolveError if it does not exist."""
    known = start.equilibrium if isinstance(start, InverseSolution) else start
    if not isinstance(known, Equilibrium):
        rotations, shift = joints_of(space, name, start)
        return forward_kinematics(space.robot, rotations, shift, load=load)
    if known.robot != space.robot:
        raise InputError(f"{name} is an equilibrium of another robot")
    return known if load is None or known.load == load else under_load(known, load)


def check_start(task: PlanTask, start: Equilibrium) -> None:
    """Raise if a plan cannot begin: out of range (InputError); margin or clearance too small (SolveError)."""
    _in_range(task.coordinates.space, "start", start.rotations, start.translations)
    if fault := _fault(task, "start", start):
        raise SolveError(fault, start)


def ends(
    task: PlanTask,
    start: Equilibrium,
    goal: Any,
    clock: Clock | None = None,
    *,
    modulo_turns: bool = False,
    nearby: Callable[[Array], Array] | None = None,
    enough: int = 1,
) -> list[End]:
    """Equilibria at a goal, nearest to the start first.

    Args:
        clock: time for the search of joint values with the tip at a goal.
        nearby: tip coordinates (k, m) with tips near a position (3,), from which a tip goal is solved first, up to
            `enough` equilibria; if that fails, it is solved from the start.

    Raises:
        InputError: a goal that is out of range.
        SolveError: no equilibrium at the goal has the required margin and clearance.
    """
    clock = clock or Clock(math.inf)
    equilibria, complete = _near_equilibria(task, goal, nearby, enough, clock), False
    if not equilibria:
        equilibria, complete = _equilibria(task, start, goal, clock)
    reasons: list[str] = []
    if task.coordinates.load is not None:
        equilibria, reasons = loaded(equilibria, task.coordinates.load)
    faults = [_fault(task, "goal", e) for e in equilibria]
    good = [e for e, fault in zip(equilibria, faults, strict=True) if not fault]
    if not good:
        reason = next(iter(reasons + faults), "no plan exists: the goal has no stable equilibrium")
        partly = "no plan was found, as far as the equilibria at the goal are known"
        raise SolveError(reason if complete else reason.replace("no plan exists", partly))
    out = [end for e in good for end in _turned(task, e, start.rotations, modulo_turns)]
    if not out:
        raise InputError("goal is out of range: no number of full turns brings its rotations into the limits")
    return _nearest(task, start, out)


def requested_ends(task: PlanTask, start: Equilibrium, goal: Any, enough: int) -> list[End]:
    """Equilibria at a goal by the options of the task; for a tip goal, up to `enough` found from a roadmap."""
    known = task.options.roadmap
    nearby = None if known is None else partial(known.near, task, count=NEAR_POINTS)
    clock = Clock(GOALS_FRACTION * task.clock.left)
    return ends(task, start, goal, clock, modulo_turns=task.options.modulo_turns, nearby=nearby, enough=enough)


def _nearest(task: PlanTask, start: Equilibrium, candidates: list[End]) -> list[End]:
    """Ends nearest to the start, at most MAX_ENDS."""
    origin = task.coordinates.of(start)
    by_distance = sorted(candidates, key=lambda end: float(np.linalg.norm((end.point - origin) / task.scale)))
    return by_distance[:MAX_ENDS]


def loaded(equilibria: Sequence[Equilibrium], load: Load) -> tuple[list[Equilibrium], list[str]]:
    """Equilibria under a load, and the reasons for missing ones."""
    good, reasons = [], []
    for e in equilibria:
        try:
            good.append(e if e.load == load else under_load(e, load))
        except SolveError as error:
            reasons.append(f"no plan was found: at the goal {error}")
    return good, reasons


def other_ends(
    task: PlanTask,
    start: Equilibrium,
    goal: Any,
    known: Sequence[End],
    clock: Clock,
    *,
    modulo_turns: bool = False,
) -> list[End]:
    """Equilibria at a tip goal in further configurations, nearest first; empty for other goals."""
    tip_goal = _tip_goal(goal)
    if tip_goal is None or task.coordinates.load is not None:
        return []
    postures: list[Equilibrium] = []
    for target in tip_goal.single_goals()[:SEARCHED_TARGETS]:
        arguments = _inverse_arguments(task, start, target, clock)
        with suppress(SolveError):  # none in so short a time
            solutions = inverse_kinematics(
                task.coordinates.space.robot, target.position, all_solutions=True, **arguments
            )
            postures += [solution.equilibrium for solution in solutions]
    good = [e for e in postures if not _fault(task, "goal", e)]
    fresh = [
        end
        for e in good
        for end in _turned(task, e, start.rotations, modulo_turns)
        if all(np.abs((end.point - known_end.point) / task.scale).max() > SAME_END for known_end in known)
    ]
    return _nearest(task, start, fresh)


def check_goal(robot: Robot, goal: Any) -> None:
    """Raise InputError for a tip goal in other units than m."""
    if (tip_goal := _tip_goal(goal)) is not None:
        check_target(robot.tubes, "goal", tip_goal.position)


def of_the_tip(goal: Any) -> bool:
    """True if a goal is a tip pose, which several configurations may reach."""
    return _tip_goal(goal) is not None


def goal_seen(goal: Any, frame: Frame) -> Any:
    """Goal in the frame of a plate; only tip goals change."""
    tip_goal = _tip_goal(goal)
    if tip_goal is None:
        return goal
    direction = tip_goal.direction
    if direction is not None:
        direction = direction @ frame.axes
    return TipGoal(frame.seen(tip_goal.position), direction)


def _tip_goal(goal: Any) -> TipGoal | None:
    if isinstance(goal, TipGoal):
        return goal
    if isinstance(goal, (Equilibrium, InverseSolution)) or (isinstance(goal, (tuple, list)) and len(goal) == 2):
        return None
    return TipGoal(vector("goal", goal, 3, "x, y, z of the tip in m"))


def _equilibria(task: PlanTask, start: Equilibrium, goal: Any, clock: Clock) -> tuple[list[Equilibrium], bool]:
    """Equilibria at a goal, and True if a systematic search proves that there are no others."""
    space = task.coordinates.space
    if isinstance(goal, InverseSolution):
        goal = goal.equilibrium
    if isinstance(goal, Equilibrium):
        if goal.robot != space.robot:
            raise InputError("goal is an equilibrium of another robot")
        return [goal], True
    tip_goal = _tip_goal(goal)
    if tip_goal is not None:
        return _first_reachable(task, start, tip_goal.single_goals(), clock), False
    rotations, shift = joints_of(space, "goal", goal)
    equilibria: list[Equilibrium] = []
    chart = task.coordinates
    few = isinstance(chart, TipCoordinates) and (chart.kind.eccentric or space.robot.n_tubes <= SEARCHED_TUBES)
    # All equilibria of a bundle cannot be searched: the one of `fk` is taken.
    if space.robot.fixed_sections and (few or clock.left > SEARCH_SECONDS):
        with suppress(SolveError):
            equilibria = [e for e in find_equilibria(space.robot, rotations, shift) if e.stable]
    complete = bool(equilibria) and few
    if not equilibria:
        equilibria = [forward_kinematics(space.robot, rotations, shift)]
    # A large margin is the best sign of a branch that the robot can reach.
    return sorted(equilibria, key=lambda e: -e.margin), complete


def _near_equilibria(
    task: PlanTask, goal: Any, nearby: Callable[[Array], Array] | None, enough: int, clock: Clock
) -> list[Equilibrium]:
    """Equilibria at a tip goal, by Gauss-Newton from known points near it.

    Any valid ones, in a fraction of the time that the one nearest to the start takes.
    """
    tip_goal = _tip_goal(goal)
    if nearby is None or tip_goal is None or task.coordinates.load is not None:
        return []
    space, equilibria = task.coordinates.space, list[Equilibrium]()
    options, weights = _options(task, clock.left), 1 / space.scale
    for target in tip_goal.single_goals():
        # Twice the tolerance of `_fault`, which must not reject a solution for round-off.
        question = Goal(
            space=space,
            position=target.position,
            direction=target.direction,
            min_margin=task.min_margin + 2 * FINISHED,
            scene=task.scene,
            objective=None,
            named=False,
            reference=space.middle(),
            weights=weights,
            options=options,
            clock=clock,
        )
        points = nearby(question.position)
        for q in task.coordinates.joints(points):
            start = start_at(space, q)
            if start is None or start.margin < question.kept_margin or not start.admissible:
                continue
            search = reach(question, start)
            if search.reached and not _fault(task, "goal", search.posture.equilibrium):
                equilibria.append(search.posture.equilibrium)
            if len(equilibria) == enough:
                return equilibria
    return equilibria


def _first_reachable(task: PlanTask, start: Equilibrium, targets: list[TipGoal], clock: Clock) -> list[Equilibrium]:
    """Equilibrium near the start with its tip at the first reachable one of some goals."""
    errors: list[SolveError] = []
    for k, target in enumerate(targets):
        try:
            return _solve_tip(
                task, start, target, clock if len(targets) == 1 else Clock(clock.left / (len(targets) - k))
            )
        except SolveError as error:
            errors.append(error)
    if len(targets) == 1:
        raise errors[0]
    raise SolveError(f"no plan was found to {len(targets)} points of the region; to the first: {errors[0]}")


def _solve_tip(task: PlanTask, start: Equilibrium, goal: TipGoal, clock: Clock) -> list[Equilibrium]:
    """Equilibrium near the start with its tip at a goal, by inverse kinematics."""
    position = goal.position
    check_position(task, position)
    miss = 0.0 if task.coordinates.load is not None else least_miss(task, position, clock)
    if miss > 0:
        raise SolveError(
            "no plan was found: the searches did not reach the goal; the smallest distance "
            f"of the tip is {miss * 1e3:.4g} mm"
        )
    try:
        arguments = _inverse_arguments(task, start, goal, clock)
        solution = inverse_kinematics(task.coordinates.space.robot, position, **arguments)
    except SolveError as error:
        raise SolveError(f"no plan was found: inverse kinematics found no joint values for the goal: {error}") from None
    return [solution.equilibrium]


def _inverse_arguments(task: PlanTask, start: Equilibrium, goal: TipGoal, clock: Clock) -> dict[str, Any]:
    """Arguments of inverse kinematics for a tip goal, except for its position."""
    constraints = inverse_constraints(task, task.min_margin + 2 * FINISHED, clock.left)
    return {"load": task.coordinates.load, "direction": goal.direction, "start": start, **constraints}


def inverse_constraints(task: PlanTask, margin: float, seconds: float) -> dict[str, Any]:
    """Constraints and time limit of inverse kinematics for a task, with margins of at least `margin`."""
    options = _options(task, seconds)
    return {
        "min_margin": margin,
        "limits": task.coordinates.space.limits,
        "obstacles": task.obstacles,
        "options": options,
    }


def _options(task: PlanTask, seconds: float) -> InverseOptions:
    """Options of inverse kinematics with a time limit, s."""
    space = task.coordinates.space
    return InverseOptions(
        clearance=task.clearance,
        carriage_gap=space.carriage_gap,
        section_length=space.section_length,
        time_limit=max(seconds, MIN_SECONDS),
    )


def _in_range(space: JointSpace, name: str, rotations: Array, translations: Array) -> None:
    if message := space.outside(space.join(rotations, translations, name), ROUNDED):
        raise InputError(f"{name} is out of range: {message}")


def _fault(task: PlanTask, name: str, e: Equilibrium) -> str:
    """Message on a violated margin or clearance of an equilibrium; "" if there is none."""
    if e.margin < task.min_margin - FINISHED:
        return f"no plan exists: the {name} has margin {e.margin:.4g}; every point must keep {task.min_margin:g}"
    clear = ArmSurface(e).clearance(task.scene)
    if clear >= task.clearance:
        return ""
    where = "is inside an obstacle" if clear < 0 else f"has clearance {clear * 1e3:.4g} mm"
    distance = f"(least distance {clear * 1e3:.4g} mm); it must keep {task.clearance * 1e3:g} mm"
    return f"no plan exists: the arm at the {name} {where} {distance}"


def _turned(task: PlanTask, e: Equilibrium, start: Array, modulo: bool) -> list[End]:
    """Ends for an equilibrium; with `modulo`, also with full turns of its rotations within the limits.

    `start` (n,): rotations at the start, to which the turns are close.
    """
    space, n = task.coordinates.space, task.coordinates.space.robot.n_tubes
    if not modulo:
        _in_range(space, "goal", e.rotations, e.translations)
        return [_end(task, e, (0,) * n)]
    ranges = []
    for i in range(n):
        # 1e-6 of a turn keeps rotations at the very edge of the limits.
        first = int(np.ceil((space.lower[i] - e.rotations[i]) / (2 * np.pi) - 1e-6))
        last = int(np.floor((space.upper[i] - e.rotations[i]) / (2 * np.pi) + 1e-6))
        ranges.append(range(first, last + 1))
    _in_range(space, "goal", np.clip(e.rotations, space.lower[:n], space.upper[:n]), e.translations)
    # In wide ranges only the turns nearest to the start: there are many others, farther away.
    turn_choices = []
    for each, difference in zip(ranges, (start - e.rotations) / (2 * np.pi), strict=True):
        all_turns = np.array(each)
        turn_choices.append(all_turns[np.argsort(np.abs(all_turns - difference))][:MAX_TURNS].tolist())
    return [_end(task, e, turns) for turns in product(*turn_choices)]


def _end(task: PlanTask, e: Equilibrium, turns: Sequence[int]) -> End:
    q = task.coordinates.space.join(e.rotations, e.translations)
    change = 2 * np.pi * np.pad(turns, (0, len(q) - len(turns)))
    return End(task.coordinates.of(e) + change, q + change, tuple(turns))
