"""Path search: straight, by translations that exclude snaps, by RRT-Connect (OMPL); and obstructions.

A path is continuous, so that every coordinate takes all values between its ends: the tip rotation of a tube, that of
one tube relative to another, a translation. If no state with one of these values is allowed, there is no path. If only
one state has this value, it decides, which is a proof. Otherwise states are checked on a grid or at random: the result
is evidence, not a proof, and reports the number of states.
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
"""Search methods."""


OBSTRUCTION_SECONDS, OBSTRUCTION_FRACTION = 5.0, 0.15
"""Maximum duration of the search for obstructions, s, and fraction of the remaining time."""

# A certificate takes about as long as the check of a motion.
DETOUR_SECONDS, DETOUR_FRACTION = 6.0, 0.3
"""Maximum duration of the search for paths by certified translations, s, and fraction of the remaining time."""

# Measured for two and three tubes: 22 and 16.
CERTIFICATE_STATES = 20
"""Work of a certificate, in evaluations of an equilibrium from tip coordinates."""

# Each is tried at four points from either end: 1280 candidates.
DETOUR_SAMPLES, MAX_DETOURS = 160, 24
"""Number of sampled translations, and of detours that are tried, the shortest first."""

# Longer ones mostly fail, and their check is wasted; shorter ones make trees that grow slowly in free space.
LONG_MOTION = 1.2
"""Longest motion that RRT-Connect tries at once, in units of the joints' scales; in the second stage a quarter of
it."""

# Where an obstruction is known the search is most likely in vain, and ends early.
LONG_FRACTION, REASON_FRACTION = 0.5, 0.3
"""Fraction of the remaining time for long motions, and the same with a known obstruction; short motions get the
rest."""

POCKET_FRACTION = 0.3
"""Fraction of the time after long motions for the test of whether start or goal lie in a closed region."""


@dataclass(frozen=True, eq=False)
class PathResult:
    """Result of a path search between points in tip coordinates."""

    points: Array | None
    """Waypoints (k, m) with valid straight motions between them; None without a path."""
    how: str
    """Method: "straight", "detour", "search", or "roadmap"."""
    motions: int
    """Number of motions checked."""
    closest: Array | None = None
    """Waypoints (k, m) closest to the goal, without a path."""
    why: str = ""
    """Reason for a missing path."""
    impossible: bool = False
    """True if the reason is a proof."""


def find_path(
    task: Task,
    start: Array,
    goals: Sequence[Array],
    clock: Clock,
    *,
    how: str = "auto",
    improving: float = 5.0,
    seed: int = 0,
) -> PathResult:
    """Path from a point to one of several goals.

    Args:
        how: method, one of SEARCHES.
        improving: time, s, for which "optimal" shortens the path.
    """
    tried, n = 0, task.coordinates.space.robot.n_tubes
    for goal in goals:
        tried += 1
        if task.motion(start, goal):
            return PathResult(np.stack([start, goal]), "straight", tried)
    seconds = improving if how == "optimal" else None
    obstruction = find_obstruction(
        task, start, goals, clock.part(OBSTRUCTION_FRACTION, most=OBSTRUCTION_SECONDS), seed=seed
    )
    if obstruction is not None and obstruction.proved:
        return PathResult(
            points=None, how="search", motions=tried, closest=None, why=obstruction.message, impossible=True
        )
    if how != "rrt_connect" and obstruction is None:
        part = clock.part(DETOUR_FRACTION, most=DETOUR_SECONDS)
        for goal in goals:
            for shift in islice(certified_translations(task, start, goal, part), MAX_DETOURS):
                # Translations change, tips turn at certified translations, then translations change to the goal.
                points = [start, np.append(start[:n], shift), np.append(goal[:n], shift), goal]
                tried += len(points) - 1
                if task.path(points):
                    detour = PathResult(np.stack(points), "detour", tried)
                    return _improved(task, detour, goals, clock, seconds, seed)
    reason = "" if obstruction is None else obstruction.message
    result = by_sampling(task, start, goals, clock, seed=seed, tried=tried, reason=reason)
    return _improved(task, result, goals, clock, seconds, seed)


def _improved(
    task: Task, path: PathResult, goals: Sequence[Array], clock: Clock, seconds: float | None, seed: int
) -> PathResult:
    """Path shortened by BIT* for a time, s; the path itself without a time or a shorter one."""
    if seconds is None or path.points is None:
        return path
    optimal = by_sampling(task, path.points[0], goals, clock, seconds=seconds, seed=seed, tried=path.motions)
    shorter = optimal.points is not None and task.length(optimal.points) < task.length(path.points)
    return optimal if shorter else replace(path, motions=optimal.motions)


def certified_translations(task: Task, start: Array, goal: Array, clock: Clock) -> Iterator[Array]:
    """Translations (G,) of the carriages with a certificate equal to the required margin.

    Those nearest to start and goal come first.

    They are computed one by one, since a certificate takes as long as the check of a motion.
    """
    space = task.coordinates.space
    n = space.robot.n_tubes
    if not space.robot.fixed_sections:  # bundles have no certificate
        return
    ends = start[n:], goal[n:]
    drawn = space.sample(DETOUR_SAMPLES)[:, n:]
    # On the path from an end to a sample the certificate usually grows: the first point that has it is the nearest.
    table = np.concatenate([end + x * (drawn - end) for end in ends for x in (0.25, 0.5, 0.75, 1.0)])
    far = sum(np.linalg.norm((table - end) / task.scale[n:], axis=1) for end in ends)
    certified: list[Array] = []
    for shift in table[np.argsort(far, kind="stable")]:
        if clock.over:
            return
        if any(np.linalg.norm((shift - each) / task.scale[n:]) < 0.08 for each in certified):
            continue
        translations = space.split(np.append(np.zeros(n), shift))[1]
        task.count(CERTIFICATE_STATES)  # counted where it is known, too: the count must not depend on the cache
        if _certificate_at(space.robot, translations) >= task.min_margin + task.margin_reserve:
            certified.append(shift)
            yield shift


@lru_cache(maxsize=8192)
def _certificate_at(robot: Robot, translations: tuple[float, ...]) -> float:
    """Certificate of a robot, cached: plans between the same translations need a thousand of them again."""
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
) -> PathResult:
    """Path by RRT-Connect of OMPL until the clock is over, or by BIT* for `seconds`.

    A known `reason` against a path ends the search early, and so does a start or goal in a closed region.
    """
    try:
        from ompl import base, geometric, util
    except ImportError:
        raise InputError("planning needs OMPL: pip install 'tubeopt[planning]'") from None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    # OMPL allows no seed of 0.
    util.RNG.setSeed(seed + 1)
    scale, count = task.scale, [tried]

    def is_valid(a: Array, b: Array) -> bool:
        if clock.over:
            return False
        count[0] += 1
        return task.motion(a * scale, b * scale)

    information, problem = _ompl_problem(base, task, start, goals, is_valid)
    if seconds is not None:
        clock = clock.part(1.0, most=seconds)
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
        planner = geometric.BITstar(information)
    else:
        planner = geometric.RRTConnect(information)
        planner.setRange(LONG_MOTION)
    planner.setProblemDefinition(problem)
    planner.setup()
    first = clock if seconds is not None else clock.part(REASON_FRACTION if reason else LONG_FRACTION)
    planner.solve(base.PlannerTerminationCondition(lambda: first.over))
    if first is not clock and not problem.hasExactSolution():
        reason = reason or closed_off(task, start, goals, clock.part(POCKET_FRACTION), seed=seed)
        if reason:
            return replace(_ompl_path(problem, scale, start, goals, count[0]), why=reason)
        # Where long motions fail, short ones may succeed.
        planner.setRange(LONG_MOTION / 4)
        planner.solve(base.PlannerTerminationCondition(lambda: clock.over))
    # With the trees of BIT*, OMPL prints lines on leaks when Python ends.
    if seconds is not None or problem.hasExactSolution():
        return _ompl_path(problem, scale, start, goals, count[0])
    data = base.PlannerData(information)
    planner.getPlannerData(data)
    tags = [data.getVertex(k).getTag() for k in range(data.numVertices())]
    trees = f"the trees of {tags.count(1)} states from the start and {tags.count(2)} from the goal did not meet"
    return replace(_ompl_path(problem, scale, start, goals, count[0]), why=trees)


def _ompl_problem(
    base: Any, task: Task, start: Array, goals: Sequence[Array], is_valid: Callable[[Array, Array], bool]
) -> tuple[Any, Any]:
    """Space information and problem of OMPL, in units of the joints' scales; `is_valid` checks a motion."""

    class Motions(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:
            return is_valid(*(np.array([state[i] for i in range(len(start))]) for state in (a, b)))

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
    goal_states = base.GoalStates(information)
    for goal in goals:
        goal_states.addState(_state(space, goal / task.scale))
    problem.setGoal(goal_states)
    return information, problem


def closed_off(task: Task, start: Array, goals: Sequence[Array], clock: Clock, *, seed: int = 0) -> str:
    """Message if no motion leaves one end of a plan; "" if both ends are open or the time is over."""
    for name, points in (("goal", goals), ("start", [start])):
        states = 0
        for point in points:
            count = trapped_region(task, point, clock, seed=seed)
            if count is None:
                break
            states += count
        else:
            return (
                f"no path was found from the {name}'s side: its tree filled {states} states and could not leave "
                "(evidence, not a proof)"
            )
    return ""


def _state(space: Any, values: Array) -> Any:
    """State of OMPL with coordinate values."""
    state = space.allocState()
    for i, value in enumerate(values):
        state[i] = float(value)
    return state


def _ompl_path(problem: Any, scale: Array, start: Array, goals: Sequence[Array], motions: int) -> PathResult:
    """Path found by OMPL, or the points closest to a goal."""
    if not problem.hasSolution():
        return PathResult(None, "search", motions)
    states = problem.getSolutionPath().getStates()
    points = np.array([[state[i] for i in range(len(start))] for state in states]) * scale
    if not problem.hasExactSolution():
        return PathResult(None, "search", motions, points)
    # The ends exactly: they went through the units of the search.
    points[0] = start
    # OMPL does not say which goal it reached.
    points[-1] = min(goals, key=lambda goal: float(np.linalg.norm((goal - points[-1]) / scale)))
    return PathResult(points, "search", motions)


def _bounds(task: Task, ends: Sequence[Array]) -> tuple[Array, Array]:
    """Box of the search, in units of the scales: half a turn about the ends' tip rotations, all translations."""
    space = task.coordinates.space
    n = space.robot.n_tubes
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    low[:n], high[:n] = low[:n] - np.pi, high[:n] + np.pi
    low[n:], high[n:] = np.minimum(space.lower, low)[n:], np.maximum(space.upper, high)[n:]
    return low / task.scale, np.maximum(high, low + 1e-9) / task.scale


def without_corners(task: Task, points: Array) -> Array:
    """Path without the corners that straight motions can skip."""
    path = [points[0]]
    for last, following in pairwise(points[1:]):
        if not task.motion(path[-1], following):
            path.append(last)
    return np.stack([*path, points[-1]])


def shorten(task: Task, points: Array, clock: Clock, *, seed: int = 0) -> Array:
    """Path with corners cut: random points on it are joined by a straight motion if that is valid and shorter."""
    random = np.random.default_rng(seed)
    path = [np.array(point) for point in points]
    for _ in range(60):
        if clock.over or len(path) < 3:
            break
        lengths = np.array([np.linalg.norm((b - a) / task.scale) for a, b in pairwise(path)])
        arc_lengths = np.concatenate([[0.0], np.cumsum(lengths)])
        a, b = np.sort(random.uniform(0, arc_lengths[-1], 2))
        i, j = (int(np.searchsorted(arc_lengths, x, side="right") - 1) for x in (a, b))
        i, j = min(i, len(path) - 2), min(j, len(path) - 2)
        if i == j:
            continue
        first = path[i] + (a - arc_lengths[i]) / max(lengths[i], 1e-12) * (path[i + 1] - path[i])
        last = path[j] + (b - arc_lengths[j]) / max(lengths[j], 1e-12) * (path[j + 1] - path[j])
        old = [first, *path[i + 1 : j + 1], last]
        if task.length([first, last]) < task.length(old) and task.motion(first, last):
            path = [*path[: i + 1], first, last, *path[j + 1 :]]
    return np.stack(path)


LEVELS = 9
"""Number of checked sections between start and goal, for every coordinate."""

# If a twentieth of a section is allowed, one of so many random states is, with 92 %.
SCREENED = 48
"""Random states that screen a section; most sections have an allowed one."""

# Each state is an integration: larger grids would use up the time of the search.
GRID_STATES = 20_000
"""Maximum number of grid states; larger sections are not decided."""

DOUBT = 2e-3
"""Smallest missing margin of a forbidden state: more than the error of the integration."""

POCKET_STATES, POCKET_DISTANCE = 60, 0.02
"""Number of states of an open region, and distance of two states in units of the joints' scales."""

# Of directions in six dimensions, so many random ones find an opening of a tenth of a per cent with 78 %.
FAILED_MOTIONS = 1500
"""Number of successive failed motions in a region that counts as closed."""


@dataclass(frozen=True)
class Obstruction:
    """Obstruction that separates start and goal."""

    message: str
    proved: bool


@dataclass(frozen=True, eq=False)
class _Section:
    """All states with one fixed value of a coordinate."""

    name: str
    """Description of the coordinate and its value."""
    base: Array
    """State (m,) of the section."""
    free: Array
    """Axes (k, m) of the section."""
    low: Array
    """Lower ends (k,) along the axes."""
    high: Array
    """Upper ends (k,) along the axes."""
    step: Array
    """Largest distances (k,) of checked states along the axes."""

    def points(self, fractions: Array) -> Array:
        """States (N, m) at fractions (N, k) of the ranges."""
        return np.asarray(self.base + (self.low + fractions * (self.high - self.low)) @ self.free)

    def grid(self, max_states: int) -> Array | None:
        """Grid (N, m) as dense as the checked points of a motion; None if it has more than `max_states`."""
        counts = [int(np.ceil(x - 1e-9)) + 1 for x in (self.high - self.low) / self.step]
        if np.prod(np.array(counts, dtype=float)) > max_states:
            return None
        axes = np.meshgrid(*(np.linspace(0, 1, count) for count in counts), indexing="ij")
        return self.points(np.stack([axis.ravel() for axis in axes], axis=1)) if counts else self.base[None]


def find_obstruction(
    task: Task, start: Array, goals: Sequence[Array], clock: Clock, *, seed: int = 0
) -> Obstruction | None:
    """Obstruction between a start and all goals (m,); None if none is found within the time.

    With several goals it is the weakest one: not proved if any of them is not.
    """
    margin, space = task.min_margin - DOUBT, task.coordinates.space
    if not task.obstacles:  # turning the whole robot changes nothing: its rotations may have any value
        lower, upper, n = space.lower.copy(), space.upper.copy(), space.robot.n_tubes
        lower[:n], upper[:n] = -np.inf, np.inf
        space = replace(space, lower=lower, upper=upper)
    coordinates = replace(task.coordinates, space=space)
    bare = replace(
        task, coordinates=coordinates, min_margin=margin, margin_reserve=0.0, min_clearance_reserve=0.0, ends=None
    )
    random = np.random.default_rng(seed)
    obstructions = []
    for goal in goals:
        obstruction = next(iter(_obstructions(bare, start, goal, clock, random)), None)
        if obstruction is None:
            return None
        obstructions.append(obstruction)
    return min(obstructions, key=lambda each: each.proved, default=None)


def _obstructions(
    task: Task, start: Array, goal: Array, clock: Clock, random: np.random.Generator
) -> Iterator[Obstruction]:
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
            reason = f"every path passes {section.name}, where {what} cannot be kept"
            yield Obstruction(reason, task.coordinates.proves)
        else:
            reason = f"{what} are kept at none" if task.obstacles else "the margin is kept at none"
            reason = f"every path passes {section.name}, where {reason} of {len(grid)} states on a grid"
            yield Obstruction(f"{reason} (evidence, not a proof)", False)


def _any(task: Task, z: Array, clock: Clock) -> bool:
    """True if a state (N, m) is allowed; most sections have one among the first."""
    parts = np.split(z, range(16, len(z), 16))
    return any(bool(task.holds(some).any()) for some in parts if not clock.over)


def _sections(task: Task, start: Array, goal: Array) -> Iterator[_Section]:
    """Sections between two points, the middle ones first."""
    space = task.coordinates.space
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
    fractions = np.arange(1, LEVELS + 1) / (LEVELS + 1)
    # Start and goal are allowed, and so are most sections near them: the middle ones are most likely to separate.
    for fraction in fractions[np.argsort(np.abs(fractions - 0.5), kind="stable")]:
        base = start + fraction * (goal - start)
        for row, name in rows:
            if abs(row @ (goal - start)) < 1e-6:
                continue
            value = float(row @ base) * (180 / np.pi if np.abs(row[:n]).any() else 1e3)
            axes = [axis for axis in unit[:n] if row @ axis == 0]
            if row.any() and not row.sum():
                axes.append(np.abs(row))  # two tubes turned by the same angle
            if not task.obstacles:
                axes.pop()  # turning the whole robot changes nothing
            axes += [unit[k] for k in moved if row[k] == 0]
            yield _section(name.format(value), base, np.reshape(axes, (-1, m)), low, high, task)


def _section(name: str, base: Array, free: Array, lower: Array, upper: Array, task: Task) -> _Section:
    """Section through a state, with axes limited to a box (m,)."""
    n = task.coordinates.space.robot.n_tubes
    low, high, step = [], [], []
    for axis in free:
        i = int(np.argmax(axis != 0))
        turns = i < n
        # Without obstacles a full turn covers all rotations.
        periodic = turns and not task.obstacles
        low.append(0.0 if periodic else lower[i] - base[i])
        high.append(2 * np.pi if periodic else upper[i] - base[i])
        step.append(STEP_TURN if turns else STEP_SHIFT * task.coordinates.space.length)
    return _Section(name, base, free, np.array(low), np.array(high), np.array(step))


def trapped_region(task: Task, point: Array, clock: Clock, *, seed: int = 0) -> int | None:
    """Number of states in a closed region around a point; None if the region is open or the clock is over.

    Motions of random length and direction are tried: this is evidence, not a proof.
    """
    random = np.random.default_rng(seed)
    states, failed = [point], 0
    while failed < FAILED_MOTIONS:
        if clock.over or len(states) >= POCKET_STATES:
            return None
        at = states[random.integers(len(states))]
        direction = random.normal(size=len(point))
        # Lengths over 2.5 decades: a narrow opening needs short motions, a wide one long.
        end = at + 10 ** random.uniform(-2.5, 0.0) * direction / np.linalg.norm(direction) * task.scale
        distance = np.linalg.norm((np.array(states) - end) / task.scale, axis=1).min()
        if task.motion(at, end):
            if distance > POCKET_DISTANCE:
                states, failed = [*states, end], 0
        else:
            failed += 1
    return len(states)
