"""Arguments of a wrong type, refused where they enter: `typed` checks them by the annotations that are there anyway."""

from __future__ import annotations

import functools
import inspect
import os
import reprlib
import sys
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from decimal import Decimal
from numbers import Real
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .errors import InputError

T = TypeVar("T", bound=Callable[..., Any])


class Check(NamedTuple):
    """Whether a value is of a type, and what it must be, in words."""

    holds: Callable[[Any], bool]
    words: str


def typed(made: T) -> T:
    """A function or a dataclass that raises InputError for an argument of another type than its annotation says.

    It names the argument, what it is, and what it must be. Types alone are checked: ranges are left to what is called.
    An annotation that says nothing (`Any`, a type variable) is not checked, nor is a default. Truths are no numbers,
    and texts are no lists.
    """
    is_class = isinstance(made, type)
    called: Callable[..., Any] = made.__init__ if is_class else made  # type: ignore[misc]
    names = tuple(inspect.signature(called).parameters)
    checks: dict[str, Check] = {}

    def prepare() -> dict[str, Check]:
        # When it is first called: annotations may name what is imported later.
        if not checks:
            checks.update(_checks(made))
        return checks

    @functools.wraps(called)
    def checked(*args: Any, **given: Any) -> Any:
        known = checks or prepare()
        for name, value in zip(names, args, strict=False):
            if name in known and not known[name].holds(value):
                raise _refused(name, value, known[name].words)
        for name, value in given.items():
            if name in known and not known[name].holds(value):
                raise _refused(name, value, known[name].words)
        return called(*args, **given)

    if is_class:
        made.__init__ = checked  # type: ignore[misc]
        return made
    return checked  # type: ignore[return-value]


def _refused(name: str, value: Any, words: str) -> InputError:
    return InputError(f"{name} is {reprlib.repr(value)}; it must be {words}")


def _checks(made: Any) -> dict[str, Check]:
    """The checks of annotations that name types which can be told at run time; "return" and "self" are none."""
    owners: tuple[Any, ...] = (made,)
    if isinstance(made, type):
        owners = made.__mro__[::-1] if is_dataclass(made) else (inspect.unwrap(made.__init__),)  # type: ignore[misc]
    found: dict[str, Check] = {}
    for one in owners:
        names = sys.modules[one.__module__].__dict__
        for name, hint in inspect.get_annotations(one).items():
            try:
                check = _check_of(eval(hint, names) if isinstance(hint, str) else hint)
            except (NameError, AttributeError):  # a name for type checkers alone
                check = None
            found.pop(name, None)
            if check is not None:
                found[name] = check
    found.pop("return", None)
    return found


def _check_of(hint: Any) -> Check | None:
    """The check of a type; None where everything passes."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _check_of(parts[0])
    if hint is Any or hint is object:
        return None
    if hint is None or hint is type(None):
        return Check(lambda value: value is None, "None")
    if hint in SIMPLE:
        return SIMPLE[hint]
    if origin in (typing.Union, types.UnionType):
        return _either(parts)
    if origin is typing.Literal:
        return Check(lambda value: value in parts, "one of " + ", ".join(map(repr, parts)))
    if origin is np.ndarray or hint is np.ndarray:
        return NUMBERS
    if origin is tuple and parts[-1:] != (...,):
        return _fixed(parts)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return Check(lambda value: isinstance(value, Mapping), "a dict")
    if origin is Callable or origin is type(Callable) or (isinstance(origin, type) and issubclass(origin, Callable)):  # type: ignore[arg-type]
        return Check(callable, "a function")
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return _list(_check_of(parts[0]) if parts else None)
    if isinstance(origin or hint, type):
        return _instance(origin or hint)
    return None


def _either(parts: tuple[Any, ...]) -> Check | None:
    arrays = set(typing.get_args(ArrayLike))
    left = list(parts)
    found: list[Check] = []
    if arrays <= set(parts):
        left = [part for part in parts if part not in arrays]
        found.append(NUMBERS)
    for part in sorted(left, key=lambda part: part is type(None)):
        check = _check_of(part)
        if check is None:
            return None
        found.append(check)
    holds = tuple(each.holds for each in found)
    return Check(
        lambda value: any(one(value) for one in holds), " or ".join(dict.fromkeys(each.words for each in found))
    )


def _fixed(parts: tuple[Any, ...]) -> Check:
    """Of so many values, each of its own type; how many numbers there must be is left to what is called."""
    if set(parts) <= {float}:
        return NUMBERS
    each = [_check_of(part) for part in parts]

    def holds(value: Any) -> bool:
        if not _several(value) or len(value) != len(each):
            return False
        return all(check is None or check.holds(item) for check, item in zip(each, value, strict=True))

    words = dict.fromkeys("anything" if check is None else check.words for check in each)
    return Check(holds, f"{len(each)} values, each {next(iter(words))}" if len(words) == 1 else f"({', '.join(words)})")


def _list(item: Check | None) -> Check:
    def holds(value: Any) -> bool:
        if not _several(value):
            return isinstance(value, Iterator)  # which can be read only once
        return item is None or all(item.holds(each) for each in value)

    return Check(holds, "a list" if item is None else f"a list, each {item.words}")


def _several(value: Any) -> bool:
    """Whether a value has members in an order: a list, no text and no dict."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Iterable) and hasattr(value, "__len__") and not isinstance(value, str | bytes | Mapping)


def _instance(wanted: type) -> Check:
    words = getattr(wanted, "_asked_for", "") or f"{'an' if wanted.__name__[0] in 'AEIOU' else 'a'} {wanted.__name__}"
    if getattr(wanted, "_is_protocol", False):
        members = [name for base in wanted.__mro__ if getattr(base, "_is_protocol", False) for name in vars(base)]
        needed = [name for name in members if not name.startswith("_")]
        return Check(lambda value: all(hasattr(value, name) for name in needed), words)
    return Check(lambda value: isinstance(value, wanted), words)


def _numeric(value: Any) -> bool:
    """Whether a value is a number, or a table of such whose rows are equally long."""
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "fiu" or (value.dtype.kind == "O" and value.size == 0)
    if isinstance(value, list | tuple):
        if not value or _number(value[0]):
            return all(map(_number, value))
        return all(map(_numeric, value)) and len({np.shape(row) for row in value}) == 1
    if _number(value):
        return True
    if (isinstance(value, Sequence) and not isinstance(value, str | bytes)) or hasattr(value, "__array__"):
        return np.asarray(value).dtype.kind in "fiu"
    return False


def _number(value: Any) -> bool:
    kind = type(value)
    if kind is float or kind is int:
        return True
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "fiu"
    return isinstance(value, Real | Decimal) and not isinstance(value, bool | np.bool_)


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


NUMBERS = Check(_numeric, "numbers")

SIMPLE: dict[Any, Check] = {
    float: Check(_number, "a number"),
    int: Check(_whole, "a whole number"),
    bool: Check(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    str: Check(lambda value: isinstance(value, str), "a text"),
    os.PathLike: Check(lambda value: isinstance(value, os.PathLike), "a path"),
    ArrayLike: NUMBERS,
}
"""Types with a check of their own."""
