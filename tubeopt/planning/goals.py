"""Where a plan begins and where it may end, as equilibria; and what can be said before any search.

No tip can be in an obstacle, farther than any arm, or behind a box that no arm gets around. Beyond that, an easier
question is tested than the one that is asked. Margin, branch, ranges of rotations, obstacles and the direction of the
tip are left out; ranges of the translations and the order of the tubes are kept. Who cannot reach the place even so
cannot reach it at all; that the best of some local searches cannot is evidence, not a proof.
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
from ..equilibrium.kinematics import forward_kinematics, under_load
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, vector
from ..inverse import InverseOptions, InverseSolution, inverse_kinematics
from ..inverse.arm_surface import ArmSurface
from ..inverse.clock import Clock
from ..inverse.gauss_newton import reach
from ..inverse.goal import Goal, unit_vector
from ..inverse.joints import JointSpace, joints_of
from ..inverse.multistart import known_starts, nearest_starts, spread_starts
from ..inverse.posture import start_at
from ..robots.limits import check_target
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.quadratic import constrained_least_squares
from ..stability.equilibria import find_equilibria
from ..typing import Array
from .question import PlanTask

# The test ends at the first start that comes near, and so costs little where a place can be reached.
STARTS, STEPS = 8, 20
"""Starts of the test for unreachable places, half of them nearest in the table, half spread; and Gauss-Newton steps
from each."""

LONGEST_STEP = 0.4
"""Largest change of a coordinate, in units of the joints' scales."""

# Who comes this close may be kept off by the margin or by the ranges, which this test leaves out.
NEAR = 0.02
"""Miss, as a share of the robot's length, below which a place is left to inverse kinematics."""

DIFFERENCE = 1e-5
"""Step of the differences, in units of the scales."""


def check_place(task: PlanTask, position: Array) -> None:
    """Raise SolveError where the tip cannot be at a place: an obstacle is there, or no arm is long enough, straight or
    around a box."""
    for k, obstacle in enumerate(task.obstacles):
        # No arm is thinner at its tip than the thinnest tube.
        clear = float(obstacle.signed_distance(position[None])[0] - task.chart.radius.min())
        if clear < task.clearance:
            raise SolveError(
                "no plan exists: with its tip at the goal, the clearance of the arm from "
                f"obstacle {k + 1} ({type(obstacle).__name__}) is at most {clear * 1e3:.4g} "
                f"mm; it must be at least {task.clearance * 1e3:g} mm"
            )
    longest, far = task.chart.space.longest, float(np.linalg.norm(position))
    if far > longest:
        raise SolveError(
            f"no plan exists: the goal is {far * 1e3:.4g} mm from the base plate; the "
            f"longest arm is {longest * 1e3:.4g} mm"
        )
    for k, body in enumerate(task.obstacles):
        around = way_around(body, position) if isinstance(body, Box) else 0.0
        if around > longest:
            raise SolveError(
                f"no plan exists: obstacle {k + 1} (Box) is between base plate and goal; a "
                f"path around it is at least {around * 1e3:.4g} mm long; the longest arm is "
                f"{longest * 1e3:.4g} mm"
            )


def way_around(box: Box, position: Array) -> float:
    """Length (m) that a way from the plate to a place is at least, since a box lies between them; 0 where it does not.

    Where plate and place are on either side of the box along an axis, a way passes the plane in the middle of the box
    beyond one of its four sides there: at best on the edge of that side, unfolded about it.
    """
    low, high, longest = np.array(box.low), np.array(box.high), 0.0
    for k in range(3):
        if not min(0.0, position[k]) < low[k] < high[k] < max(0.0, position[k]):
            continue
        middle, ways = (low[k] + high[k]) / 2, []
        for i in range(3):
            for edge, side in ((low[i], -1.0), (high[i], 1.0)) if i != k else ():
                # From a point that is itself beyond the side the plane is reached straight on.
                reach = [np.hypot(max(side * (edge - p[i]), 0.0), middle - p[k]) for p in (np.zeros(3), position)]
                along = position[3 - i - k]
                # Unfolded about the edge both parts lie in one plane. Across the edge they add up;
                # `along` is the other leg.
                ways.append(float(np.hypot(sum(reach), along)))
        # Every axis gives a lower bound of its own, and the largest of them counts.
        longest = max(longest, min(ways))
    return longest


def least_miss(task: PlanTask, position: Array, clock: Clock | None = None) -> float:
    """Distance (m) from a place (3,) at which the tip ends in the best of some searches; 0 where one comes near, and
    where the clock is over before all of them ended."""
    space = task.chart.space
    target = (position, None)
    known = nearest_starts(space, known_starts(space, clock), target, min_margin=0.0, reference=None)
    least = np.inf
    for q in spread_starts(space, known, STARTS, first=STARTS // 2):
        if clock is not None and clock.over:
            return 0.0
        least = min(least, _closest(task, q, position))
        if least <= NEAR * space.length:
            return 0.0
    return float(least) if np.isfinite(least) else 0.0


def _closest(task: PlanTask, start: Array, position: Array) -> float:
    """Distance at which Gauss-Newton from joint values (m,), taken for tip rotations, ends, m."""
    length, z = task.chart.space.length, start
    miss = np.inf
    for _ in range(STEPS):
        tips = tips_about(task, z)
        here = float(np.linalg.norm(tips[0] - position))
        # A step that gains less than a thousandth has come to a local minimum, or to a limit.
        if here > (1 - 1e-3) * miss:
            break
        miss = here
        step = None if miss <= NEAR * length else step_towards(task, z, tips, position)
        if step is None:
            break
        z = z + step
    return miss


def tips_about(task: PlanTask, z: Array) -> Array:
    """(m + 1, 3) tips, m, at a point (m,) of the chart and a DIFFERENCE farther along each coordinate."""
    return task.chart.arms(z + np.vstack([np.zeros(len(z)), DIFFERENCE * np.diag(task.scale)]), 0.0).tip


def step_towards(task: PlanTask, z: Array, tips: Array, position: Array) -> Array | None:
    """(m,) the damped step of Gauss-Newton by which tips `tips_about` a point come closer to a place; None for none."""
    gap = (tips - position) / task.chart.space.length
    constraints = step_constraints(task, z, LONGEST_STEP)
    step = damped_step(gap, DIFFERENCE, 1e-3, constraints)
    return None if step is None else np.asarray(step * task.scale)


def damped_step(gaps: Array, difference: float, damping: float, constraints: tuple[Array, Array]) -> Array | None:
    """(m,) the step of Gauss and Newton, in units of the scales, that makes a gap (r,) small; None where the
    constraints leave none. `gaps` (m + 1, r): here, and a `difference` farther along each coordinate."""
    slope, m = ((gaps[1:] - gaps[0]) / difference).T, len(gaps) - 1
    # |J d + g|^2 + damping^2 |d|^2 as rows of one least-squares problem.
    weights = np.vstack([slope, damping * np.eye(m)])
    found = constrained_least_squares(weights, np.append(-gaps[0], np.zeros(m)), *constraints)
    return None if found is None else found.x


def step_constraints(task: PlanTask, z: Array, longest: float) -> tuple[Array, Array]:
    """Rows and bounds of a step in units of the scales: ranges of the translations, order, and no change of a
    coordinate beyond the longest."""
    space = task.chart.space
    n, m = space.robot.n_tubes, len(z)
    unit = np.eye(m)
    rows = [unit[n:], -unit[n:], space.rows * space.scale, unit, -unit]
    bounds = [(space.lower - z)[n:] / space.scale[n:], (z - space.upper)[n:] / space.scale[n:]]
    bounds += [space.least - space.rows @ z, np.full(2 * m, -longest)]
    # At most 0: the step 0 is allowed even from a point that is slightly out of range.
    return np.vstack(rows), np.minimum(np.concatenate(bounds), 0.0)


# Files have joint values to six digits.
ROUNDED = 1e-6
"""Share of a joint's scale by which an end may be out of range: joint values of a file are rounded."""

FINISHED = 1e-6
"""Margin by which an end may fall short: round-off of forward kinematics."""


# A time limit has to be positive.
LEAST_SECONDS = 1e-3
"""Time limit of inverse kinematics where none is left: it looks at where it begins, and says what it knows."""


MOST_ENDS = 12
"""Maximum number of equilibria at which a plan may end, nearest to the start first."""

# Turns farther from the start only make paths longer.
MOST_TURNS = 3
"""Maximum number of full turns of one tube that are tried, nearest to the start first."""

# The first point of a region and the one farthest from it.
PLACES = 2
"""Number of points of a region for which other configurations are searched."""

# Far above the accuracy of inverse kinematics, far below the distance of two configurations.
SAME_END = 1e-3
"""Ends closer than this in every coordinate, in units of the joints' scales, are one."""

# The grid of tip rotations grows exponentially with the tubes.
SEARCHED_TUBES, SEARCH_SECONDS = 3, 30.0
"""Largest number of tubes for which all equilibria at joint values are searched in any case. For more, so many seconds
must be left, because that cannot be interrupted; otherwise that of forward kinematics is tried."""

# A second end shortens short paths by a tenth.
NEAR_POINTS, ENOUGH_ENDS = 8, 2
"""Roadmap nodes, nearest tip first, that start the inverse kinematics of the goal; and solutions that suffice."""

# A goal without joint values needs no path, so that most of the time goes here first.
GOALS_SHARE = 0.6
"""Share of the remaining time after which no further starts are tried for joint values of a tip goal."""


def checked_places(targets: ArrayLike, name: str = "targets") -> Array:
    """(N, 3) places, m; raises InputError for a table of another shape, or of what is no number."""
    try:
        places = np.array(targets, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is not a table of numbers; it must have rows of x, y, z in m") from None
    if places.ndim != 2 or not len(places) or places.shape[1] != 3 or not np.isfinite(places).all():
        raise InputError(f"{name} has shape {places.shape}; it must be rows of finite x, y, z in m, at least one")
    return places


@dataclass(frozen=True, eq=False)
class TipGoal(Displayed):
    """A pose of the tip.

    Raises:
        InputError: a position that is not three finite numbers, or a table of such rows; a direction without length.
    """

    position: Array
    """(3,) position of the tip, m. A table (N, 3) is a region: any row meets the goal, and they are tried in order."""
    direction: Array | None = None
    """(3,) along which it points; None is free."""

    def __post_init__(self) -> None:
        try:
            table = np.ndim(self.position) == 2
        except ValueError:  # rows of several lengths
            table = True
        if table:
            object.__setattr__(self, "position", checked_places(self.position, "position of the goal"))
        else:
            position = vector("position of the goal", self.position, 3, "x, y, z of the tip in m")
            object.__setattr__(self, "position", position)
        if self.direction is not None:
            object.__setattr__(self, "direction", unit_vector("direction of the goal", self.direction))

    def places(self) -> list[TipGoal]:
        """Goals of one position each: of a region the first, and five as far apart as can be."""
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
    """An equilibrium at which a plan may end."""

    point: Array
    """(m,) in the chart."""
    joints: Array
    """(m,)."""
    turns: tuple[int, ...]
    """Whole turns added to the goal as given."""


def start_equilibrium(space: JointSpace, start: Any, load: Load | None = None, name: str = "start") -> Equilibrium:
    """The equilibrium that a plan begins with, under the load; raises InputError and SolveError where there is none."""
    known = start.equilibrium if isinstance(start, InverseSolution) else start
    if not isinstance(known, Equilibrium):
        rotations, shift = joints_of(space, name, start)
        return forward_kinematics(space.robot, rotations, shift, load=load)
    if known.robot != space.robot:
        raise InputError(f"{name} is an equilibrium of another robot")
    return known if load is None or known.load == load else under_load(known, load)


def check_start(task: PlanTask, start: Equilibrium) -> None:
    """Raise where a plan cannot begin: out of range (InputError); margin or clearance too small (SolveError)."""
    _in_range(task.chart.space, "start", start.rotations, start.translations)
    if fault := _fault(task, "start", start):
        raise SolveError(fault, start)


def ends(
    task: PlanTask,
    start: Equilibrium,
    goal: Any,
    clock: Clock | None = None,
    *,
    modulo_turns: bool = False,
    near: Callable[[Array], Array] | None = None,
    enough: int = 1,
) -> list[End]:
    """The equilibria that meet a goal, the nearest first; for a goal of the tip they are looked for until the clock is
    over: from points (k, m) of the chart that are allowed and, as `near` knows, have their tips near a place (3,), so
    many as are `enough`, and where these lead nowhere, from the start.

    Raises:
        InputError: a goal that is out of range.
        SolveError: a goal that no equilibrium meets with the margin and clearance to keep.
    """
    clock = clock or Clock(math.inf)
    found, whole = _beside(task, goal, near, enough, clock), False
    if not found:
        found, whole = _equilibria(task, start, goal, clock)
    reasons: list[str] = []
    if task.chart.load is not None:
        found, reasons = loaded(found, task.chart.load)
    faults = [_fault(task, "goal", e) for e in found]
    good = [e for e, fault in zip(found, faults, strict=True) if not fault]
    if not good:
        reason = next(iter(reasons + faults), "no plan exists: the goal has no stable equilibrium")
        partly = "no plan was found, as far as the equilibria at the goal are known"
        raise SolveError(reason if whole else reason.replace("no plan exists", partly))
    out = [end for e in good for end in _turned(task, e, start.rotations, modulo_turns)]
    if not out:
        raise InputError("goal is out of range: no number of full turns brings its rotations into the limits")
    return _nearest(task, start, out)


def asked_ends(task: PlanTask, start: Equilibrium, goal: Any, enough: int) -> list[End]:
    """The equilibria at which a plan may end, as its options ask for them; for a goal of the tip first `enough` of
    those beside a roadmap."""
    known = task.options.roadmap
    near = None if known is None else partial(known.near, task, count=NEAR_POINTS)
    share = Clock(GOALS_SHARE * task.clock.left)
    return ends(task, start, goal, share, modulo_turns=task.options.modulo_turns, near=near, enough=enough)


def _nearest(task: PlanTask, start: Equilibrium, found: list[End]) -> list[End]:
    """Some of them, those nearest to the start first."""
    here = task.chart.of(start)
    by_distance = sorted(found, key=lambda end: float(np.linalg.norm((end.point - here) / task.scale)))
    return by_distance[:MOST_ENDS]


def loaded(found: Sequence[Equilibrium], load: Load) -> tuple[list[Equilibrium], list[str]]:
    """Equilibria as they are under a load, and why others are not."""
    good, reasons = [], []
    for e in found:
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
    """Further equilibria that meet the goal, if it is one of the tip, the nearest first: its other postures."""
    wanted = _tip_goal(goal)
    if wanted is None or task.chart.load is not None:
        return []
    postures: list[Equilibrium] = []
    for place in wanted.places()[:PLACES]:
        asked = _asked(task, start, place, clock)
        with suppress(SolveError):  # none in so short a time
            answers = inverse_kinematics(task.chart.space.robot, place.position, all_solutions=True, **asked)
            postures += [answer.equilibrium for answer in answers]
    good = [e for e in postures if not _fault(task, "goal", e)]
    found = [
        end
        for e in good
        for end in _turned(task, e, start.rotations, modulo_turns)
        if all(np.abs((end.point - other.point) / task.scale).max() > SAME_END for other in known)
    ]
    return _nearest(task, start, found)


def check_goal(robot: Robot, goal: Any) -> None:
    """Raise InputError for a goal of the tip that is in other units than m."""
    if (wanted := _tip_goal(goal)) is not None:
        check_target(robot.tubes, "goal", wanted.position)


def of_the_tip(goal: Any) -> bool:
    """Whether a goal is one of the tip, which several postures may meet."""
    return _tip_goal(goal) is not None


def goal_seen(goal: Any, frame: Frame) -> Any:
    """A goal as a plate sees it that stands in a frame: of the tip in its own axes, any other as it is."""
    known = _tip_goal(goal)
    if known is None:
        return goal
    towards = known.direction
    if towards is not None:
        towards = towards @ frame.axes
    return TipGoal(frame.seen(known.position), towards)


def _tip_goal(goal: Any) -> TipGoal | None:
    if isinstance(goal, TipGoal):
        return goal
    if isinstance(goal, (Equilibrium, InverseSolution)) or (isinstance(goal, (tuple, list)) and len(goal) == 2):
        return None
    return TipGoal(vector("goal", goal, 3, "x, y, z of the tip in m"))


def _equilibria(task: PlanTask, start: Equilibrium, goal: Any, clock: Clock) -> tuple[list[Equilibrium], bool]:
    """Equilibria that may meet a goal, and whether a systematic search found no others."""
    space = task.chart.space
    if isinstance(goal, InverseSolution):
        goal = goal.equilibrium
    if isinstance(goal, Equilibrium):
        if goal.robot != space.robot:
            raise InputError("goal is an equilibrium of another robot")
        return [goal], True
    wanted = _tip_goal(goal)
    if wanted is not None:
        return _somewhere(task, start, wanted.places(), clock), False
    rotations, shift = joints_of(space, "goal", goal)
    found: list[Equilibrium] = []
    if task.chart.eccentric or space.robot.n_tubes <= SEARCHED_TUBES or clock.left > SEARCH_SECONDS:
        with suppress(SolveError):
            found = [e for e in find_equilibria(space.robot, rotations, shift) if e.stable]
    whole = bool(found) and (task.chart.eccentric or space.robot.n_tubes <= SEARCHED_TUBES)
    if not found:
        found = [forward_kinematics(space.robot, rotations, shift)]
    # The margin tells best whether the branch is the one that the robot can be brought to.
    return sorted(found, key=lambda e: -e.margin), whole


def _beside(
    task: PlanTask, goal: Any, near: Callable[[Array], Array] | None, enough: int, clock: Clock
) -> list[Equilibrium]:
    """Equilibria whose tip has a pose, found by Gauss-Newton from what is known to be near: any that hold, in a
    fraction of the time in which that nearest to the start is found."""
    wanted = _tip_goal(goal)
    if near is None or wanted is None or task.chart.load is not None:
        return []
    space, found = task.chart.space, list[Equilibrium]()
    options, weights = _options(task, clock.left), 1 / space.scale
    for place in wanted.places():
        # Twice the tolerance of `_fault`, which must not refuse an answer for round-off.
        question = Goal(
            space,
            place.position,
            place.direction,
            task.min_margin + 2 * FINISHED,
            task.scene,
            None,
            False,
            space.middle(),
            weights,
            options,
            clock=clock,
        )
        points = near(question.position)
        for q in task.chart.joints(points):
            start = start_at(space, q)
            if start is None or start.margin < question.floor or not start.admissible:
                continue
            search = reach(question, start)
            if search.reached and not _fault(task, "goal", search.posture.equilibrium):
                found.append(search.posture.equilibrium)
            if len(found) == enough:
                return found
    return found


def _somewhere(task: PlanTask, start: Equilibrium, places: list[TipGoal], clock: Clock) -> list[Equilibrium]:
    """The equilibrium near the start whose tip has the first of some poses for which there is one."""
    refused: list[SolveError] = []
    for k, place in enumerate(places):
        try:
            return _posed(task, start, place, clock if len(places) == 1 else Clock(clock.left / (len(places) - k)))
        except SolveError as error:
            refused.append(error)
    if len(places) == 1:
        raise refused[0]
    raise SolveError(f"no plan was found to {len(places)} points of the region; to the first: {refused[0]}")


def _posed(task: PlanTask, start: Equilibrium, goal: TipGoal, clock: Clock) -> list[Equilibrium]:
    """The equilibrium near the start whose tip has a pose, by inverse kinematics."""
    position = goal.position
    check_place(task, position)
    miss = 0.0 if task.chart.load is not None else least_miss(task, position, clock)
    if miss > 0:
        raise SolveError(
            "no plan was found: the searches did not reach the goal; the smallest distance "
            f"of the tip is {miss * 1e3:.4g} mm"
        )
    try:
        asked = _asked(task, start, goal, clock)
        answer = inverse_kinematics(task.chart.space.robot, position, **asked)
    except SolveError as error:
        raise SolveError(f"no plan was found: inverse kinematics found no joint values for the goal: {error}") from None
    return [answer.equilibrium]


def _asked(task: PlanTask, start: Equilibrium, goal: TipGoal, clock: Clock) -> dict[str, Any]:
    """What inverse kinematics is asked beside the position."""
    asks = kept(task, task.min_margin + 2 * FINISHED, clock.left)
    return {"load": task.chart.load, "direction": goal.direction, "start": start, **asks}


def kept(task: PlanTask, floor: float, seconds: float) -> dict[str, Any]:
    """What joint values for a place of the tip have to keep, with a margin of at least `floor`, and their time."""
    options = _options(task, seconds)
    return {"min_margin": floor, "limits": task.chart.space.limits, "obstacles": task.obstacles, "options": options}


def _options(task: PlanTask, seconds: float) -> InverseOptions:
    """How joint values are asked for in a time, s."""
    space = task.chart.space
    return InverseOptions(
        clearance=task.clearance,
        carriage_gap=space.carriage_gap,
        section_length=space.section_length,
        time_limit=max(seconds, LEAST_SECONDS),
    )


def _in_range(space: JointSpace, name: str, rotations: Array, translations: Array) -> None:
    if words := space.outside(space.join(rotations, translations, name), ROUNDED):
        raise InputError(f"{name} is out of range: {words}")


def _fault(task: PlanTask, name: str, e: Equilibrium) -> str:
    """Why no plan leads to an equilibrium: margin or clearance is too small; empty where they are not."""
    if e.margin < task.min_margin - FINISHED:
        return f"no plan exists: the {name} has margin {e.margin:.4g}; every point must keep {task.min_margin:g}"
    clear = ArmSurface(e).clearance(task.scene)
    if clear >= task.clearance:
        return ""
    where = "is inside an obstacle" if clear < 0 else f"has clearance {clear * 1e3:.4g} mm"
    distance = f"(least distance {clear * 1e3:.4g} mm); it must keep {task.clearance * 1e3:g} mm"
    return f"no plan exists: the arm at the {name} {where} {distance}"


def _turned(task: PlanTask, e: Equilibrium, here: Array, modulo: bool) -> list[End]:
    """The same equilibrium with whole turns added to its rotations, where asked for; within the limits."""
    space, n = task.chart.space, task.chart.space.robot.n_tubes
    if not modulo:
        _in_range(space, "goal", e.rotations, e.translations)
        return [_end(task, e, (0,) * n)]
    ranges = []
    for i in range(n):
        # 1e-6 of a turn keeps rotations at the very edge of the limits.
        least = int(np.ceil((space.lower[i] - e.rotations[i]) / (2 * np.pi) - 1e-6))
        most = int(np.floor((space.upper[i] - e.rotations[i]) / (2 * np.pi) + 1e-6))
        ranges.append(range(least, most + 1))
    _in_range(space, "goal", np.clip(e.rotations, space.lower[:n], space.upper[:n]), e.translations)
    # Of wide ranges the turns nearest to the start: the others are farther, and many.
    near = []
    for each, gap in zip(ranges, (here - e.rotations) / (2 * np.pi), strict=True):
        whole = np.array(each)
        near.append(whole[np.argsort(np.abs(whole - gap))][:MOST_TURNS].tolist())
    return [_end(task, e, turns) for turns in product(*near)]


def _end(task: PlanTask, e: Equilibrium, turns: Sequence[int]) -> End:
    q = task.chart.space.join(e.rotations, e.translations)
    whole = 2 * np.pi * np.pad(turns, (0, len(q) - len(turns)))
    return End(task.chart.of(e) + whole, q + whole, tuple(turns))
