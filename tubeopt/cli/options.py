"""Arguments and flags that several commands share."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Annotated

import typer

from ..files.units import parse_number

RobotArgument = Annotated[str, typer.Argument(metavar="ROBOT.yaml", help="Robot file.", show_default=False)]

RotationsOption = Annotated[
    str | None, typer.Option(metavar="A,B,..", help="Rotation of every tube, inner to outer; by default all 0.")
]

TranslationsOption = Annotated[
    str | None, typer.Option(metavar="A,B,..", help="Translation of every tube, inner to outer; by default home.")
]

OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]

PlotOption = Annotated[
    bool, typer.Option("--plot", help="Save pictures (into DIR, or here), and open them where there is a display.")
]


def numbers(text: str | None) -> list[Decimal | str] | None:
    """The numbers in text such as "0,1.5,-3"; what is no number stays text, for the check to complain of."""
    return None if text is None else [parse_number(part) for part in text.split(",")]
