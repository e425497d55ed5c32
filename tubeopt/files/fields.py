"""Readers, writers and schemas of files from dataclasses with marked fields.

    @dataclass(frozen=True)
    class Clamps:
        mass: Annotated[float, unit("g"), POSITIVE, "mass of one clamp"] = 0.05

The library has `mass` in kg. A file has the key `mass_g`: the model `entry_of(Clamps)` reads it, with its range and
default in g, and `to_data(clamps)` writes it so that the same float is read back.
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

from ..errors import InputError, without_unit_warnings
from .checked import Entry, Whole, as_many, three
from .field_metadata import Absent, FieldSpec, Key, Named, OneOf, Range, Typical, Written, marked
from .units import UNITS, ZERO_CELSIUS, decimal, in_unit, simplest, split_unit, to_si

E = TypeVar("E", bound=Entry)
D = TypeVar("D")

# --- read and write --------------------------------------------------------------------------------------------------


class Part(Entry):
    """Entry that describes an object of the library; it is valid if the object can be built."""

    of: ClassVar[type[Any]]
    """Dataclass with the keys of the entry as its fields."""

    def build(self) -> Any:
        """Build the object in SI."""
        return build_from(self.of, self)

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        self.build()
        return self


@dataclass(frozen=True)
class FileKey:
    """Key of a file for a marked field or parameter."""

    name: str
    """Name of the field."""
    key: str
    """Name of the key, with its unit."""
    about: str
    """Description of the key for the documentation."""
    annotation: Any
    """Type that pydantic checks."""
    default: Any
    """Default in the unit of the file; MISSING for a required key."""
    read: Callable[[Any], Any]
    """Conversion from the file to SI."""
    write: Callable[[Any], Any]
    """Conversion from SI to the file."""


def entry_of(
    what: Any, *, base: type[Entry] = Part, extra: Mapping[str, Any] | None = None, names: Collection[str] = ()
) -> Any:
    """Model of a file with the marked fields of a dataclass as keys.

    Args:
        base: base class; by default an entry whose `build` returns the dataclass. Its own keys have priority.
        extra: further keys, as for `pydantic.create_model`, before the others.
        names: fields to use; by default all.
    """
    # A key that the entry defines itself replaces the one of the dataclass: it may have another form.
    replaced = {*(extra or {}), *base.model_fields}
    keys = {key: field for key, field in keys_of(what, names).items() if key not in replaced}
    described = what if base is Part else base
    doc = (described.__doc__ or "").partition("\n\n")[0]
    model = create_model(described.__name__, __base__=base, __doc__=doc, **(extra or {}), **keys)
    model.of = what  # type: ignore[attr-defined]
    return model


def keys_of(what: Any, names: Collection[str] = ()) -> dict[str, Any]:
    """Keys of a dataclass, or of parameters of a function, for `pydantic.create_model`."""
    chosen = [field for field in keys_in(what, tuple(names)) if not names or field.name in names]
    return {field.key: (field.annotation, _default(field)) for field in chosen}


if TYPE_CHECKING:

    class EntryOf(Part, Generic[D]):
        """Model of a file with the marked fields of the dataclass `D` as keys."""

        def build(self) -> D:
            """Build the dataclass in SI."""

else:

    class EntryOf:
        """Model of a dataclass, cached so that there is one model for each."""

        @classmethod
        @functools.lru_cache(maxsize=256)
        def __class_getitem__(cls, what):
            return entry_of(what)


def keys_from(what: Any, *names: str) -> Callable[[type[E]], type[E]]:
    """Class decorator that adds the keys of a dataclass, or of fields or parameters with these names, to an entry.

    `values` converts these keys to fields or arguments; `build` of a part returns the dataclass.
    """
    return lambda base: entry_of(what, base=base, names=names)


def with_keys(keys: Mapping[str, Any]) -> Callable[[type[E]], type[E]]:
    """Class decorator that adds keys to an entry, given as for `pydantic.create_model`."""
    return lambda base: create_model(base.__name__, __base__=base, __doc__=base.__doc__, **keys)


def values(what: Any, entry: Any, *names: str) -> dict[str, Any]:
    """Fields of a dataclass, or arguments of a function with these names, in SI from the keys of an entry.

    Missing and empty keys are omitted.
    """
    out = {}
    for field in keys_in(what, names):
        value = getattr(entry, field.key, None)
        if value is not None:
            out[field.name] = field.read(value)
    return out


def build_from(what: type[D], entry: Any) -> D:
    """Build a dataclass in SI from the keys of an entry; error messages name these keys.

    Raises:
        InputError: invalid values.
    """
    try:
        # The reader of the file warns by key; the dataclass would warn again in SI.
        with without_unit_warnings():
            return what(**values(what, entry))
    except InputError as error:
        message = str(error)
        for field in keys_in(typing.cast("Any", what)):
            # A name that is a plain word may be a word of the sentence.
            if "_" in field.name and split_unit(field.key)[0] != field.name:
                message = re.sub(rf"(?<![\w.]){field.name}(?!\w)", field.key, message)
        raise InputError(message) from None


def to_data(what: Any, leave_out: Collection[str] = ()) -> dict[str, Any]:
    """Convert a dataclass with marked fields to keys and units of a file; None and fields `leave_out` are omitted."""
    return {
        field.key: field.write(getattr(what, field.name))
        for field in keys_in(what.__class__)
        if field.name not in leave_out and getattr(what, field.name) is not None
    }


# --- the fields ------------------------------------------------------------------------------------------------------


@functools.lru_cache(maxsize=256)
def keys_in(what: Any, names: tuple[str, ...] = ()) -> tuple[FileKey, ...]:
    """Keys for the marked fields of a dataclass, or for parameters of a function with these names."""
    return tuple(_file_key(spec) for spec in marked(what, names))


def _file_key(spec: FieldSpec) -> FileKey:
    kind, absent = spec.kind, spec.first(Absent)
    key = spec.first(Key) or Key("")
    annotation, read, write = _kind(kind, spec.metadata, key.unit)
    default: Any = spec.default if absent is None else absent.value
    # A list of parts has no default in a file: an empty list and no key mean the same.
    several = get_origin(kind) is tuple and dataclasses.is_dataclass(get_args(kind)[0])
    if spec.optional or several or default is None:
        annotation = annotation | None
    if default is not MISSING and default is not None and not several:
        default = write(default)
    name = key.name or (f"{spec.name}_{key.unit}" if key.unit else spec.name)
    return FileKey(
        name=spec.name,
        key=name,
        about=spec.first(str) or "",
        annotation=annotation,
        default=None if several else default,
        read=read,
        write=write,
    )


def _default(field: FileKey) -> Any:
    options: dict[str, Any] = {"description": field.about} if field.about else {}
    if field.default is MISSING:
        return Field(**options)
    if isinstance(field.default, dict):  # a part with defaults for all its keys
        return Field(default_factory=field.annotation, **options)
    # Pydantic does not check defaults: they must have the type that a file would give.
    is_count = getattr(field.annotation, "__origin__", None) is int
    return Field(field.default if is_count else _decimals(field.default), **options)


def _decimals(value: Any) -> Any:
    """Convert numbers to decimals, as pydantic does for numbers in a file."""
    if isinstance(value, list):
        return [_decimals(each) for each in value]
    return Decimal(str(value)) if isinstance(value, int | float) and not isinstance(value, bool) else value


class KeyType(NamedTuple):
    """Check and conversion of a key."""

    annotation: Any
    """Type that pydantic checks."""
    read: Callable[[Any], Any]
    """Conversion from the file to SI."""
    write: Callable[[Any], Any]
    """Conversion from SI to the file."""


def _plain_type(annotation: Any) -> KeyType:
    """Type of a value that is equal in the file and in SI."""
    return KeyType(annotation, lambda value: value, lambda value: value)


def _kind(kind: Any, metadata: tuple[Any, ...], suffix: str) -> KeyType:
    for mark in metadata:
        if isinstance(mark, Written):
            return KeyType(mark.entry, lambda entry: entry.build(), mark.write)
        if isinstance(mark, Named):
            return _by_name(kind, mark.known)
        if isinstance(mark, OneOf) and (kind is str or isinstance(kind, tuple)):  # text, or besides text an object
            return _plain_type(Literal[mark.choices])
    if isinstance(kind, tuple):
        return _one_or_several(kind, metadata, suffix)
    if kind is float:
        return _number(metadata, suffix)
    if kind is int:
        limits: dict[str, Any] = {name: int(bound) for name, bound in _bounds(metadata).items()}
        return _plain_type(Annotated[Whole, Field(**limits)])
    if get_origin(kind) is tuple:
        return _several(get_args(kind), metadata, suffix)
    if dataclasses.is_dataclass(kind):
        return KeyType(entry_of(typing.cast(Any, kind)), lambda entry: entry.build(), to_data)
    return _plain_type(kind)


def _bounds(metadata: tuple[Any, ...]) -> dict[str, float]:
    """Bounds of a number in SI, by their names in pydantic."""
    allowed = next((mark for mark in metadata if isinstance(mark, Range)), Range())
    bounds = {"gt": allowed.above, "ge": allowed.minimum, "le": allowed.maximum, "lt": allowed.below}
    return {name: bound for name, bound in bounds.items() if bound is not None}


def _number(metadata: tuple[Any, ...], suffix: str) -> KeyType:
    scale, zero = UNITS[suffix] if suffix else Decimal(1), ZERO_CELSIUS if suffix == "degC" else Decimal(0)
    # Rounded: a bound of pi/2 rad is 90 deg in messages and schemas, not 90.000000000000002; 233.15 K is -40 degC.
    limits = {
        name: Decimal(f"{float((Decimal(repr(bound)) - zero) / scale):.12g}")
        for name, bound in _bounds(metadata).items()
    }

    def _write(value: float) -> Any:
        if zero:
            return simplest(Decimal(repr(value)) - zero)
        # Digits are added until the same float comes back.
        return value if scale == 1 else in_unit(value, scale)

    typical = [mark for mark in metadata if isinstance(mark, Typical)]
    bounds: dict[str, Any] = {name: int(limit) if limit == int(limit) else limit for name, limit in limits.items()}
    annotation: Any = Annotated[Decimal, Field(**bounds), BeforeValidator(decimal), *typical]
    return KeyType(annotation, lambda number: to_si(number + zero, scale), _write)


def _several(kinds: tuple[Any, ...], metadata: tuple[Any, ...], suffix: str) -> KeyType:
    inner, read, write = _kind(kinds[0], metadata, suffix)
    size = None if kinds[-1] is ... else len(kinds)
    min_size = size or (1 if kinds[0] is float else 0)
    exact = [] if size is None else [BeforeValidator(three if size == 3 else functools.partial(as_many, size))]
    return KeyType(
        Annotated[types.GenericAlias(list, (inner,)), Field(min_length=min_size, max_length=size), *exact],
        lambda listed: tuple(read(each) for each in listed),
        lambda listed: [write(each) for each in listed],
    )


def _one_or_several(kinds: tuple[Any, ...], metadata: tuple[Any, ...], suffix: str) -> KeyType:
    single, several = (_kind(kind, metadata, suffix) for kind in kinds)
    number: Any = Annotated[single.annotation, Tag("<number>")]
    listed: Any = Annotated[several.annotation, Tag("<list>")]
    # A discriminator chooses one alternative: without it, messages would list the faults of both.
    either = Annotated[
        number | listed, Discriminator(lambda value: "<list>" if isinstance(value, list) else "<number>")
    ]
    return KeyType(
        either,
        lambda written: (several if isinstance(written, list) else single).read(written),
        lambda value: (several if isinstance(value, tuple) else single).write(value),
    )


def named_or(entry: Any, known: Mapping[str, Any]) -> Any:
    """Type of a value that is given by its name, in upper or lower case, or by an entry."""
    named: Any = Annotated[Literal[tuple(known)], BeforeValidator(str.lower), Tag("<name>")]
    mapping: Any = Annotated[entry, Tag("<mapping>")]
    return Annotated[named | mapping, Discriminator(lambda value: "<name>" if isinstance(value, str) else "<mapping>")]


def _by_name(kind: Any, known: Mapping[str, Any]) -> KeyType:
    def write(thing: Any) -> Any:
        return next((name for name, known_thing in known.items() if known_thing == thing), None) or to_data(thing)

    # Names are short in files; own constants need a mapping.
    either = named_or(entry_of(kind), known)
    return KeyType(either, lambda written: known[written] if isinstance(written, str) else written.build(), write)
