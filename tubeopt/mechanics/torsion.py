"""Torsion of a bundle of tubes at one cross-section: curvature, moments, energy, second variation.

The general assembly: tube i runs beside the centreline at offset d_i in direction phi_i, and s is the arc length of the
centreline. With m_i = kb_i kappa_i on the curved part and 0 elsewhere,

    g_i = ds_i/ds = 1 + d_i (u_x sin phi_i - u_y cos phi_i)
    u sum_i kb_i / g_i = sum_i m_i (cos theta_i, sin theta_i)
    theta_i' = g_i w_i,   kt_i w_i' = m_i (u_x sin theta_i - u_y cos theta_i) =: M_i(theta)

For concentric tubes (d = 0) g = 1 and M is the gradient of the reduced bending energy
V = 1/2 sum m_i^2 / kb_i - 1/2 |sum m_i e^{j theta_i}|^2 / sum kb_i  (Dupont et al., IEEE T-RO 26 (2010);
Rucker, Jones, Webster, IEEE T-RO 26 (2010)). u is eliminated, so that both robots obey one explicit equation in theta.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca

CURVATURE_NEWTON_STEPS = 5
"""Newton steps on the two equations for u when d > 0: the start is off by d |u| < 1/4, squared at each step."""


@dataclass(frozen=True)
class CrossSection:
    """Symbolic quantities at one cross-section; CasADi columns of n unless said otherwise."""

    curvature: Any
    stretch: Any
    moment: Any
    bending_energy: Any


def cross_section(theta: Any, stiffness: Any, moment: Any, offset: Any = None, angle: Any = None) -> CrossSection:
    """Equilibrium of one cross-section.

    Args:
        theta: (n,) rotations, rad.
        stiffness: (n,) kb_i of the tubes present, 0 for the others, N m^2.
        moment: (n,) m_i = kb_i kappa_i of the tubes curved here, 0 for the others, N m.
        offset, angle: (n,) d_i (m), phi_i (rad); None where all tubes are concentric.

    Returns:
        curvature u (2,), stretch g (n,), moment M (n,), bending energy per centreline length (N).
    """
    cos, sin = ca.cos(theta), ca.sin(theta)
    total = ca.vertcat(ca.dot(moment, cos), ca.dot(moment, sin))
    if offset is None:
        u = total / ca.sum1(stiffness)
        stretch = ca.DM.ones(theta.shape[0])
    else:
        u, stretch = _offset_curvature(total, stiffness, offset, angle)
    tube_u = ca.repmat(u.T, theta.shape[0], 1) / ca.horzcat(stretch, stretch)
    bend = ca.sum2(tube_u**2) * stiffness / 2 - moment * (tube_u[:, 0] * cos + tube_u[:, 1] * sin)
    # m^2 / kb, with kb = 0 for a tube that is not there.
    natural = moment**2 / ca.if_else(stiffness > 0, stiffness, 1) / 2
    return CrossSection(u, stretch, moment * (u[0] * sin - u[1] * cos), ca.dot(bend + natural, stretch))


def _offset_curvature(total: Any, stiffness: Any, offset: Any, angle: Any) -> tuple[Any, Any]:
    """Curvature u and stretch g of tubes at offsets: Newton on u sum kb/g(u) = total from the concentric value."""
    u = ca.SX.sym("u", 2)
    across = offset * ca.sin(angle), -offset * ca.cos(angle)
    stretch = 1 + across[0] * u[0] + across[1] * u[1]
    balance = u * ca.sum1(stiffness / stretch) - total
    free = ca.symvar(ca.vertcat(total, stiffness, offset, angle))
    step = ca.Function("step", [u, *free], [u - ca.solve(ca.jacobian(balance, u), balance), stretch])
    value = total / ca.sum1(stiffness)
    for _ in range(CURVATURE_NEWTON_STEPS):
        value = step(value, *free)[0]
    return value, step(value, *free)[1]


@lru_cache(maxsize=32)
def section_functions(n: int, eccentric: bool) -> dict[str, ca.Function]:
    """CasADi functions of (theta, stiffness, moment[, offset, angle]) at one cross-section of n tubes.

    `curvature`: u.  `stiffness_slope`, with a further argument y (n,): d(dM/dtheta y)/dtheta (n, n).
     `curvature_slope`: du/dtheta (2, n).  `balance`: M, dM/dtheta (n, n), V, g, dg/dtheta (n, n); the last two for
    eccentric tubes only.  `moment`: M, g.  `variation`, with a further argument y (n,): y' dM/dtheta y, its gradient
    with respect to theta.
    """
    theta, stiffness, moment, offset, angle = (ca.SX.sym(s, n) for s in ("theta", "kb", "m", "d", "phi"))
    inputs = [theta, stiffness, moment] + ([offset, angle] if eccentric else [])
    here = cross_section(theta, stiffness, moment, offset, angle) if eccentric else cross_section(*inputs)
    outputs = [here.moment, ca.densify(ca.jacobian(here.moment, theta)), here.bending_energy]
    if eccentric:
        outputs += [here.stretch, ca.densify(ca.jacobian(here.stretch, theta))]
    y = ca.SX.sym("y", n)
    form = ca.bilin(outputs[1], y, y)
    turned = ca.densify(ca.jacobian(here.curvature, theta))
    table = {
        "curvature": (inputs, [here.curvature]),
        "curvature_slope": (inputs, [turned]),
        "balance": (inputs, outputs),
        "moment": (inputs, [here.moment] + ([here.stretch] if eccentric else [])),
        "stiffness_slope": ([*inputs, y], [ca.densify(ca.jacobian(outputs[1] @ y, theta))]),
        "variation": ([*inputs, y], [form, ca.gradient(form, theta)]),
    }
    return {name: ca.Function(name, *signature, {"cse": True}) for name, signature in table.items()}
