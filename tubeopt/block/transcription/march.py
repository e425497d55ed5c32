"""Torsion of tubes of one curvature from tip to base: Runge and Kutta's method over a piece, in one call."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import casadi as ca

from ...physics.torsion import section_functions

Columns = list[Any]


@lru_cache(maxsize=64)
def march_function(n: int, eccentric: bool, slopes: bool, steps: int) -> ca.Function:
    """Steps of the classical method on a piece along which the cross-sections are the same.

    From (theta, w, travel (n,)[, derivatives (n, n) of theta and of w by the tip angles], h (steps,) m, kt, kb, m (n,)
    [, offset, angle (n,)]) at its far end to the same state at its near end, and theta and theta' (n, steps + 1) where
    the steps begin and end. `travel` is the length of every tube so far, m; h is counted towards the base. The last two
    inputs are those of eccentric tubes.
    """
    step = _step_function(n, eccentric, slopes)
    shapes = [(n, 1)] * 3 + [(n, n)] * (2 if slopes else 0)
    state = [ca.MX.sym("state", *shape) for shape in shapes]
    h = ca.MX.sym("h", steps)
    constants = [ca.MX.sym("constant", n) for _ in range(5 if eccentric else 3)]
    here, passed, rates = state, [state[0]], []
    for k in range(steps):
        *here, rate = step(*here, h[k], *constants)
        passed.append(here[0])
        rates.append(rate)
    stretch = section_functions(n, True)["moment"](here[0], *constants[1:])[1] if eccentric else 1
    rates.append(stretch * here[1])
    return ca.Function("march", [*state, h, *constants], [*here, ca.horzcat(*passed), ca.horzcat(*rates)])


@lru_cache(maxsize=32)
def _step_function(n: int, eccentric: bool, slopes: bool) -> ca.Function:
    """One of these steps: the state after it, and theta' where it began."""
    shapes = [(n, 1)] * 3 + [(n, n)] * (2 if slopes else 0)
    state = [ca.SX.sym("state", *shape) for shape in shapes]
    h, kt, *section = [ca.SX.sym("h"), *(ca.SX.sym("constant", n) for _ in range(5 if eccentric else 3))]
    section_function = section_functions(n, eccentric)["balance" if slopes else "moment"]

    def rates(at: Columns) -> Columns:
        """By arc length; the travel grows towards the base."""
        theta, twist = at[:2]
        out = section_function.call([theta, *section])
        stretch = (out[3] if slopes else out[1]) if eccentric else ca.SX.ones(n)
        own = [stretch * twist, out[0] / kt, -stretch]
        if not slopes:
            return own
        theta_by_tip, twist_by_tip = at[3:]
        turned = ca.diag(stretch) @ twist_by_tip
        if eccentric:
            turned += ca.diag(twist) @ (out[4] @ theta_by_tip)
        return [*own, turned, ca.diag(1 / kt) @ (out[1] @ theta_by_tip)]

    after = [ca.densify(part) for part in classical_step(state, rates, -h)]
    return ca.Function("step", [*state, h, kt, *section], [*after, rates(state)[0]], {"cse": True})


def classical_step(state: Columns, rates: Callable[[Columns], Columns], h: Any) -> Columns:
    """The state after a step h of Runge and Kutta's classical method."""
    slopes = [rates(state)]
    for part in (0.5, 0.5, 1.0):
        slopes.append(rates([a + part * h * b for a, b in zip(state, slopes[-1], strict=True)]))
    mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(*slopes, strict=True)]
    return [a + h * b for a, b in zip(state, mean, strict=True)]
