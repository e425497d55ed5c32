"""Answers of inverse kinematics: plain data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

from ..bodies.scene import Scene
from ..display import Displayed
from ..equilibrium.result import Equilibrium
from ..files.field_metadata import form, key, unit
from ..robots.robot import Robot
from ..typing import Array, Delegate, StatusEnum
from .arm_surface import ArmSurface


class InverseStatus(StatusEnum):
    """Result for one target; every value reads as a sentence."""

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
class JointPath:
    """Joint values on which the robot does not snap: slowly through W waypoints, straight from one to the next."""

    origin: Annotated[str, key("from"), "start of the path"]
    """ "seed", "home", or "last target"."""
    rotations: Annotated[Array, unit("deg"), "rotations at its waypoints"]
    """Shape (W, n); the last are those of the solution."""
    translations: Annotated[Array, unit("mm"), "translations at its waypoints"]
    """Shape (W, n)."""


@dataclass(frozen=True, eq=False)
class InverseSolution(Displayed):
    """Joint values that bring the tip to a target, and the equilibrium that the robot takes there."""

    _brief = ("robot", "rotations", "translations", "position_error", "margin", "status")

    target_position: Annotated[Array, key("target_mm"), form(".6g", label="target"), "target position of the tip"]
    """Shape (3,)."""
    target_direction: Annotated[Array | None, "target direction of the tip"]
    """Unit vector, shape (3,), or None."""
    equilibrium: Equilibrium
    """Stable; `forward_kinematics(robot, rotations, translations, start=equilibrium)` agrees."""
    position_error: Annotated[float, unit("mm"), "distance of the tip from its target"]
    direction_error: float
    """Angle, rad; NaN without a direction."""
    scene: Scene
    """The obstacles."""
    cold_start_agrees: Annotated[bool | None, "true if a cold start gives the same equilibrium"]
    """None if it was not checked, as in a servo step."""
    straight_from_seed: Annotated[
        bool | None, key("straight_from_start"), "true if the straight path from the start arrives without a snap"
    ]
    """False if it snaps, or comes too close to a snap for a quick check. None without a seed."""
    active: Annotated[tuple[str, ...], "active constraints"]
    """Ends of ranges, tubes in contact, margin, obstacles."""
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
    """(n,) rad and (n,) m, not wrapped."""
    margin = Delegate[float]("equilibrium")

    @cached_property
    def clearance(self) -> float:
        """Least distance of the surface of the arm from any obstacle, m; infinite without."""
        return ArmSurface(self.equilibrium).clearance(self.scene)

    @property
    def value(self) -> tuple[Array, Array]:
        """The joint values: rotations (n,), rad, and translations (n,), m."""
        return self.rotations, self.translations

    @property
    def reached(self) -> bool:
        """True if the tip is on target."""
        return self.status is InverseStatus.REACHED
