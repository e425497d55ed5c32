"""The search from many starts, by the fast path and the nonlinear program; the table of starts; and why none succeeded.

The whole robot can be turned about the axis of its plate, and every tube by whole turns, without another change of its
shape: so configurations are compared with a target by height and distance from the axis, and turned to its azimuth.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..display import in_full
from ..equilibrium.batch import solved_batch
from ..errors import InputError, SolveError
from ..files.files import atomic_write
from ..solvers.compiled.library import cache_directory
from ..typing import Array
from .answer import InverseSolution, InverseStatistics, InverseStatus
from .arm_surface import ArmSurface
from .clock import Clock
from .closest import SAME_MISS, closest_of
from .gauss_newton import ON_TARGET, SLACK, Search, correct, held_most, improve, millimetres, missed_by, reach
from .goal import Goal
from .joint_path import answer_at, straight_way
from .joints import JointSpace
from .posture import Posture, posture_of, same_place, start_at
from .program import programmable, solve_program

VERSION = 4
"""Of what the table holds: a change of it makes old files unread."""

SIZE, SIZE_OF_MANY = 2048, 512
"""Configurations per table; the second for more than `MANY` joints, among which a start leads to most targets."""

MANY = 8

WIDEST = np.pi / 2
"""Largest separation of the tubes of an eccentric segment in the table; 120 deg is straight."""

# A fifth of the table: among more, the configurations that differ most are far from the target.
POOL = 400
"""Configurations, the most promising, among which starts are spread."""

# A direction error of 60 deg weighs as much as a miss of a third of the length. Nearness only orders starts that are
# otherwise alike.
DIRECTION_WEIGHT, NEARNESS_WEIGHT = 0.35, 0.02
"""Weights, in the ranking of starts, of the direction error and of the distance from a reference (in units of the
joints' scales), relative to the position error over the robot's length."""

LEAST_MARGIN = 0.01
"""Margin from which on a configuration is worth keeping."""


@dataclass(frozen=True, eq=False)
class StartTable:
    """Stable configurations."""

    q: Array
    """(N, m) joint values."""
    tip: Array
    """(N, 3) m."""
    direction: Array
    """(N, 3) along which the tip points."""
    margin: Array
    """(N,)."""
    tried: int
    """Configurations of which these are the stable ones."""
    whole: bool
    """Whether time did not run out before all were tried."""

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """What it says of every configuration."""
        return self.q, self.tip, self.direction, self.margin


def build_table(
    space: JointSpace, size: int, clock: Clock | None = None, begun: StartTable | None = None
) -> StartTable:
    """Solve `size` configurations spread over what the limits allow, or as many as there is time for, after those of a
    table that was begun; keep those with a stable equilibrium."""
    clock = clock or Clock(math.inf)
    q = _by_mirror(space, space.sample(size))
    n, m = space.robot.n_tubes, len(space.lower)
    if begun is None:
        begun = StartTable(np.empty((0, m)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), 0, whole=False)
    parts, tried = [begun.arrays], begun.tried
    count = 8  # configurations between two looks at the clock, more where these are quick
    while tried < size and not clock.over:
        began, some = clock.seconds, q[tried : tried + count]
        joint = space.joint(some)
        found = solved_batch(space.robot, joint[:, :n], joint[:, n:])
        # Rows without an equilibrium have margin NaN: as 0 they are below LEAST_MARGIN.
        kept = found.converged & (np.nan_to_num(found.margin) >= LEAST_MARGIN)
        parts.append((some[kept], found.tip_position[kept], found.tip_rotation[kept, :, 2], found.margin[kept]))
        tried += count
        # Batches double while they are quick, up to 128: a slow robot still stops near its time limit.
        if clock.seconds - began < 0.02:
            count = min(2 * count, 128)
    solved, tip, direction, margin = (np.concatenate(each) for each in zip(*parts, strict=True))
    table = StartTable(solved, tip, direction, margin, tried, whole=tried >= size)
    if table.whole and not len(table.q):
        raise InputError("no stable equilibrium was found within the limits")
    return table


def _by_mirror(space: JointSpace, q: Array) -> Array:
    """Samples (N, m) with the three tubes of every eccentric segment turned as a hand would: the first to a direction,
    the others to either side of it. Three independent rotations mostly wind a long transmission up until it snaps."""
    if not space.assembly.eccentric:
        return q
    out = q.copy()
    for tubes in space.robot.moving_together:
        # The second rotation of a sample, 0 to 1 over its range, becomes the separation: samples stay evenly spread.
        middle, apart = q[:, tubes[0]], WIDEST * (q[:, tubes[1]] - space.lower[tubes[1]])
        span = space.upper[tubes[1]] - space.lower[tubes[1]]
        apart = apart / span if span > 0 else np.zeros(len(q))
        out[:, list(tubes)] = np.column_stack([middle, middle + apart, middle - apart])
    n = space.robot.n_tubes
    out[:, :n] = np.clip(space.wrap(out, space.middle())[:, :n], space.lower[:n], space.upper[:n])
    return out


def start_table(space: JointSpace, size: int | None = None, clock: Clock | None = None) -> StartTable:
    """The table of a joint space: from the cache on disk as far as it is there, else built, and put there."""
    size = size or (SIZE if len(space.lower) <= MANY else SIZE_OF_MANY)
    path = cache_directory() / f"inverse-{_key(space, size)}.npz"
    stored = _read(path, len(space.lower), size)
    if stored is not None and stored.whole:
        return stored
    table = build_table(space, size, clock, stored)
    # Nothing new was tried, so that the file needs no change.
    if table.tried == (stored.tried if stored is not None else 0):
        return table
    try:
        with atomic_write(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, q=table.q, tip=table.tip, direction=table.direction, margin=table.margin, tried=table.tried)
    except InputError:
        pass  # Without a place to keep it, the table is built anew in the next process: slower, not wrong.
    return table


def _key(space: JointSpace, size: int) -> str:
    """Hash of all that the table depends on."""
    tubes = in_full((VERSION, size, type(space.robot).__name__, space.robot.tubes, space.carriages))
    assembly = space.assembly
    digest = hashlib.sha256(tubes.encode())
    for array in (
        space.lower,
        space.upper,
        space.rows,
        space.least,
        space.joint(space.lower),
        assembly.offset,
        assembly.offset_angle,
    ):
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.hexdigest()[:32]


def _read(path: Path, joints: int, size: int) -> StartTable | None:
    """The table in a file, as far as it was built; None where there is none, or the file is damaged."""
    try:
        # The content, not the path: of a damaged file numpy would leave the handle open.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            tried = int(file["tried"])
            table = StartTable(file["q"], file["tip"], file["direction"], file["margin"], tried, whole=tried >= size)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    count = len(table.margin)
    shapes = [(count, joints), (count, 3), (count, 3), (count,)]
    fitting = [each.shape for each in table.arrays] == shapes
    return table if fitting and (count or not table.whole) else None


def nearest_starts(
    space: JointSpace,
    table: StartTable,
    target: tuple[Array, Array | None],
    *,
    min_margin: float,
    reference: Array | None,
) -> Array:
    """(k, m) configurations of a table, turned towards a target (position, direction or None), most promising first.

    Those with less than `min_margin` are left out, and those that cannot be turned there come with the turn that the
    limits allow.
    """
    position, direction = target
    mirrored = direction is not None and not space.assembly.eccentric
    known = _mirrored(space, table) if mirrored else table
    chosen = known.margin >= min_margin
    q, tip, pointing = known.q[chosen], known.tip[chosen], known.direction[chosen]
    if not len(q):
        return q
    near = space.middle() if reference is None else reference
    turn = np.arctan2(position[1], position[0]) - np.arctan2(tip[:, 1], tip[:, 0])
    n = space.robot.n_tubes
    turned = q.copy()
    turned[:, :n] += turn[:, None]
    turned = space.wrap(turned, near)
    outside = ~((turned >= space.lower) & (turned <= space.upper)).all(1)
    # Where whole turns do not help, turn as far as the narrowest range allows.
    least, most = (space.lower[:n] - q[:, :n]).max(1), (space.upper[:n] - q[:, :n]).min(1)
    # The turn within -pi .. pi, the shortest of those that differ by whole turns.
    part = np.clip((turn + np.pi) % (2 * np.pi) - np.pi, least, np.maximum(most, least))
    turned[outside] = q[outside]
    turned[outside, :n] += part[outside, None]
    turn = np.where(outside, part, turn)
    cost = np.linalg.norm(_turned(tip, turn) - position, axis=1) / space.length
    if direction is not None:
        cost = cost + DIRECTION_WEIGHT * np.linalg.norm(_turned(pointing, turn) - direction, axis=1)
    if reference is not None:
        cost = cost + NEARNESS_WEIGHT * np.linalg.norm((turned - reference) / space.scale, axis=1)
    # Rounded, so that round-off does not choose among mirror images.
    return space.clip(turned[np.argsort(np.round(cost, 9), kind="stable")])


def spread_starts(space: JointSpace, q: Array, count: int, *, first: int) -> Iterator[Array]:
    """At most `count` of joint values (k, m) sorted by promise: the `first` of them, then such as differ most from all
    chosen before, among the `POOL` most promising; each is looked for when it is asked for."""
    if len(q) <= first:
        yield from q
        return
    q = q[: max(POOL, first + 1)]
    yield from q[: max(first, 1)]
    n = space.robot.n_tubes
    relative = q[:, :n] - q[:, n - 1 : n]
    # Rotations against the outermost tube, as points of circles; the turn of the whole robot follows from the target.
    features = np.hstack([np.cos(relative), np.sin(relative), q[:, n:] / space.scale[n:]])
    # Distance from the nearest chosen one. Taking its maximum each time is the farthest-point method
    # (Gonzalez, Theor. Comput. Sci. 38 (1985)).
    gap = np.min([np.linalg.norm(features - own, axis=1) for own in features[: max(first, 1)]], axis=0)
    for _ in range(min(count, len(q)) - max(first, 1)):
        # Rounded, so that of mirror images the more promising one is taken.
        farthest = int(np.argmax(np.round(gap, 9)))
        # All others equal one that was chosen.
        if gap[farthest] <= 0:
            return
        yield q[farthest]
        gap = np.minimum(gap, np.linalg.norm(features - features[farthest], axis=1))


def _mirrored(space: JointSpace, table: StartTable) -> StartTable:
    """The table with the mirror image of every configuration: all rotations negative, seen in the plane x = 0."""
    flipped, mirror = table.q.copy(), np.array([-1.0, 1.0, 1.0])
    flipped[:, : space.robot.n_tubes] *= -1
    # Negated rotations may leave the limits: whole turns bring some back, and the others are left out.
    flipped = space.wrap(flipped, space.middle())
    inside = ((flipped >= space.lower) & (flipped <= space.upper)).all(1)
    images = flipped, table.tip * mirror, table.direction * mirror, table.margin
    both = (np.concatenate([own, image[inside]]) for own, image in zip(table.arrays, images, strict=True))
    q, tip, direction, margin = both
    return StartTable(q, tip, direction, margin, table.tried, table.whole)


def _turned(vectors: Array, angle: Array) -> Array:
    """Vectors (N, 3) turned about z by angles (N,)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


# Where the target is easy one of the first reaches it. Spread starts come next, since the nearest ones are often of
# one posture, which an obstacle may block as a whole.
NEAREST = 12
"""Starts that are taken as they come, the most promising first; those after them are spread over all postures."""

# Finding a clear one takes up to 400 forward kinematics, so that these come last.
CLEAR_STARTS = 8
"""Starts clear of the obstacles that are tried where all others ended in one."""

# Each further one costs another search.
COMPARED = 3
"""Answers among which the best is taken where there is an objective and no start."""

# An answer that a cold start does not find is of another branch at the same joint values: correct, but harder to use.
DOUBTED = 4
"""Answers that a cold forward kinematics does not find, after which one of them is taken."""

# Out of reach all descents end at the same closest pose, and need not be made from all starts.
UNANIMOUS = 10
"""Starts that end at the same distance from the target, after which it counts as out of reach."""

# Half of the default number of starts, none of which came within 4 mm on an arm of 200 mm.
HOPELESS, FAR = 24, 0.02
"""Starts that all end farther from the target than this share of the robot's length, after which it counts as out of
reach."""

# Round-off must not choose among mirror images, which cost the same.
SAME_COST = 1e-7
"""Relative improvement of the cost by which a later solution replaces an earlier one."""

# A program takes far longer than a descent, and only starts that stall there get one.
PROGRAM_STARTS = 4
"""Starts of the nonlinear program."""


def known_starts(space: JointSpace, clock: Clock | None = None) -> StartTable:
    """The table of configurations of a robot from which a search may begin, built or loaded once; where there is too
    little time as far as there is, and further the next time."""
    shelf = _start_tables(space)
    if not (shelf and shelf[0].whole):
        shelf[:] = [start_table(space, clock=clock)]
    return shelf[0]


@lru_cache(maxsize=32)
def _start_tables(space: JointSpace) -> list[StartTable]:
    return []


@lru_cache(maxsize=32)
def known_home(space: JointSpace) -> Posture | None:
    """The equilibrium at home, or at the joint values nearest to it that ranges and order allow; None without one."""
    home = space.middle()
    return start_at(space, home if space.admissible(home) else space.nearest(home))


@dataclass
class Multistart:
    """One search: the question, and what came of it so far.

    More starts only add to what fewer do, so that they never give a worse answer: starts come in a sequence that does
    not depend on their number, and what is done after them depends on the first of them.
    """

    goal: Goal
    first: Posture | None
    """Of the start."""
    tries: int = 0
    clear: int = 0
    """Of the tries, those from starts that are clear of the obstacles."""
    iterations: int = 0
    solves: int = 0
    least: float = np.inf
    """What the best of all searches missed by, m."""
    agreeing: int = 0
    """How many more missed by the same."""
    everywhere: bool = False
    """Whether starts are spread over all postures from the first on."""
    ends: list[list[Posture]] = field(default_factory=list)
    """Postures in which searches ended without an answer, in order, a list for each kind of start."""
    stalled: list[Posture] = field(default_factory=list)
    """Starts from which the fast path found none."""

    def one(self) -> list[InverseSolution]:
        """The answer from the seed; else the best of the first ones that a cold forward kinematics agrees with: one
        where any answer will do, several where one is to be the best."""
        wanted = COMPARED if self.goal.ranked else 1
        good: list[InverseSolution] = []
        doubtful: list[InverseSolution] = []
        for answer in self._by_starts():
            if answer.statistics.start == "seed":
                return [answer]
            (good if answer.cold_start_agrees else doubtful).append(answer)
            if len(good) == wanted or len(doubtful) == DOUBTED:
                break
        if self.goal.ranked or not good:
            for answer in self._by_programs():
                (good if answer.cold_start_agrees else doubtful).append(answer)
                if good and not self.goal.ranked:
                    break
        found = good or doubtful or list(islice(self._by_clear_starts(), 1))
        return self._cheapest(found)

    def _cheapest(self, found: list[InverseSolution]) -> list[InverseSolution]:
        """The answer of least cost, if there is one, the first of those that differ by round-off."""
        best: list[InverseSolution] = []
        least = np.inf
        for answer in found:
            cost = self.goal.cost(posture_of(self.goal.space, answer.equilibrium))
            # Relative to the cost, but with a floor: costs near 0 differ by round-off only.
            if cost < least - SAME_COST * max(abs(cost), 1e-3):
                best, least = [answer], cost
        return best

    def all(self) -> list[InverseSolution]:
        """Distinct answers, best first."""
        # Distinct answers have different postures: starts are spread over these from the first on.
        self.everywhere = True
        found = [*self._by_starts(), *self._by_programs()]
        if not found:
            found += self._by_clear_starts()
        # Rounded, so that round-off does not choose among mirror images.
        if self.goal.named:
            found.sort(key=lambda answer: round(self._distance(answer), 6))
        else:
            found.sort(key=lambda answer: (-round(answer.margin, 3), round(answer.equilibrium.energy, 9)))
        kept: list[InverseSolution] = []
        for answer in found:
            if all(_difference(answer, other) > self.goal.options.distinct for other in kept):
                kept.append(answer)
        return kept

    def _distance(self, answer: InverseSolution) -> float:
        q = self.goal.space.join(answer.rotations, answer.translations)
        return float(np.linalg.norm(self.goal.weights * (q - self.goal.reference)))

    def _by_starts(self) -> Iterator[InverseSolution]:
        """Answers from the seed, or else from near the reference, and from the table."""
        found, goal, first, name = False, self.goal, self.first, "seed"
        self.ends.append([])
        if first is None and goal.named:
            # Without a seed, but with joint values to stay near: the nearest ones within the limits.
            first, name = start_at(goal.space, goal.space.nearest(goal.reference)), "reference"
        if first is not None and (answer := self._from(first, name)) is not None:
            found = True
            yield answer
        # Four times as many starts as tries: one with too little margin, or out of the limits, counts as no try.
        for start in self._starts(4 * goal.options.starts):
            # An answer shows that the target is in reach: from then on no count of misses ends the search.
            if goal.clock.over or self.tries >= goal.options.starts or (not found and self._hopeless()):
                break
            answer = self._from(start, "table")
            if answer is None:
                self.stalled.append(start)
            else:
                found = True
                yield answer

    def _by_programs(self) -> Iterator[InverseSolution]:
        """Answers of the nonlinear program from the first starts that the fast path did not solve."""
        if self.goal.options.method != "auto" or not programmable(self.goal):
            return
        self.ends.append([])
        for start in self.stalled[:PROGRAM_STARTS]:
            if self.goal.clock.over:
                return
            if (answer := self._finished(self._by_program(start), "table", "nlp")) is not None:
                yield answer

    def _by_clear_starts(self) -> Iterator[InverseSolution]:
        """Answers from starts clear of the obstacles: others may all end in one, these stay clear."""
        if not self.goal.hindered:
            return
        self.ends.append([])
        clear = (start for start in self._starts(POOL) if self.goal.violation(start) == 0)
        for start in islice(clear, CLEAR_STARTS):
            if self.goal.clock.over:
                return
            # Tries, not starts: `_from` may refuse a start before it searches.
            before = self.tries
            answer = self._from(start, "table")
            self.clear += self.tries - before
            if answer is not None:
                yield answer

    def _starts(self, most: int) -> Iterator[Posture]:
        """Stable postures of the table, the most promising first; they may be in an obstacle."""
        goal = self.goal
        reference = goal.reference if goal.named else None
        target = (goal.position, goal.direction)
        known = known_starts(goal.space, goal.clock)
        near = nearest_starts(goal.space, known, target, min_margin=goal.floor, reference=reference)
        for q in spread_starts(goal.space, near, most, first=0 if self.everywhere else NEAREST):
            start = start_at(goal.space, q)
            if start is not None and start.margin >= goal.floor:
                yield start

    def _from(self, start: Posture, name: str) -> InverseSolution | None:
        """The answer that a search from one start gives, if it does."""
        goal, space = self.goal, self.goal.space
        if not start.admissible:
            start = start.to(space.nearest(start.q)) or start
        if start.margin < goal.floor or not start.admissible:
            return None
        self.tries += 1
        if goal.options.method == "nlp":
            return self._finished(self._by_program(start), name, "nlp")
        search = reach(goal, start)
        self._count(search)
        if not search.reached or not goal.ranked:
            return self._finished(search, name, "gauss_newton")
        if goal.options.method == "auto" and programmable(goal):
            better = self._by_program(search.posture)
            if self._better(better, search.posture, name):
                last = improve(goal, better.posture)
                return self._finished(replace(last, iterations=last.iterations + better.iterations), name, "nlp")
        search = improve(goal, search.posture)
        self._count(search)
        return self._finished(search, name, "gauss_newton")

    def _better(self, search: Search, than: Posture, name: str) -> bool:
        """Whether a solution of the program is worth having: cheaper, and for a seed reached without a snap."""
        at = search.posture
        if not search.reached or self.goal.cost(at) > self.goal.cost(than) + 1e-12:
            return False
        # From a seed the answer must be on its own branch: the seed moved to these joint values arrives there.
        return name != "seed" or same_place(than.to(at.q), at)

    def _by_program(self, start: Posture) -> Search:
        found = solve_program(self.goal, start)
        if found.reached:
            return found
        # The program's equations are those of the equilibrium; where it ends near the target the fast path finishes.
        near = self.goal.position_error(found.posture) <= 1e-4 and self.goal.allowed(found.posture)
        finished = reach(self.goal, found.posture) if near else found
        return replace(finished, iterations=found.iterations + finished.iterations)

    def _hopeless(self) -> bool:
        """Whether the target is most likely out of reach: starts agree on the closest pose, or all end far off."""
        if self.agreeing >= UNANIMOUS:
            return True
        return self.least > FAR * self.goal.space.length and self.tries >= HOPELESS

    def _count(self, search: Search) -> None:
        self.iterations += search.iterations
        self.solves += search.solves
        if search.reached:
            return
        length = self.goal.space.length
        miss = float(np.linalg.norm(self.goal.residual(search.posture))) * length
        same = SAME_MISS * length
        # A smaller miss starts the count anew, an equal one adds to it, a larger one shows nothing.
        if miss < self.least - same:
            self.agreeing = 0
        elif miss < self.least + same:
            self.agreeing += 1
        self.least = min(self.least, miss)
        self.ends[-1].append(search.posture)

    def _finished(self, search: Search, name: str, method: str) -> InverseSolution | None:
        """The search's posture as an answer; None if it is none."""
        if method == "nlp":
            self._count(search)
        if not search.reached:
            return None
        goal, at = self.goal, search.posture
        # Within the tolerance of the search it may miss that of an answer: it is corrected once more.
        if not goal.met(at):
            at = correct(goal, at, goal.slope(at), close=ON_TARGET).posture or at
        good = goal.met(at) and goal.allowed(at, SLACK)
        return self._packed(at, InverseStatus.REACHED, (name, method)) if good else None

    def _packed(self, at: Posture, status: InverseStatus, how: tuple[str, str]) -> InverseSolution:
        goal, (name, method) = self.goal, how
        origin, begin = ("seed", self.first) if self.first is not None else ("home", known_home(goal.space))
        way = straight_way(origin, begin, at)
        straight = None if self.first is None else way is not None
        return answer_at(
            goal,
            at,
            status,
            InverseStatistics(method, name, max(self.tries, 1), self.iterations, self.solves, goal.clock.seconds),
            cold_start_agrees=same_place(start_at(goal.space, at.q), at),
            straight_from_seed=straight,
            reachable=None if way is None else True,
            path=way,
        )

    def failure(self, on_failure: str) -> InverseSolution:
        """The closest pose, returned or raised with a message that says by how far the target is missed, and why; where
        it is on target, an answer."""
        goal, late = self.goal, self.goal.clock.over
        search = closest_of(goal, self.ends)
        if search is None:
            raise SolveError(self._without_a_pose(late))
        self.iterations, self.solves = self.iterations + search.iterations, self.solves + search.solves
        at = search.posture
        if goal.met(at) and goal.allowed(at, SLACK):  # what the searches from the starts missed
            return self._packed(at, InverseStatus.REACHED, ("table", "gauss_newton"))
        status = InverseStatus.TIMED_OUT if late else InverseStatus.CLOSEST
        closest = self._packed(at, status, ("table", "gauss_newton"))
        if on_failure == "closest":
            return closest
        others = self.tries - self.clear
        tried = f"in {others} start{'' if others == 1 else 's'}" + (
            f" and {self.clear} clear of the obstacles" if self.clear else ""
        )
        if late:
            tried = f"within {self.goal.options.time_limit:g} s, {tried.replace('in', 'after', 1)}"
        cause, advice = self._cause(at, late)
        raise SolveError(f"target not reached {tried}: {missed_by(goal, at)}: {cause}; {advice}", closest)

    def _cause(self, at: Posture, late: bool) -> tuple[str, str]:
        """Why the closest pose misses the target, and what to change; the first that applies."""
        goal = self.goal
        beyond = goal.beyond_reach()
        if beyond > 0:
            far = f"the target is out of reach, {millimetres(beyond)} beyond the longest arm"
            return far, "move it closer to the plate"
        if late:
            return "whether the target can be reached is not known", "increase time_limit"
        limit, advice = held_most(goal, at)
        if limit and goal.pointed:
            advice = "leave the direction free, or give it a direction_weight"
        return (limit, advice) if limit else ("the search ended in a local minimum", "increase starts")

    def _without_a_pose(self, late: bool) -> str:
        """Why there is not even a closest pose."""
        goal = self.goal
        if late:
            return (
                f"no answer was found within {goal.options.time_limit:g} s, which ran out before any search had ended: "
                "whether the target can be reached is not known"
            )
        best = max(
            float(known_starts(goal.space).margin.max(initial=-np.inf)),
            -np.inf if self.first is None else self.first.margin,
        )
        if best < goal.floor:
            return (
                f"no start was found: no known configuration has a margin of at least {goal.min_margin:g}, "
                f"the largest is {best:.4g}"
            )
        if goal.scene.bodies:
            return (
                f"no start was found: no search of {self.tries} ended clear of the obstacles by {goal.clearance:g} m, "
                f"with a margin of at least {goal.min_margin:g}"
            )
        return f"no answer was found: none of {self.tries} starts could be brought inside of the limits"


def _difference(one: InverseSolution, other: InverseSolution) -> float:
    """Largest distance of two arms at equal shares of their lengths, over the longer of them."""
    arms = one.equilibrium, other.equilibrium
    (a, _), (b, _) = (ArmSurface(arm).line(33) for arm in arms)
    # Arms that are withdrawn all the way have length 0, and do not differ.
    longest = max(float(arm.arc_length[-1]) for arm in arms)
    return float(np.linalg.norm(a - b, axis=1).max()) / max(longest, 1e-300)
