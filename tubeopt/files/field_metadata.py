"""Marks on the fields of a dataclass or the parameters of a function, and checks by these marks.

    @dataclass(frozen=True)
    class Clamps:
        mass: Annotated[float, unit("g"), POSITIVE, "mass of one clamp"] = 0.05

        def __post_init__(self) -> None:
            check_fields(self, "the clamps")

The library has `mass` in kg, and a file has the key `mass_g`: `files.fields` builds reader, writer and schema from it.
In an answer, the same marks give an entry of `--json` and of the table, by `show.quantities`:

    tip_jump: Annotated[float, unit("mm"), form(".4f"), "distance that the tip jumps"]

Fields that are not `Annotated` are no keys. A docstring below a marked field adds what its marks do not say, such as
the shape of an array, or when it is None.

A parameter of a function has its description in the section Args of the docstring, so that the page of the API, the
help of the command and the page about files repeat one text:

    def stability_map(robot: Robot, *, samples: Annotated[int, Range(minimum=2)] = 24) -> StabilityMap:
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

from ..errors import InputError, choice, finite, instance, positive, warn_implausible, whole
from .units import alternative_units, si_unit, unit_of, unit_text

M = TypeVar("M")


@dataclass(frozen=True)
class Key:
    """Name of a field in a file."""

    unit: str
    """Unit of its number in the file, a key of `UNITS`."""
    name: str | None = None
    """Name with unit; None for the name of the field with its unit."""


def unit(name: str) -> Key:
    """Mark a field: its key is its name with this unit of `UNITS`."""
    return Key(name)


def key(name: str) -> Key:
    """Mark a field with the name of its key, which ends in its unit."""
    return Key(unit_of(name), name)


@dataclass(frozen=True)
class Form:
    """Format of a field in a table."""

    spec: str
    label: str | None = None
    """Label of the row; None for the description of the field."""


def form(spec: str, *, label: str | None = None) -> Form:
    """Mark a field as a row of the table, with its numbers in the format `spec`."""
    return Form(spec, label)


@dataclass(frozen=True)
class Range:
    """Allowed range of a number, or of each of several numbers, in SI."""

    above: float | None = None
    """Exclusive lower bound."""
    minimum: float | None = None
    """Lower bound."""
    maximum: float | None = None
    """Upper bound."""
    below: float | None = None
    """Exclusive upper bound."""


POSITIVE, NOT_NEGATIVE, MARGIN = Range(above=0.0), Range(minimum=0.0), Range(minimum=0.0, below=1.0)


@dataclass(frozen=True)
class Typical:
    """Typical magnitude of a number other than 0, in SI; other numbers cause a warning about the unit."""

    minimum: float
    maximum: float


TYPICAL_CLEARANCE = Typical(1e-5, 0.1)
"""Clearance between arm and bodies, m."""

TYPICAL_TIP_ERROR = Typical(1e-9, 0.1)
"""Position error of a tip, m."""

TYPICAL_TUBE_CLEARANCE = Typical(1e-6, 5e-3)
"""Radial clearance between nested tubes, m."""

TYPICAL_NOISE = Typical(1e-7, 0.02)
"""Noise of a measured coordinate, m."""

TYPICAL_REGION = Typical(1e-4, 1.0)
"""Size of a region of the body, m."""


@dataclass(frozen=True)
class OneOf:
    """Allowed words of a field."""

    choices: tuple[str, ...]


@dataclass(frozen=True)
class Absent:
    """Default in SI of a key in a file, if it differs from the default of the field."""

    value: Any


REQUIRED = Absent(MISSING)
"""Mark of a required key; its field has a default."""


@dataclass(frozen=True)
class Named:
    """Known values of a field, which a file may give by name, in upper or lower case."""

    known: Mapping[str, Any]

    def __hash__(self) -> int:
        # A dict has no hash, and each table exists once.
        return id(self.known)


@dataclass(frozen=True)
class Written:
    """Custom reader and writer of a field."""

    entry: type[Any]
    """Model of the key; its `build` returns the value."""
    write: Callable[[Any], Any]
    """Conversion of the value to data of the file."""


@dataclass(frozen=True)
class FieldSpec:
    """Marked field or parameter."""

    name: str
    default: Any
    """Default value; MISSING without one."""
    kind: Any
    """Type of its value, without None; a tuple of both types for one number or several."""
    optional: bool
    metadata: tuple[Any, ...]

    @property
    def sign(self) -> str:
        """Unit of its number in SI, after a blank; "" without a unit."""
        key = self.first(Key)
        return "" if key is None else f" {unit_text(si_unit(key.unit))}".rstrip()

    def first(self, kind: type[M]) -> M | None:
        """First mark of a type; None without one."""
        return next((mark for mark in self.metadata if isinstance(mark, kind)), None)


@functools.lru_cache(maxsize=256)
def marked(what: Any, names: tuple[str, ...] = ()) -> tuple[FieldSpec, ...]:
    """Marked fields of a dataclass, or parameters of a function with these names."""
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
    return dataclasses.replace(
        spec, metadata=(*spec.metadata, about.removesuffix(f",{spec.sign}") if spec.sign else about)
    )


def argument_docs(function: Callable[..., Any]) -> dict[str, str]:
    """First sentences of the descriptions in the section Args of a docstring, without full stops, by argument."""
    section = re.search(r"^Args:\n(.*?)(?=^\S|\Z)", inspect.getdoc(function) or "", re.MULTILINE | re.DOTALL)
    text = section[1] if section else ""
    entries = re.findall(r"^ {4}(\w[\w, ]*): (.*?)(?=^ {4}\S|\Z)", text, re.MULTILINE | re.DOTALL)
    sentences = {names: re.split(r"\.(?: |$)", " ".join(text.split()))[0] for names, text in entries}
    return {name: sentence for names, sentence in sentences.items() for name in names.split(", ")}


def _read(name: str, default: Any, hint: Any) -> FieldSpec:
    kind, metadata = (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())
    optional = get_origin(kind) in (Union, types.UnionType)
    if optional:
        parts = tuple(part for part in get_args(kind) if part is not types.NoneType)
        kind, optional = (parts[0], True) if len(parts) == 1 else (parts, len(parts) < len(get_args(kind)))
    return FieldSpec(name, default, kind, optional, tuple(metadata))


class Checked:
    """Base of a frozen dataclass that is checked by the marks of its fields only."""

    _owner: ClassVar[str] = ""
    """Owner of the fields in messages, such as "the clamps"."""

    def __post_init__(self) -> None:
        check_fields(self, self._owner)


def check_fields(what: Any, owner: str = "") -> None:
    """Convert the numbers of a frozen dataclass to float or int, and check them by the marks of their fields.

    Args:
        owner: owner of the fields in messages, as in "mass of the clamps is -1; it must be greater than 0".

    Raises:
        InputError: a number outside its range, a word that is not allowed, a part of another type.
    """
    for field in marked(what.__class__):
        value = getattr(what, field.name)
        label = f"{field.name} of {owner}" if owner else field.name
        allowed = field.first(OneOf)
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
            choice(label, value, allowed.choices) if allowed is not None else instance(label, value, str)
        elif isinstance(field.kind, type) and dataclasses.is_dataclass(field.kind):
            instance(label, value, field.kind)
    check_typical(what, owner)


def _checked(label: str, value: Any, allowed: Range, sign: str) -> float:
    # `positive` says "greater than 0", which is clearer than a bound of 0.
    bounded = allowed.above == 0 or allowed.minimum == 0
    number = positive(label, value, zero=allowed.minimum == 0) if bounded else finite(label, value)
    if allowed.minimum is not None and number < allowed.minimum:
        raise InputError(f"{label} is {number:g}{sign}; it must be at least {allowed.minimum:g}{sign}")
    if allowed.maximum is not None and number > allowed.maximum:
        raise InputError(f"{label} is {number:g}{sign}; it must be at most {allowed.maximum:g}{sign}")
    if allowed.below is not None and number >= allowed.below:
        raise InputError(f"{label} is {number:g}{sign}; it must be below {allowed.below:g}{sign}")
    return number


@functools.lru_cache(maxsize=256)
def _typical_fields(what: Any) -> tuple[tuple[FieldSpec, Typical], ...]:
    """Fields of a dataclass with a typical range."""
    return tuple((field, typical) for field in marked(what) if (typical := field.first(Typical)) is not None)


def check_typical(what: Any, owner: str = "") -> None:
    """Warn of numbers of a dataclass outside their typical range.

    Args:
        owner: owner of the fields in messages.
    """
    for field, typical in _typical_fields(what.__class__):
        label = f"{field.name} of {owner}" if owner else field.name
        check_size(label, getattr(what, field.name), typical, (field.first(Key) or Key("")).unit)


def typical_length(name: str, value: float, typical: Typical, *, zero: bool = False) -> float:
    """Convert a length, m, to float; raises InputError unless it is positive, and warns of an untypical one."""
    number = positive(name, value, zero=zero)
    check_size(name, number, typical, "mm")
    return number


def check_size(label: str, value: Any, usual: Typical, file_unit: str) -> None:
    """Warn of a number in SI, or of the largest of several, outside its typical range, with the probable unit.

    A number below the range causes a warning only if another unit explains it.

    Args:
        file_unit: unit of the number in a file, a key of `UNITS`; "" for a number without unit.
    """
    several = value if isinstance(value, tuple) and value else (value,)
    if not all(isinstance(each, float | int) for each in several):
        return
    number = max(several, key=abs)
    if number == 0 or usual.minimum <= abs(number) <= usual.maximum:
        return
    own_unit = si_unit(file_unit)
    sign = f" {unit_text(own_unit)}".rstrip()
    # The unit of the file is the likeliest mistake: its number was given without conversion.
    sizes = sorted(alternative_units(own_unit), key=lambda alternative: alternative[0] != file_unit)
    probable = next(
        (other for other, size in sizes if usual.minimum <= abs(number) * float(size) <= usual.maximum), None
    )
    # Small numbers are often correct, such as a gap of 1 um. Only a unit that explains them is worth a warning.
    if probable is None and abs(number) < usual.minimum:
        return
    question = "" if probable is None else f": was {number:g} {unit_text(probable)} meant?"
    warn_implausible(f"{label} is {number:g}{sign}; usual is {usual.minimum:g} to {usual.maximum:g}{sign}{question}")
