"""Bounds of a quantity and of its first two derivatives with respect to time, and what they make of sums and products.

A jet of f is (v, d, dd) with |f| <= v, |f'| <= d, |f''| <= dd over an interval: arrays of any shape that go together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..typing import Array


@dataclass(frozen=True, eq=False)
class Jet:
    """Bounds of |f|, |f'| and |f''|."""

    v: Array
    d: Array
    dd: Array

    def __add__(self, other: Jet) -> Jet:
        return Jet(self.v + other.v, self.d + other.d, self.dd + other.dd)

    def __mul__(self, other: Jet) -> Jet:
        return Jet(
            self.v * other.v,
            self.d * other.v + self.v * other.d,
            self.dd * other.v + 2 * self.d * other.d + self.v * other.dd,
        )

    def map(self, function: Callable[[Array], Array]) -> Jet:
        """A linear function with no negative weights, of all three."""
        return Jet(function(self.v), function(self.d), function(self.dd))


def linear(begin: Array, end: Array) -> Jet:
    """Of what goes linearly from one value to another while time goes from 0 to 1."""
    return Jet(np.maximum(np.abs(begin), np.abs(end)), np.abs(end - begin), np.zeros_like(begin))
