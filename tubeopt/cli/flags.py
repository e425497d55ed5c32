"""Commands with the keys of a study as their flags.

    @study_command(SnapStudy, example="tubeopt snap thesis_ctr --to-deg 360,0,0 --out results")
    def snap(study: SnapStudy, output: Output) -> None:
        \"\"\"The first snap on the straight path from one set of joint values to another.\"\"\"
        answer(study, output)

makes `snap` a command with a flag for every key of the study. Name, help, default and type of a flag follow from the
key. `output` has the flags that all commands share. Other parameters of the function become flags too; a parameter
named like a key receives its text.
"""

from __future__ import annotations

import functools
import inspect
import re
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import typer
from pydantic import PlainValidator
from pydantic.fields import FieldInfo

from ..errors import InputError, SolveError
from ..files.checked import Entry, check, check_kind, metadata_in
from ..files.shipped import ENDINGS, FOLDER, find_file, resolve_file, shipped
from ..files.units import parse_number, simplest, unit_of
from ..files.yaml_file import load_yaml, read_flow
from ..robots.robot import fit_warnings
from ..runs.study_file import STUDY_KINDS, Study
from ..show.progress import working
from ..show.reports import report
from .commands import COMMANDS, ROBOT, StudyCommand, flowing
from .interruption import reporting_saved
from .messages import LOGGER, naming_flags
from .output import OF_PICTURES, Output, can_be_saved, check_formats, present

S = TypeVar("S", bound=Entry)
F = TypeVar("F", bound=Study)
Command = Callable[..., None]

NONE = "none"
"""Value of a flag for an empty list."""


def command(example: str, *, note: str = "", without: Sequence[str] = ()) -> Callable[[Command], Command]:
    """Decorate a function with a parameter `output` as a command.

    Args:
        example: example at the end of the help.
        note: sentence before the example.
        without: fields of `Output` for which the command has no flags.
    """

    def _of(function: Command) -> Command:
        # Annotations are strings here; Typer needs the types.
        parameters = inspect.signature(function, eval_str=True).parameters
        flags = [part for name, part in parameters.items() if name != "output"]
        return _command(function, flags, example, note, without)

    return _of


def _command(
    function: Command, parameters: Sequence[inspect.Parameter], example: str, note: str, without: Sequence[str] = ()
) -> Command:
    """Function for Typer with the parameters `parameters` and the flags of all commands, passed on as one `Output`."""
    shared = [
        part.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for part in inspect.signature(Output, eval_str=True).parameters.values()
        if part.name not in without
    ]

    def _run(**typed: Any) -> None:
        output = Output(**{part.name: typed.pop(part.name) for part in shared})
        function(**typed, output=output)

    signature = inspect.Signature([*parameters, *shared])
    _run.__name__, _run.__doc__ = function.__name__, flowing(function.__doc__ or "")
    _run.__signature__ = signature  # type: ignore[attr-defined]
    _run.__annotations__ = {part.name: part.annotation for part in signature.parameters.values()}
    _run.epilog = f"{note}\n\nExample: {example}" if note else f"Example: {example}"  # type: ignore[attr-defined]
    return _run


def build_command(row: StudyCommand) -> Command:
    """Build the command of a row of `COMMANDS`."""
    study = STUDY_KINDS[row.kind]

    def _answer(study: Study, output: Output) -> None:
        answer(study, output)

    _answer.__doc__ = row.help
    if row.from_file:
        return study_file_command(study, example=row.example, note=study.assuming)(_answer)
    return study_command(
        study,
        example=row.example,
        note=study.assuming,
        arguments=row.arguments,
        flags=row.flags,
        defaults=row.defaults,
        without=() if row.pictures else OF_PICTURES,
    )(_answer)


def study_command(
    study: type[S],
    *,
    example: str,
    note: str = "",
    arguments: Mapping[str, tuple[str, str]] | None = None,
    flags: Mapping[str, str] | None = None,
    defaults: Mapping[str, str] | None = None,
    usual: Mapping[str, Any] | None = None,
    without: Sequence[str] = (),
) -> Callable[[Callable[..., None]], Command]:
    """Decorate a function of a study as a command. Keys that are mappings, or lists of them, have no flag.

    Args:
        example, note, without: as for `command`.
        arguments, flags, defaults: as for `StudyCommand`.
        usual: defaults of keys that are set later than by the fields, shown in the help.
    """
    positional = {"robot": ROBOT} if arguments is None else arguments
    keys = _Keys(study, tuple(positional), flags or {})
    flag_of = {key: _first(flag) for key, flag in keys.flags.items() if key not in positional}
    required = {key for key, field in keys.fields.items() if field.is_required()}
    keyed = [_argument(key, *positional[key], required=key in required) for key in positional]
    for key in flag_of:
        default = (defaults or {}).get(key, _default_text(keys.fields[key]))
        shown = as_typed((usual or {}).get(key)) or ""
        keyed.append(_option(key, keys.fields[key], keys.flags[key], default, shown=shown, required=key in required))
    default_of = {part.name: part.default for part in keyed}
    constant = {"kind": _kind_of(study)} if "kind" in study.model_fields else {}

    @contextmanager
    def _study(typed: Mapping[str, Any]) -> Iterator[S]:
        values = keys.values(typed)
        missing = {key: flag for key, flag in flag_of.items() if key in required and key not in values}
        # The message of the check has the flag; its description is added here.
        hints = {f"{flag} is missing": f": {_description(keys.fields[key])}" for key, flag in missing.items()}
        # Defaults are left out: a message about them would name a flag that was not typed.
        with naming_flags({key: keys.names[key] for key in values if typed[key] != default_of[key]}, flag_of):
            try:
                checked = check(study, constant | values, "", names=keys.names_of(values) | missing)
            except InputError as error:
                raise InputError("\n".join(line + hints.get(line, "") for line in str(error).splitlines())) from None
            yield checked

    return functools.partial(_with_study, keyed=keyed, study_of=_study, example=example, note=note, without=without)


def study_file_command(study: type[F], *, example: str, note: str = "") -> Callable[[Callable[..., None]], Command]:
    """Decorate a function of a study as a command that reads the study from a file; flags override its keys.

    Keys that are mappings, or lists of them, have no flag.
    """
    kind, keys = _kind_of(study), _Keys(study)
    keyed = [
        _argument(
            "study",
            "STUDY.yaml",
            f"Study of kind {kind}; `tubeopt init study --kind {kind}` writes one. Flags replace its keys.",
            required=True,
        )
    ]
    for key, field in keys.fields.items():
        default = _default_text(field)
        text = {True: "yes", False: "no"}[default] if isinstance(default, bool) else default
        shown = "" if default in (None, "") else f"key of the study, else {text}"
        keyed.append(_option(key, field, keys.flags[key], None, shown=shown))

    @contextmanager
    def _study(typed: Mapping[str, Any]) -> Iterator[F]:
        path = find_file(typed["study"], "studies")
        values = {
            # Files on the command line are relative to the working directory, not to the study.
            key: str(resolve_file(value).absolute()) if isinstance(value, str) and _is_file(keys.fields[key]) else value
            for key, value in keys.values(typed).items()
        }
        # A goal on the command line replaces any other goal of the file, or the study would have two.
        typed_sets = [goal for goal in study.either if not goal.isdisjoint(values)]
        replaced = frozenset().union(*(goal for goal in study.either if typed_sets and goal not in typed_sets))
        in_file = {key: value for key, value in load_yaml(path).items() if key not in replaced}
        names = keys.names_of(values)
        flags = {key: names[key] for key in values}
        with naming_flags(flags, {key: flag for key, flag in flags.items() if flag}):
            yield check_kind({kind: study}, {**in_file, **values}, path, names=flags)

    return functools.partial(_with_study, keyed=keyed, study_of=_study, example=example, note=note)


def _with_study(
    function: Callable[..., None],
    *,
    keyed: Sequence[inspect.Parameter],
    study_of: Callable[[Mapping[str, Any]], AbstractContextManager[Entry]],
    example: str,
    note: str,
    without: Sequence[str] = (),
) -> Command:
    """Command of a function of a study, which `study_of` builds from the texts of the parameters `keyed`."""
    _, *parts = inspect.signature(function, eval_str=True).parameters.values()  # the first is the study
    names = {part.name for part in parts}
    unkeyed = [part for part in parts if part.name not in ("output", *(part.name for part in keyed))]

    def _run(output: Output, **typed: Any) -> None:
        with study_of(typed) as study:
            function(study, output=output, **{key: value for key, value in typed.items() if key in names})

    _run.__name__, _run.__doc__ = function.__name__, function.__doc__
    return _command(_run, [*keyed, *unkeyed], example, note, without)


def answer(study: Study, output: Output) -> None:
    """Run a study, and show and save its answer."""
    present(report(ask(study, output)), output)


def ask(study: Study, output: Output) -> Any:
    """Run a study with a progress bar, after checks that its answer can be saved."""
    # An optimisation takes minutes: a directory that cannot be written is reported before.
    can_be_saved(output.out)
    command_of = {row.kind: command_name for command_name, row in COMMANDS.items() if isinstance(row, StudyCommand)}
    check_formats(output, command_of.get(study.kind, study.kind.replace("_", " ")))
    # Studies of rigs and molds have no robot.
    robot = getattr(study, "robot", None)
    for warning in fit_warnings(robot) if robot is not None else ():
        LOGGER.warning(warning)
    saved = study.keeps.format(out=output.out) if study.keeps and output.out else "nothing was saved"
    LOGGER.debug(f"{study.doing}: {study!r:.200}")
    with working(study.doing, shown=not output.quiet) as progress, reporting_saved(saved):
        try:
            return study.ask(output.out, progress)
        except SolveError as error:
            raise _with_partial_result(error, output.out) from None


def has_pictures(kind: str) -> bool:
    """True if the answer to studies of a kind has plots."""
    return all(row.pictures for row in COMMANDS.values() if isinstance(row, StudyCommand) and row.kind == kind)


def _with_partial_result(error: SolveError, out: Path | None) -> SolveError:
    """Save the best solution of an error in the directory `partial`, and add its path to the message."""
    if out is None or error.solution is None:
        return error
    try:
        # A solution without a report, such as plain arrays, is not saved.
        partial = report(error.solution)
    except TypeError:
        return error
    saved = partial.save(out / "partial")
    return SolveError(f"{error}; partial result: {saved[0].parent}", error.solution) if saved else error


def _kind_of(study: type[Entry]) -> str:
    (kind,) = get_args(study.model_fields["kind"].annotation)
    return str(kind)


class _Keys:
    """Keys of a study on the command line: their fields, flags and names in messages.

    The name is the flag, or "" for arguments and files, since messages about these begin with the name of the file.
    """

    def __init__(
        self, study: type[Entry], positional: Sequence[str] = (), flags: Mapping[str, str] | None = None
    ) -> None:
        self.positional = positional
        self.fields: dict[str, FieldInfo] = {}
        for key, field in study.model_fields.items():
            # A number, a word, a file, or a list of numbers or words.
            kind = _plain(field.annotation)
            inner = _plain(get_args(kind)[0]) if get_origin(kind) is list else kind
            simple = inner in (bool, int, Decimal, str) or get_origin(inner) is Literal
            if key != "kind" and (simple or _is_file(field)):
                self.fields[key] = field
        self.flags = {key: (flags or {}).get(key, f"--{key.replace('_', '-')}") for key in self.fields}
        self.names = {
            key: "" if key in positional or _is_file(field) else _first(self.flags[key])
            for key, field in self.fields.items()
        }

    def names_of(self, values: Mapping[str, Any]) -> dict[str, str]:
        """Name of each key in error messages: the flag for values given inline, otherwise the name in the file."""
        inline = {
            key: _first(self.flags[key])
            for key, value in values.items()
            if key not in self.positional and not isinstance(value, str)
        }
        return self.names | inline

    def values(self, typed: Mapping[str, Any]) -> dict[str, Any]:
        """Convert the texts of flags to data of the study's model."""
        read = {key: _read(field, typed[key]) for key, field in self.fields.items()}
        return {key: value for key, value in read.items() if value is not None}


def read_typed(model: type[Entry], typed: Mapping[str, str]) -> dict[str, Any]:
    """Convert the texts of some keys to data of their model."""
    return {key: _read(model.model_fields[key], text) for key, text in typed.items()}


def _first(flags: str) -> str:
    """First flag of a key, if it has several."""
    return re.split("[,/]", flags)[0]


def numbers(text: str) -> list[Decimal | str]:
    """Split text such as "0,1.5,-3" into numbers; other parts remain text, which the check reports."""
    return [parse_number(part) for part in text.split(",")]


def _parameter(key: str, kind: Any, option: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(
        key, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=Annotated[kind, option]
    )


def _argument(key: str, metavar: str, description: str, *, required: bool) -> inspect.Parameter:
    option = typer.Argument(metavar=metavar, help=description, show_default=False, autocompletion=files(key))
    if metavar.endswith("..."):  # as many as there are
        return _parameter(key, list[str], option)
    return _parameter(key, str, option) if required else _parameter(key, str | None, option, None)


def _option(
    key: str, field: FieldInfo, flag: str, default: str | bool | None, *, shown: str = "", required: bool = False
) -> inspect.Parameter:
    """Parameter of a flag; `shown` is the default in its help, if it differs from `default`."""
    kind: Any = bool if _plain(field.annotation) is bool else str
    if kind is bool and default is not False:
        flag = f"{flag}/--no-{flag.removeprefix('--')}"
    description = _description(field)
    description = description[:1].upper() + description[1:]
    if description and not description.endswith("."):
        description += "."
    choices = _choices(field)
    option = typer.Option(
        *flag.split(","),
        metavar=None if kind is bool else _metavar(key, field),
        help=description + " Required." * required,
        show_default=shown or default is not None,
        autocompletion=files(key) if _is_file(field) else completion(choices) if choices else None,
    )
    return _parameter(key, kind | None if default is None else kind, option, default)


def _choices(field: FieldInfo) -> tuple[str, ...]:
    """Allowed words of a key; () if any text is allowed."""
    kind = _plain(field.annotation)
    return get_args(kind) if get_origin(kind) is Literal else ()


def _default_text(field: FieldInfo) -> str | bool | None:
    """Default of a key as text of its flag; None without a default."""
    default = None if field.is_required() else field.get_default(call_default_factory=True)
    return default if isinstance(default, bool) else as_typed(default)


def _description(field: FieldInfo) -> str:
    """Description of a key on the command line, where files are relative to the working directory."""
    return (field.description or "").replace(", relative to this file", "")


def as_typed(default: Any) -> str | None:
    """Default as text of a flag; None for an empty default."""
    if default is None or default in ([], ()):
        return None
    if isinstance(default, list):
        return ",".join(as_typed(each) or "" for each in default)
    if isinstance(default, Decimal):
        return str(simplest(default)) if default == int(default) else str(default).lower()
    return str(default)


def _read(field: FieldInfo, typed: Any) -> Any:
    """Convert the text of a flag to data of the study's model; text that is no number remains, for the check."""
    if typed is None or isinstance(typed, bool):
        return typed
    if isinstance(typed, list | tuple):
        return list(typed)
    kind = _plain(field.annotation)
    if _is_file(field):
        # A mapping or list may replace a file, as `--load "{tip_force_mN: [10, 0, 0]}"`.
        return read_flow(typed) if typed.startswith(("{", "[")) else typed
    if get_origin(kind) is list:
        if typed in (NONE, ""):
            return []
        if _plain(get_args(kind)[0]) in (Decimal, int):
            return numbers(typed)
        return [part.strip() for part in typed.split(",") if part.strip()]
    return parse_number(typed) if kind in (Decimal, int) else typed


def _metavar(key: str, field: FieldInfo) -> str:
    """Placeholder of a value in the help."""
    if field.examples:
        return str(field.examples[0])
    kind = _plain(field.annotation)
    if get_origin(kind) is list:
        return "A,B,.."
    if kind is int:
        return "N"
    if kind is Decimal:
        return unit_of(key).upper() or "X"
    if _is_file(field):
        return "FILE"
    return f"[{'|'.join(_choices(field))}]" if _choices(field) else "WORD"


def _plain(annotation: Any) -> Any:
    """Type without its metadata, and without None."""
    if get_origin(annotation) is Annotated:
        return _plain(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        kinds = [part for part in get_args(annotation) if part is not types.NoneType]
        return _plain(kinds[0])
    return annotation


def _is_file(field: FieldInfo) -> bool:
    """True if a key is the path of a file."""
    return any(isinstance(mark, PlainValidator) for mark in (*field.metadata, *metadata_in(field.annotation)))


# --- completion in the shell: words, built-in files, and existing files -----------------------------------------------

Completion = Callable[[str], list[str]]
"""Function: beginning of a value -> values with this beginning."""

MAX_COMPLETIONS = 200
"""Largest number of proposed files of a directory."""

FOLDERS = {
    "study": "studies",
    "simulate": "rigs",
    "stock": "tubes",
    "measurements": "experiments",
    "log": "experiments",
    "logs": "experiments",
}
"""Keys with built-in files in a folder of another name -> folder."""


def completion(choices: Sequence[str]) -> Completion:
    """Function that completes one of several words."""
    return lambda incomplete: [word for word in choices if word.startswith(incomplete)]


def files(key: str) -> Completion:
    """Function that completes the file of a key: names of built-in files, and paths."""
    # The folder of a key is its name or its plural: robot -> robots.
    names = [FOLDERS.get(key, ""), key, f"{key}s"]
    folder = next((name for name in names if name and (FOLDER / name).is_dir()), "*")

    def complete(incomplete: str) -> list[str]:
        return [name for name in shipped(folder) if name.startswith(incomplete)] + _existing(incomplete)

    return complete


def _existing(incomplete: str) -> list[str]:
    """Paths of directories, tables and YAML files that begin with a text."""
    parent, slash, start = incomplete.rpartition("/")
    try:
        paths = sorted(path for path in Path(parent + slash).iterdir() if path.name.startswith(start))
    except OSError:
        return []
    return [
        f"{parent}{slash}{path.name}{'/' * path.is_dir()}"
        for path in paths[:MAX_COMPLETIONS]
        if (path.is_dir() or path.suffix in ENDINGS) and (start or not path.name.startswith("."))
    ]
