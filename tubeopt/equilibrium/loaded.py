"""Forward kinematics under load: the unloaded equilibrium, followed as the load grows."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from ..errors import SolveError
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.loaded import LoadedResult, loaded_margin, loaded_newton, loaded_residual, turn_of
from ..transcription.loaded import LoadedProblem, base_wrench, compliance, evaluate, tip_position, tip_slopes, unknowns
from ..transcription.loaded_arm import loaded_arm
from ..typing import Array
from .continuation import LARGEST_RATIO, LARGEST_SHIFT, LARGEST_TURN, JointPath, largest_twist
from .load_continuation import JointFamily, LoadedPoint, LoadFamily, Member, carry, reach
from .load_problem import LOADED_DISCRETISATION, check_load, loaded_problem
from .result import Equilibrium, Statistics, Status
from .solving import Discretisation, discretisation_of, sample_rotation

FINEST = 4
"""Most times that the pieces of the mesh are halved."""

MARGIN_TOLERANCE = 1e-8
"""Wanted accuracy of margins above HARDLY_SOFTENED; the others are surer than the shape."""

HARDLY_SOFTENED = 0.99

EXTRA_POINTS = 2
"""Collocation points by which the check of the mesh is finer than the solution."""

LEAST_STIFFNESS = 1e-6
"""Margin below which errors no longer grow in the estimate."""


def ramp(robot: Robot, unloaded: Equilibrium, load: Load, discretisation: Discretisation) -> LoadedPoint:
    """The equilibrium at full load on the branch of an unloaded one.

    Raises:
        SolveError: the branch ends, or turns unstable, before the load is reached; the unloaded equilibrium is a fold.
    """
    shift = tuple(unloaded.translations.tolist())
    problem = loaded_problem(robot, shift, load, discretisation)
    start = unloaded_point(problem, unloaded)
    point = reach(LoadFamily(problem, start.member.rotations, shift), start, 1.0)
    if point.t < 1.0:
        raise SolveError(
            f"{Status.BRANCH_ENDED_UNDER_LOAD}: {ending(point)} at {100 * point.t:.4g} % of the load",
            to_loaded(robot, point, load.scaled(point.t), discretisation),
        )
    return point


def ending(point: LoadedPoint) -> str:
    """What happens to a branch just after its last stable point, in words."""
    if not point.member.problem.load.has_energy:
        return "there is no equilibrium close by"
    return "it bifurcates" if bifurcates(point) else "it ends in a fold"


SYMMETRIC = 1e-5
"""A growing load whose part along the softest direction is smaller than this meets a bifurcation there."""


def bifurcates(point: LoadedPoint) -> bool:
    """Whether the load does not push along the softest direction of a point close to the end of its branch."""
    soft = np.linalg.eigh(point.state.hessian)[1][:, 0]
    pull = point.state.pull
    return bool(abs(soft @ pull) <= SYMMETRIC * np.linalg.norm(pull))


def unloaded_point(problem: LoadedProblem, unloaded: Equilibrium) -> LoadedPoint:
    """An unloaded equilibrium as the beginning of a family in the factor of the load."""
    rotations = unloaded.rotations
    theta = sample_rotation(unloaded, problem.torsion.arc_length)
    result = loaded_newton(problem, rotations, unknowns(problem, rotations, theta), 0.0)
    if not result.converged:
        raise SolveError("the unloaded equilibrium is a fold (margin 0): no load can be put on it")
    return solved(Member(problem, rotations, tuple(unloaded.translations.tolist()), 0.0), result)


def solved(member: Member, result: LoadedResult, t: float | None = None) -> LoadedPoint:
    """A result as the point of a family, at t, by default the factor."""
    margin = loaded_margin(member.problem, result.state)
    return LoadedPoint(member.factor if t is None else t, member, result.state, margin, result.iterations)


def loaded_point(equilibrium: Equilibrium) -> LoadedPoint:
    """A loaded equilibrium as the beginning of a family; raises SolveError where it is a fold."""
    shift = tuple(equilibrium.translations.tolist())
    if equilibrium.load is None:
        check_load(equilibrium.robot, Load(), shift)
        return unloaded_point(loaded_problem(equilibrium.robot, shift, Load()), equilibrium)
    problem = loaded_problem(equilibrium.robot, shift, equilibrium.load, discretisation_of(equilibrium))
    rotations = equilibrium.rotations
    x = unknowns(problem, rotations, _elastic(problem, equilibrium), equilibrium.point_curvature)
    result = loaded_newton(problem, rotations, x)
    if not result.converged:
        raise SolveError("the loaded equilibrium is a fold (margin 0): Newton does not stay there")
    return solved(Member(problem, rotations, shift), result)


def _elastic(problem: LoadedProblem, equilibrium: Equilibrium) -> Array:
    """(N, n) rotations at the points without the natural turn of tubes made of pieces."""
    return equilibrium.point_rotation - problem.torsion.assembly.wound(problem.torsion.arc_length)


def to_tolerance(
    robot: Robot,
    point: LoadedPoint,
    load: Load,
    discretisation: Discretisation,
    tolerance: float,
    how: tuple[str, float],
) -> Equilibrium:
    """The equilibrium on the first mesh whose estimated error is small enough; `how` is the start and when begun.

    Raises:
        SolveError: no mesh is fine enough.
    """
    d = discretisation
    for level in range(d.refinement, max(FINEST, d.refinement) + 1):
        errors = mesh_errors(robot, point, d)
        error = max(errors.theta, errors.tip / point.member.problem.torsion.assembly.total_length)
        if error <= tolerance and (errors.margin <= MARGIN_TOLERANCE or level >= FINEST):
            return to_loaded(robot, point, load, d, how, errors)
        d = Discretisation(d.family, d.degree, level + 1)
        shift = point.member.translations
        there = Member(loaded_problem(robot, shift, load, d), point.member.rotations, shift)
        result = loaded_newton(there.problem, there.rotations, carry(point, there))
        if not result.converged:
            raise SolveError(f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one")
        point = solved(there, result)
    wrong = f"the estimated error is {error:.1e} rad, wanted was {tolerance:.1e} rad"
    raise SolveError(f"{Status.MESH_TOO_COARSE}: {wrong}", to_loaded(robot, point, load, d, how))


def to_loaded(
    robot: Robot,
    point: LoadedPoint,
    load: Load,
    discretisation: Discretisation,
    how: tuple[str, float] = ("the load before", 0.0),
    errors: MeshErrors | None = None,
) -> Equilibrium:
    """Shape, energy and error estimates of a solved problem under `load`; `how` is the start and when (s) begun."""
    member, state = point.member, point.state
    problem, rotations = member.problem, member.rotations
    assembly, mesh = problem.torsion.assembly, problem.mesh
    arm = loaded_arm(problem, rotations, state)
    ends = np.maximum(assembly.end, 0.0)
    errors = mesh_errors(robot, point, discretisation) if errors is None else errors
    margin = point.margin
    start, began = how
    equilibrium = Equilibrium(
        robot=robot,
        rotations=rotations,
        translations=np.array(member.translations),
        tip_position=arm.position[-1],
        tip_rotation=arm.frame[-1],
        arc_length=arm.arc_length,
        position=arm.position,
        frame=arm.frame,
        curvature=arm.curvature,
        rotation=arm.rotation,
        torsion=arm.torsion,
        tip_rotations=arm.rotation[np.arange(len(rotations)), np.searchsorted(arm.arc_length, ends - 1e-12)],
        section_start=assembly.start,
        point=problem.torsion.arc_length,
        point_rotation=state.theta + assembly.wound(problem.torsion.arc_length),
        point_curvature=state.curvature,
        tube_end=ends,
        margin=margin,
        index=0 if margin > 0 or np.isnan(margin) else int((np.linalg.eigvalsh(state.hessian) < 0).sum()),
        energy=state.energy,
        residual=loaded_residual(problem, state),
        mesh_error=errors.theta,
        tip_error=errors.tip,
        status=Status.NO_MARGIN if np.isnan(margin) else Status.STABLE if margin > 0 else Status.UNSTABLE,
        statistics=Statistics(
            method="newton",
            iterations=point.iterations,
            elements=len(mesh.length),
            degree=mesh.tableau.degree,
            start=start,
            seconds=time.perf_counter() - began if began else 0.0,
            family=mesh.tableau.family,
            refinement=discretisation.refinement,
        ),
        load=load,
        work=state.work if problem.load.has_energy else float("nan"),
    )
    # What follows from the solved state at once need not be solved for again.
    vars(equilibrium)["base_wrench"] = base_wrench(problem, state)
    if not abs(margin) < LEAST_STIFFNESS:
        vars(equilibrium)["compliance"] = compliance(problem, state)
    return equilibrium


@dataclass(frozen=True)
class MeshErrors:
    """Estimated errors of theta, rad, of the tip, m, and of the margin: what a Newton step on a finer rule changes."""

    theta: float
    tip: float
    margin: float


def mesh_errors(robot: Robot, point: LoadedPoint, d: Discretisation) -> MeshErrors:
    """What the mesh gets wrong at a point."""
    member = point.member
    finer = Discretisation(d.family, d.degree + EXTRA_POINTS, d.refinement)
    problem = loaded_problem(robot, member.translations, member.problem.load, finer)
    there = Member(problem, member.rotations, member.translations, member.factor)
    state = evaluate(problem, member.rotations, carry(point, there), member.factor)
    # At a fold the step along the softest direction has no bound: its stiffness counts as at least this.
    shift = LEAST_STIFFNESS if abs(point.margin) < LEAST_STIFFNESS else 0.0
    step = np.linalg.solve(state.hessian + shift * np.eye(problem.size), -state.gradient)
    split = problem.torsion.size
    theta = np.abs(problem.torsion.factor @ step[:split]).max(initial=0.0)
    moved = tip_position(problem, state) + tip_slopes(problem, state)[:3] @ step
    moved -= tip_position(member.problem, point.state)
    # Only of arms that loads hardly soften is the margin less sure than the shape.
    close = point.margin > HARDLY_SOFTENED
    margin = abs(loaded_margin(problem, state) - point.margin) if close else 0.0
    return MeshErrors(float(theta), float(np.linalg.norm(moved)), margin)


def loaded_kinematics(
    robot: Robot,
    start: Equilibrium,
    joints: tuple[Array, tuple[float, ...]],
    load: Load,
    tolerance: float,
    began: float,
) -> Equilibrium:
    """The equilibrium at `joints` under `load` on the branch of `start`, which has other joint values or another load.

    Raises:
        SolveError: the branch ends, or turns unstable, on the way; or no mesh is fine enough.
    """
    rotations, shift = joints
    d = LOADED_DISCRETISATION
    point = None if start.load is None else _close(start, loaded_problem(robot, shift, load, d), rotations, shift)
    word = "guess"
    if point is None:
        own = np.concatenate([start.rotations, start.translations])
        there = np.concatenate([rotations, shift])
        if np.array_equal(own, there) and start.load is None:
            point, word = ramp(robot, start, load, d), "the load before, from none"
        else:
            point = _along(JointFamily(JointPath(robot, own, there, d), load, start.load), start)
    return to_tolerance(robot, point, load, d, tolerance, (word, began))


def _along(family: JointFamily, start: Equilibrium) -> LoadedPoint:
    """The end of a way in joint values and load."""
    first = family.member(0.0)
    near = unloaded_point(first.problem, start) if start.load is None else loaded_point(start)
    near = replace(near, t=0.0)
    here = reach(family, near, 1.0, longest=family.path.largest_step(), stable=not near.margin <= 0)
    if here.t < 1.0:
        raise SolveError(
            f"{Status.BRANCH_ENDED}: it ends {100 * here.t:.2f} % of the way from the guess to the goal", start
        )
    return here


def _close(
    guess: Equilibrium, problem: LoadedProblem, rotations: Array, shift: tuple[float, ...]
) -> LoadedPoint | None:
    """The equilibrium after a small change of joints or load, by one solve; None where Newton is not at ease."""
    assert guess.load is not None
    turn, moved = rotations - guess.rotations, np.array(shift) - guess.translations
    length = problem.torsion.assembly.total_length
    small = np.abs(turn).max() <= LARGEST_TURN and np.abs(moved).max() <= LARGEST_SHIFT * length
    if not small or len(guess.point) != len(problem.softness) or np.isnan(guess.margin) == problem.load.has_energy:
        return None
    before = loaded_problem(guess.robot, tuple(guess.translations.tolist()), guess.load, discretisation_of(guess))
    if len(before.softness) != len(problem.softness):
        return None
    theta = _elastic(before, guess)
    bent = unknowns(before, guess.rotations, theta, guess.point_curvature)[before.torsion.size :]
    x = unknowns(problem, rotations, theta + turn)
    x[problem.torsion.size :] = bent * np.repeat(before.softness / problem.softness, 2)
    result = loaded_newton(problem, rotations, x, iterations=8)
    if not result.converged or result.contraction > LARGEST_RATIO:
        return None
    limit = largest_twist(1.0 if np.isnan(guess.margin) else guess.margin)
    if turn_of(problem, result.state, result.state.x - x) > limit:
        return None
    there = solved(Member(problem, rotations, shift), result, 1.0)
    # A stable branch is followed while it is stable.
    return None if guess.margin > 0 and there.margin <= 0 else there


def compliance_of(equilibrium: Equilibrium) -> Array:
    """(6, 6) change of the tip by a small dead wrench there; see `Equilibrium.compliance`."""
    point = loaded_point(equilibrium)
    return compliance(point.member.problem, point.state)


def base_wrench_of(equilibrium: Equilibrium) -> Array:
    """(6,) what the load puts on the plate; see `Equilibrium.base_wrench`."""
    if equilibrium.load is None:
        return np.zeros(6)
    point = loaded_point(equilibrium)
    return base_wrench(point.member.problem, point.state)
