"""Errors of the library, checks of arguments, and warnings about implausible numbers."""

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
    """Input that is possible, but probably in another unit; the message has the field and its value."""


class InputError(ValueError):
    """Error for invalid input; the message has the field, its value and the allowed values."""


FAULTS = (ArithmeticError, AttributeError, LookupError, NameError, TypeError, ValueError)
"""Errors that a function of the user may raise."""


def call_user_function(name: str, function: Callable[[float], Any], at: float) -> Any:
    """Call a function of the user at the arc length `at`, m; raises InputError for its errors."""
    try:
        return function(at)
    except InputError:
        raise
    except FAULTS as error:
        raise InputError(
            f"{name}, a function, fails at {at:.4g} m ({at * 1e3:.4g} mm): {type(error).__name__}: {error}"
        ) from error


class MissingExtraError(InputError):
    """Missing optional package; the message has the command that installs it."""


class SolveError(RuntimeError):
    """Error without an acceptable solution; the message has the violated conditions.

    ``solution`` is the best solution found, or None.
    """

    def __init__(self, message: str, solution: Any = None) -> None:
        super().__init__(message)
        self.solution = solution


class TimeLimitError(SolveError):
    """A time limit was reached without an answer; the message has the limit.

    ``solution`` is the best solution found by then, or None.
    """


class FlutterError(SolveError):
    """A branch ends by flutter: oscillations about the equilibrium grow, so that it has no next equilibrium."""


class NotProvedError(RuntimeError):
    """An answer was returned, but its proof was not finished in time; the message has its progress."""


_WARNINGS_OFF = ContextVar("warnings_off", default=False)


@contextmanager
def without_unit_warnings() -> Iterator[None]:
    """Disable warnings of implausible numbers: they were computed, or the reader of their file warns itself."""
    before = _WARNINGS_OFF.set(True)
    try:
        yield
    finally:
        _WARNINGS_OFF.reset(before)


def warn_implausible(message: str) -> None:
    """Warn of input that is possible but probably wrong."""
    if not _WARNINGS_OFF.get():
        warnings.warn(message, ImplausibleWarning, stacklevel=2)


def positive(name: str, value: float, *, zero: bool = False) -> float:
    """Convert a value to float; raises InputError unless it is finite and > 0 (>= 0 with `zero`)."""
    number = finite(name, value)
    # NaN is not finite, and was refused above.
    if number < 0 or (number == 0 and not zero):
        raise InputError(f"{name} is {number:g}; it must be {'at least' if zero else 'greater than'} 0")
    return number


def finite(name: str, value: Any) -> float:
    """Convert a value to a finite float; raises InputError for other values."""
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
"""Types of numbers without further checks: arguments of a solve must be checked in a microsecond."""


def _only_numbers(value: Any) -> Any:
    """Return a value; raises TypeError for truth values, texts and complex numbers in it, which NumPy would convert."""
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


def whole(name: str, value: Any, min_value: int | None = None) -> int:
    """Convert a value to int; raises InputError unless it is a whole number of at least `min_value`."""
    # True is an int for Python, but no valid number here.
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise InputError(f"{name} is {value!r}; it must be a whole number")
    if min_value is not None and value < min_value:
        raise InputError(f"{name} is {value}; it must be at least {min_value}")
    return int(value)


@dataclass(frozen=True)
class Settings(Displayed):
    """Base of solver options.

    Raises:
        InputError: a field with an int default is no whole number of at least 1 (0 for the names `_none`), another
            number is not positive, or a part is no settings of its class.
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


def instance(name: str, value: Any, kind: type, *, optional: bool = False) -> None:
    """Raise InputError unless a value is an instance of `kind`, or None with `optional`."""
    if not (isinstance(value, kind) or (optional and value is None)):
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise InputError(f"{name} is {value!r}; it must be {article} {kind.__name__}")


def numbers(name: str, value: Any) -> tuple[float, ...]:
    """Convert one number or several to finite floats; raises InputError for other values."""
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
    """Convert a value to a finite array of shape (size,); raises InputError for other values."""
    try:
        array = np.array(_only_numbers(value), dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InputError(f"{name} is {value!r}; it must be {size} numbers ({what})") from None
    if array.shape != (size,):
        shape = f"{array.size} numbers" if array.ndim == 1 else f"an array of shape {array.shape}"
        got = f"has {shape}" if array.ndim else f"is {value!r}"
        raise InputError(f"{name} {got}; it must be {size} numbers ({what})")
    if not all(map(math.isfinite, array.tolist())):  # faster than NumPy for a few numbers
        raise InputError(f"{name} is {array.tolist()}; every number must be finite")
    return array


def finite_array(name: str, value: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    """Convert a value to a finite array with `dimensions` axes; raises InputError with the first invalid entry."""
    try:
        array = np.array(_only_numbers(value), dtype=float)
    except (TypeError, ValueError, OverflowError, RecursionError):
        raise InputError(f"{name} are not an array of numbers") from None
    if array.ndim != dimensions:
        raise InputError(f"{name} have shape {array.shape}; they must have {dimensions} dimensions")
    if not np.isfinite(array).all():
        # The first invalid entry is enough to find the cause.
        index = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InputError(f"{name}{index} is {array[tuple(index)]}; every number must be finite")
    return array


def items(name: str, values: Any, kinds: Any, what: str) -> tuple[Any, ...]:
    """Convert values to a tuple; raises InputError unless all are of `kinds`, with `what` as their description."""
    # An array without dimension is iterable by its type, and fails when it is read.
    scalar = isinstance(values, np.ndarray) and values.ndim == 0
    if scalar or isinstance(values, str | Mapping) or not isinstance(values, Iterable):
        raise InputError(f"{name} is {values!r}; it must be a list of {what}")
    members = tuple(values)
    for member in members:
        if not isinstance(member, kinds):
            raise InputError(f"{name} contains {member!r}; it must be a list of {what}")
    return members


def triple(name: str, value: ArrayLike) -> tuple[float, float, float]:
    """Convert a value to finite coordinates x, y, z; raises InputError for other values."""
    x, y, z = vector(name, value, 3, "x, y, z").tolist()
    return x, y, z


def choice(name: str, value: str, allowed: Iterable[str]) -> str:
    """Return an allowed word; raises InputError for others, with the nearest allowed word."""
    options = list(allowed)
    if not isinstance(value, str | None) or value not in options:
        raise InputError(f"{name} is {value!r}; it must be one of {', '.join(options)}{nearest(str(value), options)}")
    return value


def nearest(word: object, known: Iterable[str]) -> str:
    """Hint "; did you mean 'x'?" with the known word closest to `word`; "" without a similar word."""
    # At a cutoff of 0.5 half of the letters agree: "curvatur" and "curve" match "curvature".
    match = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5) if isinstance(word, str) else []
    return f"; did you mean {match[0]!r}?" if match else ""


def import_extra(module: str, brought_by: str, what: str) -> Any:
    """Import an optional module.

    Args:
        brought_by: extra of tubeopt that installs the module.
        what: plural noun in the message: "STL files".

    Raises:
        MissingExtraError: the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        needs = f"{what} need {module}: python -m pip install 'tubeopt[{brought_by}]'"
        raise MissingExtraError(needs) from None
