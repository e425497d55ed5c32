"""Reading of the columns of a recording: units, directions and zeros, found from the tips that they lead to.

A reading is right if the robot, driven by it, has its tips where they were measured, up to a motion of the device. So
candidates are compared by the distance that the best rigid registration leaves.

1. Units follow from sizes where only one is possible: nothing moves by 80 m. Rotations in deg or rad may both be.
2. For all directions of rotation, least squares start from likely places of the carriages and from the best zeros of
   rotations on a grid. Zeros are unknowns, and factors on the motion of the carriages: they begin at 0 and decide by
   their signs in which direction each carriage counts.
3. The best ones are refined with factors of 1 or -1, and with the latency where rows have times.
4. Every single change of the best reading is refined too. What it leaves says how certain the reading is.

The frame of the device is right-handed. In a left-handed one all rotations turn the other way.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ImplausibleWarning, InputError, SolveError
from ..robots.concentric import ConcentricRobot
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.robust_least_squares import LeastSquaresSolver, Weights, descend
from ..typing import Array, Index, Progress
from .measurements import unwrapped
from .model import solve_poses
from .registration import registered_residuals

ANGLES = {"deg": math.pi / 180, "rad": 1.0}
LENGTHS = {"mm": 1e-3, "m": 1.0}

# Ranges that drives move over in a recording: rotations (rad), and the largest one of translations, in lengths of the
# longest tube. Less moves no tip visibly, more no robot allows.
TURNED, SHIFTED = (math.radians(4.0), 6 * math.pi), (2e-3, 1.0)

# Spread of moving tips, in lengths of the arm. Metres taken for millimetres change it by 1000.
SPREAD = (0.02, 8.0)

# A reading is certain if every other one leaves this many times its distance. A wrong direction leaves as much as the
# tips move because of it, a missing effect leaves some millimetres with either direction.
CERTAIN = 1.4

# Distance that the best reading may leave, in root mean squares of the tips about their mean. The best of wrong ones
# leaves about as much as this.
EXPLAINED = 0.5

# Rows of the search and of the refinement. Directions and zeros are up to 13 numbers.
SEARCH_ROWS, ROWS = 24, 60

# Fewer rows than this leave most readings open.
FEWEST_ROWS = 12

# Zeros of every rotation but the first on the grid, by their number: least squares find their way over 30 deg.
GRID = {1: 12, 2: 6, 3: 4}
MOST_STARTS = 64

# Places of the carriages where the search starts, in their range: least squares find their way over 40 mm.
PLACES = (0.3, 0.5, 0.7)
RANDOM_PLACES = 8

# Readings that are refined after the search, and alternatives of each kind.
KEPT, ALTERNATIVES = 6, 2

# Largest change of the zero of a rotation, rad, factor on the motion of a carriage in the search, and latency, s.
LARGEST_STEP, LARGEST_FACTOR, LARGEST_LATENCY = 1.6, 1.5, 0.5

# Search, and refinement: a thousandth of the cost is far below what parts readings.
SEARCHING, REFINING = LeastSquaresSolver(iterations=10, settled=1e-2), LeastSquaresSolver(iterations=20, settled=1e-3)

# Steps of differences: rad, m, parts of 1, s. Equilibria are exact to 1e-8.
STEPS = {"rotation": 1e-4, "translation": 1e-5, "factor": 1e-4, "latency": 1e-4}

# What is decided together with the first rotation.
ALL = "all rotations with"

# Relative decrease of the distance from which on another reading is a better one.
BETTER = 0.02


@dataclass(frozen=True, eq=False)
class RawLog:
    """Columns of a recording as they are written, of n tubes."""

    rotations: Array
    """(M, n)."""
    translations: Array
    """(M, n); NaN in the columns of tubes that have none."""
    joint_time: Array | None
    """(M,) s."""
    sensors: Array
    """(N, S, 3); NaN where a sensor was not seen."""
    time: Array | None
    """(N,) s; None for rows without an order, of which there are M."""
    rotation_units: tuple[str, ...] = tuple(ANGLES)
    """Units that the rotations may have, the stated one first."""
    translation_units: tuple[str, ...] = tuple(LENGTHS)
    """The same for translations."""
    position_units: tuple[str, ...] = tuple(LENGTHS)
    """The same for positions."""


@dataclass(frozen=True)
class Reading:
    """Units, directions and zeros of the columns of a recording."""

    rotation_unit: str
    translation_unit: str
    position_unit: str
    rotation_signs: tuple[int, ...]
    """1, or -1 for a drive that counts the other way."""
    translation_signs: tuple[int, ...]
    rotation_zeros: tuple[float, ...]
    """Added to the rotations, rad; 0 for the first tube, whose zero the registration has."""
    translation_zeros: tuple[float, ...]
    """Added to the translations, m."""
    latency: float = 0.0
    """Delay of the tips behind the joints, s."""


@dataclass(frozen=True)
class Decision:
    """A choice between two readings of a column, or of columns of a kind."""

    about: str
    """Name of the column, as "rotation_2"."""
    chosen: str
    other: str
    rms: float
    """Distance (root mean square) that the chosen reading leaves, m; NaN where sizes decide."""
    other_rms: float
    """Distance that the other one leaves, m; infinite where it is impossible."""
    certain: bool
    reason: str = ""
    """Reason, if distances do not decide; "" otherwise."""


@dataclass(frozen=True)
class Detection:
    """Reading of a recording, and how certain it is."""

    reading: Reading
    rms: float
    """Distance (root mean square) that it leaves, of the robot as given, m."""
    spread: float
    """Root mean square distance of the tips from their mean, m."""
    decisions: tuple[Decision, ...]


@dataclass(frozen=True, eq=False)
class _Point:
    """Unknowns of a reading: zeros, factors and latency."""

    x: Array

    def moved(self, step: Array) -> _Point:
        return _Point(self.x + step)


class _Zeros:
    """Distances of registered tips at some rows by the zeros of a reading: a model for `descend`.

    Args:
        search: the recording.   reading: its units, directions, and the zeros to begin with.
        rows: of positions.   free: True for factors on the carriages and no latency, which are 0 at the start.
    """

    freedoms = 0

    def __init__(self, search: Search, reading: Reading, rows: Index, *, free: bool) -> None:
        self.search, self.reading, self.rows = search, reading, rows
        self.tips = search.tips(rows) * LENGTHS[reading.position_unit]
        self.spread = float(np.sqrt(((self.tips - self.tips.mean(0)) ** 2).sum(1).mean()))
        n, carriages = search.n, search.carriages
        self.kinds = ["rotation"] * (n - 1) + ["translation"] * len(carriages)
        start = [*reading.rotation_zeros[1:], *(reading.translation_zeros[c[0]] for c in carriages)]
        reach = [LARGEST_STEP] * (n - 1) + [math.inf] * len(carriages)
        low, high = ([x + sign * r for x, r in zip(start, reach, strict=True)] for sign in (-1, 1))
        if free:
            self.kinds += ["factor"] * len(search.sliding)
            start += [0.0] * len(search.sliding)
            low, high = low + [-LARGEST_FACTOR] * len(search.sliding), high + [LARGEST_FACTOR] * len(search.sliding)
        elif search.log.time is not None:
            self.kinds.append("latency")
            start.append(reading.latency)
            low, high = [*low, -LARGEST_LATENCY], [*high, LARGEST_LATENCY]
        self.start, self.bounds = _Point(np.array(start)), np.array([low, high])
        self.free = free
        self.steps = np.array([STEPS[kind] for kind in self.kinds])

    def costly(self, _: _Point) -> bool:
        return False

    def joints(self, x: Array) -> tuple[Array, Array]:
        """(K, n) rotations, rad, and translations, m, of the rows."""
        search, n = self.search, self.search.n
        latency = x[-1] if self.kinds[-1] == "latency" else 0.0
        rotations, translations = search.joints(self.reading, self.rows, latency)
        rotations[:, 1:] += x[: n - 1]
        if self.free:
            middle = (translations.max(0) + translations.min(0)) / 2
            factors = np.ones(n)
            for tubes, factor in zip(search.sliding, x[n - 1 + len(search.carriages) :], strict=True):
                factors[list(tubes)] = factor
            translations = middle + factors * (translations - middle)
        for tubes, zero in zip(search.carriages, x[n - 1 :], strict=False):
            translations[:, list(tubes)] += zero
        return rotations, translations

    def residuals(self, point: _Point) -> Array:
        """(K, 3) measured minus registered predicted tips, m."""
        joints = self.joints(point.x)
        if not self.search.admissible(joints[1]):
            raise InputError("a tube leaves its carriage")
        return np.asarray(self.of_many([joints])[0])

    def jacobian(self, point: _Point) -> Array:
        """(K, 3, P) derivatives, by differences towards where the robot can be."""
        moved, steps = [self.joints(point.x)], self.steps.copy()
        for k in range(len(point.x)):
            nudge = np.zeros(len(point.x))
            nudge[k] = steps[k]
            joints = self.joints(point.x + nudge)
            if not self.search.admissible(joints[1]):
                steps[k] = -steps[k]
                joints = self.joints(point.x - nudge)
            moved.append(joints)
        left = self.of_many(moved)
        return np.moveaxis((left[1:] - left[0]) / steps[:, None, None], 0, 2)

    def of_many(self, joints: Sequence[tuple[Array, Array]]) -> Array:
        """(H, K, 3) residuals at several joint values; rows without a stable shape count as far off."""
        rotations, translations = (np.vstack([each[j] for each in joints]) for j in (0, 1))
        position = solve_poses(self.search.robot, rotations, translations, np.zeros(1)).position[:, 0]
        out = registered_residuals(self.tips, position.reshape(len(joints), len(self.rows), 3))
        return np.where(np.isfinite(out), out, self.spread)


@small
def detect(
    robot: Robot,
    log: RawLog,
    known: Reading | None = None,
    *,
    answers: Sequence[tuple[str, str]] = (),
    progress: Progress | None = None,
) -> Detection:
    """Find how a recording is to be read.

    Args:
        known: reading of another recording of the same columns; where it explains this one as well, directions are not
            searched again.
        answers: pairs ("rotation_2", "reversed") of what is known.

    Raises:
        InputError: too few rows, or columns whose sizes fit no unit.
        SolveError: no reading explains the tips.
    """
    with warnings.catch_warnings(action="ignore", category=ImplausibleWarning):  # of readings that are tried
        return Search(robot, log, dict(answers), progress or (lambda count, total: None)).run(known)


Refined = tuple[float, Reading]
"""Distance (root mean square, m) that a reading leaves, and the reading."""


class Search:
    """Search of the reading of one recording; arguments as for `detect`."""

    def __init__(self, robot: Robot, log: RawLog, answers: dict[str, str], report: Progress) -> None:
        self.robot = replace(robot, friction=None, clearance=None) if isinstance(robot, ConcentricRobot) else robot
        self.log, self.answers, self.report = log, answers, report
        self.n, self.done = robot.n_tubes, 0
        known = np.isfinite(log.translations[0])
        self.carriages = [tubes for tubes in robot.moving_together if known[list(tubes)].all()]
        seen = np.flatnonzero(np.isfinite(log.sensors[..., 0]).any(1))
        if log.time is not None and log.joint_time is not None:
            seen = seen[(log.time[seen] >= log.joint_time[0]) & (log.time[seen] <= log.joint_time[-1])]
        if len(seen) < FEWEST_ROWS:
            raise InputError(f"there are {len(seen)} rows with a position and joint readings; {FEWEST_ROWS} are needed")
        self.rows, self.few = (
            seen[np.unique(np.linspace(0, len(seen) - 1, k).astype(int))] for k in (ROWS, SEARCH_ROWS)
        )
        self.turns = np.ptp(log.rotations, axis=0)
        self.shifts = np.where(known, np.ptp(log.translations, axis=0), 0.0)
        self.moving = [i for i in range(self.n) if self.turns[i] > 0]
        self.sliding = [c for c in self.carriages if self.shifts[c[0]] > 0]
        self.length = max(tube.length for tube in robot.tubes)
        self.curved, self.straight = np.array([(tube.curved_length, tube.straight_length) for tube in robot.tubes]).T
        self.counted: dict[str, Array] = {}
        self.by_signs: dict[tuple[str, tuple[int, ...]], list[Refined]] = {}

    def tips(self, rows: Index) -> Array:
        """(K, 3) mean of the sensors in rows, in the unit of the file."""
        return np.asarray(np.ma.masked_invalid(self.log.sensors[rows]).mean(1).filled(np.nan))

    # --- units by size ------------------------------------------------------------------------------------------------

    def units(self) -> tuple[list[str], str, str, list[Decision]]:
        """Possible units of rotations, units of translations and positions, and what was decided by sizes."""
        log, decisions = self.log, list[Decision]()
        spread = float(np.linalg.norm(np.ptp(self.tips(self.rows), axis=0)))
        position = self._sized("positions", log.position_units, spread, SPREAD, decisions)
        largest = float(self.shifts.max(initial=0.0))
        shift = self._sized("translations", log.translation_units, largest, SHIFTED, decisions)
        (low, high), turned = TURNED, float(self.turns.max(initial=0.0))
        turn = [name for name in log.rotation_units if low <= ANGLES[name] * turned <= high]
        answer = self.answers.get("rotations")
        return [answer] if answer else turn or [*log.rotation_units[:1]], shift, position, decisions

    def _sized(
        self, what: str, units: Sequence[str], size: float, limits: tuple[float, float], decisions: list[Decision]
    ) -> str:
        """The unit in which a range is possible, or the stated one where nothing moves."""
        if (answer := self.answers.get(what)) is not None or size == 0:
            return answer or units[0]
        low, high = (limit * self.length for limit in limits)
        possible = [name for name in units if low <= LENGTHS[name] * size <= high]
        if not possible:
            shown = " or ".join(f"{1e3 * LENGTHS[name] * size:.3g} mm in {name}" for name in units)
            raise InputError(
                f"{what} range over {shown}; they must range over {1e3 * low:.3g} to {1e3 * high:.0f} mm, since the "
                f"longest tube has {1e3 * self.length:.0f} mm"
            )
        for other in units:
            if other != possible[0]:
                reason = f"in {other} they would range over {1e3 * LENGTHS[other] * size:.3g} mm"
                decisions.append(Decision(what, possible[0], other, math.nan, math.inf, True, reason))
        return possible[0]

    # --- what a reading means -----------------------------------------------------------------------------------------

    def joints(self, reading: Reading, rows: Index, latency: float = 0.0) -> tuple[Array, Array]:
        """(K, n) rotations, rad, and translations, m, of rows of positions, in the directions of a reading, from its
        file's zeros."""
        log, unit = self.log, reading.rotation_unit
        if unit not in self.counted:
            turned = log.rotations * ANGLES[unit]
            self.counted[unit] = turned if log.joint_time is None else unwrapped(log.joint_time, turned).rotations
        both = np.hstack([self.counted[unit], log.translations * LENGTHS[reading.translation_unit]])
        if log.time is None or log.joint_time is None:
            at = both[rows]
        else:
            instants = log.time[rows] - latency
            at = np.column_stack([np.interp(instants, log.joint_time, column) for column in both.T])
        rotations = at[:, : self.n] * reading.rotation_signs
        translations = at[:, self.n :] * reading.translation_signs
        return rotations, np.where(np.isfinite(translations), translations, self.robot.home_translations)

    def admissible(self, translations: Array) -> bool:
        """True if no tube leaves its carriage, and the arm is in front of the plate in all rows."""
        inside = (translations <= self.straight + 1e-9).all() and ((translations + self.curved).max(-1) > 0).all()
        return bool(inside)

    def refined(self, reading: Reading, *, free: bool = False) -> Refined:
        """Reading with the zeros and the latency that fit best from its own; `free` lets carriages choose directions.

        Infinite where the robot cannot be.
        """
        self.done += 1
        self.report(self.done, 0)
        model = _Zeros(self, reading, self.few if free else self.rows, free=free)
        count = len(model.rows)
        weights = Weights(np.full(count, 1e-3), np.ones(count), np.full(len(model.kinds), np.inf))
        try:
            fit = descend(model, weights, model.start, solver=SEARCHING if free else REFINING)
        except (InputError, SolveError):
            return math.inf, reading
        x, rms = fit.state.x.tolist(), float(np.sqrt((fit.residuals**2).sum(1).mean()))
        zeros, rest = np.zeros(self.n), x[self.n - 1 :]
        for tubes, zero in zip(self.carriages, rest, strict=False):
            zeros[list(tubes)] = zero
        found = replace(reading, rotation_zeros=(0.0, *x[: self.n - 1]), translation_zeros=tuple(zeros.tolist()))
        if not free:
            return rms, replace(found, latency=x[-1] if model.kinds[-1] == "latency" else 0.0)
        signs = np.array(reading.translation_signs)
        for tubes, factor in zip(self.sliding, rest[len(self.carriages) :], strict=True):
            if f"translation_{tubes[0] + 1}" not in self.answers and factor < 0:
                signs[list(tubes)] *= -1
        return rms, self.pivoted(found, tuple(signs.tolist()))

    def pivoted(self, reading: Reading, signs: tuple[int, ...]) -> Reading:
        """Reading with other directions of the carriages, which are at the same place in the middle of their motion."""
        _, translations = self.joints(reading, self.rows)
        middle = (translations.max(0) + translations.min(0)) / 2
        changed = np.array(signs) != reading.translation_signs
        zeros = np.array(reading.translation_zeros) + np.where(changed, 2 * middle, 0.0)
        return replace(reading, translation_signs=signs, translation_zeros=tuple(zeros.tolist()))

    def mirrored(self, reading: Reading, signs: tuple[int, ...]) -> Reading:
        """Reading with other directions of rotation, which is the same in the middle of the motion."""
        rotations, _ = self.joints(reading, self.rows)
        changed = np.array(signs) != reading.rotation_signs
        zeros = np.array(reading.rotation_zeros) + np.where(changed, 2 * np.median(rotations, axis=0), 0.0)
        return replace(reading, rotation_signs=signs, rotation_zeros=tuple((zeros - zeros[0]).tolist()))

    # --- search -------------------------------------------------------------------------------------------------------

    def run(self, known: Reading | None) -> Detection:
        """Best reading with its decisions."""
        turn_units, shift_unit, position_unit, decisions = self.units()
        decisions += self._still(known)
        spread = LENGTHS[position_unit] * float(np.sqrt(np.var(self.tips(self.rows), axis=0).sum()))
        best: Refined = (math.inf, self._blank(turn_units[0], shift_unit, position_unit, (1,) * self.n))
        signs_of_all = self._rotation_signs()
        blanks = [self._blank(unit, shift_unit, position_unit, signs) for unit in turn_units for signs in signs_of_all]
        if known is not None:
            best = self.refined(known)
        if best[0] > EXPLAINED / 5 * spread:
            found = self._searched(blanks)
            best = min([best, *found], key=_distance)
        if best[0] > EXPLAINED * spread:
            raise SolveError(
                f"no units and directions of the columns explain the tips: the best leave {1e3 * best[0]:.1f} mm of "
                f"{1e3 * spread:.1f} mm (root mean square); is it a recording of this robot?"
            )
        better, decided = self._decided(best, turn_units)
        if not all(each.certain for each in decided):
            # A search from more places tells what is open from what was not found.
            found = self._searched(blanks, random=RANDOM_PLACES)
            best = min([best, *found], key=_distance)
            better, decided = self._decided(best, turn_units)
        while better[0] < (1 - BETTER) * best[0]:  # a single change was better after all
            best = better
            better, decided = self._decided(best, turn_units)
        return Detection(best[1], best[0], spread, (*decisions, *decided))

    def _still(self, known: Reading | None) -> list[Decision]:
        """Decisions on drives that do not move, whose direction no tip shows."""
        out = []
        each = [(f"rotation_{i + 1}", i, "rotation_signs") for i in range(self.n) if i not in self.moving]
        each += [
            (f"translation_{c[0] + 1}", c[0], "translation_signs") for c in self.carriages if c not in self.sliding
        ]
        for about, i, name in each:
            answer = self.answers.get(about)
            before = None if known is None else _directions(getattr(known, name)[i])
            chosen = answer or (before[0] if before else "forward")
            other = "reversed" if chosen == "forward" else "forward"
            reason = "as answered" if answer else "as before" if before else "it does not move"
            out.append(
                Decision(about, chosen, other, math.nan, math.nan, answer is not None or before is not None, reason)
            )
        return out

    def _blank(self, *units_and_signs: object) -> Reading:
        turn, shift, position, signs = units_and_signs
        zero = (0.0,) * self.n
        forward = np.ones(self.n, dtype=int)
        for tubes in self.carriages:
            if self.answers.get(f"translation_{tubes[0] + 1}") == "reversed":
                forward[list(tubes)] = -1
        return Reading(turn, shift, position, signs, tuple(forward.tolist()), zero, zero)  # type: ignore[arg-type]

    def _rotation_signs(self) -> list[tuple[int, ...]]:
        """Directions that the rotations may have."""
        answers = [self.answers.get(f"rotation_{i + 1}") for i in range(self.n)]
        free = [
            (-1,) if answer == "reversed" else (1,) if answer or i not in self.moving else (1, -1)
            for i, answer in enumerate(answers)
        ]
        return list(itertools.product(*free))

    def _searched(self, blanks: Sequence[Reading], random: int = 0) -> list[Refined]:
        """Best readings of a search of all zeros, from likely or from `random` places of the carriages."""
        found: list[Refined] = []
        for blank in blanks:
            places = self._random(blank, random) if random else self._placed(blank)
            some = [self.refined(start, free=True) for start in self._starts(places)]
            self.by_signs.setdefault((blank.rotation_unit, blank.rotation_signs), []).extend(some)
            found += some
        leading = [reading for rms, reading in sorted(found, key=_distance)[:KEPT] if math.isfinite(rms)]
        return [self.refined(reading) for reading in leading]

    def _starts(self, places: Iterable[Reading]) -> Iterator[Reading]:
        """Readings, each with the best zeros of the rotations on a grid."""
        grid = self._grid()
        for placed in places:
            model = _Zeros(self, placed, self.few, free=True)
            points = [np.concatenate([zeros, model.start.x[len(zeros) :]]) for zeros in grid]
            joints = [model.joints(x) for x in points]
            if self.admissible(joints[0][1]):
                left = (model.of_many(joints) ** 2).sum((1, 2))
                yield replace(placed, rotation_zeros=(0.0, *grid[int(np.argmin(left))].tolist()))

    def _placed(self, blank: Reading) -> Iterator[Reading]:
        """A reading with zeros of the carriages that are likely.

        Zero at home, home at the first row, and the middle of the motion at places between the limits.
        """
        _, shifts = self.joints(blank, self.rows)
        low, high = np.array(self.robot.limits.translations).T
        middle, home = (shifts.max(0) + shifts.min(0)) / 2, self.robot.home_translations
        offsets = [np.zeros(self.n), home - shifts[0], *(low + part * (high - low) - middle for part in PLACES)]
        for offset in offsets if self.carriages else offsets[:1]:
            zeros = np.zeros(self.n)
            for tubes in self.carriages:
                # As far in front as a tube can be.
                zeros[list(tubes)] = np.minimum(offset, self.straight - shifts.max(0))[list(tubes)].min()
            yield replace(blank, translation_zeros=tuple(zeros.tolist()))

    def _random(self, blank: Reading, count: int) -> Iterator[Reading]:
        """A reading with the middle of every carriage's motion at random places between the limits."""
        _, shifts = self.joints(blank, self.rows)
        low, high = np.array(self.robot.limits.translations).T
        middle, random = (shifts.max(0) + shifts.min(0)) / 2, np.random.default_rng(0)
        for _ in range(count):
            offset = random.uniform(low, high) - middle
            zeros = np.zeros(self.n)
            for tubes in self.carriages:
                zeros[list(tubes)] = np.minimum(offset, self.straight - shifts.max(0))[list(tubes)].min()
            yield replace(blank, translation_zeros=tuple(zeros.tolist()))

    def _grid(self) -> list[Array]:
        count = self.n - 1
        if not count:
            return [np.zeros(0)]
        each = np.linspace(-math.pi, math.pi, GRID.get(count, 3), endpoint=False)
        points = np.array(list(itertools.product(each, repeat=count)))
        if len(points) > MOST_STARTS:
            points = points[np.random.default_rng(0).choice(len(points), MOST_STARTS, replace=False)]
        return list(points)

    # --- certainty ----------------------------------------------------------------------------------------------------

    def _decided(self, best: Refined, turn_units: Sequence[str]) -> tuple[Refined, list[Decision]]:
        """Best alternative by a single change, and the decisions on units and directions."""
        rms, reading = best
        out: list[Decision] = []
        least: Refined = (math.inf, reading)
        for about, chosen, other, changed in self._changes(reading, turn_units):
            if about in self.answers:
                out.append(Decision(about, chosen, other, rms, math.nan, True, "as answered"))
                continue
            alternative = min((self.refined(each) for each in changed), key=_distance, default=(math.inf, reading))
            least = min(least, alternative, key=_distance)
            out.append(Decision(about, chosen, other, rms, alternative[0], alternative[0] > CERTAIN * rms))
        return least, out

    def _changes(self, reading: Reading, turn_units: Sequence[str]) -> Iterator[tuple[str, str, str, list[Reading]]]:
        """Name, chosen and other reading of every single change, with readings to refine."""
        for unit in turn_units:
            if unit != reading.rotation_unit:
                some = [each for (name, _), found in self.by_signs.items() if name == unit for each in found]
                yield "rotations", reading.rotation_unit, unit, self._of(some)
        for i in self.moving:
            flipped = tuple(-s if k == i else s for k, s in enumerate(reading.rotation_signs))
            some = self.by_signs.get((reading.rotation_unit, flipped), [])
            others = [*self._of(some), self.mirrored(reading, flipped)]
            yield f"rotation_{i + 1}", *_directions(reading.rotation_signs[i]), others
        answered = any(f"rotation_{i + 1}" in self.answers for i in self.moving)
        if len(self.moving) > 1 and not answered:
            # The mirror image: it fits as well where all tips are in one plane.
            flipped, first = tuple(-s for s in reading.rotation_signs), self.moving[0]
            about = f"{ALL} rotation_{first + 1}"
            yield about, *_directions(reading.rotation_signs[first]), [self.mirrored(reading, flipped)]
        for tubes in self.sliding:
            flipped = tuple(-s if k in tubes else s for k, s in enumerate(reading.translation_signs))
            yield (
                f"translation_{tubes[0] + 1}",
                *_directions(reading.translation_signs[tubes[0]]),
                [self.pivoted(reading, flipped)],
            )

    def _of(self, some: Sequence[Refined]) -> list[Reading]:
        return [reading for rms, reading in sorted(some, key=_distance)[:ALTERNATIVES] if math.isfinite(rms)]


def _distance(pair: Refined) -> float:
    return pair[0]


def _directions(sign: int) -> tuple[str, str]:
    return ("forward", "reversed") if sign > 0 else ("reversed", "forward")
