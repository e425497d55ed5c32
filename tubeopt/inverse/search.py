"""Finding a way: straight, by way of translations at which nothing can snap, and by RRT-Connect (OMPL)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice, pairwise
from typing import Any

import numpy as np

from ..errors import InputError
from ..robots.robot import Robot
from ..stability.certificate import snap_free_certificate
from ..typing import Array
from .clock import Clock
from .obstruction import pocket, wall
from .task import Task

SEARCHES = ("auto", "rrt_connect", "optimal")
"""Ways of searching."""


WALL_SECONDS, WALL_SHARE = 5.0, 0.15
"""Maximum duration of the search for obstructions, s, and share of the remaining time."""

DETOUR_SECONDS, DETOUR_SHARE = 6.0, 0.3
"""The same of paths by translations that exclude snaps."""

DETOUR_SAMPLES, MOST_DETOURS = 160, 24
"""Translations among which such are searched for, and paths that are tried, shortest first."""

LONG_MOTION = 1.2
"""Longest motion that RRT-Connect tries at once, in units of the joints' scales; short ones have a quarter of it."""

LONG_SHARE, REASON_SHARE = 0.5, 0.3
"""Share of the remaining time for long motions; short ones get the rest. The second if an obstruction is known."""

POCKET_SHARE = 0.3
"""Share of the time that long motions leave for the test whether start or goal lie in a closed region."""


@dataclass(frozen=True, eq=False)
class Way:
    """What was found between points of the chart."""

    points: Array | None
    """(k, m) whose straight motions hold."""
    how: str
    """How they were found: "straight", "detour", "search", or "roadmap"."""
    motions: int
    """That were checked."""
    closest: Array | None = None
    """(k, m) without a way, what came closest to the goal."""
    why: str = ""
    """Without a way, what stands against there being one, in words."""
    impossible: bool = False
    """Whether that is proved."""


def find_way(
    task: Task,
    start: Array,
    goals: Sequence[Array],
    clock: Clock,
    *,
    how: str = "auto",
    improving: float = 5.0,
    seed: int = 0,
) -> Way:
    """A way from a point to the first goal that is found, the nearest ones tried first, by one of SEARCHES; for so long
    (s) "optimal" improves what it finds."""
    tried, n = 0, task.chart.space.robot.n_tubes
    for goal in goals:
        tried += 1
        if task.motion(start, goal):
            return Way(np.stack([start, goal]), "straight", tried)
    seconds = improving if how == "optimal" else None
    between = wall(task, start, goals, Clock(min(WALL_SECONDS, WALL_SHARE * clock.left)), seed=seed)
    if between is not None and between.proved:
        return Way(None, "search", tried, None, between.words, True)
    if how != "rrt_connect" and between is None:
        share = Clock(min(DETOUR_SECONDS, DETOUR_SHARE * clock.left))
        for goal in goals:
            for shift in islice(certified_translations(task, start, goal, share), MOST_DETOURS):
                # Translations change, tips turn where nothing can snap, and translations go on from there.
                points = [start, np.append(start[:n], shift), np.append(goal[:n], shift), goal]
                tried += len(points) - 1
                if task.path(points):
                    detour = Way(np.stack(points), "detour", tried)
                    return _improved(task, detour, goals, clock, seconds, seed)
    reason = "" if between is None else between.words
    found = by_sampling(task, start, goals, clock, seed=seed, tried=tried, reason=reason)
    return _improved(task, found, goals, clock, seconds, seed)


def _improved(task: Task, way: Way, goals: Sequence[Array], clock: Clock, seconds: float | None, seed: int) -> Way:
    """What BIT* finds in the time that it is given, where that is asked for and shorter than a way that is known."""
    if seconds is None or way.points is None:
        return way
    other = by_sampling(task, way.points[0], goals, clock, seconds=seconds, seed=seed, tried=way.motions)
    shorter = other.points is not None and task.length(other.points) < task.length(way.points)
    return other if shorter else replace(way, motions=other.motions)


def certified_translations(task: Task, start: Array, goal: Array, clock: Clock) -> Iterator[Array]:
    """Carriages (G,) where no rotation can snap by the margin to keep, nearest to start and goal first.

    Each is handed on before the next is looked for: a certificate takes as long as the check of a motion.
    """
    space = task.chart.space
    n = space.robot.n_tubes
    ends = start[n:], goal[n:]
    drawn = space.sample(DETOUR_SAMPLES)[:, n:]
    # On the way from an end to a sample the certificate usually grows: the first point that has it is the nearest.
    table = np.concatenate([end + x * (drawn - end) for end in ends for x in (0.25, 0.5, 0.75, 1.0)])
    far = sum(np.linalg.norm((table - end) / task.scale[n:], axis=1) for end in ends)
    found: list[Array] = []
    for shift in table[np.argsort(far, kind="stable")]:
        if clock.over:
            return
        known = any(np.linalg.norm((shift - other) / task.scale[n:]) < 0.08 for other in found)
        if known:
            continue
        translations = space.split(np.append(np.zeros(n), shift))[1]
        if _certificate_at(space.robot, translations) >= task.min_margin + task.margin_room:
            found.append(shift)
            yield shift


@lru_cache(maxsize=8192)
def _certificate_at(robot: Robot, translations: tuple[float, ...]) -> float:
    """Its certificate there: plans between the same translations ask for a thousand of the same again."""
    return snap_free_certificate(robot, translations)


def by_sampling(
    task: Task,
    start: Array,
    goals: Sequence[Array],
    clock: Clock,
    *,
    seconds: float | None = None,
    seed: int = 0,
    tried: int = 0,
    reason: str = "",
) -> Way:
    """RRT-Connect of OMPL between a point and goals until the clock is over, or BIT* for `seconds`.

    `reason`: what stands against a way, in words. It ends the search early, and so does a start or a goal that turns
    out to lie in a closed pocket.
    """
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise InputError("planning needs OMPL: pip install 'tubeopt[planning]'") from None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    scale, count = task.scale, [tried]

    def moves(one: Array, other: Array) -> bool:
        if clock.over:
            return False
        count[0] += 1
        return task.motion(one * scale, other * scale)

    information, problem = _posed(base, task, start, goals, moves)
    if seconds is not None:
        clock = Clock(min(seconds, clock.left))
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
        planner = geometric.BITstar(information)
    else:
        planner = geometric.RRTConnect(information)
        planner.setRange(LONG_MOTION)
    planner.setProblemDefinition(problem)
    planner.setup()
    first = clock if seconds is not None else clock.part(REASON_SHARE if reason else LONG_SHARE)
    planner.solve(base.PlannerTerminationCondition(lambda: first.over))
    if first is not clock and not problem.hasExactSolution():
        reason = reason or closed_off(task, start, goals, clock.part(POCKET_SHARE), seed=seed)
        if reason:
            return replace(_way(problem, scale, (start, goals), count[0]), why=reason)
        # Where long motions do not lead on, short ones may.
        planner.setRange(LONG_MOTION / 4)
        planner.solve(base.PlannerTerminationCondition(lambda: clock.over))
    data = base.PlannerData(information)
    planner.getPlannerData(data)
    tags = [data.getVertex(k).getTag() for k in range(data.numVertices())]
    trees = f"the trees of {tags.count(1)} states from the start and {tags.count(2)} from the goal did not meet"
    return replace(_way(problem, scale, (start, goals), count[0]), why=trees)


def _posed(
    base: Any, task: Task, start: Array, goals: Sequence[Array], moves: Callable[[Array, Array], bool]
) -> tuple[Any, Any]:
    """The way from a point to goals as a problem of OMPL, in units of the joints' scales; `moves` checks a motion."""

    class Motions(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, one: Any, other: Any, *_: Any) -> bool:
            return moves(*(np.array([state[i] for i in range(len(start))]) for state in (one, other)))

    space = base.RealVectorStateSpace(len(start))
    bounds = base.RealVectorBounds(len(start))
    for i, (low, high) in enumerate(zip(*_bounds(task, [start, *goals]), strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setMotionValidator(Motions(information))
    information.setStateValidityChecker(lambda state: True)  # motions check their ends
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(_state(space, start / task.scale))
    wanted = base.GoalStates(information)
    for goal in goals:
        wanted.addState(_state(space, goal / task.scale))
    problem.setGoal(wanted)
    return information, problem


def closed_off(task: Task, start: Array, goals: Sequence[Array], clock: Clock, *, seed: int = 0) -> str:
    """Which end of a plan no motion was found to leave, in words; empty where both are open, or time is over."""
    for name, points in (("goal", goals), ("start", [start])):
        filled = []
        for point in points:
            filled.append(pocket(task, point, clock, seed=seed))
            if filled[-1] is None:
                break
        else:
            states = sum(count for count in filled if count is not None)
            return (
                f"no path was found from the {name}'s side: its tree filled {states} states and could not leave "
                "(evidence, not a proof)"
            )
    return ""


def _state(space: Any, values: Array) -> Any:
    """A state of OMPL."""
    state = space.allocState()
    for i, value in enumerate(values):
        state[i] = float(value)
    return state


def _way(problem: Any, scale: Array, ends: tuple[Array, Sequence[Array]], motions: int) -> Way:
    """What OMPL found."""
    start, goals = ends
    if not problem.hasSolution():
        return Way(None, "search", motions)
    states = problem.getSolutionPath().getStates()
    points = np.array([[state[i] for i in range(len(start))] for state in states]) * scale
    if not problem.hasExactSolution():
        return Way(None, "search", motions, points)
    # The ends exactly: they went through the units of the search.
    points[0] = start
    points[-1] = min(goals, key=lambda goal: float(np.linalg.norm((goal - points[-1]) / scale)))
    return Way(points, "search", motions)


def _bounds(task: Task, ends: Sequence[Array]) -> tuple[Array, Array]:
    """Box of the search, in units of the scales: half a turn about the ends' tip rotations, all translations."""
    space = task.chart.space
    n = space.robot.n_tubes
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    low[:n], high[:n] = low[:n] - np.pi, high[:n] + np.pi
    low[n:], high[n:] = np.minimum(space.lower, low)[n:], np.maximum(space.upper, high)[n:]
    return low / task.scale, np.maximum(high, low + 1e-9) / task.scale


def without_corners(task: Task, points: Array) -> Array:
    """The way without the corners past which it can go straight, from each as far as that holds."""
    way = [points[0]]
    for last, there in pairwise(points[1:]):
        if not task.motion(way[-1], there):
            way.append(last)
    return np.stack([*way, points[-1]])


def shorten(task: Task, points: Array, clock: Clock, *, seed: int = 0) -> Array:
    """The way with corners cut: random places on it joined straight where that holds and is shorter in joint space."""
    random = np.random.default_rng(seed)
    way = [np.array(point) for point in points]
    for _ in range(60):
        if clock.over or len(way) < 3:
            break
        lengths = np.array([np.linalg.norm((b - a) / task.scale) for a, b in pairwise(way)])
        marks = np.concatenate([[0.0], np.cumsum(lengths)])
        a, b = np.sort(random.uniform(0, marks[-1], 2))
        i, j = (int(np.searchsorted(marks, x, side="right") - 1) for x in (a, b))
        i, j = min(i, len(way) - 2), min(j, len(way) - 2)
        if i == j:
            continue
        first = way[i] + (a - marks[i]) / max(lengths[i], 1e-12) * (way[i + 1] - way[i])
        last = way[j] + (b - marks[j]) / max(lengths[j], 1e-12) * (way[j + 1] - way[j])
        old = [first, *way[i + 1 : j + 1], last]
        if task.length([first, last]) < task.length(old) and task.motion(first, last):
            way = [*way[: i + 1], first, last, *way[j + 1 :]]
    return np.stack(way)
