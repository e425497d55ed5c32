"""Representation of public objects: one line as text, a table with a picture in notebooks.

Every public data class derives from `Displayed`. Table and picture come from `show.notebook`, which is imported on
first use, so that robots and answers do not depend on plots.
"""

from __future__ import annotations

import dataclasses
from enum import Enum
from typing import Any, ClassVar

import numpy as np

from .typing import lazy_import

MAX_LENGTH = 160
"""Approximate length of a line; further fields are omitted."""

MAX_MEMBERS = 6
"""Largest length of an array or list for which the members are shown."""


class Displayed:
    """Base of data classes with a short text, and a table with a picture in notebooks."""

    _brief: ClassVar[tuple[str, ...]] = ()
    """Attributes in the line; () for all fields that differ from their defaults."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in cls.__dict__:
            cls.__repr__ = Displayed.__repr__  # type: ignore[method-assign]  # before dataclass would write its own

    def __repr__(self) -> str:
        return short_repr(self)

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, Any]:
        """Formats for a notebook: HTML with table and picture, and the picture alone for other readers."""
        shown: dict[str, Any] = lazy_import("tubeopt.show.notebook.shown")(self)
        return shown

    def _repr_html_(self) -> str:
        """Table and picture as HTML."""
        page: str = self._repr_mimebundle_()["text/html"]
        return page

    def _repr_png_(self) -> bytes | None:
        """Picture as PNG; None without one."""
        picture: bytes | None = lazy_import("tubeopt.show.notebook.png")(self)
        return picture


def short_repr(answer: Displayed) -> str:
    """Class and fields of an object, in about `MAX_LENGTH` characters."""
    shown: list[str] = []
    for name, value in _fields(answer):
        text = f"{name}={brief(value)}"
        # At least one field is shown, however long.
        if shown and sum(map(len, shown)) + len(text) > MAX_LENGTH:
            shown.append("...")
            break
        shown.append(text)
    return f"{type(answer).__name__}({', '.join(shown)})"


def _fields(answer: Displayed) -> list[tuple[str, Any]]:
    brief = getattr(answer, "_brief", ())
    if brief:
        return [(name, getattr(answer, name)) for name in brief]
    shown = []
    for field in dataclasses.fields(answer):  # type: ignore[arg-type]  # all derived classes are dataclasses
        value = getattr(answer, field.name)
        # Arrays have no scalar equality and are always shown.
        is_default = value is None or (isinstance(value, str | int | float | tuple) and value == field.default)
        if field.repr and not is_default:
            shown.append((field.name, value))
    return shown


def brief(value: Any) -> str:
    """Short text of a value: numbers to 6 digits, long lists by their size, objects by their name."""
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, np.ndarray):
        # Joint values and positions are shown, tables by their shape.
        few = value.ndim == 1 and value.size <= MAX_MEMBERS
        return brief(value.tolist()) if few else f"<{' x '.join(map(str, value.shape))} array>"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, str):
        return repr(value) if len(value) <= 40 else repr(value[:37] + "...")
    if isinstance(value, list | tuple):
        return _of_several(value)
    if isinstance(value, dict):
        return f"<{len(value)} keys>"
    if dataclasses.is_dataclass(value):
        name = getattr(value, "name", "")
        return f"<{type(value).__name__}{f' {name!r}' if name else ''}>"
    text = repr(value)
    return text if len(text) <= 40 else f"<{type(value).__name__}>"


def _of_several(values: list[Any] | tuple[Any, ...]) -> str:
    plain = all(isinstance(value, str | int | float | None) for value in values)
    if plain and len(values) <= MAX_MEMBERS:
        inside = ", ".join(map(brief, values))
        return f"[{inside}]" if isinstance(values, list) else f"({inside})"
    kinds = {type(value).__name__ for value in values}
    return f"<{len(values)} {kinds.pop() if len(kinds) == 1 else 'items'}>"


def in_full(value: Any) -> str:
    """Complete text of a value and its parts, equal only for equal values."""
    if isinstance(value, tuple):
        return f"({', '.join(map(in_full, value))}{',' * (len(value) == 1)})"
    if not dataclasses.is_dataclass(value):
        return repr(value)
    inside = (f"{field.name}={in_full(getattr(value, field.name))}" for field in dataclasses.fields(value))
    return f"{type(value).__qualname__}({', '.join(inside)})"
