"""Constants and tables of the kernels, as C text."""

from __future__ import annotations

import numpy as np

from ...block.transcription.arm import EXTRA_QUADRATURE_POINTS, ROUGHER, SUBSTEPS, gauss_fractions, hermite
from ...block.transcription.collocated import ENDS, SHAPE_STEPS
from ...block.transcription.contact import LEAST_CAPACITY
from ...block.transcription.mesh import DETAIL_PER_ELEMENT, INWARDS, KNOWN, SAMPLES, TWIST_PER_ELEMENT
from ...block.transcription.tableau import tableau
from ...robots.lengthwise import gauss_rule
from ...typing import Array
from ..friction_increment import FRICTION_TOLERANCE, SLIP_ROUND_OFF
from ..settings import BOX_CHANGES, FRICTION_ITERATIONS, LARGEST_RATIO, LARGEST_TWIST, ONWARD, SOFT_TWIST
from .text import c_tables, defined

DEGREE, COARSE_DEGREE = 6, 3
"""Collocation points per element of the solution, and of the energy descent before it."""


def rule_constants(eccentric: bool) -> str:
    """Tables of the two rules of the kernel, and of the transfers between them.

    A transfer is the Lagrange basis of the coarse points, integrated once and twice, at the fine points, and vice versa
    for eccentric tubes.
    """
    coarse, fine = tableau("gauss", COARSE_DEGREE), tableau("gauss", DEGREE)
    tables: dict[str, Array] = {}
    for name, rule in (("COARSE", coarse), ("FINE", fine)):
        product = rule.matrix[:, None] * rule.matrix / rule.weights
        parts = {"nodes": rule.nodes, "weights": rule.weights, "matrix": rule.matrix}
        parts |= {"both": product, "within": product.sum(-1)}
        tables |= {f"{name}_{part.upper()}": table for part, table in parts.items()}
    tables["TO_FINE"] = np.stack([coarse.lagrange(fine.nodes, integrals=k) for k in (1, 2)])
    if eccentric:
        tables["TO_COARSE"] = np.stack([fine.lagrange(coarse.nodes, integrals=k) for k in (1, 2)])
    return c_tables(tables)


def arm_constants() -> str:
    """Constants of `pieces.c`, of the mesh and of the arm.

    Tables have a column for each point of a piece at which the shape or the check evaluates the tubes: Gauss points of
    the Magnus steps (of even, and of varying tubes), ENDS, and nodes of the check. Copies of the last point pad them to
    a multiple of four.
    """
    fine, check = tableau("gauss", DEGREE), tableau("gauss", DEGREE + EXTRA_QUADRATURE_POINTS)
    numbers = {"SUBSTEPS": SUBSTEPS, "EXTRA_POINTS": EXTRA_QUADRATURE_POINTS}
    tables = {"ROUGHER": ROUGHER, "CHECK_WEIGHTS": check.weights, "CHECK_COLUMNS": check.matrix.T}
    for name, inside in (("EVEN", gauss_fractions(SHAPE_STEPS)), ("VARIED", gauss_fractions(SUBSTEPS * SHAPE_STEPS))):
        x = np.concatenate([inside, ENDS, check.nodes])
        x = np.pad(x, (0, -len(x) % 4), "edge")
        numbers[f"{name}_COUNT"] = len(x)
        tables[f"{name}_POINTS"] = x
        tables |= {f"{name}_{word}": fine.lagrange(x, integrals=k).T for k, word in ((1, "ONCE"), (2, "TWICE"))}
    return piece_constants() + defined(numbers) + c_tables(tables)


def piece_constants() -> str:
    """Constants of `pieces.c` and of the mesh."""
    nodes, weights = gauss_rule()
    numbers = {
        "QUADRATURE": len(nodes),
        "INWARDS": INWARDS,
        "DETAIL_PER_ELEMENT": DETAIL_PER_ELEMENT,
        "TWIST_PER_ELEMENT": TWIST_PER_ELEMENT,
        "KNOWN": KNOWN,
    }
    tables = {"SAMPLES": SAMPLES, "QUADRATURE_NODES": nodes, "QUADRATURE_WEIGHTS": weights}
    return defined(numbers) + c_tables(tables)


def slope_constants() -> str:
    """Tables of `change.c`.

    They are the twice integrated collocated equations and the shape points with their slopes at the collocation points,
    and the integrated Lagrange basis at the shape points.
    """
    fine = tableau("gauss", DEGREE)
    return c_tables(
        {
            "TWICE_INSIDE": fine.matrix @ fine.adjoint,
            "POSE_INSIDE": hermite(fine.family, fine.degree),
            "ONCE_UP_TO": fine.lagrange(ENDS, integrals=1),
        }
    )


def friction_constants() -> str:
    """Constants and tables of `friction.c`."""
    numbers = {
        "LEAST_CAPACITY": LEAST_CAPACITY,
        "MOST_CHANGES": BOX_CHANGES,
        "HARDLY": SLIP_ROUND_OFF,
        "HONEST": FRICTION_TOLERANCE,
        "FRICTION_ITERATIONS": FRICTION_ITERATIONS,
        "ONWARD": ONWARD,
        "LARGEST_RATIO": LARGEST_RATIO,
        "LARGEST_TWIST": LARGEST_TWIST,
        "SOFT_TWIST": SOFT_TWIST,
    }
    tables = {f"{name}_LEGENDRE": tableau("gauss", DEGREE).integrated(k) for k, name in ((1, "ONCE"), (2, "TWICE"))}
    return defined(numbers) + c_tables(tables)
