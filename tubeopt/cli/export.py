"""`tubeopt export`: a robot as a C library, for a loop without Python."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..control.c_library import c_library, save_c_library
from ..robots.file import load_robot
from ..show.reports import report
from .flags import ROBOT, command
from .output import Output, can_be_saved, present


@command(
    "tubeopt export configs/robots/thesis_ctr.yaml --c thesis_in_c",
    note="Build and test it: cmake -B build -S thesis_in_c && cmake --build build && ctest --test-dir build",
)
def export(
    robot: Annotated[str, typer.Argument(metavar=ROBOT[0], help=ROBOT[1], show_default=False)],
    output: Output,
    c: Annotated[Path, typer.Option("--c", metavar="DIR", help="Write the C library into this directory.")],
    prefix: Annotated[
        str, typer.Option(metavar="NAME", help="With which all its names begin: two robots need two.")
    ] = "tubeopt",
    loads: Annotated[bool, typer.Option("--loads", help="It can bear a force at its tip, and its weight.")] = False,
) -> None:
    """The robot as a C library of its own: forward kinematics, derivatives, margin, compliance, servo, snap guard.

    It is the compiled kernel of this program with the numbers of the robot, in C99: nothing is allocated, nothing is
    global, and every call takes bounded time. For up to six tubes, concentric or not, of one arc or made of pieces;
    with compliance and, by --loads, under load for concentric tubes of one arc each.
    """
    can_be_saved(output.out)
    can_be_saved(c)
    library = c_library(load_robot(robot), name=Path(robot).stem, prefix=prefix, loads=loads)
    present(report(library), output, written=save_c_library(library, c))
