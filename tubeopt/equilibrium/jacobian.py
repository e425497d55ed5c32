"""The Jacobian of an equilibrium: tip pose, tips of the tubes, margin and energy by joint values and dimensions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import scipy

from ..arguments import typed
from ..block.transcription.loaded import symmetric_part
from ..block.transcription.second_variation import modes
from ..errors import InputError, finite
from ..robots.assembly import DIMENSIONS, LENGTH_ROUND_OFF, Assembly
from ..robots.load import Load, PointLoad
from ..robots.order import SAME_END
from ..robots.robot import Robot, resized
from ..solvers.blas import small
from ..solvers.compiled.binding import (
    SAME_ARM,
    Carriages,
    Moved,
    Reach,
    Slopes,
    Start,
    Turn,
    kernel_of,
    motion_compiled,
    slopes_compiled,
    turn_compiled,
)
from ..typing import Array, Index
from .directions import PARAMETERS
from .kinematics import point_of
from .linearised import linearise, sharing
from .linearised_bundle import linearise_bundle
from .linearised_walls import linearise_among_walls
from .member import Loaded, LoadedPoint, discretisation_of
from .problem import DEFAULT_DISCRETISATION, loading_of
from .result import Derivatives, Equilibrium, Jacobian
from .wall_contact import at_walls, compliance_among_walls, solution_of

JOINTS = ("rotations", "translations")
"""Default parameters of a Jacobian."""

RELATIVE = ("curvature", "bending_stiffness", "torsional_stiffness")
"""Dimensions of which the kernel takes relative changes."""


def derivatives_of(
    equilibrium: Equilibrium,
    wrt: Sequence[str] = JOINTS,
    *,
    side: int = 1,
    carriages: Carriages | None = None,
) -> Derivatives:
    """Derivatives of an equilibrium, computed when they are read; by default with the `carriages` of the robot."""
    carriages = equilibrium.robot.moving_together if carriages is None else carriages
    along = sharing(carriages, tuple(wrt))
    if equilibrium.walls is not None and equilibrium.walls.contacts:
        return linearise_among_walls(equilibrium, wrt, side, along=along)
    if equilibrium.robot.fixed_sections:
        return linearise(equilibrium, wrt, side, along=along)
    return linearise_bundle(equilibrium, wrt, side, along=along)


def compiled_slopes(
    at: Equilibrium, sides: tuple[int, ...] | None = None, carriages: Carriages | None = None, **request: bool
) -> Slopes | None:
    """Derivatives of an equilibrium by the compiled kernel; None if it does not provide them, as for arms of length
    zero and for polynomials of another degree than its own.

    Translations move towards `sides` (n,), 1 where not given, and tubes of one of the `carriages` together; what is
    `request` are flags of `slopes_compiled`.
    """
    kernel = kernel_of(at.robot)
    if len(at.arc_length) < 2 or kernel is None or not kernel.differentiable:
        return None
    mesh = discretisation_of(at)
    if mesh != replace(DEFAULT_DISCRETISATION, refinement=mesh.refinement):
        return None
    sides = sides or (1,) * at.robot.n_tubes
    moved = Moved(sides, at.robot.moving_together if carriages is None else carriages)
    return slopes_compiled(at.robot, at.rotations, at.translations, _start_at(at), moved, mesh.refinement, **request)


def _start_at(at: Equilibrium) -> Start:
    """Start of a compiled solve at an equilibrium itself."""
    arm, points = at.arm, at.points
    along = arm.arc_length, arm.rotation, arm.torsion, points.point, points.point_rotation
    return Start(*along, np.zeros(at.robot.n_tubes), at.translations)


def compiled_turn(at: Equilibrium, *, most: float, precision: float) -> Turn | None:
    """Snap distance of an equilibrium without load, by the compiled kernel; None without a kernel.

    Args:
        most: largest turn that is searched, rad.   precision: relative precision of the turn.
    """
    known = _known_to_kernel(at)
    return None if known is None else turn_compiled(*known, most=most, precision=precision)


def compiled_motion(at: Equilibrium, turn: float, slide: float, *, most: float, precision: float) -> float | None:
    """Largest factor up to `most` on turns (rad) and slides (m) of all tubes that is proved to cause no snap.

    As `compiled_turn`; None also for tubes made of pieces.
    """
    known = _known_to_kernel(at)
    return None if known is None else motion_compiled(*known, Reach(turn, slide), most=most, precision=precision)


class _KnownPose(NamedTuple):
    """Equilibrium as the kernel takes it."""

    robot: Robot
    rotations: Array
    translations: Array
    start: Start
    refinement: int


def _known_to_kernel(at: Equilibrium) -> _KnownPose | None:
    """Pose of an equilibrium for the kernel; None if the kernel has another mesh."""
    mesh = discretisation_of(at)
    if len(at.arc_length) < 2 or replace(mesh, refinement=0) != DEFAULT_DISCRETISATION:
        return None
    return _KnownPose(at.robot, at.rotations, at.translations, _start_at(at), mesh.refinement)


def _by_kernel(
    equilibrium: Equilibrium, wrt: Sequence[str], side: int, carriages: Carriages | None = None
) -> Jacobian | None:
    """Jacobian of a stable equilibrium of concentric tubes, from the compiled kernel.

    None if the kernel has none, as under a load, or where it converges to another equilibrium.
    """
    robot, joints = equilibrium.robot, set(wrt) <= set(JOINTS)
    if equilibrium.load is not None or side not in (1, -1):
        return None
    scale = None if joints else _dimension_scale(robot, tuple(wrt))
    if not joints and scale is None:
        return None
    result = compiled_slopes(equilibrium, (side,) * robot.n_tubes, carriages, either=False, dimensions=not joints)
    if result is None or result.deviation > SAME_ARM:
        return None
    tables = result.position, result.turn, result.tip_rotations, result.margin, result.energy
    if tuple(wrt) == JOINTS:
        return Jacobian(JOINTS, *tables)
    n = robot.n_tubes
    table = np.empty((8 + n, 7 * n))
    table[:3, : 2 * n], table[3:6, : 2 * n], table[6:-2, : 2 * n], table[-2, : 2 * n], table[-1, : 2 * n] = tables
    if scale is not None and result.dimensions is not None:
        table[:, 2 * n :] = result.dimensions / scale
    table = table[:, _columns(tuple(wrt), n)]
    return Jacobian(tuple(wrt), table[:3], table[3:6], table[6:-2], table[-2], table[-1])


@lru_cache(maxsize=64)
def _columns(wrt: tuple[str, ...], n: int) -> Index:
    """Numbers (Q,) of the columns of `wrt` among n for each of PARAMETERS."""
    return np.array([PARAMETERS.index(name) * n + i for name in wrt for i in range(n)], dtype=np.intp)


@lru_cache(maxsize=64)
def _dimension_scale(robot: Robot, wrt: tuple[str, ...]) -> Array | None:
    """Values (5 n,) of dimensions by relative changes of which the kernel differentiates; 1 of others.

    None for other parameters, for tubes made of pieces, and for straight tubes that get a curvature or a curved part.
    """
    shapes = [name for name in ("curvature", "curved_length") if name in wrt]
    straight = not all(getattr(tube, name) for name in shapes for tube in robot.tubes)
    if straight or not robot.even or not set(wrt) <= set(PARAMETERS):
        return None
    scale = [getattr(tube, name) if name in RELATIVE else 1.0 for name in DIMENSIONS for tube in robot.tubes]
    return np.where(np.equal(scale, 0), 1.0, scale)


@typed
@small
def jacobian(equilibrium: Equilibrium, *, wrt: Sequence[str] = JOINTS, side: int = 1) -> Jacobian:
    """Derivatives of tip pose, tube tips, margin and energy of an equilibrium, by the implicit function theorem.

    Where breakpoints coincide (at home, for instance, every transition lies at the plate) a translation or a length
    changes the order of the sections, and the derivatives differ to either side.

    Contacts with walls stay closed; the derivative of the margin then takes two equilibria per column.

    Args:
        wrt: any of "rotations", "translations", "curvature", "straight_length", "curved_length", "bending_stiffness",
            "torsional_stiffness"; n columns each. Of a bundle also "offset" and "angle", and "sheath_stiffness",
            "sheath_rigid_length" and "sheath_rigid_from", of one column each. Lengths change with the translations
            held: a longer straight part is a longer transmission. Of a tube made of pieces the curvature bends all of
            them in proportion, and a stiffness makes all of it stiffer; its curved length stretches them, and what
            varies along them.
        side: 1 for breakpoints that move towards the tip, -1 for those that move towards the plate.

    Raises:
        InputError: an unknown name, or a side that is neither.
        SolveError: the equilibrium is a fold, where derivatives are infinite.
    """
    by_kernel = _by_kernel(equilibrium, wrt, side)
    if by_kernel is not None:
        return by_kernel
    load, derivatives = equilibrium.load, partial(_kept, equilibrium, tuple(wrt), side)
    touches = equilibrium.walls is not None and equilibrium.walls.contacts
    if not touches and (load is None or load.has_energy or not equilibrium.robot.fixed_sections):
        return Jacobian.of(derivatives)
    slopes = margin_slopes_among_walls if touches else margin_slopes
    return Jacobian.of(derivatives, margin=partial(_margin_by_differences, slopes, equilibrium, tuple(wrt)))


def _margin_by_differences(
    slopes: Callable[[Equilibrium, Sequence[str]], Array], equilibrium: Equilibrium, wrt: tuple[str, ...]
) -> Array:
    """Slopes of the margin by joint values and dimensions; tubes of a carriage share the derivative equally."""
    shared, result = sharing(equilibrium.robot.moving_together, wrt), slopes(equilibrium, wrt)
    return result if shared is None else np.asarray(result @ shared)


@lru_cache(maxsize=8)
def _kept(equilibrium: Equilibrium, wrt: tuple[str, ...], side: int) -> Derivatives:
    """`derivatives_of`, cached for later reads of a Jacobian."""
    return derivatives_of(equilibrium, wrt, side=side)


@small
def position_slopes(equilibrium: Equilibrium, carriages: Carriages | None = None, *, side: int = 1) -> Array:
    """(3, 2n) derivatives of the tip position of an equilibrium by its joint values, m per rad and per m.

    Args:
        carriages: partition of the tubes, numbered from 0. The translations of each group move together, and each
            column has an equal part of that. By default the carriages of the robot.
        side: as in `jacobian`.

    Raises:
        SolveError: the equilibrium is a fold, where derivatives are infinite.
    """
    result = _by_kernel(equilibrium, JOINTS, side, carriages)
    if result is not None:
        return result.position
    return derivatives_of(equilibrium, side=side, carriages=carriages).tip_position


# --- Margin under a load without an energy ----------------------------------------------------------------------------

# How an eigenvalue l of the linearised equations H changes with joint values and tubes. With its left and right
# eigenvectors w and v, dl = w'dH v / w'v, where the equilibrium moves by H dx = -dg. Both dg and dH are differences of
# two problems, a step further and a step back: the eigenvectors are not solved for again. Of a symmetric H w is v.

STEP = 1e-5
"""Step of the differences: rad, or a fraction of the arm's length, of its inverse, or of a stiffness."""


WALL_STEP = 1e-3
"""Step of the differences of margins among walls: errors of the mesh give about 1e-3, those of the step less."""


class Posed(NamedTuple):
    """Robot at joint values."""

    robot: Robot
    """Robot, with one dimension changed or none."""
    rotations: Array
    """Rotations (n,), rad."""
    translations: tuple[float, ...]
    """Translations (n,), m."""


class Change(NamedTuple):
    """Change of a robot or its joint values by one parameter."""

    step: float
    """Step to either side, in the unit of the parameter."""
    sides: list[Posed]
    """Robot a step further, then a step back; empty where one of them does not exist."""


class Difference(NamedTuple):
    """Central difference of equations with the same unknowns (U,)."""

    step: float
    """Step to either side."""
    ahead: Loaded
    """Equations a step further."""
    behind: Loaded
    """Equations a step back."""

    def gradient(self, x: Array) -> Array:
        """(U,) derivative of the residual at unknowns x (U,)."""
        return np.asarray((self.ahead.at(x).gradient - self.behind.at(x).gradient) / (2 * self.step))

    def stiffness(self, x: Array, rate: Array, modes: tuple[Array, Array], *, sure: bool = False) -> float:
        """Derivative of w'Hv for left and right modes w, v (U,), where x changes at a rate (U,).

        Of the symmetric part of H, if `sure`.
        """

        def form(member: Loaded, x: Array) -> Array:
            state = member.at(x)
            return symmetric_part(member.problem, state) if sure else state.hessian

        left, right = modes
        change = form(self.ahead, x + self.step * rate) - form(self.behind, x - self.step * rate)
        return float(np.vdot(left, change @ right).real) / (2 * self.step)


def unit_of(e: Equilibrium, name: str, tube: int) -> float:
    """Step of a parameter that turns the tip by about 1 rad."""
    length = float(e.arc_length[-1])
    match name:
        case "rotations":
            return 1.0
        case "curvature":
            return 1 / length
        case "translations" | "straight_length" | "curved_length":
            return length
        case _:
            return float(getattr(e.robot.tubes[tube], name))


def shifted(e: Equilibrium, name: str, tube: int, step: float) -> Posed:
    """Robot and joint values of an equilibrium with a parameter of a tube a step further.

    Raises:
        InputError: no such robot exists.
    """
    joints = {"rotations": e.rotations.copy(), "translations": e.translations.copy()}
    robot: Any = e.robot
    if name in joints:
        joints[name][tube] += step
    else:
        robot = resized(robot, tube, name, getattr(robot.tubes[tube], name) + step)
    return Posed(robot, joints["rotations"], tuple(joints["translations"].tolist()))


def change_by(e: Equilibrium, name: str, tube: int, size: float = STEP) -> Change:
    """Change by a parameter of a tube; `size` is that of the step relative to `unit_of`."""
    step = size * unit_of(e, name, tube)
    try:
        return Change(step, [shifted(e, name, tube, sign * step) for sign in (1, -1)])
    except InputError:
        return Change(step, [])


def difference_of(member: Loaded, change: Change, loads: tuple[Load, Load]) -> Difference | None:
    """Difference of the equations of a member by a change, under a load at each side.

    None where a side does not exist, and where breakpoints that coincide move apart.
    """
    sides = list[Loaded]()
    for (robot, rotations, shift), load in zip(change.sides, loads, strict=False):
        try:
            assembly, _ = loading_of(robot, shift, load)
        except InputError:  # the arm does not exist
            return None
        side = member.with_inputs(rotations, shift, load, member.factor, robot)
        if side is None or _with_length(assembly) != _with_length(member.torsion.assembly):
            return None
        sides.append(side)
    return Difference(change.step, *sides) if sides else None


def _with_length(assembly: Assembly) -> int:
    """Number of sections of an arm that have a length."""
    return int((assembly.length > LENGTH_ROUND_OFF).sum())


def margin_slopes(
    e: Equilibrium, wrt: Sequence[str], varied: Sequence[tuple[float, tuple[Robot, Robot]]] = (), *, sure: bool = False
) -> Array:
    """(Q,) derivatives of the margin under a load without an energy, or of the `sure_margin`.

    First by joint values and dimensions, n for each name of `wrt`; then, per step, by robots a step further and a step
    back. NaN at a double eigenvalue, and at breakpoints that coincide and that the change separates.

    Raises:
        SolveError: the equilibrium is a fold.
    """
    point: LoadedPoint = point_of(e)
    member, x = point.member, point.state.x
    changes = [change_by(e, name, tube) for name in wrt for tube in range(len(e.rotations))]
    changes += [
        Change(step, [Posed(robot, e.rotations, member.translations) for robot in pair]) for step, pair in varied
    ]
    matrix, slopes = symmetric_part(member.problem, point.state) if sure else point.state.hessian, list[float]()
    result = modes(matrix, symmetric=sure)
    if result is None:
        return np.full(len(changes), np.nan)
    factors, scale = scipy.linalg.lu_factor(point.state.hessian), np.vdot(result.left, result.right)
    left, right = result.left, result.right / scale
    for change in changes:
        difference = difference_of(member, change, (member.problem.load,) * 2)
        if difference is None:
            slopes.append(np.nan)
            continue
        rate = -scipy.linalg.lu_solve(factors, difference.gradient(x))
        slopes.append(difference.stiffness(x, rate, (left, right), sure=sure))
    return np.array(slopes)


def margin_slopes_among_walls(e: Equilibrium, wrt: Sequence[str]) -> Array:
    """(Q,) derivatives of the margin of an arm that touches walls, by differences of equilibria; NaN without one.

    Where a contact moves past the end of an element, the margin jumps by the error of the mesh, about 1e-6.
    """
    solved, slopes = solution_of(e), list[float]()
    for change in (change_by(e, name, tube, WALL_STEP) for name in wrt for tube in range(len(e.rotations))):
        near = [solved.at_joints(at, np.array(shift), robot) for robot, at, shift in change.sides]
        margins = [np.nan if each is None else at_walls(each).margin for each in near]
        slopes.append((margins[0] - margins[1]) / (2 * change.step) if len(margins) == 2 else np.nan)
    return np.array(slopes)


# --- Compliance -------------------------------------------------------------------------------------------------------


def compliance_of(equilibrium: Equilibrium) -> Array:
    """Compliance (6, 6) of the tip; see `Equilibrium.compliance`."""
    if equilibrium.walls is not None and equilibrium.walls.contacts:
        return compliance_among_walls(equilibrium)
    point = point_of(equilibrium, Load())
    return np.asarray(point.member.compliance(point.state))


def compliance_at(equilibrium: Equilibrium, arc_length: float, tube: int | None) -> Array:
    """Compliance (6, 6) of a point of the arm; see `Equilibrium.compliance_at`."""
    length, tubes = float(equilibrium.arc_length[-1]), equilibrium.tube_end
    if not 0 <= finite("arc_length", arc_length) <= length * (1 + 1e-12):
        raise InputError(f"arc_length is {arc_length:g} m; it must be on the arm, between 0 and {length:g} m")
    present = np.flatnonzero(tubes >= arc_length - SAME_END)
    if tube is not None and tube not in present:
        raise InputError(f"tube is {tube}; tubes {', '.join(map(str, present))} are at {arc_length:g} m")
    # Where a wrench acts the curvature jumps: elements end there.
    point, load, place = point_of(equilibrium, Load()), equilibrium.load or Load(), min(arc_length, length)
    cut = replace(load, points=(*load.points, PointLoad(place)))
    failure = "the equilibrium is a fold (margin 0), where the compliance is infinite"
    result = point.onto(point.member.under(point, cut, 1.0), failure)
    return np.asarray(result.member.compliance_at(result.state, place, tube))


def base_wrench_of(equilibrium: Equilibrium) -> Array:
    """Wrench (6,) of the load on the plate; see `Equilibrium.base_wrench`."""
    if equilibrium.load is None:
        return np.zeros(6)
    if equilibrium.walls is not None:
        # Contact forces are forces at points of the load; without the walls the equilibrium need not be stable.
        member, x = Loaded.of_equilibrium(equilibrium, None, None)
        return np.asarray(member.base_wrench(member.at(x)))
    point = point_of(equilibrium)
    return np.asarray(point.member.base_wrench(point.state))
