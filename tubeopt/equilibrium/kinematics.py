"""Forward kinematics: equilibrium of a robot at joint values.

The torsion boundary-value problem is discretised by collocation (`block/transcription/reduced.py`) and solved by
Newton's method. `forward_kinematics` calls, in this order:

1. `unloaded` or `loaded`: the compiled kernel, on the default mesh or finer ones.
2. `_descend`: the general solver, from tubes without torsion; if that ends in a saddle, on the path from home.
3. `on_branch`: with a start or a load, continuation along the joints or the load (`continuation.py`).
4. `_to_tolerance`: halves the elements of the mesh until the estimated error is below the tolerance.
"""

from __future__ import annotations

import reprlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import renamed, typed
from ..block.transcription.arm import ArmSolution, Profile, profile
from ..block.transcription.loaded import monotonicity
from ..block.transcription.reduced import ReducedProblem, evaluate
from ..bodies.obstacles import Obstacle, checked_obstacles
from ..errors import FlutterError, InputError, SolveError, choice, positive
from ..files.field_metadata import POSITIVE, OneOf, unit
from ..robots.eccentric import BundleRobot, by_model
from ..robots.load import Load
from ..robots.robot import Robot, check_robot, joint_values
from ..solvers.blas import small
from ..solvers.compiled.binding import Solved, Start, kernel_of, solve_compiled
from ..solvers.compiled.bundle import MOST_TUBES, bundle_kernel
from ..solvers.compiled.loaded import solve_loaded_compiled
from ..solvers.ipopt import solve_ipopt, solve_loaded_ipopt
from ..solvers.settings import (
    LARGEST_RATIO,
    LARGEST_SHIFT,
    LARGEST_TURN,
    LARGEST_TWIST,
    NEWTON,
    NEWTON_ROUND_OFF,
    Ipopt,
    Newton,
)
from ..solvers.time_limit import limited
from ..typing import Array, lazy_import
from .bundle import Bundled, solved_by_kernel
from .continuation import (
    SHARPEST_STEP,
    SHORTEST_STEP,
    Family,
    Milestone,
    SampledJointPath,
    bifurcates,
    largest_twist,
    reach,
    step_to,
)
from .member import AnyPoint, Loaded, Member, Point, Unloaded, at_points, discretisation_of
from .problem import (
    DEFAULT_DISCRETISATION,
    LOADED_DISCRETISATION,
    LOADED_REFINEMENTS,
    REFINEMENTS,
    Discretisation,
    check_load,
    loaded_rules,
)
from .result import Accuracy, Equilibrium, Statistics, Status, refuse_contact, refuse_load

# --- Method -----------------------------------------------------------------------------------------------------------

METHODS = ("newton", "ipopt", "energy")

TOLERANCE = 1e-8
"""Default tolerance of theta(s), rad, and of the tip relative to the length of the arm."""


@dataclass(frozen=True)
class Method:
    """Name of a method, one of METHODS, with the settings of its solver."""

    name: str
    newton: Newton = NEWTON
    ipopt: Ipopt | None = None


NAMED = {name: Method(name) for name in METHODS}


@dataclass(frozen=True)
class SolveRequest:
    """Method, tolerance and start of the clock of a solve."""

    method: Method = NAMED["newton"]
    tolerance: float = TOLERANCE
    """Largest error, as TOLERANCE."""
    start_time: float = field(default_factory=time.perf_counter)
    """Start of the clock, s."""

    def by_kernel(self, load: Load | None, discretisation: Discretisation) -> bool:
        """True if a compiled kernel may solve: by Newton's method with its settings, on its collocation points.

        Under a load, the only settings allowed are also the kernel's.
        """
        if load is not None:
            return self.method.name == "newton"
        return self.method is NAMED["newton"] and discretisation == DEFAULT_DISCRETISATION


def method_of(method: str | Newton | Ipopt, load: Load | None, discretisation: Discretisation) -> Method:
    """Method from its name or the settings of its solver.

    Raises:
        InputError: neither of them, or a method that cannot solve under the load.
    """
    if isinstance(method, Newton):
        by = Method("newton", newton=method)
    elif isinstance(method, Ipopt):
        by = Method("ipopt", ipopt=method)
    else:
        by = NAMED[choice("method", method, METHODS)]
    if isinstance(load, Load):
        _must_bear(by, load, discretisation)
    return by


def _must_bear(by: Method, load: Load, discretisation: Discretisation) -> None:
    """Raise InputError for methods and settings that are not supported under a load."""
    if by.newton is not NEWTON and replace(by.newton, margin_tolerance=NEWTON.margin_tolerance) != NEWTON:
        raise InputError("method has settings other than margin_tolerance; only this one applies under load")
    if by.name != "newton" and not load.has_energy:
        raise InputError(
            f"method is {by.name!r}; under a moment or a follower force, which have no energy, it must be 'newton'"
        )
    if discretisation != DEFAULT_DISCRETISATION:
        raise InputError("discretisation is given; under load it is chosen automatically")


# --- Forward kinematics -----------------------------------------------------------------------------------------------

# Most equilibria take a few milliseconds, under a load a tenth of a second.
KINEMATICS_LIMIT = 60.0
"""Default time limit for one equilibrium, s."""


@renamed(guess="start")
@typed
@by_model
@limited
def forward_kinematics(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    method: Annotated[str | Newton | Ipopt, OneOf(METHODS)] = "newton",
    start: Any = None,
    load: Load | None = None,
    walls: Sequence[Obstacle] = (),
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
        walls: bodies that the arm cannot enter, and that push it without friction. Without a start they advance from
            where the arm is free to their places. A start among walls is moved to these joint values among them.
        method: solver: newton (collocation), ipopt (the same as an NLP) or energy (minimum of the elastic energy).
            "newton" solves condensed collocation equations, "ipopt" the same equations as constraints of a nonlinear
            program, and "energy" minimises the elastic energy by IPOPT (concentric tubes only). Solver settings are
            `tubeopt.Newton(...)` or `tubeopt.Ipopt(...)`. Under load "ipopt" and "energy" are the same: minimum
            potential energy from the result of "newton", with the orientation of the arm as constraints.
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
    start_time = time.perf_counter()
    check_robot(robot)
    alpha, shift = joint_values(robot, rotations, translations)
    translation = tuple(shift.tolist())
    solver = method_of(method, load, discretisation)
    positive("tolerance", tolerance)
    guess = None if start is None else _start_of(robot, start, tolerance)
    if not robot.fixed_sections and (solver.name != "newton" or discretisation != DEFAULT_DISCRETISATION):
        raise InputError("kind is bundle; its equilibria have the method newton and the default mesh")
    # At home all robots are admissible.
    if translations is not None and (not robot.fixed_sections or len(robot.moving_together) < robot.n_tubes):
        _check_carriages(robot, translation)
    request = SolveRequest(solver, tolerance, start_time)
    if load is not None:
        check_load(robot, load, translation)
    elif guess is not None and guess.given_load is not None:
        raise InputError("start has a load, but no load is given; give the load, or a start without load")
    if guess is not None and not walls:
        refuse_contact(guess)

    if walls:
        if solver is not NAMED["newton"] or discretisation != DEFAULT_DISCRETISATION or tolerance < TOLERANCE:
            raise InputError(
                f"walls are given; then method must be 'newton', discretisation the default, and tolerance at least "
                f"{TOLERANCE:g} rad"
            )
        bodies = checked_obstacles(walls)
        among: Callable[..., Equilibrium] = lazy_import("tubeopt.equilibrium.wall_contact.among_walls")
        result = among(robot, alpha, shift, load, bodies, guess)
    elif load is None and guess is None:
        result = _from_scratch(robot, alpha, shift, discretisation, request)
    else:
        if guess is None:
            # The branch of the unloaded equilibrium is followed while the load grows.
            without_load = SolveRequest(tolerance=tolerance, start_time=start_time)
            guess = _from_scratch(robot, alpha, shift, DEFAULT_DISCRETISATION, without_load)
        result = _from_start(guess, robot, (alpha, shift), load, discretisation, request)
    return result.verified() if verify else result


@lru_cache(maxsize=256)
def _check_carriages(robot: Robot, translations: tuple[float, ...]) -> None:
    """Raise InputError for translations that carriages do not allow, which the kernel does not check."""
    robot.admit(np.array(translations))


def _start_of(robot: Robot, start: Any, tolerance: float) -> Equilibrium:
    """Equilibrium of the argument `start`: itself, its `equilibrium`, or that of its joint values."""
    known = start if isinstance(start, Equilibrium) else getattr(start, "equilibrium", None)
    if isinstance(known, Equilibrium):
        if known.robot.n_tubes != robot.n_tubes:
            raise InputError(f"start is of a robot with {known.robot.n_tubes} tubes; it must have {robot.n_tubes}")
        return known
    if not isinstance(start, tuple | list) or len(start) != 2:
        raise InputError(f"start is {reprlib.repr(start)}; it must be an Equilibrium or (rotations, translations)")
    return forward_kinematics(robot, *start, tolerance=tolerance)


def _from_scratch(
    robot: Robot, rotations: Array, translations: Array, discretisation: Discretisation, request: SolveRequest
) -> Equilibrium:
    """Stable equilibrium without a load: by the compiled kernel, or by the general solver from home at the latest."""
    if request.by_kernel(None, discretisation):
        result = unloaded(robot, rotations, translations, None, request)
        if result is not None:
            return result
    member: Member[Any]
    if isinstance(robot, BundleRobot):
        member = Bundled.cold(robot, rotations, tuple(translations.tolist()))
    else:
        member = Unloaded.of(robot, rotations, tuple(translations.tolist()), discretisation)
    point, how = _descend(member, request.method)
    return _to_tolerance(point, how, request)


def _from_start(
    guess: Equilibrium,
    robot: Robot,
    joints: tuple[Array, Array],
    load: Load | None,
    discretisation: Discretisation,
    request: SolveRequest,
) -> Equilibrium:
    """Equilibrium at joint values and under a load, on the branch of an equilibrium at others."""
    if load is not None:
        discretisation = LOADED_DISCRETISATION
    elif request.by_kernel(None, discretisation):
        # A small motion takes one solve.
        result = unloaded(robot, *joints, guess, request)
        if result is not None:
            return result
    before = np.concatenate([guess.rotations, guess.translations])
    path = SampledJointPath(robot, before, np.concatenate(joints), discretisation)
    return on_branch(Family(path, load, guess.load), guess, request)


# --- By the compiled kernel, without a load ---------------------------------------------------------------------------

# Each function returns None, or stops, where a kernel declines: there is none for the robot, no stable equilibrium is
# close by, or no mesh is fine enough. The general solver then continues.

TORSION_FREE = "tubes without torsion"
"""Start of a cold solve, as `Statistics.start` names it."""


# A translation is compared with the length of the arm. Without this lower bound an arm of length zero, as at full
# retraction, could not move at all.
SHORT_ARM = 0.1
"""Smallest length of an arm, over the longest tube's, for which tubes couple noticeably."""


KERNEL_MESHES: tuple[int, ...] = (0, 1, 2)
"""Halvings of the default mesh that the compiled kernel tries: the last for tubes that vary along their length.

Its memory holds the elements of the first two for all tubes, of the third for most; it declines others.
"""


def unloaded(
    robot: Robot, rotations: Array, translations: Array, guess: Equilibrium | None, request: SolveRequest
) -> Equilibrium | None:
    """Stable equilibrium without a load, from tubes without torsion or by a small motion from a guess.

    It is solved on the default mesh or, where that is too coarse, on finer ones.
    """
    max_change, refinements = LARGEST_TWIST, KERNEL_MESHES
    if guess is not None:
        if guess.margin <= 0 or not small_motion(guess, rotations, translations):
            return None
        max_change = largest_twist(guess.margin)
        if not robot.fixed_sections:
            refinements = (guess.statistics.refinement,)  # a bundle keeps the mesh of its start
    for refinement in refinements:
        solved = _by_kernel(robot, rotations, translations, guess, refinement)
        if solved is None or solved.largest_change > max_change:
            return None
        # A Newton iteration that contracts slowly may have converged to another branch.
        if guess is not None and solved.contraction > LARGEST_RATIO:
            return None
        result = solved.solution
        length = float(result.arm.arc_length[-1])
        if largest_error(result.errors.theta, result.errors.tip, length, even=robot.even) > request.tolerance:
            continue
        statistics = Statistics(
            method="newton",
            iterations=result.iterations,
            elements=solved.elements,
            degree=DEFAULT_DISCRETISATION.degree,
            start=TORSION_FREE if guess is None else "guess",
            seconds=time.perf_counter() - request.start_time - solved.loading,
            refinement=refinement,
            loading=solved.loading,
        )
        return build_equilibrium(robot, rotations, translations, result, statistics)
    return None


def _by_kernel(
    robot: Robot, rotations: Array, translations: Array, guess: Equilibrium | None, refinement: int
) -> Solved | None:
    """Solution of the compiled kernel of a robot; None where there is none."""
    if isinstance(robot, BundleRobot):
        return solved_by_kernel(robot, rotations, translations, guess, refinement)
    if guess is None:
        return solve_compiled(robot, rotations, translations, None, refinement)
    arm, points = guess.arm, guess.points
    sampled = arm.arc_length, arm.rotation, arm.torsion, points.point, points.point_rotation
    start = Start(*sampled, rotations - guess.rotations, guess.translations)
    return solve_compiled(robot, rotations, translations, start, refinement)


def small_motion(start: Equilibrium, rotations: Array, translations: Array) -> bool:
    """True for motions from `start` after which Newton's method stays on the branch."""
    turns = (rotations - start.rotations).tolist()
    if max(max(turns), -min(turns)) > LARGEST_TURN:
        return False
    shift = (translations - start.translations).tolist()
    largest = max(max(shift), -min(shift))
    return not largest or bool(largest <= LARGEST_SHIFT * reference_length(start))


@lru_cache(maxsize=64)
def reference_length(equilibrium: Equilibrium) -> float:
    """Length (m) of the arm as a scale for translations; at least SHORT_ARM of the longest tube."""
    return max(float(equilibrium.arc_length[-1]), SHORT_ARM * max(tube.length for tube in equilibrium.robot.tubes))


def has_kernel(robot: Robot) -> bool:
    """True if a compiled kernel solves a robot; bundles whose sheath has a rigid tip have none."""
    if isinstance(robot, BundleRobot):
        small, flexible = robot.n_tubes <= MOST_TUBES, robot.sheath_rigid_from is None
        return small and flexible and bundle_kernel(robot.n_tubes) is not None
    return kernel_of(robot) is not None


# --- By the general solver --------------------------------------------------------------------------------------------


@small
def _descend(member: Member[Any], solver: Method) -> tuple[AnyPoint, str]:
    """Stable equilibrium by energy descent, and a description of its start."""
    failure = ""
    try:
        point = _solve(member, member.untwisted(), solver)
        if point.margin > 0:
            return point, TORSION_FREE
    except SolveError as error:
        failure = f" ({error})"
    # Newton's method ended in a saddle, or did not converge: symmetric tubes that oppose one another are such a case.
    # On the path from home every step ends in a minimum.
    result = member.from_home()
    if not result.converged:
        raise SolveError(f"no stable equilibrium was found: the descent from home did not converge{failure}")
    point = Point.of(member, result)
    if point.margin <= 0:
        raise SolveError(f"no stable equilibrium was found: the best has margin {point.margin:.3g}{failure}")
    return _by_method(point, solver), "the path from home"


def _by_method(point: AnyPoint, solver: Method) -> AnyPoint:
    """Point solved again by the requested method, unless that is Newton's."""
    if solver.name == "newton":
        return point
    if isinstance(point.member, Unloaded):
        return _solve(point.member, point.state.x, solver)
    problem, rotations = point.member.problem, point.member.rotations
    return Point.of(point.member, solve_loaded_ipopt(problem, rotations, point.state, solver.ipopt), point.t)


def _solve(member: Member[Any], x: Array, solver: Method) -> AnyPoint:
    """Solution from unknowns x (U,) by a method; raises SolveError if it does not converge."""
    problem, rotations = member.problem, member.rotations
    if solver.name == "newton":
        result = member.descend(x, solver.newton)
    elif solver.name == "energy" and problem.assembly.eccentric:
        raise InputError("method is 'energy'; eccentric robots have no such energy: use newton or ipopt")
    else:
        guess = profile(problem, rotations, evaluate(problem, rotations, x))
        form = "energy" if solver.name == "energy" else "equations"
        result = solve_ipopt(problem, rotations, guess, form, solver.ipopt)
    if not result.converged:
        raise SolveError(f"{Status.NOT_CONVERGED}: {member.worst(result.state)}")
    return Point.of(member, result)


@small
def _to_tolerance(point: AnyPoint, start: str, request: SolveRequest) -> Equilibrium:
    """Equilibrium of a solved point on the first mesh with an estimated error within the tolerance.

    Args:
        start: what the point was solved from, for the statistics.

    Raises:
        SolveError: none is fine enough; `.solution` is the equilibrium on the last mesh.
    """
    solver, first, error_before = request.method, point.member.discretisation.refinement, np.inf
    finest = max(REFINEMENTS if point.member.load is None else LOADED_REFINEMENTS, first)
    for level in range(first, finest + 1):
        solution = point.member.solution(point)
        result = equilibrium_of(point.member, solution, start, request.start_time, solver.name)
        error = error_of(result)
        if error <= request.tolerance and (level == finest or solution.errors.margin <= solver.newton.margin_tolerance):
            return result
        # Halved elements lower the error by orders of magnitude; a factor below two is no error of the mesh.
        if error > request.tolerance and (level == finest or error > error_before / 2):
            why = "" if level == finest else "; finer elements no longer help"
            wrong = f"the estimated error is {error:.1e} rad, wanted was {request.tolerance:.1e} rad"
            raise SolveError(f"{Status.MESH_TOO_COARSE}: {wrong}{why}", result)
        finer, error_before = point.member.on(refinement=level + 1), error
        failure = f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one"
        point = point.onto(finer, failure, solver.newton.iterations)
        point = _by_method(point, solver)
    raise AssertionError("the finest mesh neither reached the tolerance nor raised an error")


# --- From a solution to an equilibrium --------------------------------------------------------------------------------

# The error of the shape is a fraction of the length of a piece of a tube, not of the arm.
SHORT = 0.01
"""Reference length (m) of the tip error of tubes made of pieces: 1e-10 m at the default tolerance."""


def to_equilibrium(point: AnyPoint, start: str, start_time: float = 0.0) -> Equilibrium:
    """Equilibrium of a solved point.

    Args:
        start: what it was solved from.   start_time: start of the clock, s; 0 if unknown.
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
    """Equilibrium object from joint values and the solution of a solver."""
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
        accuracy=Accuracy(result.residual, result.errors.theta, result.errors.tip),
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
    """Estimated error of an equilibrium: of theta, rad, or of the tip relative to the arm's length, the larger one."""
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


# --- On the branch of a start, or as a load grows ---------------------------------------------------------------------

# Close to a fold the general solver predicts the branch, where the kernel only halves its steps: seven halvings cost
# less than one step of the general solver; more would be spent on a branch that ends.
SHORTEST_COMPILED = 1 / 128
"""Fraction of the longest step along a path below which the general solver takes over from the compiled kernel."""


LOADED_MESHES = tuple(replace(LOADED_DISCRETISATION, refinement=k) for k in range(LOADED_REFINEMENTS + 1))
"""Meshes under a load, from coarse to fine."""


def on_branch(family: Family, guess: Equilibrium, request: SolveRequest) -> Equilibrium:
    """Equilibrium at t = 1 of a family on the branch of `guess`, the equilibrium at t = 0.

    Raises:
        SolveError: as `forward_kinematics`.
    """
    load_grows = family.load is not None and guess.load is None and not family.path.moves
    last = Milestone(0.0, guess)
    if followed_by_kernel(family) and request.by_kernel(family.load, family.path.discretisation):
        if load_grows:
            quick = nearby(family, guess, 1.0, request)
            last = last if quick is None else Milestone(1.0, quick)
        else:
            last = [last, *along(family, last, request)][-1]
    return last.pose if last.t == 1.0 else _continued(family, last, load_grows, request)


def followed_by_kernel(family: Family) -> bool:
    """True if a compiled kernel may follow a family; it minimises an energy, and that of bundles without a load."""
    robot, loads = family.path.robot, [load for load in family.loads if load is not None]
    if isinstance(robot, BundleRobot):
        return not loads and has_kernel(robot)
    return has_kernel(robot) and all(load.has_energy for load in loads)


def along(family: Family, start: Milestone, request: SolveRequest | None = None) -> Iterator[Milestone]:
    """Stable equilibria after `start`, up to t = 1 or to the point where the kernel declines even short steps."""
    request = request or SolveRequest()
    longest = family.path.largest_step()
    if longest < 1.0:
        longest *= 1 - 1e-9  # round-off may make a step longer than the kernel accepts
    last, step = start, longest
    if family.load is not None and start.pose.load is None and family.path.moves:
        # Where joints move as well, the kernel continues from an equilibrium under a load, here of size 0.
        first = nearby(family, start.pose, start.t, request)
        if first is None:
            return
        last = Milestone(start.t, first)
    while last.t < 1.0:
        t = 1.0 if last.t + step >= 1 - 1e-12 else last.t + step
        pose = nearby(family, last.pose, t, request)
        if pose is not None:
            last, step = Milestone(t, pose), min(2 * step, longest)
            yield last
            continue
        step /= 2
        if step < longest * SHORTEST_COMPILED:
            return


def nearby(family: Family, guess: Equilibrium, t: float, request: SolveRequest) -> Equilibrium | None:
    """Stable equilibrium at t of a family, a small change from `guess` on its branch; None close to a fold, too."""
    if family.load is not None:
        return loaded(guess, family.under_load(t), request)
    rotations, translations = family.path.at(t)
    result = unloaded(family.path.robot, rotations, translations, guess, request)
    return result if result is not None and result.margin > 0 else None


def loaded(start: Equilibrium, member: Loaded, request: SolveRequest) -> Equilibrium | None:
    """Stable equilibrium under a dead load, grown from an unloaded `start` or by a small change of a loaded one."""
    robot, rotations, shift, load = member.robot, member.rotations, member.translations, member.load
    if not (load.has_energy and start.margin > 0):
        return None
    problem, turn = member.problem, rotations - start.rotations
    if start.load is None:
        how, close = "the load before, from none", not turn.any() and np.array_equal(start.translations, shift)
    else:
        how, close = "guess", small_motion(start, rotations, np.array(shift))
    if not close:
        return None
    inputs = at_points(start, problem)
    margin = start.margin
    solution: ArmSolution | None = None
    for refinement in range(LOADED_REFINEMENTS + 1):
        rules = loaded_rules(robot, shift, load, refinement)
        if solution is not None:
            # Start from the coarse solution; its polynomials are those of the elastic rotation, without natural twist.
            coarse = [solution.points.point_rotation - problem.twist_angle, solution.points.point_curvature]
            table = problem.mesh.interpolated(np.concatenate(coarse, axis=1), rules.problem.torsion.arc_length)
            inputs, turn, margin = (table[:, : len(turn)], table[:, len(turn) :]), 0 * turn, solution.margin
        problem, solution = rules.problem, solve_loaded_compiled(rules, (rotations, turn), inputs, margin)
        if solution is None:
            return None
        errors, length = solution.errors, problem.torsion.assembly.total_length
        error = float(largest_error(errors.theta, errors.tip, length))
        if errors.margin <= request.method.newton.margin_tolerance and error <= request.tolerance:
            solved = Loaded(robot, problem, rotations, shift, LOADED_MESHES[refinement])
            return equilibrium_of(solved, solution, how, request.start_time)
    return None


@small
def _continued(family: Family, last: Milestone, load_grows: bool, request: SolveRequest) -> Equilibrium:
    """Equilibrium at t = 1 by the general solver, from where the compiled kernel stopped.

    `load_grows` is True if a load grows from none and nothing else changes.
    """
    shortest = SHORTEST_STEP if load_grows else SHARPEST_STEP
    point = _start(family, last)
    # Without a load the branch of the start is followed whether it stays stable or not.
    stable = load_grows or (family.load is not None and point.margin > 0)
    point = reach(family, point, stable=stable, shortest=shortest)
    if point.t < 1.0 and load_grows:
        flutters = point.member.flutters(point.state)
        if flutters:
            ending = "it begins to flutter"
        else:
            ending = "it bifurcates" if bifurcates(family, point) else "it ends in a fold"
        why = f"{ending} at {100 * point.t:.4g} % of the load"
        best = to_equilibrium(point, "the load before") if point.t else last.pose
        raise (FlutterError if flutters else SolveError)(f"{Status.BRANCH_ENDED_UNDER_LOAD}: {why}", best)
    if point.t < 1.0:
        why = f"it ends {100 * point.t:.2f} % of the path from the start to the goal"
        raise SolveError(f"{Status.BRANCH_ENDED}: {why}", last.pose)
    start = "the load before, from none" if load_grows else "guess"
    return _to_tolerance(_by_method(point, request.method), start, request)


def _start(family: Family, milestone: Milestone) -> AnyPoint:
    """First point of a branch: an equilibrium in the equations and on the mesh of its own solve."""
    pose = milestone.pose
    member, x = unsolved(pose, family.load, family.path.discretisation)
    return Point(milestone.t, member, member.at(x), pose.margin)


def one_step(robot: Robot, guess: Equilibrium, rotations: Array, translations: tuple[float, ...]) -> Equilibrium | None:
    """Equilibrium after a small motion from `guess`, by a single solve.

    None if Newton's method converges slowly, which may mean another branch, or where the motion is not small.
    """
    request = SolveRequest()
    quick = unloaded(robot, rotations, np.array(translations), guess, request)
    if quick is not None:
        return quick
    if not small_motion(guess, rotations, np.array(translations)):
        return None
    joints = np.concatenate([guess.rotations, guess.translations])
    family = Family(SampledJointPath(robot, joints, np.concatenate([rotations, translations])))
    # `step_to` refuses a solution far from the guess: Newton's method may have jumped past a fold.
    point = step_to(family, 1.0, _start(family, Milestone(0.0, guess)))
    if point is None:
        return None
    result = to_equilibrium(point, "guess", request.start_time)
    if error_of(result) <= request.tolerance:
        return result
    return forward_kinematics(robot, rotations, translations, start=result)


def under_load(equilibrium: Equilibrium, load: Load | None) -> Equilibrium:
    """Equilibrium at the same joint values on the same branch after the load grew, or changed into another one.

    Raises:
        SolveError: the branch ends before the full load.
    """
    robot, joints = equilibrium.robot, (equilibrium.rotations, equilibrium.translations)
    return forward_kinematics(robot, *joints, load=load, start=equilibrium)


Along = Callable[[Array], Array]
"""Function of arc lengths (N,), m."""


def equilibrium_at(
    robot: Robot,
    rotations: Array,
    translations: Array,
    rotation_at: Along | None,
    *,
    load: Load | None = None,
    curvature_at: Along | None = None,
) -> Equilibrium:
    """Equilibrium close to rotations (and, under a load, curvature) that are functions of arc length; `Equilibrium.at`.

    The default is the equilibrium of `forward_kinematics`.
    """
    if rotation_at is None or (load is not None and curvature_at is None):
        return forward_kinematics(robot, rotations, translations, load=load)
    start_time, shift = time.perf_counter(), tuple(translations.tolist())
    member: Member[Any]
    if load is None:
        member = Unloaded.of(robot, rotations, shift)
    else:
        check_load(robot, load, shift)
        member = Loaded.of(robot, rotations, shift, load)
    s = member.torsion.arc_length
    theta = rotation_at(s).T.reshape(-1, robot.n_tubes)
    curvature = None if load is None or curvature_at is None else curvature_at(s).T
    point = Point.solved_near(member, member.unknowns(theta, curvature), FOLDED)
    return _to_tolerance(point, "a program", SolveRequest(start_time=start_time))


# --- From an equilibrium to its problem -------------------------------------------------------------------------------

FOLDED = "the equilibrium is a fold (margin 0): it has no solution close by that Newton can find"


def point_of(
    equilibrium: Equilibrium, load: Load | None = None, discretisation: Discretisation | None = None
) -> AnyPoint:
    """Solved point of an equilibrium; arguments as of `unsolved`.

    Raises:
        InputError: an equilibrium with friction, or a load on a robot that cannot be loaded.
        SolveError: Newton's method does not converge, as at a fold.
    """
    member, x = unsolved(equilibrium, load, discretisation)
    # Where ends of tubes are about to separate, Newton's method may part them, and finds nothing close by.
    if member.residual(member.at(x)) <= NEWTON_ROUND_OFF:
        return Point.at(member, x)
    return Point.solved_near(member, x, FOLDED)


def unsolved(
    equilibrium: Equilibrium, load: Load | None = None, discretisation: Discretisation | None = None
) -> tuple[Member[Any], Array]:
    """Problem of an equilibrium, and the unknowns that solved it.

    Args:
        load: load that will grow on an unloaded equilibrium; its factor is still 0.
        discretisation: mesh of an unloaded equilibrium, or the default. A loaded one keeps its mesh.
    """
    refuse_contact(equilibrium)
    kind: type[Bundled | Unloaded | Loaded] = Unloaded if load is None and equilibrium.load is None else Loaded
    if not equilibrium.robot.fixed_sections:
        kind = Bundled
    return kind.of_equilibrium(equilibrium, load, discretisation)


def collocated(equilibrium: Equilibrium) -> tuple[ReducedProblem, Profile]:
    """Equations of the rotations of an equilibrium on its own mesh, and the torsion along its arm."""
    point = point_of(equilibrium, discretisation=discretisation_of(equilibrium))
    return point.member.torsion, point.torsion


def linearised(equilibrium: Equilibrium) -> Array:
    """(U, U) Jacobian of the equations of an unloaded equilibrium on its own mesh."""
    refuse_load(equilibrium)
    member, x = unsolved(equilibrium, discretisation=discretisation_of(equilibrium))
    return np.asarray(member.at(x).hessian)


def sure_margin(equilibrium: Equilibrium) -> float:
    """Lower bound of the linearised equations relative to the elastic form, at most 1.

    The margin, or of fixed sections under a load without an energy the smallest eigenvalue of their symmetric part.
    Above 0 there is no other equilibrium close by.
    """
    if equilibrium.load is None or equilibrium.load.has_energy or not equilibrium.robot.fixed_sections:
        return min(equilibrium.margin, 1.0)
    member, x = unsolved(equilibrium)
    return monotonicity(member.problem, member.at(x))
