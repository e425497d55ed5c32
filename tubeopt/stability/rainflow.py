"""Cycles of a repeated history by rainflow counting: ASTM E1049-85, for histories that repeat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import Array


@dataclass(frozen=True, eq=False)
class Cycles:
    """K full cycles of a repeated history, the largest first."""

    amplitude: Array
    """(K,) half of the difference between the largest and the smallest value."""
    mean: Array
    """(K,) mean of both."""


def rainflow(history: Array) -> Cycles:
    """Cycles of one period (T,) of a repeated history; its last value is followed by its first."""
    values = np.asarray(history, dtype=float)
    first = int(np.argmax(values))
    # From the largest value to itself all ranges close to full cycles.
    turned, pairs = np.roll(values, -first), list[tuple[float, float]]()
    stack: list[float] = []
    for value in [*turned.tolist(), float(turned[0])]:
        if len(stack) > 1 and (value - stack[-1]) * (stack[-1] - stack[-2]) >= 0:
            stack.pop()  # no turning point
        if stack and value == stack[-1]:
            continue
        stack.append(value)
        while len(stack) > 2 and abs(stack[-1] - stack[-2]) >= abs(stack[-2] - stack[-3]):
            high, low = max(stack[-3:-1]), min(stack[-3:-1])
            pairs.append((high, low))
            del stack[-3:-1]
    table = np.array(sorted(pairs, key=lambda pair: pair[1] - pair[0])).reshape(-1, 2)
    return Cycles((table[:, 0] - table[:, 1]) / 2, table.mean(1))
