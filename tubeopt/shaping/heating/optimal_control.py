"""Heating schedule as an optimal control problem: the course of a rig, limits and objective, compiled once.

What may be chosen of the rig (clearance, lead and vents) is always unknown, fixed by its bounds where the rig is given,
so that one compiled program serves every tube, rig and question.

The equations of one instant depend on few unknowns, and linearly on the rates of its temperatures. They are
differentiated as symbols once and evaluated at all points. Automatic differentiation of the whole program would take
one sweep for each direction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ...physics.heat import Resolution
from ...solvers.settings import Ipopt
from ...typing import Array
from .rig_course import (
    NO_PLACES,
    SCALE,
    TASK,
    TIME_MESH,
    VENTS,
    GridPlaces,
    RigCourse,
    TimeMesh,
    instant,
    parameter_count,
)

LOCAL, PARAMETERS = (0, 2, 3, 4), 5
"""Inputs of `instant`: those that are unknowns of the instant other than rates, and the parameters of tube and rig."""


class Derivative(NamedTuple):
    """Sparse derivative of one instant."""

    nonzeros: ca.Function
    pattern: Any


@lru_cache(maxsize=8)
def instant_derivatives(resolution: Resolution) -> tuple[Derivative, Derivative]:
    """Jacobian and Hessian of `instant` by its local unknowns.

    The rates, in which the equations are linear, are left out. The Jacobian of the equations is a function of (own
    unknowns, parameters), the Hessian of the equations times multipliers of (own unknowns, parameters, multipliers).
    """
    whole = instant(resolution)
    inputs = whole.sx_in()
    sizes = np.cumsum([0, *(inputs[k].numel() for k in LOCAL)]).tolist()
    local, parameters = ca.SX.sym("local", sizes[-1]), inputs[PARAMETERS]
    z, circuit, I_sq, design = ca.vertsplit(local, sizes)
    equations = whole(z, ca.SX(*z.shape), circuit, I_sq, design, parameters)
    multipliers = ca.SX.sym("multipliers", equations.numel())
    # Derivatives of one instant serve all points by a map: the pattern is built and coloured once.
    J = ca.jacobian(equations, local)
    H = ca.hessian(ca.dot(multipliers, equations), local)[0]
    jacobian = ca.Function("slopes", [local, parameters], [J.nz[:]], {"cse": True})
    hessian = ca.Function("bends", [local, parameters, multipliers], [H.nz[:]], {"cse": True})
    return Derivative(jacobian, J.sparsity()), Derivative(hessian, H.sparsity())


def exact_derivatives(
    problem: dict[str, Any], resolution: Resolution, *, parameters: Any, local: Any, rest: Any
) -> dict[str, ca.Function]:
    """Jacobian of the constraints of a program and Hessian of its Lagrangian, as options of its `nlpsol`.

    Both are sums of what depends on the unknowns through the instants, and the rest.

    Args:
        parameters: of tube and rig.
        local: (Y, N) own unknowns of every instant, linear in the unknowns.
        rest: all constraints, where the equations of the instants, which come first, are reduced to their rates.
    """
    x, p, f, g = (problem[name] for name in "xpfg")
    jacobian, hessian = instant_derivatives(resolution)
    count, size = local.size2(), jacobian.pattern.size1()
    factor, multipliers = ca.MX.sym("factor"), ca.MX.sym("multipliers", g.numel())
    of_instants = ca.reshape(multipliers[: count * size], size, count)
    J_nonzeros = jacobian.nonzeros.map("slopes", "serial", count, [1], [])(local, parameters)
    H_nonzeros = hessian.nonzeros.map("bends", "serial", count, [1], [])(local, parameters, of_instants)
    # Chain rule with a constant matrix, as local unknowns are linear in x.
    local_by_x = ca.jacobian(ca.vec(local), x)
    # Only the first constraints, the equations of instants, depend on x through them.
    others = ca.MX(g.numel() - count * size, x.numel())
    J = ca.jacobian(rest, x) + ca.vertcat(ca.mtimes(_blocks(jacobian.pattern, J_nonzeros), local_by_x), others)
    lagrangian = factor * f + ca.dot(multipliers, rest)
    H = ca.hessian(lagrangian, x)[0] + ca.mtimes([local_by_x.T, _blocks(hessian.pattern, H_nonzeros), local_by_x])
    inputs = {"x": x, "p": p}
    return {
        "jac_g": _function("jac_g", inputs, {"g": g, "jac_g_x": J}),
        "hess_lag": _function(
            "hess_lag", {**inputs, "lam_f": factor, "lam_g": multipliers}, {"triu_hess_gamma_x_x": ca.triu(H)}
        ),
    }


def _blocks(pattern: Any, values: Any) -> Any:
    """Block-diagonal matrix of one pattern with its nonzeros in columns."""
    return ca.MX(ca.diagcat(*[pattern] * values.size2()), ca.vec(values))


def _function(name: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> ca.Function:
    return ca.Function(name, list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))


# --- the program ------------------------------------------------------------------------------------------------------


REGULARISATION = 1e-5
"""Added to the diagonal of the convex Hessian, in scaled unknowns."""

# The objective is in units of about 1 K and 30 s: a tolerance of 1e-4 is far below what the coarse grid and counts
# change. Tubes that are hard to heat take up to about 150 iterations.
IPOPT = Ipopt(tolerance=1e-4, constraint_tolerance=1e-7, iterations=250, barrier=1e-2)

# A correction moves the bounds by a few K, which takes 3 to 30 steps. After more a new start is faster.
RESTART_ITERATIONS = 40
"""Iterations from an earlier solution before a new start."""

MUMPS: dict[str, Any] = {
    # With the default the inertia is lost to round-off, and every step is tried several times.
    "ipopt.mumps_pivtol": 1e-2,
    "ipopt.mumps_pivot_order": 5,  # METIS: the pattern is that of a grid, in space and time.
    # Memory beyond the estimate of the analysis, in percent. Ten times as much would be mapped anew in every iteration.
    "ipopt.mumps_mem_percent": 20,
}

# The program is nearly linear: each barrier problem needs little accuracy.
COLD: dict[str, Any] = {"ipopt.barrier_tol_factor": 100.0}
# A solution from a start that violates custom requirements is corrected in any case: it needs less accuracy. For
# objective "margin" a smaller barrier takes half as many steps from there, for "energy" up to twice as many.
ROUGH: dict[str, Any] = {**COLD, "ipopt.tol": 3e-3, "ipopt.compl_inf_tol": 3e-3}
ROUGH_BARRIER = {True: 1e-3, False: 1e-2}
"""First barrier parameter of `Program.rough`, with and without a soft limit."""

# Other limits are active after a correction. Bounds at which the start almost lies would let no step be long: with a
# tenth of the barrier and of the distances the hardest programs take twice as many steps.
WARM: dict[str, Any] = {
    "ipopt.mu_init": 1e-4,
    "ipopt.warm_start_init_point": "yes",
    **dict.fromkeys(
        (
            "ipopt.warm_start_bound_push",
            "ipopt.warm_start_bound_frac",
            "ipopt.warm_start_slack_bound_push",
            "ipopt.warm_start_slack_bound_frac",
            "ipopt.warm_start_mult_bound_push",
        ),
        1e-2,
    ),
}


@dataclass(frozen=True)
class Structure:
    """Everything that the structure of a program depends on: each needs a compiled program of its own."""

    resolution: Resolution
    mesh: TimeMesh = TIME_MESH
    soft_limit: bool = False
    """True if the miss relaxes the limit as it does the window; otherwise the limit bounds the unknowns."""
    chosen: tuple[str, ...] = ()
    """Parameters of the rig that may be chosen: every interval has a copy of them."""

    @property
    def copied(self) -> list[int]:
        """Rows of the design that are free."""
        rows = {"clearance": [0], "lead": [1], "vents": list(range(2, 2 + VENTS))}
        return [row for name, of_name in rows.items() if name in self.chosen for row in of_name]

    @property
    def copies(self) -> int:
        """Number of unknowns, the last ones, that repeat the design in each interval but the first."""
        return len(self.copied) * (self.mesh.heating + self.mesh.hold - 1)

    def copies_of(self, design: Array) -> Array:
        """Values of the copies of a design (2 + VENTS,)."""
        return np.resize(design[self.copied], self.copies)

    @property
    def states(self) -> int:
        """Number of states: temperatures of tube, shells and clamp, charge drawn and sag."""
        return self.resolution.cells + self.resolution.covered * self.resolution.shells + 3

    @property
    def points(self) -> int:
        """Number of collocation points in time, N."""
        return (self.mesh.heating + self.mesh.hold) * self.mesh.degree

    @property
    def unknowns(self) -> dict[str, tuple[int, int]]:
        """Shapes of the unknowns by their names, in order."""
        intervals = self.mesh.heating + self.mesh.hold
        return {
            "z": (self.states, self.points),
            "circuit": (2, self.points),
            "I_sq": (1, intervals + 1),
            "durations": (1, self.mesh.heating),
            "misses": (1, self.points),
            "design": (2 + VENTS, 1),
            "copies": (len(self.copied), intervals - 1),
        }


@dataclass(frozen=True, eq=False)
class Program:
    """Compiled solvers of the program of one structure."""

    structure: Structure
    exact: Any
    """Solver with the exact Hessian."""
    rough: Any
    """Solver of less accuracy, for starts that violate custom requirements; None without any."""
    restart: Any
    """Solver that starts at an earlier solution and takes few steps."""
    convex: Any
    """Solver with a convex part of the Hessian, for when the others fail."""
    split: Any
    """Function that takes the column of unknowns apart."""
    custom: Any
    """Function (unknowns without slacks, parameters) -> values of custom requirements."""
    sizes: dict[str, int]
    """Number of constraints of each kind, in their order."""

    def worst(self, violation: Array) -> str:
        """Description of the constraint that is violated most."""
        row = int(np.argmax(violation))
        for name, size in self.sizes.items():
            if row < size:
                return f"the worst constraint is {name}, entry {row + 1} of {size}, violated by {violation.max():.1e}"
            row -= size
        raise AssertionError


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """Symbols of the unknowns.

    There is a copy of the duration in every interval and of the miss at every point: a single one would be a dense
    column, which fills the factors. The same holds for the chosen design.
    """

    z: Any
    """(S, N) states at the points."""
    circuit: Any
    """(2, N) current and resistance of half the tube at the points."""
    I_sq: Any
    """(1, 1+K) mean square current at the ends of the intervals."""
    durations: Any
    """(1, intervals of heating) copies of the heating time."""
    misses: Any
    """(1, N) copies of the miss of the window."""
    design: Any
    """(2 + VENTS,) clearance, lead and vents."""
    copies: Any
    """(chosen rows, K-1) copies of the chosen design in the other intervals."""

    @property
    def column(self) -> Any:
        """All unknowns in one column."""
        return ca.veccat(*vars(self).values())

    def designs(self, s: Structure) -> Any:
        """(2 + VENTS, N) design at every point: that of its interval."""
        count = s.mesh.heating + s.mesh.hold
        rows = [ca.repmat(row, 1, count) for row in ca.vertsplit(self.design)]
        for k, row in enumerate(s.copied):
            rows[row] = ca.horzcat(self.design[row], self.copies[k, :])
        return ca.kron(ca.vertcat(*rows), ca.DM.ones(1, s.mesh.degree))


@dataclass(frozen=True, eq=False)
class CustomTerms:
    """Requirements and objective of a user, as functions of the course; compared by identity."""

    requirements: tuple[Callable[[RigCourse], Any], ...] = ()
    """Functions that return expressions whose entries must be at least 0, scaled."""
    objective: Callable[[RigCourse], Any] | None = None
    """Function that returns what is minimised in place of time and energy, scaled."""
    grid: GridPlaces = NO_PLACES
    """Places of the cells of the rig."""


NO_TERMS = CustomTerms()
"""The program of the built-in objectives alone."""


def _course(s: Structure, grid: GridPlaces) -> tuple[_Unknowns, Any, Any, RigCourse]:
    """Unknowns, parameters of the rig, values of `TASK`, and the course that they determine."""
    x = _Unknowns(**{name: ca.MX.sym(name, *shape) for name, shape in s.unknowns.items()})
    p, task = ca.MX.sym("p", parameter_count(s.resolution)), ca.MX.sym("task", len(TASK))
    course = RigCourse(
        s.resolution,
        s.mesh,
        z=x.z,
        circuit=x.circuit,
        I_sq_nodes=x.I_sq,
        durations=x.durations,
        hold=task[TASK.index("hold")],
        designs=x.designs(s),
        column=p,
        grid=grid,
    )
    return x, p, task, course


@lru_cache(maxsize=8)
def custom_function(s: Structure, custom: CustomTerms) -> ca.Function:
    """Function (unknowns without slacks, parameters) -> values of every custom requirement, a column each."""
    x, p, task, course = _course(s, custom.grid)
    values = [ca.vec(ca.MX(requirement(course))) for requirement in custom.requirements]
    return ca.Function("requirements", [x.column, ca.veccat(p, task)], values)


@lru_cache(maxsize=8)
def program(s: Structure, custom: CustomTerms = NO_TERMS) -> Program:
    """Compiled program of a structure."""
    x, p, task, course = _course(s, custom.grid)
    w = dict(zip(TASK, ca.vertsplit(task), strict=True))
    limits = course.limits(w, x.misses)
    limits["limit"] = limits["limit"][:, : s.soft_limit * s.points]
    blocks = {
        "equations": course.equations,
        # Copies are equal by constraints of two entries each, which keep the factors sparse.
        "same": ca.horzcat(ca.diff(x.durations, 1, 1), ca.diff(x.misses, 1, 1)),
        **limits,
        # Copies of the design are equal from interval to interval, as those of the duration.
        "chosen": ca.diff(ca.horzcat(x.design[s.copied], x.copies), 1, 1) if s.copied else ca.MX(0, 1),
    }
    values = ca.veccat(ca.MX(0, 1), *(requirement(course) for requirement in custom.requirements))
    # From a start that violates them, IPOPT would take a hundred steps or more; slacks let it move on.
    slacks = ca.MX.sym("slacks", values.numel())
    blocks["custom"] = values + slacks
    smooth = course.regularisation(w, x.design)
    linear = w["w_time"] * x.durations[0] + w["w_miss"] * x.misses[0] + w["w_custom"] * ca.sum1(slacks)
    if custom.objective is not None:
        linear += custom.objective(course)

    column = ca.vertcat(x.column, slacks)
    problem = {
        "x": column,
        "p": ca.veccat(p, task),
        "f": smooth + linear + w["w_energy"] / SCALE.energy * course.energy,
        "g": ca.veccat(*blocks.values()),
    }
    blocks["equations"] = ca.vertcat(course.rate, ca.MX(course.equations.size1() - s.states, s.points))
    derivatives = exact_derivatives(
        problem,
        s.resolution,
        parameters=p,
        local=ca.vertcat(x.z, x.circuit, course.I_sq, course.designs),
        rest=ca.veccat(*blocks.values()),
    )
    exact = {**IPOPT.options(), **MUMPS, **derivatives}
    convex = {**exact, "hess_lag": _convex_hessian(problem, smooth)}
    rough = {**exact, **ROUGH, "ipopt.mu_init": ROUGH_BARRIER[s.soft_limit]}
    return Program(
        structure=s,
        convex=ca.nlpsol("heating", "ipopt", problem, {**convex, **COLD}),
        restart=ca.nlpsol("heating_again", "ipopt", problem, {**exact, **WARM, "ipopt.max_iter": RESTART_ITERATIONS}),
        exact=ca.nlpsol("heating_exact", "ipopt", problem, {**exact, **COLD}),
        rough=ca.nlpsol("heating_rough", "ipopt", problem, rough) if custom.requirements else None,
        split=ca.Function("split", [column], [x.z, x.circuit, x.I_sq, x.durations[0], x.misses[0], x.design]),
        custom=ca.Function("custom", [x.column, problem["p"]], [values]),
        sizes={name: int(block.numel()) for name, block in blocks.items()},
    )


def _convex_hessian(problem: dict[str, Any], smooth: Any) -> ca.Function:
    """Hessian of the squares in the objective alone, a little regularised: the equations are nearly linear.

    With it every step is that of a convex quadratic program. Where the equations are curved, such steps are short.
    """
    x = problem["x"]
    weight, multipliers = ca.MX.sym("weight"), ca.MX.sym("multipliers", problem["g"].numel())
    H = ca.hessian(smooth, x)[0] * weight + REGULARISATION * ca.DM.eye(x.numel())
    return ca.Function("curvature", [x, problem["p"], weight, multipliers], [ca.triu(H)])
