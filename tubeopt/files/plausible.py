"""Numbers that were probably meant in another unit, by what their fields say is usual."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any, get_args

from pydantic import BaseModel

from .field_metadata import Typical
from .units import UNITS, ZERO_CELSIUS, in_words, others, to_si, unit_of


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
    if size == 0 or usual.least <= size <= usual.most:
        return
    shown = ", ".join(str(number) for number in numbers)
    sentence = f"{key} is {f'[{shown}]' if isinstance(value, list) else shown}"
    meant_in = [(meant, scale, Decimal(0)) for meant, scale in others(unit)]
    for meant, scale, zero in [("K", Decimal(1), ZERO_CELSIUS)] if unit == "degC" else meant_in:
        if usual.least <= abs(to_si(largest - zero, scale)) <= usual.most:
            factor = scale / UNITS[unit]
            right = ", ".join(f"{float((number - zero) * factor):.6g}" for number in numbers)
            yield f"{sentence}; that would be usual in {in_words(meant) or 'parts of 1'}: was {right} meant?"
            return
    low, high = (f"{bound / float(UNITS[unit] if unit else 1):.4g}" for bound in (usual.least, usual.most))
    yield f"{sentence}; usual is {low} to {high}"
