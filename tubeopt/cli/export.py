"""`tubeopt export`: a robot as a C library, for a loop without Python."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from ..control.c_library import c_library, save_c_library
from ..files.checked import Entry
from ..runs.base import RobotPath
from ..show.reports import report
from .flags import asks
from .output import Output, can_be_saved, present


class ExportEntry(Entry):
    """A robot to be written in C."""

    robot: RobotPath
    c: str = Field(description="write the C library into this directory", examples=["DIR"])
    prefix: str = Field("tubeopt", description="with which all its names begin: two robots need two", examples=["NAME"])
    loads: bool = Field(False, description="it can bear a force at its tip, and its weight")


@asks(
    ExportEntry,
    example="tubeopt export configs/robots/thesis_ctr.yaml --c thesis_in_c",
    note="Build and test it: cmake -B build -S thesis_in_c && cmake --build build && ctest --test-dir build",
)
def export(study: ExportEntry, output: Output, robot: str) -> None:
    """The robot as a C library of its own: forward kinematics, derivatives, margin, compliance, servo, snap guard.

    It is the compiled kernel of this program with the numbers of the robot, in C99: nothing is allocated, nothing is
    global, and every call takes bounded time. For up to six tubes, concentric or not, of one arc or made of pieces;
    concentric ones by --loads under load too, which tubes made of pieces need for their compliance.
    """
    folder = Path(study.c)
    can_be_saved(output.out)
    can_be_saved(folder)
    library = c_library(study.robot, name=Path(robot).stem, prefix=study.prefix, loads=study.loads)
    present(report(library), output, written=save_c_library(library, folder))
