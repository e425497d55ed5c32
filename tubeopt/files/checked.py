"""Checks of input data against a model: every problem at once, each in one sentence with its path.

Numbers that are probably in another unit cause warnings.
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

from ..errors import InputError, nearest, without_unit_warnings
from .field_metadata import Typical
from .shipped import resolve_file, shipped
from .units import (
    UNITS,
    ZERO_CELSIUS,
    alternative_units,
    decimal,
    in_input_units,
    shown,
    split_unit,
    suggest_key,
    to_si,
    unit_of,
    unit_text,
)

# --- unusual numbers --------------------------------------------------------------------------------------------------


def unusual_numbers(entry: BaseModel, path: str = "", *, names: Mapping[str, str] | None = None) -> Iterator[str]:
    """Sentences on numbers outside their typical range, in an entry and in its parts.

    Args:
        names: names of keys of the entry in messages, if they differ.
    """
    for key, typical in _typical_ranges(type(entry)):
        value = getattr(entry, key)
        if value is None:
            continue
        name = f"{path}{(names or {}).get(key, key)}"
        if typical is not None:
            yield from unusual(name, unit_of(key), value, typical)
        if isinstance(value, BaseModel):
            yield from unusual_numbers(value, f"{name}.")
        elif isinstance(value, list | tuple):
            for k, part in enumerate(value):
                if isinstance(part, BaseModel):
                    yield from unusual_numbers(part, f"{name}[{k}].")


@functools.lru_cache(maxsize=256)
def _typical_ranges(model: type[BaseModel]) -> tuple[tuple[str, Typical | None], ...]:
    """Keys with a typical range, and keys that may contain entries, with None."""
    ranges = []
    for key, field in model.model_fields.items():
        metadata = (*field.metadata, *metadata_in(field.annotation))
        typical = next((item for item in metadata if isinstance(item, Typical)), None)
        if typical is not None or any(True for _ in models(field.annotation)):
            ranges.append((key, typical))
    return tuple(ranges)


def models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models in a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models(part)


def metadata_in(annotation: Any) -> Iterator[Any]:
    """Metadata in an annotation and in its parts."""
    yield from getattr(annotation, "__metadata__", ())
    for part in get_args(annotation):
        yield from metadata_in(part)


def unusual(key: str, unit: str, value: Any, typical: Typical) -> Iterator[str]:
    """Sentence on a number outside its typical range. Of several, the largest counts: coordinates may be small."""
    numbers: Sequence[Decimal] = value if isinstance(value, list) else [value]
    if not numbers or not all(isinstance(number, Decimal) for number in numbers):
        return
    largest = max(numbers, key=abs)
    size = abs(to_si(largest, UNITS[unit] if unit else Decimal(1)))
    # 0 has no size: it is the same in every unit.
    if size == 0 or typical.minimum <= size <= typical.maximum:
        return
    listed = ", ".join(str(number) for number in numbers)
    sentence = f"{key} is {f'[{listed}]' if isinstance(value, list) else listed}"
    # Kelvin and Celsius differ by an offset; all other units by a factor.
    alike = [(other, scale, Decimal(0)) for other, scale in alternative_units(unit)]
    for other, scale, zero in [("K", Decimal(1), ZERO_CELSIUS)] if unit == "degC" else alike:
        if typical.minimum <= abs(to_si(largest - zero, scale)) <= typical.maximum:
            factor = scale / UNITS[unit]
            right = ", ".join(f"{float((number - zero) * factor):.6g}" for number in numbers)
            yield f"{sentence}; that would be usual in {unit_text(other) or 'parts of 1'}: was {right} meant?"
            return
    low, high = (f"{bound / float(UNITS[unit] if unit else 1):.4g}" for bound in (typical.minimum, typical.maximum))
    yield f"{sentence}; usual is {low} to {high}"


# --- keys and their values --------------------------------------------------------------------------------------------

LOGGER = logging.getLogger(__name__)

Number = Annotated[Decimal, BeforeValidator(decimal)]
"""Finite number as written in the file; neither text nor true/false."""

Positive = Annotated[Decimal, Field(gt=0), BeforeValidator(decimal)]
NotNegative = Annotated[Decimal, Field(ge=0), BeforeValidator(decimal)]


def _whole(value: object) -> int:
    number = decimal(value)
    # 12.0 is a whole number too: spreadsheets write it so.
    if number != number.to_integral_value():
        raise ValueError(f"is {shown(value)}; it must be a whole number")
    return int(number)


Whole = Annotated[int, BeforeValidator(_whole)]
"""Whole number."""

Count = Annotated[Whole, Field(ge=1)]
"""Whole number, at least 1."""


def as_many(count: int, value: object, what: str = "") -> object:
    """Check the number of values in a list; raises ValueError with a message that continues the key's name."""
    if isinstance(value, (list, tuple)) and len(value) != count:
        raise ValueError(f"has {len(value)} number{'' if len(value) == 1 else 's'}; it must have {count}{what}")
    return value


def three(value: object) -> object:
    """Check that a list has three values; raises ValueError with a message that continues the key's name."""
    return as_many(3, value, ": x, y, z")


Triple = Annotated[list[Number], Field(min_length=3, max_length=3), BeforeValidator(three)]
"""Coordinates x, y and z."""


class Entry(BaseModel):
    """Mapping in a file. Keys have their unit as suffix; unknown keys are refused.

    Validators raise InputError with a whole sentence, or ValueError with a message that continues the key's name.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, defer_build=True)

    def si(self, key: str) -> Any:
        """Value of a key with numbers in SI, lists as tuples."""
        return _in_si(getattr(self, key), unit_of(key))

    def in_si(self, *keys: str) -> dict[str, Any]:
        """Values of several keys in SI, by the names of the keys without units."""
        return {split_unit(key)[0]: self.si(key) for key in keys}


def require_one(study: Entry, first: str, second: str) -> None:
    """Raise ValueError unless a study has exactly one of two keys."""
    present = {getattr(study, key) is not None for key in (first, second)}
    if present == {False}:
        raise ValueError(f"{first} and {second} are missing; one of them must be given")
    if present == {True}:
        raise ValueError(f"{first} and {second} are given; it must be one of them")


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
    """Mark a key as the path of a file, relative to the file with the key, or as a built-in name.

    The value of the key is the content of the file.

    Args:
        read: function that reads the file.
        what: description of the file for messages.
        kind: type of a value that is accepted in place of a path: a sweep has read the file already.
        of: earlier key whose value is a second argument of `read`.
        named: the value is the pair of path and content.
    """

    def _load(value: object, info: ValidationInfo) -> Any:
        if kind is not None and isinstance(value, kind):
            return value
        if not isinstance(value, str):
            raise ValueError(f"is {shown(value)}; it must be the path of {what}")
        path = resolve_file(value, info.context["directory"]) if info.context else resolve_file(value)
        if info.context:
            # A built-in file is stored by name, so that a command that repeats the study runs anywhere.
            info.context["files"][info.field_name] = value if shipped().get(value) == path else str(path)
        # Pydantic checks keys in their order: an invalid earlier key is absent here.
        if of and of not in info.data:
            return None
        content = read(path, info.data[of]) if of else read(path)
        return (str(path), content) if named else content

    return PlainValidator(_load, json_schema_input_type=str)


Model = TypeVar("Model", bound=BaseModel)


def check(
    model: type[Model],
    data: object,
    where: str | PathLike[str],
    *,
    names: Mapping[str, str] | None = None,
    kinds: Mapping[str, type[BaseModel]] | None = None,
) -> Model:
    """Build an instance of `model` from data.

    Numbers outside their typical range are logged as warnings, with the unit that was probably meant.

    Args:
        where: path of the file with the data; messages begin with it, and paths in the data are relative to it.
        names: names in messages of top-level keys that are not from this file; "" omits the key.
        kinds: models of other kinds of file, which may have a key that this one lacks.

    Raises:
        InputError: one line per problem.
    """
    try:
        with without_unit_warnings():
            # The library warns in SI units. The sentences below warn once, with key and unit of the file.
            entry = model.model_validate(data, context={"directory": Path(where).parent, "files": {}})
    except ValidationError as error:
        problems = error.errors(include_url=False)
    else:
        for sentence in unusual_numbers(entry, names=names):
            LOGGER.warning(f"{where}: {sentence}" if str(where) else sentence)
        return entry
    names = names or {}
    of_kind = [problem for problem in problems if problem["loc"] == ("kind",)]
    if of_kind and "kind" not in names:  # in a file of another kind all keys are wrong
        problems = of_kind
    sentences = []
    for problem in problems:
        # A flag is in no file: its message begins with the flag.
        prefix = f"{where}: " if str(where) and problem["loc"][:1] not in {(name,) for name in names} else ""
        sentences += [prefix + sentence for sentence in _sentences(model, dict(problem), names, kinds or {})]
    raise InputError("\n".join(sentences))


ROBOT_FILE_KINDS = ("concentric", "eccentric", "segmented_eccentric", "bundle")
"""Kinds of robot files, a common mistake for a study file."""


def check_kind(
    kinds: Mapping[str, type[Model]],
    data: object,
    where: str | PathLike[str],
    *,
    names: Mapping[str, str] | None = None,
) -> Model:
    """Build an instance of the model of the key `kind`; `names` and InputError as in `check`."""
    prefix = f"{where}: " if str(where) else ""
    if not isinstance(data, Mapping):
        raise InputError(f"{prefix}the data are {shown(data)}; they must be a mapping of keys to values")
    allowed = f"it must be {_either(list(kinds))}"
    if "kind" not in data:
        raise InputError(f"{prefix}kind is missing; {allowed}")
    kind = data["kind"]
    if not isinstance(kind, str) or kind not in kinds:
        hint = nearest(kind, kinds)
        if kind in ROBOT_FILE_KINDS and any("robot" in model.model_fields for model in kinds.values()):
            hint = "; a robot is named by the key robot of such a file"
        elif kind in ROBOT_FILE_KINDS:
            hint = f"; this is a robot file, and a {_either(list(kinds))} file is required"
        raise InputError(f"{prefix}kind is {shown(kind)}; {allowed}{hint}")
    return check(kinds[kind], data, where, names=names, kinds=kinds)


def _sentences(
    model: type[BaseModel],
    problem: Mapping[str, Any],
    names: Mapping[str, str],
    kinds: Mapping[str, type[BaseModel]],
) -> list[str]:
    """Sentences on a problem: path, value, and allowed values. A file named in the data may have several."""
    loc: Sequence[int | str] = problem["loc"]
    path, value, context = path_of(loc, names), problem["input"], problem.get("ctx", {})
    match problem["type"]:
        case "missing":
            return [f"{path} is missing"]
        case "extra_forbidden":
            key = str(loc[-1])
            known = [name for name in _known_keys(model, loc[:-1]) if name != key]  # another alternative may have it
            if key == "kind":
                return [f"this is a file of kind {shown(value)}; another kind is required here"]
            owners = [kind for kind, other in kinds.items() if len(loc) == 1 and key in other.model_fields]
            elsewhere = f"; it is one of kind: {_either(owners)}" if owners else ""
            return [f"{path} is not a known key{suggest_key(key, known) or elsewhere}"]
        case "invalid_key":
            return [f"{path} is not a known key; keys are text"]
        case "value_error" if isinstance(context["error"], InputError):
            return [f"{path}: {line}" if path else line for line in in_input_units(str(context["error"])).splitlines()]
        case "value_error":
            return [f"{path} {context['error']}".strip()]
        case "literal_error":
            expected = re.findall(r"'(.*?)'", context["expected"])
            if "<name>" in loc:
                # The material of a tube is a name or a mapping; pydantic only lists the names.
                expected.append("a mapping with its keys")
            return [f"{path} is {shown(value)}; it must be {_either(expected)}{nearest(value, expected)}"]
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
    """Path of a value, such as `tubes[1].outer_diameter_mm`; the first part is replaced by its name in `names`."""
    path = ""
    for part in loc:
        if isinstance(part, int):
            path += f"[{part}]"
        elif not part.startswith("<"):  # the tag of an alternative
            path += f".{part}" if path else (names or {}).get(part, part)
    return path


def _known_keys(model: type[BaseModel], loc: Sequence[int | str]) -> list[str]:
    """Keys that are allowed at a location in the data of `model`."""
    alternatives = [model]
    for part in loc:
        annotations = [each.model_fields[part].annotation for each in alternatives if part in each.model_fields]
        # A list of alternatives has several models: all their keys are proposed.
        alternatives = [inner for annotation in annotations for inner in models(annotation)] or alternatives
    return [key for each in alternatives for key in each.model_fields]


def _either(alternatives: Sequence[str]) -> str:
    return alternatives[0] if len(alternatives) == 1 else f"{', '.join(alternatives[:-1])} or {alternatives[-1]}"


def _items(count: int) -> str:
    return "1 item" if count == 1 else f"{count} items"
