"""Question of a plan: options, requirements and tip coordinates, also of a robot under a load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Protocol

import numpy as np

from ..block.custom import CustomObjective
from ..block.quantities import Expression, recorded
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..display import Displayed
from ..equilibrium.kinematics import equilibrium_at, forward_kinematics
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, SolveError, finite, instance, positive, whole
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, OneOf, Typical, check_fields, check_size, key, unit
from ..inverse.clock import Clock, OutOfTimeError
from ..inverse.joints import JointSpace, joint_space, shift_of
from ..inverse.search import SEARCHES, PathResult
from ..inverse.task import ArmBatch, Coordinates, JointCoordinates, Task, TipCoordinates
from ..robots.limits import JointLimits
from ..robots.load import Load
from ..robots.robot import Robot, check_robot
from ..stability.deflection import under_any_force
from ..stability.shooting import profiles
from ..typing import Array
from .loaded_sections import uncovered
from .motion import DEFAULT_RATES, RateLimits

SAME = 1e-6
"""Largest difference of the tip rotations (rad) of equal equilibria."""


@dataclass(frozen=True, eq=False)
class LoadedChart(TipCoordinates):
    """Tip coordinates of a robot under a load: a point describes the unloaded equilibrium, its arm the loaded one."""

    def of(self, equilibrium: Equilibrium) -> Array:
        """Tip coordinates of an equilibrium, after its load is removed.

        Raises:
            SolveError: it snaps as the load is removed.
        """
        e = equilibrium
        if e.load is not None:
            e = forward_kinematics(e.robot, e.rotations, e.translations, load=Load(), start=e)
        return super().of(e)

    def arms(self, z: Array, margin: float | Array, clock: Clock | None = None) -> ArmBatch:
        """Arms of points (k, m) under the load, with margins above `margin`."""
        plain, shift = super().arms(z, 0.0, clock), self.translations(z)
        required, loaded = np.broadcast_to(margin, len(z)), dict[int, Equilibrium]()
        for k in np.flatnonzero(plain.stable).tolist():
            if clock is not None and clock.over:
                raise OutOfTimeError
            e = self._loaded(z[k, : shift.shape[1]], plain.rotations[k], shift[k])
            if e is not None:
                loaded[k] = e
        stable = np.array([k in loaded and loaded[k].margin > required[k] for k in range(len(z))], dtype=bool)
        width = max((len(e.arc_length) for e in loaded.values()), default=plain.points.shape[1])
        points, tangents, s = (_widened(table, width) for table in (plain.points, plain.tangents, plain.arc_length))
        for k, e in loaded.items():
            samples = e.position, e.frame[:, :, 2], e.arc_length
            points[k], tangents[k], s[k] = (_widened(table[None], width)[0] for table in samples)
        return ArmBatch(plain.rotations, stable, points, tangents, s, plain.tube_end)

    def _loaded(self, tips: Array, rotations: Array, translations: Array) -> Equilibrium | None:
        """Equilibrium under the load at joint values, from the one without it that has these tip rotations."""
        robot = self.space.robot
        try:
            bare = forward_kinematics(robot, rotations, translations)
            if np.abs(bare.tip_rotations - tips).max() > SAME:
                problem = reduced_problem(robot, tuple(translations.tolist()), DEFAULT_DISCRETISATION)
                theta = profiles(problem, tips[None])[0]
                bare = equilibrium_at(robot, rotations, translations, lambda s: theta.T)
            return forward_kinematics(robot, rotations, translations, load=self.load, start=bare)
        except SolveError:
            return None


def _widened(table: Array, width: int) -> Array:
    """(N, width, ...) table from a table (N, p, ...): its last points are repeated or omitted."""
    more = [(0, 0)] * table.ndim
    more[1] = (0, max(0, width - table.shape[1]))
    return np.pad(table, more, mode="edge")[:, :width].copy()


# The proof bounds the deflection between both ends too; the search reserves a little more than at the ends, so that
# the proof does not narrowly fail.
DEFLECTION_FACTOR = 1.05
"""Safety factor on the deflection of the arm by a force at the ends of a motion."""

WEIGHTS = {
    "length": (1.0, 0.1, 0.0, 0.0),
    "time": (0.02, 1.0, 0.0, 0.0),
    "effort": (0.02, 0.05, 1e-2, 0.0),
    "margin": (0.02, 0.05, 0.0, 1.0),
}
"""Weights of length, time, effort and margin, for every objective."""

PATH_QUANTITIES = ("rotations", "translations", "tip_position", "tip_direction")
"""Quantities in a custom cost on the path, at every knot."""


class PathSource(Protocol):
    """Source of known paths among obstacles, such as a `Roadmap`."""

    def shortest_path(self, task: PlanTask, start: Array, goals: Sequence[Array], clock: Clock) -> PathResult:
        """Shortest known path from a point to one of the goals; without points if none is known."""

    def near(self, task: PlanTask, position: Array, count: int) -> Array:
        """Points with tips nearest to a position, at most `count`."""


@dataclass(frozen=True)
class PlanOptions(Displayed):
    """Details of a plan.

    Raises:
        InputError: a value that is not allowed.
    """

    method: Annotated[
        str,
        OneOf(SEARCHES),
        "search algorithm: rrt_connect, auto (simple paths, then rrt_connect) or optimal (auto, then shorter paths)",
    ] = "auto"
    """"auto": straight, then through translations that exclude snaps, then RRT-Connect. "rrt_connect": that alone.
    "optimal": as "auto", then BIT* (OMPL) searches a shorter path for `search_seconds`.
    """
    objective: Annotated[
        str,
        OneOf((*WEIGHTS, "none")),
        "objective of the smoothing: length (of the joint path), time, effort (squared acceleration), margin or none",
    ] = "length"
    """"length" (of the path in joint space), "time", "effort" (int of the squares of the accelerations),
    "margin" (largest least margin), or "none"."""
    time_limit: Annotated[float, unit("s"), POSITIVE, "time limit of search, smoothing and proof"] = 60.0
    """Time limit of search, smoothing and proof, s."""
    search_seconds: float = 5.0
    """Duration of the search for a shorter path by "optimal", s."""
    clearance: Annotated[
        float, unit("mm"), NOT_NEGATIVE, Typical(1e-5, 0.1), "smallest allowed distance between arm and obstacles"
    ] = 0.0
    """Smallest allowed distance between the surface of the arm and obstacles, m."""
    max_force: Annotated[
        float,
        key("max_tip_force_mN"),
        NOT_NEGATIVE,
        "prove margin and clearance for any tip force up to this size, in any direction",
    ] = 0.0
    """Forces that keep their direction."""
    carriage_gap: float = 0.0
    """Smallest distance between carriages, as in `InverseOptions`, m."""
    section_length: float = 0.0
    """Smallest length that a tube protrudes from the next outer one, as in `InverseOptions`, m."""
    modulo_turns: Annotated[bool, "accept goal rotations plus any number of full turns"] = False
    """The trajectory states the number of full turns."""
    seed: Annotated[int, NOT_NEGATIVE, "random seed of the search"] = 0
    extra_cost: CustomObjective | None = None
    """Custom objective of smoothing: an expression of the joint values and the tip of one pose, `q.poses[0]`. Its mean
    along the path, times its weight, is added to the objective. There the length of the path found counts 1.
    """
    smoothing_seconds: float = 20.0
    """Maximum duration of the smoothing, s; at most half of the remaining time."""
    smoothing_intervals: int = 24
    """Initial number of intervals between knots of the smoothing; more give a better motion, and take longer."""
    roadmap: PathSource | None = field(default=None, repr=False)
    """Roadmap that is searched first, see `build_roadmap`."""

    @property
    def kept_clearance(self) -> float:
        """Distance that arms keep from bodies and from each other, m, without the deflection under `max_force`."""
        return self.clearance

    def __post_init__(self) -> None:
        check_fields(self)
        instance("extra_cost", self.extra_cost, CustomObjective, optional=True)
        if self.extra_cost is not None and self.objective == "none":
            raise InputError("extra_cost is a cost of smoothing, and objective is 'none'; it must be another one")
        if self.roadmap is not None and not hasattr(self.roadmap, "shortest_path"):
            raise InputError(f"roadmap is {self.roadmap!r}; it must be a Roadmap")
        positive("search_seconds", self.search_seconds)
        positive("smoothing_seconds", self.smoothing_seconds)
        whole("smoothing_intervals", self.smoothing_intervals, 1)
        for name in ("carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
            check_size(name, getattr(self, name), Typical(1e-6, 0.5), "mm")


DEFAULT_PLAN = PlanOptions()


@dataclass(frozen=True, eq=False)
class PlanTask(Task):
    """Requirements on a plan, with limits of the actuators and options; its clock of the time limit is running."""

    max_force: float = 0.0
    """Largest force on the tip under which margin and clearance must hold, N."""
    reserve: float = 0.0
    """Part of `clearance` for the deflection by that force, m."""
    rates: RateLimits = DEFAULT_RATES
    """Limits of the actuators."""
    options: PlanOptions = DEFAULT_PLAN
    """Options of search and smoothing."""
    cost: tuple[Expression, float] | None = None
    """Custom cost of a pose in the smoothing, and its weight."""

    @contextmanager
    def in_time(self) -> Iterator[None]:
        """Context that turns a OutOfTimeError into a SolveError."""
        try:
            yield
        except OutOfTimeError:
            limit = f"{self.clock.limit:g} s"
            raise SolveError(f"no path was found within the time limit of {limit}") from None


def plan_task(
    robot: Robot,
    obstacles: Sequence[Obstacle],
    min_margin: float = MIN_MARGIN,
    rate_limits: RateLimits = DEFAULT_RATES,
    limits: JointLimits | None = None,
    options: PlanOptions = DEFAULT_PLAN,
    load: Load | None = None,
    configurations: Sequence[Any] = (),
) -> PlanTask:
    """Task of a plan, with its clock running; `configurations` are those that its joint space must contain.

    Raises:
        InputError: arguments of another kind, or with invalid numbers.
    """
    instance("options", options, PlanOptions)
    clock = Clock(options.time_limit)
    check_robot(robot)
    instance("limits", limits, JointLimits, optional=True)
    instance("rate_limits", rate_limits, RateLimits)
    bodies = checked_obstacles(obstacles)
    extra = options.extra_cost
    cost = None if extra is None else (path_cost(extra, robot.n_tubes), extra.sign * extra.weight)
    required = finite("min_margin", min_margin)
    if not 0 <= required < 1:
        raise InputError(f"min_margin is {required:g}; it must be at least 0 and less than 1")
    space = joint_space(robot, limits, options.carriage_gap, options.section_length)
    space = space.holding(*shift_of(robot, *configurations))
    rate_limits.of(space)
    if options.max_force and rate_limits.tip is not None:
        raise InputError("rate_limits.tip and max_force are both given; there is no bound on the tip speed under force")
    coordinates: Coordinates
    if robot.fixed_sections:
        coordinates = TipCoordinates(space) if load is None else _loaded(space, load, options)
    else:
        coordinates = _of_joints(space, load, options)
    return PlanTask(
        coordinates,
        bodies,
        required,
        options.kept_clearance,
        clock=clock,
        max_force=options.max_force,
        rates=rate_limits,
        options=options,
        cost=cost,
    )


def _loaded(space: JointSpace, load: Load, options: PlanOptions) -> LoadedChart:
    """Chart of a robot under a load; raises InputError if no plan could be proved."""
    instance("load", load, Load)
    what = uncovered(load)
    if what:
        raise InputError(f"load has {what}; no trajectory can be proved under it")
    _must_not_smooth("a load", options)
    return LoadedChart(space, load)


def _of_joints(space: JointSpace, load: Load | None, options: PlanOptions) -> JointCoordinates:
    """Coordinates of a bundle; raises InputError for options that it does not support."""
    instance("load", load, Load, optional=True)
    if options.max_force:
        raise InputError("max_force is given; nothing is proved of bundles under forces that may change")
    _must_not_smooth("a bundle", options)
    return JointCoordinates(space, load)


def _must_not_smooth(what: str, options: PlanOptions) -> None:
    for name in ("roadmap", "extra_cost"):
        if getattr(options, name):
            raise InputError(f"{name} and {what} are both given; plans then do not support {name}")


def reserve_deflection(task: PlanTask, *translations: Array) -> PlanTask:
    """Task with the clearance increased by the largest deflection under its tip force at and between translations (n,).

    Raises:
        SolveError: at one of them the margin is not proved for every such force.
    """
    if not task.max_force:
        return task
    robot, deflections = task.coordinates.space.robot, []
    for each in translations:
        bound = under_any_force(robot, each, task.max_force, task.coordinates.load)
        if bound.margin <= 0 or bound.margin < task.min_margin:
            where = ", ".join(f"{x * 1e3:.4g}" for x in each)
            raise SolveError(
                f"no plan can be proved: at translations {where} mm the proved margin is "
                f"{bound.margin:.3g} under any tip force up to {task.max_force * 1e3:g} mN; "
                f"it must be at least {max(task.min_margin, 0.0):g}"
            )
        deflections.append(bound.deflection)
    between = under_any_force(robot, np.array(translations), task.max_force, task.coordinates.load).deflection
    reserve = DEFLECTION_FACTOR * (between if np.isfinite(between) else max(deflections))
    return replace(task, clearance=task.clearance - task.reserve + reserve, reserve=reserve)


def path_cost(extra: CustomObjective, n: int) -> Expression:
    """Custom cost on the path, as an expression of one pose on it.

    Raises:
        InputError: an invalid cost, or one that uses more than joint values, tip position and tip direction.
    """
    extra.checked()
    cost = recorded(extra.expression, n, 1, extra.description)
    for quantity in cost.quantities:
        if quantity.pose is None or quantity.name not in PATH_QUANTITIES:
            known = ", ".join(PATH_QUANTITIES)
            raise InputError(f"the cost {extra.description} uses {quantity.name}; on a path it may use {known}")
    if cost.value.numel_out() != 1:
        raise InputError(f"the cost {extra.description} has {cost.value.numel_out()} numbers; it must be one")
    return cost
