"""`tubeopt robot`, `list` and `doctor`: data of a robot, built-in files, installation."""

from __future__ import annotations

from typing import Annotated

import typer

from ..errors import choice
from ..robots.file import load_robot
from ..show.command_report import examine, shipped_files, shipped_folders
from ..show.reports import report
from .commands import ROBOT
from .flags import command, completion, files
from .output import OF_PICTURES, Output, can_be_saved, present


@command("tubeopt robot show thesis_ctr", without=OF_PICTURES)
def show(
    robot: Annotated[
        str,
        typer.Argument(metavar=ROBOT[0], help=ROBOT[1], show_default=False, autocompletion=files("robot")),
    ],
    output: Output,
) -> None:
    """Show stiffness, strain, fit and home position of every tube, with warnings."""
    can_be_saved(output.out)
    present(report(load_robot(robot)), output)


@command("tubeopt robot list", without=OF_PICTURES)
def list_robots(output: Output) -> None:
    """List the built-in robots. Use them by name, as in `tubeopt fk thesis_ctr`."""
    can_be_saved(output.out)
    present(report(shipped_files("robots")), output)


@command("tubeopt list rigs", without=OF_PICTURES)
def list_files(
    output: Output,
    folder: Annotated[
        str | None,
        typer.Argument(
            metavar="[FOLDER]",
            help="Show only this kind: robots, rigs, studies, ...",
            autocompletion=completion(shipped_folders()),
        ),
    ] = None,
) -> None:
    """List the built-in files, to use by name: robots, rigs, studies, targets, ..."""
    can_be_saved(output.out)
    chosen = "*" if folder is None else choice("FOLDER", folder, shipped_folders())
    present(report(shipped_files(chosen)), output)


@command("tubeopt doctor", without=OF_PICTURES)
def doctor(output: Output) -> None:
    """Show versions, compiled kernel, threads, cache and extras, and run a timed self-test."""
    present(report(examine()), output)
