"""Marks on the fields of a dataclass, or on the parameters of a function, and the check of an object by them.

    @dataclass(frozen=True)
    class Clamps:
        mass: Annotated[float, unit("g"), POSITIVE, "mass of one clamp"] = 0.05

        def __post_init__(self) -> None:
            check_fields(self, "the clamps")

The library has `mass` in kg, and a file has the key `mass_g`: `files.fields` makes reader, writer and schema of it. In
an answer the same marks make an entry of `--json` and of the table, by `show.quantities`:

    tip_jump: Annotated[float, unit("mm"), form(".4f"), "distance that the tip jumps"]

Fields that are not `Annotated` are no keys. A docstring below a marked field adds what its marks do not say, such as
the shape of an array, or when it is None.

A parameter of a function has its description in the section Args of the docstring, so that the page of the API, the
help of the command and the page about files repeat one text:

    def stability_map(robot: Robot, *, samples: Annotated[int, Range(least=2)] = 24) -> StabilityMap:
        \"\"\"Margin over two rotations.

        Args:
            samples: samples per axis. More of them cost as many solves.
        \"\"\"

The description is the first sentence, without the unit at its end.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import sys
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

from ..errors import InputError, choice, finite, implausible, instance, positive, whole
from .units import in_words, others, plain_unit, unit_of

M = TypeVar("M")


@dataclass(frozen=True)
class Key:
    """How a field is called in a file."""

    unit: str
    """Of its number there, a key of `UNITS`."""
    name: str | None = None
    """None for the name of the field and its unit."""


def unit(name: str) -> Key:
    """The key of a field is its name with this unit, a key of `UNITS`."""
    return Key(name)


def key(name: str) -> Key:
    """The key of a field where that is not its name with its unit; it ends in the unit all the same."""
    return Key(unit_of(name), name)


@dataclass(frozen=True)
class Form:
    """How the numbers of a field are written in a table."""

    spec: str
    label: str | None = None
    """Name of the row; None for the description of the field."""


def form(spec: str, *, label: str | None = None) -> Form:
    """A field is a row of the table, with its numbers in the format `spec` and their unit."""
    return Form(spec, label)


@dataclass(frozen=True)
class Range:
    """What a number, or each of several, must be (SI)."""

    above: float | None = None
    """Exclusive lower bound."""
    least: float | None = None
    most: float | None = None
    below: float | None = None
    """Exclusive upper bound."""


POSITIVE, NOT_NEGATIVE, MARGIN = Range(above=0.0), Range(least=0.0), Range(least=0.0, below=1.0)


@dataclass(frozen=True)
class Typical:
    """Between which magnitudes (SI) a number other than 0 usually lies: what lies outside is warned of, as it may be in
    another unit than that of its key."""

    least: float
    most: float


FAR_FROM_BODIES = Typical(1e-5, 0.1)
"""m, by which an arm keeps clear."""

TOLERATED = Typical(1e-9, 0.1)
"""m, between a tip and where it is wanted."""

BETWEEN_TUBES = Typical(1e-6, 5e-3)
"""m, radial, of a tube in the next one."""

SEEN_WITHIN = Typical(1e-7, 0.02)
"""m, the noise of a measured coordinate."""

REGION = Typical(1e-4, 1.0)
"""m, the size of a region of the body."""


@dataclass(frozen=True)
class OneOf:
    """The words that a field may be."""

    words: tuple[str, ...]


@dataclass(frozen=True)
class Absent:
    """What a key that is left out of a file stands for (SI), where the field has no default."""

    value: Any


REQUIRED = Absent(MISSING)
"""The key must be there, although the field has a default."""


@dataclass(frozen=True)
class Named:
    """Things that may be given by their name, in upper or lower case, in place of their constants."""

    known: Mapping[str, Any]

    def __hash__(self) -> int:
        # A dict has no hash, and each table exists once.
        return id(self.known)


@dataclass(frozen=True)
class Written:
    """A field that is read and written in a way of its own."""

    entry: type[Any]
    """Reads it."""
    write: Callable[[Any], Any]
    """Writes it."""


@dataclass(frozen=True)
class FieldSpec:
    """A field or parameter with marks."""

    name: str
    default: Any
    """MISSING where there is none."""
    kind: Any
    """Type of its value, without None; a tuple of both types where that is a number or several."""
    optional: bool
    marks: tuple[Any, ...]

    @property
    def sign(self) -> str:
        """The unit of its number in SI, after a blank; "" where it has none."""
        named = self.first(Key)
        return "" if named is None else f" {in_words(plain_unit(named.unit))}".rstrip()

    def first(self, kind: type[M]) -> M | None:
        """The first mark of a kind."""
        return next((mark for mark in self.marks if isinstance(mark, kind)), None)


@functools.lru_cache(maxsize=256)
def marked(what: Any, names: tuple[str, ...] = ()) -> tuple[FieldSpec, ...]:
    """The fields of a dataclass that have marks, or the parameters of a function with these names."""
    if not dataclasses.is_dataclass(what):
        return tuple(_parameter(what, name) for name in names)
    hints = typing.get_type_hints(what, include_extras=True)
    known = [(field, hints[field.name]) for field in dataclasses.fields(what)]
    return tuple(_read(field.name, _default(field), hint) for field, hint in known if get_origin(hint) is Annotated)


def _default(field: dataclasses.Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _parameter(function: Callable[..., Any], name: str) -> FieldSpec:
    # Decorators such as `typed` keep the signature, but not the names of the module.
    plain = inspect.unwrap(function)
    part = inspect.signature(plain).parameters[name]
    # Only this annotation: other parameters may have types that are imported for type checkers alone.
    hint = eval(part.annotation, vars(sys.modules[plain.__module__]))
    spec = _read(name, MISSING if part.default is part.empty else part.default, hint)
    about = argument_docs(plain)[name]
    return dataclasses.replace(spec, marks=(*spec.marks, about.removesuffix(f",{spec.sign}") if spec.sign else about))


def argument_docs(function: Callable[..., Any]) -> dict[str, str]:
    """First sentence, without its full stop, of what a docstring says about each argument in its section Args."""
    found = re.search(r"^Args:\n(.*?)(?=^\S|\Z)", inspect.getdoc(function) or "", re.MULTILINE | re.DOTALL)
    entries = re.findall(r"^ {4}(\w[\w, ]*): (.*?)(?=^ {4}\S|\Z)", found[1] if found else "", re.MULTILINE | re.DOTALL)
    sentences = {names: re.split(r"\.(?: |$)", " ".join(text.split()))[0] for names, text in entries}
    return {name: sentence for names, sentence in sentences.items() for name in names.split(", ")}


def _read(name: str, default: Any, hint: Any) -> FieldSpec:
    kind, marks = (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())
    optional = get_origin(kind) in (Union, types.UnionType)
    if optional:
        parts = tuple(part for part in get_args(kind) if part is not types.NoneType)
        kind, optional = (parts[0], True) if len(parts) == 1 else (parts, len(parts) < len(get_args(kind)))
    return FieldSpec(name, default, kind, optional, tuple(marks))


class Checked:
    """A frozen dataclass whose fields are checked by what they say of themselves, and by nothing else."""

    _owner: ClassVar[str] = ""
    """What messages say its fields are of."""

    def __post_init__(self) -> None:
        check_fields(self, self._owner)


def check_fields(what: Any, owner: str = "") -> None:
    """Make the numbers of a frozen dataclass floats, and check what its fields say of themselves.

    Args:
        owner: what messages say the field is of, as in "mass of the clamps is -1; it must be greater than 0".

    Raises:
        InputError: a number out of its range, a word that is not allowed, a part of another kind.
    """
    for field in marked(what.__class__):
        value = getattr(what, field.name)
        label = f"{field.name} of {owner}" if owner else field.name
        words = field.first(OneOf)
        if value is None and field.optional:
            continue
        if field.kind is float:
            object.__setattr__(what, field.name, _checked(label, value, field.first(Range) or Range(), field.sign))
        elif field.kind is int:
            object.__setattr__(what, field.name, whole(label, value))
            _checked(label, value, field.first(Range) or Range(), "")
        elif field.kind is bool:
            instance(label, value, bool)
        elif field.kind is str:
            choice(label, value, words.words) if words is not None else instance(label, value, str)
        elif isinstance(field.kind, type) and dataclasses.is_dataclass(field.kind):
            instance(label, value, field.kind)
    check_usual(what, owner)


def _checked(label: str, value: Any, allowed: Range, sign: str) -> float:
    # `positive` says "greater than 0", which is clearer than a bound of 0.
    bounded = allowed.above == 0 or allowed.least == 0
    number = positive(label, value, zero=allowed.least == 0) if bounded else finite(label, value)
    if allowed.least is not None and number < allowed.least:
        raise InputError(f"{label} is {number:g}{sign}; it must be at least {allowed.least:g}{sign}")
    if allowed.most is not None and number > allowed.most:
        raise InputError(f"{label} is {number:g}{sign}; it must be at most {allowed.most:g}{sign}")
    if allowed.below is not None and number >= allowed.below:
        raise InputError(f"{label} is {number:g}{sign}; it must be below {allowed.below:g}{sign}")
    return number


@functools.lru_cache(maxsize=256)
def _with_usual(what: Any) -> tuple[tuple[str, str, Typical], ...]:
    """The fields of a dataclass with a usual range: their names, and the units of their keys."""
    found = [(one.name, one.first(Key) or Key(""), one.first(Typical)) for one in marked(what)]
    return tuple((name, named.unit, usual) for name, named, usual in found if usual is not None)


def check_usual(what: Any, owner: str = "") -> None:
    """Warn of numbers of a dataclass that are unusual by what its fields say of themselves.

    Args:
        owner: what messages say the field is of.
    """
    for name, file_unit, usual in _with_usual(what.__class__):
        check_size(f"{name} of {owner}" if owner else name, getattr(what, name), usual, file_unit)


def usual_length(name: str, value: float, usual: Typical, *, zero: bool = False) -> float:
    """A length, m, as float where it is above 0 (0 or more with `zero`), with a warning where it is unusual."""
    number = positive(name, value, zero=zero)
    check_size(name, number, usual, "mm")
    return number


def check_size(label: str, value: Any, usual: Typical, file_unit: str) -> None:
    """Warn of a number (SI), or of the largest of several, that is unusual, with the unit that was probably meant.

    Below the usual range a number may well be meant, unless there is such a unit.

    Args:
        file_unit: that of the number in a file, a key of `UNITS`; "" for a number without unit.
    """
    several = value if isinstance(value, tuple) and value else (value,)
    if not all(isinstance(each, float | int) for each in several):
        return
    number = max(several, key=abs)
    if number == 0 or usual.least <= abs(number) <= usual.most:
        return
    plain = plain_unit(file_unit)
    sign = f" {in_words(plain)}".rstrip()
    # The unit of the file is the likeliest mistake: its number was given without conversion.
    sizes = sorted(others(plain), key=lambda one: one[0] != file_unit)
    meant = (other for other, size in sizes if usual.least <= abs(number) * float(size) <= usual.most)
    right = next(meant, None)
    # Small numbers are often meant, such as a gap of 1 um. Only a unit that explains them is worth a warning.
    if right is None and abs(number) < usual.least:
        return
    words = "" if right is None else f": was {number:g} {in_words(right)} meant?"
    implausible(f"{label} is {number:g}{sign}; usual is {usual.least:g} to {usual.most:g}{sign}{words}")
