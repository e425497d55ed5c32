"""Torsion of a bundle of tubes at one cross-section: curvature, moments, energy, second variation.

The general assembly: tube i runs at an offset d_i from the centreline, in direction gamma_i, and s is the arc length
of the centreline. With m_i = kb_i kappa_i on the curved part and 0 elsewhere,

    g_i = ds_i/ds = 1 + d_i (u_x sin gamma_i - u_y cos gamma_i)
    u sum_i kb_i / g_i = sum_i m_i (cos theta_i, sin theta_i)
    theta_i' = g_i w_i,   kt_i w_i' = m_i (u_x sin theta_i - u_y cos theta_i) =: M_i(theta)

For concentric tubes (d = 0) g = 1 and M is the gradient of the reduced bending energy
V = 1/2 sum m_i^2 / kb_i - 1/2 |sum m_i e^{j theta_i}|^2 / sum kb_i  (Dupont et al., IEEE T-RO 26 (2010);
Rucker, Jones, Webster, IEEE T-RO 26 (2010)). u is eliminated, so that both robots obey one explicit equation in theta.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca

CURVATURE_NEWTON_STEPS = 3
"""Newton steps on the two equations for u when d > 0.

The start is off by (d |u|)^3 < 1/64, squared at each step.
"""


@dataclass(frozen=True)
class CrossSection:
    """Symbolic quantities at one cross-section; CasADi columns of n unless said otherwise."""

    curvature: Any
    stretch: Any
    moment: Any
    bending_energy: Any


def cross_section(
    theta: Any, stiffness: Any, moment: Any, offset: Any = None, angle: Any = None, *, load: Any = 0.0
) -> CrossSection:
    """Equilibrium of one cross-section.

    Args:
        theta: (n,) rotations, rad.
        stiffness: (n,) kb_i of the tubes present, 0 for the others, N m^2.
        moment: (n,) m_i = kb_i kappa_i of the tubes curved here, 0 for the others, N m; or (n, 2), kb_i times the
            precurvature about both axes of the tube.
        offset, angle: (n,) d_i (m), gamma_i (rad); None if all tubes are concentric.
        load: (2,) bending moment that forces put on concentric tubes here, N m.

    Returns:
        curvature u (2,), stretch g (n,), moment M (n,), bending energy per centreline length (N).
    """
    total = ca.sum1(natural_moments(theta, moment)).T
    if offset is None:
        u = (total + load) / ca.sum1(stiffness)
        return _at_curvature(u, theta, stiffness, moment, ca.DM.ones(theta.shape[0]))
    u = _offset_curvature(total, stiffness, offset, angle)
    return _at_curvature(u, theta, stiffness, moment, _stretch(u, offset, angle))


def natural_moments(theta: Any, moment: Any) -> Any:
    """Moments (n, 2) m_i (cos theta_i, sin theta_i), N m; of tubes with precurvature about both axes, both parts."""
    cos, sin = ca.cos(theta), ca.sin(theta)
    about_x = ca.horzcat(moment[:, 0] * cos, moment[:, 0] * sin)
    if moment.shape[1] == 1:
        return about_x
    return about_x + ca.horzcat(-moment[:, 1] * sin, moment[:, 1] * cos)


def jacobi_rates(y: Any, v: Any, slope: Any, g: Any = None, turned: Any = None) -> tuple[Any, Any]:
    """Derivatives by arc length of fields y = d theta and v = d w: the linearised equations of torsion.

        y' = g v + w (dg/dtheta) y,      kt v' = (dM/dtheta) y.

    Args:
        y, v: fields (n,), or several as columns (n, N).
        slope: dM/dtheta (n, n), or over kt: the second result is as `slope` y.
        g, turned: g (n,) and, for eccentric tubes, w dg/dtheta (n, n); g is 1 for None.

    Returns:
        y', and `slope` y, which does not depend on v.
    """
    y_rate = v if g is None else ca.diag(g) @ v
    return y_rate if turned is None else y_rate + turned @ y, slope @ y


def _stretch(u: Any, offset: Any, angle: Any) -> Any:
    """Stretch g (n,) at curvature u."""
    return 1 + offset * (u[0] * ca.sin(angle) - u[1] * ca.cos(angle))


def _at_curvature(u: Any, theta: Any, stiffness: Any, moment: Any, stretch: Any) -> CrossSection:
    natural = natural_moments(theta, moment)
    # kb |u / g - kappa|^2 / 2 per length of the tube, expanded; g turns it to the arm's length.
    tube_u = ca.repmat(u.T, theta.shape[0], 1) / ca.horzcat(stretch, stretch)
    bend = ca.sum2(tube_u**2) * stiffness / 2 - ca.sum2(tube_u * natural)
    # m^2 / kb; an absent tube has kb = m = 0.
    constant = ca.sum2(moment**2) / ca.if_else(stiffness > 0, stiffness, 1) / 2
    return CrossSection(u, stretch, u[0] * natural[:, 1] - u[1] * natural[:, 0], ca.dot(bend + constant, stretch))


def _offset_curvature(total: Any, stiffness: Any, offset: Any, angle: Any) -> Any:
    """Curvature u (2,) of tubes at offsets: Newton's method on u sum kb / g(u) = total, after two fixed-point steps."""
    # g = 1 + across . u, so one pass of u = total / sum(kb / g) shrinks the error by about d |u|.
    across = offset * ca.sin(angle), -offset * ca.cos(angle)
    u = total / ca.sum1(stiffness)
    u = total / ca.sum1(stiffness / (1 + across[0] * u[0] + across[1] * u[1]))
    for _ in range(CURVATURE_NEWTON_STEPS):
        inverse = 1 / (1 + across[0] * u[0] + across[1] * u[1])
        weights = stiffness * inverse
        resistance, loss = ca.sum1(weights), weights * inverse
        slope = ca.dot(loss, across[0]), ca.dot(loss, across[1])
        # d(resistance) / du = -slope, since dg / du = across.
        residual = u * resistance - total
        # The Jacobian is resistance * 1 - u slope': its inverse by Sherman and Morrison.
        factor = (slope[0] * residual[0] + slope[1] * residual[1]) / (resistance - slope[0] * u[0] - slope[1] * u[1])
        u = u - (residual + u * factor) / resistance
    return u


class SectionSlopes(NamedTuple):
    """Derivatives of a cross-section by some of its inputs, dense."""

    curvature: Any
    moment: Any
    stretch: Any


def _slopes(section: CrossSection, inputs: list[Any], wrt: Any) -> SectionSlopes:
    """Derivatives of a cross-section by `wrt`.

    The curvature of tubes at offsets is the root of an equation: its derivative is by the implicit function theorem.
    """
    theta, stiffness, moment, *offsets = inputs
    if not offsets:
        return SectionSlopes(
            curvature=ca.densify(ca.jacobian(section.curvature, wrt)),
            moment=ca.densify(ca.jacobian(section.moment, wrt)),
            stretch=ca.DM.zeros(theta.shape[0], wrt.numel()),
        )
    u = ca.SX.sym("u", 2)
    stretch = _stretch(u, *offsets)
    balance = u * ca.sum1(stiffness / stretch) - ca.sum1(natural_moments(theta, moment)).T
    at = _at_curvature(u, theta, stiffness, moment, stretch)
    # F(u, w) = 0 gives du/dw = -F_u^-1 F_w, exact at the root and without the Newton steps.
    turned = -ca.inv(ca.jacobian(balance, u)) @ ca.jacobian(balance, wrt)
    moments = ca.jacobian(at.moment, wrt) + ca.jacobian(at.moment, u) @ turned
    slopes = [ca.densify(part) for part in (turned, moments, ca.jacobian(stretch, u) @ turned)]
    return SectionSlopes(*ca.Function("slopes", [u, *inputs], slopes)(section.curvature, *inputs))


def symbolic_section(theta: Any, stiffness: Any, moment: Any, *offsets: Any, load: Any = None) -> CrossSection:
    """`cross_section` of `SX` expressions, by a function that is built once: for expressions with many sections."""
    inputs = [theta, stiffness, moment, *offsets, *([] if load is None else [load])]
    return CrossSection(
        *_section_function(theta.shape[0], moment.shape[1], bool(offsets), load is not None).call(inputs)
    )


@lru_cache(maxsize=32)
def _section_function(n: int, moments: int, eccentric: bool, loaded: bool) -> ca.Function:
    theta, stiffness, offset, angle = (ca.SX.sym(s, n) for s in ("theta", "kb", "d", "gamma"))
    moment, load = ca.SX.sym("m", n, moments), ca.SX.sym("load", 2)
    inputs = [theta, stiffness, moment, *([offset, angle] if eccentric else [])]
    section = cross_section(*inputs, load=load if loaded else 0.0)
    outputs = [section.curvature, ca.SX(section.stretch), section.moment, section.bending_energy]
    return ca.Function("section", [*inputs, *([load] if loaded else [])], outputs)


@lru_cache(maxsize=32)
def section_functions(n: int, eccentric: bool) -> dict[str, ca.Function]:
    """CasADi functions of (theta, stiffness, moment[, offset, angle]) at one cross-section of n tubes.

    `curvature`: u.  `curvature_slope`: du/dtheta (2, n).  `balance`: M, dM/dtheta (n, n), V, g, dg/dtheta (n, n); the
    last two for eccentric tubes only.  `moment`: M, g.  `section`: M, g, u, V.  `variation`, with a further argument y
    (n,): y' dM/dtheta y, its gradient with respect to theta, kb and m (3 n).  `linear`: M, g, u, V and their
    derivatives (n, 3 n), (n, 3 n), (2, 3 n), (1, 3 n) with respect to theta, kb and m.  `mode`, of eccentric tubes,
    with further arguments y, b, c, e (n,): b' dM/dtheta y + c' dg/dtheta y + e' g, its gradient with respect to theta,
    kb and m (3 n).  `bending`, of concentric tubes: V, M = dV/dtheta, V'' (n, n), u, du/dtheta (2, n), and the
    diagonals d2u/dtheta_i^2 (2, n) of its second derivatives, which have nothing else: what tubes under load need,
    whose curvature is not u.
    """
    theta, stiffness, moment, offset, angle = (ca.SX.sym(s, n) for s in ("theta", "kb", "m", "d", "gamma"))
    inputs = [theta, stiffness, moment] + ([offset, angle] if eccentric else [])
    section = cross_section(*inputs)
    data = ca.vertcat(theta, stiffness, moment)
    slopes = _slopes(section, inputs, data)
    u_theta, m_theta, g_theta = (part[:, :n] for part in slopes)
    outputs = [section.moment, m_theta, section.bending_energy] + ([section.stretch, g_theta] if eccentric else [])
    y = ca.SX.sym("y", n)
    form = ca.bilin(m_theta, y, y)
    energy_slope = ca.densify(ca.gradient(section.bending_energy, data).T)
    values = [section.moment, ca.SX(section.stretch), section.curvature, section.bending_energy]
    table = {
        "curvature": (inputs, [section.curvature]),
        "curvature_slope": (inputs, [u_theta]),
        "balance": (inputs, outputs),
        "moment": (inputs, [section.moment] + ([section.stretch] if eccentric else [])),
        "section": (inputs, values),
        "variation": ([*inputs, y], [form, ca.densify(ca.gradient(form, data))]),
        "linear": (inputs, [*values, slopes.moment, ca.SX(slopes.stretch), slopes.curvature, energy_slope]),
    }
    if not eccentric:
        # u is a sum of terms in one theta_i each, so that its mixed second derivatives vanish.
        second = ca.vertcat(*(ca.diag(ca.hessian(section.curvature[j], theta)[0]).T for j in range(2)))
        bending = [section.bending_energy, section.moment, m_theta, section.curvature, u_theta, second]
        table["bending"] = (inputs, [ca.densify(part) for part in bending])
    if eccentric:
        weights = [ca.SX.sym(name, n) for name in "bce"]
        mode = sum(ca.dot(w, v) for w, v in zip(weights, (m_theta @ y, g_theta @ y, section.stretch), strict=True))
        table["mode"] = ([*inputs, y, *weights], [mode, ca.densify(ca.gradient(mode, data))])
    return {name: ca.Function(name, *signature, {"cse": True}) for name, signature in table.items()}


@lru_cache(maxsize=32)
def bent_functions(n: int) -> dict[str, ca.Function]:
    """CasADi functions of (theta, kb, m, b) at a cross-section of n concentric tubes with a bending moment b (2,), N m.

    `section`: M above u.  `linear`: these and their derivative, transposed, (n + 2, n + 2) with respect to theta and b;
    `linear_data`: that (2 n, n + 2) with respect to kb and m.  `energy`: bending energy per length and its gradient
    (3 n + 2) with respect to all arguments.  `mode`, with further arguments g (2,), y (n,) and a softness c: second
    variation per length along a mode that turns the tubes by y and bends by the moment g,

        y' (dM/dtheta) y - 2 g'(du/dtheta) y - c |g|^2 / sum kb,

    and its gradient (n + 4) with respect to theta, b and g; `mode_data`: that (2 n) with respect to kb and m.
    """
    theta, stiffness, moment, y = (ca.SX.sym(s, n) for s in ("theta", "kb", "m", "y"))
    load, g, softness = ca.SX.sym("b", 2), ca.SX.sym("g", 2), ca.SX.sym("c")
    inputs, state, data = [theta, stiffness, moment, load], ca.vertcat(theta, load), ca.vertcat(stiffness, moment)
    section = cross_section(theta, stiffness, moment, load=load)
    values, energy = ca.vertcat(section.moment, section.curvature), section.bending_energy
    m_theta, u_theta = ca.jacobian(section.moment, theta), ca.jacobian(section.curvature, theta)
    mode = ca.bilin(m_theta, y, y) - 2 * g.T @ u_theta @ y - softness * ca.sumsqr(g) / ca.sum1(stiffness)
    mode_inputs = [*inputs, g, y, softness]
    table = {
        "section": (inputs, [values]),
        "linear": (inputs, [values, ca.densify(ca.jacobian(values, state).T)]),
        "linear_data": (inputs, [ca.densify(ca.jacobian(values, data).T)]),
        "energy": (inputs, [energy, ca.densify(ca.gradient(energy, ca.vertcat(*inputs)))]),
        "mode": (mode_inputs, [mode, ca.densify(ca.gradient(mode, ca.vertcat(state, g)))]),
        "mode_data": (mode_inputs, [ca.densify(ca.gradient(mode, data))]),
    }
    return {name: ca.Function(name, *signature, {"cse": True}) for name, signature in table.items()}


@lru_cache(maxsize=16)
def passed_moment_function(n: int) -> ca.Function:
    """Function (theta, kb, m, b) -> bending moments (n - 1,), N m, that each tube and those in it put on those around.

    Tubes that touch have one curvature u. Those around a contact carry sum_j (m_j - kb_j u), which only the contact
    brings to them. b (2,) is the bending moment of forces, N m.
    """
    theta, stiffness, moment, load = ca.SX.sym("theta", n), ca.SX.sym("kb", n), ca.SX.sym("m", n), ca.SX.sym("b", 2)
    u = cross_section(theta, stiffness, moment, load=load).curvature
    carried = natural_moments(theta, moment) - stiffness @ u.T
    passed = [ca.norm_2(ca.sum1(carried[i:, :])) for i in range(1, n)]
    return ca.Function("passed_moment", [theta, stiffness, moment, load], [ca.vertcat(*passed)], {"cse": True})


@lru_cache(maxsize=16)
def bent_anyhow(n: int) -> ca.Function:
    """Function (theta, kb, m (n, 2)) -> M, dM/dtheta (n, n) of n concentric tubes with precurvature about both axes."""
    theta, stiffness, moment = ca.SX.sym("theta", n), ca.SX.sym("kb", n), ca.SX.sym("m", n, 2)
    section = cross_section(theta, stiffness, moment)
    slope = ca.densify(ca.jacobian(section.moment, theta))
    return ca.Function("balance", [theta, stiffness, moment], [section.moment, slope], {"cse": True})


# --- Tubes of fixed own length beside the centreline ------------------------------------------------------------------

# A tube at offset d in direction phi is g = h + d a.kappa long where the centreline is h long and turns by kappa = h u,
# with a = (sin phi, -cos phi). With the turn p = h theta' over the element its energy is
#
#     kt p^2 / (2 g) + kb |kappa - g kappa_0 e(theta)|^2 / (2 g),
#
# jointly convex in (p, kappa, h) but for -m kappa.e(theta), m = kb kappa_0, as g > 0. Lengths g are linear in (kappa,
# h): that tubes have a fixed own length is a linear condition.


class _BundleEnergy(NamedTuple):
    """Energy of a bundle over an element of the centreline, as an expression of its arguments."""

    local: ca.SX
    """v = (theta (n,), p (n,), kappa (2,), h)."""
    data: list[ca.SX]
    """kb, kt, m, d and phi (n,), and the bending stiffness of the sheath."""
    energy: ca.SX
    """Energy, J."""
    length: ca.SX
    """Lengths g (n,) of the tubes, m."""


def _bundle_energy(n: int) -> _BundleEnergy:
    theta, turn, bend, h = ca.SX.sym("theta", n), ca.SX.sym("p", n), ca.SX.sym("kappa", 2), ca.SX.sym("h")
    kb, kt, m, d, phi = (ca.SX.sym(name, n) for name in ("kb", "kt", "m", "d", "phi"))
    sheath = ca.SX.sym("sheath")
    length = h * _stretch(bend / h, d, phi)
    twisting = ca.dot(kt, turn**2 / length) / 2
    bending = ca.sumsqr(bend) * (ca.sum1(kb / length) + sheath / h) / 2
    natural = ca.dot(m**2 / ca.if_else(kb > 0, kb, 1), length) / 2
    coupling = ca.dot(natural_moments(theta, m), ca.repmat(bend.T, n, 1))
    energy = twisting + bending + natural - coupling
    return _BundleEnergy(ca.vertcat(theta, turn, bend, h), [kb, kt, m, d, phi, sheath], energy, length)


@lru_cache(maxsize=16)
def bundle_energy(n: int) -> ca.Function:
    """Elastic energy of n tubes of fixed own length in a sheath, over an element of the centreline, with derivatives.

    Args of the function: v = (theta (n,), p (n,), kappa (2,), h), kb, kt, m, d, phi (n,), and the bending stiffness of
    the sheath. kt and kb of absent tubes are 0.

    Returns of the function: energy (J), gradient (2 n + 3), Hessian (2 n + 3, 2 n + 3), and lengths g (n,) of the
    tubes, m.
    """
    v, data, energy, length = _bundle_energy(n)
    hessian, gradient = ca.hessian(energy, v)
    outputs = [energy, ca.densify(gradient), ca.densify(hessian), length]
    return ca.Function("bundle_energy", [v, *data], outputs, {"cse": True})


@lru_cache(maxsize=16)
def bundle_energy_changes(n: int) -> ca.Function:
    """Derivatives of `bundle_energy`, and of its second variation a' Hessian b for two directions of v.

    Args of the function: those of `bundle_energy`, and a, b (2 n + 3,).

    Returns of the function: gradient of the energy by the data, kb to the sheath (5 n + 1); derivative of its gradient
    by them (5 n + 1, 2 n + 3); gradient of the second variation by v and the data (7 n + 4).
    """
    v, inputs, energy, _ = _bundle_energy(n)
    data = ca.vertcat(*inputs)
    a, b = ca.SX.sym("a", v.shape[0]), ca.SX.sym("b", v.shape[0])
    gradient = ca.gradient(energy, v)
    second = ca.dot(ca.jtimes(gradient, v, b), a)
    outputs = [ca.gradient(energy, data), ca.jacobian(gradient, data).T, ca.gradient(second, ca.vertcat(v, data))]
    dense = [ca.densify(each) for each in outputs]
    return ca.Function("bundle_energy_changes", [v, *inputs, a, b], dense, {"cse": True})
