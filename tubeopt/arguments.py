"""Arguments of a wrong type, refused where they enter: `typed` checks them by the annotations that are there anyway."""

from __future__ import annotations

import functools
import inspect
import os
import reprlib
import sys
import types
import typing
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from decimal import Decimal
from numbers import Real
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from .errors import InputError

T = TypeVar("T", bound=Callable[..., Any])


class Check(NamedTuple):
    """Whether a value is of a type, and what it must be, in words; of a list the check is `late`."""

    holds: Callable[[Any], bool]
    words: str
    late: bool = False


def typed(made: T) -> T:
    """A function or a dataclass that raises InputError for an argument of another type than its annotation says.

    It names the argument, what it is, and what it must be. Types alone are checked: ranges are left to what is called,
    and so is what a list holds, unless what is called fails of it: it knows better how many of what there must be.
    An annotation that says nothing (`Any`, a type variable) is not checked, nor is a default. Truths are no numbers,
    and texts are no lists.
    """
    is_class = isinstance(made, type)
    called: Callable[..., Any] = made.__init__ if is_class else made
    names = tuple(inspect.signature(called).parameters)
    checks: dict[str, Check] = {}
    lists: dict[str, Check] = {}
    placed: list[tuple[int, str, Check]] = []
    ready = False

    def prepare() -> None:
        """When it is first called: annotations may name what is imported later."""
        nonlocal ready
        every = _checks(made)
        checks.update({name: check for name, check in every.items() if not check.late})
        lists.update({name: check for name, check in every.items() if check.late})
        placed[:] = [(k, name, checks[name]) for k, name in enumerate(names) if name in checks]
        ready = True

    @functools.wraps(called)
    def checked(*args: Any, **given: Any) -> Any:
        """What the function returns for arguments of the right types."""
        if not ready:
            prepare()
        count = len(args)
        # A solve takes about 35 us: positions are compared without binding a signature.
        for k, name, check in placed:
            if k >= count:
                break
            if not check.holds(args[k]):
                raise _refused(name, args[k], check.words)
        for name, value in given.items():
            if name in checks and not checks[name].holds(value):
                raise _refused(name, value, checks[name].words)
        try:
            return called(*args, **given)
        except InputError:
            raise
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):
            # Long lists are checked only after a failure: checking every member at each call would take longer than a
            # solve.
            for name, value in (*zip(names, args, strict=False), *given.items()):
                if name in lists and not lists[name].holds(value):
                    raise _refused(name, value, lists[name].words) from None
            raise

    if is_class:
        setattr(made, "__init__", checked)  # noqa: B010
        return made
    return checked  # type: ignore[return-value]


def renamed(**names: str) -> Callable[[T], T]:
    """A function that still accepts old names of keywords, given as old="new", and warns that they will end."""

    def of(function: T) -> T:
        @functools.wraps(function)
        def asked(*args: Any, **given: Any) -> Any:
            """What the function returns, for keywords by either name."""
            for old in names.keys() & given.keys():
                new = names[old]
                if new in given:
                    raise InputError(f"{old} and {new} are the same argument; give {new} only")
                words = f"{old}= is now {new}= in {function.__qualname__.removesuffix('.__init__')}"
                warnings.warn(f"{words}; {old}= ends with the next release", DeprecationWarning, stacklevel=2)
                given[new] = given.pop(old)
            return function(*args, **given)

        return asked  # type: ignore[return-value]

    return of


def _refused(name: str, value: Any, words: str) -> InputError:
    return InputError(f"{name} is {reprlib.repr(value)}; it must be {words}")


def _checks(made: Any) -> dict[str, Check]:
    """The checks of annotations that name types which can be told at run time; "return" and "self" are none."""
    owners: tuple[Any, ...] = (made,)
    if isinstance(made, type):
        owners = made.__mro__[::-1] if is_dataclass(made) else (inspect.unwrap(made.__init__),)  # type: ignore[misc]
    found: dict[str, Check] = {}
    for one in owners:
        # Annotations are strings, and mean what they mean in the module of their class.
        names = sys.modules[one.__module__].__dict__
        for name, hint in inspect.get_annotations(one).items():
            try:
                check = _check_of(eval(hint, names) if isinstance(hint, str) else hint)
            except (NameError, AttributeError):  # a name for type checkers alone
                check = None
            # A derived class may change the type of a field of its base.
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
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return Check(lambda value: isinstance(value, Mapping), "a dict")
    if origin is Callable or origin is type(Callable) or (isinstance(origin, type) and issubclass(origin, Callable)):  # type: ignore[arg-type]
        return Check(callable, "a function")
    if hint is np.ndarray or origin is np.ndarray:
        return NUMBERS
    if origin is tuple and parts[-1:] != (...,):
        return _fixed(parts)
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return _list(_check_of(parts[0]) if parts else None)
    if isinstance(origin or hint, type):
        return _instance(origin or hint)
    return None


def _either(parts: tuple[Any, ...]) -> Check | None:
    found: list[Check] = []
    # `ArrayLike` is a union itself: its members become one check with one word.
    if set(typing.get_args(ArrayLike)) <= set(parts):
        parts = tuple(part for part in parts if part not in typing.get_args(ArrayLike))
        found.append(NUMBERS)
    # None goes last: "a number or None".
    for part in sorted(parts, key=lambda part: part is type(None)):
        check = _check_of(part)
        if check is None:
            return None
        found.append(check)
    words, late = " or ".join(dict.fromkeys(each.words for each in found)), any(each.late for each in found)
    if len(found) == 2:  # as most are: without a generator, since a solve checks a guess
        first, second = found[0].holds, found[1].holds
        return Check(lambda value: first(value) or second(value), words, late)
    return Check(lambda value: any(each.holds(value) for each in found), words, late)


def _fixed(parts: tuple[Any, ...]) -> Check:
    """Of so many values, each of its own type."""
    each = [_check_of(part) for part in parts]

    def holds(value: Any) -> bool:
        """Whether a value is a list of as many values, each of its own type."""
        if not _several(value) or len(value) != len(each):
            return False
        return all(check is None or check.holds(item) for check, item in zip(each, value, strict=True))

    words = dict.fromkeys("anything" if check is None else check.words for check in each)
    if list(words) == ["anything"]:
        return Check(holds, f"{len(each)} values", True)
    return Check(holds, f"{len(each)} values: {', '.join(words)}", True)


def _list(item: Check | None) -> Check:
    def holds(value: Any) -> bool:
        """Whether a value is a list whose members are all of one type."""
        if not _several(value):
            return isinstance(value, Iterator)  # which can be read only once
        return item is None or all(item.holds(each) for each in value)

    return Check(holds, "a list" if item is None else f"a list, each {item.words}", True)


def _several(value: Any) -> bool:
    """Whether a value has members in an order: a list, no text and no dict."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Iterable) and hasattr(value, "__len__") and not isinstance(value, str | bytes | Mapping)


def _numeric(value: Any) -> bool:
    """Whether a value is a number, or a table of such whose rows are equally long."""
    if isinstance(value, list | tuple):
        return all(map(_numeric, value)) and len({np.shape(row) for row in value}) <= 1
    # Arrays of truth values, texts and objects are no numbers, though NumPy converts some of them.
    return _number(value) or (hasattr(value, "__array__") and np.asarray(value).dtype.kind in "fiu")


def _instance(wanted: type) -> Check:
    words = vars(wanted).get("_asked_for") or f"{'an' if wanted.__name__[0] in 'AEIOU' else 'a'} {wanted.__name__}"
    if getattr(wanted, "_is_protocol", False):
        members = [name for base in wanted.__mro__ if getattr(base, "_is_protocol", False) for name in vars(base)]
        # `isinstance` with a protocol takes longer, and needs it to be checkable at run time.
        needed = [name for name in members if not name.startswith("_")]
        return Check(lambda value: all(hasattr(value, name) for name in needed), words)
    return Check(_of(wanted), words)


def _of(wanted: type) -> Callable[[Any], bool]:
    """`isinstance`, which takes long for abstract classes: types that were seen are remembered."""
    seen: set[type] = set()

    def holds(value: Any) -> bool:
        """Whether a value is of the type."""
        kind = type(value)
        if kind in seen:
            return True
        if isinstance(value, wanted):
            seen.add(kind)
            return True
        return False

    return holds


MOST = 10**12
"""Whole numbers are smaller: they count, or begin a sequence of random numbers."""


def _number(value: Any) -> bool:
    kind = type(value)
    if kind is float or kind is int:
        return True
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "fiu"
    return isinstance(value, Real | Decimal) and not isinstance(value, bool | np.bool_)


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and -MOST < int(value) < MOST


NUMBERS = Check(_numeric, "numbers", True)

SIMPLE: dict[Any, Check] = {
    float: Check(_number, "a number"),
    int: Check(_whole, "a whole number"),
    bool: Check(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    str: Check(lambda value: isinstance(value, str), "a text"),
    ArrayLike: NUMBERS,
    os.PathLike: Check(lambda value: isinstance(value, os.PathLike), "a path"),
}
"""Types with a check of their own."""
