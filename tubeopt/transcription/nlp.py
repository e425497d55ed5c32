"""A nonlinear program in which every variable and constraint has a name, a scale, a guess and bounds.

Blocks add their unknowns and equations to a `Builder`; `Builder.build` closes it as an `Nlp`, from which IPOPT
problems and, where it is square, root-finding problems are made. Names are what error messages are made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..typing import Array

IPOPT_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-12,
    "ipopt.constr_viol_tol": 1e-12,
    "ipopt.max_iter": 300,
    # "Acceptable" is not converged: a solution that is not within the tolerance is a failure, and said to be one.
    "ipopt.acceptable_iter": 0,
}


@dataclass(frozen=True, eq=False)
class Nlp:
    """minimise f(x, p) subject to lower <= g(x, p) <= upper, in scaled x and g.

    `guess`, `lower`, `upper` (X,) are for the unscaled variables x = scale * x_scaled; `names`, `constraint_names` say
    what each entry is.
    """

    x: Any
    p: Any
    objective: Any
    constraints: Any
    names: tuple[str, ...]
    scale: Array
    guess: Array
    lower: Array
    upper: Array
    constraint_names: tuple[str, ...]
    constraint_scale: Array
    constraint_lower: Array
    constraint_upper: Array

    @property
    def square(self) -> bool:
        """Whether it is a system of as many equations as unknowns."""
        return len(self.names) == len(self.constraint_names) and bool(
            (self.constraint_lower == self.constraint_upper).all()
        )

    @property
    def bounds(self) -> dict[str, Array]:
        """Bounds of the scaled problem, by the names of CasADi's solvers."""
        return {
            "lbx": self.lower / self.scale,
            "ubx": self.upper / self.scale,
            "lbg": self.constraint_lower / self.constraint_scale,
            "ubg": self.constraint_upper / self.constraint_scale,
        }

    def ipopt(self, name: str = "nlp", **options: Any) -> ca.Function:
        """CasADi solver of the scaled problem."""
        problem = {"x": self.x, "p": self.p, "f": self.objective, "g": self.constraints}
        return ca.nlpsol(name, "ipopt", problem, {**IPOPT_OPTIONS, **options})

    def rootfinder(self, name: str = "root", **options: Any) -> ca.Function:
        """CasADi Newton solver (x0, p) -> x of the scaled equations.

        Raises:
            InputError: the problem has bounds on its constraints or another number of equations than unknowns.
        """
        if not self.square:
            raise InputError(
                f"the problem has {len(self.names)} unknowns and {len(self.constraint_names)} constraints; "
                "a root-finding problem must have as many equations as unknowns, and no inequality"
            )
        target = ca.DM(self.constraint_lower / self.constraint_scale)
        function = ca.Function("equations", [self.x, self.p], [self.constraints - target])
        return ca.rootfinder(name, "newton", function, {"linear_solver": "qr", "abstol": 1e-13, **options})

    def worst(self, constraints: ArrayLike, count: int = 3) -> list[tuple[str, float]]:
        """The `count` most violated constraints at scaled values g (G,), as (name, violation in its own units)."""
        g = np.asarray(constraints, dtype=float) * self.constraint_scale
        violation = np.maximum(self.constraint_lower - g, g - self.constraint_upper)
        violation = np.where(np.isfinite(violation), violation, np.inf)
        order = np.argsort(-violation)[:count]
        return [(self.constraint_names[i], float(violation[i])) for i in order if violation[i] > 0]


class Builder:
    """Collects variables, parameters, constraints and an objective."""

    def __init__(self) -> None:
        self._x: list[Any] = []
        self._p: list[Any] = []
        self._g: list[Any] = []
        self._names: list[str] = []
        self._constraint_names: list[str] = []
        self._tables: dict[str, list[Array]] = {
            key: [] for key in ("scale", "guess", "lower", "upper", "g_scale", "g_lower", "g_upper")
        }
        self._objective: Any = 0.0

    def variable(
        self,
        names: Sequence[str],
        *,
        guess: ArrayLike = 0.0,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
    ) -> Any:
        """A column of unknowns, one per name, in their own units; `scale` is the size that they typically have."""
        symbol = ca.SX.sym("x", len(names))
        self._x.append(symbol)
        self._names.extend(names)
        self._record(len(names), scale=scale, guess=guess, lower=lower, upper=upper)
        return symbol * ca.DM(self._tables["scale"][-1])

    def parameter(self, size: int) -> Any:
        """A column of numbers that are given at each solve."""
        symbol = ca.SX.sym("p", size)
        self._p.append(symbol)
        return symbol

    def constrain(
        self,
        names: Sequence[str],
        expression: Any,
        *,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = 0.0,
        scale: ArrayLike = 1.0,
    ) -> None:
        """Demand lower <= expression <= upper (equations by default); one name per entry."""
        if expression.numel() != len(names):
            raise InputError(f"{len(names)} names are given for {expression.numel()} constraints; they must agree")
        self._constraint_names.extend(names)
        self._record(len(names), g_scale=scale, g_lower=lower, g_upper=upper)
        self._g.append(ca.vec(expression) / ca.DM(self._tables["g_scale"][-1]))

    def minimise(self, expression: Any) -> None:
        """Add `expression` to the objective."""
        self._objective = self._objective + expression

    def build(self) -> Nlp:
        """Close the problem."""
        table = {key: np.concatenate([*parts, np.zeros(0)]) for key, parts in self._tables.items()}
        return Nlp(
            x=ca.vertcat(*self._x),
            p=ca.vertcat(*self._p),
            objective=ca.SX(self._objective),
            constraints=ca.vertcat(*self._g),
            names=tuple(self._names),
            scale=table["scale"],
            guess=table["guess"],
            lower=table["lower"],
            upper=table["upper"],
            constraint_names=tuple(self._constraint_names),
            constraint_scale=table["g_scale"],
            constraint_lower=table["g_lower"],
            constraint_upper=table["g_upper"],
        )

    def _record(self, size: int, **values: ArrayLike) -> None:
        for key, value in values.items():
            self._tables[key].append(np.broadcast_to(np.asarray(value, dtype=float), (size,)).copy())
