"""One piece of an arm as a CasADi function: theta, theta', curvature, pose and check values from collocated moments."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..physics.shape import GAUSS_POINTS, magnus_step
from ..physics.torsion import cross_section
from ..typing import Array
from .tableau import tableau

STEPS, COARSE_STEPS = 4, 2
"""Steps of the shape per piece of the mesh, and of the rougher integration that tells its error."""

EXTRA_POINTS = 3
"""Collocation points by which the check of the mesh is finer than the solution."""

ENDS = np.arange(STEPS + 1) / STEPS
"""Fractions of a piece at which its shape points lie, its beginning included."""


@lru_cache(maxsize=32)
def piece_function(n: int, eccentric: bool, family: str, degree: int) -> ca.Function:
    """(poses, theta, w, M/kt, kb, m, kt, h[, (g-1)w, d, phi]) -> (poses, theta, theta', u, R and p, defects, V).

    poses (24,): R by columns and p of the fine and of the coarse integration, where the piece begins and where it ends.
    theta, w (n,) at its beginning; M/kt (n, K) at its collocation points; kb, m (n,) of its section; h its length.
    theta (n, 5), theta' (n, 5), u (2, 5) at the points ENDS, R and p (12, 4) at all but the first.
    defects (n, 2): how far theta inside and the gain of w over the piece are from a quadrature with EXTRA_POINTS more.
    V: bending energy per length at the beginning.
    """
    t = tableau(family, degree)
    symbols = {
        name: ca.SX.sym(name, *size)
        for name, size in {
            "poses": (24,),
            "theta": (n,),
            "twist": (n,),
            "moment": (n, degree),
            "kb": (n,),
            "m": (n,),
            "kt": (n,),
            "h": (1,),
            "extra": (n, degree),
            "d": (n,),
            "phi": (n,),
        }.items()
    }
    inputs = list(symbols.values()) if eccentric else list(symbols.values())[:8]
    h, place = symbols["h"], (symbols["d"], symbols["phi"]) if eccentric else (None, None)

    def rotation(x: Array) -> Any:
        theta = ca.repmat(symbols["theta"], 1, len(x)) + h * symbols["twist"] @ ca.DM(x).T
        theta += h**2 * symbols["moment"] @ t.lagrange(x, integrals=2).T
        return theta + h * symbols["extra"] @ t.lagrange(x, integrals=1).T if eccentric else theta

    def slope(x: Array) -> Any:
        w = ca.repmat(symbols["twist"], 1, len(x)) + h * symbols["moment"] @ t.lagrange(x, integrals=1).T
        return w + symbols["extra"] @ t.lagrange(x).T if eccentric else w

    def sections(theta: Any) -> list[Any]:
        return [cross_section(theta[:, k], symbols["kb"], symbols["m"], *place) for k in range(theta.shape[1])]

    def curvature(x: Array) -> Any:
        return ca.horzcat(*(here.curvature for here in sections(rotation(x))))

    fine = _integrate(symbols["poses"][:12], curvature, h, STEPS)
    coarse = _integrate(symbols["poses"][12:], curvature, h, COARSE_STEPS)
    check = tableau("gauss", degree + EXTRA_POINTS)
    theta = rotation(check.nodes)
    finer = [(here.moment / symbols["kt"], here.stretch) for here in sections(theta)]
    gain = h * ca.horzcat(*(moment for moment, _ in finer))
    w = ca.repmat(symbols["twist"], 1, check.degree) + gain @ check.matrix.T
    stretch = ca.horzcat(*(ca.SX(g) for _, g in finer))
    defect = ca.repmat(symbols["theta"], 1, check.degree) + h * (w * stretch) @ check.matrix.T - theta
    outputs = [
        ca.vertcat(fine[-1], coarse[-1]),
        rotation(ENDS),
        slope(ENDS),
        curvature(ENDS),
        ca.horzcat(*fine),
        ca.horzcat(_row_max(ca.fabs(defect)), ca.fabs(gain @ check.weights - h * symbols["moment"] @ t.weights)),
        cross_section(symbols["theta"], symbols["kb"], symbols["m"], *place).bending_energy,
    ]
    return ca.Function("piece", inputs, [ca.densify(out) for out in outputs], {"cse": True})


def _integrate(pose: Any, curvature: Any, h: Any, steps: int) -> list[Any]:
    """Poses (12,) after each Magnus step."""
    x = ((np.arange(steps)[:, None] + GAUSS_POINTS) / steps).ravel()
    u = curvature(x)
    rotation, position = ca.reshape(pose[:9], 3, 3), pose[9:]
    out = []
    for k in range(steps):
        rotation, position = magnus_step(rotation, position, u[:, 3 * k : 3 * k + 3], h / steps)
        out.append(ca.vertcat(ca.vec(rotation), position))
    return out


def _row_max(values: Any) -> Any:
    """Largest entry of each row."""
    largest = values[:, 0]
    for k in range(1, values.shape[1]):
        largest = ca.fmax(largest, values[:, k])
    return largest
