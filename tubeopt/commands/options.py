"""Arguments and flags that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RobotArgument = Annotated[str, typer.Argument(metavar="ROBOT.yaml", help="Robot file.", show_default=False)]

OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]

PlotOption = Annotated[
    bool, typer.Option("--plot", help="Save pictures (into DIR, or here), and open them where there is a display.")
]
