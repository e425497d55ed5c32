"""Constants and tables of the kernels, as C."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...block.transcription.collocated import ENDS
from ...block.transcription.general_arm import FINE, ROUGHER, SUBSTEPS
from ...block.transcription.green import INWARDS
from ...block.transcription.linear import hermite
from ...block.transcription.mesh import DETAIL_PER_PIECE, KNOWN, SAMPLES, TWIST_PER_PIECE
from ...block.transcription.piece import EXTRA_POINTS
from ...block.transcription.tableau import tableau
from ...robots.lengthwise import gauss_rule
from ...typing import Array
from .text import c_tables


def general_constants(degree: int) -> str:
    """Numbers of which the kernel for tubes made of pieces is made, with `degree` points per piece, as C."""
    fine, check = tableau("gauss", degree), tableau("gauss", degree + EXTRA_POINTS)

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
    return piece_constants() + _defined(numbers) + c_tables(tables)


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
    return _defined(numbers) + c_tables(tables)


def _defined(numbers: Mapping[str, float]) -> str:
    return "".join(f"#define {name} {value!r}\n" for name, value in numbers.items())


def slope_constants(degree: int) -> str:
    """Tables of `slopes.c`: at the points, the Lagrange basis integrated twice, and shape points with their slopes; at
    the shape points, the basis integrated once."""
    fine = tableau("gauss", degree)
    return c_tables(
        {
            "TWICE_INSIDE": fine.lagrange(fine.nodes, integrals=2),
            "POSE_INSIDE": hermite(fine.family, fine.degree),
            "ONCE_UP_TO": fine.lagrange(ENDS, integrals=1),
        }
    )
