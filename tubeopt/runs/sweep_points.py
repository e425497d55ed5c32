"""The points of a sweep: what varies, over a grid or a sample of its values."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import InputError, choice
from ..solvers.sampling import sobol

METHODS = ("grid", "random", "sobol", "latin_hypercube")

MOST_POINTS = 10**7

Value = float | str | bool


@dataclass(frozen=True)
class Axis:
    """Keys that take the same values."""

    keys: tuple[str, ...]
    values: tuple[Value, ...] | None = None
    """Of a list; None for the range from `low` to `high`."""
    low: float = 0.0
    high: float = 0.0
    count: int = 0
    """Values of the range on a grid."""

    @property
    def places(self) -> int:
        """How many values it has on a grid."""
        return self.count if self.values is None else len(self.values)

    def on_grid(self, place: int) -> Value:
        """The value at a place on a grid, from 0; those of a range to 15 digits, ends included."""
        if self.values is not None:
            return self.values[place]
        return self.at(place / (self.count - 1) if self.count > 1 else 0.0)

    def at(self, unit: float) -> Value:
        """The value at a number from 0 to 1."""
        if self.values is not None:
            return self.values[min(int(unit * len(self.values)), len(self.values) - 1)]
        return float(f"{(1 - unit) * self.low + unit * self.high:.15g}")


@dataclass(frozen=True)
class Points(Sequence[dict[str, Value]]):
    """All points of a sweep, in a fixed order; each gives every key its value.

    Raises:
        InputError: unknown method, no axis, a key on two axes, a sample without count, more than ten million points.
    """

    axes: tuple[Axis, ...]
    method: str = "grid"
    """One of `METHODS`."""
    total: int = 0
    """Of a sample; a grid has its own number."""
    seed: int = 0
    """Of a sample."""

    def __post_init__(self) -> None:
        choice("sample.method", self.method, METHODS)
        if not self.axes:
            raise InputError("vary is empty; it must name at least one key")
        for key in self.keys:
            if self.keys.count(key) > 1:
                raise InputError(f"vary {key}: it is given {self.keys.count(key)} times; it must be given once")
        if self.method == "grid":
            object.__setattr__(self, "total", math.prod(axis.places for axis in self.axes))
        if not 1 <= self.total <= MOST_POINTS:
            raise InputError(f"the sweep has {self.total} points; there must be 1 to {MOST_POINTS}")

    @property
    def keys(self) -> tuple[str, ...]:
        """All keys that vary."""
        return tuple(key for axis in self.axes for key in axis.keys)

    def __len__(self) -> int:
        return self.total

    def __getitem__(self, index):  # type: ignore[no-untyped-def]
        """The value of every key at a point, from 0, or a list of points. On a grid the last axis runs fastest."""
        if isinstance(index, slice):
            return [self[k] for k in range(self.total)[index]]
        index = range(self.total)[index]
        if self.method == "grid":
            places = np.unravel_index(index, [axis.places for axis in self.axes])
            chosen = [axis.on_grid(int(k)) for axis, k in zip(self.axes, places, strict=True)]
        else:
            units = _sample(self.method, len(self.axes), self.total, self.seed)[index]
            chosen = [axis.at(float(unit)) for axis, unit in zip(self.axes, units, strict=True)]
        return {key: value for axis, value in zip(self.axes, chosen, strict=True) for key in axis.keys}


@functools.lru_cache(maxsize=4)
def _sample(method: str, dimension: int, count: int, seed: int) -> np.ndarray:
    """(count, dimension) numbers from 0 to 1."""
    if method == "random":
        return np.random.default_rng(seed).random((count, dimension))
    if method == "latin_hypercube":
        return np.asarray(scipy.stats.qmc.LatinHypercube(dimension, rng=seed).random(count))
    return sobol(dimension, count, seed)
