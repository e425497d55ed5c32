"""Arguments and flags that several commands share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperGroup

from ..errors import InputError, choice
from ..files.units import MM, parse_number, to_si
from ..show.plots.style import WIDTH
from ..show.report import FORMATS, PICTURE_FORMATS, SOLID_FORMATS, TABLE_FORMATS

RobotArgument = Annotated[str, typer.Argument(metavar="ROBOT.yaml", help="Robot file.", show_default=False)]

OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Save the results into this directory.", show_default=False)
]

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]

PlotOption = Annotated[
    bool, typer.Option("--plot", help="Save pictures (into DIR, or here), and open them where there is a display.")
]


FormatOption = Annotated[
    str,
    typer.Option(
        "--format", metavar="F,..", help="To save in: png, pdf or svg for pictures; parquet; stl, glb, urdf, mjcf."
    ),
]

WidthOption = Annotated[
    str | None,
    typer.Option("--width-mm", metavar="MM", help="Lay pictures out for a page: a column has some 88, a page 180."),
]

NARROWEST_MM, WIDEST_MM = 60, 400

F = TypeVar("F", bound=Callable[..., Any])


class App(typer.Typer):
    """Commands; those with `--out` have flags that say in which formats and sizes is saved."""

    def command(self, *given: Any, **options: Any) -> Callable[[F], F]:
        """Register a command, as Typer does."""
        register = super().command(*given, **options)

        def decorate(function: F) -> F:
            register(_saving(function))
            return function

        return decorate


def _saving(function: Callable[..., None]) -> Callable[..., None]:
    """A command with the flags `--format` and `--width-mm` behind its `--out`, where it has one."""
    signature = inspect.signature(function, eval_str=True)
    parts = list(signature.parameters.values())
    if "out" not in signature.parameters:
        return function

    def command(formats: str, width_mm: str | None, **typed: Any) -> None:
        with _saved_as(formats, width_mm):
            function(**typed)

    place = 1 + list(signature.parameters).index("out")
    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    parts[place:place] = [
        inspect.Parameter("formats", kind, default=PICTURE_FORMATS[0], annotation=FormatOption),
        inspect.Parameter("width_mm", kind, default=None, annotation=WidthOption),
    ]
    command.__name__, command.__doc__ = function.__name__, function.__doc__
    command.__signature__ = signature.replace(parameters=parts)  # type: ignore[attr-defined]
    command.__annotations__ = {part.name: part.annotation for part in parts}
    return command


@contextmanager
def _saved_as(formats: str, width_mm: str | None) -> Iterator[None]:
    """Let reports write in these formats, and pictures be so wide."""
    wanted = tuple(part.strip().lower() for part in formats.split(","))
    for form in wanted:
        choice("--format", form, (*PICTURE_FORMATS, *TABLE_FORMATS, *SOLID_FORMATS))
    number = None if width_mm is None else parse_number(width_mm)
    if isinstance(number, str) or (number is not None and not NARROWEST_MM <= number <= WIDEST_MM):
        raise InputError(f"--width-mm is {width_mm}; it must be a number from {NARROWEST_MM} to {WIDEST_MM}")
    format_token, width_token = FORMATS.set(wanted), WIDTH.set(None if number is None else to_si(number, MM))
    try:
        yield
    finally:
        FORMATS.reset(format_token)
        WIDTH.reset(width_token)


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
