"""How public objects show themselves: in one line where text is wanted, as a table with a picture in a notebook.

Every class of `tubeopt` that holds data derives from `Displayed`. The line is made here; table and picture come from
`show.notebook`, which is loaded when the first is asked for, so that a robot or an answer knows nothing of pictures.
"""

from __future__ import annotations

import dataclasses
from enum import Enum
from typing import Any, ClassVar

import numpy as np

from .typing import lazy_import

LENGTH = 160
"""Characters that a line holds before what is left of an object is left out."""

SMALL = 6
"""Numbers of an array, or members of a list, that are told one by one."""


class Displayed:
    """Data that show themselves in one line, and in a notebook as a table with a picture."""

    _brief: ClassVar[tuple[str, ...]] = ()
    """Attributes that the line tells; () for the fields in their order, without those that are as by default."""

    def __init_subclass__(cls, **given: Any) -> None:
        super().__init_subclass__(**given)
        if "__repr__" not in cls.__dict__:
            cls.__repr__ = Displayed.__repr__  # type: ignore[method-assign]  # before dataclass would write its own

    def __repr__(self) -> str:
        return short_repr(self)

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, Any]:
        """What a notebook shows, with the picture alone for a reader that takes no HTML: of one drawing."""
        shown: dict[str, Any] = lazy_import("tubeopt.show.notebook.shown")(self)
        return shown

    def _repr_html_(self) -> str:
        """Table and picture."""
        page: str = self._repr_mimebundle_()["text/html"]
        return page

    def _repr_png_(self) -> bytes | None:
        """The picture alone; None for what has none."""
        picture: bytes | None = lazy_import("tubeopt.show.notebook.png")(self)
        return picture


def short_repr(answer: Displayed) -> str:
    """Class and what an object is, in about `LENGTH` characters."""
    told: list[str] = []
    for name, value in _fields(answer):
        one = f"{name}={brief(value)}"
        # At least one field is shown, however long.
        if told and sum(map(len, told)) + len(one) > LENGTH:
            told.append("...")
            break
        told.append(one)
    return f"{type(answer).__name__}({', '.join(told)})"


def _fields(answer: Displayed) -> list[tuple[str, Any]]:
    brief = getattr(answer, "_brief", ())
    if brief:
        return [(name, getattr(answer, name)) for name in brief]
    fields = dataclasses.fields(answer)  # type: ignore[arg-type]  # they are dataclasses, which no type says
    shown = [(field, getattr(answer, field.name)) for field in fields if field.repr]
    return [(field.name, value) for field, value in shown if not _is_default(value, field)]


def _is_default(value: Any, field: dataclasses.Field[Any]) -> bool:
    """Whether a field is left as it was; arrays, which say not whether they are equal, never are."""
    return value is None or (isinstance(value, str | int | float | tuple) and value == field.default)


def brief(value: Any) -> str:
    """A value in a few characters: numbers to 6 digits, long lists by their size, objects by their name."""
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, np.ndarray):
        # Joint values and positions are shown, tables by their shape.
        few = value.ndim == 1 and value.size <= SMALL
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
    if plain and len(values) <= SMALL:
        inside = ", ".join(map(brief, values))
        return f"[{inside}]" if isinstance(values, list) else f"({inside})"
    kinds = {type(value).__name__ for value in values}
    return f"<{len(values)} {kinds.pop() if len(kinds) == 1 else 'items'}>"


def in_full(value: Any) -> str:
    """All that a value holds, and what its parts hold, as text: what tells it from every other."""
    if isinstance(value, tuple):
        return f"({', '.join(map(in_full, value))}{',' * (len(value) == 1)})"
    if not dataclasses.is_dataclass(value):
        return repr(value)
    inside = (f"{field.name}={in_full(getattr(value, field.name))}" for field in dataclasses.fields(value))
    return f"{type(value).__qualname__}({', '.join(inside)})"
