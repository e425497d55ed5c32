"""Studies of loads: how much a robot bears, and which forces act on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..errors import InputError
from ..files.checked import Positive
from ..files.field_metadata import Typical
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability import LoadLimit, find_load_limit, find_stroke_force, follow
from ..typing import Array, Progress
from ..validation import ForceRecord, estimate_forces
from .base import OnePerTube, Posed, RobotPath, Timed, joints_of
from .load_file import LoadedStudy
from .validation_study import MeasurementsPath

PUSH = 1e-3
"""N that a robot whose stroke force is asked pushes with, so that times are mN."""


SEARCHED = (10.0, 100.0, 1000.0)
"""Largest load factors that are searched one after the other; the first is the largest axial force too, N."""


@dataclass(frozen=True, eq=False)
class Bearing(Displayed):
    """How much of a load a robot bears at given joint values."""

    robot: Robot
    rotations: Array
    """(n,) rad"""
    translations: Array
    """(n,) m"""
    load: Load
    limit: LoadLimit | None
    """None where it bears all that was looked at."""
    up_to: float
    """Up to how many times the load was looked at."""


class LoadLimitStudy(Posed, LoadedStudy, Timed):
    """Load factor at which a robot loses stability."""

    doing = "putting the load on"

    kind: Literal["load_limit"]
    from_deg: OnePerTube | None = Field(
        None,
        description="rotations of an unloaded start: the robot moves from there to its "
        "rotations, then the load grows; default no motion",
    )
    axial: bool = Field(
        False,
        description="use an axial force of 1 mN against the tip as load (stroke force)",
    )
    up_to: Positive | None = Field(
        None,
        description="largest load factor to search, by default 10, then 100 and 1000 until the limit is found; "
        "with axial, largest force, N, by default 10",
    )

    @model_validator(mode="after")
    def _pushed(self) -> Self:
        given = self.pushing()
        if given is None and not self.axial:
            raise ValueError("no load is given; give tip_force_mN, tip_moment_mN_m, gravity_m_per_s2 or load, or axial")
        if given is not None and given == Load(frame=given.frame):
            raise ValueError("the load is 0; it must not be 0")
        if given is not None and self.axial:
            raise ValueError("axial and a load are both given; give one of them")
        return self

    def run(self, progress: Progress | None = None) -> Bearing:
        """The limit; raises SolveError where there is no stable equilibrium without load, or the branch is lost."""
        rotations, translations = self.joints
        load, up_to = self.pushing(), self.si("up_to")
        start = None
        if self.from_deg is not None:
            way = [joints_of(self.robot, self.si("from_deg"), self.si("translations_mm"))[0], rotations]
            start = follow(self.robot, way, [translations, translations]).equilibria[-1]
        if load is not None:
            found, reached = None, 0.0
            for reached in SEARCHED if up_to is None else (up_to,):
                found = find_load_limit(self.robot, rotations, translations, load, equilibrium=start, up_to=reached)
                if found is not None:
                    break
            return Bearing(self.robot, rotations, translations, load, found, reached)
        start = start or forward_kinematics(self.robot, rotations, translations)
        up_to = SEARCHED[0] if up_to is None else up_to
        found = find_stroke_force(self.robot, rotations, translations, equilibrium=start, up_to=up_to)
        x, y, z = (-PUSH * start.tip_rotation[:, 2]).tolist()
        limit = None if found is None else replace(found, factor=found.factor / PUSH)
        return Bearing(self.robot, rotations, translations, Load((x, y, z)), limit, up_to / PUSH)


class ForceStudy(LoadedStudy, Timed):
    """The force on the tip of a robot at every row of a recording of its tip, or of points along its arm."""

    doing = "estimating forces"

    kind: Literal["force"]
    robot: RobotPath
    measurements: MeasurementsPath
    noise_mm: Annotated[Positive, Typical(1e-6, 0.02)] = Field(
        Decimal(1), description="standard deviation of a measured coordinate"
    )
    registration: Literal["none", "saved"] | None = Field(
        None,
        description="frame of the positions. none: base frame; saved: device frame of the calibration",
    )

    def run(self, progress: Progress | None = None) -> ForceRecord:
        """The forces in the frame of the plate, rows without one marked.

        Raises:
            InputError: a load that is known turns with the tip.
        """
        known = self.pushing()
        if known is not None and known.frame != "world":
            raise InputError("the known load turns with the tip; its frame must be 'world'")
        return estimate_forces(
            self.robot, self.measurements, known=known, progress=progress, **self.in_si("noise_mm", "registration")
        )
