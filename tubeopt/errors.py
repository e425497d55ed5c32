"""The two ways in which a request can fail: it makes no sense, or it has no solution that could be found."""

from __future__ import annotations

import difflib
import importlib
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .display import Displayed


class ImplausibleWarning(UserWarning):
    """The input is possible, but was probably meant in another unit; the message says which field, and its value."""


class InputError(ValueError):
    """The input names something impossible; the message says which field, its value, and what is allowed."""


FAULTS = (ArithmeticError, AttributeError, LookupError, NameError, TypeError, ValueError)
"""What a function of a user raises by a fault of its own."""


def called(name: str, function: Callable[[float], Any], at: float) -> Any:
    """The value of a user's function of the arc length at `at`, m; raises InputError, with `name`, for its faults."""
    try:
        return function(at)
    except InputError:
        raise
    except FAULTS as error:
        raise InputError(
            f"{name}, a function, fails at {at:.4g} m ({at * 1e3:.4g} mm): {type(error).__name__}: {error}"
        ) from error


class MissingExtraError(InputError):
    """A package that an extra brings is not installed; the message has the line that installs it."""


class SolveError(RuntimeError):
    """No acceptable solution was found; the message names what was violated.

    ``solution`` is the best solution found, or None.
    """

    def __init__(self, message: str, solution: Any = None) -> None:
        super().__init__(message)
        self.solution = solution


class TimeLimitError(SolveError):
    """A time limit was reached before there was an answer; the message names the limit.

    ``solution`` is the best solution found by then, or None.
    """


class NotProvedError(RuntimeError):
    """An answer was found, and given, whose proof was not finished in time; the message says how far it came."""


_UNDOUBTED = ContextVar("undoubted", default=False)


@contextmanager
def undoubted() -> Iterator[None]:
    """Warn of no implausible number: it was computed, or the reader of its file warns, with its key and unit."""
    before = _UNDOUBTED.set(True)
    try:
        yield
    finally:
        _UNDOUBTED.reset(before)


def implausible(words: str) -> None:
    """Warn of what is possible but was probably meant otherwise."""
    if not _UNDOUBTED.get():
        warnings.warn(words, ImplausibleWarning, stacklevel=2)


def positive(name: str, value: float, *, zero: bool = False) -> float:
    """Return `value` as float if it is finite and > 0 (>= 0 with `zero`), else raise InputError naming it."""
    number = finite(name, value)
    # NaN is not finite, and was refused above.
    if number < 0 or (number == 0 and not zero):
        raise InputError(f"{name} is {number:g}; it must be {'at least' if zero else 'greater than'} 0")
    return number


def finite(name: str, value: Any) -> float:
    """Return `value` as a finite float, else raise InputError naming it."""
    try:
        number = value if type(value) is float else float(_only_numbers(value))
    except OverflowError:
        raise InputError(f"{name} is an integer beyond 1e308; it must be a finite number") from None
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be a number") from None
    if not math.isfinite(number):
        raise InputError(f"{name} is {number}; it must be a finite number")
    return number


PLAIN = {float, int, np.float64}
"""Types of numbers that need no further look: what is asked at each solve is checked in a microsecond."""


def _only_numbers(value: Any) -> Any:
    """`value`, or TypeError where a truth value, a text or a complex number stands in it, which NumPy would convert."""
    if isinstance(value, np.ndarray):
        # Truth values, bytes, texts and complex numbers.
        if value.dtype.kind in "bSUc":
            raise TypeError("no number")
    elif isinstance(value, list | tuple):
        # The set of types decides for most lists, without a call for each member.
        if not PLAIN.issuperset(map(type, value)):
            for each in value:
                _only_numbers(each)
    elif isinstance(value, bool | np.bool_ | str | bytes | complex | np.complexfloating):
        raise TypeError("no number")
    return value


def whole(name: str, value: Any, least: int | None = None) -> int:
    """The value as a whole number, of at least `least` if given; raises InputError where it is none."""
    # True is an int for Python, and never meant as a number here.
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InputError(f"{name} is {value!r}; it must be a whole number")
    if least is not None and value < least:
        raise InputError(f"{name} is {value}; it must be at least {least}")
    return int(value)


@dataclass(frozen=True)
class Settings(Displayed):
    """What a user may want to change of how something is solved: the numbers that a class derived from this has.

    Raises:
        InputError: a field whose default is a whole number is none of at least 1, or of at least 0 by the names
            `_none`; another one is no positive number, holds one that is none, or is no settings where these are asked
            for.
    """

    _none: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(each.default, int):
                whole(each.name, value, int(each.name not in self._none))
            elif isinstance(each.default, tuple):
                for number in numbers(each.name, value):
                    positive(each.name, number)
            elif is_dataclass(each.default):
                instance(each.name, value, type(each.default))
            else:
                positive(each.name, value)


def instance(name: str, value: Any, wanted: type, *, optional: bool = False) -> None:
    """Raise InputError naming `name` unless `value` is a `wanted`; where it is optional, None will do."""
    if not (isinstance(value, wanted) or (optional and value is None)):
        article = "an" if wanted.__name__[0] in "AEIOU" else "a"
        raise InputError(f"{name} is {value!r}; it must be {article} {wanted.__name__}")


def numbers(name: str, value: Any) -> tuple[float, ...]:
    """Return `value`, one number or several, as finite floats, else raise InputError naming it."""
    # A text and a dict can be iterated, into letters and keys.
    if isinstance(value, str | Mapping):
        raise InputError(f"{name} is {value!r}; it must be numbers")
    try:
        values = tuple(value)
    except TypeError:
        values = (value,)
    if not values:
        raise InputError(f"{name} is empty; it must have at least one number")
    return tuple(finite(name, number) for number in values)


def vector(name: str, value: ArrayLike, size: int, what: str = "one per tube") -> NDArray[np.float64]:
    """Return `value` as a finite float array of shape (size,), else raise InputError naming it."""
    try:
        array = np.array(_only_numbers(value), dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InputError(f"{name} is {value!r}; it must be {size} numbers ({what})") from None
    if array.shape != (size,):
        shape = f"{array.size} numbers" if array.ndim == 1 else f"an array of shape {array.shape}"
        got = f"has {shape}" if array.ndim else f"is {value!r}"
        raise InputError(f"{name} {got}; it must be {size} numbers ({what})")
    if not all(map(math.isfinite, array.tolist())):  # of so few numbers faster than NumPy
        raise InputError(f"{name} is {array.tolist()}; every number must be finite")
    return array


def finite_array(name: str, value: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    """`value` as a float array with so many dimensions, else InputError naming the first bad place."""
    try:
        array = np.array(_only_numbers(value), dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InputError(f"{name} are not an array of numbers") from None
    if array.ndim != dimensions:
        raise InputError(f"{name} have shape {array.shape}; they must have {dimensions} dimensions")
    if not np.isfinite(array).all():
        # The first bad place is enough to find the cause.
        place = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InputError(f"{name}{place} is {array[tuple(place)]}; every number must be finite")
    return array


def items(name: str, values: Any, kinds: Any, what: str) -> tuple[Any, ...]:
    """`values` as a tuple whose every member is of `kinds`, or InputError naming it; `what` says what they must be."""
    # An array without dimension is iterable by its type, and fails when it is read.
    scalar = isinstance(values, np.ndarray) and values.ndim == 0
    if scalar or isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise InputError(f"{name} is {values!r}; it must be a list of {what}")
    found = tuple(values)
    for one in found:
        if not isinstance(one, kinds):
            raise InputError(f"{name} contains {one!r}; it must be a list of {what}")
    return found


def triple(name: str, value: ArrayLike) -> tuple[float, float, float]:
    """Return x, y, z of `value` if they are finite numbers, else raise InputError naming it."""
    x, y, z = vector(name, value, 3, "x, y, z").tolist()
    return x, y, z


def choice(name: str, value: str, allowed: Iterable[str]) -> str:
    """Return `value` if it is one of `allowed`, else raise InputError with the nearest allowed word."""
    options = list(allowed)
    if not isinstance(value, str | None) or value not in options:
        raise InputError(f"{name} is {value!r}; it must be one of {', '.join(options)}{nearest(str(value), options)}")
    return value


def nearest(word: object, known: Iterable[str]) -> str:
    """Return "; did you mean 'x'?" for the known word closest to `word`, or an empty string."""
    # At a cutoff of 0.5 half of the letters agree: "curvatur" and "curve" find "curvature".
    match = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5) if isinstance(word, str) else []
    return f"; did you mean {match[0]!r}?" if match else ""


def extra(module: str, brought_by: str, what: str) -> Any:
    """A module that is not installed with tubeopt itself, loaded where it is used.

    Args:
        brought_by: the extra that has it.
        what: is said to need it, in the plural: "STL files".

    Raises:
        MissingExtraError: it is not installed; with the line that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        needs = f"{what} need {module}: python -m pip install 'tubeopt[{brought_by}]'"
        raise MissingExtraError(needs) from None
