"""Commands whose flags are the keys of a study.

    @asks(SnapStudy)
    def snap(study: SnapStudy, out: OutOption = None, as_json: JsonOption = False) -> None:
        \"\"\"The first snap on the straight way from one set of joint values to another.\"\"\"

makes of `snap` a command with a flag for every key of the study: its name from the key, its help from the description,
its default and what it is read as from the field. What the function takes besides the study stays as it is; where it
takes a key too, it gets that as it was typed.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import typer
from pydantic import PlainValidator
from pydantic.fields import FieldInfo

from ..files.checked import check
from ..files.units import parse_number, plainest, unit_of
from ..runs.base import Study
from ..show.progress import working
from ..show.report import can_be_saved
from .options import numbers

S = TypeVar("S", bound=Study)

ROBOT = ("ROBOT.yaml", "Robot file.")
"""Metavar and help of the robot as an argument."""

NONE = "none"
"""Empties a list."""


def asks(
    study: type[S],
    *,
    arguments: Mapping[str, tuple[str, str]] | None = None,
    flags: Mapping[str, str] | None = None,
    defaults: Mapping[str, str] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a command of a function that takes a study.

    Args:
        arguments: keys that are arguments, in order -> (metavar, help); by default the robot's file.
        flags: keys whose flag is not their name -> the flag, or several with "/" or "," between.
        defaults: keys whose default on the command line is not that of a study, as they would be typed.
    """
    placed = {"robot": ROBOT} if arguments is None else arguments

    def command_of(function: Callable[..., None]) -> Callable[..., None]:
        fields = {key: field for key, field in study.model_fields.items() if key != "kind"}
        called = {key: (flags or {}).get(key, f"--{key.replace('_', '-')}") for key in fields}
        keyed = [_argument(key, *placed[key]) for key in placed]
        keyed += [
            _option(key, field, called[key], (defaults or {}).get(key))
            for key, field in fields.items()
            if key not in placed
        ]
        taken = inspect.signature(function, eval_str=True).parameters
        own = [part for name, part in taken.items() if name != "study" and name not in fields]
        kind = get_args(study.model_fields["kind"].annotation)[0]
        # What is said of a file begins with its name; of all else, with the flag.
        names = {key: "" if key in placed or _is_file(fields[key]) else called[key].split(",")[0] for key in fields}
        names |= {key: name.split("/")[0] for key, name in names.items()}

        def command(**typed: Any) -> None:
            read = {key: _read(field, typed[key]) for key, field in fields.items()}
            given = {key: value for key, value in read.items() if value is not None}
            question = check(study, {"kind": kind} | given, "", names=names)
            function(question, **{key: value for key, value in typed.items() if key in taken})

        command.__name__, command.__doc__ = function.__name__, function.__doc__
        signature = inspect.Signature([*keyed, *own])
        command.__signature__ = signature  # type: ignore[attr-defined]
        command.__annotations__ = {part.name: part.annotation for part in signature.parameters.values()}
        return command

    return command_of


def ask(study: Study, doing: str, out: Path | None = None) -> Any:
    """The answer to a study, with a bar while it is computed; nothing is computed that could not be saved."""
    can_be_saved(out)
    with working(doing) as progress:
        return study.run(progress)


def _argument(key: str, metavar: str, words: str) -> inspect.Parameter:
    shown = Annotated[str, typer.Argument(metavar=metavar, help=words, show_default=False)]
    return inspect.Parameter(key, inspect.Parameter.POSITIONAL_OR_KEYWORD, annotation=shown)


def _option(key: str, field: FieldInfo, flag: str, default: str | None) -> inspect.Parameter:
    words = field.description or ""
    sentence = words[:1].upper() + words[1:] + "." * (not words.endswith("."))
    kind = _plain(field.annotation)
    if kind is bool:
        flag = f"{flag}/--no-{flag.removeprefix('--')}" if field.default else flag
        option: Any = typer.Option(flag, help=sentence)
        return inspect.Parameter(
            key, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=field.default, annotation=Annotated[bool, option]
        )
    shown = default if default is not None else _typed(field.get_default(call_default_factory=True))
    option = typer.Option(*flag.split(","), metavar=_metavar(key, field), help=sentence)
    annotation: Any = Annotated[str, option] if shown is not None else Annotated[str | None, option]
    return inspect.Parameter(key, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=shown, annotation=annotation)


def _typed(default: Any) -> str | None:
    """A default as it would be typed; None where there is nothing to be typed."""
    if default is None or default == []:
        return None
    if isinstance(default, list):
        return ",".join(_typed(each) or "" for each in default)
    if isinstance(default, Decimal):
        return str(plainest(default)) if default == int(default) else str(default).lower()
    return str(default)


def _read(field: FieldInfo, typed: Any) -> Any:
    """What was typed, as the study's model takes it; what is no number stays text, for the check to complain of."""
    if typed is None or isinstance(typed, bool):
        return typed
    kind = _plain(field.annotation)
    if _is_file(field):
        return typed
    if get_origin(kind) is list:
        if typed in (NONE, ""):
            return []
        if _plain(get_args(kind)[0]) in (Decimal, int):
            return numbers(typed)
        return [part.strip() for part in typed.split(",") if part.strip()]
    return parse_number(typed) if kind in (Decimal, int) else typed


def _metavar(key: str, field: FieldInfo) -> str:
    """What stands for a value in the help."""
    if field.examples:
        return str(field.examples[0])
    kind = _plain(field.annotation)
    if get_origin(kind) is list:
        return "A,B,.."
    if kind is int:
        return "N"
    if kind is Decimal:
        return unit_of(key).upper() or "X"
    return "FILE" if _is_file(field) else "WORD"


def _plain(annotation: Any) -> Any:
    """A type without its metadata, and without None."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        kinds = [part for part in get_args(annotation) if part is not types.NoneType]
        return _plain(kinds[0])
    return annotation


def _is_file(field: FieldInfo) -> bool:
    """Whether a key is the path of a file."""
    return any(isinstance(mark, PlainValidator) for mark in (*field.metadata, *_marks(field.annotation)))


def _marks(annotation: Any) -> Iterator[Any]:
    if get_origin(annotation) is Annotated:
        yield from get_args(annotation)[1:]
    if get_origin(annotation) in (Union, types.UnionType, Annotated):
        for part in get_args(annotation):
            yield from _marks(part)
