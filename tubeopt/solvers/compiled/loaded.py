"""Compiled kernel of arms under load, on NumPy arrays.

CasADi generates its mechanics, the functions of cross-sections and quaternions. Linear algebra, sweeps along the arm,
Newton's method and continuation are written in C.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...block.transcription.arm import ArmSolution, CollocationPoints, Errors
from ...block.transcription.collocated import ENDS, SHAPE_STEPS
from ...block.transcription.loaded import LoadedProblem
from ...block.transcription.mesh import sections_at
from ...block.transcription.tableau import tableau
from ...physics.shape import rotation_matrix_function, tangent_forms, world_turns
from ...physics.torsion import section_functions
from ...robots.lengthwise import CrossSections
from ...typing import Array, Mask
from ..settings import (
    HARDLY_SOFTENED,
    LARGEST_RATIO,
    LARGEST_TWIST,
    LAST_STEP,
    LEAST_STIFFNESS,
    NEWTON,
    NEWTON_ROUND_OFF,
    SHORTEST_LOAD_STEP,
    SOFT_TWIST,
)
from ..time_limit import check_time
from .binding import address, memory_of
from .library import Kernel, copied_shape, load_kernel
from .text import c_tables, c_text

DEGREE, ROUGH_DEGREE, CHECK_DEGREE, MOST_PIECES, MOST_TUBES = 7, 3, 8, 24, 6
"""Points per piece of the solution, of the continuation in the load, and of the check; largest numbers of pieces and
tubes. The general solver solves other arms."""

SOLVED = 0


def loaded_source(n: int) -> str:
    """C text of the kernel for n concentric tubes under load."""
    return loaded_text(n, ca.CodeGenerator("mechanics.c"))


def loaded_text(n: int, generator: ca.CodeGenerator, pieces: int = MOST_PIECES) -> str:
    """`loaded_source` for up to `pieces` pieces of a mesh, with the functions already in `generator`."""
    generator.add(section_functions(n, False)["bending"])
    generator.add(rotation_matrix_function())
    defines = {
        "N": n,
        "DEGREE": DEGREE,
        "ROUGH_DEGREE": ROUGH_DEGREE,
        "CHECK_DEGREE": CHECK_DEGREE,
        "MOST_DEGREE": CHECK_DEGREE,
        "MOST_PIECES": pieces,
        "STEPS": SHAPE_STEPS,
        "ROUND_OFF": NEWTON_ROUND_OFF,
        "LAST_STEP": LAST_STEP,
        "MOST_ITERATIONS": NEWTON.iterations,
        "LARGEST_RATIO": LARGEST_RATIO,
        "LARGEST_TWIST": LARGEST_TWIST,
        "SOFT_TWIST": SOFT_TWIST,
        "SHORTEST_LOAD_STEP": SHORTEST_LOAD_STEP,
        "LEAST_STIFFNESS": LEAST_STIFFNESS,
        "HARDLY_SOFTENED": HARDLY_SOFTENED,
    }
    tables = {"TANGENT": tangent_forms(), "TURN": world_turns()}
    braces = str.maketrans("[]", "{}")
    arrays = "".join(
        f"static const double {name}[3][4][4] = {str(table.tolist()).translate(braces)};\n"
        for name, table in tables.items()
    )
    return _rules() + arrays + c_text(defines, generator, "loaded.c")


def _rules() -> str:
    """Tables of the three rules, and the Lagrange basis of one rule at the points of another."""
    degrees = DEGREE, ROUGH_DEGREE, CHECK_DEGREE
    fine, rough, check = rules = [tableau("gauss", degree) for degree in degrees]
    tables: dict[str, Array] = {}
    for k, rule in enumerate(rules):
        parts = {"nodes": rule.nodes, "weights": rule.weights, "matrix": rule.matrix}
        parts |= {name: rule.lagrange(ENDS, integrals=i) for i, name in enumerate(("basis", "once", "twice"))}
        tables |= {f"RULE{k}_{name}": table for name, table in parts.items()}
    transfers = {"TO_ROUGH": (fine, rough), "TO_CHECK": (fine, check), "FROM_ROUGH": (rough, fine)}
    return c_tables(tables | {name: source.lagrange(to.nodes) for name, (source, to) in transfers.items()})


_POINTERS = (*("start", "length", "bent", "felt", "held", "at", "ends", "ends_twist", "force", "base_force"),)


_BY_RULE = ("at", "force", "base_force")
"""Pointers that differ between the rules."""


class _Problem(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_longlong) for name in ("pieces", "tip_tube")),
        ("whole", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in _POINTERS),
    )


class _Rules(ctypes.Structure):
    _fields_ = tuple((name, _Problem) for name in ("problem", "rough", "check"))


@dataclass(frozen=True)
class LoadedRules:
    """Problem on three quadrature rules with equal pieces."""

    problem: LoadedProblem
    """Rule of the solution."""
    rough: LoadedProblem
    """Rule with fewer points, for the continuation in the load."""
    check: LoadedProblem
    """Rule with more points, for the error estimate."""


def _answer(n: int) -> np.dtype[np.void]:
    """C struct Answer."""
    points, shape = MOST_PIECES * CHECK_DEGREE, MOST_PIECES * SHAPE_STEPS + 1
    names = ("margin", "residual", "theta_error", "tip_error", "margin_error", "energy", "work")
    fields: list[Any] = [(name, "f8") for name in names] + [("iterations", "i8")]
    fields += [("theta", "f8", (points, n)), ("curvature", "f8", (points, 2))]
    fields += [("compliance", "f8", (6, 6)), ("base_wrench", "f8", 6), ("arc_length", "f8", shape)]
    fields += [("rotation", "f8", (shape, n)), ("torsion", "f8", (shape, n)), ("bent", "f8", (shape, 2))]
    fields += [("position", "f8", (shape, 3)), ("frame", "f8", (shape, 3, 3))]
    return np.dtype(fields)


@lru_cache(maxsize=MOST_TUBES)
def _kernel(n: int) -> Kernel | None:
    kernel = load_kernel((n, "loaded"), lambda: loaded_source(n), _answer(n))
    if kernel is not None:
        pointer, functions = ctypes.c_void_p, kernel.functions
        functions.solve_loaded.argtypes = [*[pointer] * 5, ctypes.c_double, *[pointer] * 2]
        functions.solve_many_loaded.argtypes = [pointer, ctypes.c_longlong, *[pointer] * 9]
        functions.solve_many_loaded.restype = None
    return kernel


def _sections(at: CrossSections) -> Array:
    """Cross-sections (m, 5, n) as an array of the C struct Sections."""
    return np.stack((at.stiffness, at.moment, at.phase, 1 / at.torsional_stiffness, at.twist_angle), axis=1)


@lru_cache(maxsize=64)
def _structure(rules: LoadedRules) -> Any:
    """C struct Rules; `keep` holds the memory that it points into."""
    problems, tip = (rules.problem, rules.rough, rules.check), rules.problem.tip_tube
    torsion, length = rules.problem.torsion, rules.problem.torsion.assembly.total_length
    mesh, ends = torsion.mesh, sections_at(torsion.assembly, torsion.mesh, ENDS)
    bent = torsion.unknown[mesh.section]
    # The twist of a tube matters up to its last bent piece; that of the tip tube matters up to the tip.
    felt = np.logical_or.accumulate(bent[::-1], axis=0)[::-1]
    felt[:, tip] = True
    # Data of all rules, then of each rule.
    shared = {
        "start": mesh.start,
        "length": mesh.length,
        "bent": bent,
        "felt": felt,
        "held": torsion.compliant.transmission,
        "ends": _sections(ends),
        "ends_twist": ends.twist,
    }
    arrays = list(shared.values())
    for problem in problems:
        arrays += [_sections(problem.torsion.compliant.sections), problem.force, problem.base[:3]]
    # One piece of memory, since each address that NumPy returns takes a microsecond.
    memory = np.concatenate(arrays, axis=None, dtype=float)
    sizes = [8 * array.size for array in arrays]
    places = accumulate(sizes[:-1], initial=address(memory))
    common = dict(zip(shared, places, strict=False))
    parts = [
        _Problem(len(mesh.length), tip, length, **common, **dict(zip(_BY_RULE, places, strict=False))) for _ in problems
    ]
    out: Any = _Rules(*parts)
    out.keep = memory
    return out


def _usable(rules: LoadedRules) -> Kernel | None:
    """Kernel that can solve a problem; None without one."""
    problem = rules.problem
    check_time()
    n, mesh = problem.torsion.assembly.n_tubes, problem.mesh
    fits = n <= MOST_TUBES and len(mesh.length) <= MOST_PIECES and mesh.tableau.degree == DEGREE
    return _kernel(n) if fits and problem.load.has_energy and mesh.tableau.family == "gauss" else None


def solve_loaded_compiled(
    rules: LoadedRules, joints: tuple[Array, Array], start: tuple[Array, Array | None], margin: float
) -> ArmSolution | None:
    """Stable equilibrium under a dead load.

    None if there is no kernel, or if it finds no stable equilibrium: the branch ends, or no equilibrium is close by.

    Args:
        joints: rotations (n,), and their change from those of the start.
        start: rotations (N, n) and curvature (N, 2) at the points of an equilibrium close by; None for the curvature
            is a start without load, from which the load grows.
        margin: margin of the start.
    """
    problem, kernel = rules.problem, _usable(rules)
    if kernel is None:
        return None
    workspace, n = memory_of(kernel), problem.torsion.assembly.n_tubes
    theta, curvature = start
    memory = np.concatenate([*joints, theta.ravel(), *([] if curvature is None else [curvature.ravel()])])
    at = address(memory)
    status = kernel.functions.solve_loaded(
        ctypes.byref(_structure(rules)),
        at,
        at + 8 * n,
        at + 16 * n,
        None if curvature is None else at + 8 * (2 * n + theta.size),
        margin,
        *workspace.addresses,
    )
    return _solution(workspace.answer(), problem) if status == SOLVED else None


class ManySolved(NamedTuple):
    """Equilibria under load at M rotations."""

    table: Array
    """Rows (M, 18 + n) of tip position (3), tip frame by rows (9), tip rotations (n), and six numbers.

    The numbers are margin, residual, error of theta, error of the tip, energy, and error of the margin.
    """
    compliance: Array
    """Compliances (M, 6, 6) of the tip."""
    unsolved: Mask
    """Rows (M,) that the kernel did not solve."""


def solve_many_loaded_compiled(
    rules: LoadedRules, rotations: Array, starts: tuple[Array, Array], ends: NDArray[np.int64]
) -> ManySolved | None:
    """Stable equilibria at rotations (M, n) under a dead load that grows from 0; None without a kernel.

    Args:
        starts: rotations (M, N, n) without load at the points, and margins (M,).
        ends: numbers (n,) of the points of the arm at which tubes end.
    """
    kernel, count = _usable(rules), len(rotations)
    if kernel is None:
        return None
    inputs = [np.ascontiguousarray(a, dtype=float) for a in (rotations, *starts)]
    table, compliance = np.zeros((count, 18 + rotations.shape[1])), np.zeros((count, 6, 6))
    unsolved = np.zeros(count, dtype=np.uint8)
    addresses = (address(a) for a in (*inputs, ends, table, compliance, unsolved))
    workspace = memory_of(kernel).addresses
    kernel.functions.solve_many_loaded(ctypes.byref(_structure(rules)), count, *addresses, *workspace)
    return ManySolved(table, compliance, unsolved.astype(bool))


def _solution(answer: dict[str, Any], problem: LoadedProblem) -> ArmSolution:
    """Copy of the solution in an answer."""
    torsion, points, m = problem.torsion, len(problem.torsion.weight), SHAPE_STEPS * len(problem.mesh.length) + 1
    theta, curvature = answer["theta"][:points] + problem.twist_angle, answer["curvature"][:points].copy()
    return ArmSolution.of(
        copied_shape(answer, m, "bent"),
        torsion.assembly,
        points=CollocationPoints(torsion.arc_length, theta, curvature),
        margin=answer["margin"],
        energy=answer["energy"],
        residual=answer["residual"],
        errors=Errors(answer["theta_error"], answer["tip_error"], answer["margin_error"]),
        iterations=answer["iterations"],
        work=answer["work"],
        compliance=answer["compliance"].copy(),
        base_wrench=answer["base_wrench"].copy(),
    )
