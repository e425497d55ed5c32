"""The largest bending strain of a tube in a pose, and how it changes with the design."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from ..block.quantities import PoseNumber
from ..physics.strain import bend_from_own, surface_strain
from ..typing import Array
from .state import State


@lru_cache(maxsize=1)
def _strain() -> ca.Function:
    """(theta, u (2,), precurvature, outer diameter) -> strain, and its slope (1, 5)."""
    x = ca.SX.sym("x", 5)
    theta, u, natural, diameter = x[0], (x[1], x[2]), x[3], x[4]
    bend = bend_from_own((ca.cos(theta), ca.sin(theta)), u, natural)
    strain = surface_strain(diameter / 2, bend, natural)
    return ca.Function("strain", [x], [strain, ca.densify(ca.jacobian(strain, x))])


def pose_strain(state: State, index: PoseNumber, tube: int) -> tuple[float, Array]:
    """Largest bending strain of a tube in a pose, and its change (X,); 0 where it is not in front of the plate."""
    pose, shape = state.shaped(index, "strain"), state.tubes[tube]
    assembly, mesh = pose.problem.assembly, pose.problem.mesh
    section = np.repeat(mesh.section, len(pose.bend) // max(len(mesh.length), 1))
    there, curved = np.flatnonzero(assembly.present[section, tube]), assembly.curved[section, tube]
    if not len(there):
        return 0.0, np.zeros(state.layout.size)
    natural, diameter = shape.curvature * curved, np.full(len(section), shape.outer_diameter)
    given = np.column_stack([pose.theta[:, tube], pose.bend, natural, diameter])[there]
    strains, slopes = (part.full() for part in _strain().map(len(there))(given.T))
    worst = int(np.argmax(strains))
    k, slope = there[worst], slopes.reshape(5, -1, order="F")[:, worst]
    dtheta, du = pose.bend_slopes
    change = (slope[0] * dtheta[k, tube] + slope[1:3] @ du[k]) @ state.chain(index)
    change = change + slope[3] * curved[k] * state.slopes["curvature"][tube]
    return float(strains[0, worst]), change + slope[4] * state.slopes["outer_diameter"][tube]
