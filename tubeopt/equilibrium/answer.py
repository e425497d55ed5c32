"""Conversion of solved points to plain `Equilibrium` objects, and back."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.arm import ArmSolution, between
from ..block.transcription.collocated import SHAPE_STEPS, THROUGH_ENDS
from ..block.transcription.loaded import LoadedProblem, monotonicity
from ..block.transcription.reduced import ReducedProblem
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.settings import LARGEST_SHIFT
from ..typing import Array
from .bundle import bundle_unsolved
from .member import AnyPoint, Loaded, Member, Point, Unloaded
from .problem import (
    DEFAULT_DISCRETISATION,
    LOADED_DISCRETISATION,
    Discretisation,
    assembly_of,
    check_load,
    loaded_problem,
    loading_of,
)
from .result import Accuracy, Equilibrium, Statistics, Status, refuse_friction, refuse_load

# The error of the shape is a fraction of the length of a piece of a tube, not of the arm.
SHORT = 0.01
"""Reference length (m) of the tip error of tubes made of pieces: 1e-10 m at the default tolerance."""

FOLDED = "the equilibrium is a fold (margin 0): it has no solution close by that Newton can find"


def to_equilibrium(point: AnyPoint, start: str, start_time: float = 0.0) -> Equilibrium:
    """Equilibrium of a solved point.

    Args:
        start: what it was solved from.   began: start of the clock, s; 0 if unknown.
    """
    return equilibrium_of(point.member, point.member.solution(point), start, start_time)


def equilibrium_of(
    member: Member[Any], result: ArmSolution, start: str, start_time: float = 0.0, method: str = "newton"
) -> Equilibrium:
    """Equilibrium of a problem from the solution of a solver."""
    mesh = member.problem.mesh
    statistics = Statistics(
        method=method,
        iterations=result.iterations,
        elements=int(mesh.collocated.sum()),
        degree=mesh.tableau.degree,
        start=start,
        seconds=time.perf_counter() - start_time if start_time else 0.0,
        family=mesh.tableau.family,
        refinement=member.discretisation.refinement,
    )
    translations = np.array(member.translations)
    return build_equilibrium(member.robot, member.rotations, translations, result, statistics, load=member.load)


def build_equilibrium(
    robot: Robot,
    rotations: Array,
    translations: Array,
    result: ArmSolution,
    statistics: Statistics,
    *,
    load: Load | None = None,
) -> Equilibrium:
    """Equilibrium of a robot at joint values from the solution of a solver."""
    equilibrium = Equilibrium(
        robot=robot,
        rotations=rotations,
        translations=translations,
        arm=result.arm,
        tip_rotations=result.tip_rotations,
        section_start=result.section_start,
        tube_end=result.tube_end,
        points=result.points,
        margin=result.margin,
        index=result.index,
        energy=result.energy,
        accuracy=Accuracy(result.residual, *result.errors[:2]),
        status=Status.STABLE if result.margin > 0 else Status.UNSTABLE,
        statistics=statistics,
        load=load,
        work=result.work,
    )
    # The solver has these already: they need not be computed on first access.
    if result.base_wrench is not None:
        vars(equilibrium)["base_wrench"] = result.base_wrench
    if result.compliance is not None:
        vars(equilibrium)["compliance"] = result.compliance
    return equilibrium


def error_of(equilibrium: Equilibrium) -> float:
    """Estimated error of an equilibrium, as in `largest_error`; under a load relative to the whole arm."""
    even = equilibrium.load is not None or equilibrium.robot.even
    length = float(equilibrium.arc_length[-1])
    return float(largest_error(equilibrium.mesh_error, equilibrium.tip_error, length, even=even))


def largest_error(theta: Any, tip: Any, length: Any, *, even: bool = True) -> Any:
    """Larger one of the estimated errors of theta, rad, and of the tip relative to the length of the arm.

    For tubes made of pieces (not `even`), relative to at most SHORT. Arguments are numbers or arrays.
    """
    # Numbers are compared by Python: NumPy takes longer for one than the kernel for a piece.
    minimum, maximum = (min, max) if isinstance(tip, float) else (np.minimum, np.maximum)
    scale = maximum(length, 1e-300)
    return maximum(theta, tip / (scale if even else minimum(scale, SHORT)))


# --- From an equilibrium to its problem -------------------------------------------------------------------------------


def point_of(
    equilibrium: Equilibrium, load: Load | None = None, discretisation: Discretisation | None = None
) -> AnyPoint:
    """Solved point of an equilibrium; arguments as of `unsolved`.

    Raises:
        InputError: an equilibrium with friction, or a load on a robot that cannot be loaded.
        SolveError: Newton's method does not converge, as at a fold.
    """
    member, x = unsolved(equilibrium, load, discretisation)
    return Point.near(member, x, FOLDED)


def unsolved(
    equilibrium: Equilibrium, load: Load | None = None, discretisation: Discretisation | None = None
) -> tuple[Member[Any], Array]:
    """Problem of an equilibrium, and its unknowns as they were solved for.

    Args:
        load: load that will grow on an unloaded equilibrium; its factor is still 0.
        discretisation: mesh of an unloaded equilibrium, or the default. A loaded one keeps its mesh.
    """
    refuse_friction(equilibrium)
    robot, rotations, shift = equilibrium.robot, equilibrium.rotations, tuple(equilibrium.translations.tolist())
    if not robot.fixed_sections:
        return bundle_unsolved(equilibrium, load, discretisation)
    member: Member[Any]
    if equilibrium.load is not None:
        member = Loaded(robot, _loaded_problem_of(equilibrium), rotations, shift, discretisation_of(equilibrium))
        theta = sample_rotation(equilibrium, equilibrium.point)
        return member, member.unknowns(theta, equilibrium.point_curvature)
    if load is None:
        member = Unloaded.of(robot, rotations, shift, discretisation or DEFAULT_DISCRETISATION)
    else:
        check_load(robot, load, shift)
        member = Loaded.of(robot, rotations, shift, load, discretisation or LOADED_DISCRETISATION, 0.0)
    return member, member.unknowns(sample_rotation(equilibrium, member.torsion.arc_length))


def _loaded_problem_of(equilibrium: Equilibrium) -> LoadedProblem:
    """Problem of a loaded equilibrium on its own mesh, possibly refined for a larger load."""
    robot, shift, load = equilibrium.robot, tuple(equilibrium.translations.tolist()), equilibrium.load
    assert load is not None
    start, d = loading_of(robot, shift, load)[0].start, discretisation_of(equilibrium)
    points = np.bincount(np.searchsorted(start, equilibrium.point, side="right") - 1, minlength=len(start))
    return loaded_problem(robot, shift, load, d, tuple((points // d.degree).tolist()))


def collocated(equilibrium: Equilibrium) -> tuple[ReducedProblem, arms.Profile]:
    """Problem of an unloaded equilibrium on its own mesh, and the torsion along its arm."""
    refuse_load(equilibrium)
    point = point_of(equilibrium, discretisation=discretisation_of(equilibrium))
    return point.member.problem, point.torsion


def linearised(equilibrium: Equilibrium) -> Array:
    """(U, U) Jacobian of the equations of an unloaded equilibrium on its own mesh."""
    refuse_load(equilibrium)
    member, x = unsolved(equilibrium, discretisation=discretisation_of(equilibrium))
    return np.asarray(member.at(x).hessian)


def sure_margin(equilibrium: Equilibrium) -> float:
    """Lower bound of the linearised equations relative to the elastic form, at most 1.

    The margin, or under a load without an energy the smallest eigenvalue of their symmetric part. Above 0 there is no
    other equilibrium close by.
    """
    if equilibrium.load is None or equilibrium.load.has_energy:
        return min(equilibrium.margin, 1.0)
    member, x = unsolved(equilibrium)
    return monotonicity(member.problem, member.at(x))


def at_points(start: Equilibrium, problem: LoadedProblem) -> tuple[Array, Array | None]:
    """Elastic rotations (N, n) and curvature (N, 2) of an equilibrium at the points of a problem.

    The curvature is None without a load.
    """
    s, curvature = problem.torsion.arc_length, None
    if start.load is not None:
        tolerance = LARGEST_SHIFT * start.arc_length[-1]
        if len(s) == len(start.point) and np.abs(s - start.point).max() <= tolerance:
            s, curvature = start.point, start.point_curvature
        else:
            curvature = _loaded_problem_of(start).mesh.interpolated(start.point_curvature, s)
    return sample_rotation(start, s), curvature


def discretisation_of(equilibrium: Equilibrium) -> Discretisation:
    """Discretisation that an equilibrium was solved on."""
    statistics = equilibrium.statistics
    return _discretisation(statistics.family, statistics.degree, statistics.refinement)


_discretisation = lru_cache(maxsize=64)(Discretisation)


def sample_rotation(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """(N, n) rotations theta of an equilibrium at arc lengths (N,), rad; phi for tubes made of pieces.

    As solved at its own collocation points, interpolated by cubic Hermite polynomials elsewhere.
    """
    points, robot, shift = equilibrium.point, equilibrium.robot, equilibrium.translations
    if len(points) != len(arc_length) or np.abs(points - arc_length).max(initial=0.0) > LENGTH_ROUND_OFF:
        arm = np.stack([equilibrium.rotation.T, equilibrium.torsion.T])
        return sample_arms(robot, shift, equilibrium.arc_length, arm, arc_length)
    theta = equilibrium.point_rotation
    return theta if robot.even else theta - assembly_of(robot, tuple(shift.tolist())).wound(arc_length)


def sample_arms(robot: Robot, translations: Array, s: Array, arms: Array, arc_length: Array) -> Array:
    """(..., N, n) theta or phi at arc lengths (N,) of arms (..., 2, m, n), rotation and torsion at s (m,)."""
    rotation, torsion = arms[..., 0, :, :], arms[..., 1, :, :]
    even = robot.even
    phi = rotation if even else rotation - robot.assembly(translations).wound(s)
    if len(s) < 2:
        return np.repeat(phi, len(arc_length), axis=-2)
    if not even:
        # The polynomial through the shape points of each piece: the torsion jumps between pieces.
        piece, _, x = between(s[::SHAPE_STEPS], arc_length)
        basis = np.vander(np.clip(x, 0.0, 1.0), SHAPE_STEPS + 1, increasing=True) @ THROUGH_ENDS
        around = phi[..., piece[:, None] * SHAPE_STEPS + np.arange(SHAPE_STEPS + 1), :]
        return np.asarray(np.einsum("ak,...aki->...ai", basis, around))
    k, length, fraction = between(s, arc_length)
    h, x = length[:, None], np.clip(fraction, 0.0, 1.0)[:, None]
    value = rotation[..., k, :] * ((1 + 2 * x) * (1 - x) ** 2) + rotation[..., k + 1, :] * (x**2 * (3 - 2 * x))
    value += h * (torsion[..., k, :] * (x * (1 - x) ** 2) - torsion[..., k + 1, :] * (x**2 * (1 - x)))
    return np.asarray(value)
