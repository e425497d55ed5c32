"""Functions for worker processes, which import them by name."""

from __future__ import annotations

import math
import os
import signal
import time
from dataclasses import dataclass
from typing import Any

import casadi as ca

from tubeopt import InputError


def square(x: int) -> int:
    return x * x


def evaluated(function: ca.Function, x: float) -> float:
    return float(function(x))


def picky(x: int) -> int:
    """Fails at 3, ends its process at 7."""
    if x == 3:
        raise ValueError("three is no good")
    if x == 7:
        os.kill(os.getpid(), signal.SIGKILL)
    return x * x


def slow(x: int) -> tuple[int, int]:
    """A twentieth of a second, then the answer and the process that found it."""
    time.sleep(0.05)
    return x * x, os.getpid()


@dataclass(frozen=True)
class Weighed:
    """A function that counts how often it arrived in a process."""

    weight: int

    def __call__(self, x: int) -> tuple[int, int, int]:
        return self.weight * x, os.getpid(), arrivals

    def __setstate__(self, state: dict[str, int]) -> None:
        global arrivals
        arrivals += 1
        self.__dict__.update(state)


arrivals = 0


def slow_row(factor: int, point: dict[str, int]) -> dict[str, float]:
    time.sleep(0.01)
    return {"y": factor * point["x"] / 7}


def slow_parabola(shift: float, point: dict[str, float]) -> dict[str, Any]:
    """Half a millisecond or more; fails at 77, and has no answer to a part of the question at odd points."""
    time.sleep(0.0005)
    if point["x"] == 77:
        raise InputError("x is 77; it must be another number")
    return {"y": (point["x"] - shift) ** 2 / 7, "odd": {"x": math.nan if point["x"] % 2 else 1.0}}


def echo(point: dict[str, Any]) -> Any:
    """Twice the x of a point; of 3 no mapping, of 4 no number."""
    answers: dict[Any, Any] = {3: 3, 4: {"z": 4j}}
    return answers.get(point["x"], {"twice": 2 * point["x"]})
