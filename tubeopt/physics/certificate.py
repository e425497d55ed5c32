"""The snap-free certificate as CasADi expressions: the worst second variation that any rotations, and any force on the
tip of at most F, can give.

With every cos(theta_i - theta_j) replaced by -1 the second variation without a force is

    Q(y) = sum_i int kt_i y_i'^2 - int sum_pairs |c_ij| (y_i - y_j)^2 + sum_i kt_i / |beta_i| y_i(0)^2,

c_ij = m_i m_j / sum kb, constant on each section. mu_cert is its smallest eigenvalue relative to the torsional part,
1 - lambda. Under a force, with A_i = |a_i| / K and M = F (L - s), which bounds the bending moment, what the second
variation has beside T = int sum kt Y'^2 + K |r|^2 + springs is no less than -N,

    N = int sum_pairs |c_ij| (Y_i + Y_j)^2 + sum_i M A_i Y_i^2 + 3/2 F phi^2,    phi' = sum A_i Y_i + r,  phi(0) = 0.

Where lambda T - N is stationary, with P = kt Y' and p = K r and with mu = 1 / lambda,

    Y' = P / kt,   phi' = A . Y + p / K,   P' = -mu (S + M diag A) Y - A p,   p' = -3/2 mu F phi,

S the matrix of the sum over pairs, and P = 0, p = 0 at the tip, phi = 0 and Y = |beta| Y' at the plate. They are
carried from the tip to the plate by power series in the distance, exact for the moment's linear growth. Without a
force phi and p drop out.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..typing import Array

WHOLE, ONCE = (24, 4), (18, 1)
"""Number of terms of the series, and of parts of a section.

WHOLE is accurate to round-off for sections that tubes can bend by up to 16 rad; ONCE up to 1.5 rad, as pieces of a
mesh, or sections at the eigenvalue itself."""

OPPOSED, TURNED, APART = (1.0, 1.0), (1.0, -1.0), (0.0, 0.0)
"""Pairs of tubes in N, as factors of Y_i^2 + Y_j^2 and of 2 Y_i Y_j.

OPPOSED is (Y_i + Y_j)^2; TURNED is (y_i - y_j)^2, which gives the certificate without force; APART leaves the pairs
out, for the part of N by the force alone."""

ITERATIONS = 200
"""Maximum number of Newton iterations. Usually about ten: digits double each time, but a double eigenvalue gains one
bit an iteration."""


def pair_couplings(stiffness: Any, moment: Any) -> Any:
    """Couplings |c_ij| (n, n) of every pair of tubes at a cross-section with kb, m (n,); 0 on the diagonal."""
    # -V'' has m_i m_j cos(theta_i - theta_j) / sum kb for a pair: |cos| <= 1 bounds it at any rotations.
    size = ca.fabs(moment)
    pairs = size @ size.T / ca.sum1(stiffness)
    return pairs - ca.diag(ca.diag(pairs))


def laplacian(stiffness: Any, moment: Any) -> Any:
    """Matrix C (n, n) with y' C y = sum_pairs |c_ij| (y_i - y_j)^2.

    It is -V'' at the worst rotations of every pair.
    """
    pairs = pair_couplings(stiffness, moment)
    return ca.diag(ca.sum2(pairs)) - pairs


@lru_cache(maxsize=16)
def bend_rate_function(n: int) -> ca.Function:
    """Function (kb, m (n,)) -> |m_i| / sum kb (n,), 1/m: curvature that turning a tube can change; 0 without tubes."""
    stiffness, moment = (ca.SX.sym(s, n) for s in ("kb", "m"))
    total = ca.sum1(stiffness)
    # Both branches of `if_else` are evaluated: 0 / 0 in the unused one would make the sum NaN.
    rate = ca.if_else(total > 0, ca.fabs(moment) / ca.if_else(total > 0, total, 1), ca.DM.zeros(n))
    return ca.Function("bend_rate", [stiffness, moment], [rate], {"cse": True})


@lru_cache(maxsize=16)
def coupling_rate_function(n: int) -> ca.Function:
    """Function (kb, m, kt (n,)) -> bound sqrt(c) on the rate of growth or oscillation of torsion, 1/m; 0 without tubes.

    For two tubes c = (1 + nu) kappa_1 kappa_2 if their nu are equal (Dupont et al. 2010). For more tubes the row sums
    sum_j |c_ij| (1 / kt_i + 1 / kt_j) bound the eigenvalues of the Jacobi matrix.
    """
    stiffness, moment, kt = (ca.SX.sym(s, n) for s in ("kb", "m", "kt"))
    # Without tubes m = 0, and kb = 1 makes the couplings 0 instead of 0 / 0.
    safe = ca.if_else(ca.sum1(stiffness) > 0, stiffness, ca.DM.ones(n))
    pairs = pair_couplings(safe, moment)
    # Row sums of C diag(1 / kt), which has the eigenvalues of diag(1 / kt) C (Gershgorin).
    rate = ca.sqrt(ca.mmax(pairs @ (1 / kt) + ca.sum2(pairs) / kt))
    return ca.Function("coupling_rate", [stiffness, moment, kt], [rate], {"cse": True})


@lru_cache(maxsize=16)
def worst_function(n: int) -> ca.Function:
    """Function (kb, m, y) -> -C (n, n), -y' C y, its gradient (2 n), |c_ij| (n, n).

    The gradient is by kb and m.
    """
    stiffness, moment, y = (ca.SX.sym(s, n) for s in ("kb", "m", "y"))
    worst = -laplacian(stiffness, moment)
    form = ca.bilin(worst, y, y)
    slope = ca.gradient(form, ca.vertcat(stiffness, moment))
    outputs = [ca.densify(part) for part in (worst, form, slope, pair_couplings(stiffness, moment))]
    return ca.Function("worst", [stiffness, moment, y], outputs, {"cse": True})


@lru_cache(maxsize=32)
def crossing_function(n: int, columns: int, terms: int, parts: int) -> ca.Function:
    """Function (end, mu, pairs, F, h, lever, K, |a|, kt) -> states (2 n + 2, `columns`) where a section begins.

    `end` are the states (Y (n), phi, P (n), p) where it ends, at the distance `lever` from the tip. K and |a_i| (n,)
    are constant on its length h; `pairs` are as OPPOSED. The section is cut into `parts`, each by `terms` of a series.
    """
    end, stiffness = ca.SX.sym("end", 2 * n + 2, columns), ca.SX.sym("K")
    mu, force, h, lever = (ca.SX.sym(name) for name in ("mu", "F", "h", "lever"))
    pairs, natural_moment, kt = ca.SX.sym("pairs", 2), ca.SX.sym("natural_moment", n), ca.SX.sym("kt", n)
    # S of the module docstring: (Y_i + Y_j)^2 puts |c_ij| on both diagonal entries and beside them.
    coupled = pair_couplings(stiffness, natural_moment)
    opposing = pairs[0] * ca.diag(ca.sum2(coupled)) + pairs[1] * coupled
    slope = natural_moment / stiffness
    slopes, stiffnesses = ca.repmat(slope, 1, columns), ca.repmat(kt, 1, columns)
    # A bounded sum of large terms x^k / k! loses digits: short parts keep the terms small.
    total, part = end, h / parts
    for k in range(parts):
        start = lever + k * part
        previous, term = ca.SX.zeros(n, columns), total
        for power in range(terms):
            y, phi, torque, moment = term[:n, :], term[n, :], term[n + 1 : 2 * n + 1, :], term[2 * n + 1, :]
            # M = F (lever + x) is linear: its slope multiplies the coefficient of Y one power below.
            loaded = opposing @ y + force * slopes * (start * y + part * previous)
            # Negative derivatives of the module docstring, since x runs from the tip to the plate.
            change = ca.vertcat(
                -torque / stiffnesses,
                -slope.T @ y - moment / stiffness,
                mu * loaded + slope @ moment,
                1.5 * force * mu * phi,
            )
            previous, term = y, part / (power + 1) * change
            total = total + term
    inputs = [end, mu, pairs, force, h, lever, stiffness, natural_moment, kt]
    return ca.Function("crossing", inputs, [total], {"cse": True})


@lru_cache(maxsize=64)
def _plate_function(n: int, sections: int) -> ca.Function:
    """Function (mu, pairs, F, h (m,), K (m,), |a| (n, m), kt (n, m), |beta| (n,)) -> residuals at the plate.

    The residuals (n + 1, n + 1) have a column for each unit value of Y_1, ..., Y_n and phi at the tip; the second
    output is their derivative by mu.
    """
    mu, pairs, force = ca.MX.sym("mu"), ca.MX.sym("pairs", 2), ca.MX.sym("F")
    h, stiffness, natural_moment = (
        ca.MX.sym("h", sections),
        ca.MX.sym("K", sections),
        ca.MX.sym("natural_moment", n, sections),
    )
    kt, held = ca.MX.sym("kt", n, sections), ca.MX.sym("l", n)
    crossing = crossing_function(n, n + 1, *WHOLE)
    # At the free tip P = 0 and p = 0; the columns are unit values of Y_1, ..., Y_n and phi.
    state: Any = ca.vertcat(ca.DM.eye(n + 1), ca.DM.zeros(n + 1, n + 1))
    lever: Any = 0.0
    for k in reversed(range(sections)):
        state = crossing(state, mu, pairs, force, h[k], lever, stiffness[k], natural_moment[:, k], kt[:, k])
        lever = lever + h[k]
    residual = plate_conditions(state, kt[:, 0], held)
    # One tangent carried through all sections; the derivative by Newton's method needs no other.
    slope = ca.reshape(ca.jtimes(ca.vec(residual), mu, ca.MX(1)), n + 1, n + 1)
    return ca.Function("plate", [mu, pairs, force, h, stiffness, natural_moment, kt, held], [residual, slope])


def plate_conditions(state: Any, kt: Any, held: Any) -> Any:
    """Residuals (n + 1, ...) of Y = |beta| Y' and phi = 0 at the plate.

    The states are (2 n + 2, ...) there.
    """
    n = kt.shape[0]
    # The straight part below the plate is a spring kt / |beta|, and Y' = P / kt.
    springs = state[:n, :] - ca.repmat(held / kt, 1, state.shape[1]) * state[n + 1 : 2 * n + 1, :]
    return ca.vertcat(springs, state[n, :])


def largest_eigenvalue(
    force: float, sections: tuple[Array, Array, Array], tubes: tuple[Array, Array], pairs: tuple[float, float] = OPPOSED
) -> tuple[float, Array]:
    """Largest eigenvalue lambda of N relative to T, and its Y and phi (n + 1,) at the tip.

    The mode is scaled to a maximum of 1.

    The determinant of the residuals at the plate, as a function of mu, has real roots only, the reciprocals of the
    eigenvalues. It is an entire function of order 1/2, hence the product of 1 - mu lambda_k. Newton's method from
    mu = 0 therefore increases to the smallest root and never passes it: every iterate is a bound on lambda.

    Args:
        sections: length (m,), K (m,), |a_i| (m, n), plate to tip.
        tubes: kt (n,) or (n, m), transmission (n,) with kt at the plate.

    Returns:
        The eigenvalue, infinite if numbers overflow, and the mode at the tip.
    """
    length, stiffness, natural_moment = sections
    kt = tubes[0] if np.ndim(tubes[0]) == 2 else np.repeat(tubes[0][:, None], len(length), axis=1)
    function = _plate_function(len(kt), len(length))
    inputs: list[Any] = [pairs, force, length, stiffness, natural_moment.T, kt, tubes[1]]
    mu, last = 0.0, np.inf
    for _ in range(ITERATIONS):
        residual, slope = (np.array(part) for part in function(mu, *inputs))
        if not (np.isfinite(residual).all() and np.isfinite(slope).all()):
            return np.inf, np.zeros(len(kt) + 1)
        try:
            # -D'/D of the determinant D.
            rate = -float(np.trace(np.linalg.solve(residual, slope)))
        except np.linalg.LinAlgError:
            break
        if not np.isfinite(rate):
            return np.inf, np.zeros(len(kt) + 1)
        # D'^2 >= D D'' for real roots (Laguerre), so the steps -D / D' fall: one that grows is round-off.
        if not rate > 0 or 1 / rate >= last:
            break
        last = 1 / rate
        mu += last
        if last < 1e-15 * mu:
            break
    # The mode's values at the tip span the kernel of the conditions at the plate.
    tip = np.linalg.svd(residual)[2][-1]
    return (1 / mu if mu > 0 else 0.0), tip / tip[np.argmax(np.abs(tip))]


def base_determinant(eigenvalue: Any, data: dict[str, Any], series: tuple[int, int]) -> Any:
    """Determinant D(lambda) without a force, for the pairs TURNED.

    Args:
        data: torsional_stiffness kt (n,) or (n, m), transmission (n,), and per section, base to tip, length (m,),
            stiffness kb of the tubes present and moment m of the tubes curved, (n, m). If kt changes from section to
            section, `transmission` is kt of the first one times int ds / kt up to the plate.
        series: numbers of terms and parts, as WHOLE.
    """
    n, sections = data["stiffness"].shape
    kt = ca.horzsplit(data["torsional_stiffness"])
    kt = kt if len(kt) == sections else kt * sections
    crossing = crossing_function(n, n, *series)
    state: Any = ca.vertcat(ca.DM.eye(n), ca.DM.zeros(n + 2, n))
    for k in reversed(range(sections)):
        stiffness, natural_moment = ca.sum1(data["stiffness"][:, k]), ca.fabs(data["moment"][:, k])
        state = crossing(state, 1 / eigenvalue, TURNED, 0.0, data["length"][k], 0.0, stiffness, natural_moment, kt[k])
    # Without a force p stays 0 and phi has no effect, so the last condition drops out.
    return ca.det(plate_conditions(state, kt[0], data["transmission"])[:n, :])


PARAMETERS = (
    "bending_stiffness",
    "torsional_stiffness",
    "curvature",
    "straight_length",
    "curved_length",
    "translation",
)
"""Parameters of the certificate, (n,) each: dimensions of the tubes, SI, and translations."""
