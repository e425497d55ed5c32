"""Constants and tables of the kernels, as C."""

from __future__ import annotations

import numpy as np

from ...block.transcription.collocated import ENDS
from ...block.transcription.green import INWARDS
from ...block.transcription.linear import hermite
from ...block.transcription.mesh import DETAIL_PER_PIECE, KNOWN, SAMPLES, TWIST_PER_PIECE
from ...block.transcription.tableau import tableau
from ...block.transcription.whole_arm import EXTRA_POINTS, FINE, ROUGHER, SUBSTEPS
from ...robots.lengthwise import gauss_rule
from ...typing import Array
from ..rubbing import HONEST
from ..settings import CONTINUATION
from ..sticking import ROUND_OFF
from .text import c_tables, defined

DEGREE, COARSE_DEGREE = 6, 3
"""Collocation points per element of the solution, and of the descent towards it."""


def rule_constants(general: bool) -> str:
    """The two rules of the kernel, and what carries over between them: the Lagrange basis integrated twice, for tubes
    made of pieces once and twice, of the coarse points at the fine ones, and back."""
    coarse, fine = tableau("gauss", COARSE_DEGREE), tableau("gauss", DEGREE)
    kinds = (1, 2) if general else (2,)
    tables = {
        f"{name}_{part.upper()}": getattr(rule, part)
        for name, rule in (("COARSE", coarse), ("FINE", fine))
        for part in ("nodes", "weights", "matrix")
    }
    tables["TO_FINE"] = np.stack([coarse.lagrange(fine.nodes, integrals=k) for k in kinds])
    tables["TO_COARSE"] = np.stack([fine.lagrange(coarse.nodes, integrals=k) for k in kinds])
    return c_tables(tables)


def general_constants() -> str:
    """Numbers of which the kernel for tubes made of pieces is made, as C."""
    fine, check = tableau("gauss", DEGREE), tableau("gauss", DEGREE + EXTRA_POINTS)

    def bases(x: Array) -> Array:
        return np.stack([fine.lagrange(x, integrals=1), fine.lagrange(x, integrals=2)], axis=1)

    tables = {
        "FINE_POINTS": FINE,
        "FINE_BASIS": bases(FINE),
        "ROUGHER": ROUGHER,
        "ENDS_BASIS": bases(ENDS),
        "CHECK_NODES": check.nodes,
        "CHECK_WEIGHTS": check.weights,
        "CHECK_MATRIX": check.matrix,
        "CHECK_BASIS": bases(check.nodes),
    }
    numbers = {"SUBSTEPS": SUBSTEPS, "EXTRA_POINTS": EXTRA_POINTS}
    return piece_constants() + defined(numbers) + c_tables(tables)


def piece_constants() -> str:
    """Numbers of which `pieces.c` and the mesh of tubes made of pieces are made, as C."""
    nodes, weights = gauss_rule()
    numbers = {
        "QUADRATURE": len(nodes),
        "INWARDS": INWARDS,
        "DETAIL_PER_PIECE": DETAIL_PER_PIECE,
        "TWIST_PER_PIECE": TWIST_PER_PIECE,
        "KNOWN": KNOWN,
    }
    tables = {"SAMPLES": SAMPLES, "QUADRATURE_NODES": nodes, "QUADRATURE_WEIGHTS": weights}
    return defined(numbers) + c_tables(tables)


def slope_constants() -> str:
    """Tables of `change.c`: at the points, the collocated equations integrated twice, and shape points with their
    slopes; at the shape points, the Lagrange basis integrated once."""
    fine = tableau("gauss", DEGREE)
    return c_tables(
        {
            "TWICE_INSIDE": fine.matrix @ fine.adjoint,
            "POSE_INSIDE": hermite(fine.family, fine.degree),
            "ONCE_UP_TO": fine.lagrange(ENDS, integrals=1),
        }
    )


def rubbing_constants() -> str:
    """Numbers and tables of `rubbing.c`."""
    numbers = {
        "PATIENCE": CONTINUATION.stick_patience,
        "MOST_CHANGES": CONTINUATION.stick_changes,
        "HARDLY": ROUND_OFF,
        "HONEST": HONEST,
        "RUB_ITERATIONS": CONTINUATION.rubbing_steps,
        "ONWARD": CONTINUATION.onward,
        "LARGEST_TURN": CONTINUATION.largest_turn,
        "LARGEST_SHIFT": CONTINUATION.largest_shift,
        "LARGEST_RATIO": CONTINUATION.largest_ratio,
        "LARGEST_TWIST": CONTINUATION.largest_twist,
        "SOFT_TWIST": CONTINUATION.soft_twist,
    }
    tables = {"TWICE_LEGENDRE": tableau("gauss", DEGREE).integrated(2)}
    return defined(numbers) + c_tables(tables)
