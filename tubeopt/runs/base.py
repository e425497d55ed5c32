"""What all kinds of study share: the robot, lists of joint values, and how a long answer tells how far it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from ..files.checked import Entry, Number, in_file
from ..files.units import DEG, MM, decimal, shown, to_si
from ..robots.file import AnyRobot, load_robot
from ..typing import Array

Progress = Callable[[int, int], object]
"""Called with how much is done, and how much there is, 0 where nobody knows."""


RobotPath = Annotated[
    AnyRobot,
    in_file(load_robot, "a robot file", kind=AnyRobot),
    Field(description="path of the robot file, relative to this file"),
]
"""A robot, given as the path of its file."""


def _one_per_tube(values: list[Decimal], info: ValidationInfo) -> list[Decimal]:
    robot = info.data.get("robot")  # absent where the robot itself has problems
    if robot is not None and len(values) != robot.n_tubes:
        count = "1 number" if len(values) == 1 else f"{len(values)} numbers"
        raise ValueError(f"has {count}; it must be {robot.n_tubes} (one per tube)")
    return values


OnePerTube = Annotated[list[Number], AfterValidator(_one_per_tube)]
"""A number for every tube of the study's robot, inner to outer."""


TURNED = Field(None, description="rotation of every tube, inner to outer; by default all 0")
SHIFTED = Field(None, description="translation of every tube, inner to outer; by default home")


def _whole(value: object) -> int:
    number = decimal(value)
    if number != number.to_integral_value():
        raise ValueError(f"is {shown(value)}; it must be a whole number")
    return int(number)


Whole = Annotated[int, BeforeValidator(_whole)]
"""A whole number."""


class Study(Entry):
    """What all kinds of study have in common."""

    kind: str

    def run(self, progress: Progress | None = None) -> Any:
        """The answer to the question that the study asks."""
        raise NotImplementedError


def radians(values: Sequence[Decimal] | None, otherwise: Array) -> Array:
    """`values` (deg) in rad, or `otherwise` where there are none."""
    return otherwise if values is None else np.array([to_si(value, DEG) for value in values])


def metres(values: Sequence[Decimal] | None, otherwise: Array) -> Array:
    """`values` (mm) in m, or `otherwise` where there are none."""
    return otherwise if values is None else np.array([to_si(value, MM) for value in values])
