"""Time limits of questions: one mechanism for all that is computed inside, however deep.

A question sets its limit with `limited` or `within`; what it computes calls `check_time`, at every equilibrium and
every certificate. The nearest limit counts: a question that another one asks has no more time than that one has left.
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
"""s, of a question without a limit of its own: more than ten times what the slowest shipped example takes on two cores.
Who asks for more gives more time."""

LONG_TIME_LIMIT = 3600.0
"""s, of what repeats a computation as often as it is asked to, as a sample or a fit to measurements: here a limit only
ends what would not end in a working hour."""

LEAST_SECONDS = 1e-3
"""That a solver is given, since IPOPT takes no limit of 0."""

_UNTIL: ContextVar[float] = ContextVar("until", default=math.inf)
"""Moment (of `time.time`, which processes share) at which the nearest limit is reached."""


class LateError(Exception):
    """Time is over, in the middle of what can be cut short. No `SolveError`: who goes on after one that failed must not
    take it for a failure.

    `best` is the best that was found before, or None.
    """

    def __init__(self, *labels: object, best: Any = None) -> None:
        super().__init__(*labels)
        self.best = best


def time_left() -> float:
    """Seconds until the nearest limit, at least 0; infinite where there is none."""
    until = _UNTIL.get()
    return until if until == math.inf else max(0.0, until - time.time())


def check_time() -> None:
    """Raise `LateError` where the nearest limit is reached."""
    until = _UNTIL.get()
    if until != math.inf and time.time() > until:
        raise LateError


class within:  # noqa: N801  # read as a verb: with within(seconds)
    """A limit for all that is computed inside; no generator, since every solve enters one.

    Raises:
        LateError: it is reached.
    """

    __slots__ = ("_seconds", "_token")

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def __enter__(self) -> None:
        self._token = _UNTIL.set(min(_UNTIL.get(), time.time() + self._seconds))

    def __exit__(self, *raised: object) -> None:
        _UNTIL.reset(self._token)


def limited(question: F) -> F:
    """The question under the limit that its keyword `time_limit` (s) sets. Its default counts where nobody who asks has
    set a limit.

    Raises:
        InputError: a limit that is no positive number.
        TimeLimitError: it is reached, and the question has no answer by then.
    """
    default = (question.__kwdefaults__ or {})["time_limit"]

    @functools.wraps(question)
    def asked(*args: Any, **inputs: Any) -> Any:
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
        except LateError as late:
            if outer <= limit:  # of who asks, who knows what to do about it
                raise
            result = "" if late.best is None else " with an answer that it could not check"
            raise late_error(question.__name__, limit, late.best, result) from None

    return asked  # type: ignore[return-value]


def late_error(name: str, limit: float, best: Any = None, how: str = "") -> TimeLimitError:
    """What ends a question whose time is over; `how` says how far it came."""
    return TimeLimitError(
        f"{name} reached its time limit of {limit:g} s{how or ' without a result'}; increase time_limit",
        best,
    )


def timed(function: F) -> F:
    """A function for other processes, under the limit that is the nearest here; the function itself without one."""
    until = _UNTIL.get()
    return function if until == math.inf else functools.partial(_until, function, until)  # type: ignore[return-value]


def _until(function: Callable[..., Any], until: float, *args: Any) -> Any:
    with within(until - time.time()):
        check_time()
        return function(*args)
