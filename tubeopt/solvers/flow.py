"""The gradient flow of an energy, down to where it comes to rest.

Linearly implicit Euler steps, no longer than a stride, grow into those of Newton's method. Time steps may be as long as
the softest direction allows, so that a flat valley costs no more steps than a steep one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ..typing import Array
from .newton import NewtonResult

S = TypeVar("S")

# A valley of the coupling energy is about as wide as the hysteresis, down to a few tenths of a radian (`SOFT_TWIST`): a
# longer step may cross into the next valley.
STRIDE = 0.1
"""Largest turn (rad) of a point in one step downhill."""

# A fall crosses up to a few turns of every tube, at 0.1 rad a step with some steps repeated: some hundred steps.
FLOW_STEPS = 2000
"""Maximum number of steps of a fall."""


def flow(
    state: S,
    step: Callable[[S, float], tuple[Array, float, bool]],
    moved: Callable[[S, Array], S | None],
    solved: Callable[[S], NewtonResult[S]],
) -> NewtonResult[S]:
    """The state where the flow from another comes to rest, and the steps that took.

    Args:
        step: from a state in a time: change, its largest turn (rad), and whether its matrix is not positive.
        moved: a state after a change; None where its energy rises.
        solved: the state at rest, from where the flow hardly moves.
    """
    time = 1.0
    for count in range(1, FLOW_STEPS + 1):
        change, turn, not_convex = step(state, time)
        if not_convex or turn > STRIDE:
            time *= 0.25 if not_convex else shortened(turn)
            continue
        there = moved(state, change)
        if there is None:
            time *= 0.25
            continue
        state, time = there, grown(time, turn)
        if turn < 1e-6 and time > 1e6:
            last = solved(state)
            return NewtonResult(last.state, last.converged, count, 0.0)
    return NewtonResult(state, False, FLOW_STEPS, 0.0)


def downhill(x: Array, push: Array, gradient: Callable[[Array], Array]) -> list[Array]:
    """Points (U,) beside x at +-`push`, on the sides that lead down; on both if none does."""
    down = [side for side in (push, -push) if float(gradient(x + side) @ side) < 0]
    return [x + side for side in down or (push, -push)]


def shortened(turn: float) -> float:
    """By what a time is multiplied after a step with this turn (rad), which was too long."""
    return max(0.1, 0.8 * STRIDE / turn)


def grown(time: float, turn: float) -> float:
    """The time after one whose step had this turn (rad)."""
    return min(time * min(3.0, max(1.0, 0.8 * STRIDE / max(turn, 1e-12))), 1e12)
