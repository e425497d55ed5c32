"""The command line `tubeopt`: all commands, with errors as sentences and exit codes.

Commands are imported when they run, so that `tubeopt --help` is fast.

Exit codes: 0 success, 2 invalid input, 3 no solution found, 4 a motion was found but not proved in time,
130 interrupted. `certify`: 0 the robot cannot snap, 3 it can, 4 undecided.
"""

from __future__ import annotations

import ast
import functools
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from .. import __version__
from .commands import COMMANDS, StudyCommand, flowing
from .interruption import awake, interrupted, interruptible, saved_message, stop_workers
from .messages import INTERRUPTED, LEVELS, failure, listening, log_level, print_error


class LazyCommand(TyperCommand):
    """Command with a function that is built or imported when it runs.

    Args:
        name: last word of the command.
        what: study command, or module of this package and function, as "export.export".
        panel: heading in the help of all commands.
    """

    def __init__(self, name: str, what: StudyCommand | str, panel: str | None = None) -> None:
        text = flowing(what.help) if isinstance(what, StudyCommand) else _docstring(*what.split("."))
        super().__init__(name, help=text, rich_help_panel=panel)
        self.what = what

    @functools.cached_property
    def command(self) -> Any:
        """Typer command with all its options."""
        if isinstance(self.what, StudyCommand):
            from .flags import build_command

            function_of_command: Any = build_command(self.what)
        else:
            module, function = self.what.split(".")
            function_of_command = getattr(importlib.import_module(f".{module}", __package__), function)
        app = typer.Typer(add_completion=False)
        app.command(self.name, epilog=function_of_command.epilog)(function_of_command)
        return get_command(app)

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """Create the context of the actual command, which Click then runs."""
        return self.command.make_context(*arguments, **options)


def _docstring(module: str, function: str) -> str:
    """Docstring of a function, read from its file without importing it."""
    # An import would load Matplotlib or SciPy for the help of all commands.
    tree = ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"))
    (node,) = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function)
    return flowing(ast.get_docstring(node) or "")


class PlanByDefault(TyperGroup):
    """Group with the default command `plan`: `tubeopt mold ROBOT.yaml` is `tubeopt mold plan ROBOT.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert `plan` before arguments that do not start with a command."""
        # A file named like a command needs an explicit `plan`.
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["plan", *args]
        remaining: list[str] = super().parse_args(ctx, args)
        return remaining


GROUPS: dict[str, tuple[type[TyperGroup], str]] = {
    "init": (TyperGroup, "Write a template of a robot, rig or study file."),
    "heat": (PlanByDefault, "Plan, control, run and calibrate the heating that sets the shape of tubes."),
    "mold": (PlanByDefault, "Design and calibrate molds that set the shape of tubes."),
    "robot": (TyperGroup, "Inspect a robot file, or list the built-in robots."),
}
"""First words of command groups -> class and help."""


PANELS = {
    "Ask": "fk ik equilibria snap follow drives fatigue load-limit force certify stability-map workspace view",
    "Design": "design design-pair",
    "Plan": "plan deploy plan-arms verify",
    "Build": "mold heat fabricate",
    "Measure": "commission validate measure",
    "Real time": "export serve",
    "Files": "init list robot run figure sweep doctor",
}
"""Headings of the help -> commands and groups below them."""


def _panel(word: str) -> str:
    """Heading of a command or group in the help."""
    return next(heading for heading, commands in PANELS.items() if word in commands.split())


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"tubeopt {__version__}")
        raise typer.Exit


def _options(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    log: Annotated[
        str,
        typer.Option(
            metavar="LEVEL", callback=log_level, help=f"Lowest level of log messages to show: {', '.join(LEVELS)}."
        ),
    ] = "warning",
) -> None:
    pass


@functools.lru_cache(maxsize=1)
def program() -> TyperGroup:
    """Command `tubeopt` with all subcommands."""
    root = typer.Typer(
        help="Kinematics, stability, planning, design and fabrication of concentric tube robots.", no_args_is_help=True
    )
    root.callback()(_options)
    group: Any = get_command(root)
    for command_name, what in COMMANDS.items():
        *groups, name = command_name.split()
        parent = group
        for word in groups:
            kind, help_text = GROUPS[word]
            if word not in parent.commands:
                parent.add_command(kind(name=word, help=help_text, no_args_is_help=True, rich_help_panel=_panel(word)))
            parent = parent.commands[word]
        parent.add_command(LazyCommand(name, what, None if groups else _panel(name)))
    return group  # type: ignore[no-any-return]


def _run(arguments: Sequence[str], signals: Sequence[int]) -> object:
    """Run a command; returns its exit code if it is not 0."""
    try:
        with awake():
            # Ctrl-C during imports: nothing was started yet.
            if signals:
                raise KeyboardInterrupt
            return program()(arguments, prog_name="tubeopt", standalone_mode=False)
    except BaseException as error:  # an interrupted command may raise anything
        if isinstance(error, KeyboardInterrupt) or interrupted():
            return INTERRUPTED
        raise


def main(arguments: Sequence[str] | None = None, signals: Sequence[int] = ()) -> NoReturn:
    """Run one command and exit; `arguments` default to those of the process.

    Args:
        signals: interruptions that were received before; with any, the command ends as interrupted.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in arguments
    # Warnings may come before the flags are parsed, so that these two are searched in the text.
    with listening(quiet=as_json or "--quiet" in arguments), interruptible(as_json) as reporting:
        try:
            code = _run(arguments, signals)
            if code == INTERRUPTED:
                # The watcher has the lock if it already reports: then this waits until it ends the process.
                reporting.acquire()
                stop_workers()
                print_error(f"interrupted; {saved_message()}", INTERRUPTED, "interrupted", as_json)
        except Exception as error:  # the errors of Typer have no public base
            known = failure(error)
            if known is None:
                raise
            code = print_error(*known, as_json)
    sys.exit(code if isinstance(code, int) else 0)
