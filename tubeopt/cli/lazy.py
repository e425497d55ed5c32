"""Commands that are imported when they are run: the help of all of them waits for none."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command


class LazyCommand(TyperCommand):
    """A command whose function is imported when it is run.

    Args:
        name: what is typed.
        where: module of this package and function, as "stability.snap".
    """

    def __init__(self, name: str, where: str) -> None:
        super().__init__(name, help=_documented(*where.split(".")))
        self.where = where

    @functools.cached_property
    def command(self) -> Any:
        """The command itself."""
        module, function = self.where.split(".")
        found = getattr(importlib.import_module(f".{module}", __package__), function)
        app = typer.Typer(add_completion=False)
        app.command(self.name, epilog=found.epilog)(found)
        return get_command(app)

    def make_context(self, *arguments: Any, **options: Any) -> Any:
        """The context of the command itself, which thereby is what is run."""
        return self.command.make_context(*arguments, **options)


def _documented(module: str, function: str) -> str:
    """The docstring of a function, read from its file without running it."""
    tree = ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"))
    (node,) = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function)
    return inspect.cleandoc(ast.get_docstring(node) or "")


class PlanByDefault(TyperGroup):
    """A group whose command `plan` need not be typed: `tubeopt mold ROBOT.yaml` is `tubeopt mold plan ROBOT.yaml`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put `plan` in front of arguments that name no command."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = ["plan", *args]
        rest: list[str] = super().parse_args(ctx, args)
        return rest
