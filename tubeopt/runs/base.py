"""What all kinds of study share: the robot, lists of joint values, and how a long answer tells how far it is."""

from __future__ import annotations

import importlib
import math
from collections import UserDict
from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo

from ..equilibrium.readings import to_model
from ..files.checked import Entry, Number, Positive, Whole, in_file
from ..files.units import TO_MM
from ..robots.file import AnyRobot, load_robot
from ..robots.limits import FAR, MOST_TURN
from ..robots.robot import Robot
from ..solvers.time_limit import LONG_TIME_LIMIT, LateError, late_error, within
from ..typing import Array, Progress

RobotPath = Annotated[
    AnyRobot,
    in_file(load_robot, "a robot file", kind=AnyRobot),
    Field(description="path of the robot file, relative to this file"),
]
"""A robot, given as the path of its file."""


ROUNDED = 1e-9
"""mm, by which a translation may exceed what the tube allows: numbers of a file are rounded."""


def _one_per_tube(values: list[Decimal], info: ValidationInfo) -> list[Decimal]:
    robot = info.data.get("robot")  # absent where the robot itself has problems
    if robot is not None and len(values) != robot.n_tubes:
        count = "1 number" if len(values) == 1 else f"{len(values)} numbers"
        raise ValueError(f"has {count}; it must be {robot.n_tubes} (one per tube)")
    key = info.field_name or ""
    if robot is None or robot.calibration is not None or key.startswith(("lower", "upper")):  # readings; ends of a box
        return values
    most = round(math.degrees(MOST_TURN))
    for i, (value, tube) in enumerate(zip(values, robot.tubes, strict=True)):
        at = f"has {value} for tube {i + 1}; it must be"
        if key.endswith("_deg") and abs(value) > most:
            raise ValueError(f"{at} at most {most} ({MOST_TURN / math.tau:.0f} turns) to either side")
        if key.endswith("_mm") and float(value) > tube.straight_length * TO_MM + ROUNDED:
            raise ValueError(f"{at} at most its straight length, {tube.straight_length * TO_MM:g}: it is held there")
        if key.endswith("_mm") and float(value) < -FAR * tube.length * TO_MM:
            raise ValueError(f"{at} at least {-FAR * tube.length * TO_MM:g}, {FAR:g} lengths of the tube behind home")
    return values


OnePerTube = Annotated[list[Number], AfterValidator(_one_per_tube)]
"""A number for every tube of the study's robot, inner to outer."""


HOME = "home: 0, or as near to it as limits and the order of the tubes allow"
"""What the word means, for helps."""


SHIFTED = Field(None, description=f"translation of every tube, inner to outer; by default {HOME}")


def _of_the_robot(tube: int, info: ValidationInfo) -> int:
    robot = info.data.get("robot")
    if robot is not None and tube > robot.n_tubes:
        raise ValueError(f"is {tube}; it must be 1 to {robot.n_tubes}")
    return tube


Count = Annotated[Whole, Field(ge=1)]
"""A whole number, at least 1."""


TubeNumber = Annotated[Count, AfterValidator(_of_the_robot), Field(description="which tube of the robot, from 1")]
"""One of the tubes of the study's robot."""


def require_one(study: Entry, one: str, other: str) -> None:
    """Raise ValueError unless a study has one of two keys."""
    given = {getattr(study, key) is not None for key in (one, other)}
    if given == {False}:
        raise ValueError(f"{one} and {other} are missing; one of them must be given")
    if given == {True}:
        raise ValueError(f"{one} and {other} are given; it must be one of them")


class Kinds(UserDict[str, Any]):
    """Kinds of a file -> the entry that reads it, from "module.Class" of this package: imported when asked for."""

    def __getitem__(self, kind: str) -> Any:
        module, name = self.data[kind].split(".")
        return getattr(importlib.import_module(f".{module}", __package__), name)


class Posed(Entry):
    """A robot at joint values: readings, where it has a calibration."""

    robot: RobotPath
    rotations_deg: OnePerTube | None = Field(
        None, description="rotation of every tube, inner to outer; by default 0, or as near as limits allow"
    )
    translations_mm: OnePerTube | None = SHIFTED

    @property
    def joints(self) -> tuple[Array, Array]:
        """The model's rotations (n,) rad and translations (n,) m there."""
        return joints_of(self.robot, self.si("rotations_deg"), self.si("translations_mm"))


class Started(Entry):
    """A robot, and from where it begins."""

    robot: RobotPath
    start_deg: OnePerTube | None = Field(
        None, description="rotations at the start; by default 0, or as near as limits allow"
    )
    start_mm: OnePerTube | None = Field(None, description=f"translations at the start; by default {HOME}")

    @property
    def start(self) -> tuple[Array, Array]:
        """Joint values with which it begins."""
        return joints_of(self.robot, self.si("start_deg"), self.si("start_mm"))


class Study(Entry):
    """What all kinds of study have in common."""

    doing: ClassVar[str] = "running the study"
    """What is told while its answer is computed."""

    keeps: ClassVar[str] = ""
    """What `run_in` has saved into {out} where it is interrupted."""

    either: ClassVar[tuple[frozenset[str], ...]] = ()
    """Sets of keys of which a study has one: a flag in one of them stands for the keys of the others too."""

    assuming: ClassVar[str] = ""
    """A sentence on what its answer is said under."""

    kind: str

    def run(self, progress: Progress | None = None) -> Any:
        """The answer to the question that the study asks; a kind of study has this or `run_in` of its own."""
        return self.run_in(None, progress)

    def ask(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer of a command."""
        return self.run_in(out, progress)

    def run_in(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer, as `run` gives it; what can be kept of it on the way is kept in `out`, to go on from there."""
        if progress is not None and getattr(self, "workers", 1) == 1:  # a bar is a thread: processes come first
            progress(0, 0)
        return self.run(progress)


class Timed(Study):
    """A study whose answer takes long: its time limit."""

    time_limit_s: Positive = Field(Decimal(int(LONG_TIME_LIMIT)), description="on the clock, for all of it")

    def ask(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer, as `run_in` gives it, within the time limit.

        Raises:
            TimeLimitError: it is reached before there is an answer.
        """
        limit = self.si("time_limit_s")
        try:
            with within(limit):
                return self.run_in(out, progress)
        except LateError as late:
            raise late_error(self.kind, limit, late.best) from None


def joints_of(robot: Robot, turned: Sequence[float] | None, shifted: Sequence[float] | None) -> tuple[Array, Array]:
    """The model's rotations (n,) rad and translations (n,) m where drives read `turned` (rad) and `shifted` (m).

    Readings are the model's values where the robot has no calibration. Without `turned` the drives read 0, or what is
    nearest in their limits; without `shifted` the carriages are at home.

    Raises:
        SolveError: carriages yield without end.
    """
    given = robot.joint_limits
    low, high = np.array(robot.limits.rotations if given is None else given.rotations).T
    rotations = np.clip(0.0, low, high) if turned is None else np.array(turned)
    if shifted is not None:
        return to_model(robot, rotations, np.array(shifted))
    own = robot.calibration
    return rotations if own is None else own.to_model(rotations, 0.0)[0], robot.home_translations
