"""What the fields of a dataclass say about themselves, once; checks, reader, writer and schema follow from it.

    @dataclass(frozen=True)
    class Clamps:
        mass: Annotated[float, unit("g"), POSITIVE, "of one"] = 0.05

        def __post_init__(self) -> None:
            check_fields(self, "the clamps")

The library holds `mass` in kg. A file has the key `mass_g`: `entry_of(Clamps)` is the model that reads it, with its
range and default in g, and `to_data(clamps)` is what is written, so that the same float comes back. Fields that are not
`Annotated` are no keys.
"""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass
from decimal import Decimal
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, get_args, get_origin

from pydantic import BeforeValidator, Discriminator, Field, Tag, create_model, model_validator

from ..errors import InputError, choice, finite, instance, positive
from .checked import Entry
from .units import UNITS, ZERO_CELSIUS, decimal, in_unit, plainest, to_si, unit_of

E = TypeVar("E", bound=Entry)

# --- what an annotation may say: besides these, text says what the field is ------------------------------------------


@dataclass(frozen=True)
class Key:
    """How a field is called in a file, and the unit of its number there, a key of `UNITS`.   name: None adds the unit
    to the name of the field."""

    unit: str
    name: str | None = None


def unit(name: str) -> Key:
    """The key of a field is its name with this unit, a key of `UNITS`."""
    return Key(name)


def key(name: str) -> Key:
    """The key of a field where that is not its name with its unit; it ends in the unit all the same."""
    return Key(unit_of(name), name)


@dataclass(frozen=True)
class Range:
    """What a number, or each of several, must be (SI): above one bound or at least another, at most a third."""

    above: float | None = None
    least: float | None = None
    most: float | None = None


POSITIVE, NOT_NEGATIVE = Range(above=0.0), Range(least=0.0)


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
    """Things that may be given by their name in place of their constants."""

    known: Mapping[str, Any]

    def __hash__(self) -> int:
        return id(self.known)


@dataclass(frozen=True)
class Written:
    """An entry of its own reads the field, and a function of its own writes it."""

    entry: type[Part]
    write: Callable[[Any], Any]


# --- read and write --------------------------------------------------------------------------------------------------


class Part(Entry):
    """An entry that describes an object of the library, and is valid where that object can be built."""

    def build(self) -> Any:
        """The object, in SI."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self.build()
        return self


class _Described(Part):
    """An entry made by `entry_of`."""

    of: ClassVar[type[Any]]
    finish: ClassVar[Callable[[Any, Any], Any] | None] = None

    def build(self) -> Any:
        """The object that the keys describe, in SI."""
        made = self.of(**values(self.of, self))
        finish = type(self).finish
        return made if finish is None else finish(self, made)


@dataclass(frozen=True)
class Described:
    """A field that is a key.

    annotation: what pydantic checks.   read, write: from there to SI and back.   kind: of its value, besides None where
    it is optional.
    """

    name: str
    key: str
    about: str
    annotation: Any
    default: Any
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]
    marks: tuple[Any, ...]
    kind: Any
    optional: bool

    @property
    def range(self) -> Range:
        """What its numbers must be."""
        return next((mark for mark in self.marks if isinstance(mark, Range)), Range())


def entry_of(
    what: type[Any],
    *,
    base: type[Entry] = _Described,
    extra: Mapping[str, Any] | None = None,
    finish: Callable[[Any, Any], Any] | None = None,
) -> Any:
    """The model of what a file says about a dataclass whose fields describe themselves.

    Args:
        base: what it derives from; by default an entry whose `build` makes the dataclass.
        extra: further keys, as `pydantic.create_model` takes them; they stand before the others.
        finish: (entry, object) -> the object as those further keys want it; may raise ValueError or InputError.
    """
    keys: dict[str, Any] = {
        field.key: (field.annotation, _default(field)) for field in described(what) if field.key not in (extra or {})
    }
    doc = (what.__doc__ or "").partition("\n\n")[0]
    name = what.__name__ if base is _Described else base.__name__
    model = create_model(
        name, __base__=base, __doc__=doc if base is _Described else base.__doc__, **(extra or {}), **keys
    )
    if base is _Described:
        model.of, model.finish = what, finish  # type: ignore[attr-defined]
    return model


def asking(what: Any) -> Callable[[type[E]], type[E]]:
    """Give an entry, besides its own keys, those of a dataclass; `values` of the entry makes its fields of them."""

    def with_keys(base: type[E]) -> type[E]:
        model: type[E] = entry_of(what, base=base)
        return model

    return with_keys


def values(what: type[Any], entry: Any) -> dict[str, Any]:
    """The fields of a dataclass in SI, from the keys of an entry; those whose key is empty by default are left out."""
    read = {}
    for field in described(what):
        given = getattr(entry, field.key)
        if given is not None:
            read[field.name] = field.read(given)
    return read


def to_data(what: Any) -> dict[str, Any]:
    """A dataclass whose fields describe themselves, with the keys and units of a file; what is None is left out."""
    return {
        field.key: field.write(getattr(what, field.name))
        for field in described(type(what))
        if getattr(what, field.name) is not None
    }


def check_fields(what: Any, owner: str = "") -> None:
    """Make the numbers of a frozen dataclass floats, and check what its fields say of themselves.

    Args:
        owner: what messages say the field is of, as in "mass of the clamps is -1; it must be greater than 0".

    Raises:
        InputError: a number out of its range, a word that is not allowed, a part of another kind.
    """
    for field in described(type(what)):
        value = getattr(what, field.name)
        label = f"{field.name} of {owner}" if owner else field.name
        words = next((mark.words for mark in field.marks if isinstance(mark, OneOf)), None)
        if value is None and field.optional:
            continue
        if field.kind is float:
            object.__setattr__(what, field.name, _checked(label, value, field.range))
        elif words is not None and field.kind is str:
            choice(label, value, words)
        elif isinstance(field.kind, type) and dataclasses.is_dataclass(field.kind):
            instance(label, value, field.kind)


def _checked(label: str, value: Any, allowed: Range) -> float:
    bounded = allowed.above == 0 or allowed.least == 0
    number = positive(label, value, zero=allowed.least == 0) if bounded else finite(label, value)
    if allowed.most is not None and number > allowed.most:
        raise InputError(f"{label} is {number:g}; it must be at most {allowed.most:g}")
    return number


# --- the fields ------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=256)
def _hints(what: Any) -> dict[str, Any]:
    return typing.get_type_hints(what, include_extras=True)


def described(what: Any) -> tuple[Described, ...]:
    """The fields of a dataclass that are keys, in order."""
    return _keys(what)


@functools.lru_cache(maxsize=256)
def _keys(what: Any) -> tuple[Described, ...]:
    hints = _hints(what)
    known = [(field, hints[field.name]) for field in dataclasses.fields(what)]
    return tuple(_described(field, hint) for field, hint in known if get_origin(hint) is Annotated)


def _described(field: dataclasses.Field[Any], hint: Any) -> Described:
    kind, marks = hint.__origin__, tuple(hint.__metadata__)
    optional = get_origin(kind) in (Union, types.UnionType)
    if optional:
        (kind,) = (part for part in get_args(kind) if part is not types.NoneType)
    named = next((mark for mark in marks if isinstance(mark, Key)), Key(""))
    annotation, read, write = _kind(kind, marks, named.unit)
    default: Any = field.default if field.default_factory is MISSING else field.default_factory()
    default = next((mark.value for mark in marks if isinstance(mark, Absent)), default)
    several = get_origin(kind) is tuple and dataclasses.is_dataclass(get_args(kind)[0])
    if optional or several:
        annotation = annotation | None
    if default is not MISSING and default is not None and not several:
        default = write(default)
    about = next((mark for mark in marks if isinstance(mark, str)), "")
    name = named.name or (f"{field.name}_{named.unit}" if named.unit else field.name)
    default = None if several else default
    return Described(
        field.name, name, about, annotation, None if several else default, read, write, marks, kind, optional
    )


def _default(field: Described) -> Any:
    options: dict[str, Any] = {"description": field.about} if field.about else {}
    if field.default is MISSING:
        return Field(**options)
    if isinstance(field.default, dict):  # a part: what it is where none of its keys is given
        return Field(default_factory=field.annotation, **options)
    return Field(_decimals(field.default), **options)


def _decimals(value: Any) -> Any:
    """Numbers as the decimals that pydantic would make of them."""
    if isinstance(value, list):
        return [_decimals(each) for each in value]
    return Decimal(str(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value


Way = Callable[[Any], Any]


def _kind(kind: Any, marks: tuple[Any, ...], suffix: str) -> tuple[Any, Way, Way]:
    """What pydantic checks, and the ways to SI and back."""
    for mark in marks:
        if isinstance(mark, Written):
            return mark.entry, lambda entry: entry.build(), mark.write
        if isinstance(mark, Named):
            return _by_name(kind, mark.known)
        if isinstance(mark, OneOf) and kind is str:
            return Literal[mark.words], lambda word: word, lambda word: word
    if kind is float:
        return _number(marks, suffix)
    if get_origin(kind) is tuple:
        return _several(get_args(kind), marks, suffix)
    if dataclasses.is_dataclass(kind):
        return entry_of(typing.cast(Any, kind)), lambda entry: entry.build(), to_data
    return kind, lambda value: value, lambda value: value


def _number(marks: tuple[Any, ...], suffix: str) -> tuple[Any, Way, Way]:
    scale, zero = UNITS[suffix] if suffix else Decimal(1), ZERO_CELSIUS if suffix == "degC" else Decimal(0)
    allowed = next((mark for mark in marks if isinstance(mark, Range)), Range())
    bounds = {"gt": allowed.above, "ge": allowed.least, "le": allowed.most}
    limits = {name: (Decimal(repr(bound)) - zero) / scale for name, bound in bounds.items() if bound is not None}

    def write(value: float) -> Any:
        if zero:
            return plainest(Decimal(repr(value)) - zero)
        return value if scale == 1 else in_unit(value, scale)

    whole = {name: int(limit) if limit == int(limit) else limit for name, limit in limits.items()}
    annotation = Annotated[Decimal, Field(**whole), BeforeValidator(decimal)]
    return annotation, lambda number: to_si(number + zero, scale), write


def _several(kinds: tuple[Any, ...], marks: tuple[Any, ...], suffix: str) -> tuple[Any, Way, Way]:
    inner, read, write = _kind(kinds[0], marks, suffix)
    most = None if kinds[-1] is ... else len(kinds)
    least = most or (1 if kinds[0] is float else 0)
    return (
        Annotated[types.GenericAlias(list, (inner,)), Field(min_length=least, max_length=most)],
        lambda listed: tuple(read(each) for each in listed),
        lambda listed: [write(each) for each in listed],
    )


def _by_name(kind: Any, known: Mapping[str, Any]) -> tuple[Any, Way, Way]:
    entry = entry_of(kind)
    named: Any = Annotated[Literal[tuple(known)], Tag("<name>")]
    mapping: Any = Annotated[entry, Tag("<mapping>")]
    either = Annotated[
        named | mapping, Discriminator(lambda value: "<name>" if isinstance(value, str) else "<mapping>")
    ]

    def write(thing: Any) -> Any:
        return thing.name if known.get(thing.name) == thing else to_data(thing)

    return either, lambda given: known[given] if isinstance(given, str) else given.build(), write
