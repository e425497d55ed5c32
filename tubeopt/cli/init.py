"""`tubeopt init`: template files of robots, rigs and studies, from prompts or flags."""

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
from ..runs.templates import NewRig, NewRobot, NewStudy, WrittenFile
from ..show.reports import report
from .flags import as_typed, read_typed, study_command
from .messages import BAD_INPUT, print_error
from .output import OF_PICTURES, Output, present

New = TypeVar("New", NewRobot, NewRig, NewStudy)

WITHOUT = ("out", *OF_PICTURES)
"""Fields of an output without a flag: the file is an argument."""

File = Annotated[Path | None, typer.Argument(metavar="FILE", help="File to write.", show_default=False)]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]


@study_command(
    NewRobot,
    arguments={},
    flags={"robot_kind": "--kind"},
    usual=check(NewRobot, {}, "").usual,
    example="tubeopt init robot mine.yaml --outer-diameter-mm 1,1.4 --inner-diameter-mm 0.8,1.1",
    without=WITHOUT,
)
def robot(study: NewRobot, output: Output, file: File = None, force: Force = False) -> None:
    """Write a template of a robot file, by default robot.yaml.

    Without flags, it prompts for the tubes if it runs in a terminal. With any flag, missing values have defaults. The
    tubes of an eccentric robot are equal: give one number for each dimension. Its default is the tube of the thesis.
    Every key has a comment; optional keys are commented out.
    """
    path = _free(file or Path("robot.yaml"), force)
    _write(path, _from_flags_or_prompts(study, NewRobot, lambda new: new.text(path)), f"fk {path}", output)


@study_command(
    NewRig,
    arguments={},
    usual=check(NewRig, {}, "").usual,
    example="tubeopt init rig mine.yaml --mold steel --outer-diameter-mm 1.5 --inner-diameter-mm 1.2",
    without=WITHOUT,
)
def rig(study: NewRig, output: Output, file: File = None, force: Force = False) -> None:
    """Write a template of a rig file, by default rig.yaml.

    Without flags, it prompts for battery, mold and tube if it runs in a terminal. With any flag, missing values have
    defaults; those of the tube are from the thesis. A rig has one tube: give one number for each dimension. Every key
    has a comment; optional keys are commented out.
    """
    path = _free(file or Path("rig.yaml"), force)
    _write(
        path,
        _from_flags_or_prompts(study, NewRig, lambda new: new.text(path)),
        f"heat plan {path} --sensor thermocouple",
        output,
    )


@study_command(
    NewStudy,
    arguments={},
    flags={"study_kind": "--kind"},
    usual={"study_kind": check(NewStudy, {}, "").kind},
    example="tubeopt init study mine.yaml --kind snap --robot thesis_ctr --set to_deg=[360,0,0]",
    without=WITHOUT,
)
def study(
    study: NewStudy,
    output: Output,
    file: File = None,
    keys: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Value of any other key of the study; repeatable.", show_default=False
        ),
    ] = None,
    force: Force = False,
) -> None:
    """Write a template of a study file, by default study.yaml, for `tubeopt run` or, with kind sweep, `tubeopt sweep`.

    Without flags, it prompts for kind and robot if it runs in a terminal. With any flag, missing values have defaults.
    Every key has a comment; optional keys are commented out.
    """
    path = _free(file or Path("study.yaml"), force)
    extra = dict(_pair(text) for text in keys or ())
    try:
        written = _from_flags_or_prompts(study, NewStudy, lambda new: new.text(path, extra), prompts=not extra)
    except InputError as error:
        hint = r"\1 is missing; --set \1=VALUE gives it"
        raise InputError(re.sub(r"^.*: (\w+) is missing$", hint, str(error), flags=re.MULTILINE)) from None
    _write(path, written, f"{'sweep' if read_flow(written)['kind'] == 'sweep' else 'run'} {path}", output)


def _pair(text: str) -> tuple[str, Any]:
    """Split "key=value" into key and value."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set is {text!r}; it must be KEY=VALUE, as to_deg=[360,0,0]")
    return key.strip(), read_flow(value)


def _free(path: Path, force: bool) -> Path:
    """Path of the new file; raises InputError if it exists and `force` is false."""
    if path.is_dir():
        raise InputError(f"{path}: this is a directory; it must be a file")
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{path}: the name of the file must end in .yaml")
    if path.exists() and not force:
        raise InputError(f"{path}: the file exists; --force replaces it")
    return path


def _from_flags_or_prompts(
    from_flags: New, kind: type[New], text: Callable[[New], str], *, prompts: bool = True
) -> str:
    """Text of the file from flags; without any flag and in a terminal, from answers to prompts.

    An invalid answer is prompted for again. If the answers do not fit together, all are prompted for again, with the
    previous answers as defaults.
    """
    # A script has no terminal: it must not wait for answers.
    if from_flags.model_fields_set or not prompts or not sys.stdin.isatty():
        return text(from_flags)
    typed: dict[str, str] = {}
    while True:
        for key in kind.prompted:
            usual = check(kind, read_typed(kind, typed), "").usual[key]
            if usual is None:
                continue
            typed[key] = _answer(kind, key, typed, typed.get(key) or as_typed(usual) or "")
        try:
            return text(check(kind, read_typed(kind, typed), ""))
        except InputError as error:
            print_error(str(error), BAD_INPUT, "input", as_json=False)


def _answer(kind: type[New], key: str, typed: dict[str, str], usual: str) -> str:
    description, unit = kind.model_fields[key].description or key, unit_of(key)
    prompt = description[:1].upper() + description[1:] + f", {unit}" * bool(unit)
    while True:
        try:
            answer = str(typer.prompt(prompt, default=usual, err=True)).strip()
        except typer.Abort:  # Ctrl-C, or the end of the input
            raise KeyboardInterrupt from None
        try:
            check(kind, read_typed(kind, {**typed, key: answer}), "")
        except InputError as error:
            print_error(str(error), BAD_INPUT, "input", as_json=False)
        else:
            return answer


def _write(path: Path, text: str, then: str, output: Output) -> None:
    write_text(path, text)
    present(report(WrittenFile(f"tubeopt {then}")), output, written=[path])
