"""`tubeopt robot`: what a robot is made of, and whether it can be built."""

from __future__ import annotations

from typing import Annotated

import typer

from ..robots.file import load_robot
from ..show.reports import report
from .commands import ROBOT
from .flags import command
from .output import Output, can_be_saved, present


@command("tubeopt robot show configs/robots/thesis_ctr.yaml")
def show(
    robot: Annotated[str, typer.Argument(metavar=ROBOT[0], help=ROBOT[1], show_default=False)], output: Output
) -> None:
    """Stiffness, strain and fit of every tube, with warnings."""
    can_be_saved(output.out)
    present(report(load_robot(robot)), output)
