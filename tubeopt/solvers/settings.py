"""Settings of the solvers that a user may change, and limits that Python and the compiled kernels share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, Settings, choice, positive, whole
from .time_limit import TIME_LIMIT


@dataclass(frozen=True)
class Newton(Settings):
    """Settings of Newton's method and of the energy descent before it, for an equilibrium.

    Raises:
        InputError: a field out of its range.
    """

    iterations: int = 20
    """Maximum number of Newton iterations."""
    descent_iterations: int = 60
    """Maximum number of descent iterations."""
    margin_tolerance: float = 1e-8
    """Accuracy under load of margins so close to 1 that they need a check of their own."""


NEWTON = Newton()
"""Default settings of Newton's method for equilibria."""

# The limits below are compiled into the kernels: kernel and Python follow the same branch only with the same limits.

# Newton's method converges quadratically: after a step of 1e-6 rad the error is about 1e-12 rad, which is round-off of
# the residual. At 1e-3 a solve stops with an error of 1e-6 rad; below 1e-8 round-off may keep a step from falling
# below.
LAST_STEP = 1e-6
"""Newton step (rad) after which an iteration ends, if the residual is of round-off."""

NEWTON_ROUND_OFF = 1e-12
"""Residual or step (rad) close to round-off; smaller values are no sign of divergence."""

# The coupling energy has the period 2 pi: within 1 rad its second-order model still has the right sign of curvature.
LONGEST_STEP = 1.0
"""Largest change (rad) of a rotation in one step of the energy descent."""

# Newton's steps shrink as their squares near a solution of the same branch, and by a constant factor close to a fold,
# where the two solutions are the same. Friction paths depend on it: see `TOWARDS_FRICTION_FOLD`.
LARGEST_RATIO = 0.3
"""Largest ratio of successive Newton steps of a solution on the same branch."""

LARGEST_TWIST = 0.6
"""Largest change (rad) of the twist theta - alpha at a point in one step along a branch."""

# The two stable branches of a narrow hysteresis are little more than this apart.
SOFT_TWIST = 0.1
"""Value of LARGEST_TWIST (rad) at margin 0."""

LARGEST_EXCHANGE = 0.05
"""Largest change (rad) of the twist in one step along a branch in which ends of tubes of a bundle pass each other.

A jump there is found if it is larger; smaller ones, up to 2 mm at the tip of an arm of 0.1 m, are steps."""

LARGEST_TURN = 0.3
"""Largest change (rad) of a joint rotation in one step along a path. Equilibria repeat after a full turn: a step must
be much smaller."""

LARGEST_SHIFT = 0.05
"""Largest change of a translation in one step along a path, as a fraction of the longest tube."""

# An error is divided by the margin, which vanishes at a fold; without this bound no fold would have an error estimate.
LEAST_STIFFNESS = 1e-6
"""Smallest margin used as a divisor of an error estimate."""

# Only for arms that a load hardly softens is the margin less accurate than the shape.
HARDLY_SOFTENED = 0.99
"""Margin above which its own accuracy is checked under load."""

SHORTEST_LOAD_STEP = 1e-3
"""Fraction of a load below which the compiled kernel leaves a failing step to the general solver."""

# A descent never repeats an active set. It ends after few changes a component unless round-off makes it repeat one.
BOX_CHANGES = 20
"""Changes of the active set per component after which the search of a minimum within a box stops."""

FRICTION_ITERATIONS = 15
"""Maximum number of Newton iterations of an increment with friction."""

ONWARD = 0.9
"""Cosine of the angle between two increments of the bases above which the second continues the first."""

HESSIANS = ("exact", "limited-memory")
"""Second derivatives for IPOPT."""

NO_SENSITIVITIES = {"no_nlp_grad": True, "calc_lam_p": False}
"""Options of `casadi.nlpsol` without parametric sensitivities, which take as long to build as all other derivatives."""


class WarmStart(NamedTuple):
    """Settings of IPOPT for a start with multipliers."""

    barrier: float
    """Barrier parameter."""
    push: float
    """Distance from bounds to which the start is moved; IPOPT would move it farther otherwise."""


AT_SOLUTION = WarmStart(1e-9, 1e-9)
"""Start at an earlier solution."""

# Of barriers from 1e-8 to 1e-5 and pushes from 1e-6 to 1e-2 these need the fewest iterations after a swap of
# breakpoints.
NEAR_SOLUTION = WarmStart(1e-6, 1e-3)
"""Start close to a solution."""

LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma77", "ma86", "ma97", "pardiso", "pardisomkl", "spral", "wsmp")
"""Linear solvers of IPOPT; all but the first must be installed."""


@typed
@dataclass(frozen=True)
class Ipopt(Displayed):
    """Settings of IPOPT, for a `Problem` or the equations of an equilibrium.

    Raises:
        InputError: a field out of its range.
    """

    tolerance: float = 1e-10
    """Tolerance of optimality and of scaled constraints. An "acceptable" solution of IPOPT counts as a failure."""
    constraint_tolerance: float | None = None
    """Tolerance of scaled constraints; None is `tolerance`."""
    iterations: int = 500
    """Maximum number of iterations."""
    time_limit: float = TIME_LIMIT
    """Time limit of one solve, s; IPOPT then stops at its current point."""
    linear_solver: str = "mumps"
    """Linear solver of the Newton steps; "mumps" is included in CasADi."""
    expand: bool = False
    """Expand the program to scalar operations: solves are faster, building slower. For one to three blocks."""
    hessian: str = "exact"
    """Second derivatives: "exact", or "limited-memory"."""
    barrier: float = 0.1
    """Initial barrier parameter of a cold start."""
    push: float = 1e-2
    """Smallest distance of a cold start from its bounds, in scaled units and relative to their distance."""
    print_level: int = 0
    """Output of IPOPT: 0 silent, 5 a line for every iteration."""

    further: Mapping[str, float | str] = field(default_factory=dict, hash=False)
    """Further options of IPOPT by their names, such as {"mumps_pivtol": 1e-2}."""

    def __post_init__(self) -> None:
        positive("tolerance", self.tolerance)
        if self.constraint_tolerance is not None:
            positive("constraint_tolerance", self.constraint_tolerance)
        positive("barrier", self.barrier)
        positive("push", self.push)
        if self.time_limit != math.inf:
            positive("time_limit", self.time_limit)
        choice("hessian", self.hessian, HESSIANS)
        choice("linear_solver", self.linear_solver, LINEAR_SOLVERS)
        whole("iterations", self.iterations, 1)
        if whole("print_level", self.print_level, 0) > 12:
            raise InputError(f"print_level is {self.print_level}; it must lie between 0 and 12")

    def options(self, *, warm: WarmStart | None = None) -> dict[str, Any]:
        """Options of `casadi.nlpsol`; `warm` for a start with multipliers."""
        ipopt: dict[str, Any] = {
            "tol": self.tolerance,
            "constr_viol_tol": self.constraint_tolerance or self.tolerance,
            "max_iter": self.iterations,
            "linear_solver": self.linear_solver,
            "hessian_approximation": self.hessian,
            "mu_init": self.barrier if warm is None else warm.barrier,
            "print_level": self.print_level,
            "sb": "yes",
            # An "acceptable" solution has not converged within the tolerance: it counts as a failure.
            "acceptable_iter": 0,
        }
        if self.time_limit < math.inf:
            ipopt["max_wall_time"] = self.time_limit
        pushes = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
        ipopt |= dict.fromkeys(pushes, self.push)
        if warm is not None:
            ipopt["warm_start_init_point"] = "yes"
            ipopt |= {f"warm_start_{push}": warm.push for push in (*pushes, "mult_bound_push")}
        ipopt |= self.further
        return {
            "print_time": False,
            "show_eval_warnings": False,
            **NO_SENSITIVITIES,
            **{f"ipopt.{key}": value for key, value in ipopt.items()},
        }
