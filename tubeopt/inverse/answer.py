"""Answers of inverse kinematics: plain data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..bodies.scene import Scene
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..robots.robot import Robot
from ..typing import Array, Of, Sentence
from .outline import Outline


class InverseStatus(Sentence):
    """What became of a target; every value reads as a sentence."""

    REACHED = "the target is reached in a stable equilibrium"
    CLOSEST = "target not reached; the closest pose is shown"
    TIMED_OUT = "target not reached within the time limit; the closest pose is shown"


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
    """(n,) rad and (n,) m, not wrapped."""
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
