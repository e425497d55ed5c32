"""Files as dataclasses whose fields describe themselves: readers, writers and schemas follow from their marks.

    @dataclass(frozen=True)
    class Clamps:
        mass: Annotated[float, unit("g"), POSITIVE, "of one"] = 0.05

The library holds `mass` in kg. A file has the key `mass_g`: `entry_of(Clamps)` is the model that reads it, with its
range and default in g, and `to_data(clamps)` is what is written, so that the same float comes back.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import types
import typing
from collections.abc import Callable, Collection, Mapping
from dataclasses import MISSING, dataclass
from decimal import Decimal
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    Literal,
    NamedTuple,
    Self,
    TypeVar,
    get_args,
    get_origin,
)

from pydantic import BeforeValidator, Discriminator, Field, Tag, create_model, model_validator

from ..errors import InputError, undoubted
from .checked import Entry, Whole, as_many, three
from .field_metadata import Absent, FieldSpec, Key, Named, OneOf, Range, Typical, Written, marked
from .units import UNITS, ZERO_CELSIUS, decimal, in_unit, parted, plainest, to_si

E = TypeVar("E", bound=Entry)
D = TypeVar("D")

# --- read and write --------------------------------------------------------------------------------------------------


class Part(Entry):
    """An entry that describes an object of the library, and is valid where that object can be built."""

    of: ClassVar[type[Any]]
    """The dataclass whose fields are among its keys."""

    def build(self) -> Any:
        """The object, in SI: what those fields make."""
        return made(self.of, self)

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self.build()
        return self


@dataclass(frozen=True)
class Described:
    """A field that is a key."""

    name: str
    """In the dataclass."""
    key: str
    """In the file."""
    about: str
    annotation: Any
    """What pydantic checks."""
    default: Any
    """In the unit of the file; MISSING where the key must be there."""
    read: Callable[[Any], Any]
    """From the file to SI."""
    write: Callable[[Any], Any]
    """And back."""


def entry_of(
    what: Any, *, base: type[Entry] = Part, extra: Mapping[str, Any] | None = None, names: Collection[str] = ()
) -> Any:
    """The model of what a file says about a dataclass whose fields describe themselves.

    Args:
        names: of the fields; by default all.
        base: what it derives from; by default an entry whose `build` makes the dataclass. Keys that it has stay.
        extra: further keys, as `pydantic.create_model` takes them; they stand before the others.
    """
    # A key that the entry defines itself replaces the one of the dataclass: it may have another form.
    own = {*(extra or {}), *base.model_fields}
    keys = {key: field for key, field in keys_of(what, names).items() if key not in own}
    told = what if base is Part else base
    doc = (told.__doc__ or "").partition("\n\n")[0]
    model = create_model(told.__name__, __base__=base, __doc__=doc, **(extra or {}), **keys)
    model.of = what  # type: ignore[attr-defined]
    return model


def keys_of(what: Any, names: Collection[str] = ()) -> dict[str, Any]:
    """The keys of a dataclass, or of the parameters of a function with these names, as `create_model` takes them."""
    chosen = [field for field in described(what, tuple(names)) if not names or field.name in names]
    return {field.key: (field.annotation, _default(field)) for field in chosen}


if TYPE_CHECKING:

    class EntryOf(Part, Generic[D]):
        """The model of what a file says about a dataclass `D` whose fields describe themselves, and nothing besides."""

        def build(self) -> D:
            """The object that the keys describe, in SI."""

else:

    class EntryOf:
        """The same; for one dataclass it is always one model."""

        @classmethod
        @functools.lru_cache(maxsize=256)
        def __class_getitem__(cls, what):
            return entry_of(what)


def asking(what: Any, *names: str) -> Callable[[type[E]], type[E]]:
    """Give an entry, besides its own keys, those of a dataclass, or of its fields or a function's parameters with these
    names: `values` makes the fields or arguments of them, and `build` of a part the dataclass."""
    return lambda base: entry_of(what, base=base, names=names)


def extended(keys: Mapping[str, Any]) -> Callable[[type[E]], type[E]]:
    """Give an entry, besides its own keys, further ones, as `pydantic.create_model` takes them."""
    return lambda base: create_model(base.__name__, __base__=base, __doc__=base.__doc__, **keys)


def values(what: Any, entry: Any, *names: str) -> dict[str, Any]:
    """The fields of a dataclass, or the arguments of a function with these names, in SI, from the keys of an entry;
    those without a key, or with an empty one, are left out."""
    read = {}
    for field in described(what, names):
        given = getattr(entry, field.key, None)
        if given is not None:
            read[field.name] = field.read(given)
    return read


def made(what: type[D], entry: Any) -> D:
    """The dataclass that the keys of an entry describe, in SI; what is wrong is said by these keys.

    Raises:
        InputError: values that it refuses.
    """
    try:
        # The reader of the file warns by key; the dataclass would warn again in SI.
        with undoubted():
            return what(**values(what, entry))
    except InputError as error:
        said, of = str(error), typing.cast("Any", what)
        for field in described(of):
            # A name that is a plain word may be one of the sentence.
            if "_" in field.name and parted(field.key)[0] != field.name:
                said = re.sub(rf"(?<![\w.]){field.name}(?!\w)", field.key, said)
        raise InputError(said) from None


def to_data(what: Any, leave_out: Collection[str] = ()) -> dict[str, Any]:
    """A dataclass whose fields describe themselves, with the keys and units of a file.

    Fields that are None, or named in `leave_out`, are left out.
    """
    return {
        field.key: field.write(getattr(what, field.name))
        for field in described(what.__class__)
        if field.name not in leave_out and getattr(what, field.name) is not None
    }


# --- the fields ------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=256)
def described(what: Any, names: tuple[str, ...] = ()) -> tuple[Described, ...]:
    """The fields of a dataclass that are keys, in order, or the parameters of a function with these names."""
    return tuple(_described(field) for field in marked(what, names))


def _described(said: FieldSpec) -> Described:
    kind, absent = said.kind, said.first(Absent)
    named = said.first(Key) or Key("")
    annotation, read, write = _kind(kind, said.marks, named.unit)
    default: Any = said.default if absent is None else absent.value
    # A list of parts has no default in a file: an empty list and no key mean the same.
    several = get_origin(kind) is tuple and dataclasses.is_dataclass(get_args(kind)[0])
    if said.optional or several or default is None:
        annotation = annotation | None
    if default is not MISSING and default is not None and not several:
        default = write(default)
    name = named.name or (f"{said.name}_{named.unit}" if named.unit else said.name)
    return Described(said.name, name, said.first(str) or "", annotation, None if several else default, read, write)


def _default(field: Described) -> Any:
    options: dict[str, Any] = {"description": field.about} if field.about else {}
    if field.default is MISSING:
        return Field(**options)
    if isinstance(field.default, dict):  # a part: what it is where none of its keys is given
        return Field(default_factory=field.annotation, **options)
    # Pydantic does not check defaults: they must have the type that a file would give.
    whole = getattr(field.annotation, "__origin__", None) is int
    return Field(field.default if whole else _decimals(field.default), **options)


def _decimals(value: Any) -> Any:
    """Numbers as the decimals that pydantic would make of them."""
    if isinstance(value, list):
        return [_decimals(each) for each in value]
    return Decimal(str(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value


class KeyType(NamedTuple):
    """How a key is checked and converted."""

    annotation: Any
    """What pydantic checks."""
    read: Callable[[Any], Any]
    """From the file to SI."""
    write: Callable[[Any], Any]
    """And back."""


def _plain_type(annotation: Any) -> KeyType:
    """The type of a value that is the same in the file and in SI."""
    return KeyType(annotation, lambda value: value, lambda value: value)


def _kind(kind: Any, marks: tuple[Any, ...], suffix: str) -> KeyType:
    for mark in marks:
        if isinstance(mark, Written):
            return KeyType(mark.entry, lambda entry: entry.build(), mark.write)
        if isinstance(mark, Named):
            return _by_name(kind, mark.known)
        if isinstance(mark, OneOf) and (kind is str or isinstance(kind, tuple)):  # text, or besides text an object
            return _plain_type(Literal[mark.words])
    if isinstance(kind, tuple):
        return _one_or_several(kind, marks, suffix)
    if kind is float:
        return _number(marks, suffix)
    if kind is int:
        limits: dict[str, Any] = {name: int(bound) for name, bound in _bounds(marks).items()}
        return _plain_type(Annotated[Whole, Field(**limits)])
    if get_origin(kind) is tuple:
        return _several(get_args(kind), marks, suffix)
    if dataclasses.is_dataclass(kind):
        return KeyType(entry_of(typing.cast(Any, kind)), lambda entry: entry.build(), to_data)
    return _plain_type(kind)


def _bounds(marks: tuple[Any, ...]) -> dict[str, float]:
    """What pydantic calls the bounds of a number, SI."""
    allowed = next((mark for mark in marks if isinstance(mark, Range)), Range())
    bounds = {"gt": allowed.above, "ge": allowed.least, "le": allowed.most, "lt": allowed.below}
    return {name: bound for name, bound in bounds.items() if bound is not None}


def _number(marks: tuple[Any, ...], suffix: str) -> KeyType:
    scale, zero = UNITS[suffix] if suffix else Decimal(1), ZERO_CELSIUS if suffix == "degC" else Decimal(0)
    # Rounded to a float: a bound of pi/2 rad is 90 deg in messages and schemas, not 90.000000000000002.
    limits = {
        name: Decimal(repr(float((Decimal(repr(bound)) - zero) / scale))) for name, bound in _bounds(marks).items()
    }

    def _write(value: float) -> Any:
        if zero:
            return plainest(Decimal(repr(value)) - zero)
        # Digits are added until the same float comes back.
        return value if scale == 1 else in_unit(value, scale)

    usual = [mark for mark in marks if isinstance(mark, Typical)]
    whole: dict[str, Any] = {name: int(limit) if limit == int(limit) else limit for name, limit in limits.items()}
    annotation: Any = Annotated[Decimal, Field(**whole), BeforeValidator(decimal), *usual]
    return KeyType(annotation, lambda number: to_si(number + zero, scale), _write)


def _several(kinds: tuple[Any, ...], marks: tuple[Any, ...], suffix: str) -> KeyType:
    inner, read, write = _kind(kinds[0], marks, suffix)
    most = None if kinds[-1] is ... else len(kinds)
    least = most or (1 if kinds[0] is float else 0)
    exact = [] if most is None else [BeforeValidator(three if most == 3 else functools.partial(as_many, most))]
    return KeyType(
        Annotated[types.GenericAlias(list, (inner,)), Field(min_length=least, max_length=most), *exact],
        lambda listed: tuple(read(each) for each in listed),
        lambda listed: [write(each) for each in listed],
    )


def _one_or_several(kinds: tuple[Any, ...], marks: tuple[Any, ...], suffix: str) -> KeyType:
    one, several = (_kind(kind, marks, suffix) for kind in kinds)
    number: Any = Annotated[one.annotation, Tag("<number>")]
    listed: Any = Annotated[several.annotation, Tag("<list>")]
    # A discriminator chooses one alternative: without it, messages would list the faults of both.
    either = Annotated[
        number | listed, Discriminator(lambda value: "<list>" if isinstance(value, list) else "<number>")
    ]
    return KeyType(
        either,
        lambda written: (several if isinstance(written, list) else one).read(written),
        lambda value: (several if isinstance(value, tuple) else one).write(value),
    )


def named_or(entry: Any, known: Mapping[str, Any]) -> Any:
    """What pydantic checks where a thing is given by its name, in upper or lower case, or by an entry."""
    named: Any = Annotated[Literal[tuple(known)], BeforeValidator(str.lower), Tag("<name>")]
    mapping: Any = Annotated[entry, Tag("<mapping>")]
    return Annotated[named | mapping, Discriminator(lambda value: "<name>" if isinstance(value, str) else "<mapping>")]


def _by_name(kind: Any, known: Mapping[str, Any]) -> KeyType:
    def write(thing: Any) -> Any:
        return next((name for name, one in known.items() if one == thing), None) or to_data(thing)

    # Names are short in files; own constants need a mapping.
    either = named_or(entry_of(kind), known)
    return KeyType(either, lambda written: known[written] if isinstance(written, str) else written.build(), write)
