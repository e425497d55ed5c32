"""YAML to begin with: data with what every key is behind it, and below them the keys that may follow, as comments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from .plausible import models
from .yaml_file import to_flow

INDENT = "  "


def commented(model: type[BaseModel], data: Mapping[str, Any], header: str) -> str:
    """The text of a YAML file that holds `data`, whose keys are those of `model`, below the comment `header`."""
    head = "".join(f"# {line}\n" for line in header.splitlines())
    return head + "".join(f"{line}\n" for line in _mapping([model], data))


def _mapping(alternatives: Sequence[type[BaseModel]], data: Mapping[str, Any], *, told: bool = False) -> Iterator[str]:
    """Lines of a mapping; without comments where they were `told` before."""
    fields = next((known for one in alternatives if data.keys() <= (known := _keys(one)).keys()), {})
    for key, value in data.items():
        field = fields.get(key)
        note = "" if told or field is None else _note(field)
        yield from _entry(key, value, note, () if field is None else tuple(models(field.annotation)), told)
    for key, field in fields.items():
        if not told and key not in data and not field.is_required():
            yield f"# {key}:{_default(field)}{_note(field)}"


def _keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """What a file calls the fields of a model -> the fields."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _entry(key: str, value: Any, note: str, inner: Sequence[type[BaseModel]], told: bool) -> Iterator[str]:
    if isinstance(value, Mapping) and inner:
        yield f"{key}:{note}"
        yield from (INDENT + line for line in _mapping(inner, value, told=told))
    elif isinstance(value, list) and value and isinstance(value[0], Mapping) and inner:
        yield f"{key}:{note}"
        for k, each in enumerate(value):
            first, *rest = _mapping(inner, each, told=told or k > 0)
            yield f"{INDENT}- {first}"
            yield from (2 * INDENT + line for line in rest)
    else:
        yield f"{key}: {to_flow(value)}{note}"


def _note(field: FieldInfo) -> str:
    return f"  # {' '.join(field.description.split())}" if field.description else ""


def _default(field: FieldInfo) -> str:
    """What stands for a key that is left out, where it is a number or a word."""
    value = field.get_default(call_default_factory=True)
    return "" if value is None or isinstance(value, BaseModel | tuple) or value == [] else f" {to_flow(value)}"
