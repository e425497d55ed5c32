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
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ..typing import Array

WHOLE, ONCE = (24, 4), (18, 1)
"""Terms of the series, and parts of a section that it crosses: to round-off where tubes can bend it by up to 16 rad;
and where they can bend it by up to 1.5 rad, as a piece of a mesh, or every section where lambda is the eigenvalue."""

OPPOSED, TURNED, APART = (1.0, 1.0), (1.0, -1.0), (0.0, 0.0)
"""Pairs of tubes in N: (Y_i + Y_j)^2; (y_i - y_j)^2, which without force gives the certificate of tubes that bear
none; and none, for the part of N by the force alone. Factors of Y_i^2 + Y_j^2 and of 2 Y_i Y_j."""

ITERATIONS = 200
"""Of Newton's method, which takes some ten: twice the digits each time, but one bit where an eigenvalue is double."""


def pair_couplings(stiffness: Any, moment: Any) -> Any:
    """(n, n) |c_ij| of every pair of tubes at a cross-section with kb_i, m_i (n,), 0 on the diagonal."""
    # -V'' has m_i m_j cos(theta_i - theta_j) / sum kb for a pair: |cos| <= 1 bounds it at any rotations.
    pull = ca.fabs(moment)
    pairs = pull @ pull.T / ca.sum1(stiffness)
    return pairs - ca.diag(ca.diag(pairs))


def laplacian(stiffness: Any, moment: Any) -> Any:
    """(n, n) C with y' C y = sum_pairs |c_ij| (y_i - y_j)^2: -V'' at rotations that are worst for every pair."""
    pairs = pair_couplings(stiffness, moment)
    return ca.diag(ca.sum2(pairs)) - pairs


@lru_cache(maxsize=16)
def bend_rate_function(n: int) -> ca.Function:
    """(kb, m (n,)) -> |m_i| / sum kb (n,): how much curvature (1/m) a turn of a tube can change; 0 where none is."""
    stiffness, moment = (ca.SX.sym(s, n) for s in ("kb", "m"))
    total = ca.sum1(stiffness)
    # Both branches of `if_else` are evaluated: 0 / 0 in the unused one would make the sum NaN.
    rate = ca.if_else(total > 0, ca.fabs(moment) / ca.if_else(total > 0, total, 1), ca.DM.zeros(n))
    return ca.Function("bend_rate", [stiffness, moment], [rate], {"cse": True})


@lru_cache(maxsize=16)
def coupling_rate_function(n: int) -> ca.Function:
    """(kb, m, kt (n,)) -> bound sqrt(c) of the fastest growth or oscillation of torsion, 1/m; 0 where no tube is.

    For two tubes c = (1 + nu) kappa_1 kappa_2 when their nu are equal (Dupont et al. 2010); for more, the row sums of
    the Jacobi matrix, and what is behind them, sum_j |c_ij| (1 / kt_i + 1 / kt_j), bound its eigenvalues.
    """
    stiffness, moment, kt = (ca.SX.sym(s, n) for s in ("kb", "m", "kt"))
    # Without tubes m = 0, and kb = 1 makes the couplings 0 instead of 0 / 0.
    there = ca.if_else(ca.sum1(stiffness) > 0, stiffness, ca.DM.ones(n))
    pairs = pair_couplings(there, moment)
    # Row sums of C diag(1 / kt), which has the eigenvalues of diag(1 / kt) C (Gershgorin).
    rate = ca.sqrt(ca.mmax(pairs @ (1 / kt) + ca.sum2(pairs) / kt))
    return ca.Function("coupling_rate", [stiffness, moment, kt], [rate], {"cse": True})


@lru_cache(maxsize=16)
def worst_function(n: int) -> ca.Function:
    """(kb, m, y) -> -C (n, n), -y' C y, its gradient with respect to kb and m (2 n), |c_ij| (n, n)."""
    stiffness, moment, y = (ca.SX.sym(s, n) for s in ("kb", "m", "y"))
    worst = -laplacian(stiffness, moment)
    form = ca.bilin(worst, y, y)
    slope = ca.gradient(form, ca.vertcat(stiffness, moment))
    outputs = [ca.densify(part) for part in (worst, form, slope, pair_couplings(stiffness, moment))]
    return ca.Function("worst", [stiffness, moment, y], outputs, {"cse": True})


@lru_cache(maxsize=32)
def crossing_function(n: int, columns: int, terms: int, parts: int) -> ca.Function:
    """(end, mu, pairs, F, h, lever, K, pull, kt) -> states (2 n + 2, `columns`) where a section begins.

    `end`: states (Y (n), phi, P (n), p) where it ends, at the distance `lever` from the tip; K and `pull` |a_i| (n,)
    are constant on its length h; `pairs` as OPPOSED. In so many `parts`, by series of so many `terms`.
    """
    end, stiffness = ca.SX.sym("end", 2 * n + 2, columns), ca.SX.sym("K")
    mu, force, h, lever = (ca.SX.sym(name) for name in ("mu", "F", "h", "lever"))
    pairs, pull, kt = ca.SX.sym("pairs", 2), ca.SX.sym("pull", n), ca.SX.sym("kt", n)
    # S of the text above: (Y_i + Y_j)^2 puts |c_ij| on both diagonal entries and beside them.
    coupled = pair_couplings(stiffness, pull)
    opposing = pairs[0] * ca.diag(ca.sum2(coupled)) + pairs[1] * coupled
    # A bounded sum of large terms x^k / k! loses digits: short parts keep the terms small.
    state, part = end, h / parts
    for k in range(parts):
        where = mu, force, lever + k * part, part
        state = _series(state, where, (opposing, pull / stiffness, stiffness, kt), terms)
    inputs = [end, mu, pairs, force, h, lever, stiffness, pull, kt]
    return ca.Function("crossing", inputs, [state], {"cse": True})


def _series(state: Any, where: tuple[Any, ...], section: tuple[Any, ...], terms: int) -> Any:
    """States one part nearer to the plate: the sum of the terms x_k h^k."""
    (mu, force, lever, h), (opposing, slope, stiffness, kt) = where, section
    n = slope.shape[0]
    last, total, term = ca.SX.zeros(n, state.shape[1]), state, state
    for k in range(terms):
        y, phi, torque, moment = term[:n, :], term[n, :], term[n + 1 : 2 * n + 1, :], term[2 * n + 1, :]
        bent = ca.repmat(slope, 1, y.shape[1])
        # M = F (lever + x) is linear: its slope multiplies the coefficient of Y one power below, `last`.
        pulled = opposing @ y + force * bent * (lever * y + h * last)
        # Minus the derivatives of the text above, since x runs from the tip to the plate.
        change = ca.vertcat(
            -torque / ca.repmat(kt, 1, y.shape[1]),
            -slope.T @ y - moment / stiffness,
            mu * pulled + slope @ moment,
            1.5 * force * mu * phi,
        )
        last, term = y, h / (k + 1) * change
        total = total + term
    return total


@lru_cache(maxsize=64)
def _plate_function(n: int, sections: int) -> ca.Function:
    """(mu, pairs, F, h (m,), K (m,), pull (n, m), kt (n, m), |beta| (n,)) -> (n + 1, n + 1) what the conditions at the
    plate miss by for each way in which the tip may be turned, and its derivative by mu."""
    mu, pairs, force = ca.MX.sym("mu"), ca.MX.sym("pairs", 2), ca.MX.sym("F")
    h, stiffness, pull = ca.MX.sym("h", sections), ca.MX.sym("K", sections), ca.MX.sym("pull", n, sections)
    kt, held = ca.MX.sym("kt", n, sections), ca.MX.sym("l", n)
    crossing = crossing_function(n, n + 1, *WHOLE)
    # At the free tip P = 0 and p = 0; the columns are unit values of Y_1, ..., Y_n and phi.
    state: Any = ca.vertcat(ca.DM.eye(n + 1), ca.DM.zeros(n + 1, n + 1))
    lever: Any = 0.0
    for k in reversed(range(sections)):
        state = crossing(state, mu, pairs, force, h[k], lever, stiffness[k], pull[:, k], kt[:, k])
        lever = lever + h[k]
    missed = plate_conditions(state, kt[:, 0], held)
    # One tangent carried through all sections; the derivative by Newton's method needs no other.
    slope = ca.reshape(ca.jtimes(ca.vec(missed), mu, ca.MX(1)), n + 1, n + 1)
    return ca.Function("plate", [mu, pairs, force, h, stiffness, pull, kt, held], [missed, slope])


def plate_conditions(state: Any, kt: Any, held: Any) -> Any:
    """By what Y = |beta| Y' and phi = 0 are missed at the plate, where the states (2 n + 2, ...) are these."""
    n = kt.shape[0]
    # The straight part below the plate is a spring kt / |beta|, and Y' = P / kt.
    springs = state[:n, :] - ca.repmat(held / kt, 1, state.shape[1]) * state[n + 1 : 2 * n + 1, :]
    return ca.vertcat(springs, state[n, :])


def largest_eigenvalue(
    force: float, sections: tuple[Array, Array, Array], tubes: tuple[Array, Array], pairs: tuple[float, float] = OPPOSED
) -> tuple[float, Array]:
    """Largest eigenvalue lambda of N relative to T, and (n + 1,) its Y and phi at the tip, the largest being 1.

    `sections`: length (m,), K (m,), |a_i| (m, n), plate to tip.   `tubes`: kt (n,) or (n, m), transmission (n,) with kt
    at the plate. The eigenvalue is infinite where numbers overflow.

    What the conditions at the plate miss by has a determinant, as a function of mu, with real roots alone, the
    reciprocals of the eigenvalues: an entire function of order 1/2, so the product of its 1 - mu lambda_k. Newton's
    method from mu = 0 therefore rises to the least root and never passes it: every iterate is a bound of lambda.
    """
    length, stiffness, pull = sections
    kt = tubes[0] if np.ndim(tubes[0]) == 2 else np.repeat(tubes[0][:, None], len(length), axis=1)
    function = _plate_function(len(kt), len(length))
    given: list[Any] = [pairs, force, length, stiffness, pull.T, kt, tubes[1]]
    mu, last = 0.0, np.inf
    for _ in range(ITERATIONS):
        missed, slope = (np.array(each) for each in function(mu, *given))
        if not (np.isfinite(missed).all() and np.isfinite(slope).all()):
            return np.inf, np.zeros(len(kt) + 1)
        try:
            # -D'/D of the determinant D.
            rate = -float(np.trace(np.linalg.solve(missed, slope)))
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
    tip = np.linalg.svd(missed)[2][-1]
    return (1 / mu if mu > 0 else 0.0), tip / tip[np.argmax(np.abs(tip))]


def base_determinant(eigenvalue: Any, given: dict[str, Any], across: tuple[int, int]) -> Any:
    """D(lambda) without a force, of tubes with torsional_stiffness kt (n,) or (n, m), transmission (n,), and per
    section, base to tip, length (m,), stiffness kb_i of the tubes present and moment m_i of the tubes curved, (n, m).

    Its pairs are those of rotations that are worst for each: TURNED. Where kt changes from section to section
    `transmission` is kt of the first one times int ds / kt up to the plate. `across`: terms and parts, as WHOLE.
    """
    n, sections = given["stiffness"].shape
    kt = ca.horzsplit(given["torsional_stiffness"])
    kt = kt if len(kt) == sections else kt * sections
    crossing = crossing_function(n, n, *across)
    state: Any = ca.vertcat(ca.DM.eye(n), ca.DM.zeros(n + 2, n))
    for k in reversed(range(sections)):
        stiffness, pull = ca.sum1(given["stiffness"][:, k]), ca.fabs(given["moment"][:, k])
        state = crossing(state, 1 / eigenvalue, TURNED, 0.0, given["length"][k], 0.0, stiffness, pull, kt[k])
    # Without a force p stays 0, and phi acts on nothing: the last condition drops out.
    return ca.det(plate_conditions(state, kt[0], given["transmission"])[:n, :])


PARAMETERS = (
    "bending_stiffness",
    "torsional_stiffness",
    "curvature",
    "straight_length",
    "curved_length",
    "translation",
)
"""What the certificate depends on, each (n,): a tube parameter, SI, or the translation."""


Rows = tuple[tuple[int, ...], ...]
Pattern = tuple[tuple[int, ...], Rows, Rows]


@lru_cache(maxsize=128)
def determinant_function(pattern: Pattern) -> Any:
    """(lambda, PARAMETERS...) -> D(lambda), of which 1 - mu_cert is the largest root.

    `pattern` fixes the order of breakpoints: the breakpoint at the end of each section (2 i for the transition of tube
    i, 2 i + 1 for its end), and which tubes are present and curved on it.
    """
    ends, present, curved = pattern
    n = len(present[0])
    symbols = {name: ca.SX.sym(name, n) for name in PARAMETERS}
    # Each tube is clamped at beta < 0: -beta is its length below the plate.
    beta = symbols["translation"] - symbols["straight_length"]
    transition = beta + symbols["straight_length"]
    tip = transition + symbols["curved_length"]
    # D is smooth only while the breakpoints keep their order, so each order has its own function.
    cuts = [ca.SX(0), *((tip if e % 2 else transition)[e // 2] for e in ends)]
    masks = (ca.DM(present).T, ca.DM(curved).T)
    given = {
        "torsional_stiffness": symbols["torsional_stiffness"],
        "transmission": -beta,
        "length": ca.vertcat(*(b - a for a, b in pairwise(cuts))),
        "stiffness": masks[0] * symbols["bending_stiffness"],
        "moment": masks[1] * (symbols["bending_stiffness"] * symbols["curvature"]),
    }
    eigenvalue = ca.SX.sym("lambda")
    determinant = base_determinant(eigenvalue, given, ONCE)
    return ca.Function("determinant", [eigenvalue, *symbols.values()], [determinant], {"cse": True})
