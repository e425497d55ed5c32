"""One piece of an arm as a CasADi function: theta, theta', curvature, pose and check values from collocated moments."""

from __future__ import annotations

from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np

from ...physics.shape import GAUSS_POINTS, magnus_step
from .collocated import ENDS, STEPS, Grid, Torsion, symbols
from .tableau import tableau

COARSE_STEPS = 2
"""Steps of the shape per piece of the mesh of the rougher integration that tells the error of the STEPS."""

EXTRA_POINTS = 3
"""Collocation points by which the check of the mesh is finer than the solution."""


@lru_cache(maxsize=32)
def piece_function(n: int, eccentric: bool, family: str, degree: int) -> ca.Function:
    """(poses, theta, w, M/kt, kb, m, kt, h[, (g-1)w, d, phi]) -> (poses, theta, theta', u, R and p, defects, V).

    poses (24,): R by columns and p of the fine and of the coarse integration, where the piece begins and where it ends.
    theta, w (n,) at its beginning; M/kt (n, K) at its collocation points; kb, m (n,) of its section; h its length.
    theta (n, 5), theta' (n, 5), u (2, 5) at the points ENDS, R and p (12, 4) at all but the first.
    defects (n, 2): how far theta inside and the gain of w over the piece are from a quadrature with EXTRA_POINTS more.
    V: bending energy per length at the beginning.
    """
    piece = symbols(Grid(n, family, degree, eccentric))
    t, h = piece.grid.tableau, piece.length
    poses, gain, extra = ca.SX.sym("poses", 24), ca.SX.sym("moment", n, degree), ca.SX.sym("extra", n, degree)
    torsion = Torsion(piece, ca.SX(), gain, extra, ca.SX(), (ca.SX(), ca.SX()))
    inputs = [poses, piece.theta, piece.twist, gain, piece.stiffness, piece.moment, piece.torsional_stiffness, h]
    inputs += [extra, *piece.place] if eccentric else []
    slope = torsion.torsion(ENDS) + (extra @ t.lagrange(ENDS).T if eccentric else 0)
    fine = _integrate(poses[:12], torsion, STEPS)
    coarse = _integrate(poses[12:], torsion, COARSE_STEPS)
    check = tableau("gauss", degree + EXTRA_POINTS)
    theta = torsion.rotation(check.nodes)
    finer = [piece.section(theta[:, k], x) for k, x in enumerate(check.nodes)]
    gained = h * ca.horzcat(*(here.moment / piece.torsional_stiffness for here in finer))
    w = ca.repmat(piece.twist, 1, check.degree) + gained @ check.matrix.T
    stretch = ca.horzcat(*(ca.SX(here.stretch) for here in finer))
    defect = ca.repmat(piece.theta, 1, check.degree) + h * (w * stretch) @ check.matrix.T - theta
    outputs = [
        ca.vertcat(fine[-1], coarse[-1]),
        torsion.rotation(ENDS),
        slope,
        torsion.curvature(ENDS),
        ca.horzcat(*fine),
        ca.horzcat(
            reduce(ca.fmax, ca.horzsplit(ca.fabs(defect))), ca.fabs(gained @ check.weights - h * gain @ t.weights)
        ),
        piece.section(piece.theta, 0.0).bending_energy,
    ]
    return ca.Function("piece", inputs, [ca.densify(out) for out in outputs], {"cse": True})


def _integrate(pose: Any, torsion: Torsion, steps: int) -> list[Any]:
    """Poses (12,) after each Magnus step."""
    u = torsion.curvature(((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel())
    rotation, position = ca.reshape(pose[:9], 3, 3), pose[9:]
    out = []
    for k in range(steps):
        rotation, position = magnus_step(rotation, position, u[:, 3 * k : 3 * k + 3], torsion.piece.length / steps)
        out.append(ca.vertcat(ca.vec(rotation), position))
    return out
