"""Compiled kernel of bundles without a load, on NumPy arrays."""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ...block.transcription.arm import ArmSolution, CollocationPoints, Errors, gauss_fractions
from ...block.transcription.bundle import (
    CLOSING,
    FELT,
    FINER,
    HELD,
    SAME_PLACE,
    TO_BOUNDARY,
    VANISHING,
    Bundle,
    boundaries,
)
from ...block.transcription.collocated import ENDS, SHAPE_STEPS
from ...block.transcription.mesh import BEND_PER_ELEMENT, WAVES_PER_ELEMENT
from ...block.transcription.tableau import tableau
from ...physics.certificate import coupling_rate_function
from ...physics.shape import carry_function
from ...physics.torsion import bundle_energy
from ...typing import Array
from ..settings import (
    LARGEST_EXCHANGE,
    LARGEST_RATIO,
    LARGEST_TWIST,
    LAST_STEP,
    LEAST_STIFFNESS,
    LONGEST_STEP,
    NEWTON,
    NEWTON_ROUND_OFF,
    SOFT_TWIST,
)
from ..time_limit import check_time
from .binding import SOLVED, Solved, address, memory_of
from .constants import DEGREE
from .library import MOST_PIECES, Kernel, copied_shape, load_kernel
from .text import c_tables, c_text

MOST_TUBES = 9
"""Largest number of tubes in the kernel: those of three segments."""

CHECK_DEGREE = DEGREE + 1
"""Collocation points per element for the error estimate."""


def bundle_source(n: int) -> str:
    """C text of the kernel for a bundle of n tubes."""
    generator = ca.CodeGenerator("mechanics.c")
    generator.add(bundle_energy(n))
    generator.add(carry_function())
    generator.add(coupling_rate_function(n))
    constants = {
        "N": n,
        "DEGREE": DEGREE,
        "CHECK_DEGREE": CHECK_DEGREE,
        "MOST_PIECES": MOST_PIECES,
        "STEPS": SHAPE_STEPS,
        "MOST_ITERATIONS": NEWTON.descent_iterations,
        "ROUND_OFF": NEWTON_ROUND_OFF,
        "LAST_STEP": LAST_STEP,
        "LONGEST_STEP": LONGEST_STEP,
        "LARGEST_RATIO": LARGEST_RATIO,
        "LARGEST_TWIST": LARGEST_TWIST,
        "LARGEST_EXCHANGE": LARGEST_EXCHANGE,
        "SOFT_TWIST": SOFT_TWIST,
        "LEAST_STIFFNESS": LEAST_STIFFNESS,
        "WAVES_PER_ELEMENT": WAVES_PER_ELEMENT / FINER,
        "BEND_PER_ELEMENT": BEND_PER_ELEMENT / FINER,
        "HELD": HELD,
        "FELT": FELT,
        "SAME_PLACE": SAME_PLACE,
        "CLOSING": CLOSING,
        "VANISHING": VANISHING,
        "TO_BOUNDARY": TO_BOUNDARY,
    }
    return _rules() + c_text(constants, generator, "bundle.c")


def _rules() -> str:
    """Tables of the rules of the solution and of the check, and of the transfer between them."""
    fine, check = rules = [tableau("gauss", degree) for degree in (DEGREE, CHECK_DEGREE)]
    tables: dict[str, Array] = {
        "TO_CHECK": fine.lagrange(check.nodes),
        "FROM_ROTATION": np.asarray(np.linalg.inv(fine.matrix)),
    }
    for k, rule in enumerate(rules):
        parts = {"nodes": rule.nodes, "weights": rule.weights, "matrix": rule.matrix}
        parts |= {"basis": rule.lagrange(ENDS), "once": rule.lagrange(ENDS, integrals=1)}
        parts["inside"] = rule.lagrange(gauss_fractions(SHAPE_STEPS))
        tables |= {f"RULE{k}_{name}": table for name, table in parts.items()}
    return c_tables(tables)


def _answer(n: int) -> np.dtype[np.void]:
    """C struct Answer."""
    points, shape = MOST_PIECES * CHECK_DEGREE, MOST_PIECES * SHAPE_STEPS + 1
    names = ("margin", "residual", "theta_error", "tip_error", "energy", "contraction", "largest_change")
    fields: list[Any] = [(name, "f8") for name in names]
    fields += [(name, "i8") for name in ("iterations", "pieces", "sections")]
    fields += [("section_start", "f8", 2 * n), ("tube_end", "f8", n), ("tip_rotations", "f8", n)]
    fields += [("point", "f8", points), ("theta", "f8", (points, n)), ("bent", "f8", (points, 2))]
    fields += [("arc_length", "f8", shape), ("rotation", "f8", (shape, n)), ("torsion", "f8", (shape, n))]
    fields += [("curvature", "f8", (shape, 2)), ("position", "f8", (shape, 3)), ("frame", "f8", (shape, 3, 3))]
    return np.dtype(fields)


@lru_cache(maxsize=MOST_TUBES)
def bundle_kernel(n: int) -> Kernel | None:
    kernel = load_kernel((n, "bundle"), lambda: bundle_source(n), _answer(n))
    if kernel is not None:
        pointer = ctypes.c_void_p
        kernel.functions.solve_bundle.argtypes = [*[pointer] * 3, ctypes.c_longlong, *[pointer] * 2]
    return kernel


@dataclass(frozen=True, eq=False)
class _Tubes:
    """C struct Tubes of a bundle."""

    memory: Array
    address: int


@lru_cache(maxsize=64)
def _tubes(bundle: Bundle) -> _Tubes:
    n = len(bundle.end)
    moment = bundle.bending_stiffness * bundle.curvature
    parts = [bundle.bending_stiffness, bundle.torsional_stiffness, moment, bundle.offset, bundle.angle]
    parts.append(np.where(bundle.transmission > SAME_PLACE, bundle.transmission, 0.0))
    found = boundaries(bundle)
    table = np.zeros((2 * n, 2 + 2 * n))
    for row, boundary in zip(table, found, strict=False):
        row[:2] = boundary.arc_length, boundary.tubes[0]
        row[[2 + i for i in boundary.ends]] = 1.0
        row[[2 + n + i for i in boundary.tubes if i not in boundary.ends]] = 1.0
    memory = np.concatenate([*parts, bundle.levers.ravel(), [bundle.sheath, len(found)], table.ravel()])
    return _Tubes(memory, address(memory))


class BundleStart(NamedTuple):
    """Start of a solve from another equilibrium of the same tubes, on collocation points of the kernel's degree."""

    ends: Array
    """Arc lengths (m,) of the ends of the sections, m."""
    point: Array
    """Arc lengths (N,) of the collocation points, m."""
    point_rotation: Array
    """Rotations (N, n) of the tubes at the points, rad."""
    point_curvature: Array
    """Curvature (N, 2) at the points, 1/m."""
    rotations: Array
    """Joint rotations (n,), rad."""
    twist: Array
    """Rotations (n,) at the plate beyond the joint rotations, rad."""
    shift: Array
    """Translations (n,) of the solve less those of the start, m."""


def _start(start: BundleStart) -> Array:
    """C struct Start."""
    n, sections = len(start.rotations), len(start.ends)
    first = start.point[::DEGREE]
    pieces = np.diff(np.searchsorted(first, start.ends), prepend=0)
    head = np.zeros(1 + 4 * n)
    head[0], head[1 : 1 + sections], head[1 + 2 * n : 1 + 2 * n + sections] = sections, start.ends, pieces
    parts = (head, start.rotations, start.twist, start.shift, start.point_rotation, start.point_curvature)
    return np.concatenate(parts, axis=None)


def solve_bundle_compiled(
    bundle: Bundle, rotations: Array, start: BundleStart | None = None, refinement: int = 0
) -> Solved | None:
    """Stable equilibrium of a bundle at rotations (n,), from tubes without torsion or from a start close by.

    None if the kernel does not solve it, or if there is no kernel.

    Args:
        refinement: number of times that the mesh is halved; with a start the mesh is that of the start.
    """
    check_time()
    start_time, n = time.perf_counter(), len(rotations)
    kernel = bundle_kernel(n) if n <= MOST_TUBES else None
    if kernel is None:
        return None
    loading, memory, alpha = time.perf_counter() - start_time, memory_of(kernel), np.array(rotations, dtype=float)
    near = None if start is None else _start(start)
    at = _tubes(bundle).address, address(alpha), None if near is None else address(near)
    status = kernel.functions.solve_bundle(*at, refinement, *memory.addresses)
    if status != SOLVED:
        return None
    answer = memory.answer()
    pieces = answer["pieces"]
    points, m = pieces * DEGREE, pieces * SHAPE_STEPS + 1
    solution = ArmSolution(
        copied_shape(answer, m),
        tip_rotations=answer["tip_rotations"].copy(),
        section_start=answer["section_start"][: answer["sections"]].copy(),
        tube_end=answer["tube_end"].copy(),
        points=CollocationPoints(*(answer[name][:points].copy() for name in ("point", "theta", "bent"))),
        margin=answer["margin"],
        energy=answer["energy"],
        residual=answer["residual"],
        errors=Errors(answer["theta_error"], answer["tip_error"], 0.0),
        iterations=answer["iterations"],
        base_wrench=np.zeros(6),
    )
    return Solved(solution, pieces, answer["largest_change"], answer["contraction"], loading)
