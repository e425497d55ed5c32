"""The settings of IPOPT for a program, and how a solve may end."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

from ..errors import InputError, choice, positive

HESSIANS = ("exact", "limited-memory")


@dataclass(frozen=True)
class Ipopt:
    """How IPOPT solves a `Problem`.

    Args:
        tolerance: of optimality and of constraints over their scales. An answer that is merely "acceptable" to IPOPT
            counts as a failure.
        iterations: after how many it gives up.
        linear_solver: of the Newton steps; "mumps" comes with CasADi.
        expand: write the program out in scalars first: a solve is faster, the building slower. For one to three blocks.
        hessian: "exact" second derivatives, or "limited-memory".
        barrier: barrier parameter with which a cold start begins.
        print_level: 0 silent, 5 a line for every iteration.

    Raises:
        InputError: a field out of its range.
    """

    tolerance: float = 1e-10
    iterations: int = 500
    linear_solver: str = "mumps"
    expand: bool = False
    hessian: str = "exact"
    barrier: float = 0.1
    print_level: int = 0

    def __post_init__(self) -> None:
        positive("tolerance", self.tolerance)
        positive("barrier", self.barrier)
        choice("hessian", self.hessian, HESSIANS)
        if self.iterations < 1:
            raise InputError(f"iterations is {self.iterations}; it must be at least 1")
        if not 0 <= self.print_level <= 12:
            raise InputError(f"print_level is {self.print_level}; it must lie between 0 and 12")

    def options(self, *, warm: bool) -> dict[str, Any]:
        """Options of `casadi.nlpsol`; `warm` for a start with multipliers."""
        own: dict[str, Any] = {
            "tol": self.tolerance,
            "constr_viol_tol": self.tolerance,
            "max_iter": self.iterations,
            "linear_solver": self.linear_solver,
            "hessian_approximation": self.hessian,
            "mu_init": self.barrier,
            "print_level": self.print_level,
            "sb": "yes",
            # "Acceptable" is not converged: what is not within the tolerance is a failure, and said to be one.
            "acceptable_iter": 0,
        }
        if warm:
            near = dict.fromkeys(
                (f"warm_start_{what}" for what in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")),
                1e-9,
            )
            own |= {"warm_start_init_point": "yes", "warm_start_mult_bound_push": 1e-9, "mu_init": 1e-9, **near}
        return {
            "print_time": False,
            "show_eval_warnings": False,
            "expand": self.expand,
            **{f"ipopt.{key}": value for key, value in own.items()},
        }


class ProblemStatus(Enum):
    """How the solve of a program ended; every value reads as a sentence."""

    SOLVED = "an optimum was found"
    INFEASIBLE = "no point was found at which all constraints hold"
    TOO_MANY_ITERATIONS = "the solver ran out of iterations"
    UNBOUNDED = "the iterates grow without bound"
    NOT_A_NUMBER = "an expression of the program has no finite value or derivative where the solver came"
    STOPPED = "the solver came to a halt before an optimum"

    def __str__(self) -> str:
        return self.value

    @classmethod
    def of(cls, verdict: str) -> ProblemStatus:
        """The status behind a return status of IPOPT."""
        known = {
            "Solve_Succeeded": cls.SOLVED,
            "Infeasible_Problem_Detected": cls.INFEASIBLE,
            "Maximum_Iterations_Exceeded": cls.TOO_MANY_ITERATIONS,
            "Diverging_Iterates": cls.UNBOUNDED,
            "Invalid_Number_Detected": cls.NOT_A_NUMBER,
        }
        return known.get(verdict, cls.STOPPED)
