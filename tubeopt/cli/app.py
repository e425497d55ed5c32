"""The command line `tubeopt`: commands gathered, failures turned into a sentence and an exit code, in one place.

Commands are imported when they are run: the help of all of them waits for none.

Exit codes: 0 done, 2 the input makes no sense, 3 no solution was found, 4 a motion was found but not proved in time,
130 interrupted. `certify` ends with 0 if the robot cannot snap, 3 if it can, and 4 if neither is known.
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
from .commands import COMMANDS, Asked, flowing
from .interruption import awake, interrupted, interruptible, kept, stop_workers
from .messages import INTERRUPTED, LEVELS, complain, failure, listening, log_level


class LazyCommand(TyperCommand):
    """A command whose function is made, or imported, when it is run.

    Args:
        name: what is typed.
        what: what it asks, or module of this package and function, as "export.export".
        panel: heading in the help of all commands.
    """

    def __init__(self, name: str, what: Asked | str, panel: str | None = None) -> None:
        words = flowing(what.help) if isinstance(what, Asked) else _documented(*what.split("."))
        super().__init__(name, help=words, rich_help_panel=panel)
        self.what = what

    @functools.cached_property
    def command(self) -> Any:
        """The command itself."""
        if isinstance(self.what, Asked):
            from .flags import asking

            found: Any = asking(self.what)
        else:
            module, function = self.what.split(".")
            found = getattr(importlib.import_module(f".{module}", __package__), function)
        app = typer.Typer(add_completion=False)
        app.command(self.name, epilog=found.epilog)(found)
        return get_command(app)

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """The context of the command itself, which thereby is what is run."""
        # Click runs the command of the context, so that the real one takes over from here.
        return self.command.make_context(*arguments, **options)


def _documented(module: str, function: str) -> str:
    """The docstring of a function, read from its file without running it."""
    # Importing the module for one sentence would load Matplotlib or SciPy for the help of all commands.
    tree = ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"))
    (node,) = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function)
    return flowing(ast.get_docstring(node) or "")


class PlanByDefault(TyperGroup):
    """A group whose command `plan` need not be typed: `tubeopt mold ROBOT.yaml` is `tubeopt mold plan ROBOT.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `plan` in front of arguments that name no command."""
        # A file named like a command would need `plan` in front of it.
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["plan", *args]
        rest: list[str] = super().parse_args(ctx, args)
        return rest


GROUPS: dict[str, tuple[type[TyperGroup], str]] = {
    "init": (TyperGroup, "Write a robot, rig or study file to begin with."),
    "heat": (PlanByDefault, "Plan, control, run and calibrate the heating that sets the shape of tubes."),
    "mold": (PlanByDefault, "Design and calibrate molds that set the shape of tubes."),
    "robot": (TyperGroup, "Inspect a robot file, or list the built-in robots."),
}
"""Words that several commands begin with, and what their help says."""


PANELS = {
    "Ask": "fk ik equilibria snap follow load-limit force certify stability-map workspace view",
    "Design": "design design-pair",
    "Plan": "plan plan-arms verify",
    "Build": "mold heat fabricate",
    "Measure": "validate measure",
    "Real time": "export serve",
    "Files": "init list robot run figure sweep doctor",
}
"""Headings of the help -> the commands below them."""


def _panel(word: str) -> str:
    """Heading of a command, or of a group, in the help."""
    return next(heading for heading, commands in PANELS.items() if word in commands.split())


def _print_version(wanted: bool) -> None:
    if wanted:
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
    """The command `tubeopt` with all that are under it."""
    root = typer.Typer(
        help="Kinematics, stability, planning, design and fabrication of concentric tube robots.", no_args_is_help=True
    )
    root.callback()(_options)
    group: Any = get_command(root)
    for words, what in COMMANDS.items():
        *above, name = words.split()
        place = group
        for word in above:
            kind, help_text = GROUPS[word]
            if word not in place.commands:
                place.add_command(kind(name=word, help=help_text, no_args_is_help=True, rich_help_panel=_panel(word)))
            place = place.commands[word]
        place.add_command(LazyCommand(name, what, None if above else _panel(name)))
    return group  # type: ignore[no-any-return]


def _code(typed: Sequence[str], heard: Sequence[int]) -> object:
    """What a command ends with: its exit code, where it is not 0."""
    try:
        with awake():
            # Ctrl-C came while Python imported: nothing was started yet.
            if heard:
                raise KeyboardInterrupt
            return program()(typed, prog_name="tubeopt", standalone_mode=False)
    except BaseException as error:  # whatever a command raises that a signal ended; all else goes on
        if isinstance(error, KeyboardInterrupt) or interrupted():
            return INTERRUPTED
        raise


def main(arguments: Sequence[str] | None = None, heard: Sequence[int] = ()) -> NoReturn:
    """Run one command; `arguments` default to those of the process. Ends with SystemExit.

    With signals that were `heard` before, it ends as one that is interrupted.
    """
    typed = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in typed
    # Warnings may come before the flags are parsed, so that these two are searched in the text.
    with listening(quiet=as_json or "--quiet" in typed), interruptible(as_json) as telling:
        try:
            code = _code(typed, heard)
            if code == INTERRUPTED:
                # The watcher has the lock if it already reports: then this waits until it ends the process.
                telling.acquire()
                stop_workers()
                complain(f"interrupted; {kept()}", INTERRUPTED, "interrupted", as_json)
        except Exception as error:  # the errors of Typer have no public base; what `failure` does not know goes on
            told = failure(error)
            if told is None:
                raise
            code = complain(*told, as_json)
    sys.exit(code if isinstance(code, int) else 0)
