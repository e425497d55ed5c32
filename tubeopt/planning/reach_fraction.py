"""Fraction of targets that a robot reaches by snap-free paths: quality of a design for a region of a patient.

The paths are those of a roadmap, checked as in the search of a plan: margin, clearance and ranges at points so close
that the deviation between them is less than the reserve. `plan_trajectory` proves them one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.anatomy import bodies_in_frame
from ..bodies.frames import Frame
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..display import Displayed
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, finite, instance, items, positive, whole
from ..files.field_metadata import TYPICAL_TIP_ERROR, typical_length
from ..inverse.clock import OutOfTimeError
from ..robots.limits import check_target
from ..robots.robot import Robot
from ..solvers.blas import small
from ..stability import find_equilibria
from ..typing import Array, Mask
from .arms import PlacedRobot
from .arms_plan import plan_arms
from .goals import approach, check_start, checked_points, start_equilibrium
from .motion import DEFAULT_RATES
from .plan import plan_trajectory
from .question import DEFAULT_PLAN, PlanOptions, PlanTask, plan_task
from .roadmap import Roadmap, roadmap_of

POINTS, CONNECTED_POINTS = 30, 4
"""Number of roadmap nodes, nearest tip first, considered per target; and of reachable ones that start the approach."""

# Beyond this, the distance from a target does not distinguish designs.
FAR_MISS = 0.01
"""Distance from a target, m, beyond which it does not contribute to the score of a region."""

SAME = 0.05
"""Largest difference of tip rotations (rad) of equal equilibria at the same joint values."""


@dataclass(frozen=True, eq=False)
class ReachFraction(Displayed):
    """Result of `evaluate_reach`: fraction of N targets that the tip reaches, and the arms there."""

    targets: Array
    """(N, 3) target positions, m."""
    miss: Array
    """(N,) smallest distance of each target from tips reachable by a path, including the start, m."""
    tolerance: float
    """Largest distance of a reached target from the tip, m."""
    rotations: Array = field(repr=False)
    """(N, n) rotations of the arms at the targets, rad; NaN for targets without an arm."""
    translations: Array = field(repr=False)
    """(N, n) translations of the arms at the targets, m."""
    tip_rotations: Array = field(repr=False)
    """(N, n) rotations of their tubes at the ends, rad; they identify one of several equilibria."""
    examined: int = 0
    """Number of points of the roadmap."""

    @property
    def reached(self) -> Mask:
        """(N,) True for reached targets."""
        return np.asarray(self.miss <= self.tolerance)

    @property
    def fraction(self) -> float:
        """Fraction of the targets that are reached."""
        return float(self.reached.mean())

    def arm(self, robot: Robot, k: int) -> Equilibrium | None:
        """Equilibrium of a robot that reaches target k; None if no equilibrium has these joint values and this tip."""
        joints, tips = (self.rotations[k], self.translations[k]), self.tip_rotations[k]
        with suppress(SolveError):
            equilibria = [forward_kinematics(robot, *joints)]
            if np.abs(equilibria[0].tip_rotations - tips).max() > SAME:  # on another branch
                equilibria = [e for e in find_equilibria(robot, *joints) if e.stable]
            best = min(equilibria, key=lambda e: float(np.abs(e.tip_rotations - tips).max()), default=None)
            if best is not None and np.linalg.norm(best.tip_position - self.targets[k]) <= 2 * self.tolerance:
                return best
        return None


@typed
@small
def evaluate_reach(
    robot: Robot,
    start: Any,
    targets: ArrayLike,
    *,
    tolerance: float = 5e-4,
    obstacles: Sequence[Obstacle] = (),
    min_margin: float = MIN_MARGIN,
    options: PlanOptions = DEFAULT_PLAN,
    count: int = 300,
) -> ReachFraction:
    """Targets that the tip reaches from a start, by paths with margin and clearance.

    The fraction is a lower estimate that improves with `count` on average.

    Args:
        start: as for `plan_trajectory`.   targets: (N, 3) target positions of the tip, m, as `Anatomy.target`.
        tolerance: largest distance of the tip from a reached target, m.
        obstacles, min_margin, options: as for `build_roadmap`; the time limit covers the whole call.
        count: number of points of the roadmap.

    Raises:
        InputError: a table of wrong shape, numbers out of range, a start out of range.
        SolveError: the start is not possible.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> home = tubeopt.forward_kinematics(robot, [0.0, 0.0])
        >>> turned = home.tip_position * [-1.0, -1.0, 1.0]  # half a turn away
        >>> tubeopt.evaluate_reach(robot, home, [turned, [0.0, 0.0, 1.0]], count=20).fraction
        0.5
    """
    points = checked_points(targets)
    check_target(robot.tubes, "targets", points)
    tolerance = typical_length("tolerance", tolerance, TYPICAL_TIP_ERROR)
    task = plan_task(robot, obstacles, min_margin, DEFAULT_RATES, None, options, configurations=(start,))
    first = start_equilibrium(task.coordinates.space, start)
    check_start(task, first)
    first_point, n = task.coordinates.of(first), robot.n_tubes
    miss = np.linalg.norm(first.tip_position - points, axis=1)
    joints, tips = np.full((len(points), len(first_point)), np.nan), np.full((len(points), n), np.nan)
    examined = 0
    with suppress(OutOfTimeError, SolveError):  # results so far are returned
        roadmap = roadmap_of(task, count)
        examined, point_task = len(roadmap), task.from_to(first_point, first_point)
        search = _Search(point_task, roadmap, first_point, point_task.arms(roadmap.points).tip)
        for k, point in enumerate(points):
            for distance, z in search.approach(point, tolerance):
                if distance >= miss[k] or task.clock.over:
                    break
                if search.reaches(z):
                    miss[k], joints[k], tips[k] = distance, task.coordinates.joints(z[None])[0], z[:n]
    configurations = np.array([task.coordinates.space.joint(q) for q in joints])
    return ReachFraction(
        targets=points,
        miss=miss,
        tolerance=tolerance,
        rotations=configurations[:, :n],
        translations=configurations[:, n:],
        tip_rotations=tips,
        examined=examined,
    )


@dataclass(eq=False)
class _Search:
    """Search for paths over a roadmap from one start."""

    task: PlanTask
    roadmap: Roadmap
    start: Array
    """(m,) tip coordinates of the start."""
    tips: Array
    """(N, 3) tips of the points of the roadmap, m."""
    reachable: dict[int, bool] = field(default_factory=dict)
    """Results for points of the roadmap."""

    def reaches(self, z: Array) -> bool:
        """True if a path leads to a point (m,)."""
        return self.roadmap.shortest_path(self.task, self.start, [z], self.task.clock).points is not None

    def approach(self, point: Array, tolerance: float) -> list[tuple[float, Array]]:
        """Distances from a target, m, and points (m,) close to it, reached from the nearest connected nodes; closest
        first.
        """
        ends = list[tuple[float, Array]]()
        for j in np.argsort(np.linalg.norm(self.tips - point, axis=1))[:POINTS].tolist():
            if self.task.clock.over or len(ends) == CONNECTED_POINTS:
                break
            if j not in self.reachable:
                self.reachable[j] = self.reaches(self.roadmap.points[j])
            if self.reachable[j]:
                start = self.roadmap.points[j]
                ends.append(approach(self.task, start, point, enough=0.2 * tolerance, valid=True))
                if ends[-1][0] <= tolerance:
                    break
        return sorted(ends, key=lambda end: end[0])


def check_reach_arguments(tolerance: float, min_margin: float, options: PlanOptions, count: int) -> None:
    """Raise InputError for arguments that `evaluate_reach` does not accept."""
    typical_length("tolerance", tolerance, TYPICAL_TIP_ERROR)
    if not 0 <= finite("min_margin", min_margin) < 1:
        raise InputError(f"min_margin is {min_margin:g}; it must be at least 0 and less than 1")
    instance("options", options, PlanOptions)
    whole("count", count, 1)


@dataclass(frozen=True, eq=False)
class RegionReach(Displayed):
    """Goal of `search_design`: a robot reaches targets in a region from its start by paths with margin and clearance.

    The base plate may be movable. The fraction is a lower bound: a larger roadmap (`count`) may reach more targets, and
    a very small one none. With few targets many designs have the same fraction; so the score includes the distances
    from missed targets. Robots are compared with the same random numbers.

    Raises:
        InputError: a table of wrong shape, numbers out of range.
    """

    start: tuple[Any, Any]
    """Initial joint values (rotations, translations) of every robot."""
    targets: Array
    """(N, 3) targets of the tip, m, in the frame of the given plate."""
    obstacles: Sequence[Obstacle] = ()
    """Obstacles in the frame of the given plate."""
    tolerance: float = 5e-4
    """Largest distance of the tip from a reached target, m."""
    min_margin: float = MIN_MARGIN
    """Required margin."""
    options: PlanOptions = DEFAULT_PLAN
    """Options as for `evaluate_reach`."""
    count: int = 200
    """Number of points of the roadmap."""
    shift: float = 0.0
    """Largest shift of the plate along each of its axes, to both sides, m."""
    tilt: float = 0.0
    """Largest rotation of the plate about its x and its y axis, to both sides, rad."""
    description: str = field(default="share of the region that is reached", init=False)
    """Label of the value."""

    def __post_init__(self) -> None:
        items("start", self.start, object, "rotations and translations")
        object.__setattr__(self, "targets", checked_points(self.targets))
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles))
        check_reach_arguments(self.tolerance, self.min_margin, self.options, self.count)
        positive("shift of the plate", self.shift, zero=True)
        positive("tilt of the plate", self.tilt, zero=True)

    @property
    def ranges(self) -> Array:
        """(k, 2) ranges of the free motions of the plate: along x, y, z, m, then about x and y, rad."""
        bounds = np.array([self.shift] * 3 * bool(self.shift) + [self.tilt] * 2 * bool(self.tilt))
        return np.column_stack([-bounds, bounds])

    def base(self, variables: Array) -> Frame:
        """Pose of the plate in the frame of the given plate after a move by numbers (k,)."""
        shift, tilt = np.split(np.asarray(variables, dtype=float), [3 * bool(self.shift)])
        turn = np.append(tilt, 0.0) if len(tilt) else np.zeros(3)
        axes = scipy.spatial.transform.Rotation.from_rotvec(turn).as_matrix()
        return Frame(axes, shift if len(shift) else np.zeros(3))

    def evaluate(self, robot: Robot, variables: Array) -> ReachFraction:
        """Targets that a robot reaches from a moved plate.

        Raises:
            InputError, SolveError: as of `evaluate_reach`.
        """
        frame = self.base(variables)
        return evaluate_reach(
            robot,
            self.start,
            frame.seen(self.targets),
            tolerance=self.tolerance,
            obstacles=bodies_in_frame(frame, self.obstacles),
            min_margin=self.min_margin,
            options=self.options,
            count=self.count,
        )

    def __call__(self, robot: Robot, variables: Array) -> tuple[float, float]:
        """Score, from 0 (all targets reached) to 1, and the fraction of reached targets."""
        reach = self.evaluate(robot, variables)
        return score([reach], reach.fraction)

    def plans_proved(self, robot: Robot, variables: Array, reach: ReachFraction, limit: int) -> tuple[int, int]:
        """Numbers of proved and of attempted plans to the first reached targets, at most `limit` of them."""
        some, proved = np.flatnonzero(reach.reached)[:limit], 0
        bodies, options = bodies_in_frame(self.base(variables), self.obstacles), replace(self.options, objective="none")
        arguments: dict[str, Any] = {"obstacles": bodies, "min_margin": self.min_margin, "options": options}
        for k in some.tolist():
            goal = reach.arm(robot, k)
            with suppress(SolveError):
                proved += goal is not None and plan_trajectory(robot, self.start, goal, **arguments).proved
        return proved, len(some)


def score(results: Sequence[ReachFraction], fraction: float) -> tuple[float, float]:
    """Score, from 0 (all reached) to 1, from a fraction and the distances from missed targets; and the fraction."""
    missed = [np.minimum(np.maximum(each.miss - each.tolerance, 0.0) / FAR_MISS, 1.0) for each in results]
    return float(np.mean(missed) + 1 - fraction) / 2, fraction


# Pieces of 2 mm on an arm of 200 mm: the bound is 1 mm^2 / d too small at a distance d.
REST_POINTS = 100
"""Number of points along an arm at rest for the bound on its distance from another."""


@dataclass(frozen=True, eq=False)
class PairFraction(Displayed):
    """Result of `PairReach`: pairs of N targets for two tips."""

    reached: tuple[ReachFraction, ReachFraction]
    """Targets that each robot reaches by itself."""
    apart: Array = field(repr=False)
    """(N, N) lower bound on the distance of the arms at rest, m; NaN for unreached targets.

    The first tip is at target i, the second at j.
    """
    clearance: float
    """Required distance of the arms, m."""

    @property
    def held(self) -> Mask:
        """(N, N) True for pairs of different targets that both tips reach with the required distance."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.apart >= self.clearance) & ~np.eye(len(self.apart), dtype=bool))

    @property
    def fraction(self) -> float:
        """Fraction of the ordered pairs of different targets that are reached."""
        count = len(self.apart)
        return float(self.held.sum() / (count * (count - 1)))


@typed
@dataclass(frozen=True, eq=False)
class PairReach(Displayed):
    """Goal of `search_pair`: two robots reach any two targets in a region at the same time without contact.

    The base plates may be moved. Each robot reaches its target by a path with margin and clearance from obstacles, on
    its own (`RegionReach`). The distance of the two arms is bounded from below at rest; use `plan_arms` to prove a
    motion of both.

    Raises:
        InputError: a table of wrong shape, numbers out of range.
    """

    starts: tuple[Any, Any]
    """Initial joint values (rotations, translations) of the two robots."""
    bases: tuple[Frame, Frame]
    """Poses of the base plates."""
    targets: Array
    """(N, 3) targets of the tips, m, at least two, in the frame of the bases."""
    obstacles: Sequence[Obstacle] = ()
    """Obstacles in the frame of the bases."""
    tolerance: float = 5e-4
    """Largest distance of the tip from a reached target, m."""
    min_margin: float = MIN_MARGIN
    """Required margin."""
    options: PlanOptions = DEFAULT_PLAN
    """Options as for `evaluate_reach`; the arms keep their clearance from each other too."""
    count: int = 200
    """Number of points of the roadmap."""
    shift: float = 0.0
    """Largest shift of either plate along its own axes, to both sides, m."""
    tilt: float = 0.0
    """Largest rotation of either plate about its own x and y, to both sides, rad."""
    description: str = field(
        default="share of the pairs of places that both tips reach without contact between the arms", init=False
    )
    """Label of the value."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", checked_points(self.targets))
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles))
        check_reach_arguments(self.tolerance, self.min_margin, self.options, self.count)
        if len(self.targets) < 2:
            raise InputError("targets is 1 point; two tips need at least 2")
        for name in ("starts", "bases"):
            if len(getattr(self, name)) != 2:
                raise InputError(f"{name} are {len(getattr(self, name))}; they must be two, one for each robot")
        positive("shift of the plates", self.shift, zero=True)
        positive("tilt of the plates", self.tilt, zero=True)

    @cached_property
    def sides(self) -> tuple[RegionReach, RegionReach]:
        """Goals of the two robots alone, in the frames of their plates."""
        numbers = self.tolerance, self.min_margin, self.options, self.count, self.shift, self.tilt
        one, other = (
            RegionReach(start, base.seen(self.targets), bodies_in_frame(base, self.obstacles), *numbers)
            for start, base in zip(self.starts, self.bases, strict=True)
        )
        return one, other

    @property
    def ranges(self) -> Array:
        """(k, 2) ranges of the motions of the plates: of the first as in `RegionReach`, then of the second."""
        return np.concatenate([side.ranges for side in self.sides])

    def plates(self, variables: Array) -> tuple[Frame, Frame]:
        """Poses of the plates after a move by numbers (k,)."""
        first, second = (
            base.inverse.of(side.base(numbers))
            for base, side, numbers in zip(self.bases, self.sides, np.split(np.asarray(variables), 2), strict=True)
        )
        return first, second

    def evaluate(self, one: Robot, other: Robot, variables: Array) -> PairFraction:
        """Pairs of targets that two robots reach from moved plates.

        Raises:
            InputError, SolveError: as for `evaluate_reach`.
        """
        numbers = np.split(np.asarray(variables, dtype=float), 2)
        sides = [side.evaluate(robot, x) for side, robot, x in zip(self.sides, (one, other), numbers, strict=True)]
        arms = [
            _at_rest(robot, side_reach, base)
            for robot, side_reach, base in zip((one, other), sides, self.plates(variables), strict=True)
        ]
        apart = np.full((len(self.targets),) * 2, np.nan)
        for i, first in arms[0].items():
            for j, second in arms[1].items():
                apart[i, j] = _apart(first, second)
        return PairFraction((sides[0], sides[1]), apart, self.options.kept_clearance)

    def __call__(self, one: Robot, other: Robot, variables: Array) -> tuple[float, float]:
        """Score, from 0 (all pairs reached) to 1, with the distances from missed targets; and the fraction of pairs."""
        result = self.evaluate(one, other, variables)
        return score(result.reached, result.fraction)

    def plans_proved(
        self, one: Robot, other: Robot, variables: Array, reach: PairFraction, limit: int
    ) -> tuple[int, int]:
        """Numbers of proved and of attempted motions to reached pairs, chosen evenly, at most `limit` of them."""
        pairs = np.argwhere(reach.held)
        some = pairs[np.unique(np.linspace(0, len(pairs) - 1, limit).astype(int))] if len(pairs) else pairs
        arms = [PlacedRobot(robot, base) for robot, base in zip((one, other), self.plates(variables), strict=True)]
        options, proved = replace(self.options, objective="none"), 0
        arguments: dict[str, Any] = {"obstacles": self.obstacles, "min_margin": self.min_margin, "options": options}
        for pair in some.tolist():
            ends = zip(reach.reached, (one, other), pair, strict=True)
            goals = [goal for side, robot, k in ends if (goal := side.arm(robot, k)) is not None]
            with suppress(SolveError):
                proved += plan_arms(arms, self.starts, goals, **arguments).proved
        return proved, len(some)


class _Arm(NamedTuple):
    """An arm at rest as pieces of equal length."""

    points: Array
    """(P, 3) centreline in the frame of the bases, m."""
    radius: Array
    """(P,) radii of the arm, m."""
    square: float
    """Squared length of a piece, m^2."""
    sagitta: float
    """Bound on the distance of the centreline from its pieces, m."""


def _at_rest(robot: Robot, reach: ReachFraction, base: Frame) -> dict[int, _Arm]:
    """Arms at the reached targets, by number of the target."""
    arms: dict[int, _Arm] = {}
    for k in np.flatnonzero(reach.reached).tolist():
        e = reach.arm(robot, k)
        if e is None:
            continue
        surface = ArmSurface(e)
        line, radius = surface.line(REST_POINTS)
        # A piece is as thick as the thicker of its ends: the arm becomes thinner towards its tip.
        thick = np.maximum.accumulate(radius[::-1])[::-1]
        thick[1:] = np.maximum(thick[1:], thick[:-1])
        square = (float(e.arc_length[-1]) / (REST_POINTS - 1)) ** 2
        arms[k] = _Arm(base.placed(line), thick, square, surface.bend * square / 8)
    return arms


def _apart(first: _Arm, second: _Arm) -> float:
    """Lower bound on the distance of two arms, m.

    Squared distances between pieces are at least those of their ends less a quarter of their squared lengths, as in
    `arms`.
    """
    square = scipy.spatial.distance.cdist(first.points, second.points, "sqeuclidean")
    straight = np.sqrt(np.maximum(square - (first.square + second.square) / 4, 0.0))
    return float((straight - first.radius[:, None] - second.radius).min()) - first.sagitta - second.sagitta
