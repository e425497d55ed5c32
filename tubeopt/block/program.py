"""The program to which a block is added: a `casadi.Opti`, or a `tubeopt.Problem`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .transcription.program import Program


class OptiProgram:
    """A `casadi.Opti` as a Program. Names are not kept, since Opti has none."""

    def __init__(self, opti: ca.Opti) -> None:
        self.opti = opti

    def variable(self, name: str, size: int = 1, *, guess: ArrayLike = 0.0, scale: ArrayLike = 1.0) -> Any:
        """A column of unknowns, in its own units; Opti is given it over its scale."""
        factor = ca.DM(np.broadcast_to(np.asarray(scale, dtype=float), (size,)))
        column = self.opti.variable(size) * factor
        self.set_guess(column, guess)
        return column

    def subject_to(
        self,
        name: str,
        expression: Any,
        *,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] | None = None,
    ) -> None:
        """Demand 0 <= expression <= upper, divided by their scale."""
        high, factor = (np.broadcast_to(np.asarray(v, dtype=float), (expression.numel(),)) for v in (upper, scale))
        scaled = ca.vec(expression) / ca.DM(factor)
        self.opti.subject_to(self.opti.bounded(0.0, scaled, high / factor) if high.any() else scaled == 0)

    def parameter(self, name: str, value: ArrayLike) -> Any:
        """Numbers that may be changed."""
        numbers = np.asarray(value, dtype=float).ravel()
        symbol = self.opti.parameter(len(numbers))
        self.opti.set_value(symbol, numbers)
        return symbol

    def set_value(self, parameter: Any, value: ArrayLike) -> None:
        """Give a parameter other numbers."""
        self.opti.set_value(parameter, np.asarray(value, dtype=float).ravel())

    def set_guess(self, variable: Any, value: ArrayLike) -> None:
        """Start there; Opti solves for the variable behind the scale."""
        if variable.numel():
            self.opti.set_initial(variable, ca.DM(np.broadcast_to(np.asarray(value, dtype=float), (variable.numel(),))))

    def rename(self, name: str, entries: Sequence[str]) -> None:
        """Opti keeps no names."""

    def enter(self, block: Any) -> str:
        """Opti keeps no list of blocks."""
        return ""


def as_program(opti: Any) -> Program:
    """The Program behind a `casadi.Opti` or a `tubeopt.Problem`."""
    if isinstance(opti, ca.Opti):
        return OptiProgram(opti)
    if all(hasattr(opti, name) for name in ("variable", "subject_to", "parameter", "enter")):
        return opti  # type: ignore[no-any-return]
    raise InputError(f"opti is a {type(opti).__name__}; it must be a casadi.Opti or a tubeopt.Problem")
