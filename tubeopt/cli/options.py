"""Arguments and flags that several commands share."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import typer

from ..files.checked import check
from ..files.units import parse_number
from ..runs.load_file import LoadEntry, load_data

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


TipForceOption = Annotated[
    str | None, typer.Option("--tip-force-mN", metavar="X,Y,Z", help="Force on the tip, in axes of the plate.")
]

TipMomentOption = Annotated[
    str | None, typer.Option("--tip-moment-mN_m", metavar="X,Y,Z", help="Moment on the tip, in axes of the plate.")
]

GravityOption = Annotated[
    str | None, typer.Option("--gravity-m_per_s2", metavar="X,Y,Z", help="Gravity, which acts on the tubes' mass.")
]

LoadOption = Annotated[
    Path | None,
    typer.Option("--load", metavar="FILE.yaml", help="Load file; flags replace what it says.", show_default=False),
]


LOAD_FLAGS = {
    "tip_force_mN": "--tip-force-mN",
    "tip_moment_mN_m": "--tip-moment-mN_m",
    "gravity_m_per_s2": "--gravity-m_per_s2",
}
"""What the keys of a load are called on the command line."""


def load_of(file: Path | None, force: str | None, moment: str | None, gravity: str | None) -> dict[str, Any] | None:
    """The key `load` of a study from a file and flags, None without any."""
    flags = {"tip_force_mN": force, "tip_moment_mN_m": moment, "gravity_m_per_s2": gravity}
    given = {key: numbers(text) for key, text in flags.items() if text is not None}
    if file is None:
        if given:
            check(LoadEntry, given, "", names=LOAD_FLAGS)
        return given or None
    return {**load_data(file), **given}
