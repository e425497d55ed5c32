"""Equilibria by IPOPT, as collocated equations or as minima of the energy, and IPOPT for functions with derivatives.

Under load the potential energy is minimised, with the orientation among the unknowns.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..block.transcription import loaded as under_load
from ..block.transcription.arm import Profile, torques_at
from ..block.transcription.loaded import LoadedProblem, LoadedState
from ..block.transcription.model import equation, location_labels, mapped
from ..block.transcription.program import (
    Structure,
    add_torsion,
    structure_of,
    torsion_constants,
    torsion_guess,
    torsion_numbers,
)
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, to_unknowns
from ..errors import SolveError
from ..physics.shape import quaternion_rates, tangent_forms
from ..physics.torsion import section_functions
from ..typing import Array
from .named_program import ProblemStatus
from .newton import NewtonResult
from .problem import Problem
from .settings import NO_SENSITIVITIES, Ipopt
from .time_limit import MIN_SECONDS, OutOfTimeError, check_time, time_left

EQUILIBRIUM = Ipopt(tolerance=1e-12, iterations=300, expand=True)
"""Default settings for equilibria."""

EQUATIONS = replace(EQUILIBRIUM, hessian="limited-memory")
"""Default settings for as many equations as unknowns, where second derivatives do not change the steps."""


@lru_cache(maxsize=64)
def _program(structure: Structure, formulation: str, thread: int) -> Problem:
    """Program of one equilibrium with its data as parameters; each thread has a program of its own."""
    problem = Problem(formulation)
    rotations = problem.parameter("rotations", np.zeros(structure.grid.n_tubes))
    if formulation == "equations":
        add_torsion(problem, structure, rotations, {})
    else:
        _add_energy(problem, structure, rotations)
    return problem


def _add_energy(problem: Problem, structure: Structure, rotations: Any) -> None:
    """Add the optimal control problem of an equilibrium: minimum energy over theta with the control w = theta'.

    It is for concentric tubes, whose equilibria are its stationary points. A transmission of no length stores no
    energy, so its twist, which has no effect, gets the cost of a whole arm.
    """
    grid, pieces = structure.grid, len(structure.section)
    n, degree = grid.n_tubes, grid.degree
    inputs = torsion_constants(problem, structure, {})
    base = problem.variable("torsion of the transmissions", n)
    theta = ca.reshape(problem.variable("rotation", n * pieces), n, pieces)
    inner, twist = (
        ca.reshape(problem.variable(f"{what} inside", n * pieces * degree), n, pieces * degree)
        for what in ("rotation", "torsion")
    )
    kt, lengths, transmission = inputs["torsional_stiffness"], inputs["lengths"], inputs["transmission"]
    row = [kt, lengths.T, inputs["along"]] if grid.detail else [inputs["stiffness"], inputs["moment"], kt, lengths.T]
    defect, end, energy = mapped("motion", grid, pieces)(theta, inner, twist, *row)
    tubes = [f"tube {i + 1}" for i in range(n)]
    after, points = location_labels(pieces, degree, structure.section)
    for constraint in (
        equation("rotation equation", tubes, points, defect, 1.0),
        equation("continuity of rotation", tubes, after, theta[:, 1:] - end[:, :-1], 1.0),
        equation("base rotation", tubes, None, theta[:, 0] - rotations - transmission * base, 1.0),
    ):
        problem.subject_to(constraint.name, constraint.expression, upper=0.0, entries=constraint.entries)
    # Twist over no length has no energy: without a cost the program would have a free direction.
    cost_length = ca.if_else(transmission > 0, transmission, ca.sum1(lengths))
    elastic = ca.sum2(energy) + ca.dot(kt[:, 0] * cost_length, base**2) / 2
    problem.minimize(elastic * ca.sum1(lengths) / ca.sum1(kt[:, 0]))


def solve_ipopt(
    problem: ReducedProblem,
    rotations: Array,
    guess: Profile,
    formulation: str = "equations",
    settings: Ipopt | None = None,
) -> NewtonResult[Evaluation]:
    """Solve the collocated problem from the torsion `guess`.

    Args:
        formulation: "equations" (no objective, the equations as constraints) or "energy" (minimum elastic energy).
        settings: default `EQUATIONS` for equations, and `EQUILIBRIUM` for the energy.

    Raises:
        SolveError: IPOPT did not converge; the message has its status and the largest violations.
    """
    if not len(problem.mesh.length):
        return NewtonResult(evaluate(problem, rotations, np.zeros(0)), True, 0, 0.0)
    program = _program(structure_of(problem), formulation, threading.get_ident())
    for name, numbers in {"rotations": rotations, **torsion_numbers(problem)}.items():
        program.set_value(name, numbers)
    start = torsion_guess(problem, guess)
    if formulation == "energy":
        start["torsion of the transmissions"] = start.pop("torsion")[: len(rotations)]
        inside = torques_at(problem, guess, tuple(problem.mesh.tableau.nodes.tolist()))
        start["torsion inside"] = (inside / problem.assembly.held_stiffness).ravel()
    for name, numbers in start.items():
        program.set_guess(name, numbers)
    result = program.attempt(settings or (EQUATIONS if formulation == "equations" else EQUILIBRIUM))
    if result.status is not ProblemStatus.SOLVED:
        worst = "; ".join(map(str, result.violations[:3]))
        verdict = result.statistics.verdict.replace("_", " ").lower()
        raise SolveError(f"IPOPT found no equilibrium ({verdict}): {worst or 'all constraints are satisfied'}")
    theta = inside_points(problem, result.values["rotation inside"])
    state = evaluate(problem, rotations, to_unknowns(problem, rotations, theta))
    return NewtonResult(state, True, result.statistics.iterations, 0.0)


def inside_points(problem: ReducedProblem, inside: Array) -> Array:
    """Rotations theta (N, n) at the points of a reduced problem, from the variable "rotation inside" of all pieces."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    return inside.reshape(len(mesh.length), mesh.tableau.degree, n)[mesh.collocated].reshape(-1, n)


def solve_loaded_ipopt(
    problem: LoadedProblem, rotations: Array, guess: LoadedState, settings: Ipopt | None = None
) -> NewtonResult[LoadedState]:
    """Equilibrium under a load with an energy, from a state close to it.

    The equations are those of `block.transcription.loaded`, but quaternions are unknowns, with constraints that relate
    them to the curvature.
    """
    program, split = Problem("equilibrium under load"), problem.torsion.size
    z = program.variable("twist", split, guess=guess.x[:split])
    q = program.variable("bending", problem.size - split, guess=guess.x[split:])
    start, stage = guess.orientation.start, guess.orientation.stage
    ends = ca.reshape(program.variable("orientation", start.size, guess=start.ravel()), 4, len(start))
    inside = ca.reshape(program.variable("orientation inside", stage.size, guess=stage.ravel()), 4, len(stage))
    bending_energy, curvature = _bending(problem, rotations, z, q)
    omegas = map(ca.DM, quaternion_rates())
    rate = sum(ca.repmat(u, 4, 1) * (omega @ inside) / 2 for u, omega in zip(curvature, omegas, strict=True))
    mesh, defects = problem.mesh, [ends[:, 0] - ca.DM([1, 0, 0, 0])]
    degree = mesh.tableau.degree
    for e, h in enumerate(mesh.length.tolist()):
        points = slice(e * degree, (e + 1) * degree)
        increment = h * rate[:, points] @ ca.DM(np.column_stack([mesh.tableau.matrix.T, mesh.tableau.weights]))
        after = ca.horzcat(inside[:, points], ends[:, e + 1])
        defects.append(ca.vec(after - ca.repmat(ends[:, e], 1, degree + 1) - increment))
    program.subject_to("orientation equation", ca.vertcat(*defects), upper=0.0)
    tangent = ca.vertcat(*(ca.sum1(inside * (ca.DM(form) @ inside)) for form in tangent_forms()))
    work = ca.dot(ca.DM((problem.torsion.weight[:, None] * problem.force).T), tangent)
    potential = (ca.sumsqr(z) + ca.sumsqr(q)) / 2 + bending_energy - work
    program.minimize(potential * problem.tip_lever)
    result = program.attempt(settings or EQUILIBRIUM)
    if result.status is not ProblemStatus.SOLVED:
        raise SolveError(program.failure(result))
    x = np.concatenate([result.values["twist"], result.values["bending"]])
    return NewtonResult(under_load.evaluate(problem, rotations, x), True, result.statistics.iterations, 0.0)


def _bending(problem: LoadedProblem, rotations: Array, z: Any, q: Any) -> tuple[Any, list[Any]]:
    """Coupling energy of the cross-sections, J, and rows u_x and u_y (N,) of the curvature at the points."""
    torsion = problem.torsion
    count, n = torsion.stiffness.shape
    base = rotations + torsion.phase
    theta = ca.reshape(ca.DM(base.ravel()) + ca.DM(problem.spread.reshape(count * n, -1)) @ z, n, count)
    section = section_functions(n, False)["section"].map(count)
    stiffness, moment = ca.DM(torsion.stiffness.T), ca.DM(torsion.moment.T)
    _, _, natural, energy = section(theta, stiffness, moment)
    curvature = natural + ca.reshape(q, 2, count) * ca.repmat(ca.DM(problem.softness).T, 2, 1)
    return ca.dot(ca.DM(torsion.weight).T, energy), ca.vertsplit(curvature)


# --- Functions that compute their own first derivatives ---------------------------------------------------------------

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
"""Options by strategy: quick is faster on most problems; on some it cycles, where patient converges."""


@dataclass(frozen=True, eq=False)
class Values:
    """Functions f(x) and g(x) at a point, with first derivatives."""

    objective: float
    """Objective f."""
    gradient: Array
    """Gradient (X,) of f."""
    constraints: Array
    """Constraints g (G,)."""
    jacobian: Array
    """Jacobian (G, X) of g."""


def nowhere(rows: int, size: int) -> Values:
    """NaN for all values and derivatives, at a point where the functions are undefined."""
    nan = np.full(rows, np.nan)
    return Values(np.nan, np.full(size, np.nan), nan, np.full((rows, size), np.nan))


Evaluate = Callable[[Array], Values]
"""Function x (X,) -> values, NaN if they are not defined."""


@dataclass(frozen=True, eq=False)
class Optimum:
    """Last point of IPOPT."""

    x: Array
    """Variables (X,)."""
    values: Values
    """Values and derivatives of the functions at x."""
    multipliers: Array
    """Multipliers (G,) of the constraints, positive for active constraints."""
    bound_multipliers: Array
    """Multipliers (X,) of the bounds."""
    success: bool
    """IPOPT converged."""
    status: str
    """Status of IPOPT, in lower case."""
    iterations: int
    """Number of iterations."""


class _Callback(ca.Callback):
    """CasADi function of dense matrices of the shapes `inputs` and `outputs`, with its `jacobian`."""

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


def _functions(values_at: Callable[[bytes], Values], size: int, rows: int) -> _Callback:
    """CasADi function x -> (f, g), with first derivatives."""

    def functions(x: Any) -> list[Any]:
        values = values_at(np.array(x).tobytes())
        return [ca.DM(values.objective), ca.DM(values.constraints)]

    def slopes(x: Any, *_: Any) -> list[Any]:
        values = values_at(np.array(x).tobytes())
        return [ca.DM(values.gradient[None]), ca.DM(values.jacobian)]

    shapes = [(1, 1), (rows, 1)]
    derivatives = _Callback("slopes", [(size, 1), *shapes], [(1, size), (rows, size)], slopes)
    return _Callback("program", [(size, 1)], shapes, functions, derivatives)


def _iteration_callback(report: Callable[[float], object], size: int, rows: int) -> _Callback:
    """Callback of `nlpsol` that reports the objective of each iteration."""

    def callback(x: Any, f: Any, *_: Any) -> list[Any]:
        report(float(f))
        return [0]

    sizes = {"f": 1, "x": size, "lam_x": size, "g": rows, "lam_g": rows}
    inputs = [(sizes.get(ca.nlpsol_out(i), 0), 1) for i in range(ca.nlpsol_n_out())]
    return _Callback("watch", inputs, [(1, 1)], callback)


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
    """Minimise f(x) subject to g(x) >= 0 and lower <= x <= upper, from `start` (X,).

    Args:
        evaluate: functions of x, which should be of order 1; where they are NaN, IPOPT shortens its step.
        iterations: maximum number of iterations.
        strategy: key of `STRATEGIES`.
        report: function called with the objective of each iteration, or None.

    Raises:
        OutOfTimeError: the nearest time limit is reached.
    """
    timeouts: list[OutOfTimeError] = []

    @lru_cache(maxsize=1)
    def values_at(x: bytes) -> Values:
        """Values and derivatives at a point, cached for repeated calls there."""
        try:
            check_time()
            return evaluate(np.frombuffer(x).copy())
        except OutOfTimeError as error:
            # An exception must not pass through IPOPT: it is raised again when IPOPT has ended.
            timeouts.append(error)
            return nowhere(rows, size)

    size, rows = len(start), 0
    rows = len(values_at(start.tobytes()).constraints)
    if timeouts:
        raise timeouts[0]
    program = _functions(values_at, size, rows)
    x = ca.MX.sym("x", size)
    f, g = program(x)
    options = {**OPTIONS, **STRATEGIES[strategy], "ipopt.max_iter": iterations}
    if time_left() < np.inf:
        options["ipopt.max_wall_time"] = max(time_left(), MIN_SECONDS)
    if report is not None:
        options["iteration_callback"] = _iteration_callback(report, size, rows)
    solver = ca.nlpsol("design", "ipopt", {"x": x, "f": f, "g": g}, options)
    result = solver(x0=start, lbx=lower, ubx=upper, lbg=np.zeros(rows), ubg=np.full(rows, np.inf))
    stats = solver.stats()
    solution = np.clip(np.array(result["x"]).ravel(), lower, upper)
    values = values_at(solution.tobytes())
    if timeouts:
        raise timeouts[0]
    return Optimum(
        x=solution,
        values=values,
        multipliers=-np.array(result["lam_g"]).ravel(),
        bound_multipliers=-np.array(result["lam_x"]).ravel(),
        success=bool(stats["success"]),
        status=str(stats["return_status"]).replace("_", " ").lower(),
        iterations=int(stats["iter_count"]),
    )
