"""Checks of argument types by annotations: the decorator `typed`."""

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


class ArgumentCheck(NamedTuple):
    """Check of a type."""

    holds: Callable[[Any], bool]
    """Test of a value."""
    expected: str
    """Description of allowed values, as "a number"."""
    deferred: bool = False
    """True if the check is slow and runs only after an error, as for lists."""


def typed(target: T) -> T:
    """Decorate a function or a dataclass: an argument of another type than its annotation raises InputError.

    The message has the argument, its value and the expected type. Ranges are not checked. Members of a list are checked
    only if the call fails: its own messages are better. `Any`, type variables and defaults are not checked. Truth
    values are no numbers, and texts are no lists.
    """
    is_class = isinstance(target, type)
    function: Callable[..., Any] = target.__init__ if is_class else target
    names = tuple(inspect.signature(function).parameters)
    checks: dict[str, ArgumentCheck] = {}
    lists: dict[str, ArgumentCheck] = {}
    positional: list[tuple[int, str, ArgumentCheck]] = []
    ready = False

    def prepare() -> None:
        """Build the checks at the first call: annotations may name types that are imported later."""
        nonlocal ready
        every = _checks(target)
        checks.update({name: check for name, check in every.items() if not check.deferred})
        lists.update({name: check for name, check in every.items() if check.deferred})
        positional[:] = [(k, name, checks[name]) for k, name in enumerate(names) if name in checks]
        ready = True

    @functools.wraps(function)
    def checked(*args: Any, **kwargs: Any) -> Any:
        """Call the function after the checks."""
        if not ready:
            prepare()
        count = len(args)
        # A solve takes about 35 us: positions are compared without binding a signature.
        for k, name, check in positional:
            if k >= count:
                break
            if not check.holds(args[k]):
                raise _type_error(name, args[k], check)
        for name, value in kwargs.items():
            if name in checks and not checks[name].holds(value):
                raise _type_error(name, value, checks[name])
        try:
            return function(*args, **kwargs)
        except InputError:
            raise
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):
            # Checking every member of a list at each call would take longer than a solve.
            for name, value in (*zip(names, args, strict=False), *kwargs.items()):
                if name in lists and not lists[name].holds(value):
                    raise _type_error(name, value, lists[name]) from None
            raise

    if is_class:
        setattr(target, "__init__", checked)  # noqa: B010
        return target
    return checked  # type: ignore[return-value]


def renamed(**names: str) -> Callable[[T], T]:
    """Decorate a function to accept old names of keywords, given as old="new", with a DeprecationWarning."""

    def of(function: T) -> T:
        @functools.wraps(function)
        def with_new_names(*args: Any, **kwargs: Any) -> Any:
            """Call the function with the new names."""
            for old in names.keys() & kwargs.keys():
                new = names[old]
                if new in kwargs:
                    raise InputError(f"{old} and {new} are the same argument; give {new} only")
                change = f"{old}= is now {new}= in {function.__qualname__.removesuffix('.__init__')}"
                warnings.warn(f"{change}; {old}= ends with the next release", DeprecationWarning, stacklevel=2)
                kwargs[new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return with_new_names  # type: ignore[return-value]

    return of


def _type_error(name: str, value: Any, check: ArgumentCheck) -> InputError:
    return InputError(f"{name} is {reprlib.repr(value)}; it must be {check.expected}")


def _checks(target: Any) -> dict[str, ArgumentCheck]:
    """Checks of the annotations of a function or class: argument -> check."""
    owners: tuple[Any, ...] = (target,)
    if isinstance(target, type):
        owners = target.__mro__[::-1] if is_dataclass(target) else (inspect.unwrap(target.__init__),)  # type: ignore[misc]
    checks: dict[str, ArgumentCheck] = {}
    for owner in owners:
        # Annotations are strings, to be evaluated in the module of their class.
        names = sys.modules[owner.__module__].__dict__
        for name, hint in inspect.get_annotations(owner).items():
            try:
                check = _check_of(eval(hint, names) if isinstance(hint, str) else hint)
            except (NameError, AttributeError):  # a name for type checkers only
                check = None
            # A derived class may change the type of a field of its base.
            checks.pop(name, None)
            if check is not None:
                checks[name] = check
    checks.pop("return", None)
    return checks


def _check_of(hint: Any) -> ArgumentCheck | None:
    """Check of a type; None if every value passes."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        return _check_of(parts[0])
    if hint is Any or hint is object:
        return None
    if hint is None or hint is type(None):
        return ArgumentCheck(lambda value: value is None, "None")
    if hint in SIMPLE:
        return SIMPLE[hint]
    if origin in (typing.Union, types.UnionType):
        return _either(parts)
    if origin is typing.Literal:
        return ArgumentCheck(lambda value: value in parts, "one of " + ", ".join(map(repr, parts)))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return ArgumentCheck(lambda value: isinstance(value, Mapping), "a dict")
    if origin is Callable or origin is type(Callable) or (isinstance(origin, type) and issubclass(origin, Callable)):  # type: ignore[arg-type]
        return ArgumentCheck(callable, "a function")
    if hint is np.ndarray or origin is np.ndarray:
        return NUMBERS
    if origin is tuple and parts[-1:] != (...,):
        return _fixed(parts)
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return _list(_check_of(parts[0]) if parts else None)
    if isinstance(origin or hint, type):
        return _instance(origin or hint)
    return None


def _either(parts: tuple[Any, ...]) -> ArgumentCheck | None:
    checks: list[ArgumentCheck] = []
    # `ArrayLike` is a union itself: its members become one check with one word.
    if set(typing.get_args(ArrayLike)) <= set(parts):
        parts = tuple(part for part in parts if part not in typing.get_args(ArrayLike))
        checks.append(NUMBERS)
    # None goes last: "a number or None".
    for part in sorted(parts, key=lambda part: part is type(None)):
        check = _check_of(part)
        if check is None:
            return None
        checks.append(check)
    expected = " or ".join(dict.fromkeys(check.expected for check in checks))
    deferred = any(check.deferred for check in checks)
    if len(checks) == 2:  # the usual case, without a generator, since every solve checks its start
        first, second = checks[0].holds, checks[1].holds
        return ArgumentCheck(lambda value: first(value) or second(value), expected, deferred)
    return ArgumentCheck(lambda value: any(check.holds(value) for check in checks), expected, deferred)


def _fixed(parts: tuple[Any, ...]) -> ArgumentCheck:
    """Check of a fixed number of values, each with its own type."""
    checks = [_check_of(part) for part in parts]

    def holds(value: Any) -> bool:
        """True for a list of as many values with the right types."""
        if not _is_list(value) or len(value) != len(checks):
            return False
        return all(check is None or check.holds(item) for check, item in zip(checks, value, strict=True))

    expected = dict.fromkeys("anything" if check is None else check.expected for check in checks)
    if list(expected) == ["anything"]:
        return ArgumentCheck(holds, f"{len(checks)} values", True)
    return ArgumentCheck(holds, f"{len(checks)} values: {', '.join(expected)}", True)


def _list(item: ArgumentCheck | None) -> ArgumentCheck:
    def holds(value: Any) -> bool:
        """True for a list whose members have the right type."""
        if not _is_list(value):
            return isinstance(value, Iterator)  # which can be read only once
        return item is None or all(item.holds(member) for member in value)

    return ArgumentCheck(holds, "a list" if item is None else f"a list, each {item.expected}", True)


def _is_list(value: Any) -> bool:
    """True for ordered values, except text and dicts."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Iterable) and hasattr(value, "__len__") and not isinstance(value, str | bytes | Mapping)


def _numeric(value: Any) -> bool:
    """True for a number, or a table of numbers with rows of equal length."""
    if isinstance(value, list | tuple):
        return all(map(_numeric, value)) and len({np.shape(row) for row in value}) <= 1
    # Arrays of truth values, texts and objects are no numbers, though NumPy converts some of them.
    return _number(value) or (hasattr(value, "__array__") and np.asarray(value).dtype.kind in "fiu")


def _instance(kind: type) -> ArgumentCheck:
    expected = vars(kind).get("_asked_for") or f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
    if getattr(kind, "_is_protocol", False):
        members = [name for base in kind.__mro__ if getattr(base, "_is_protocol", False) for name in vars(base)]
        # `isinstance` with a protocol takes longer, and needs it to be checkable at run time.
        needed = [name for name in members if not name.startswith("_")]
        return ArgumentCheck(lambda value: all(hasattr(value, name) for name in needed), expected)
    # `isinstance` is slow for abstract classes: known types are cached.
    known: set[type] = set()

    def holds(value: Any) -> bool:
        """True for an instance of the class."""
        if type(value) in known:
            return True
        if isinstance(value, kind):
            known.add(type(value))
            return True
        return False

    return ArgumentCheck(holds, expected)


MAX_WHOLE = 10**12
"""Bound of whole numbers, which are counts or random seeds."""


def _number(value: Any) -> bool:
    kind = type(value)
    if kind is float or kind is int:
        return True
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "fiu"
    return isinstance(value, Real | Decimal) and not isinstance(value, bool | np.bool_)


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and -MAX_WHOLE < int(value) < MAX_WHOLE


NUMBERS = ArgumentCheck(_numeric, "numbers", True)

SIMPLE: dict[Any, ArgumentCheck] = {
    float: ArgumentCheck(_number, "a number"),
    int: ArgumentCheck(_whole, "a whole number"),
    bool: ArgumentCheck(lambda value: isinstance(value, bool | np.bool_), "True or False"),
    str: ArgumentCheck(lambda value: isinstance(value, str), "a text"),
    ArrayLike: NUMBERS,
    os.PathLike: ArgumentCheck(lambda value: isinstance(value, os.PathLike), "a path"),
}
"""Types with a check of their own."""
