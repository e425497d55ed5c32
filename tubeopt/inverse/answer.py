"""Options and answers of inverse kinematics: plain data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

from ..arguments import typed
from ..block.custom import CustomObjective, CustomRequirement
from ..bodies.obstacles import Scene
from ..display import Displayed
from ..equilibrium.arm_surface import ArmSurface
from ..equilibrium.result import Equilibrium
from ..errors import InputError, positive, whole
from ..files.field_metadata import (
    NOT_NEGATIVE,
    POSITIVE,
    OneOf,
    Range,
    Typical,
    check_fields,
    check_size,
    form,
    key,
    unit,
)
from ..robots.robot import Robot
from ..typing import Array, Delegate, StatusEnum

OBJECTIVES = ("nearest", "margin", "curvature")
"""Objectives: joint values nearest to a reference, largest margin, smallest int |u|^2 ds."""

METHODS = ("auto", "gauss_newton", "nlp")
"""Solvers: the fast Gauss-Newton search with the nonlinear program as fallback, or one of them alone."""

TIME_LIMIT = 60.0
"""Default time limit per target, s: three times the default of `tubeopt ik`."""


@typed
@dataclass(frozen=True)
class InverseOptions(Displayed):
    """Options of inverse kinematics.

    Raises:
        InputError: a value that is not allowed.
    """

    objective: Annotated[
        str | None,
        OneOf(OBJECTIVES),
        "objective: nearest (to the start or reference), margin (largest) or curvature (smallest); "
        "default nearest with a start or reference, otherwise any answer",
    ] = None
    """Objective among the solutions: "nearest" (to the reference), "margin" (largest), "curvature" (smallest
    int |u|^2 ds). None is "nearest" with a start or a reference, else any solution."""
    direction_weight: Annotated[
        float | None,
        POSITIVE,
        "weight of the direction error (half the squared difference of the unit vectors) in the objective, "
        "dimensionless; by default the direction is exact",
    ] = None
    """Weight of half the squared difference of the unit vectors in the objective; None makes the direction a
    constraint.
    """
    clearance: Annotated[
        float, unit("mm"), NOT_NEGATIVE, Typical(1e-5, 0.1), "smallest allowed distance between arm and obstacles"
    ] = 0.0
    """Smallest allowed distance between the surface of the arm and obstacles, m."""
    carriage_gap: float = 0.0
    """Smallest allowed distance of neighbouring carriages, m."""
    section_length: float = 0.0
    """Smallest allowed length that a tube protrudes from the next outer one, m."""
    method: Annotated[
        str, OneOf(METHODS), "solver: gauss_newton, nlp (IPOPT), or auto (gauss_newton, then nlp if it fails)"
    ] = "auto"
    """Solver: "auto" (Gauss-Newton, and the nonlinear program if it stalls), "gauss_newton" or "nlp"."""
    starts: Annotated[int, Range(minimum=1), "largest number of starting configurations"] = 48
    steps: int = 30
    """Maximum number of steps from one start to the target; fewer stop sooner for targets out of reach."""
    distinct: float = 0.05
    """Smallest difference of solutions of `all_solutions`, at some point of the arm, as a fraction of its length."""
    time_limit: float = TIME_LIMIT
    """Time limit of the whole call for any solver, s; computations in progress end early. `math.inf` sets none."""
    extra_cost: CustomObjective | None = None
    """Custom objective, added to `objective`: a weighted expression of the quantities of the pose, `q.poses[0]`. Only
    Gauss-Newton supports it."""
    extra_constraints: tuple[CustomRequirement, ...] = ()
    """Custom requirements that every solution satisfies. Only Gauss-Newton supports them."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
            check_size(name, getattr(self, name), Typical(1e-6, 0.5), "mm")
        whole("steps", self.steps, 1)
        positive("distinct", self.distinct)
        if self.time_limit != math.inf:
            positive("time_limit", self.time_limit)
        if not isinstance(self.extra_constraints, (list, tuple)):
            raise InputError(
                f"extra_constraints is {self.extra_constraints!r}; it must be a sequence of CustomRequirement"
            )
        object.__setattr__(self, "extra_constraints", tuple(self.extra_constraints))
        if self.method == "nlp" and (self.extra_cost is not None or self.extra_constraints):
            raise InputError(
                "method 'nlp' does not support extra_cost and extra_constraints; use 'auto' or 'gauss_newton'"
            )


DEFAULT_OPTIONS = InverseOptions()


class InverseStatus(StatusEnum):
    """Result for one target; every value reads as a sentence."""

    REACHED = "the target is reached in a stable equilibrium"
    CLOSEST = "target not reached; the closest pose is shown"
    TIMED_OUT = "target not reached within the time limit; the closest pose is shown"


@dataclass(frozen=True)
class InverseStatistics:
    """Statistics of a search."""

    method: str
    """Solver of the solution: "gauss_newton" or "nlp"."""
    start: str
    """Start of the solution: "seed", "reference" or "table"."""
    tries: int
    """Number of starts tried."""
    iterations: int
    """Number of iterations of all searches."""
    solves: int
    """Number of solved equilibria."""
    seconds: float
    """Time of the call, s."""


@dataclass(frozen=True, eq=False)
class JointPath:
    """Snap-free quasi-static joint path: straight segments between W waypoints."""

    origin: Annotated[str, key("from"), "start of the path"]
    """Start of the path: "seed", "home", or "last target"."""
    rotations: Annotated[Array, unit("deg"), "rotations at its waypoints"]
    """Rotations (W, n), rad; the last row is that of the solution."""
    translations: Annotated[Array, unit("mm"), "translations at its waypoints"]
    """Translations (W, n), m."""


@dataclass(frozen=True, eq=False)
class InverseSolution(Displayed):
    """Joint values that bring the tip to a target, and the equilibrium that the robot takes there."""

    _brief = ("robot", "rotations", "translations", "position_error", "margin", "status")

    target_position: Annotated[Array, key("target_mm"), form(".6g", label="target"), "target position of the tip"]
    """Target position (3,) of the tip, m."""
    target_direction: Annotated[Array | None, "target direction of the tip"]
    """Target direction of the tip as a unit vector (3,), or None."""
    equilibrium: Equilibrium
    """Stable equilibrium; `forward_kinematics(robot, rotations, translations, start=equilibrium)` agrees."""
    position_error: Annotated[float, unit("mm"), "distance of the tip from its target"]
    direction_error: float
    """Angle between tip and target direction, rad; NaN without a target direction."""
    scene: Scene
    """Obstacles of the search."""
    cold_start_agrees: Annotated[bool | None, "true if a cold start gives the same equilibrium"]
    """True if forward kinematics without a start finds the same equilibrium; None if not checked."""
    straight_from_seed: Annotated[
        bool | None, key("straight_from_start"), "true if the straight path from the start arrives without a snap"
    ]
    """True if the straight joint path from the seed has no snap and enough margin for a quick check; None without a
    seed."""
    active: Annotated[tuple[str, ...], "active constraints"]
    """Descriptions of active ranges, contacts of tubes, margin and obstacles."""
    status: InverseStatus
    """Result of the search."""
    statistics: InverseStatistics
    """Solves, iterations and time of the search."""
    reachable: Annotated[bool | None, "true if a snap-free path to it is known; null if unknown"] = None
    """True if a snap-free path from the seed, or else from home, is known: `path`. None if only the straight path was
    checked quickly. False if `reachable=True` was given and no path was found; one may still exist.
    """
    path: Annotated[JointPath | None, "a snap-free path"] = None
    """Snap-free joint path to this solution, or None. It keeps the joint ranges; obstacles are left to
    `plan_trajectory`. Home means the nearest joint values within ranges and order of the tubes.
    """
    jump: Annotated[str, "reason why the straight path from the target before jumps"] = ""
    """Set by `IkSession`; empty if the tip stays near the line between the two targets."""

    robot = Delegate[Robot]("equilibrium")
    rotations, translations = Delegate[Array]("equilibrium"), Delegate[Array]("equilibrium")
    """Joint values (n,), rad and m, not wrapped."""
    margin = Delegate[float]("equilibrium")

    @cached_property
    def clearance(self) -> float:
        """Smallest distance between the surface of the arm and obstacles, m; infinite without obstacles."""
        return ArmSurface(self.equilibrium).clearance(self.scene)

    @property
    def value(self) -> tuple[Array, Array]:
        """Joint values: rotations (n,), rad, and translations (n,), m."""
        return self.rotations, self.translations

    @property
    def reached(self) -> bool:
        """True if the tip is on target."""
        return self.status is InverseStatus.REACHED
