"""Arguments and flags that several commands share."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..files.units import parse_number

RobotArgument = Annotated[str, typer.Argument(metavar="ROBOT.yaml", help="Robot file.", show_default=False)]

OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]

PlotOption = Annotated[
    bool, typer.Option("--plot", help="Save pictures (into DIR, or here), and open them where there is a display.")
]


class PlanByDefault(TyperGroup):
    """A group whose command `plan` need not be typed: `tubeopt mold ROBOT.yaml` is `tubeopt mold plan ROBOT.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `plan` in front of arguments that name no command."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["plan", *args]
        rest: list[str] = super().parse_args(ctx, args)
        return rest


def numbers(text: str | None) -> list[Decimal | str] | None:
    """The numbers in text such as "0,1.5,-3"; what is no number stays text, for the check to complain of."""
    return None if text is None else [parse_number(part) for part in text.split(",")]
