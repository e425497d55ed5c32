"""First and second derivatives of the program: those of its instants by themselves, put in their places.

An instant depends on few unknowns, and linearly on the rates of its temperatures. Differentiated as symbols once, it is
evaluated at all points; with all unknowns at once it would be differentiated in one direction after the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...physics.heat import Resolution
from .instant import instant

OWN, NUMBERS = (0, 2, 3, 4), 5
"""Inputs of an instant: the unknowns that are its own, and the numbers of tube and rig."""


@dataclass(frozen=True, eq=False)
class InstantDerivatives:
    """Of an instant, by its own unknowns with the length of its interval; as functions that return the nonzeros of a
    pattern. The rates, in which the equations are linear, are left out.

    Attributes:
        jacobian: (own unknowns, numbers) -> of the equations.
        hessian: (own unknowns, numbers, multipliers, weight) -> of the equations times multipliers, and of the energy,
            power times length, times a weight.
    """

    jacobian: ca.Function
    hessian: ca.Function
    slopes: Any
    bends: Any


@lru_cache(maxsize=8)
def instant_derivatives(resolution: Resolution) -> InstantDerivatives:
    """Those of `instant`."""
    whole = instant(resolution)
    inputs = whole.sx_in()
    sizes = np.cumsum([0, *(inputs[k].numel() for k in OWN), 1]).tolist()
    own, numbers = ca.SX.sym("own", sizes[-1]), inputs[NUMBERS]
    *parts, length = ca.vertsplit(own, sizes)
    state, *others = parts
    equations, power = whole(state, ca.SX(*state.shape), *others, numbers)
    multipliers, weight = ca.SX.sym("multipliers", equations.numel()), ca.SX.sym("weight")
    J = ca.jacobian(equations, own)
    H = ca.hessian(ca.dot(multipliers, equations) + weight * length * power, own)[0]
    return InstantDerivatives(
        ca.Function("slopes", [own, numbers], [J.nz[:]], {"cse": True}),
        ca.Function("bends", [own, numbers, multipliers, weight], [H.nz[:]], {"cse": True}),
        J.sparsity(),
        H.sparsity(),
    )


@dataclass(frozen=True, eq=False)
class Parts:
    """A program taken apart: what depends on unknowns and parameters through the instants, and the rest.

    Attributes:
        x, p: unknowns, parameters. numbers: of tube and rig.
        own: (Y, N) own unknowns of every instant and the length of its interval, linear in x.
        objective: without the energy. constraints: all, the instants' equations first; of them only their rates.
        weights: (1, N) of power times length in the objective.
    """

    x: Any
    p: Any
    numbers: Any
    own: Any
    objective: Any
    constraints: Any
    weights: Any

    def functions(self, resolution: Resolution, g: Any) -> dict[str, ca.Function]:
        """Jacobian of the constraints, whose values are `g`, and Hessian of the Lagrangian, as options of `nlpsol`."""
        by = instant_derivatives(resolution)
        count, size = self.own.size2(), by.slopes.size1()
        factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", self.constraints.numel())
        ours = ca.reshape(multipliers[: count * size], size, count)
        slopes = by.jacobian.map("slopes", "serial", count, [1], [])(self.own, self.numbers)
        bends = by.hessian.map("bends", "serial", count, [1], [])(self.own, self.numbers, ours, factor * self.weights)
        places = ca.jacobian(ca.vec(self.own), self.x)
        rest = ca.jacobian(self.constraints, self.x)
        below = ca.MX(g.numel() - count * size, self.x.numel())
        J = rest + ca.vertcat(ca.mtimes(_blocks(by.slopes, slopes), places), below)
        lagrangian = factor * self.objective + ca.dot(multipliers, self.constraints)
        H = ca.hessian(lagrangian, self.x)[0] + ca.mtimes([places.T, _blocks(by.bends, bends), places])
        return {
            "jac_g": _named("jac_g", {"x": self.x, "p": self.p}, {"g": g, "jac_g_x": J}),
            "hess_lag": _named(
                "hess_lag",
                {"x": self.x, "p": self.p, "lam_f": factor, "lam_g": multipliers},
                {"triu_hess_gamma_x_x": ca.triu(H)},
            ),
        }


def _blocks(pattern: Any, values: Any) -> Any:
    """Blocks of a pattern on the diagonal; their nonzeros by column."""
    return ca.MX(ca.diagcat(*[pattern] * values.size2()), ca.vec(values))


def _named(name: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> ca.Function:
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))
