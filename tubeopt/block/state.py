"""A solved equilibrium as the arm that derivatives and blocks are made from."""

from __future__ import annotations

import numpy as np

from ..equilibrium import Equilibrium
from ..robots.assembly import Array
from ..solution import Solution
from ..transcription import arm as arms
from .linear import Arm


def arm_of(solution: Solution) -> Arm:
    """The arm of a solved problem."""
    problem, t = solution.problem, solution.problem.mesh.tableau
    assembly, mesh, torsion = problem.assembly, problem.mesh, solution.arm
    shape = arms.evaluate_arm(problem, solution.rotations, solution.result.state, torsion)
    return Arm(
        tableau=t,
        start=mesh.start,
        length=mesh.length,
        stiffness=problem.piece_stiffness,
        moment=problem.piece_moment,
        torsional_stiffness=assembly.torsional_stiffness,
        transmission=assembly.transmission,
        place=(assembly.offset, assembly.offset_angle) if assembly.eccentric else (),
        theta=torsion.rotation,
        twist=torsion.twist,
        inner=arms.rotations_at(problem, torsion, tuple(t.nodes.tolist())),
        position=shape.position,
        frame=shape.frame,
    )
