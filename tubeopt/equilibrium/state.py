"""A solved equilibrium as the arm that derivatives and blocks are made from."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.buffered import section_function
from ..block.transcription.collocated import ENDS
from ..block.transcription.linear import Arm, interpolation, shape_points
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.tableau import tableau
from ..block.transcription.whole_arm import evaluate_arm
from ..robots.assembly import Assembly
from ..typing import Array
from .answer import discretisation_of, point_of
from .member import PlainPoint
from .problem import reduced_problem
from .result import Equilibrium, refuse_load


def arm_of(point: PlainPoint) -> Arm:
    """The arm of a solved problem."""
    problem, torsion = point.member.problem, point.torsion
    mesh, t = problem.mesh, problem.mesh.tableau
    shape = evaluate_arm(problem, point.member.rotations, point.state, torsion)
    stiffness, moment = problem.on_pieces
    inner = arms.rotations_at(problem, torsion, tuple(t.nodes.tolist()))
    return Arm(
        tableau=t,
        assembly=problem.assembly,
        start=mesh.start,
        length=mesh.length,
        stiffness=stiffness,
        moment=moment,
        theta=torsion.rotation,
        twist=torsion.torque * torsion.compliance,
        inner=inner,
        shape=shape,
    )


def problem_of(equilibrium: Equilibrium) -> ReducedProblem:
    """The reduced problem of an equilibrium without load, on its own mesh."""
    refuse_load(equilibrium)
    return reduced_problem(equilibrium.robot, tuple(equilibrium.translations.tolist()), discretisation_of(equilibrium))


HERMITE = 2 * len(ENDS) - 2
"""Values at ENDS and slopes at those inside a piece: a polynomial with so many coefficients is told by them."""


def arm_of_equilibrium(equilibrium: Equilibrium, assembly: Assembly) -> Arm:
    """The arm of an equilibrium, whose torsion is read off its shape points.

    Raises:
        SolveError: the mesh is of a degree that shape points do not tell, and Newton's method does not stay at the
            equilibrium (a fold).
    """
    refuse_load(equilibrium)
    how = equilibrium.statistics
    if how.degree + 2 > HERMITE:
        return arm_of(point_of(equilibrium, discretisation=discretisation_of(equilibrium)))
    t = tableau(how.family, how.degree)
    steps, n = len(ENDS) - 1, assembly.n_tubes
    start = equilibrium.arc_length[:-1:steps]
    length = equilibrium.arc_length[steps::steps] - start
    section = np.searchsorted(assembly.start, start + length / 2) - 1
    here = assembly.of_sections(section)
    stiffness, moment = here.stiffness, here.moment
    index = shape_points(len(start))
    theta, slope = equilibrium.rotation.T[index], equilibrium.torsion.T[index[:, 1:-1]]
    inner = _hermite(how.family, how.degree) @ np.concatenate([theta, length[:, None, None] * slope], axis=1)
    # Where there are collocation points the equations hold for what was solved there, not for polynomials between.
    solved = np.searchsorted(start, equilibrium.point[:: t.degree]) - 1
    inner[solved] = equilibrium.point_rotation.reshape(-1, t.degree, n)
    twist = equilibrium.torsion.T[index[:, 0]]
    if assembly.eccentric:
        kb, m = (np.repeat(table, t.degree, axis=0) for table in (stiffness, moment))
        function = section_function("moment", len(kb), n, True)
        gain = function(inner.reshape(-1, n), kb, m, assembly.offset, assembly.offset_angle)[0].reshape(inner.shape)
        gain = gain / assembly.torsional_stiffness
        turned = length[:, None] * (t.weights @ gain)
        twist = -np.cumsum(turned[::-1], axis=0)[::-1]
    return Arm(t, assembly, start, length, stiffness, moment, theta[:, 0], twist, inner, equilibrium.arm)


@lru_cache(maxsize=16)
def _hermite(family: str, degree: int) -> Array:
    """(K, HERMITE) values at the collocation points from those at ENDS and slopes at ENDS inside."""
    return interpolation(tableau(family, degree).nodes, ENDS, ENDS[1:-1])
