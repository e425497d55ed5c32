"""The compiled kernel of arms under load, on NumPy arrays.

Its mechanics are the functions of the cross-section and of quaternions that CasADi generates; by hand there are only
linear algebra, sweeps along the arm and the loops of Newton's method and of the continuation.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ...block.transcription.arm import ArmShape, ArmSolution, CollocationPoints
from ...block.transcription.collocated import ENDS, STEPS
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
    ROUND_OFF,
    SHORTEST_LOAD_STEP,
    SOFT_TWIST,
)
from ..time_limit import check_time
from .binding import address, room_of
from .library import Kernel, load_kernel
from .text import c_tables, c_text

DEGREE, ROUGH_DEGREE, CHECK_DEGREE, MOST_PIECES, MOST_TUBES = 7, 3, 8, 24, 6
"""Points per piece: of the answer, of the growing of the load, and of the check; and room of the kernel: other
arms go to the general solver."""

SOLVED = 0


def loaded_source(n: int) -> str:
    """The C text of the kernel for n concentric tubes under load."""
    return loaded_text(n, ca.CodeGenerator("mechanics.c"))


def loaded_text(n: int, generator: ca.CodeGenerator, pieces: int = MOST_PIECES) -> str:
    """The same with the functions that a generator has beside its own, and room for so many pieces of a mesh."""
    generator.add(section_functions(n, False)["bending"])
    generator.add(rotation_matrix_function())
    defines = {
        "N": n,
        "DEGREE": DEGREE,
        "ROUGH_DEGREE": ROUGH_DEGREE,
        "CHECK_DEGREE": CHECK_DEGREE,
        "MOST_DEGREE": CHECK_DEGREE,
        "MOST_PIECES": pieces,
        "STEPS": STEPS,
        "ROUND_OFF": ROUND_OFF,
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
    """The three rules, and what carries over between them: the Lagrange basis of one at the points of another."""
    degrees = DEGREE, ROUGH_DEGREE, CHECK_DEGREE
    whole, rough, check = rules = [tableau("gauss", degree) for degree in degrees]
    tables: dict[str, Array] = {}
    for k, rule in enumerate(rules):
        own = {"nodes": rule.nodes, "weights": rule.weights, "matrix": rule.matrix}
        own |= {name: rule.lagrange(ENDS, integrals=i) for i, name in enumerate(("basis", "once", "twice"))}
        tables |= {f"RULE{k}_{name}": table for name, table in own.items()}
    between = {"TO_ROUGH": (whole, rough), "TO_CHECK": (whole, check), "FROM_ROUGH": (rough, whole)}
    return c_tables(tables | {name: one.lagrange(other.nodes) for name, (one, other) in between.items()})


_POINTERS = (*("start", "length", "bent", "felt", "held", "at", "ends", "ends_twist", "force", "base_force"),)


_OWN = ("at", "force", "base_force")
"""What differs from rule to rule."""


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
    """One problem on three rules with the same pieces: that of the answer, with few points on which the load grows, and
    with more, which tell the error."""

    problem: LoadedProblem
    rough: LoadedProblem
    check: LoadedProblem


def _answer(n: int) -> np.dtype[np.void]:
    points, shape = MOST_PIECES * CHECK_DEGREE, MOST_PIECES * STEPS + 1
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
    """(m, 5, n) cross-sections as an array of the C struct Sections."""
    return np.stack((at.stiffness, at.moment, at.phase, 1 / at.torsional_stiffness, at.wound), axis=1)


@lru_cache(maxsize=64)
def _structure(rules: LoadedRules) -> Any:
    """The C struct Rules, and the memory that it points into as `keep`."""
    problems, tip = (rules.problem, rules.rough, rules.check), rules.problem.tip_tube
    torsion, length = rules.problem.torsion, rules.problem.torsion.assembly.total_length
    mesh, ends = torsion.mesh, sections_at(torsion.assembly, torsion.mesh, ENDS)
    bent = torsion.unknown[mesh.section]
    # The twist of a tube matters up to where it is bent for the last time, and to where it ends the arm.
    felt = np.logical_or.accumulate(bent[::-1], axis=0)[::-1]
    felt[:, tip] = True
    # What all rules share, then each rule's own.
    shared = {
        "start": mesh.start,
        "length": mesh.length,
        "bent": bent,
        "felt": felt,
        "held": torsion.here.transmission,
        "ends": _sections(ends),
        "ends_twist": ends.twist,
    }
    arrays = list(shared.values())
    for one in problems:
        arrays += [_sections(one.torsion.here.sections), one.force, one.base[:3]]
    # In one piece of memory, since asking NumPy for an address takes a microsecond.
    memory = np.concatenate(arrays, axis=None, dtype=float)
    sizes = [8 * array.size for array in arrays]
    places = accumulate(sizes[:-1], initial=address(memory))
    common = dict(zip(shared, places, strict=False))
    parts = [
        _Problem(len(mesh.length), tip, length, **common, **dict(zip(_OWN, places, strict=False))) for _ in problems
    ]
    out: Any = _Rules(*parts)
    out.keep = memory
    return out


def _usable(rules: LoadedRules) -> Kernel | None:
    """The kernel for a problem; None where there is none."""
    problem = rules.problem
    check_time()
    n, mesh = problem.torsion.assembly.n_tubes, problem.mesh
    fits = n <= MOST_TUBES and len(mesh.length) <= MOST_PIECES and mesh.tableau.degree == DEGREE
    return _kernel(n) if fits and problem.load.has_energy and mesh.tableau.family == "gauss" else None


def solve_loaded_compiled(
    rules: LoadedRules, joints: tuple[Array, Array], start: tuple[Array, Array | None], margin: float
) -> ArmSolution | None:
    """The stable equilibrium under a dead load.

    `joints`: rotations (n,), and their change from those of the start. `start`: rotations (N, n) and curvature (N, 2)
    at the points of an equilibrium close by, of the `margin`; without curvature it bears no load, and the load is to
    grow from there.

    None where there is no kernel, or it declines: nothing stable close by, a branch that ends.
    """
    problem, kernel = rules.problem, _usable(rules)
    if kernel is None:
        return None
    room, n = room_of(kernel), problem.torsion.assembly.n_tubes
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
        *room.at,
    )
    return _answered(room.answer(), problem) if status == SOLVED else None


def solve_many_loaded_compiled(
    rules: LoadedRules, rotations: Array, starts: tuple[Array, Array], ends: NDArray[np.int64]
) -> tuple[Array, Array, Mask] | None:
    """Stable equilibria at rotations (M, n) under a dead load that grows from nothing.

    `starts`: rotations (M, N, n) without load at the points, and margins (M,). `ends`: (n,) where tubes end among the
    points of the arm. A row for each with tip position (3), tip frame by rows (9), tip rotations (n), margin, residual,
    errors of theta and of the tip, energy and error of the margin; the compliances (M, 6, 6); (M,) which were declined.
    None where there is no kernel.
    """
    kernel, count = _usable(rules), len(rotations)
    if kernel is None:
        return None
    room = room_of(kernel)
    given = [np.ascontiguousarray(a, dtype=float) for a in (rotations, *starts)]
    summary, compliance = np.zeros((count, 18 + rotations.shape[1])), np.zeros((count, 6, 6))
    declined = np.zeros(count, dtype=np.uint8)
    places = (address(a) for a in (*given, ends, summary, compliance, declined))
    kernel.functions.solve_many_loaded(ctypes.byref(_structure(rules)), count, *places, *room.at)
    return summary, compliance, declined.astype(bool)


def _answered(answer: dict[str, Any], problem: LoadedProblem) -> ArmSolution:
    torsion, points, m = problem.torsion, len(problem.torsion.weight), STEPS * len(problem.mesh.length) + 1
    arm = ArmShape(
        arc_length=answer["arc_length"][:m].copy(),
        rotation=answer["rotation"][:m].T.copy(),
        torsion=answer["torsion"][:m].T.copy(),
        curvature=answer["bent"][:m].copy(),
        position=answer["position"][:m].copy(),
        frame=answer["frame"][:m].copy(),
    )
    theta, curvature = answer["theta"][:points] + problem.wound, answer["curvature"][:points].copy()
    return ArmSolution.of(
        arm,
        torsion.assembly,
        points=CollocationPoints(torsion.arc_length, theta, curvature),
        margin=answer["margin"],
        energy=answer["energy"],
        residual=answer["residual"],
        errors=(answer["theta_error"], answer["tip_error"], answer["margin_error"]),
        iterations=answer["iterations"],
        work=answer["work"],
        compliance=answer["compliance"].copy(),
        base_wrench=answer["base_wrench"].copy(),
    )
