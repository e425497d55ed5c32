"""From a solved point to the plain `Equilibrium`, and back."""

from __future__ import annotations

import time
from functools import lru_cache
from typing import Any

import numpy as np

from ..block.transcription import arm as arms
from ..block.transcription.arm import ArmSolution, between
from ..block.transcription.collocated import STEPS, THROUGH_ENDS
from ..block.transcription.loaded import LoadedProblem, monotonicity
from ..block.transcription.reduced import ReducedProblem
from ..robots.assembly import ROUND_OFF
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.settings import LARGEST_SHIFT
from ..typing import Array
from .member import Loaded, Member, Place, Point, Unloaded
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

# The shape of one piece of a tube is integrated with an error that is a fraction of the piece, not of the arm.
SHORT = 0.01
"""Length (m) over which the tip of tubes made of pieces is right: to 1e-10 m where 1e-8 is asked for."""

FOLDED = "the equilibrium is a fold (margin 0): it has no solution close by that Newton can find"


def to_equilibrium(point: Place, start: str, began: float = 0.0) -> Equilibrium:
    """The equilibrium of a solved point; `start`: how it was reached; `began`: when (s), 0 where that is not known."""
    return answered(point.member, point.member.found(point), start, began)


def answered(
    member: Member[Any], result: ArmSolution, start: str, began: float = 0.0, method: str = "newton"
) -> Equilibrium:
    """The equilibrium of a problem as a solver found it."""
    mesh = member.torsion.mesh
    statistics = Statistics(
        method=method,
        iterations=result.iterations,
        elements=int(mesh.collocated.sum()),
        degree=mesh.tableau.degree,
        start=start,
        seconds=time.perf_counter() - began if began else 0.0,
        family=mesh.tableau.family,
        refinement=member.discretisation.refinement,
    )
    return built(member.robot, (member.rotations, np.array(member.translations)), result, statistics, member.load)


def built(
    robot: Robot,
    joints: tuple[Array, Array],
    result: ArmSolution,
    statistics: Statistics,
    load: Load | None = None,
) -> Equilibrium:
    """The equilibrium of a robot at joint values as a solver found it."""
    equilibrium = Equilibrium(
        robot=robot,
        rotations=joints[0],
        translations=joints[1],
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
    if result.base_wrench is not None:
        vars(equilibrium)["base_wrench"] = result.base_wrench
    if result.compliance is not None:
        vars(equilibrium)["compliance"] = result.compliance
    return equilibrium


def error_of(equilibrium: Equilibrium) -> float:
    """`largest_error` of an equilibrium; under a load by the whole length of the arm."""
    even = equilibrium.load is not None or equilibrium.robot.even
    length = float(equilibrium.arc_length[-1])
    return float(largest_error(equilibrium.mesh_error, equilibrium.tip_error, length, even=even))


def largest_error(theta: Any, tip: Any, length: Any, *, even: bool = True) -> Any:
    """Estimated error of theta, rad, or of the tip, m, as a fraction of the arm's length, m, whichever is larger; where
    tubes are not `even`, as a fraction of at most SHORT."""
    # Numbers are compared by Python: NumPy takes longer for one than the kernel for a piece.
    least, most = (min, max) if isinstance(tip, float) else (np.minimum, np.maximum)
    by = most(length, 1e-300)
    return most(theta, tip / (by if even else least(by, SHORT)))


# --- and back ---------------------------------------------------------------------------------------------------------


def point_of(equilibrium: Equilibrium, load: Load | None = None, discretisation: Discretisation | None = None) -> Place:
    """The solved point behind an equilibrium; arguments as of `unsolved`.

    Raises:
        InputError: the equilibrium bears friction, or its robot no load.
        SolveError: Newton's method does not stay there: it is a fold.
    """
    member, x = unsolved(equilibrium, load, discretisation)
    return Point.near(member, x, FOLDED)


def unsolved(
    equilibrium: Equilibrium, load: Load | None = None, discretisation: Discretisation | None = None
) -> tuple[Member[Any], Array]:
    """The problem behind an equilibrium, and its unknowns as they were solved for.

    Args:
        load: one that grows from an equilibrium without a load, of which it bears none yet.
        discretisation: of an equilibrium without a load; by default the usual one. One under a load keeps its mesh.
    """
    refuse_friction(equilibrium)
    robot, rotations, shift = equilibrium.robot, equilibrium.rotations, tuple(equilibrium.translations.tolist())
    member: Member[Any]
    if equilibrium.load is not None:
        own = discretisation_of(equilibrium)
        member = Loaded(robot, _own(equilibrium), rotations, shift, own)
        theta = sample_rotation(equilibrium, equilibrium.point)
        return member, member.unknowns(theta, equilibrium.point_curvature)
    if load is None:
        member = Unloaded.of(robot, rotations, shift, discretisation or DEFAULT_DISCRETISATION)
    else:
        check_load(robot, load, shift)
        member = Loaded.of(robot, rotations, shift, load, discretisation or LOADED_DISCRETISATION, 0.0)
    return member, member.unknowns(sample_rotation(equilibrium, member.torsion.arc_length))


def _own(equilibrium: Equilibrium) -> LoadedProblem:
    """The problem of a loaded equilibrium, on the mesh on which it was solved: perhaps that of a larger load."""
    robot, shift, load = equilibrium.robot, tuple(equilibrium.translations.tolist()), equilibrium.load
    assert load is not None
    start, d = loading_of(robot, shift, load)[0].start, discretisation_of(equilibrium)
    points = np.bincount(np.searchsorted(start, equilibrium.point, side="right") - 1, minlength=len(start))
    return loaded_problem(robot, shift, load, d, tuple((points // d.degree).tolist()))


def collocated(equilibrium: Equilibrium) -> tuple[ReducedProblem, arms.Profile]:
    """The problem that an equilibrium without a load solves, on its own mesh, and the torsion along its arm."""
    refuse_load(equilibrium)
    point = point_of(equilibrium, discretisation=discretisation_of(equilibrium))
    return point.member.problem, point.torsion


def linearised(equilibrium: Equilibrium) -> Array:
    """(U, U) the linearised equations behind an equilibrium without a load, on its own mesh, as it was solved."""
    refuse_load(equilibrium)
    member, x = unsolved(equilibrium, discretisation=discretisation_of(equilibrium))
    return np.asarray(member.at(x).hessian)


def sure_margin(equilibrium: Equilibrium) -> float:
    """What the linearised equations have of the elastic form in all directions: the margin, or under a load without an
    energy the least eigenvalue of their symmetric part. Above 0 there is no other equilibrium close by."""
    if equilibrium.load is None or equilibrium.load.has_energy:
        return min(equilibrium.margin, 1.0)
    member, x = unsolved(equilibrium)
    return monotonicity(member.problem, member.at(x))


def at_points(start: Equilibrium, problem: LoadedProblem) -> tuple[Array, Array | None]:
    """Rotations (N, n) without the natural turn, and curvature (N, 2), of an equilibrium at the points of a problem;
    without a load the curvature is None."""
    s, curvature = problem.torsion.arc_length, None
    if start.load is not None:
        near = LARGEST_SHIFT * start.arc_length[-1]
        if len(s) == len(start.point) and np.abs(s - start.point).max() <= near:
            s, curvature = start.point, start.point_curvature
        else:
            curvature = _own(start).mesh.interpolated(start.point_curvature, s)
    return sample_rotation(start, s), curvature


def discretisation_of(equilibrium: Equilibrium) -> Discretisation:
    """The discretisation on which an equilibrium was solved."""
    how = equilibrium.statistics
    return _discretisation(how.family, how.degree, how.refinement)


_discretisation = lru_cache(maxsize=64)(Discretisation)


def sample_rotation(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """theta (len(arc_length), n) of an equilibrium: as solved at its own collocation points, else cubic Hermite; phi
    where a tube is made of pieces."""
    own, robot, shift = equilibrium.point, equilibrium.robot, equilibrium.translations
    if len(own) != len(arc_length) or np.abs(own - arc_length).max(initial=0.0) > ROUND_OFF:
        arm = np.stack([equilibrium.rotation.T, equilibrium.torsion.T])
        return sample_arms(robot, shift, equilibrium.arc_length, arm, arc_length)
    theta = equilibrium.point_rotation
    return theta if robot.even else theta - assembly_of(robot, tuple(shift.tolist())).wound(arc_length)


def sample_arms(robot: Robot, translations: Array, s: Array, arms: Array, arc_length: Array) -> Array:
    """The same (..., len(arc_length), n) of arms (..., 2, m, n), rotation and torsion at arc lengths s (m,)."""
    rotation, torsion = arms[..., 0, :, :], arms[..., 1, :, :]
    even = robot.even
    phi = rotation if even else rotation - robot.assembly(translations).wound(s)
    if len(s) < 2:
        return np.repeat(phi, len(arc_length), axis=-2)
    if not even:
        # The polynomial through the shape points of each piece: its rate jumps between.
        piece, _, x = between(s[::STEPS], arc_length)
        basis = np.vander(np.clip(x, 0.0, 1.0), STEPS + 1, increasing=True) @ THROUGH_ENDS
        around = phi[..., piece[:, None] * STEPS + np.arange(STEPS + 1), :]
        return np.asarray(np.einsum("ak,...aki->...ai", basis, around))
    k, length, fraction = between(s, arc_length)
    h, x = length[:, None], np.clip(fraction, 0.0, 1.0)[:, None]
    value = rotation[..., k, :] * ((1 + 2 * x) * (1 - x) ** 2) + rotation[..., k + 1, :] * (x**2 * (3 - 2 * x))
    value += h * (torsion[..., k, :] * (x * (1 - x) ** 2) - torsion[..., k + 1, :] * (x**2 * (1 - x)))
    return np.asarray(value)
