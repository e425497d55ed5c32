"""Commands whose flags are the keys of a study.

    @asks(SnapStudy, example="tubeopt snap thesis_ctr --to-deg 360,0,0 --out results")
    def snap(study: SnapStudy, output: Output) -> None:
        \"\"\"The first snap on the straight path from one set of joint values to another.\"\"\"
        answer(study, output)

makes of `snap` a command with a flag for every key of the study: its name from the key, its help from the description,
its default and what it is read as from the field. `output` stands for the flags that all commands share. What the
function takes besides stays as it is; where it takes a key too, it gets that as it was typed.
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
from ..files.checked import Entry, check, check_kind, marks_in
from ..files.shipped import ENDINGS, FOLDER, found, resolved, shipped
from ..files.units import parse_number, plainest, unit_of
from ..files.yaml_file import load_yaml, read_flow
from ..robots.robot import fit_warnings
from ..runs.study_file import STUDY_KINDS, Study
from ..show.progress import working
from ..show.reports import report
from .commands import COMMANDS, ROBOT, Asked, flowing
from .interruption import keeping
from .messages import LOGGER, told_by_flag
from .output import OF_PICTURES, Output, can_be_saved, check_formats, present

S = TypeVar("S", bound=Entry)
F = TypeVar("F", bound=Study)
Made = Callable[..., None]

NONE = "none"
"""Empties a list."""


def command(example: str, *, note: str = "", without: Sequence[str] = ()) -> Callable[[Made], Made]:
    """Make a command of a function that takes an `Output`; `example` and `note` end its help.

    `without`: fields of the output for which it has no flags.
    """

    def _of(function: Made) -> Made:
        # Annotations are strings here; Typer needs the types.
        taken = inspect.signature(function, eval_str=True).parameters
        return _command(function, [part for name, part in taken.items() if name != "output"], example, note, without)

    return _of


def _command(
    function: Made, own: Sequence[inspect.Parameter], example: str, note: str, without: Sequence[str] = ()
) -> Made:
    """A function with parameters `own`, besides the flags of every command, which it takes as one `Output`."""
    shared = [
        part.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for part in inspect.signature(Output, eval_str=True).parameters.values()
        if part.name not in without
    ]

    def _run(**typed: Any) -> None:
        output = Output(**{part.name: typed.pop(part.name) for part in shared})
        function(**typed, output=output)

    signature = inspect.Signature([*own, *shared])
    _run.__name__, _run.__doc__ = function.__name__, flowing(function.__doc__ or "")
    _run.__signature__ = signature  # type: ignore[attr-defined]
    _run.__annotations__ = {part.name: part.annotation for part in signature.parameters.values()}
    _run.epilog = f"{note}\n\nExample: {example}" if note else f"Example: {example}"  # type: ignore[attr-defined]
    return _run


def asking(row: Asked) -> Made:
    """The command that a row of `COMMANDS` is."""
    study = STUDY_KINDS[row.kind]

    def _ask(study: Study, output: Output) -> None:
        answer(study, output)

    _ask.__doc__ = row.help
    options: dict[str, Any] = {"arguments": row.arguments, "flags": row.flags, "defaults": row.defaults}
    without = () if row.pictures else OF_PICTURES
    makes: Any = asks_file if row.from_file else functools.partial(asks, without=without, **options)
    made: Made = makes(study, example=row.example, note=study.assuming)(_ask)
    return made


def asks(
    study: type[S],
    *,
    example: str,
    note: str = "",
    arguments: Mapping[str, tuple[str, str]] | None = None,
    flags: Mapping[str, str] | None = None,
    defaults: Mapping[str, str] | None = None,
    without: Sequence[str] = (),
) -> Callable[[Callable[..., None]], Made]:
    """Make a command of a function that takes a study. Keys that are mappings, or lists of them, have no flag.

    Args:
        example, note: what its help ends with.
        arguments, flags, defaults: as of `Asked`.
        without: fields of the output for which it has no flags.
    """
    placed = {"robot": ROBOT} if arguments is None else arguments
    keys = _Keys(study, tuple(placed), flags or {})
    flag_of = {key: _first(flag) for key, flag in keys.called.items() if key not in placed}
    keyed = [_argument(key, *placed[key], required=keys.fields[key].is_required()) for key in placed]
    keyed += [
        _option(
            key,
            keys.fields[key],
            keys.called[key],
            (defaults or {}).get(key, _usual(keys.fields[key])),
            needed=keys.fields[key].is_required(),
        )
        for key in flag_of
    ]
    usual = {part.name: part.default for part in keyed}
    constant = {"kind": _kind_of(study)} if "kind" in study.model_fields else {}

    @contextmanager
    def _question(typed: Mapping[str, Any]) -> Iterator[S]:
        given = keys.given(typed)
        missing = {key: flag for key, flag in flag_of.items() if keys.fields[key].is_required() and key not in given}
        # The sentence of the check names the flag; its description says what to type.
        lacks = {f"{flag} is missing": f": {_about(keys.fields[key])}" for key, flag in missing.items()}
        # Defaults are left out: a message about them would name a flag that was not typed.
        with told_by_flag({key: keys.names[key] for key in given if typed[key] != usual[key]}, flag_of):
            try:
                question = check(study, constant | given, "", names=keys.names_of(given) | missing)
            except InputError as error:
                raise InputError("\n".join(line + lacks.get(line, "") for line in str(error).splitlines())) from None
            yield question

    return functools.partial(_asking, keyed=keyed, question=_question, example=example, note=note, without=without)


def asks_file(study: type[F], *, example: str, note: str = "") -> Callable[[Callable[..., None]], Made]:
    """Make a command of a function that takes a study: it is read from a file, whose keys the flags override.

    Keys that are mappings, or lists of them, have no flag.
    """
    kind, keys = _kind_of(study), _Keys(study)
    keyed = [
        _argument(
            "study",
            "STUDY.yaml",
            f"Study of kind {kind}; `tubeopt init study --kind {kind}` writes one.",
            required=True,
        )
    ]
    keyed += [_option(key, field, keys.called[key], None, shown=_else(field)) for key, field in keys.fields.items()]

    @contextmanager
    def _question(typed: Mapping[str, Any]) -> Iterator[F]:
        path = found(typed["study"], "studies")
        given = {
            # A file that is typed is relative to where one is, not to the study.
            key: str(resolved(value).absolute()) if isinstance(value, str) and _is_file(keys.fields[key]) else value
            for key, value in keys.given(typed).items()
        }
        # A goal on the command line replaces any other goal of the file, or the study would have two.
        typed_sets = [one for one in study.either if not one.isdisjoint(given)]
        replaced = frozenset().union(*(one for one in study.either if typed_sets and one not in typed_sets))
        written = {key: value for key, value in load_yaml(path).items() if key not in replaced}
        named = keys.names_of(given)
        flags = {key: named[key] for key in given}
        with told_by_flag(flags, {key: flag for key, flag in flags.items() if flag}):
            yield check_kind({kind: study}, {**written, **given}, path, names=flags)

    return functools.partial(_asking, keyed=keyed, question=_question, example=example, note=note)


def _asking(
    function: Callable[..., None],
    *,
    keyed: Sequence[inspect.Parameter],
    question: Callable[[Mapping[str, Any]], AbstractContextManager[Entry]],
    example: str,
    note: str,
    without: Sequence[str] = (),
) -> Made:
    """A command of a function that takes a study, which `question` makes of what is typed for `keyed`."""
    _, *parts = inspect.signature(function, eval_str=True).parameters.values()  # the first is the study
    taken = {part.name for part in parts}
    own = [part for part in parts if part.name not in ("output", *(part.name for part in keyed))]

    def _run(output: Output, **typed: Any) -> None:
        with question(typed) as study:
            function(study, output=output, **{key: value for key, value in typed.items() if key in taken})

    _run.__name__, _run.__doc__ = function.__name__, function.__doc__
    return _command(_run, [*keyed, *own], example, note, without)


def answer(study: Study, output: Output) -> None:
    """Ask a study, and show and save its answer."""
    present(report(ask(study, output)), output)


def ask(study: Study, output: Output) -> Any:
    """The answer to a study, with a bar while it is computed; nothing is computed that could not be saved."""
    # An optimisation takes minutes: a directory that cannot be written is reported before.
    can_be_saved(output.out)
    check_formats(output, _command_of(study.kind))
    # Studies of rigs and molds have no robot.
    robot = getattr(study, "robot", None)
    for words in fit_warnings(robot) if robot is not None else ():
        LOGGER.warning(words)
    kept = study.keeps.format(out=output.out) if study.keeps and output.out else "nothing was saved"
    LOGGER.debug(f"{study.doing}: {study!r:.200}")
    with working(study.doing, shown=not output.quiet) as progress, keeping(kept):
        try:
            return study.ask(output.out, progress)
        except SolveError as error:
            raise _with_what_was_found(error, output.out) from None


def _command_of(kind: str) -> str:
    """What is typed for studies of a kind."""
    typed = {row.kind: words for words, row in COMMANDS.items() if isinstance(row, Asked)}
    return typed.get(kind, kind.replace("_", " "))


def has_pictures(kind: str) -> bool:
    """Whether the answer to studies of a kind has plots."""
    return all(row.pictures for row in COMMANDS.values() if isinstance(row, Asked) and row.kind == kind)


def _with_what_was_found(error: SolveError, out: Path | None) -> SolveError:
    """The error, with the best that was found saved: in a directory of its own, not to be taken for the answer."""
    if out is None or error.solution is None:
        return error
    try:
        # A solution without a report, such as plain arrays, is not saved.
        found = report(error.solution)
    except TypeError:
        return error
    saved = found.save(out / "partial")
    return SolveError(f"{error}; partial result: {saved[0].parent}", error.solution) if saved else error


def _kind_of(study: type[Entry]) -> str:
    (kind,) = get_args(study.model_fields["kind"].annotation)
    return str(kind)


class _Keys:
    """The keys of a study that can be typed: their fields, their flags, and what messages call them, which is nothing
    where what is said begins with the name of a file, and else the flag."""

    def __init__(self, study: type[Entry], placed: Sequence[str] = (), flags: Mapping[str, str] | None = None) -> None:
        known, self.placed = study.model_fields.items(), placed
        self.fields = {key: field for key, field in known if key != "kind" and _can_be_typed(field)}
        self.called = {key: (flags or {}).get(key, f"--{key.replace('_', '-')}") for key in self.fields}
        self.names = {
            key: "" if key in placed or _is_file(field) else _first(self.called[key])
            for key, field in self.fields.items()
        }

    def names_of(self, given: Mapping[str, Any]) -> dict[str, str]:
        """Names of all keys in messages: data typed in place of a file have no file name, so their flag names them."""
        inline = {
            key: _first(self.called[key])
            for key, value in given.items()
            if key not in self.placed and not isinstance(value, str)
        }
        return self.names | inline

    def given(self, typed: Mapping[str, Any]) -> dict[str, Any]:
        """What was typed, as the study's model takes it."""
        read = {key: _read(field, typed[key]) for key, field in self.fields.items()}
        return {key: value for key, value in read.items() if value is not None}


def read_typed(model: type[Entry], typed: Mapping[str, str]) -> dict[str, Any]:
    """What was typed for some keys, as the model takes it."""
    return {key: _read(model.model_fields[key], text) for key, text in typed.items()}


def _first(flags: str) -> str:
    """The first of several flags for a key."""
    return re.split("[,/]", flags)[0]


def numbers(text: str) -> list[Decimal | str]:
    """The numbers in text such as "0,1.5,-3"; what is no number stays text, for the check to complain of."""
    return [parse_number(part) for part in text.split(",")]


def _parameter(key: str, kind: Any, option: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(
        key, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=Annotated[kind, option]
    )


def _argument(key: str, metavar: str, words: str, *, required: bool) -> inspect.Parameter:
    option = typer.Argument(metavar=metavar, help=words, show_default=False, autocompletion=files(key))
    return _parameter(key, str, option) if required else _parameter(key, str | None, option, None)


def _option(
    key: str, field: FieldInfo, flag: str, default: str | bool | None, *, shown: str = "", needed: bool = False
) -> inspect.Parameter:
    """A flag; one without a default says nothing where it is not typed. Its help may show one, or that it is needed."""
    kind: Any = bool if _plain(field.annotation) is bool else str
    if kind is bool and default is not False:
        flag = f"{flag}/--no-{flag.removeprefix('--')}"
    option = typer.Option(
        *flag.split(","),
        metavar=None if kind is bool else _metavar(key, field),
        help=_sentence(field) + " Required." * needed,
        show_default=shown or default is not None,
        autocompletion=_completion(key, field),
    )
    return _parameter(key, kind | None if default is None else kind, option, default)


def _completion(key: str, field: FieldInfo) -> Completion | None:
    """What completes the value of a flag in the shell, where that is a file or a word."""
    if _is_file(field):
        return files(key)
    choices = _choices(field)
    return words(choices) if choices else None


def _choices(field: FieldInfo) -> tuple[str, ...]:
    """The words of which a key is one."""
    kind = _plain(field.annotation)
    return get_args(kind) if get_origin(kind) is Literal else ()


def _usual(field: FieldInfo) -> str | bool | None:
    """What stands for a key whose flag is not typed, as it would be typed."""
    own = None if field.is_required() else field.get_default(call_default_factory=True)
    return own if isinstance(own, bool) else as_typed(own)


def _else(field: FieldInfo) -> str:
    """Default of a flag that overrides a key of a study, for its help; "" where the key has none."""
    usual = _usual(field)
    if usual is None:
        return ""
    return f"key of the study, else {('no', 'yes')[usual] if isinstance(usual, bool) else usual}"


def _sentence(field: FieldInfo) -> str:
    words = _about(field)
    return words[:1].upper() + words[1:] + "." * (bool(words) and not words.endswith("."))


def _about(field: FieldInfo) -> str:
    """What a key is, where it is typed: files are then relative to where one is."""
    return (field.description or "").replace(", relative to this file", "")


def _can_be_typed(field: FieldInfo) -> bool:
    """Whether a key is a number, a word, a file, or a list of numbers or words."""
    kind = _plain(field.annotation)
    inner = _plain(get_args(kind)[0]) if get_origin(kind) is list else kind
    return _is_file(field) or inner in (bool, int, Decimal, str) or get_origin(inner) is Literal


def as_typed(default: Any) -> str | None:
    """A default as it would be typed; None where there is nothing to be typed."""
    if default is None or default in ([], ()):
        return None
    if isinstance(default, list):
        return ",".join(as_typed(each) or "" for each in default)
    if isinstance(default, Decimal):
        return str(plainest(default)) if default == int(default) else str(default).lower()
    return str(default)


def _read(field: FieldInfo, typed: Any) -> Any:
    """What was typed, as the study's model takes it; what is no number stays text, for the check to complain of."""
    if typed is None or isinstance(typed, bool):
        return typed
    kind = _plain(field.annotation)
    if _is_file(field):
        # A mapping or list is typed instead of a file, as `--load "{tip_force_mN: [10, 0, 0]}"`.
        return read_flow(typed) if typed.startswith(("{", "[")) else typed
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
    if _is_file(field):
        return "FILE"
    return f"[{'|'.join(_choices(field))}]" if _choices(field) else "WORD"


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
    return any(isinstance(mark, PlainValidator) for mark in (*field.metadata, *marks_in(field.annotation)))


# --- completion in the shell: words, built-in files, and files that are there -----------------------------------------

Completion = Callable[[str], list[str]]
"""What is typed of a value so far -> the values that begin so."""

MOST = 200
"""Files of a directory that are proposed."""

FOLDERS = {
    "study": "studies",
    "simulate": "rigs",
    "stock": "tubes",
    "measurements": "experiments",
    "log": "experiments",
}
"""Keys whose files are in a folder that is not called as they are."""


def words(choices: Sequence[str]) -> Completion:
    """What completes one of several words."""
    return lambda incomplete: [word for word in choices if word.startswith(incomplete)]


def files(key: str) -> Completion:
    """What completes the file of a key: names of those that come with tubeopt, and paths."""
    # The folder of a key is its name or its plural: robot -> robots.
    near = [FOLDERS.get(key, ""), key, f"{key}s"]
    folder = next((name for name in near if name and (FOLDER / name).is_dir()), "*")

    def complete(incomplete: str) -> list[str]:
        return [name for name in shipped(folder) if name.startswith(incomplete)] + _there(incomplete)

    return complete


def _there(incomplete: str) -> list[str]:
    """Directories and tables or YAML files whose path begins so."""
    above, slash, begins = incomplete.rpartition("/")
    try:
        beside = sorted(path for path in Path(above + slash).iterdir() if path.name.startswith(begins))[:MOST]
    except OSError:
        return []
    return [
        f"{above}{slash}{path.name}{'/' * path.is_dir()}"
        for path in beside
        if (path.is_dir() or path.suffix in ENDINGS) and (begins or not path.name.startswith("."))
    ]
