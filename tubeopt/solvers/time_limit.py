"""Time limits of questions, for all computations inside.

A question sets its limit with `limited` or `within`; computations call `check_time`, at every equilibrium and every
certificate. The earliest limit applies: a question inside another one has no more time than the outer one has left.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any, TypeVar

from ..errors import TimeLimitError, positive

F = TypeVar("F", bound=Callable[..., Any])

TIME_LIMIT = 600.0
"""Default limit of a question, s: more than ten times the time of the slowest shipped example on two cores."""

LONG_TIME_LIMIT = 3600.0
"""Default limit of questions with many repetitions, such as samples or fits to measurements, s."""

MIN_SECONDS = 1e-3
"""Smallest limit of a solver, s: IPOPT accepts no limit of 0."""

_UNTIL: ContextVar[float] = ContextVar("until", default=math.inf)
"""Time of the earliest limit, by `time.time`, which processes share."""


class OutOfTimeError(Exception):
    """Error of a computation at its time limit. It is no `SolveError`, which some callers treat as a failed attempt.

    Attributes:
        best: best result so far, or None.
    """

    def __init__(self, *labels: object, best: Any = None) -> None:
        super().__init__(*labels)
        self.best = best


def time_left() -> float:
    """Time until the earliest limit, s, at least 0; infinite without a limit."""
    until = _UNTIL.get()
    return until if until == math.inf else max(0.0, until - time.time())


def check_time() -> None:
    """Raise `OutOfTimeError` if the earliest limit is reached."""
    until = _UNTIL.get()
    if until != math.inf and time.time() > until:
        raise OutOfTimeError


class within:  # noqa: N801  # read as a verb: with within(seconds)
    """Context with a time limit; a class, since a generator would cost more in every solve.

    Raises:
        OutOfTimeError: the limit is reached.
    """

    __slots__ = ("_seconds", "_token")

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __enter__(self) -> None:
        self._token = _UNTIL.set(min(_UNTIL.get(), time.time() + self._seconds))

    def __exit__(self, *raised: object) -> None:
        _UNTIL.reset(self._token)


def limited(question: F) -> F:
    """Decorator of a question with the keyword `time_limit` (s); its default applies if no outer limit is set.

    Raises:
        InputError: a limit that is no positive number.
        TimeLimitError: the limit is reached before the question has an answer.
    """
    default = (question.__kwdefaults__ or {})["time_limit"]

    @functools.wraps(question)
    def with_limit(*args: Any, **inputs: Any) -> Any:
        outer = time_left()
        if "time_limit" in inputs:
            limit = positive("time_limit", inputs["time_limit"])
        elif outer < math.inf:
            return question(*args, **inputs)
        else:
            limit = default
        try:
            with within(limit):
                return question(*args, **inputs)
        except OutOfTimeError as error:
            if outer <= limit:  # the limit of the caller, who handles it
                raise
            result = "" if error.best is None else " with an answer that it could not check"
            raise time_limit_error(question.__name__, limit, error.best, result) from None

    return with_limit  # type: ignore[return-value]


def time_limit_error(name: str, limit: float, best: Any = None, progress: str = "") -> TimeLimitError:
    """Error of a question that reached its limit; `progress` describes its partial result."""
    return TimeLimitError(
        f"{name} reached its time limit of {limit:g} s{progress or ' without a result'}; increase time_limit",
        best,
    )


def timed(function: F) -> F:
    """Function for other processes that has the earliest time limit of this process."""
    until = _UNTIL.get()
    return function if until == math.inf else functools.partial(_until, function, until)  # type: ignore[return-value]


def _until(function: Callable[..., Any], until: float, *args: Any) -> Any:
    with within(until - time.time()):
        check_time()
        return function(*args)
