"""Data from outside, checked against a model: every problem at once, each in one sentence with its path.

Numbers that were probably meant in another unit are warnings.
"""

from __future__ import annotations

import functools
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
)

from ..errors import InputError, nearest, undoubted
from .field_metadata import Typical
from .shipped import resolved, shipped
from .units import UNITS, ZERO_CELSIUS, as_typed, decimal, in_words, meant, others, parted, shown, to_si, unit_of

# --- unusual numbers --------------------------------------------------------------------------------------------------


def suspects(entry: BaseModel, path: str = "", *, names: Mapping[str, str] | None = None) -> Iterator[str]:
    """Sentences on the numbers of an entry, and of those in it, that are unusual by what their fields say.

    `names`: what the caller calls keys of the entry.
    """
    for key, usual in _looked_at(type(entry)):
        value = getattr(entry, key)
        if value is None:
            continue
        here = f"{path}{(names or {}).get(key, key)}"
        if usual is not None:
            yield from unusual(here, unit_of(key), value, usual)
        for place, part in _parts(value):
            yield from suspects(part, f"{here}{place}.")


@functools.lru_cache(maxsize=256)
def _looked_at(model: type[BaseModel]) -> tuple[tuple[str, Typical | None], ...]:
    """Keys whose numbers have a usual range, and keys that may hold entries of their own, for which it is None."""
    found = []
    for key, field in model.model_fields.items():
        marks = (*field.metadata, *marks_in(field.annotation))
        usual = next((mark for mark in marks if isinstance(mark, Typical)), None)
        if usual is not None or any(True for _ in models(field.annotation)):
            found.append((key, usual))
    return tuple(found)


def models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models(part)


def marks_in(annotation: Any) -> Iterator[Any]:
    """What is said beside the types in an annotation."""
    yield from getattr(annotation, "__metadata__", ())
    for part in get_args(annotation):
        yield from marks_in(part)


def _parts(value: Any) -> Iterator[tuple[str, BaseModel]]:
    if isinstance(value, BaseModel):
        yield "", value
    elif isinstance(value, list | tuple):
        yield from ((f"[{k}]", part) for k, part in enumerate(value) if isinstance(part, BaseModel))


def unusual(key: str, unit: str, value: Any, usual: Typical) -> Iterator[str]:
    """A sentence on a number, or on the largest of several: a position has coordinates that are small."""
    numbers: Sequence[Decimal] = value if isinstance(value, list) else [value]
    if not numbers or not all(isinstance(number, Decimal) for number in numbers):
        return
    largest = max(numbers, key=abs)
    size = abs(to_si(largest, UNITS[unit] if unit else Decimal(1)))
    # 0 has no size: it is the same in every unit.
    if size == 0 or usual.least <= size <= usual.most:
        return
    listed = ", ".join(str(number) for number in numbers)
    sentence = f"{key} is {f'[{listed}]' if isinstance(value, list) else listed}"
    # Kelvin and Celsius differ by an offset; all other units by a factor.
    alike = [(other, scale, Decimal(0)) for other, scale in others(unit)]
    for other, scale, zero in [("K", Decimal(1), ZERO_CELSIUS)] if unit == "degC" else alike:
        if usual.least <= abs(to_si(largest - zero, scale)) <= usual.most:
            factor = scale / UNITS[unit]
            right = ", ".join(f"{float((number - zero) * factor):.6g}" for number in numbers)
            yield f"{sentence}; that would be usual in {in_words(other) or 'parts of 1'}: was {right} meant?"
            return
    low, high = (f"{bound / float(UNITS[unit] if unit else 1):.4g}" for bound in (usual.least, usual.most))
    yield f"{sentence}; usual is {low} to {high}"


# --- keys and their values --------------------------------------------------------------------------------------------

LOGGER = logging.getLogger(__name__)

Number = Annotated[Decimal, BeforeValidator(decimal)]
"""A finite number as it was written; neither text nor true/false."""

Positive = Annotated[Decimal, Field(gt=0), BeforeValidator(decimal)]
NotNegative = Annotated[Decimal, Field(ge=0), BeforeValidator(decimal)]


def _whole(value: object) -> int:
    number = decimal(value)
    # 12.0 is a whole number too: spreadsheets write it so.
    if number != number.to_integral_value():
        raise ValueError(f"is {shown(value)}; it must be a whole number")
    return int(number)


Whole = Annotated[int, BeforeValidator(_whole)]
"""A whole number."""

Count = Annotated[Whole, Field(ge=1)]
"""A whole number, at least 1."""


def as_many(count: int, value: object, what: str = "") -> object:
    """A list, where it has as many numbers as it must; raises ValueError with words that continue its name."""
    if isinstance(value, (list, tuple)) and len(value) != count:
        raise ValueError(f"has {len(value)} number{'' if len(value) == 1 else 's'}; it must have {count}{what}")
    return value


def three(value: object) -> object:
    """A list, where it has three numbers; raises ValueError with words that continue its name."""
    return as_many(3, value, ": x, y, z")


Triple = Annotated[list[Number], Field(min_length=3, max_length=3), BeforeValidator(three)]
"""x, y and z."""


class Entry(BaseModel):
    """A mapping in a file. Keys carry their unit as suffix; unknown keys are refused.

    Validators raise InputError with a whole sentence, or ValueError with a message that continues the key's name.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)

    def si(self, key: str) -> Any:
        """The value of a key, a number in SI, those of a list as a tuple; what is no number is as it was given."""
        return _in_si(getattr(self, key), unit_of(key))

    def in_si(self, *keys: str) -> dict[str, Any]:
        """The same of several, by the names of the keys without their units."""
        return {parted(key)[0]: self.si(key) for key in keys}


def require_one(study: Entry, one: str, other: str) -> None:
    """Raise ValueError unless a study has one of two keys."""
    given = {getattr(study, key) is not None for key in (one, other)}
    if given == {False}:
        raise ValueError(f"{one} and {other} are missing; one of them must be given")
    if given == {True}:
        raise ValueError(f"{one} and {other} are given; it must be one of them")


def _in_si(value: Any, unit: str) -> Any:
    if isinstance(value, list):
        return tuple(_in_si(each, unit) for each in value)
    if isinstance(value, dict):
        return {name: _in_si(each, unit) for name, each in value.items()}
    if not isinstance(value, Decimal):
        return value
    return to_si(value + ZERO_CELSIUS if unit == "degC" else value, UNITS[unit] if unit else Decimal(1))


def in_file(
    read: Callable[..., Any], what: str, *, kind: Any = None, of: str = "", named: bool = False
) -> PlainValidator:
    """Mark a key as the path of a file, relative to the one that it stands in, or as the name of one that comes with
    tubeopt; its value is what is read from there.

    Args:
        read: path -> what the file holds.
        what: what the path must be of.
        kind: what may be given as it is, by a sweep, which has read or changed it.
        of: a key that stands before, whose value `read` takes too.
        named: whether the value is the path too, before what is read.
    """

    def _load(value: object, info: ValidationInfo) -> Any:
        if kind is not None and isinstance(value, kind):
            return value
        if not isinstance(value, str):
            raise ValueError(f"is {shown(value)}; it must be the path of {what}")
        path = resolved(value, info.context["directory"]) if info.context else resolved(value)
        if info.context:
            # A built-in file keeps its name, so that a command that repeats the study runs anywhere.
            info.context["files"][info.field_name] = value if shipped().get(value) == path else str(path)
        # Pydantic checks keys in their order: a key with a problem is absent here.
        if of and of not in info.data:  # it has problems itself; it is None where it was left out
            return None
        found = read(path, info.data[of]) if of else read(path)
        return (str(path), found) if named else found

    return PlainValidator(_load, json_schema_input_type=str)


Model = TypeVar("Model", bound=BaseModel)


def check(
    model: type[Model],
    data: object,
    where: str | PathLike[str],
    *,
    names: Mapping[str, str] | None = None,
) -> Model:
    """`data` as an instance of `model`.

    Args:
        where: file or other place that the data are from; it begins every message, and what a path in the data is
            relative to.
        names: what the caller calls a top-level key that is not from there; "" leaves it out.

    Numbers that no such thing has are logged as warnings, with what was probably meant.

    Raises:
        InputError: one line for every problem.
    """
    try:
        with undoubted():
            # The library warns in SI units. The sentences below warn once, with key and unit of the file.
            entry = model.model_validate(data, context={"directory": Path(where).parent, "files": {}})
    except ValidationError as error:
        problems = error.errors(include_url=False)
    else:
        for words in suspects(entry, names=names):
            LOGGER.warning(f"{where}: {words}" if str(where) else words)
        return entry
    called = names or {}
    kinds = [problem for problem in problems if problem["loc"] == ("kind",)]
    if kinds and "kind" not in called:  # a file of another kind: what its keys are is no matter
        problems = kinds
    sentences = []
    for problem in problems:
        # A flag is in no file: its message begins with the flag.
        prefix = f"{where}: " if str(where) and problem["loc"][:1] not in {(name,) for name in called} else ""
        sentences += [prefix + sentence for sentence in _sentences(model, dict(problem), called)]
    raise InputError("\n".join(sentences))


OF_ROBOTS = ("concentric", "eccentric", "segmented_eccentric")
"""Kinds of robot files, which are often given in place of a file that names one."""


def check_kind(
    kinds: Mapping[str, type[Model]],
    data: object,
    where: str | PathLike[str],
    *,
    names: Mapping[str, str] | None = None,
) -> Model:
    """`data` as an instance of the model that its key `kind` names; `names` and InputError as of `check`."""
    prefix = f"{where}: " if str(where) else ""
    if not isinstance(data, Mapping):
        raise InputError(f"{prefix}the data are {shown(data)}; they must be a mapping of keys to values")
    allowed = f"it must be {_either(list(kinds))}"
    if "kind" not in data:
        raise InputError(f"{prefix}kind is missing; {allowed}")
    kind = data["kind"]
    if not isinstance(kind, str) or kind not in kinds:
        hint = nearest(kind, kinds)
        if kind in OF_ROBOTS and any("robot" in model.model_fields for model in kinds.values()):
            hint = "; a robot is named by the key robot of such a file"
        elif kind in OF_ROBOTS:
            hint = f"; this is a robot file, and a {_either(list(kinds))} file is wanted"
        raise InputError(f"{prefix}kind is {shown(kind)}; {allowed}{hint}")
    return check(kinds[kind], data, where, names=names)


def _sentences(model: type[BaseModel], problem: Mapping[str, Any], names: Mapping[str, str]) -> list[str]:
    """What is wrong, where, and what is allowed: one sentence, or several where a file named in the data has many."""
    loc: Sequence[int | str] = problem["loc"]
    path, value, context = path_of(loc, names), problem["input"], problem.get("ctx", {})
    match problem["type"]:
        case "missing":
            return [f"{path} is missing"]
        case "extra_forbidden":
            key = str(loc[-1])
            known = [one for one in _known_keys(model, loc[:-1]) if one != key]  # another alternative may have it
            if key == "kind":
                return [f"this is a file of kind {shown(value)}; another kind is required here"]
            return [f"{path} is not a known key{meant(key, known)}"]
        case "invalid_key":
            return [f"{path} is not a known key; keys are text"]
        case "value_error" if isinstance(context["error"], InputError):
            return [f"{path}: {line}" if path else line for line in as_typed(str(context["error"])).splitlines()]
        case "value_error":
            return [f"{path} {context['error']}".strip()]
        case "literal_error":
            words = re.findall(r"'(.*?)'", context["expected"])
            if "<name>" in loc:
                # The material of a tube is a name or a mapping; pydantic only lists the names.
                words.append("a mapping with its keys")
            return [f"{path} is {shown(value)}; it must be {_either(words)}{nearest(value, words)}"]
        case "too_short":
            return [f"{path} has {_items(context['actual_length'])}; it must have at least {context['min_length']}"]
        case "too_long":
            return [f"{path} has {_items(context['actual_length'])}; it must have at most {context['max_length']}"]
        case "string_too_short":
            return [f"{path} is empty; it must be text"]
        case "union_tag_invalid" if tags := re.findall("<(.*?)>", context["expected_tags"]):
            return [f"{path} is {shown(value)}; it must be {_either([f'a {tag}' for tag in tags])}"]
        case "greater_than_equal":
            return [f"{path} is {shown(value)}; it must be at least {context['ge']}"]
        case "less_than_equal":
            return [f"{path} is {shown(value)}; it must be at most {context['le']}"]
        case kind if kind in _NOUNS:
            return [f"{path or 'it'} is {shown(value)}; it must be {_NOUNS[kind]}"]
        case _:  # pydantic's own words, which read "Input should be greater than 0"
            return [f"{path} is {shown(value)}; {problem['msg'].replace('Input should', 'it must')}"]


_NOUNS = {
    "model_type": "a mapping of keys to values",
    "dict_type": "a mapping of keys to values",
    "list_type": "a list",
    "string_type": "text",
    "bool_type": "true or false",
}


def path_of(loc: Sequence[int | str], names: Mapping[str, str] | None = None) -> str:
    """`tubes[1].outer_diameter_mm`, with the caller's `names` for the first part; parts in <> only tell pydantic's
    choices apart."""
    path = ""
    for part in loc:
        if isinstance(part, int):
            path += f"[{part}]"
        elif not part.startswith("<"):
            path += f".{part}" if path else (names or {}).get(part, part)
    return path


def _known_keys(model: type[BaseModel], loc: Sequence[int | str]) -> list[str]:
    """The keys that are known at a place in the data of `model`."""
    places = [model]
    for part in loc:
        inner = [one.model_fields[part].annotation for one in places if part in one.model_fields]
        # A list of alternatives has several models: all their keys are proposed.
        places = [found for annotation in inner for found in models(annotation)] or places
    return [key for one in places for key in one.model_fields]


def _either(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _items(count: int) -> str:
    return "1 item" if count == 1 else f"{count} items"
