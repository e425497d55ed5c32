"""A pose solved for a design, and how its mesh moves with the lengths of the tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..block.transcription.mesh import Mesh, make_mesh
from ..block.transcription.reduced import evaluate, reduce, to_unknowns
from ..equilibrium.arm_change import PARAMETERS
from ..equilibrium.solving import Solution
from ..errors import SolveError
from ..robots.assembly import ROUND_OFF, Assembly, assemble
from ..robots.tubes import Tube
from ..solvers.newton import NewtonResult, descend, newton
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Twist:
    """Twist theta - alpha (m, n) of a solved pose at fractions (m,) of the arm: a guess for the next one."""

    fraction: Array
    twist: Array


def twist_at(solved: Solution) -> Twist:
    """Guess for a pose close by."""
    length = max(solved.problem.assembly.total_length, 1e-300)
    return Twist(solved.problem.arc_length / length, solved.result.state.theta - solved.rotations)


def solve_pose(tubes: Sequence[Tube], rotations: Array, translations: Array, guess: Twist | None = None) -> Solution:
    """The equilibrium near `guess`, or the one that descent reaches from tubes without torsion."""
    assembly = assemble(tubes, translations)
    problem = reduce(assembly, make_mesh(assembly))
    if guess is not None and len(guess.fraction) and problem.size:
        fraction = problem.arc_length / max(assembly.total_length, 1e-300)
        twist = np.column_stack([np.interp(fraction, guess.fraction, column) for column in guess.twist.T])
        result = newton(problem, rotations, to_unknowns(problem, rotations, rotations + twist), iterations=12)
        if result.converged:
            return Solution.of(problem, rotations, result)
    result = descend(problem, rotations, np.zeros(problem.size))
    if not result.converged:
        raise SolveError("no equilibrium was found at a pose of the design")
    return Solution.of(problem, rotations, result)


def without_solving(tubes: Sequence[Tube], translations: Array) -> Solution:
    """The problem at given translations, for what does not depend on the rotations: the certificate."""
    assembly = assemble(tubes, translations)
    problem = reduce(assembly, make_mesh(assembly))
    state = evaluate(problem, np.zeros(len(tubes)), np.zeros(problem.size))
    return Solution(problem, np.zeros(len(tubes)), NewtonResult(state, True, 0, 0.0), 1.0)


def mesh_slopes(assembly: Assembly, mesh: Mesh) -> tuple[Array, Array]:
    """(P, 7 n) change of where the pieces begin and of their lengths, by `block.derivatives.PARAMETERS`."""
    n, m = assembly.n_tubes, assembly.n_sections
    cuts = np.zeros((m + 1, len(PARAMETERS) * n))
    shift, longer = (PARAMETERS.index(name) * n for name in ("translations", "curved_length"))
    for k, cut in enumerate(assembly.start + assembly.length, start=1):
        near = np.abs(np.stack([assembly.transition, assembly.end], axis=1).ravel() - cut) <= 2 * ROUND_OFF
        tube, at_end = divmod(int(np.argmax(near)), 2)
        cuts[k, shift + tube] = 1.0
        cuts[k, longer + tube] = at_end
    count = np.bincount(mesh.section, minlength=m)
    rank = np.arange(len(mesh.section)) - np.repeat(np.cumsum(count) - count, count)
    length = (np.diff(cuts, axis=0) / count[:, None])[mesh.section]
    return cuts[mesh.section] + rank[:, None] * length, length
