"""`tubeopt init`: a robot, a rig or a study to begin with, written after a few questions, or from flags without any."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from ..errors import InputError
from ..files.checked import check
from ..files.files import write_text
from ..files.units import unit_of
from ..files.yaml_file import read_flow
from ..runs.templates import NewRig, NewRobot, NewStudy, Written
from ..show.reports import report
from .flags import as_typed, asks, read_typed
from .messages import BAD_INPUT, complain
from .output import OF_PICTURES, Output, present

New = TypeVar("New", NewRobot, NewRig, NewStudy)

WITHOUT = ("out", *OF_PICTURES)
"""Fields of an output that these commands do not have: the file is an argument."""

File = Annotated[Path | None, typer.Argument(metavar="FILE", help="File to write.", show_default=False)]
Force = Annotated[bool, typer.Option("--force", help="Replace a file that is there.")]


@asks(
    NewRobot,
    arguments={},
    flags={"robot_kind": "--kind"},
    example="tubeopt init robot mine.yaml --outer-diameter-mm 1,1.4 --inner-diameter-mm 0.8,1.1",
    without=WITHOUT,
)
def robot(study: NewRobot, output: Output, file: File = None, force: Force = False) -> None:
    """Write a robot file to begin with, by default robot.yaml.

    In a terminal it asks for the tubes. With any flag it asks nothing, and uses defaults for the rest. Every key has a
    comment; optional keys are commented out.
    """
    path = _free(file or Path("robot.yaml"), force)
    _write(path, _answered(study, NewRobot, lambda new: new.text(path)), f"fk {path}", output)


@asks(
    NewRig,
    arguments={},
    example="tubeopt init rig mine.yaml --mold steel --outer-diameter-mm 1.5 --inner-diameter-mm 1.2",
    without=WITHOUT,
)
def rig(study: NewRig, output: Output, file: File = None, force: Force = False) -> None:
    """Write a rig file to begin with, by default rig.yaml.

    In a terminal it asks for battery, mold and tube. With any flag it asks nothing, and uses defaults for the rest.
    Every key has a comment; optional keys are commented out.
    """
    path = _free(file or Path("rig.yaml"), force)
    _write(
        path, _answered(study, NewRig, lambda new: new.text(path)), f"heat plan {path} --sensor thermocouple", output
    )


@asks(
    NewStudy,
    arguments={},
    flags={"study_kind": "--kind"},
    example="tubeopt init study mine.yaml --kind snap --robot thesis_ctr --set to_deg=[360,0,0]",
    without=WITHOUT,
)
def study(
    study: NewStudy,
    output: Output,
    file: File = None,
    keys: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A further key; may be given again.", show_default=False),
    ] = None,
    force: Force = False,
) -> None:
    """Write a study file to begin with, by default study.yaml, for `tubeopt run`, or `tubeopt sweep` for kind sweep.

    In a terminal it asks for kind and robot. With any flag it asks nothing, and uses defaults for the rest. Every key
    has a comment; optional keys are commented out.
    """
    path = _free(file or Path("study.yaml"), force)
    given = dict(_pair(text) for text in keys or ())
    try:
        written = _answered(study, NewStudy, lambda new: new.text(path, given), asks_nothing=bool(given))
    except InputError as error:
        hint = r"\1 is missing; --set \1=VALUE gives it"
        raise InputError(re.sub(r"^.*: (\w+) is missing$", hint, str(error), flags=re.MULTILINE)) from None
    _write(path, written, f"{'sweep' if read_flow(written)['kind'] == 'sweep' else 'run'} {path}", output)


def _pair(text: str) -> tuple[str, Any]:
    """Key and value of "key=value"."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set is {text!r}; it must be KEY=VALUE, as to_deg=[360,0,0]")
    return key.strip(), read_flow(value)


def _free(path: Path, force: bool) -> Path:
    """The path, where a file may be written; raises InputError where one is there that is not to be replaced."""
    if path.is_dir():
        raise InputError(f"{path}: this is a directory; it must be a file")
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{path}: the name of the file must end in .yaml")
    if path.exists() and not force:
        raise InputError(f"{path}: the file is there already; --force replaces it")
    return path


def _answered(given: New, kind: type[New], text: Callable[[New], str], *, asks_nothing: bool = False) -> str:
    """The text made of flags; where none is given and there is a terminal, of answers to questions.

    An answer that is refused is asked for again; where all together are refused, all are, each with what was typed as
    the usual one.
    """
    # A script has no terminal: it must not wait for answers.
    if given.model_fields_set or asks_nothing or not sys.stdin.isatty():
        return text(given)
    typed: dict[str, str] = {}
    while True:
        for key in kind.asked:
            usual = check(kind, read_typed(kind, typed), "").usual[key]
            if usual is None:
                continue
            typed[key] = _answer(kind, key, typed, typed.get(key) or as_typed(usual) or "")
        try:
            return text(check(kind, read_typed(kind, typed), ""))
        except InputError as error:
            complain(str(error), BAD_INPUT, "input", as_json=False)


def _answer(kind: type[New], key: str, typed: dict[str, str], usual: str) -> str:
    words, unit = kind.model_fields[key].description or key, unit_of(key)
    asked = words[:1].upper() + words[1:] + f", {unit}" * bool(unit)
    while True:
        try:
            answer = str(typer.prompt(asked, default=usual, err=True)).strip()
        except typer.Abort:  # Ctrl-C, or the end of what is typed
            raise KeyboardInterrupt from None
        try:
            check(kind, read_typed(kind, {**typed, key: answer}), "")
        except InputError as error:
            complain(str(error), BAD_INPUT, "input", as_json=False)
        else:
            return answer


def _write(path: Path, text: str, then: str, output: Output) -> None:
    write_text(path, text)
    present(report(Written(f"tubeopt {then}")), output, written=[path])
