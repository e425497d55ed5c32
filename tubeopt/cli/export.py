"""`tubeopt export`: a robot as a C library, for a loop without Python."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from ..control.c_library import c_library, save_c_library
from ..files.checked import Entry
from ..runs.robot_keys import RobotPath
from ..show.reports import report
from .flags import asks
from .output import OF_PICTURES, Output, can_be_saved, present


class ExportEntry(Entry):
    """A robot to be written in C."""

    robot: RobotPath
    c: str = Field(description="directory to write the C library to", examples=["DIR"])
    prefix: str = Field(
        "tubeopt",
        description="prefix of all C names; use a different one for each robot of a program",
        examples=["NAME"],
    )
    loads: bool = Field(
        False, description="include tip force and weight; required for the compliance of tubes made of pieces"
    )


@asks(
    ExportEntry,
    example="tubeopt export configs/robots/thesis_ctr.yaml --c thesis_in_c",
    note="Build and test it: cmake -B build -S thesis_in_c && cmake --build build && ctest --test-dir build",
    without=OF_PICTURES,
)
def export(study: ExportEntry, output: Output, robot: str) -> None:
    """Write a C99 library of the robot: forward kinematics, derivatives, margin, compliance, servo, snap guard.

    It allocates no memory, has no global state, and every call takes bounded time. It supports up to six tubes,
    concentric or eccentric, with one arc or made of pieces. --loads adds loads for concentric robots.
    """
    folder = Path(study.c)
    can_be_saved(output.out)
    can_be_saved(folder)
    library = c_library(study.robot, name=Path(robot).stem, prefix=study.prefix, loads=study.loads)
    present(report(library), output, written=save_c_library(library, folder))
