"""Forward kinematics under load: the unloaded equilibrium, followed as the load grows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..block.transcription.arm import arc_lengths
from ..block.transcription.collocated import STEPS
from ..block.transcription.loaded import LoadedProblem, base_wrench, compliance, unknowns
from ..block.transcription.loaded_arm import compliance_along
from ..errors import InputError, SolveError, finite
from ..robots.load import Load, PointLoad
from ..robots.order import SAME_END, twisted_tube
from ..robots.robot import Robot
from ..solvers.compiled.binding import solve_compiled, solve_many_compiled
from ..solvers.compiled.loaded import LoadedAnswer, solve_loaded_compiled, solve_many_loaded_compiled
from ..solvers.ipopt import solve_loaded_ipopt
from ..solvers.parallel.blas import small
from ..solvers.settings import CONTINUATION, NEWTON, Ipopt, Newton
from ..typing import Array, Mask
from .continuation import Family, JointPath, Milestone, P, bifurcates, by_kernel, reach, small_motion
from .load_answer import from_answer, mesh_errors, to_loaded
from .load_problem import LOADED_DISCRETISATION, check_load, loaded_problem, loaded_rules, loading_of
from .member import Loaded, LoadedPoint, Point, interpolate
from .result import Equilibrium, Status
from .solving import Discretisation, discretisation_of, sample_arms, sample_rotation


def ramp(unloaded: Equilibrium, load: Load, discretisation: Discretisation) -> LoadedPoint:
    """The equilibrium at full load on the branch of an unloaded one.

    Raises:
        SolveError: the branch ends, or turns unstable, before the load is reached; the unloaded equilibrium is a fold.
    """
    start = unloaded_point(unloaded, load, discretisation)
    family = Family.growing(start.member)
    point = reach(family, start)
    if point.t < 1.0:
        raise SolveError(
            f"{Status.BRANCH_ENDED_UNDER_LOAD}: {ending(family, point)} at {100 * point.t:.4g} % of the load",
            to_loaded(point),
        )
    return point


def ending(family: Family, point: LoadedPoint) -> str:
    """What happens to a branch just after its last stable point, in words."""
    if point.member.flutters(point.state):
        return "it begins to flutter"
    return "it bifurcates" if bifurcates(family, point) else "it ends in a fold"


def unloaded_point(
    unloaded: Equilibrium, load: Load, discretisation: Discretisation = LOADED_DISCRETISATION
) -> LoadedPoint:
    """An unloaded equilibrium as the beginning of a family in the factor of a load."""
    shift = tuple(unloaded.translations.tolist())
    member = Loaded.of(unloaded.robot, unloaded.rotations, shift, load, discretisation, 0.0)
    problem = member.problem
    theta = sample_rotation(unloaded, problem.torsion.arc_length)
    failure = "the unloaded equilibrium is a fold (margin 0): no load can be put on it"
    return Point.near(member, unknowns(problem, unloaded.rotations, theta), failure)


def loaded_point(equilibrium: Equilibrium) -> LoadedPoint:
    """An equilibrium as the beginning of a family; raises SolveError where it is a fold, InputError under friction."""
    if equilibrium.friction is not None:
        raise InputError("the equilibrium bears friction, which is not supported here; give one without friction")
    if equilibrium.load is None:
        check_load(equilibrium.robot, Load(), tuple(equilibrium.translations.tolist()))
        return unloaded_point(equilibrium, Load())
    failure = "the loaded equilibrium is a fold (margin 0): Newton does not stay there"
    return Point.near(*_unsolved(equilibrium), failure)


def _unsolved(equilibrium: Equilibrium) -> tuple[Loaded, Array]:
    """The problem of a loaded equilibrium, and its unknowns as they were solved for."""
    rotations, shift = equilibrium.rotations, tuple(equilibrium.translations.tolist())
    problem, theta = _own(equilibrium), sample_rotation(equilibrium, equilibrium.point)
    member = Loaded(equilibrium.robot, problem, rotations, shift, discretisation_of(equilibrium))
    return member, unknowns(problem, rotations, theta, equilibrium.point_curvature)


def _own(equilibrium: Equilibrium) -> LoadedProblem:
    """The problem of a loaded equilibrium, on the mesh on which it was solved: perhaps that of a larger load."""
    robot, shift, load = equilibrium.robot, tuple(equilibrium.translations.tolist()), equilibrium.load
    assert load is not None
    start, d = loading_of(robot, shift, load)[0].start, discretisation_of(equilibrium)
    points = np.bincount(np.searchsorted(start, equilibrium.point, side="right") - 1, minlength=len(start))
    return loaded_problem(robot, shift, load, d, tuple((points // d.degree).tolist()))


def to_tolerance(
    point: LoadedPoint, tolerance: float, how: tuple[str, float], settings: Newton = NEWTON
) -> Equilibrium:
    """The equilibrium on the first mesh whose estimated error is small enough; `how` is the start and when begun."""
    d, finest = point.member.discretisation, settings.loaded_refinements
    for level in range(d.refinement, max(finest, d.refinement) + 1):
        errors = mesh_errors(point)
        error = max(errors[0], errors[1] / point.member.problem.torsion.assembly.total_length)
        if error <= tolerance and (errors[2] <= settings.margin_tolerance or level >= finest):
            return to_loaded(point, how, errors)
        there = point.member.on(refinement=level + 1)
        failure = f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one"
        point = Point.near(there, there.carried(point), failure)
    wrong = f"the estimated error is {error:.1e} rad, wanted was {tolerance:.1e} rad"
    raise SolveError(f"{Status.MESH_TOO_COARSE}: {wrong}", to_loaded(point, how))


@small
def loaded_kinematics(
    start: Equilibrium, there: Loaded, tolerance: float, began: float, settings: Newton = NEWTON
) -> Equilibrium:
    """The equilibrium `there` on the branch of `start`, which has other joint values or another load; raises SolveError
    as `forward_kinematics`."""
    quick = compiled(start, there, tolerance, began, settings)
    if quick is not None:
        return quick
    own, goal = (np.concatenate([one.rotations, one.translations]) for one in (start, there))
    if start.load is None and np.array_equal(own, goal):
        point, word = ramp(start, there.load, there.discretisation), "the load before, from none"
    else:
        path, word = JointPath(there.robot, own, goal, there.discretisation), "guess"
        family = Family(path, there.load, start.load)
        here = _quickly(family, start, tolerance, began, settings)
        if here.t == 1.0:
            return here.pose
        point = _along(family, here.pose, here.t)
    return to_tolerance(point, tolerance, (word, began), settings)


def solved_by_ipopt(found: Equilibrium, method: str, settings: Ipopt | None, began: float) -> Equilibrium:
    """A loaded equilibrium solved once more, by IPOPT; raises SolveError where that fails."""
    point = loaded_point(found)
    result = solve_loaded_ipopt(point.member.problem, found.rotations, point.state, settings)
    again = to_loaded(Point.of(point.member, result, point.t), ("newton", began))
    return replace(again, statistics=replace(again.statistics, method=method))


def compiled(start: Equilibrium, there: Loaded, tolerance: float, began: float, settings: Newton) -> Equilibrium | None:
    """The stable equilibrium under a dead load by the compiled kernel: grown from `start`, which bears none, or a small
    change of it, which bears one; None where the kernel declines, or no mesh is fine enough."""
    robot, rotations, shift, load = there.robot, there.rotations, there.translations, there.load
    if not (load.has_energy and start.margin > 0):
        return None
    problem, turn = there.problem, rotations - start.rotations
    given: tuple[Array, Array | None]
    if start.load is None:
        if turn.any() or not np.array_equal(start.translations, shift):
            return None
        given, word = (sample_rotation(start, problem.torsion.arc_length), None), "the load before, from none"
    elif small_motion(turn, shift - start.translations, float(start.arc_length[-1])):
        given, word = at_points(start, problem), "guess"
    else:
        return None
    found = solve_loaded_compiled(loaded_rules(robot, shift, load), (rotations, turn), given, start.margin)
    refinement = 0
    while found is not None and _too_coarse(found, problem, tolerance, settings):
        refinement += 1
        if refinement > settings.loaded_refinements:
            return None
        coarse, rules = problem, loaded_rules(robot, shift, load, refinement)
        problem = rules.problem
        table = interpolate(coarse, np.concatenate([found.theta, found.curvature], axis=1), problem)
        given = table[:, : len(turn)], table[:, len(turn) :]
        found = solve_loaded_compiled(rules, (rotations, 0 * turn), given, found.margin)
    if found is None:
        return None
    d = replace(LOADED_DISCRETISATION, refinement=refinement)
    return from_answer(Loaded(robot, problem, rotations, shift, d), found, (word, began, 0))


def grow_many(
    robot: Robot, rotations: Array, translations: Array, load: Load, tolerance: float
) -> tuple[Array, Array, Mask] | None:
    """Equilibria at rotations (M, n) and translations (n,) under a load, by the compiled kernels.

    Rows of tip position (3), tip frame (9), tip rotations (n), margin, residual, errors of theta and tip, energy; the
    compliances (M, 6, 6); and (M,) which are fine: grown from an equilibrium without load, and on a mesh fine enough.
    None where there is no kernel for them.
    """
    shift = tuple(translations.tolist())
    check_load(robot, load, shift)
    first = solve_compiled(robot, rotations[0], translations) if load.has_energy else None
    if first is None:
        return None
    s = first["arc_length"][: int(first["pieces"]) * STEPS + 1].copy()
    arms = np.zeros((len(rotations), 2, len(s), robot.n_tubes))
    unloaded = solve_many_compiled(robot, rotations, np.tile(translations, (len(rotations), 1)), arms)
    assert unloaded is not None
    rules = loaded_rules(robot, shift, load)
    problem, n = rules.problem, robot.n_tubes
    length = problem.torsion.assembly.total_length
    theta = sample_arms(robot, translations, s, arms, problem.torsion.arc_length)
    ends = np.searchsorted(arc_lengths(problem.mesh), np.maximum(problem.torsion.assembly.end, 0.0) - 1e-12)
    found = solve_many_loaded_compiled(rules, rotations, (theta, unloaded[0][:, n + 12]), ends.astype(np.int64))
    if found is None:
        return None
    table, compliance, declined = found
    coarse = np.maximum(table[:, n + 14], table[:, n + 15] / length) > tolerance
    return table[:, :-1], compliance, ~(unloaded[1] | declined | coarse | (table[:, -1] > NEWTON.margin_tolerance))


def _too_coarse(found: LoadedAnswer, problem: LoadedProblem, tolerance: float, settings: Newton) -> bool:
    theta, tip, margin = found.errors
    return margin > settings.margin_tolerance or max(theta, tip / problem.torsion.assembly.total_length) > tolerance


def at_points(start: Equilibrium, problem: LoadedProblem) -> tuple[Array, Array]:
    """Rotations (N, n) without the natural turn, and curvature (N, 2), of a loaded equilibrium at the points of a
    problem."""
    s = problem.torsion.arc_length
    if (
        len(s) == len(start.point)
        and np.abs(s - start.point).max() <= CONTINUATION.largest_shift * start.arc_length[-1]
    ):
        return sample_rotation(start, start.point), start.point_curvature
    return sample_rotation(start, s), interpolate(_own(start), start.point_curvature, problem)


def _quickly(family: Family, start: Equilibrium, tolerance: float, began: float, settings: Newton) -> Milestone:
    """The last equilibrium on the way of a family to which the compiled kernel comes."""

    def solve(here: Equilibrium, t: float) -> Equilibrium | None:
        return compiled(here, family.under_load(t), tolerance, began, settings)

    first = start if start.load is not None else solve(start, 0.0)
    if first is None:
        return Milestone(0.0, start)
    origin = Milestone(0.0, first)
    last = [origin, *by_kernel(family, origin, solve)][-1]
    return last if last.t > 0 else Milestone(0.0, start)


def _along(family: Family, here: Equilibrium, t: float) -> LoadedPoint:
    """The end of a way in joint values and load, `here` being the equilibrium at t."""
    if here.load is None:
        assert family.load is not None
        near = replace(unloaded_point(here, family.load, family.path.discretisation), t=t)
    else:
        member, x = _unsolved(here)
        near = Point(t, member, member.at(x), here.margin)
    return arrived(reach(family, near, stable=not near.margin <= 0), here)


def arrived(last: P, guess: Equilibrium) -> P:
    """The last point of a branch from a guess; raises SolveError where that is not the goal."""
    if last.t < 1.0:
        raise SolveError(
            f"{Status.BRANCH_ENDED}: it ends {100 * last.t:.2f} % of the way from the guess to the goal", guess
        )
    return last


def compliance_of(equilibrium: Equilibrium) -> Array:
    """(6, 6) change of the tip by a small dead wrench there; see `Equilibrium.compliance`."""
    point = loaded_point(equilibrium)
    return compliance(point.member.problem, point.state)


def compliance_at(equilibrium: Equilibrium, arc_length: float, tube: int | None) -> Array:
    """(6, 6) change of a place of the arm by a small dead wrench there; see `Equilibrium.compliance_at`."""
    if equilibrium.load is not None and not equilibrium.load.has_energy:
        raise InputError("the load has a moment or turns with the tip; compliance is then told at the tip only")
    point = loaded_point(equilibrium)
    assembly, length = point.member.problem.torsion.assembly, float(equilibrium.arc_length[-1])
    if not 0 <= finite("arc_length", arc_length) <= length * (1 + 1e-12):
        raise InputError(f"arc_length is {arc_length:g} m; it must be on the arm, between 0 and {length:g} m")
    here = np.flatnonzero(assembly.end >= arc_length - SAME_END)
    chosen = twisted_tube(assembly.end, arc_length) if tube is None else tube
    if chosen not in here:
        raise InputError(f"tube is {tube}; tubes {', '.join(map(str, here))} are at {arc_length:g} m")
    # Where a wrench acts the curvature jumps: elements end there.
    load = equilibrium.load or Load()
    cut = replace(load, points=(*load.points, PointLoad(min(arc_length, length))))
    there = Loaded.of(equilibrium.robot, point.member.rotations, point.member.translations, cut)
    failure = "the equilibrium is a fold (margin 0), where the compliance is infinite"
    found: LoadedPoint = Point.near(there, there.carried(point), failure)
    return compliance_along(there.problem, found.state, min(arc_length, length), chosen)


def base_wrench_of(equilibrium: Equilibrium) -> Array:
    """(6,) what the load puts on the plate; see `Equilibrium.base_wrench`."""
    if equilibrium.load is None:
        return np.zeros(6)
    point = loaded_point(equilibrium)
    return base_wrench(point.member.problem, point.state)
