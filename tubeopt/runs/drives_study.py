"""Studies of motors and tubes in use: loads of the drives, and fatigue of the tubes."""

from __future__ import annotations

from os import PathLike
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from ..equilibrium.readings import to_model
from ..equilibrium.result import Equilibrium
from ..files.checked import Count, Positive, in_file
from ..files.csv_file import read_csv
from ..files.field_metadata import Typical
from ..files.units import PERCENT, RAD
from ..planning.trajectory import TIME, load_trajectory
from ..robots.concentric import friction_of
from ..robots.file import load_waypoints
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability import Drives, Fatigue, StrainLife, drives_along, drives_at, fatigue
from ..typing import Array, Progress
from ..workspaces import workspace
from .robot_keys import ExternalLoad, Loaded, RobotPath
from .stability_studies import Shaken
from .study_file import Timed, question
from .surroundings_file import WallBodies

SAMPLES = 1000
"""Default number of configurations in the workspace."""


class JointMotion(NamedTuple):
    """Joint values of a motion, as read from a file."""

    rotations: Array
    """Rotations (T, n), rad."""
    translations: Array
    """Translations (T, n), m."""
    time: Array | None
    """(T,) times, s; None if the file has none."""
    file: Any
    """The trajectory of the file, which may know the start; None without times."""

    def start(self, load: Load | None) -> Equilibrium | None:
        """Equilibrium at the first row under a load, if the file knows it."""
        equilibrium: Equilibrium | None = None if self.file is None else self.file.start(load)
        return equilibrium


def load_joint_motion(path: str | PathLike[str], robot: Robot) -> JointMotion:
    """Motion in a CSV file: waypoints as of `tubeopt follow`, or a trajectory of `tubeopt plan` with times.

    Raises:
        InputError: no such file, unknown or missing columns, cells that are no numbers.
    """
    if TIME in read_csv(path).columns:
        timed = load_trajectory(path, robot)
        return JointMotion(timed.rotations, timed.translations, timed.time, timed)
    waypoints = load_waypoints(path, robot)
    return JointMotion(*to_model(robot, waypoints.rotations, waypoints.translations), None, None)


MotionPath = Annotated[
    JointMotion | None,
    in_file(load_joint_motion, "a CSV file", of="robot"),
    Field(
        description="path of a CSV file of waypoints, as of follow, or of a trajectory with times, as plan saves it; "
        "default samples of the workspace",
        examples=["MOTION.csv"],
    ),
]


def load_strain_life(path: str | PathLike[str]) -> StrainLife:
    """Strain-life curve in a CSV file: columns amplitude_percent, cycles and, for the scatter, cycles_low, cycles_high.

    Raises:
        InputError: no such file, unknown or missing columns, cells that are no numbers, or an invalid curve.
    """
    table = read_csv(path, (*CURVE, *SCATTER))
    scattered = table.expect(CURVE, together=SCATTER)
    amplitude, cycles = table.numbers(CURVE, [PERCENT, RAD]).T
    low, high = table.numbers(SCATTER, RAD).T if scattered else (None, None)
    table.check()
    return StrainLife(amplitude, cycles, low, high)


CURVE, SCATTER = ("amplitude_percent", "cycles"), ("cycles_low", "cycles_high")
"""Columns of a strain-life curve."""


RepeatedMotion = Annotated[
    JointMotion,
    in_file(load_joint_motion, "a CSV file", of="robot"),
    Field(description="path of a CSV file of waypoints, as of follow, or of a trajectory, as plan saves it"),
]

CurvePath = Annotated[
    StrainLife | None,
    in_file(load_strain_life, "a CSV file"),
    Field(
        description="path of a CSV file with a strain-life curve: columns amplitude_percent, cycles and, for its "
        "scatter, cycles_low and cycles_high; default the published limits of nitinol alone",
        examples=["CURVE.csv"],
    ),
]


class DrivesStudy(Loaded, Timed):
    """Largest torque, force and power of the drives along a motion, or over the workspace."""

    doing = "computing the loads of the drives"
    assuming = "Results are of slow motion: without inertia, and without the friction of the drives themselves."

    kind: Literal["drives"]
    robot: RobotPath
    along: MotionPath = None
    walls: WallBodies = ()
    shaken: Shaken = False
    samples: Count | None = Field(
        None,
        description=f"number of configurations in the workspace, without a motion; default {SAMPLES}",
        examples=["N"],
    )
    rotation_rate_deg_per_s: Annotated[Positive | None, Typical(0.03, 100.0)] = Field(
        None, description="rate of all rotations, for the power over the workspace; default no power", examples=["R"]
    )
    translation_rate_mm_per_s: Annotated[Positive | None, Typical(1e-4, 1.0)] = Field(
        None, description="rate of all translations, for the power over the workspace; default no power", examples=["R"]
    )

    @model_validator(mode="after")
    def _motion_or_workspace(self) -> Self:
        rates = "rotation_rate_deg_per_s", "translation_rate_mm_per_s"
        given = [key for key in rates if getattr(self, key) is not None]
        alone = ["samples"] * (self.samples is not None) + given
        if self.along is not None and alone:
            raise ValueError(f"{alone[0]} is given, but along has joint values and times of its own; leave one out")
        if len(given) == 1:
            other = next(key for key in rates if key not in given)
            raise ValueError(f"{given[0]} is given without {other}; give both rates")
        if self.along is None and self.walls:
            raise ValueError("walls are given without a motion; give along")
        return self

    def run(self, progress: Progress | None = None) -> Drives:
        """Loads of the drives; raises SolveError if the motion cannot be followed."""
        robot, load = self.robot, self.external_load
        if self.along is None:
            drawn = workspace(robot, self.samples or SAMPLES)
            turn, slide = self.si("rotation_rate_deg_per_s"), self.si("translation_rate_mm_per_s")
            rates = None if turn is None else (turn, slide)
            return drives_at(robot, drawn.rotations, drawn.translations, load=load, rates=rates, progress=progress)
        motion = self.along
        return drives_along(
            robot,
            motion.rotations,
            motion.translations,
            time=motion.time,
            start=motion.start(load),
            load=load,
            friction=None if self.shaken else friction_of(robot),
            walls=self.walls,
        )


@question("following the motion")
def size_fatigue(
    robot: RobotPath,
    along: RepeatedMotion,
    load: ExternalLoad,
    walls: WallBodies = (),
    shaken: Shaken = False,
    curve: CurvePath = None,
) -> Fatigue:
    """Strain cycles of the tubes along a repeated motion, and their life."""
    return fatigue(
        robot,
        along.rotations,
        along.translations,
        start=along.start(load),
        load=load,
        friction=None if shaken else friction_of(robot),
        walls=walls,
        curve=curve,
    )
