"""What varies along one piece of tubes made of pieces, as the numbers of a column and read at any point of the piece.

Every tube has polynomials on the panels that its own pieces are cut into; a piece of the mesh lies in one panel of each
tube, from `low` to `high` in the coordinate -1 .. 1 of that panel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...robots.lengthwise import CrossSections
from ...typing import Array

CHANNELS = 5
"""EI of a tube that is present, GJ, u*_x, u*_y and the natural turn, in this order."""

QUADRATURE = 16
"""Gauss points for the mean torsional compliance of a panel."""


@dataclass(frozen=True, eq=False)
class Local:
    """n tubes at a cross-section: kb (n,), m (n,) or (n, 2), natural turn, ease kt / GJ, and u* (n, 2)."""

    stiffness: Any
    moment: Any
    wound: Any = 0.0
    ease: Any = 1.0
    natural: Any = None


def width(n: int, detail: int) -> int:
    """Length of the column of n tubes with `detail` coefficients."""
    return n * (CHANNELS * detail + 2)


def local(along: Any, torsional_stiffness: Any, detail: int, x: Any) -> Local:
    """The tubes at the fraction x of a piece.

    Args:
        along: column, tube by tube: `detail` coefficients of each channel, then low and high.
        torsional_stiffness: (n,) kt, to which the ease refers.
    """
    n = along.numel() // (CHANNELS * detail + 2)
    return Local(*_local_function(n, detail).call([along, torsional_stiffness, x]))


@lru_cache(maxsize=32)
def _local_function(n: int, detail: int) -> ca.Function:
    """Written out once, for expressions of symbols that have many points."""
    along, torsional_stiffness, x = ca.SX.sym("along", width(n, detail)), ca.SX.sym("kt", n), ca.SX.sym("x")
    table = ca.reshape(along, CHANNELS * detail + 2, -1)
    low, high = table[-2, :], table[-1, :]
    basis = chebyshev(low + x * (high - low), detail)
    kb, kt, a, b, wound = (sum(table[c * detail + k, :] * basis[k] for k in range(detail)).T for c in range(CHANNELS))
    natural = ca.horzcat(a, b)
    outputs = [kb, ca.horzcat(kb, kb) * natural, wound, torsional_stiffness / kt, natural]
    return ca.Function("local", [along, torsional_stiffness, x], outputs)


def chebyshev(x: Any, count: int) -> list[Any]:
    """The first `count` polynomials at x."""
    basis = [1.0, x]
    for _ in range(2, count):
        basis.append(2 * x * basis[-1] - basis[-2])
    return basis[:count]


def at_points(here: CrossSections, nodes: Array) -> Array:
    """The columns of P pieces, one behind the other, by polynomials through the cross-sections (P K, n) at nodes (K,)
    of every piece: as good as exact where nothing but these is asked for."""
    count, n = len(nodes), here.stiffness.shape[1]
    curvature = here.moment / np.where(here.stiffness > 0, here.stiffness, 1.0)
    turn = here.phase - here.wound
    parts = here.stiffness, here.torsional_stiffness, curvature * np.cos(turn), curvature * np.sin(turn), here.wound
    fit = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * nodes - 1, count - 1))
    tables = [fit @ part.reshape(-1, count, n) for part in parts]
    whole = np.concatenate(tables, axis=1).transpose(0, 2, 1)
    ends = np.broadcast_to([-1.0, 1.0], (*whole.shape[:2], 2))
    return np.asarray(np.concatenate([whole, ends], axis=2).ravel())


def slid(table: Any, detail: int, lengths: Any, moved: tuple[Any, Any]) -> Any:
    """Columns (X, P) as `at_points` gives them for pieces of `lengths` (P,), m, after the ends of the pieces (P + 1,)
    and the tubes (n,) have `moved` forward, m: the same polynomials of the place on each tube."""
    ends, tubes = moved
    rows, pieces = CHANNELS * detail + 2, table.shape[1]
    out = []
    for i in range(tubes.shape[0]):
        places = [2 * (ends[first : first + pieces] - tubes[i]) / lengths for first in (0, 1)]
        out += [table[i * rows : (i + 1) * rows - 2, :], (places[0] - 1).T, (places[1] + 1).T]
    return ca.vertcat(*out)


@lru_cache(maxsize=32)
def compliance_function(detail: int) -> ca.Function:
    """(coefficients of GJ (detail,), low, high) -> mean of 1 / GJ between two places of a panel."""
    coefficients, low, high = ca.SX.sym("kt", detail), ca.SX.sym("low"), ca.SX.sym("high")
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE if detail > 1 else 1)
    mean: Any = 0.0
    for x, w in zip((nodes + 1) / 2, weights / 2, strict=True):
        basis = chebyshev(low + x * (high - low), detail)
        mean += w / sum(coefficients[k] * basis[k] for k in range(detail))
    return ca.Function("compliance", [coefficients, low, high], [mean], {"cse": True})
