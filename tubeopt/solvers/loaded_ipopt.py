"""The collocated equilibrium under load solved by IPOPT: least potential energy, the orientation among the unknowns."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ..block.transcription.loaded import LoadedProblem, LoadedState, evaluate
from ..errors import SolveError
from ..physics.shape import quaternion_rates, tangent_forms
from ..physics.torsion import section_functions
from ..typing import Array
from .ipopt import EQUILIBRIUM
from .newton import NewtonResult
from .problem import Problem
from .problem_solution import ProblemStatus
from .settings import Ipopt


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
    return NewtonResult(evaluate(problem, rotations, x), True, found.statistics.iterations, 0.0)


def _section(problem: LoadedProblem, rotations: Array, z: Any, q: Any) -> tuple[Any, list[Any]]:
    """Bending energy of the cross-sections, J, and rows u_x and u_y (N,) of the curvature at the points."""
    torsion = problem.torsion
    count, n = torsion.stiffness.shape
    base = np.tile(rotations, (count, 1)) + (0.0 if torsion.phase is None else torsion.phase)
    theta = ca.reshape(ca.DM(base.ravel()) + ca.DM(problem.spread.reshape(count * n, -1)) @ z, n, count)
    section = section_functions(n, False)["section"].map(count)
    stiffness, moment = ca.DM(torsion.stiffness.T), ca.DM(torsion.moment.T)
    _, _, natural, energy = section(theta, stiffness, moment)
    curvature = natural + ca.reshape(q, 2, count) * ca.repmat(ca.DM(problem.softness).T, 2, 1)
    return ca.dot(ca.DM(torsion.weight).T, energy), ca.vertsplit(curvature)
