"""Finding a path: straight, by translations at which nothing can snap, by RRT-Connect (OMPL); why there may be none.

A path is continuous, so that whatever changes from one value to another takes every value in between: the tip rotation
of a tube, that of one tube against another, a translation. If no state with one of these values is allowed, there is no
path. Where nothing but that value is free, one state decides, and that is a proof. Else states are checked on a grid,
or at random: what is found then is a reason to give up and not a proof, and says how many states were checked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, islice, pairwise
from typing import Any

import numpy as np

from ..errors import InputError
from ..robots.robot import Robot
from ..stability.certificate import snap_free_certificate
from ..typing import Array
from .clock import Clock
from .task import STEP_SHIFT, STEP_TURN, Task

SEARCHES = ("auto", "rrt_connect", "optimal")
"""Ways of searching."""


WALL_SECONDS, WALL_SHARE = 5.0, 0.15
"""Maximum duration of the search for obstructions, s, and share of the remaining time."""

# A certificate takes about as long as the check of a motion.
DETOUR_SECONDS, DETOUR_SHARE = 6.0, 0.3
"""The same of paths by translations that exclude snaps."""

# Measured for two and three tubes: 22 and 16.
CERTIFICATE_STATES = 20
"""Work of a certificate, in equilibria of the chart."""

# Each is tried at four points from either end: 1280 candidates.
DETOUR_SAMPLES, MOST_DETOURS = 160, 24
"""Translations among which such are searched for, and paths that are tried, shortest first."""

# Longer ones mostly fail, and their check is wasted; shorter ones make trees that grow slowly in free space.
LONG_MOTION = 1.2
"""Longest motion that RRT-Connect tries at once, in units of the joints' scales; short ones have a quarter of it."""

# Where an obstruction is known the search is most likely in vain, and ends early.
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
    between = wall(task, start, goals, clock.part(WALL_SHARE, most=WALL_SECONDS), seed=seed)
    if between is not None and between.proved:
        return Way(None, "search", tried, None, between.words, True)
    if how != "rrt_connect" and between is None:
        share = clock.part(DETOUR_SHARE, most=DETOUR_SECONDS)
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
        task.count(CERTIFICATE_STATES)  # counted where it is known, too: the count must not depend on the cache
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
    # OMPL allows no seed of 0.
    util.RNG.setSeed(seed + 1)
    scale, count = task.scale, [tried]

    def moves(one: Array, other: Array) -> bool:
        if clock.over:
            return False
        count[0] += 1
        return task.motion(one * scale, other * scale)

    information, problem = _posed(base, task, start, goals, moves)
    if seconds is not None:
        clock = clock.part(1.0, most=seconds)
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
    # OMPL does not say which goal it reached.
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


LEVELS = 9
"""Checked sections between start and goal, of every coordinate."""

# If a twentieth of a section is allowed, one of so many random states is, with 92 %.
SCREENED = 48
"""Random states that screen a section; most sections have an allowed one."""

# Each state is an integration: larger grids would use up the time of the search.
GRID_STATES = 20_000
"""Maximum number of grid states; larger sections are not decided."""

DOUBT = 2e-3
"""Margin that states must lack to count as not allowed: more than the integration is off."""

POCKET_STATES, POCKET_APART = 60, 0.02
"""Number of states at which a region counts as open, and distance of two states in units of the joints' scales."""

# Of directions in six dimensions, so many random ones find an opening of a tenth of a per cent with 78 %.
FAILED_MOTIONS = 1500
"""Successive failed motions at which a region counts as closed."""


@dataclass(frozen=True)
class Wall:
    """What separates start and goal."""

    words: str
    proved: bool


@dataclass(frozen=True, eq=False)
class _Section:
    """All states z with row @ z = level; `name` in words.

    free: axes (k, m) along which states of the section differ.   low, high, step (k,) along them; base (m,) is one.
    """

    name: str
    base: Array
    free: Array
    low: Array
    high: Array
    step: Array

    def points(self, shares: Array) -> Array:
        """(N, m) states at shares (N, k) of the ranges."""
        return np.asarray(self.base + (self.low + shares * (self.high - self.low)) @ self.free)

    def grid(self, most: int) -> Array | None:
        """(N, m) all states, as close as the points of a motion that are checked; None of more than `most`."""
        counts = [int(np.ceil(x - 1e-9)) + 1 for x in (self.high - self.low) / self.step]
        if np.prod(np.array(counts, dtype=float)) > most:
            return None
        axes = np.meshgrid(*(np.linspace(0, 1, count) for count in counts), indexing="ij")
        return self.points(np.stack([axis.ravel() for axis in axes], axis=1)) if counts else self.base[None]


def wall(task: Task, start: Array, goals: Sequence[Array], clock: Clock, *, seed: int = 0) -> Wall | None:
    """What keeps a start from all goals, points (m,); None where nothing was found before the clock was over. Of
    several goals the one is told of which least is proved."""
    margin, space = task.min_margin - DOUBT, task.chart.space
    if not task.obstacles:  # turned as a whole, the robot is as it was: its joints may be turned at will
        lower, upper, n = space.lower.copy(), space.upper.copy(), space.robot.n_tubes
        lower[:n], upper[:n] = -np.inf, np.inf
        space = replace(space, lower=lower, upper=upper)
    chart = replace(task.chart, space=space)
    bare = replace(task, chart=chart, min_margin=margin, margin_room=0.0, floor=0.0, ends=None)
    random = np.random.default_rng(seed)
    found = []
    for goal in goals:
        between = next(iter(_walls(bare, start, goal, clock, random)), None)
        if between is None:
            return None
        found.append(between)
    return min(found, key=lambda each: each.proved, default=None)


def _walls(task: Task, start: Array, goal: Array, clock: Clock, random: np.random.Generator) -> Iterator[Wall]:
    for section in _sections(task, start, goal):
        if clock.over:
            return
        k = len(section.free)
        # A few random states settle most sections; a grid takes up to GRID_STATES integrations.
        if k and _any(task, section.points(random.random((SCREENED, k))), clock):
            continue
        grid = section.grid(GRID_STATES)
        if grid is None or _any(task, grid, clock) or clock.over:
            continue
        what = "margin and clearance" if task.obstacles else "the margin"
        if k == 0:
            words = f"every path passes {section.name}, where {what} cannot be kept"
            yield Wall(words, not task.chart.eccentric)
        else:
            words = f"{what} are kept at none" if task.obstacles else "the margin is kept at none"
            words = f"every path passes {section.name}, where {words} of {len(grid)} states on a grid"
            yield Wall(f"{words} (evidence, not a proof)", False)


def _any(task: Task, z: Array, clock: Clock) -> bool:
    """Whether some state (N, m) is allowed, of which most sections have one among the first."""
    parts = np.split(z, range(16, len(z), 16))
    return any(bool(task.holds(some).any()) for some in parts if not clock.over)


def _sections(task: Task, start: Array, goal: Array) -> Iterator[_Section]:
    """Sections between two points, the middle ones first."""
    space = task.chart.space
    n, m = space.robot.n_tubes, len(start)
    unit = np.eye(m)
    rows = [
        (unit[i] - unit[j], f"tube {i + 1} turned by {{:.4g}} deg at its tip against tube {j + 1}")
        for i, j in combinations(range(n), 2)
    ]
    if task.obstacles:
        rows += [(unit[i], f"tube {i + 1} turned to {{:.4g}} deg at its tip") for i in range(n)]
    rows += [
        (unit[n + k], f"tube {tubes[0] + 1} moved to {{:.4g}} mm from home") for k, tubes in enumerate(space.carriages)
    ]
    moved = np.flatnonzero(space.upper[n:] - space.lower[n:] > 1e-9) + n
    low = np.append(np.minimum(space.lower[:n], np.minimum(start, goal)[:n]) - np.pi, space.lower[n:])
    high = np.append(np.maximum(space.upper[:n], np.maximum(start, goal)[:n]) + np.pi, space.upper[n:])
    shares = np.arange(1, LEVELS + 1) / (LEVELS + 1)
    # Start and goal are allowed, and so are most sections near them: the middle ones are most likely to separate.
    for share in shares[np.argsort(np.abs(shares - 0.5), kind="stable")]:
        base = start + share * (goal - start)
        for row, name in rows:
            if abs(row @ (goal - start)) < 1e-6:
                continue
            value = float(row @ base) * (180 / np.pi if np.abs(row[:n]).any() else 1e3)
            axes = [axis for axis in unit[:n] if row @ axis == 0]
            if row.any() and not row.sum():
                axes.append(np.abs(row))  # both of two tubes turned by the same
            if not task.obstacles:
                axes.pop()  # turned as a whole, the robot is as it was
            axes += [unit[k] for k in moved if row[k] == 0]
            yield _section(name.format(value), base, np.reshape(axes, (-1, m)), (low, high), task)


def _section(name: str, base: Array, free: Array, box: tuple[Array, Array], task: Task) -> _Section:
    n = task.chart.space.robot.n_tubes
    low, high, step = [], [], []
    for axis in free:
        i = int(np.argmax(axis != 0))
        turns = i < n
        # Without anything to collide with a whole turn is all that there is.
        whole = turns and not task.obstacles
        low.append(0.0 if whole else box[0][i] - base[i])
        high.append(2 * np.pi if whole else box[1][i] - base[i])
        step.append(STEP_TURN if turns else STEP_SHIFT * task.chart.space.length)
    return _Section(name, base, free, np.array(low), np.array(high), np.array(step))


def pocket(task: Task, point: Array, clock: Clock, *, seed: int = 0) -> int | None:
    """How many states fill the place around a point that no motion was found to leave; None where it is open, or the
    clock is over. Evidence, and no proof: motions of random length and direction are tried."""
    random = np.random.default_rng(seed)
    states, failed = [point], 0
    while failed < FAILED_MOTIONS:
        if clock.over or len(states) >= POCKET_STATES:
            return None
        at = states[random.integers(len(states))]
        way = random.normal(size=len(point))
        # Lengths over 2.5 decades: a narrow opening needs short motions, a wide one long.
        there = at + 10 ** random.uniform(-2.5, 0.0) * way / np.linalg.norm(way) * task.scale
        apart = np.linalg.norm((np.array(states) - there) / task.scale, axis=1).min()
        if task.motion(at, there):
            if apart > POCKET_APART:
                states, failed = [*states, there], 0
        else:
            failed += 1
    return len(states)
