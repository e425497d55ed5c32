"""Forward kinematics: joint values -> the equilibrium that the robot takes."""

from __future__ import annotations

import reprlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..block.transcription.arm import ArmSolution, profile
from ..block.transcription.loaded import LoadedProblem
from ..block.transcription.reduced import evaluate, worst_equation
from ..errors import InputError, SolveError, positive
from ..files.field_metadata import POSITIVE, OneOf, unit
from ..robots.load import Load
from ..robots.robot import Robot, check_robot, joint_values
from ..solvers.blas import small
from ..solvers.compiled.binding import Start, solve_compiled
from ..solvers.compiled.loaded import solve_loaded_compiled
from ..solvers.ipopt import solve_ipopt, solve_loaded_ipopt
from ..solvers.settings import LARGEST_RATIO, LARGEST_TWIST, Ipopt, Newton
from ..solvers.time_limit import limited
from ..typing import Array
from .answer import FOLDED, answered, at_points, built, error_of, largest_error, to_equilibrium, unsolved
from .continuation import (
    SHARPEST_STEP,
    SHORTEST_STEP,
    Family,
    JointPath,
    Milestone,
    bifurcates,
    largest_twist,
    reach,
    shortest_arm,
    small_motion,
    step_to,
)
from .member import Loaded, Member, Place, PlainPoint, Point, Unloaded
from .problem import (
    DEFAULT_DISCRETISATION,
    LOADED_DISCRETISATION,
    LOADED_REFINEMENTS,
    METHODS,
    REFINEMENTS,
    TOLERANCE,
    Discretisation,
    Method,
    SolveRequest,
    check_load,
    loaded_rules,
    method_of,
)
from .result import Equilibrium, Statistics, Status
from .verification import verify_equilibrium

# --- By the compiled kernels ------------------------------------------------------------------------------------------

# Equilibria by the compiled kernels: one, and those along a family.
#
# A function returns None, or stops, where a kernel declines: there is none for the robot, no stable equilibrium is
# close by, or no mesh is fine enough. The general solver then goes on.

# Close to a fold the general solver bends its steps to the branch, where the kernel only halves them: seven halvings
# cost the kernel less than one step of the general solver, more would be spent on a branch that ends.
SHORTEST_COMPILED = 1 / 128
"""Fraction of the longest step along a path below which the general solver takes over from the compiled kernel."""


def unloaded(
    robot: Robot, rotations: Array, translations: Array, guess: Equilibrium | None, request: SolveRequest
) -> Equilibrium | None:
    """The stable equilibrium without a load at joint values: from tubes without torsion, or by a small motion from a
    guess; on the usual mesh or, where that is too coarse, on one twice as fine."""
    if _tied(robot):
        _check_translations(robot, tuple(translations.tolist()))
    start, most = None, LARGEST_TWIST
    if guess is not None:
        turn, arm, points = rotations - guess.rotations, guess.arm, guess.points
        length = max(float(arm.arc_length[-1]), shortest_arm(robot))
        if guess.margin <= 0 or not small_motion(turn, translations - guess.translations, length):
            return None
        along = arm.arc_length, arm.rotation, arm.torsion, points.point, points.point_rotation
        start, most = Start(*along, turn, guess.translations), largest_twist(guess.margin)
    # Finer meshes are left to the general solver: the kernel has static memory for the pieces of these two.
    for refinement in (0, 1):
        solved = solve_compiled(robot, rotations, translations, start, refinement)
        if solved is None or solved.largest_change > most:
            return None
        if start is not None and solved.contraction > LARGEST_RATIO:
            return None
        result = solved.found
        length = float(result.arm.arc_length[-1])
        if largest_error(*result.errors[:2], length, even=robot.even) > request.tolerance:
            continue
        statistics = Statistics(
            method="newton",
            iterations=result.iterations,
            elements=solved.elements,
            degree=DEFAULT_DISCRETISATION.degree,
            start="tubes without torsion" if start is None else "guess",
            seconds=time.perf_counter() - request.began - solved.loading,
            refinement=refinement,
            loading=solved.loading,
        )
        return built(robot, (rotations, translations), result, statistics)
    return None


@lru_cache(maxsize=64)
def _tied(robot: Robot) -> bool:
    """Whether tubes move together."""
    return len(robot.moving_together) < robot.n_tubes


@lru_cache(maxsize=256)
def _check_translations(robot: Robot, shift: tuple[float, ...]) -> None:
    """Raise InputError where tubes that move together are moved apart; the kernel sees the tubes only."""
    robot.assembly(np.array(shift))


def loaded(start: Equilibrium, there: Loaded, request: SolveRequest) -> Equilibrium | None:
    """The stable equilibrium under a dead load: grown from `start`, which bears none, or a small change of it, which
    bears one."""
    robot, rotations, shift, load = there.robot, there.rotations, there.translations, there.load
    if not (load.has_energy and start.margin > 0):
        return None
    problem, turn = there.problem, rotations - start.rotations
    if start.load is None:
        word, close = "the load before, from none", not turn.any() and np.array_equal(start.translations, shift)
    else:
        word, close = "guess", small_motion(turn, shift - start.translations, float(start.arc_length[-1]))
    if not close:
        return None
    inputs = at_points(start, problem)
    margin = start.margin
    coarse: ArmSolution | None = None
    for refinement in range(LOADED_REFINEMENTS + 1):
        rules = loaded_rules(robot, shift, load, refinement)
        if coarse is not None:
            # The polynomials of a mesh are those of the elastic rotation, without the natural turn.
            known = [coarse.points.point_rotation - problem.wound, coarse.points.point_curvature]
            table = problem.mesh.interpolated(np.concatenate(known, axis=1), rules.problem.torsion.arc_length)
            inputs, turn, margin = (table[:, : len(turn)], table[:, len(turn) :]), 0 * turn, coarse.margin
        problem, coarse = rules.problem, solve_loaded_compiled(rules, (rotations, turn), inputs, margin)
        if coarse is None:
            return None
        if not _too_coarse(coarse, problem, request):
            d = replace(LOADED_DISCRETISATION, refinement=refinement)
            return answered(Loaded(robot, problem, rotations, shift, d), coarse, word, request.began)
    return None


def _too_coarse(result: ArmSolution, problem: LoadedProblem, request: SolveRequest) -> bool:
    theta, tip, margin = result.errors
    error = float(largest_error(theta, tip, problem.torsion.assembly.total_length))
    return margin > request.method.newton.margin_tolerance or error > request.tolerance


def nearby(family: Family, guess: Equilibrium, t: float, request: SolveRequest) -> Equilibrium | None:
    """The stable equilibrium at t of a family on the branch of `guess`, a small change away; None as well close to a
    fold."""
    if family.load is not None:
        return loaded(guess, family.under_load(t), request)
    rotations, translations = family.path.at(t)
    result = unloaded(family.path.robot, rotations, translations, guess, request)
    return result if result is not None and result.margin > 0 else None


def along(family: Family, start: Milestone, request: SolveRequest | None = None) -> Iterator[Milestone]:
    """Equilibria after `start` as far as t = 1, or to where the kernel declines even short steps."""
    # The kernel itself checks the same limits: a step that it declines costs one failed solve.
    longest = family.path.largest_step()
    if longest < 1.0:
        longest *= 1 - 1e-9  # a round-off may make a step longer than the kernel takes
    here, step = start, longest
    if family.load is not None and start.pose.load is None and family.path.moves:
        # Where joints move, the kernel goes on from an equilibrium under a load, if it is zero.
        first = nearby(family, start.pose, start.t, request or SolveRequest())
        if first is None:
            return
        here = Milestone(start.t, first)
    while here.t < 1.0:
        t = 1.0 if here.t + step >= 1 - 1e-12 else here.t + step
        pose = nearby(family, here.pose, t, request or SolveRequest())
        if pose is not None:
            here, step = Milestone(t, pose), min(2 * step, longest)
            yield here
            continue
        step /= 2
        if step < longest * SHORTEST_COMPILED:
            return


KINEMATICS_LIMIT = 60.0
"""s, for one equilibrium: most take a few milliseconds, under a load a tenth of a second."""

Along = Callable[[Array], Array]


@renamed(guess="start")
@typed
@limited
def forward_kinematics(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    method: Annotated[str | Newton | Ipopt, OneOf(METHODS)] = "newton",
    start: Any = None,
    load: Load | None = None,
    tolerance: Annotated[float, unit("rad"), POSITIVE] = TOLERANCE,
    verify: bool = False,
    discretisation: Discretisation = DEFAULT_DISCRETISATION,
    time_limit: Annotated[float, unit("s"), POSITIVE] = KINEMATICS_LIMIT,
) -> Equilibrium:
    """Equilibrium of a robot at given joint values.

    Without a start the result is a stable equilibrium. Energy descent (method "newton") finds it from tubes without
    torsion. If that one is unstable, all tubes are moved together from home instead. With a start, an equilibrium at
    other joint values, the branch of the start is followed, stable or not.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.
        start: an Equilibrium or InverseSolution, or a pair (rotations, translations) for its `forward_kinematics`.
        load: external load. Without a start, the unloaded equilibrium is followed while the load grows. With one, the
            branch of the start is followed to these joint values and this load.
        method: solver: newton, ipopt or energy. "newton" solves condensed collocation equations, "ipopt" the same
            equations as constraints of a nonlinear program, and "energy" minimises the elastic energy by IPOPT
            (concentric tubes only). Solver settings are `tubeopt.Newton(...)` or `tubeopt.Ipopt(...)`. Under load
            "ipopt" and "energy" are the same: minimum potential energy from the result of "newton", with the
            orientation of the arm as constraints.
        tolerance: largest allowed error of tube angles, rad. That of the tip is relative to the length of the arm. For
            tubes made of pieces it applies to pieces of 10 mm. The mesh is refined until its error is below it.
        verify: compare the result with an independent adaptive integration. The difference is in `.verification`.
        discretisation: collocation family and degree.
        time_limit: time limit of the solve, s. Moments that wind an arm into a coil need many steps.

    Raises:
        InputError: no robot, an unknown method, or wrong joint values: their number, a value that is not finite, a
            rotation beyond MOST_TURN, a tube out of its actuator. With a load also: an eccentric
            robot, a discretisation, or IPOPT for a load without an energy.
        SolveError: no stable equilibrium was found, the tolerance cannot be reached, or the branch of the start ends on
            the path (a snap). Or the branch ends or loses stability before the full load; the message names the load
            fraction. `.solution` is the best equilibrium found, if any.
        TimeLimitError: (a SolveError) the time limit was reached.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.5, 0.0])
        >>> pose.stable, round(1e3 * float(pose.tip_position[2]), 3)
        (True, 76.151)
    """
    began = time.perf_counter()
    check_robot(robot)
    alpha, place = joint_values(robot, rotations, translations)
    shift = tuple(place.tolist())
    by = method_of(method, load, discretisation)
    positive("tolerance", tolerance)
    guess = None if start is None else _start_of(robot, start, tolerance)
    request, result = SolveRequest(by, tolerance, began), None
    if load is not None:
        check_load(robot, load, shift)
        guess = guess if guess is not None else forward_kinematics(robot, alpha, shift, tolerance=tolerance)
        discretisation = LOADED_DISCRETISATION
    elif guess is not None and guess.load is not None:
        raise InputError("start has a load, but no load is given; give the load, or a start without load")
    elif request.of_kernel(None, discretisation):
        result = unloaded(robot, alpha, place, guess, request)
    if result is None and guess is None:
        point, home = _descended(Unloaded.of(robot, alpha, shift, discretisation), by)
        result = _to_tolerance(point, home, request)
    elif result is None:
        assert guess is not None
        own = np.concatenate([guess.rotations, guess.translations])
        path = JointPath(robot, own, np.concatenate([alpha, place]), discretisation)
        result = on_branch(Family(path, load, guess.load), guess, request)
    return verify_equilibrium(result) if verify else result


def _start_of(robot: Robot, start: Any, tolerance: float) -> Equilibrium:
    """The equilibrium that a start is or has, or that of its joint values; raises InputError where it is none."""
    known = start if isinstance(start, Equilibrium) else getattr(start, "equilibrium", None)
    if isinstance(known, Equilibrium):
        if known.robot.n_tubes != robot.n_tubes:
            raise InputError(f"start is of a robot with {known.robot.n_tubes} tubes; it must have {robot.n_tubes}")
        return known
    if not isinstance(start, tuple | list) or len(start) != 2:
        raise InputError(f"start is {reprlib.repr(start)}; it must be an Equilibrium or (rotations, translations)")
    return forward_kinematics(robot, *start, tolerance=tolerance)


def under_load(equilibrium: Equilibrium, load: Load | None) -> Equilibrium:
    """The equilibrium at the same joint values into which one grows with a load, or goes over as its load becomes
    another; raises SolveError where it is lost."""
    robot, joints = equilibrium.robot, (equilibrium.rotations, equilibrium.translations)
    return forward_kinematics(robot, *joints, load=load, start=equilibrium)


def _to_tolerance(point: Place, start: str, request: SolveRequest) -> Equilibrium:
    """The equilibrium of a point that was reached from `start`, on the first mesh whose estimated error is small
    enough, as far as finer ones help.

    Raises:
        SolveError: none is fine enough; the error bears the equilibrium on the last one.
    """
    by, first, before = request.method, point.member.discretisation.refinement, np.inf
    finest = max(REFINEMENTS if point.member.load is None else LOADED_REFINEMENTS, first)
    for level in range(first, finest + 1):
        shape = point.member.found(point)
        result = answered(point.member, shape, start, request.began, by.name)
        error = error_of(result)
        if error <= request.tolerance and (level == finest or shape.errors[2] <= by.newton.margin_tolerance):
            return result
        # Halved pieces lower the error by orders of magnitude; a factor below two means that it is not one of the mesh.
        if error > request.tolerance and (level == finest or error > before / 2):
            why = "" if level == finest else "; finer pieces no longer help"
            wrong = f"the estimated error is {error:.1e} rad, wanted was {request.tolerance:.1e} rad"
            raise SolveError(f"{Status.MESH_TOO_COARSE}: {wrong}{why}", result)
        there, before = point.member.on(refinement=level + 1), error
        failure = f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one"
        point = point.onto(there, failure, by.newton.iterations)
        point = _by_method(point, by)
    raise AssertionError("the finest mesh neither reached the tolerance nor raised an error")


@small
def _descended(member: Unloaded, by: Method) -> tuple[Place, str]:
    """A stable equilibrium, and from where energy descent led to it."""
    failure = ""
    try:
        point = _resolved(member, np.zeros(member.problem.size), by)
        if point.margin > 0:
            return point, "tubes without torsion"
    except SolveError as error:
        failure = f" ({error})"
    # From tubes without torsion Newton's method ended in a saddle or nowhere: symmetric tubes that oppose one another
    # are such a case. On the path from home every step ends in a minimum.
    result = member.from_home()
    point = Point.of(member, result)
    if point.margin <= 0 or not result.converged:
        raise SolveError(f"no stable equilibrium was found: the best has margin {point.margin:.3g}{failure}")
    return _by_method(point, by), "the path from home"


def _by_method(point: Place, by: Method) -> Place:
    """A solved point, solved once more from there where the method is not Newton's."""
    if by.name == "newton":
        return point
    if isinstance(point.member, Unloaded):
        return _resolved(point.member, point.state.x, by)
    problem, rotations = point.member.problem, point.member.rotations
    return Point.of(point.member, solve_loaded_ipopt(problem, rotations, point.state, by.ipopt), point.t)


def _resolved(member: Unloaded, x: Array, by: Method) -> PlainPoint:
    """Solved from unknowns x (U,) by a method; raises SolveError where it does not converge."""
    problem, rotations = member.problem, member.rotations
    if by.name == "newton":
        result = member.descend(x, by.newton)
    elif by.name == "energy" and problem.assembly.eccentric:
        raise InputError("method is 'energy'; eccentric robots have no such energy: use newton or ipopt")
    else:
        guess = profile(problem, rotations, evaluate(problem, rotations, x))
        result = solve_ipopt(problem, rotations, guess, "energy" if by.name == "energy" else "equations", by.ipopt)
    if not result.converged:
        raise SolveError(f"{Status.NOT_CONVERGED}: {worst_equation(problem, result.state)}")
    return Point.of(member, result)


def one_step(robot: Robot, guess: Equilibrium, rotations: Array, translations: tuple[float, ...]) -> Equilibrium | None:
    """The equilibrium after a small motion from `guess`, by one solve: `forward_kinematics` with a start that does not
    ask where the branch ends. None where Newton's method is not at ease, or the motion is not small."""
    request = SolveRequest()
    quick = unloaded(robot, rotations, np.array(translations), guess, request)
    if quick is not None:
        return quick
    turn, shift = rotations - guess.rotations, translations - guess.translations
    if not small_motion(turn, shift, max(float(guess.arc_length[-1]), shortest_arm(robot))):
        return None
    own = np.concatenate([guess.rotations, guess.translations])
    family = Family(JointPath(robot, own, np.concatenate([rotations, translations])))
    # Newton that goes far from the guess may have jumped past a fold: steps along the way would tell.
    point = step_to(family, 1.0, _start(family, Milestone(0.0, guess)))
    if point is None:
        return None
    result = to_equilibrium(point, "guess", request.began)
    if error_of(result) <= request.tolerance:
        return result
    return forward_kinematics(robot, rotations, translations, start=result)


@small
def on_branch(family: Family, guess: Equilibrium, request: SolveRequest) -> Equilibrium:
    """The equilibrium at t = 1 of a family on the branch of `guess`, which is that at t = 0; raises SolveError as
    `forward_kinematics`."""
    d, grows = family.path.discretisation, family.load is not None and guess.load is None and not family.path.moves
    here = Milestone(0.0, guess)
    if request.of_kernel(family.load, d):
        if grows:
            quick = nearby(family, guess, 1.0, request)
            here = here if quick is None else Milestone(1.0, quick)
        else:
            here = [here, *along(family, here, request)][-1]
        if here.t == 1.0:
            return here.pose
    known, shortest = _start(family, here), SHORTEST_STEP if grows else SHARPEST_STEP
    if grows:
        # The start was sampled from another mesh: Newton's method solves it once on this one.
        known = Point.near(known.member, known.state.x, FOLDED)
    # Without a load the branch of the start is followed whether it stays stable or not.
    stable = grows or (family.load is not None and known.margin > 0)
    point = reach(family, known, stable=stable, shortest=shortest)
    if point.t < 1.0 and grows:
        why = f"{_ending(family, point)} at {100 * point.t:.4g} % of the load"
        raise SolveError(f"{Status.BRANCH_ENDED_UNDER_LOAD}: {why}", to_equilibrium(point, "the load before"))
    if point.t < 1.0:
        why = f"it ends {100 * point.t:.2f} % of the path from the start to the goal"
        raise SolveError(f"{Status.BRANCH_ENDED}: {why}", here.pose)
    start = "the load before, from none" if grows else "guess"
    return _to_tolerance(_by_method(point, request.method), start, request)


def _start(family: Family, here: Milestone) -> Place:
    """An equilibrium as the beginning of a branch, as it was solved for."""
    pose = here.pose
    member, x = unsolved(pose, family.load, family.path.discretisation)
    return Point(here.t, member, member.at(x), pose.margin)


def _ending(family: Family, point: Place) -> str:
    """What happens to a branch just after its last stable point, in words."""
    if point.member.flutters(point.state):
        return "it begins to flutter"
    return "it bifurcates" if bifurcates(family, point) else "it ends in a fold"


def equilibrium_at(
    robot: Robot,
    rotations: Array,
    translations: Array,
    rotation_at: Along | None,
    *,
    load: Load | None = None,
    curvature_at: Along | None = None,
) -> Equilibrium:
    """What `Equilibrium.at` tells."""
    if rotation_at is None or (load is not None and curvature_at is None):
        return forward_kinematics(robot, rotations, translations, load=load)
    began, shift = time.perf_counter(), tuple(translations.tolist())
    member: Member[Any]
    if load is None:
        member = Unloaded.of(robot, rotations, shift)
    else:
        check_load(robot, load, shift)
        member = Loaded.of(robot, rotations, shift, load)
    s = member.torsion.arc_length
    theta = rotation_at(s).T.reshape(-1, robot.n_tubes)
    curvature = None if load is None or curvature_at is None else curvature_at(s).T
    point = Point.near(member, member.unknowns(theta, curvature), FOLDED)
    return _to_tolerance(point, "a program", SolveRequest(began=began))
