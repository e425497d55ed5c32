"""The snap-free certificate as CasADi expressions: the worst second variation that any rotations can give.

With every cos(theta_i - theta_j) replaced by -1 the second variation is

    Q(y) = sum_i int kt_i y_i'^2 - int sum_pairs |c_ij| (y_i - y_j)^2 + sum_i kt_i / |beta_i| y_i(0)^2,

c_ij = m_i m_j / sum kb, constant on each section. mu_cert is its smallest eigenvalue relative to the torsional part:
1 - lambda, with lambda the largest number for which the Jacobi equation  lambda kt y'' = -C y  (C the Laplacian matrix
of the |c_ij|) has a solution with y' = 0 at the tip and y(0) = |beta| y'(0). From Y = 1, Y' = 0 at the tip it is
carried to the base by transfer matrices, entire functions of the coefficients, and
D(lambda) = det(Y(0) - |beta| Y'(0)) is 0.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca

TERMS = 12
"""Terms of cos and sinc of the transfer matrices, for h^2 C / (kt lambda) up to SPLITS^2."""

SPLITS = 4
"""Parts in which every section is crossed."""


def pair_couplings(stiffness: Any, moment: Any) -> Any:
    """(n, n) |c_ij| of every pair of tubes at a cross-section with kb_i, m_i (n,), 0 on the diagonal."""
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
    rate = ca.if_else(total > 0, ca.fabs(moment) / ca.if_else(total > 0, total, 1), ca.DM.zeros(n))
    return ca.Function("bend_rate", [stiffness, moment], [rate], {"cse": True})


@lru_cache(maxsize=16)
def coupling_rate_function(n: int) -> ca.Function:
    """(kb, m, kt (n,)) -> bound sqrt(c) of the fastest growth or oscillation of torsion, 1/m; 0 where no tube is.

    For two tubes c = (1 + nu) kappa_1 kappa_2 when their nu are equal (Dupont et al. 2010); for more, the row sums of
    the Jacobi matrix, and what is behind them, sum_j |c_ij| (1 / kt_i + 1 / kt_j), bound its eigenvalues.
    """
    stiffness, moment, kt = (ca.SX.sym(s, n) for s in ("kb", "m", "kt"))
    there = ca.if_else(ca.sum1(stiffness) > 0, stiffness, ca.DM.ones(n))
    pairs = pair_couplings(there, moment)
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


def base_determinant(eigenvalue: Any, given: dict[str, Any]) -> Any:
    """D(lambda) of tubes with torsional_stiffness kt (n,) or (n, m), transmission (n,), and per section, base to tip,
    length (m,), stiffness kb_i of the tubes present and moment m_i of the tubes curved, (n, m).

    Where kt changes from section to section kt y' is continuous, and `transmission` is kt of the first one times
    int ds / kt up to the plate.
    """
    n, sections = given["stiffness"].shape
    kt = ca.horzsplit(given["torsional_stiffness"])
    kt = kt if len(kt) == sections else kt * sections
    identity = ca.DM.eye(n)
    y: Any = identity
    slope: Any = ca.DM.zeros(n, n)
    for k in reversed(range(sections)):
        coupling = laplacian(given["stiffness"][:, k], given["moment"][:, k])
        rate = ca.diag(1 / kt[k]) @ coupling / eigenvalue
        if k + 1 < sections and kt[k] is not kt[k + 1]:
            slope = ca.diag(kt[k + 1] / kt[k]) @ slope
        h = given["length"][k] / SPLITS
        cos, sinc, turned = _transfer(rate, h)
        for _ in range(SPLITS):
            # Backwards: the slope changes sign.
            y, slope = cos @ y - h * (sinc @ slope), turned @ y + cos @ slope
    return ca.det(y - ca.diag(given["transmission"]) @ slope)


def _transfer(rate: Any, h: Any) -> tuple[Any, Any, Any]:
    """cos(h sqrt(N)), sinc(h sqrt(N)) and h N sinc(h sqrt(N)) of a matrix N = `rate`, by their power series."""
    identity = ca.DM.eye(rate.shape[0])
    argument = h**2 * rate
    cos: Any = identity
    sinc: Any = identity
    for k in reversed(range(1, TERMS + 1)):
        cos = identity - argument @ cos / ((2 * k - 1) * (2 * k))
        sinc = identity - argument @ sinc / ((2 * k) * (2 * k + 1))
    return cos, sinc, h * rate @ sinc


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


def _posed(pattern: Pattern) -> tuple[Any, dict[str, Any], Any]:
    """lambda, PARAMETERS (n,), and D(lambda)."""
    ends, present, curved = pattern
    n = len(present[0])
    symbols = {name: ca.SX.sym(name, n) for name in PARAMETERS}
    beta = symbols["translation"] - symbols["straight_length"]
    transition = beta + symbols["straight_length"]
    tip = transition + symbols["curved_length"]
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
    return eigenvalue, symbols, base_determinant(eigenvalue, given)


@lru_cache(maxsize=128)
def determinant_function(pattern: Pattern) -> Any:
    """(lambda, PARAMETERS...) -> D(lambda), of which 1 - mu_cert is the largest root."""
    eigenvalue, symbols, determinant = _posed(pattern)
    return ca.Function("determinant", [eigenvalue, *symbols.values()], [determinant], {"cse": True})


@lru_cache(maxsize=128)
def certificate_function(pattern: Pattern) -> Any:
    """(lambda, PARAMETERS...) -> derivative of mu with respect to each of PARAMETERS, (n,).

    `pattern` fixes the order of breakpoints: the breakpoint at the end of each section (2 i for the transition of tube
    i, 2 i + 1 for its end), and which tubes are present and curved on it. lambda is the eigenvalue to about 1e-6. The
    derivatives are those of the implicit function D = 0.
    """
    eigenvalue, symbols, determinant = _posed(pattern)
    inputs, n = [eigenvalue, *symbols.values()], len(pattern[1][0])
    ends = [0, *(1 + n * k for k in range(len(symbols) + 1))]
    rate, *slopes = ca.vertsplit(ca.gradient(determinant, ca.vertcat(*inputs)), ends)
    gradient = [slope / rate for slope in slopes]
    return ca.Function("certificate", inputs, gradient, ["lambda", *symbols], [f"d_{name}" for name in symbols])
