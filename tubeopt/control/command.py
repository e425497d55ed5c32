"""Command, options and result of a servo step."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

import numpy as np

from ..display import Displayed
from ..errors import InputError, choice, finite, items, positive, vector
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, TYPICAL_CLEARANCE, Absent, Range, Typical, unit
from ..inverse.joints import Configuration, parts
from ..robots.limits import check_target
from ..robots.robot import Robot
from ..typing import Array, Delegate

TASKS = ("position", "velocity", "direction", "pivot", "joints")
OBJECTIVES = ("margin", "centre", "compliance")

Vector = Any
"""(3,) numbers, given as any sequence and kept as an array."""

T = TypeVar("T")

# Largest number of a command, in SI units: beyond, squares and products would no longer be numbers.
MOST_NUMBER = 1e6


def time_step(dt: float) -> float:
    """Checked duration of a step, s; raises InputError for an implausible one."""
    seconds = finite("dt", dt)
    if not 0 < seconds <= MOST_NUMBER:
        raise InputError(f"dt is {seconds:g} s; it must be more than 0, and at most {MOST_NUMBER:g} s")
    return seconds


def at_most(value: Any, name: str) -> Any:
    """Numbers, checked to be at most MOST_NUMBER; raises InputError with the first larger one."""
    most = float(np.abs(value).max())
    if most > MOST_NUMBER:
        raise InputError(f"{name} has {most:g}; it must be at most {MOST_NUMBER:g}, in SI units")
    return value


@dataclass(frozen=True, eq=False)
class Command(Displayed):
    """Target of the tip for one servo step; None leaves a part free."""

    position: Vector | None = None
    """(3,) target position of the tip, m."""
    velocity: Vector | None = None
    """(3,) velocity of the tip, m/s, instead of a position."""
    direction: Vector | None = None
    """(3,) direction of the tip, of any length but 0; stored with length 1."""
    pivot: Vector | None = None
    """(3,) point that the arm must pass through, m, for example an incision."""
    joints: Configuration | None = None
    """Rotations and translations to go to, as a configuration."""
    closest: bool = False
    """True to leave local minima of the distance: at rest short of its target, the servo searches a closer pose."""

    def __post_init__(self) -> None:
        for name in TASKS[:4]:
            value = getattr(self, name)
            if value is not None:
                numbers = vector(name, value, 3, "x, y, z")
                object.__setattr__(self, name, numbers if name == "direction" else at_most(numbers, name))
        if self.position is not None and self.velocity is not None:
            raise InputError("position and velocity are both given; give one of them")
        if self.joints is not None:
            parts("joints", self.joints)
        if not isinstance(self.closest, bool):
            raise InputError(f"closest is {self.closest!r}; it must be true or false")
        if self.closest and (self.position is None or self.joints is not None):
            raise InputError("closest is for a position, without joints")
        if self.direction is not None:
            largest = float(np.abs(self.direction).max())
            if not largest > 0:
                raise InputError("direction has no length")
            ahead = self.direction / largest  # so that its square is a number
            object.__setattr__(self, "direction", ahead / np.linalg.norm(ahead))


def check_places(command: Command, robot: Robot) -> None:
    """Raise InputError for an invalid command, or for a position too far from the robot, which is probably not in m."""
    if not isinstance(command, Command):
        raise InputError(f"command is {command!r}; it must be a Command, such as Command(position=(0.01, 0, 0.1))")
    for name in ("position", "pivot"):
        if (target := getattr(command, name)) is not None:
            check_target(robot.tubes, name, target)


@dataclass(frozen=True)
class ServoOptions(Displayed):
    """Speeds, margins and objective of a servo."""

    speed: Annotated[float, unit("mm_per_s"), POSITIVE, Typical(1e-4, 2.0), "largest tip speed"] = 0.05
    turn_rate: Annotated[
        float,
        unit("deg_per_s"),
        POSITIVE,
        Typical(0.03, 40.0),
        Absent(math.radians(170)),
        "largest rotation speed of a tube",
    ] = 3.0
    shift_rate: Annotated[
        float, unit("mm_per_s"), POSITIVE, Typical(1e-4, 2.0), "largest translation speed of a tube"
    ] = 0.05
    min_margin: Annotated[float, Range(above=0.0, below=1.0), "smallest allowed stability margin"] = 0.1
    clearance: Annotated[
        float, unit("mm"), NOT_NEGATIVE, TYPICAL_CLEARANCE, "smallest allowed distance between arm and obstacles"
    ] = 0.0
    priorities: tuple[str, ...] = ("pivot", "position+velocity+direction+joints")
    """Tasks of TASKS, the most important first; those of one word, as "position+direction", count alike."""
    objective: Annotated[
        str | None,
        "null-space objective, for joint motion that does not move the tip: "
        "margin, centre (of the joint ranges) or compliance (minimised); default none",
    ] = None
    push: float = 0.2
    """Fraction of the rates for the null-space objective."""
    turn_acceleration: Annotated[
        float | None, unit("deg_per_s2"), POSITIVE, "largest acceleration of a rotation; default no limit"
    ] = None
    shift_acceleration: Annotated[
        float | None, unit("mm_per_s2"), POSITIVE, "largest acceleration of a translation; default no limit"
    ] = None
    min_snap_distance: Annotated[
        float | None,
        unit("deg"),
        Range(above=0.0, below=math.pi),
        Typical(1e-3, 1.5),
        "smallest proved snap distance, less than 180 deg: no rotation of the tubes by less may cause a snap. It "
        "replaces min_margin; default none. It has no effect on eccentric robots",
    ] = None

    def __post_init__(self) -> None:
        for name in ("speed", "turn_rate", "shift_rate", "clearance", "push"):
            object.__setattr__(self, name, at_most(positive(name, getattr(self, name), zero=True), name))
        for name in ("turn_acceleration", "shift_acceleration"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, at_most(positive(name, value), name))
        if not 0 < finite("min_margin", self.min_margin) < 1:
            raise InputError(f"min_margin is {self.min_margin:g}; it must be between 0 and 1")
        least = self.min_snap_distance
        if least is not None and not 0 < finite("min_snap_distance", least) < math.pi:
            raise InputError(f"min_snap_distance is {least:g} rad; it must be between 0 and pi")
        named = [
            name
            for group in items("priorities", self.priorities, str, f"some of {', '.join(TASKS)}")
            for name in group.split("+")
        ]
        if sorted(set(named)) != sorted(named) or not set(named) <= set(TASKS):
            raise InputError(f"priorities are {list(self.priorities)}; each of {', '.join(TASKS)} may appear once")
        if self.objective is not None:
            choice("objective", self.objective, OBJECTIVES)


class Why(enum.IntFlag):
    """Reasons why a servo step differs from its command, as flags; 0: none. The C library has the same flags."""

    RATE = 1
    RANGE = 2
    ORDER = 4
    MARGIN = 8
    SHORTENED = 16
    HELD = 32
    OBSTACLE = 64
    NO_CLOSER = 128
    SEEKING = 256

    @property
    def text(self) -> str:
        """Reasons as text; empty without any."""
        return "; ".join(WORDS[bit] for bit in Why if bit in self)


WORDS = {
    Why.RATE: "a joint moves as fast as it may",
    Why.RANGE: "a joint is at the end of its range",
    Why.ORDER: "tubes or carriages touch",
    Why.MARGIN: "the margin is at its lower limit",
    Why.SHORTENED: "the guard has shortened the step",
    Why.HELD: "no step is safe, the robot stays where it is",
    Why.OBSTACLE: "the arm slides along an obstacle",
    Why.NO_CLOSER: "no small motion brings the tip closer to the target",
    Why.SEEKING: "the robot searches a closer pose, or moves to one",
}


@dataclass(frozen=True, eq=False)
class ServoStep(Displayed, Generic[T]):
    """Result of one servo step."""

    equilibrium: T
    """Next equilibrium of the robot."""
    why: Why
    """Reasons for a difference from the command."""
    distance: float
    """Distance of the tip from its target before the step, m; NaN without a target."""
    angle: float
    """Angle between the tip and its target direction before the step, rad; NaN without one."""

    rotations, translations = Delegate[Array]("equilibrium"), Delegate[Array]("equilibrium")
    """(n,) joint values to be sent, rad and m."""
