"""The collocated torsion problem solved by IPOPT, as equations or as the energy whose stationary points they are; under
load as least potential energy, the orientation among the unknowns."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..block.transcription import loaded as under_load
from ..block.transcription.arm import Profile, torques_at
from ..block.transcription.loaded import LoadedProblem, LoadedState
from ..block.transcription.model import equation, mapped, places_in_words
from ..block.transcription.program import (
    Structure,
    add_torsion,
    structure_of,
    torsion_given,
    torsion_guess,
    torsion_numbers,
)
from ..block.transcription.reduced import Evaluation, ReducedProblem, evaluate, to_unknowns
from ..errors import SolveError
from ..physics.shape import quaternion_rates, tangent_forms
from ..physics.torsion import section_functions
from ..typing import Array
from .newton import NewtonResult
from .problem import Problem
from .problem_solution import ProblemStatus
from .settings import Ipopt

EQUILIBRIUM = Ipopt(tolerance=1e-12, iterations=300, expand=True)
"""How an equilibrium is solved for unless told otherwise."""

EQUATIONS = replace(EQUILIBRIUM, hessian="limited-memory")
"""The same where as many equations as unknowns leave no choice: no second derivative changes the steps."""


@lru_cache(maxsize=64)
def _program(structure: Structure, formulation: str, thread: int) -> Problem:
    """The program of one equilibrium, all that is given of it parameters; each thread has its own numbers."""
    problem = Problem(formulation)
    rotations = problem.parameter("rotations", np.zeros(structure.grid.n_tubes))
    if formulation == "equations":
        add_torsion(problem, structure, rotations, {})
    else:
        _add_energy(problem, structure, rotations)
    return problem


def _add_energy(problem: Problem, structure: Structure, rotations: Any) -> None:
    """The optimal control problem behind an equilibrium: least energy over theta with control w = theta'.

    Only for concentric tubes, whose equilibria are its stationary points. A transmission without length stores no
    energy, so its idle twist is given the cost of a whole arm.
    """
    grid, pieces = structure.grid, len(structure.section)
    n, degree = grid.n_tubes, grid.degree
    given = torsion_given(problem, structure, {})
    base = problem.variable("torsion of the transmissions", n)
    theta = ca.reshape(problem.variable("rotation", n * pieces), n, pieces)
    inner, twist = (
        ca.reshape(problem.variable(f"{what} inside", n * pieces * degree), n, pieces * degree)
        for what in ("rotation", "torsion")
    )
    kt, lengths, transmission = given["torsional_stiffness"], given["lengths"], given["transmission"]
    row = [kt, lengths.T, given["along"]] if grid.detail else [given["stiffness"], given["moment"], kt, lengths.T]
    defect, end, energy = mapped("motion", grid, pieces)(theta, inner, twist, *row)
    tubes = [f"tube {i + 1}" for i in range(n)]
    after, points = places_in_words(pieces, degree, structure.section)
    for each in (
        equation("rotation equation", tubes, points, defect, 1.0),
        equation("continuity of rotation", tubes, after, theta[:, 1:] - end[:, :-1], 1.0),
        equation("base rotation", tubes, None, theta[:, 0] - rotations - transmission * base, 1.0),
    ):
        problem.subject_to(each.name, each.expression, upper=0.0, entries=each.entries)
    idle = ca.if_else(transmission > 0, transmission, ca.sum1(lengths))
    stored = ca.sum2(energy) + ca.dot(kt[:, 0] * idle, base**2) / 2
    problem.minimize(stored * ca.sum1(lengths) / ca.sum1(kt[:, 0]))


def solve_ipopt(
    problem: ReducedProblem,
    rotations: Array,
    guess: Profile,
    formulation: str = "equations",
    settings: Ipopt | None = None,
) -> NewtonResult[Evaluation]:
    """Solve the collocated problem from the torsion `guess`.

    Args:
        formulation: "equations" (no objective, the equations as constraints) or "energy" (least elastic energy).
        settings: None are `EQUATIONS` or `EQUILIBRIUM`.

    Raises:
        SolveError: IPOPT did not converge; the message names its verdict and the worst constraints.
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
    found = program.attempt(settings or (EQUATIONS if formulation == "equations" else EQUILIBRIUM))
    if found.status is not ProblemStatus.SOLVED:
        worst = "; ".join(map(str, found.violations[:3]))
        verdict = found.statistics.verdict.replace("_", " ").lower()
        raise SolveError(f"IPOPT found no equilibrium ({verdict}): {worst or 'all constraints are satisfied'}")
    theta = inside_points(problem, found.values["rotation inside"])
    state = evaluate(problem, rotations, to_unknowns(problem, rotations, theta))
    return NewtonResult(state, True, found.statistics.iterations, 0.0)


def inside_points(problem: ReducedProblem, inside: Array) -> Array:
    """theta (N, n) at the points of a reduced problem, of the column "rotation inside" of all pieces."""
    mesh, n = problem.mesh, problem.assembly.n_tubes
    return inside.reshape(len(mesh.length), mesh.tableau.degree, n)[mesh.collocated].reshape(-1, n)


def solve_loaded_ipopt(
    problem: LoadedProblem, rotations: Array, guess: LoadedState, settings: Ipopt | None = None
) -> NewtonResult[LoadedState]:
    """The equilibrium under a load with an energy, from a state close by: the equations of `block.transcription.loaded`
    in another writing, in which the quaternions are unknowns, tied to the curvature by constraints."""
    program, split = Problem("equilibrium under load"), problem.torsion.size
    z = program.variable("twist", split, guess=guess.x[:split])
    q = program.variable("bending", problem.size - split, guess=guess.x[split:])
    begin, stage = guess.orientation.begin, guess.orientation.stage
    ends = ca.reshape(program.variable("orientation", begin.size, guess=begin.ravel()), 4, len(begin))
    inside = ca.reshape(program.variable("orientation inside", stage.size, guess=stage.ravel()), 4, len(stage))
    stored, rows = _section(problem, rotations, z, q)
    omegas = map(ca.DM, quaternion_rates())
    rate = sum(ca.repmat(row, 4, 1) * (omega @ inside) / 2 for row, omega in zip(rows, omegas, strict=True))
    mesh, defects = problem.mesh, [ends[:, 0] - ca.DM([1, 0, 0, 0])]
    degree = mesh.tableau.degree
    for e, h in enumerate(mesh.length.tolist()):
        own = slice(e * degree, (e + 1) * degree)
        moved = h * rate[:, own] @ ca.DM(np.column_stack([mesh.tableau.matrix.T, mesh.tableau.weights]))
        there = ca.horzcat(inside[:, own], ends[:, e + 1])
        defects.append(ca.vec(there - ca.repmat(ends[:, e], 1, degree + 1) - moved))
    program.subject_to("orientation equation", ca.vertcat(*defects), upper=0.0)
    tangent = ca.vertcat(*(ca.sum1(inside * (ca.DM(form) @ inside)) for form in tangent_forms()))
    work = ca.dot(ca.DM((problem.torsion.weight[:, None] * problem.force).T), tangent)
    potential = (ca.sumsqr(z) + ca.sumsqr(q)) / 2 + stored - work
    program.minimize(potential * problem.tip_lever)
    found = program.attempt(settings or EQUILIBRIUM)
    if found.status is not ProblemStatus.SOLVED:
        raise SolveError(program.failure(found))
    x = np.concatenate([found.values["twist"], found.values["bending"]])
    return NewtonResult(under_load.evaluate(problem, rotations, x), True, found.statistics.iterations, 0.0)


def _section(problem: LoadedProblem, rotations: Array, z: Any, q: Any) -> tuple[Any, list[Any]]:
    """Bending energy of the cross-sections, J, and rows u_x and u_y (N,) of the curvature at the points."""
    torsion = problem.torsion
    count, n = torsion.stiffness.shape
    base = rotations + torsion.phase
    theta = ca.reshape(ca.DM(base.ravel()) + ca.DM(problem.spread.reshape(count * n, -1)) @ z, n, count)
    section = section_functions(n, False)["section"].map(count)
    stiffness, moment = ca.DM(torsion.stiffness.T), ca.DM(torsion.moment.T)
    _, _, natural, energy = section(theta, stiffness, moment)
    curvature = natural + ca.reshape(q, 2, count) * ca.repmat(ca.DM(problem.softness).T, 2, 1)
    return ca.dot(ca.DM(torsion.weight).T, energy), ca.vertsplit(curvature)
