"""IPOPT on functions that compute their own first derivatives: values and gradients in, raw solution and status out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..typing import Array
from .settings import NO_SENSITIVITIES
from .time_limit import LEAST_SECONDS, LateError, check_time, time_left

OPTIONS: dict[str, Any] = {
    **NO_SENSITIVITIES,
    "print_time": False,
    "show_eval_warnings": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.tol": 1e-8,
    "ipopt.constr_viol_tol": 1e-8,
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


def nowhere(rows: int, size: int) -> Values:
    """Values where the functions are not defined."""
    nan = np.full(rows, np.nan)
    return Values(np.nan, np.full(size, np.nan), nan, np.full((rows, size), np.nan))


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


class _Callback(ca.Callback):
    """A function of dense matrices of the shapes `inputs` and `outputs`; `jacobian` has its derivatives."""

    def __init__(
        self,
        name: str,
        inputs: list[tuple[int, int]],
        outputs: list[tuple[int, int]],
        function: Callable[..., list[Any]],
        jacobian: _Callback | None = None,
    ) -> None:
        super().__init__()
        self._inputs, self._outputs, self._function, self._jacobian = inputs, outputs, function, jacobian
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(*self._inputs[i])

    def get_sparsity_out(self, i: int) -> Any:
        return ca.Sparsity.dense(*self._outputs[i])

    def eval(self, arguments: Any) -> Any:
        return self._function(*arguments)

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(self, name: str, inames: Any, onames: Any, opts: Any) -> Any:
        return self._jacobian


def _program(values_at: Callable[[bytes], Values], size: int, rows: int) -> _Callback:
    """x -> f, g, with their derivatives."""

    def both(x: Any) -> list[Any]:
        here = values_at(np.array(x).tobytes())
        return [ca.DM(here.objective), ca.DM(here.constraints)]

    def slopes(x: Any, *_: Any) -> list[Any]:
        here = values_at(np.array(x).tobytes())
        return [ca.DM(here.gradient[None]), ca.DM(here.jacobian)]

    shapes = [(1, 1), (rows, 1)]
    derivatives = _Callback("slopes", [(size, 1), *shapes], [(1, size), (rows, size)], slopes)
    return _Callback("program", [(size, 1)], shapes, both, derivatives)


def _watch(report: Callable[[float], object], size: int, rows: int) -> _Callback:
    """Calls `report` with the iteration's objective."""

    def told(x: Any, f: Any, *_: Any) -> list[Any]:
        report(float(f))
        return [0]

    known = {"f": 1, "x": size, "lam_x": size, "g": rows, "lam_g": rows}
    inputs = [(known.get(ca.nlpsol_out(i), 0), 1) for i in range(ca.nlpsol_n_out())]
    return _Callback("watch", inputs, [(1, 1)], told)


def minimise(
    evaluate: Evaluate,
    start: Array,
    lower: Array,
    upper: Array,
    *,
    iterations: int,
    strategy: str,
    report: Callable[[float], object] | None,
) -> Optimum:
    """Minimise f(x) subject to g(x) >= 0 and lower <= x <= upper, from `start` (X,), in the scale of x.

    Values may be NaN where the functions are not defined: the step is then shortened.

    Raises:
        LateError: the nearest time limit is reached.
    """
    late: list[LateError] = []

    @lru_cache(maxsize=1)
    def values_at(x: bytes) -> Values:
        """So that value and gradient at one point cost one evaluation."""
        try:
            check_time()
            return evaluate(np.frombuffer(x).copy())
        except LateError as error:  # IPOPT has to end before it may go up
            late.append(error)
            return nowhere(rows, size)

    size, rows = len(start), 0
    rows = len(values_at(start.tobytes()).constraints)
    if late:
        raise late[0]
    program = _program(values_at, size, rows)
    x = ca.MX.sym("x", size)
    f, g = program(x)
    options = {**OPTIONS, **STRATEGIES[strategy], "ipopt.max_iter": iterations}
    if time_left() < np.inf:
        options["ipopt.max_wall_time"] = max(time_left(), LEAST_SECONDS)
    if report is not None:
        options["iteration_callback"] = _watch(report, size, rows)
    solver = ca.nlpsol("design", "ipopt", {"x": x, "f": f, "g": g}, options)
    result = solver(x0=start, lbx=lower, ubx=upper, lbg=np.zeros(rows), ubg=np.full(rows, np.inf))
    stats = solver.stats()
    found = np.clip(np.array(result["x"]).ravel(), lower, upper)
    values = values_at(found.tobytes())
    if late:
        raise late[0]
    return Optimum(
        x=found,
        values=values,
        multipliers=-np.array(result["lam_g"]).ravel(),
        bound_multipliers=-np.array(result["lam_x"]).ravel(),
        success=bool(stats["success"]),
        status=str(stats["return_status"]).replace("_", " ").lower(),
        iterations=int(stats["iter_count"]),
    )
