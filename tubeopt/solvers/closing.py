"""A program with names closed as one function of IPOPT: everything in one column, over its scale."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError
from .settings import Ipopt

DIRECTIONS = 8
"""Derivatives in so many directions are written out at once, in place of CasADi's 64: evaluated as fast, and built in a
fraction of the time where the cross-section of many tubes is differentiated twice."""


class Stacked:
    """Scales and bounds of variables or constraints, one below the other."""

    def __init__(self, parts: Sequence[Any]) -> None:
        columns = [
            np.concatenate([*(getattr(p, key) for p in parts), np.zeros(0)]) for key in ("scale", "lower", "upper")
        ]
        self.scale, self.lower, self.upper = columns


def ipopt_function(
    variables: Sequence[Any],
    parameters: list[Any],
    objective: Any,
    constraints: Sequence[Any],
    settings: Ipopt,
    *,
    warm: bool,
) -> ca.Function:
    """The solver (x0, p, bounds) -> x, f, g, multipliers of the scaled program."""
    symbols = [each.symbol for each in variables]
    whole = function_of(
        [*symbols, *parameters], [objective, *(each.expression / ca.DM(each.scale) for each in constraints)]
    )
    scale = Stacked(variables).scale
    x: Any = ca.MX.sym("x", len(scale))
    p: Any = ca.MX.sym("p", sum(each.numel() for each in parameters))
    parts = _parted(ca.DM(scale) * x, symbols) + _parted(p, parameters)
    f, *rows = whole.call(parts, True, False)
    options = settings.options(warm=warm)
    with few_directions():
        if settings.expand:
            flat = ca.Function("flat", [x, p], [f, *rows]).expand()
            x, p = flat.sx_in()
            f, *rows = flat.call([x, p], True, False)
        if settings.expand and settings.hessian == "limited-memory":
            # Each constraint by itself: the rows of a few that depend on everything are cheap in reverse, and would
            # spoil the colouring of all that are local.
            slopes = ca.vertcat(ca.SX(0, x.numel()), *(ca.jacobian(each, x) for each in rows))
            both = [ca.vertcat(ca.SX(0, 1), *rows), slopes]
            options["jac_g"] = ca.Function("jac_g", [x, p], both, ["x", "p"], ["g", "jac_g_x"])
        return ca.nlpsol("program", "ipopt", {"x": x, "p": p, "f": f, "g": ca.vertcat(*rows)}, options)


def function_of(symbols: list[Any], expressions: list[Any]) -> ca.Function:
    """Symbols -> expressions; raises InputError where these have others."""
    function: ca.Function = ca.Function("program", symbols, expressions, {"allow_free": True})
    if function.has_free():
        raise InputError(f"an expression has symbols that are not the problem's: {', '.join(function.get_free())}")
    return function


def _parted(column: Any, symbols: list[Any]) -> list[Any]:
    sizes = [each.numel() for each in symbols]
    return list(ca.vertsplit(column, np.cumsum([0, *sizes]).tolist())) if sizes else []


@contextmanager
def few_directions() -> Iterator[None]:
    """Within, CasADi writes out derivatives in `DIRECTIONS` at once, also of a `casadi.Opti` that is solved there."""
    before = ca.GlobalOptions.getMaxNumDir()
    ca.GlobalOptions.setMaxNumDir(DIRECTIONS)
    try:
        yield
    finally:
        ca.GlobalOptions.setMaxNumDir(before)
