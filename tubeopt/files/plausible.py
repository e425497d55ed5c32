"""Units that were probably mistaken: numbers that no such thing has, and known keys with the ending of another unit."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any, get_args

from pydantic import BaseModel

from .marks import Usual
from .units import UNITS, to_si, unit_of

ALIKE = (
    {"m": Decimal(1), "cm": Decimal("1e-2"), "mm": Decimal("1e-3"), "um": Decimal("1e-6"), "inch": Decimal("0.0254")},
    {"Pa": Decimal(1), "MPa": Decimal("1e6"), "GPa": Decimal("1e9"), "kPa": Decimal("1e3")},
    {"per_mm": Decimal(1000), "per_m": Decimal(1), "per_cm": Decimal(100)},
    {"s": Decimal(1), "ms": Decimal("1e-3"), "min": Decimal(60), "h": Decimal(3600)},
    {"N": Decimal(1), "mN": Decimal("1e-3")},
    {"rad": Decimal(1), "deg": UNITS["deg"]},
)
"""Units that are taken for one another, the likeliest first -> each in SI."""


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
            yield from _unusual(here, unit_of(key), value, usual)
        for place, part in _parts(value):
            yield from suspects(part, f"{here}{place}.")


@functools.lru_cache(maxsize=256)
def _looked_at(model: type[BaseModel]) -> tuple[tuple[str, Usual | None], ...]:
    """Keys whose numbers have a usual range, and keys that may hold entries of their own, for which it is None."""
    found = []
    for key, field in model.model_fields.items():
        marks = (*field.metadata, *_marks(field.annotation))
        usual = next((mark for mark in marks if isinstance(mark, Usual)), None)
        if usual is not None or any(True for _ in models(field.annotation)):
            found.append((key, usual))
    return tuple(found)


def models(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models in a type."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models(part)


def _marks(annotation: Any) -> Iterator[Any]:
    """What is said beside the types in an annotation."""
    yield from getattr(annotation, "__metadata__", ())
    for part in get_args(annotation):
        yield from _marks(part)


def _parts(value: Any) -> Iterator[tuple[str, BaseModel]]:
    if isinstance(value, BaseModel):
        yield "", value
    elif isinstance(value, list | tuple):
        yield from ((f"[{k}]", part) for k, part in enumerate(value) if isinstance(part, BaseModel))


def _unusual(key: str, unit: str, value: Any, usual: Usual) -> Iterator[str]:
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
    for meant, scale in _others(unit):
        if usual.least <= abs(to_si(largest, scale)) <= usual.most:
            factor = scale / UNITS[unit]
            right = ", ".join(f"{float(number * factor):.6g}" for number in numbers)
            yield f"{sentence}; that would be usual in {meant.replace('per_', '1/')}: was {right} meant?"
            return
    low, high = (f"{bound / float(UNITS[unit] if unit else 1):.4g}" for bound in (usual.least, usual.most))
    yield f"{sentence}; usual is {low} to {high}"


def _others(unit: str) -> Iterator[tuple[str, Decimal]]:
    """Units that are taken for one, the likeliest first, and each in SI."""
    for group in ALIKE:
        if unit in group:
            yield from ((name, size) for name, size in group.items() if name != unit)


def converted(key: str, known: Iterable[str]) -> str:
    """How a key with another unit is written, as "; did you mean 'curvature_per_m', 1000 times the number?"."""
    for right in known:
        unit = unit_of(right)
        for other, size in _others(unit) if unit else ():
            if key == f"{right.removesuffix(unit)}{other}":
                factor = size / UNITS[unit]
                return f"; did you mean {right!r}, {float(factor):.6g} times the number?"
    return ""
