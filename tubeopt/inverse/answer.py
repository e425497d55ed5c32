"""Answers of inverse kinematics: plain data, and how the question is asked in detail."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from ..block.own import OwnObjective, OwnRequirement
from ..bodies.scene import Scene
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..errors import InputError, choice, instance, positive, whole
from ..robots.robot import Robot
from ..typing import Array, Of, Sentence
from .goal import OBJECTIVES
from .outline import Outline
from .settings import DEFAULT_SOLVER, InverseSolver

METHODS = ("auto", "gauss_newton", "nlp")
"""How to solve: the fast path and the nonlinear program where it stalls, or one of them alone."""


class InverseStatus(Sentence):
    """What became of a target; every value reads as a sentence."""

    REACHED = "the target is reached by a stable equilibrium"
    CLOSEST = "the target was reached from no start; this is the closest pose that was found"
    TIMED_OUT = "the time ran out before the target was reached; this is the closest pose that was found till then"


@dataclass(frozen=True)
class InverseStatistics:
    """How an answer was found."""

    method: str
    """"gauss_newton" or "nlp"."""
    start: str
    """"seed", "reference" or "table"."""
    tries: int
    """Starts tried."""
    iterations: int
    """Of all searches."""
    solves: int
    """Equilibria that were solved."""
    seconds: float
    """Since the question was asked."""


@dataclass(frozen=True, eq=False)
class JointWay:
    """Joint values on which the robot does not snap: slowly through W waypoints, straight from one to the next."""

    origin: str
    """Where it begins: "seed", "home", or "last target"."""
    rotations: Array
    """(W, n) rad; the last are those of the answer."""
    translations: Array
    """(W, n) m."""


@dataclass(frozen=True, eq=False)
class InverseSolution(Displayed):
    """Joint values that bring the tip to a target, and the equilibrium that the robot takes there."""

    _brief = ("robot", "rotations", "translations", "position_error", "margin", "status")

    target_position: Array
    """(3,) m, asked for."""
    target_direction: Array | None
    """(3,) unit vector, or None: what was asked for."""
    equilibrium: Equilibrium
    """Stable; `forward_kinematics(robot, rotations, translations, guess=equilibrium)` agrees."""
    position_error: float
    """Distance of the tip from the target, m."""
    direction_error: float
    """Angle, rad; NaN without a direction."""
    scene: Scene
    """The obstacles."""
    cold_start_agrees: bool | None
    """Whether `forward_kinematics` without a guess finds this same equilibrium; None where nobody asked, as in a servo
    step."""
    straight_from_seed: bool | None
    """Whether the straight way of joint values from the seed is known to lead there without a snap; False where it
    snaps, or comes too close to that for a quick look; None without a seed."""
    active: tuple[str, ...]
    """In words, what holds the joint values: ends of ranges, tubes that touch, margin, obstacles."""
    status: InverseStatus
    """How the search ended."""
    statistics: InverseStatistics
    """Its cost."""
    reachable: bool | None = None
    """Whether a way is known from the seed, or else from home, on which the robot does not snap: True with `way`; None
    where only a quick look was taken at the straight one; False where `reachable=True` was given and none was found,
    which does not prove that there is none."""
    way: JointWay | None = None
    """That way; None without. It keeps the ranges of the joints; obstacles are left to `plan_trajectory`. Home is the
    joint values nearest to it that ranges and order of the tubes allow."""
    leaps: str = ""
    """For an answer of `IkSession`, what makes the straight way of joint values from the last answer a leap, in words;
    empty where the tip stays near the line between the two targets."""

    robot = Of[Robot]("equilibrium")
    rotations, translations = Of[Array]("equilibrium"), Of[Array]("equilibrium")
    margin = Of[float]("equilibrium")

    @cached_property
    def clearance(self) -> float:
        """Least distance of the surface of the arm from any obstacle, m; infinite without."""
        return Outline(self.equilibrium).clearance(self.scene)

    @property
    def value(self) -> tuple[Array, Array]:
        """The joint values: rotations (n,), rad, and translations (n,), m."""
        return self.rotations, self.translations

    @property
    def reached(self) -> bool:
        """Whether the tip is on target."""
        return self.status is InverseStatus.REACHED


@dataclass(frozen=True)
class InverseOptions(Displayed):
    """Details of the question and of the search.

    Raises:
        InputError: a value that is not allowed.
    """

    objective: str | None = None
    """What is best among the answers: "nearest" (to the reference), "margin" (largest), "curvature" (least
    int |u|^2 ds), or None: "nearest" where a seed or a reference is given, else any answer."""
    direction_weight: float | None = None
    """None holds the tip to the direction; a number makes (half the square of) the difference of the unit vectors a
    cost of that weight beside the objective."""
    clearance: float = 0.0
    """Least distance of the surface of the arm from obstacles, m."""
    carriage_gap: float = 0.0
    """Least distance of neighbouring carriages, m."""
    section_length: float = 0.0
    """Least length by which a tube ends beyond the one around it, m."""
    method: str = "auto"
    """"auto" (the fast path, and the nonlinear program where that stalls), "gauss_newton" or "nlp" alone."""
    starts: int = 48
    """Most starting configurations."""
    distinct: float = 0.05
    """Answers of `all_solutions` differ somewhere along the arm by this share of its length."""
    time_limit: float = math.inf
    """s, of the whole call, whatever the method: what is under way then ends where it is."""
    extra_cost: OwnObjective | None = None
    """An own objective, added to `objective`: its expression of the quantities of the one pose, `q.poses[0]`, times its
    weight. The fast path then searches alone."""
    extra_constraints: tuple[OwnRequirement, ...] = ()
    """Own requirements that every answer keeps. The fast path then searches alone."""
    solver: InverseSolver = DEFAULT_SOLVER
    """How hard it is searched."""

    def __post_init__(self) -> None:
        if self.objective is not None:
            choice("objective", self.objective, OBJECTIVES)
        choice("method", self.method, METHODS)
        for name in ("clearance", "carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
        positive("distinct", self.distinct)
        if self.time_limit != math.inf:
            positive("time_limit", self.time_limit)
        if self.direction_weight is not None:
            positive("direction_weight", self.direction_weight)
        if not isinstance(self.extra_constraints, (list, tuple)):
            raise InputError(
                f"extra_constraints is {self.extra_constraints!r}; it must be a sequence of OwnRequirement"
            )
        object.__setattr__(self, "extra_constraints", tuple(self.extra_constraints))
        if self.method == "nlp" and (self.extra_cost is not None or self.extra_constraints):
            raise InputError("method 'nlp' takes no extra_cost and no extra_constraints; use 'auto' or 'gauss_newton'")
        whole("starts", self.starts, 1)
        instance("solver", self.solver, InverseSolver)


DEFAULT_OPTIONS = InverseOptions()
