"""Search from many starts, by Gauss-Newton and the nonlinear program, and the table of starts.

Turning the whole robot about the axis of its plate, or a tube by whole turns, does not change the shape: so
configurations are compared with a target by height and distance from the axis, and turned to its azimuth.
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
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.batch import solved_batch
from ..equilibrium.directions import ARRANGEMENT
from ..equilibrium.kinematics import has_kernel
from ..errors import InputError, SolveError
from ..files.files import atomic_write
from ..solvers.compiled.library import cache_directory
from ..typing import Array
from .answer import InverseSolution, InverseStatistics, InverseStatus
from .clock import Clock
from .closest import SAME_MISS, closest_of
from .gauss_newton import ON_TARGET, SLACK, DescentSearch, correct, improve, reach
from .goal import Goal
from .joint_path import answer_at, straight_path
from .joints import JointSpace
from .miss import limiting_constraint, millimetres, miss_text
from .posture import Posture, posture_of, same_posture, start_at
from .program import programmable, solve_program

VERSION = 5
"""Version of the table: files of other versions are not read."""

SIZE, SIZE_OF_MANY = 2048, 512
"""Configurations per table; the second for more than `MANY` joints, among which a start leads to most targets."""

MANY = 8

SIZE_UNCOMPILED = 192
"""Configurations per table of a robot without a compiled kernel, whose equilibria take a hundred times as long."""

WIDEST = np.pi / 2
"""Largest separation of the tubes of an eccentric segment in the table; 120 deg is straight."""

# A fifth of the table: among more, the configurations that differ most are far from the target.
POOL = 400
"""Configurations, the most promising, among which starts are spread."""

# A direction error of 60 deg weighs as much as a miss of a third of the length. Nearness only orders starts that are
# otherwise alike.
DIRECTION_WEIGHT, NEARNESS_WEIGHT = 0.35, 0.02
"""Weights of the direction error and of the distance from a reference, in the ranking of starts.

They are relative to the position error over the robot's length; the distance is in units of the joints' scales.
"""

MIN_MARGIN = 0.01
"""Smallest margin of a configuration in the table."""


@dataclass(frozen=True, eq=False)
class StartTable:
    """Table of stable configurations."""

    q: Array
    """Joint values (N, m)."""
    tip: Array
    """Tip positions (N, 3), m."""
    direction: Array
    """Tip directions (N, 3)."""
    margin: Array
    """Stability margins (N,) of the starts."""
    tried: int
    """Number of configurations tried, stable or not."""
    complete: bool
    """True if all configurations were tried within the time limit."""

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Joint values, tips, directions and margins."""
        return self.q, self.tip, self.direction, self.margin


def build_table(
    space: JointSpace, size: int, clock: Clock | None = None, partial: StartTable | None = None
) -> StartTable:
    """Table of the stable equilibria of `size` configurations spread over the joint limits.

    It continues a `partial` table, and is partial itself if the time runs out.
    """
    clock = clock or Clock(math.inf)
    samples = _by_mirror(space, space.sample(size))
    n, m = space.robot.n_tubes, len(space.lower)
    if partial is None:
        partial = StartTable(np.empty((0, m)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), 0, complete=False)
    # Where ends of bundles stay together the general solver takes half a second, the kernel milliseconds.
    quick = not space.robot.fixed_sections and has_kernel(space.robot)
    parts, tried = [partial.arrays], partial.tried
    count = 8  # configurations between two checks of the clock, more where these are quick
    while tried < size and not clock.over:
        start_time, batch = clock.seconds, samples[tried : tried + count]
        joint = space.joint(batch)
        solved = solved_batch(space.robot, joint[:, :n], joint[:, n:], quick=quick)
        # Rows without an equilibrium have margin NaN: as 0 they are below MIN_MARGIN.
        stable = solved.converged & (np.nan_to_num(solved.margin) >= MIN_MARGIN)
        parts.append(
            (batch[stable], solved.tip_position[stable], solved.tip_rotation[stable, :, 2], solved.margin[stable])
        )
        tried += count
        # Batches double while they are quick, up to 128: a slow robot still stops near its time limit.
        if clock.seconds - start_time < 0.02:
            count = min(2 * count, 128)
    q, tip, direction, margin = (np.concatenate(each) for each in zip(*parts, strict=True))
    table = StartTable(q, tip, direction, margin, tried, complete=tried >= size)
    if table.complete and not len(table.q):
        raise InputError("no stable equilibrium was found within the limits")
    return table


def _by_mirror(space: JointSpace, q: Array) -> Array:
    """Samples (N, m) with mirror-symmetric rotations of the three tubes of every eccentric segment.

    The first tube is turned to a direction, the others to either side of it. Three independent rotations mostly twist a
    long transmission until it snaps.
    """
    if not space.robot.axes.any():
        return q
    out = q.copy()
    for tubes in space.robot.moving_together if space.robot.fixed_sections else ():
        # The second rotation of a sample, 0 to 1 over its range, becomes the separation: samples stay evenly spread.
        middle, apart = q[:, tubes[0]], WIDEST * (q[:, tubes[1]] - space.lower[tubes[1]])
        span = space.upper[tubes[1]] - space.lower[tubes[1]]
        apart = apart / span if span > 0 else np.zeros(len(q))
        out[:, list(tubes)] = np.column_stack([middle, middle + apart, middle - apart])
    n = space.robot.n_tubes
    out[:, :n] = np.clip(space.wrap(out, space.middle())[:, :n], space.lower[:n], space.upper[:n])
    return out


def start_table(space: JointSpace, size: int | None = None, clock: Clock | None = None) -> StartTable:
    """Table of a joint space, from the cache on disk, or built and stored there."""
    fewer = SIZE_OF_MANY if len(space.lower) > MANY or not space.robot.fixed_sections else SIZE
    size = size or (fewer if has_kernel(space.robot) else SIZE_UNCOMPILED)
    path = cache_directory() / f"inverse-{_key(space, size)}.npz"
    stored = _read(path, len(space.lower), size)
    if stored is not None and stored.complete:
        return stored
    table = build_table(space, size, clock, stored)
    # Nothing new was tried: the file needs no change.
    if table.tried == (stored.tried if stored is not None else 0):
        return table
    try:
        with atomic_write(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, q=table.q, tip=table.tip, direction=table.direction, margin=table.margin, tried=table.tried)
    except InputError:
        pass  # Without a place to keep it, the table is built anew in the next process: slower, not wrong.
    return table


def _key(space: JointSpace, size: int) -> str:
    """Hash of all inputs of the table."""
    tubes = in_full((VERSION, size, type(space.robot).__name__, space.robot.tubes, space.carriages))
    digest = hashlib.sha256(tubes.encode())
    for array in (
        space.lower,
        space.upper,
        space.rows,
        space.row_lower,
        space.joint(space.lower),
        space.robot.axes,
        np.array([getattr(space.robot, name, None) or 0.0 for name in ARRANGEMENT[2:]]),
    ):
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.hexdigest()[:32]


def _read(path: Path, joints: int, size: int) -> StartTable | None:
    """Table in a file, possibly partial; None for a missing or damaged file."""
    try:
        # The content, not the path: of a damaged file numpy would leave the handle open.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            tried = int(file["tried"])
            table = StartTable(file["q"], file["tip"], file["direction"], file["margin"], tried, complete=tried >= size)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    count = len(table.margin)
    shapes = [(count, joints), (count, 3), (count, 3), (count,)]
    fitting = [each.shape for each in table.arrays] == shapes
    return table if fitting and (count or not table.complete) else None


def nearest_starts(
    space: JointSpace,
    table: StartTable,
    target: tuple[Array, Array | None],
    *,
    min_margin: float,
    reference: Array | None,
) -> Array:
    """Configurations (k, m) of a table, turned to a target (position, direction or None), most promising first.

    Those with less than `min_margin` are omitted. Those that cannot be turned to its azimuth are turned as far as the
    limits allow.
    """
    position, direction = target
    mirrored = direction is not None and not space.robot.axes.any()
    known = _mirrored(space, table) if mirrored else table
    chosen = known.margin >= min_margin
    q, tip, pointing = known.q[chosen], known.tip[chosen], known.direction[chosen]
    if not len(q):
        return q
    centre = space.middle() if reference is None else reference
    azimuth = np.arctan2(position[1], position[0]) - np.arctan2(tip[:, 1], tip[:, 0])
    n = space.robot.n_tubes
    turned = q.copy()
    turned[:, :n] += azimuth[:, None]
    turned = space.wrap(turned, centre)
    outside = ~((turned >= space.lower) & (turned <= space.upper)).all(1)
    # Where whole turns do not help, turn as far as the narrowest range allows.
    lower_turns, upper_turns = (space.lower[:n] - q[:, :n]).max(1), (space.upper[:n] - q[:, :n]).min(1)
    # The turn within -pi .. pi, the shortest of those that differ by whole turns.
    part = np.clip((azimuth + np.pi) % (2 * np.pi) - np.pi, lower_turns, np.maximum(upper_turns, lower_turns))
    turned[outside] = q[outside]
    turned[outside, :n] += part[outside, None]
    azimuth = np.where(outside, part, azimuth)
    cost = np.linalg.norm(_turned(tip, azimuth) - position, axis=1) / space.length
    if direction is not None:
        cost = cost + DIRECTION_WEIGHT * np.linalg.norm(_turned(pointing, azimuth) - direction, axis=1)
    if reference is not None:
        cost = cost + NEARNESS_WEIGHT * np.linalg.norm((turned - reference) / space.scale, axis=1)
    # Rounded, so that round-off does not choose among mirror images.
    return space.clip(turned[np.argsort(np.round(cost, 9), kind="stable")])


def spread_starts(space: JointSpace, q: Array, count: int, *, first: int) -> Iterator[Array]:
    """Select up to `count` of joint values (k, m), sorted by promise, by the farthest-point method (Gonzalez 1985).

    The `first` of them are returned in order, then those that differ most from all before, among the `POOL` most
    promising.
    """
    if len(q) <= first:
        yield from q
        return
    q = q[: max(POOL, first + 1)]
    yield from q[: max(first, 1)]
    n = space.robot.n_tubes
    relative = q[:, :n] - q[:, n - 1 : n]
    # Rotations against the outermost tube, as points of circles; the turn of the whole robot follows from the target.
    features = np.hstack([np.cos(relative), np.sin(relative), q[:, n:] / space.scale[n:]])
    # Distance from the nearest chosen one (Gonzalez, Theor. Comput. Sci. 38 (1985)).
    distance = np.min([np.linalg.norm(features - chosen, axis=1) for chosen in features[: max(first, 1)]], axis=0)
    for _ in range(min(count, len(q)) - max(first, 1)):
        # Rounded, so that of mirror images the more promising one is taken.
        farthest = int(np.argmax(np.round(distance, 9)))
        # All others equal one that was chosen.
        if distance[farthest] <= 0:
            return
        yield q[farthest]
        distance = np.minimum(distance, np.linalg.norm(features - features[farthest], axis=1))


def _mirrored(space: JointSpace, table: StartTable) -> StartTable:
    """Table with the mirror image of every configuration in the plane x = 0: all rotations negative."""
    flipped, mirror = table.q.copy(), np.array([-1.0, 1.0, 1.0])
    flipped[:, : space.robot.n_tubes] *= -1
    # Negated rotations may leave the limits: whole turns bring some back, and the others are left out.
    flipped = space.wrap(flipped, space.middle())
    inside = ((flipped >= space.lower) & (flipped <= space.upper)).all(1)
    images = flipped, table.tip * mirror, table.direction * mirror, table.margin
    q, tip, direction, margin = (
        np.concatenate([array, image[inside]]) for array, image in zip(table.arrays, images, strict=True)
    )
    return StartTable(q, tip, direction, margin, table.tried, table.complete)


def _turned(vectors: Array, angle: Array) -> Array:
    """Vectors (N, 3) turned about z by angles (N,)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])


# Where the target is easy one of the first reaches it. Spread starts come next, since the nearest ones are often of
# one posture, which an obstacle may block as a whole.
NEAREST = 12
"""Number of most promising starts that are tried first; later starts are spread over all postures."""

# Finding a clear one takes up to 400 forward kinematics, so that these come last.
CLEAR_STARTS = 8
"""Number of starts clear of obstacles that are tried if all others end in one."""

# Each further one costs another search.
COMPARED = 3
"""Number of solutions compared for an objective without a start."""

# An answer that a cold start does not find is of another branch at the same joint values: correct, but harder to use.
DOUBTED = 4
"""Number of solutions that forward kinematics without a start does not find, after which the search ends."""

# Out of reach all descents end at the same closest pose, and need not be made from all starts.
UNANIMOUS = 10
"""Number of starts that end at the same distance before the target counts as out of reach."""

# The ends above are of the most promising starts, which may all lie in the valley of one minimum. A start ends at the
# global minimum with a probability of at least 0.3 (60 targets of five robots): 16 miss it in 0.3 % of the cases.
SPREAD = 16
"""Number of configurations spread over all joint ranges from which the closest pose is searched as well."""

# Half of the default number of starts, none of which came within 4 mm on an arm of 200 mm.
HOPELESS, FAR = 24, 0.02
"""Number of starts that all end farther from the target than this, relative to the robot's length, after which it
counts as out of reach."""

# Round-off must not choose among mirror images, which cost the same.
SAME_COST = 1e-7
"""Smallest relative improvement of the cost of a later solution that replaces an earlier one."""

# A program takes far longer than a descent, and only starts that stall there get one.
PROGRAM_STARTS = 4
"""Starts of the nonlinear program."""


def known_starts(space: JointSpace, clock: Clock | None = None) -> StartTable:
    """Table of starts, built or loaded once per process; a partial table is continued by the next call."""
    table = _TABLES.get(space)
    if table is None or not table.complete:
        table = start_table(space, clock=clock)
    # The last spaces used: the oldest one is dropped.
    _TABLES.pop(space, None)
    _TABLES[space] = table
    if len(_TABLES) > MAX_TABLES:
        _TABLES.pop(next(iter(_TABLES)), None)
    return table


MAX_TABLES = 32
_TABLES: dict[JointSpace, StartTable] = {}


@lru_cache(maxsize=32)
def known_home(space: JointSpace) -> Posture | None:
    """Posture at home, or at the nearest admissible joint values; None without a stable equilibrium."""
    home = space.middle()
    return start_at(space, home if space.admissible(home) else space.nearest(home))


@dataclass
class Multistart:
    """State of a search from many starts.

    More starts never give a worse solution: starts come in a sequence that does not depend on their number, and later
    stages depend on the first of them.
    """

    goal: Goal
    first: Posture | None
    """Posture of the given start, or None."""
    tries: int = 0
    clear: int = 0
    """Number of tries from starts that are clear of obstacles."""
    iterations: int = 0
    solves: int = 0
    smallest_miss: float = np.inf
    """Smallest distance from the target of all searches, m."""
    agreeing: int = 0
    """Number of further searches with the same distance."""
    everywhere: bool = False
    """True if starts are spread over all postures from the first on."""
    ends: list[list[Posture]] = field(default_factory=list)
    """Final postures of searches off target, in order, a list for each stage."""
    stalled: list[Posture] = field(default_factory=list)
    """Starts with a Gauss-Newton search that did not reach the target."""

    def one(self) -> list[InverseSolution]:
        """Solution from the start, or else the best of the first confirmed solutions.

        Forward kinematics without a start confirms them.

        Without a cost the first one counts, with a cost several are compared.
        """
        count = COMPARED if self.goal.ranked else 1
        good: list[InverseSolution] = []
        doubtful: list[InverseSolution] = []
        for answer in self._by_starts():
            if answer.statistics.start == "seed":
                return [answer]
            (good if answer.cold_start_agrees else doubtful).append(answer)
            if len(good) == count or len(doubtful) == DOUBTED:
                break
        if self.goal.ranked or not good:
            for answer in self._by_programs(in_reach=bool(good or doubtful)):
                (good if answer.cold_start_agrees else doubtful).append(answer)
                if good and not self.goal.ranked:
                    break
        return self._cheapest(good or doubtful or list(islice(self._by_clear_starts(), 1)))

    def _cheapest(self, answers: list[InverseSolution]) -> list[InverseSolution]:
        """Solution of smallest cost, the first of those that differ by round-off; empty without solutions."""
        best: list[InverseSolution] = []
        smallest = np.inf
        for answer in answers:
            cost = self.goal.cost(posture_of(self.goal.space, answer.equilibrium))
            # Relative to the cost, but with a floor: costs near 0 differ by round-off only.
            if cost < smallest - SAME_COST * max(abs(cost), 1e-3):
                best, smallest = [answer], cost
        return best

    def all(self) -> list[InverseSolution]:
        """Distinct solutions, best first."""
        # Distinct solutions have different postures: starts are spread over these from the first on.
        self.everywhere = True
        postures = [*self._by_starts()]
        postures += self._by_programs(in_reach=bool(postures))
        if not postures:
            postures += self._by_clear_starts()
        # Rounded, so that round-off does not choose among mirror images.
        if self.goal.named:
            postures.sort(key=lambda answer: round(self._distance(answer), 6))
        else:
            postures.sort(key=lambda answer: (-round(answer.margin, 3), round(answer.equilibrium.energy, 9)))
        distinct: list[InverseSolution] = []
        for answer in postures:
            if all(_difference(answer, each) > self.goal.options.distinct for each in distinct):
                distinct.append(answer)
        return distinct

    def _distance(self, answer: InverseSolution) -> float:
        q = self.goal.space.join(answer.rotations, answer.translations)
        return float(np.linalg.norm(self.goal.weights * (q - self.goal.reference)))

    def _by_starts(self) -> Iterator[InverseSolution]:
        """Solutions from the start or near the reference, then from the table."""
        any_found, goal, first, name = False, self.goal, self.first, "seed"
        self.ends.append([])
        if first is None and goal.named:
            # Without a start, but with joint values to stay near: the nearest ones within the limits.
            first, name = start_at(goal.space, goal.space.nearest(goal.reference)), "reference"
        if first is not None and (answer := self._from(first, name)) is not None:
            any_found = True
            yield answer
        # Four times as many starts as tries: one with too little margin, or out of the limits, counts as no try.
        for start in self._starts(4 * goal.options.starts):
            # An answer shows that the target is in reach: from then on no count of misses ends the search.
            if goal.clock.over or self.tries >= goal.options.starts or (not any_found and self._hopeless()):
                break
            answer = self._from(start, "table")
            if answer is None:
                self.stalled.append(start)
            else:
                any_found = True
                yield answer

    def _by_programs(self, *, in_reach: bool) -> Iterator[InverseSolution]:
        """Solutions of the nonlinear program from the first starts that Gauss-Newton did not solve.

        None for a target that is most likely out of reach, without obstacles: programs would take most of the time.
        """
        if self.goal.options.method != "auto" or not programmable(self.goal):
            return
        if not in_reach and self._hopeless() and not self.goal.hindered:
            return
        self.ends.append([])
        for start in self.stalled[:PROGRAM_STARTS]:
            if self.goal.clock.over:
                return
            if (answer := self._finished(self._by_program(start), "table", "nlp")) is not None:
                yield answer

    def _by_clear_starts(self) -> Iterator[InverseSolution]:
        """Solutions from starts that are clear of obstacles, and stay so."""
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

    def _starts(self, count: int) -> Iterator[Posture]:
        """Stable postures of the table, at most `count`, the most promising first; they may be in an obstacle."""
        goal = self.goal
        reference = goal.reference if goal.named else None
        target = (goal.position, goal.direction)
        known = known_starts(goal.space, goal.clock)
        nearest = nearest_starts(goal.space, known, target, min_margin=goal.kept_margin, reference=reference)
        for q in spread_starts(goal.space, nearest, count, first=0 if self.everywhere else NEAREST):
            start = start_at(goal.space, q)
            if start is not None and start.margin >= goal.kept_margin:
                yield start

    def _spread(self) -> Iterator[Posture]:
        """Postures of the first SPREAD configurations of the table, turned to the target, within the time limit."""
        goal = self.goal
        if goal.clock.over or not has_kernel(goal.space.robot):  # each descent would take seconds
            return
        known, target = known_starts(goal.space, goal.clock), (goal.position, goal.direction)
        table = replace(known, **{name: getattr(known, name)[:SPREAD] for name in ("q", "tip", "direction", "margin")})
        for q in nearest_starts(goal.space, table, target, min_margin=goal.kept_margin, reference=None):
            start = start_at(goal.space, q)
            if start is not None:
                yield start

    def _from(self, start: Posture, name: str) -> InverseSolution | None:
        """Solution of a search from one start, or None."""
        goal, space = self.goal, self.goal.space
        if not start.admissible:
            start = start.to(space.nearest(start.q)) or start
        if start.margin < goal.kept_margin or not start.admissible:
            return None
        self.tries += 1
        if goal.options.method == "nlp":
            return self._finished(self._by_program(start), name, "nlp")
        search = reach(goal, start)
        self._count(search)
        if not search.reached or not goal.ranked:
            return self._finished(search, name, "gauss_newton")
        if goal.options.method == "auto" and programmable(goal):
            program = self._by_program(search.posture)
            if self._better(program, search.posture, name):
                last = improve(goal, program.posture)
                return self._finished(replace(last, iterations=last.iterations + program.iterations), name, "nlp")
        search = improve(goal, search.posture)
        self._count(search)
        return self._finished(search, name, "gauss_newton")

    def _better(self, search: DescentSearch, than: Posture, name: str) -> bool:
        """True if a solution of the program has a smaller cost and, from a given start, is reached without a snap."""
        at = search.posture
        if not search.reached or self.goal.cost(at) > self.goal.cost(than) + 1e-12:
            return False
        # From a given start the solution must be on its branch: the start moved to these joint values arrives there.
        return name != "seed" or same_posture(than.to(at.q), at)

    def _by_program(self, start: Posture) -> DescentSearch:
        """Search by the nonlinear program, finished by Gauss-Newton if it ends near the target."""
        posture = solve_program(self.goal, start)
        if posture.reached:
            return posture
        is_close = self.goal.position_error(posture.posture) <= 1e-4 and self.goal.allowed(posture.posture)
        finished = reach(self.goal, posture.posture) if is_close else posture
        return replace(finished, iterations=posture.iterations + finished.iterations)

    def _hopeless(self) -> bool:
        """True if the target is most likely out of reach: starts agree on the closest pose, or all end far off."""
        if self.agreeing >= UNANIMOUS:
            return True
        return self.smallest_miss > FAR * self.goal.space.length and self.tries >= HOPELESS

    def _count(self, search: DescentSearch) -> None:
        """Add a search to the statistics."""
        self.iterations += search.iterations
        self.solves += search.solves
        if search.reached:
            return
        length = self.goal.space.length
        miss = float(np.linalg.norm(self.goal.residual(search.posture))) * length
        same = SAME_MISS * length
        # A smaller miss starts the count anew, an equal one adds to it, a larger one shows nothing.
        if miss < self.smallest_miss - same:
            self.agreeing = 0
        elif miss < self.smallest_miss + same:
            self.agreeing += 1
        self.smallest_miss = min(self.smallest_miss, miss)
        self.ends[-1].append(search.posture)

    def _finished(self, search: DescentSearch, name: str, method: str) -> InverseSolution | None:
        """Solution at the end of a search; None if it is off target or violates a constraint."""
        if method == "nlp":
            self._count(search)
        if not search.reached:
            return None
        goal, at = self.goal, search.posture
        # The tolerance of the search is larger than that of a solution: it is corrected once more.
        if not goal.met(at):
            at = correct(goal, at, goal.slope(at), tolerance=ON_TARGET).iterate or at
        good = goal.met(at) and goal.allowed(at, SLACK)
        return self._packed(at, InverseStatus.REACHED, name, method) if good else None

    def _packed(
        self, at: Posture, status: InverseStatus, name: str = "table", method: str = "gauss_newton"
    ) -> InverseSolution:
        """Solution at a posture, with the straight path to it if it has no snap."""
        goal = self.goal
        origin, start = ("seed", self.first) if self.first is not None else ("home", known_home(goal.space))
        path = straight_path(origin, start, at)
        straight = None if self.first is None else path is not None
        return answer_at(
            goal,
            at,
            status,
            InverseStatistics(
                method=method,
                start=name,
                tries=max(self.tries, 1),
                iterations=self.iterations,
                solves=self.solves,
                seconds=goal.clock.seconds,
            ),
            cold_start_agrees=same_posture(start_at(goal.space, at.q), at),
            straight_from_seed=straight,
            reachable=None if path is None else True,
            path=path,
        )

    def failure(self, on_failure: str) -> InverseSolution:
        """Closest pose, returned or raised as SolveError with the miss and its cause; a solution if it is on target."""
        goal, out_of_time = self.goal, self.goal.clock.over
        search = closest_of(goal, self.ends, self._spread())
        if search is None:
            raise SolveError(self._without_a_pose(out_of_time))
        self.iterations, self.solves = self.iterations + search.iterations, self.solves + search.solves
        at = search.posture
        if goal.met(at) and goal.allowed(at, SLACK):  # what the searches from the starts missed
            return self._packed(at, InverseStatus.REACHED)
        status = InverseStatus.TIMED_OUT if out_of_time else InverseStatus.CLOSEST
        closest = self._packed(at, status)
        if on_failure == "closest":
            return closest
        count = self.tries - self.clear
        tried = f"in {count} start{'' if count == 1 else 's'}" + (
            f" and {self.clear} clear of the obstacles" if self.clear else ""
        )
        if out_of_time:
            tried = f"within {self.goal.options.time_limit:g} s, {tried.replace('in', 'after', 1)}"
        cause, advice = self._cause(at, out_of_time)
        raise SolveError(f"target not reached {tried}: {miss_text(goal, at)}: {cause}; {advice}", closest)

    def _cause(self, at: Posture, out_of_time: bool) -> tuple[str, str]:
        """Cause of the miss of the closest pose, and advice: the first cause that applies."""
        goal = self.goal
        beyond = goal.beyond_reach()
        if beyond > 0:
            distance = f"the target is out of reach, {millimetres(beyond)} beyond the longest arm"
            return distance, "move it closer to the plate"
        if out_of_time:
            return "whether the target can be reached is not known", "increase time_limit"
        limit, advice = limiting_constraint(goal, at)
        if limit and goal.pointed:
            advice = "leave the direction free, or give it a direction_weight"
        return (limit, advice) if limit else ("the search ended in a local minimum", "increase starts")

    def _without_a_pose(self, out_of_time: bool) -> str:
        """Message of a search without a closest pose."""
        goal = self.goal
        if out_of_time:
            return (
                f"no answer was found within {goal.options.time_limit:g} s, which ran out before any search had ended: "
                "whether the target can be reached is not known"
            )
        best = max(
            float(known_starts(goal.space).margin.max(initial=-np.inf)),
            -np.inf if self.first is None else self.first.margin,
        )
        if best < goal.kept_margin:
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


def _difference(first: InverseSolution, second: InverseSolution) -> float:
    """Largest distance of two arms at equal fractions of their lengths, relative to the longer one."""
    arms = first.equilibrium, second.equilibrium
    (a, _), (b, _) = (ArmSurface(arm).line(33) for arm in arms)
    # Arms that are fully withdrawn have length 0, and do not differ.
    longest = max(float(arm.arc_length[-1]) for arm in arms)
    return float(np.linalg.norm(a - b, axis=1).max()) / max(longest, 1e-300)
