"""IPOPT on functions that compute their own first derivatives: values and gradients in, raw solution and status out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..typing import Array
from .settings import NO_SENSITIVITIES

OPTIONS: dict[str, Any] = {
    **NO_SENSITIVITIES,
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.acceptable_iter": 12,
    "ipopt.acceptable_tol": 1e-5,
    "ipopt.acceptable_constr_viol_tol": 1e-7,
    "ipopt.acceptable_obj_change_tol": 1e-7,
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.honor_original_bounds": "yes",
}

STRATEGIES: dict[str, dict[str, Any]] = {
    "quick": {"ipopt.mu_strategy": "adaptive", "ipopt.limited_memory_max_history": 6},
    "patient": {"ipopt.mu_strategy": "monotone", "ipopt.limited_memory_max_history": 30},
}
"""Quick is best on most problems; on some it goes round in circles, and patient does not."""


@dataclass(frozen=True, eq=False)
class Values:
    """f, its gradient (X,), g (G,) and its Jacobian (G, X) at a point."""

    objective: float
    gradient: Array
    constraints: Array
    jacobian: Array


Evaluate = Callable[[Array], Values]
"""Values at x (X,); NaN where there are none."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where IPOPT ended: x (X,), values there, multipliers of constraints (G,) (>= 0 where g >= 0 is active) and of
    bounds (X,), its own verdict, iterations."""

    x: Array
    values: Values
    multipliers: Array
    bound_multipliers: Array
    success: bool
    status: str
    iterations: int


class _Memory:
    """The last values, so that value and gradient at one point cost one evaluation."""

    def __init__(self, evaluate: Evaluate) -> None:
        self._evaluate = evaluate
        self._at: bytes = b""
        self._values: Values | None = None

    def __call__(self, x: Array) -> Values:
        key = x.tobytes()
        if self._values is None or key != self._at:
            self._values, self._at = self._evaluate(x), key
        return self._values


class _Slopes(ca.Callback):
    def __init__(self, memory: _Memory, size: int, rows: int) -> None:
        super().__init__()
        self._memory, self._size, self._rows = memory, size, rows
        self.construct("slopes", {})

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense((self._size, 1, self._rows)[i], 1)

    def get_sparsity_out(self, i: int) -> Any:
        return ca.Sparsity.dense((1, self._rows)[i], self._size)

    def eval(self, arguments: Any) -> Any:
        values = self._memory(np.array(arguments[0]).ravel())
        return [ca.DM(values.gradient[None]), ca.DM(values.jacobian)]


class _Program(ca.Callback):
    def __init__(self, memory: _Memory, size: int, rows: int) -> None:
        super().__init__()
        self._memory, self._size, self._rows = memory, size, rows
        self._slopes = _Slopes(memory, size, rows)
        self.construct("program", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self._size, 1)

    def get_sparsity_out(self, i: int) -> Any:
        return ca.Sparsity.dense((1, self._rows)[i], 1)

    def eval(self, arguments: Any) -> Any:
        values = self._memory(np.array(arguments[0]).ravel())
        return [ca.DM(values.objective), ca.DM(values.constraints)]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, opts: Any) -> Any:
        return self._slopes


class _Watch(ca.Callback):
    """Calls `report` with the iteration's objective."""

    def __init__(self, report: Callable[[float], object], size: int, rows: int) -> None:
        super().__init__()
        self._report, self._size, self._rows = report, size, rows
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        size = {"f": 1, "x": self._size, "lam_x": self._size, "g": self._rows, "lam_g": self._rows}
        return ca.Sparsity.dense(size.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, arguments: Any) -> Any:
        self._report(float(arguments[1]))
        return [0]


def minimise(
    evaluate: Evaluate,
    start: Array,
    lower: Array,
    upper: Array,
    *,
    tolerance: float = 1e-8,
    iterations: int = 300,
    strategy: str = "quick",
    report: Callable[[float], object] | None = None,
) -> Optimum:
    """Minimise f(x) subject to g(x) >= 0 and lower <= x <= upper, from `start` (X,), in the scale of x.

    Values may be NaN where the functions are not defined: the step is then shortened.
    """
    memory = _Memory(evaluate)
    rows = len(memory(start).constraints)
    size = len(start)
    program = _Program(memory, size, rows)
    x = ca.MX.sym("x", size)
    f, g = program(x)
    options = {
        **OPTIONS,
        **STRATEGIES[strategy],
        "ipopt.tol": tolerance,
        "ipopt.constr_viol_tol": tolerance,
        "ipopt.max_iter": iterations,
    }
    watch = None
    if report is not None:
        watch = _Watch(report, size, rows)
        options["iteration_callback"] = watch
    solver = ca.nlpsol("design", "ipopt", {"x": x, "f": f, "g": g}, options)
    result = solver(x0=start, lbx=lower, ubx=upper, lbg=np.zeros(rows), ubg=np.full(rows, np.inf))
    stats = solver.stats()
    found = np.clip(np.array(result["x"]).ravel(), lower, upper)
    return Optimum(
        x=found,
        values=memory(found),
        multipliers=-np.array(result["lam_g"]).ravel(),
        bound_multipliers=-np.array(result["lam_x"]).ravel(),
        success=bool(stats["success"]),
        status=str(stats["return_status"]).replace("_", " ").lower(),
        iterations=int(stats["iter_count"]),
    )
