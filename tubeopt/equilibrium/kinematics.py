"""Forward kinematics: joint values -> the equilibrium that the robot takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..block.transcription import arm as arms
from ..block.transcription.loaded import unknowns
from ..block.transcription.reduced import (
    Evaluation,
    ReducedProblem,
    evaluate,
    on_centreline,
    to_unknowns,
    worst_equation,
)
from ..block.transcription.second_variation import margin
from ..errors import InputError, SolveError, positive
from ..robots.limits import check_reach, check_turn
from ..robots.load import Load
from ..robots.robot import Robot, check_robot, is_general, joint_values
from ..solvers.compiled.binding import Start, solve_compiled
from ..solvers.ipopt import solve_ipopt
from ..solvers.newton import NewtonResult, descend, leave_saddle, newton
from ..solvers.parallel.blas import small
from ..solvers.settings import CONTINUATION, NEWTON, Ipopt, Newton
from ..solvers.time_limit import limited
from ..typing import Array
from .continuation import Family, JointPath, largest_twist, reach, shortest_arm, small_motion
from .load_problem import check_load
from .loaded import arrived, compiled, loaded_kinematics, solved_by_ipopt, to_tolerance
from .member import Loaded, LoadedPoint, Point, plain_point, solution_of
from .method import NAMED, Method, method_of, only_plain
from .result import Equilibrium, Status
from .solving import (
    DEFAULT_DISCRETISATION,
    Discretisation,
    Solution,
    from_compiled,
    polish,
    reduced_problem,
    sample_rotation,
    to_equilibrium,
)
from .verification import verify_equilibrium

SHORT = 0.01
"""Length (m) over which the tip of tubes made of pieces is right: to 1e-10 m where 1e-8 is asked for."""

TOLERANCE = 1e-8
"""Wanted accuracy of theta(s), rad, and of the tip, as a fraction of the length of the arm."""

KINEMATICS_LIMIT = 60.0
"""s, for one equilibrium: most take a few milliseconds, under a load a tenth of a second."""

FOLD = "Newton's method does not stay at the equilibrium of the program: it is a fold (margin 0)"

Along = Callable[[Array], Array]


@typed
@limited
def forward_kinematics(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    method: str | Newton | Ipopt = "newton",
    guess: Equilibrium | None = None,
    load: Load | None = None,
    tolerance: float = TOLERANCE,
    verify: bool = False,
    discretisation: Discretisation = DEFAULT_DISCRETISATION,
    time_limit: float = KINEMATICS_LIMIT,
) -> Equilibrium:
    """Equilibrium of a robot at given joint values.

    Without a guess the answer is a stable equilibrium: the one that energy descent (method "newton") reaches from
    tubes without torsion, or, where that is unstable, the one that is reached by turning all tubes together from home.
    With a guess, an equilibrium at other joint values, the branch of the guess is followed, stable or not.

    Args:
        rotations, translations: (n,) rad and m; translations default to home. Rotations are not wrapped.
        load: forces on the robot. Without a guess the answer is then the stable equilibrium into which the unloaded one
            grows with the load; with one, the branch of the guess is followed to these joint values and this load.
        method: "newton" (the collocation equations, condensed), "ipopt" (the same equations as the constraints of a
            nonlinear program), "energy" (least elastic energy by IPOPT; concentric tubes only); or the settings of a
            solver, `tubeopt.Newton(...)` or `tubeopt.Ipopt(...)`. Under load "ipopt" and "energy" are one: least
            potential energy, with the orientation of the arm as constraints, from what "newton" finds.
        tolerance: wanted accuracy of theta(s), rad, and of the tip as a fraction of the length of the arm, with tubes
            made of pieces of 10 mm; the mesh is refined until the estimate is below.
        verify: also re-integrate adaptively and report the difference in `.verification`.
        discretisation: collocation family and degree.
        time_limit: s, on the clock: moments that wind an arm up to a coil take many steps.

    Raises:
        InputError: no robot, wrong number of joint values, one that is not finite, a rotation beyond MOST_TURN, a tube
            out of its actuator, translations that are not in m, unknown method; a load on an eccentric robot, with
            a discretisation, or with IPOPT where it has no energy.
        SolveError: no stable equilibrium was found, the branch of the guess ends on the way (a snap), the branch ends
            or loses stability before the whole load is on (the message says at which part of it), or the tolerance is
            out of reach; `.solution` holds the best equilibrium found, where there is one.
        TimeLimitError: the time limit is reached, a `SolveError`.

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
    check_turn(alpha)
    shift = tuple(place.tolist())
    check_reach(robot.tubes, shift)
    by = method_of(method)
    positive("tolerance", tolerance)
    if guess is not None and guess.robot.n_tubes != robot.n_tubes:
        raise InputError(f"guess is of a robot with {guess.robot.n_tubes} tubes; it must have {robot.n_tubes}")
    if load is not None:
        check_load(robot, load, shift)
        only_plain(by, load, discretisation)
        first = guess if guess is not None else forward_kinematics(robot, alpha, shift, tolerance=tolerance)
        found = loaded_kinematics(first, Loaded.of(robot, alpha, shift, load), tolerance, began, by.newton)
        if by.name != "newton":
            found = solved_by_ipopt(found, by.name, by.ipopt, began)
        return verify_equilibrium(found) if verify else found
    if guess is not None and guess.load is not None:
        raise InputError("guess bears a load, but no load is given; give the load, or a guess without one")
    if by is NAMED["newton"] and discretisation == DEFAULT_DISCRETISATION:
        quick = _quick(robot, alpha, shift, guess, tolerance, began)
        if quick is not None:
            return verify_equilibrium(quick) if verify else quick
    if guess is None:
        solution, start = _cold(reduced_problem(robot, shift, discretisation), alpha, by)
    else:
        solution, start = follow_branch(robot, guess, alpha, shift, discretisation), "guess"
        if by.name != "newton":
            solution = _resolve(solution.problem, alpha, solution.arm, by)
    equilibrium = _to_tolerance(robot, solution, shift, discretisation, tolerance, (by, start, began))
    return verify_equilibrium(equilibrium) if verify else equilibrium


def _quick(
    robot: Robot, alpha: Array, shift: tuple[float, ...], guess: Equilibrium | None, tolerance: float, began: float
) -> Equilibrium | None:
    """By the compiled kernel, on its usual mesh or on one twice as fine; None where that does not do."""
    for refinement in (0, 1):
        found = _compiled(robot, alpha, shift, guess, (began, refinement))
        if found is None or _error(found) <= tolerance:
            return found
    return None


def _to_tolerance(
    robot: Robot,
    solution: Solution,
    shift: tuple[float, ...],
    discretisation: Discretisation,
    tolerance: float,
    how: tuple[Method, str, float],
) -> Equilibrium:
    """The equilibrium on the first mesh whose estimated error is small enough, as far as finer ones help; `how` is
    method, start, and when begun."""
    method, start, began = how
    before, finest = np.inf, max(method.newton.refinements, discretisation.refinement)
    for level in range(discretisation.refinement, finest + 1):
        equilibrium = to_equilibrium(robot, solution, shift, (method.name, start, time.perf_counter() - began))
        error = _error(equilibrium)
        if error <= tolerance:
            return equilibrium
        if level == finest or error > before / 2:
            why = "" if level == finest else "; finer pieces no longer help"
            wrong = f"the estimated error is {error:.1e} rad, wanted was {tolerance:.1e} rad"
            raise SolveError(f"{Status.MESH_TOO_COARSE}: {wrong}{why}", equilibrium)
        before = error
        finer = Discretisation(discretisation.family, discretisation.degree, level + 1)
        solution = _refine(robot, solution, shift, finer, method)
    raise AssertionError("the finest mesh either holds the tolerance or raises")


def _error(equilibrium: Equilibrium) -> float:
    """Estimated error of theta(s), rad, or of the tip as a fraction of `measure`, whichever is larger."""
    by = max(float(equilibrium.arc_length[-1]), 1e-300)
    if by > SHORT and is_general(equilibrium.robot):
        by = SHORT
    return max(equilibrium.mesh_error, equilibrium.tip_error / by)


def measure(robot: Robot, length: ArrayLike) -> Array:
    """By what the error of the tip is divided, m: the length of the arm, with tubes made of pieces at most SHORT."""
    length = np.maximum(length, 1e-300)
    return np.minimum(length, SHORT) if is_general(robot) else length


def _compiled(
    robot: Robot, rotations: Array, shift: tuple[float, ...], guess: Equilibrium | None, how: tuple[float, int]
) -> Equilibrium | None:
    """A stable equilibrium by the compiled kernel: cold, or by a small motion from a guess; None where it declines.
    `how`: when the solve began (s), and how often the pieces of the mesh are halved."""
    if _tied(robot):
        _check_translations(robot, shift)
    start, translations = None, np.array(shift)
    if guess is not None:
        turn, length = rotations - guess.rotations, max(float(guess.arc_length[-1]), shortest_arm(robot))
        if guess.margin <= 0 or not small_motion(turn, translations - guess.translations, length):
            return None
        arm = guess.arc_length, guess.rotation, guess.torsion, guess.point, guess.point_rotation
        start = Start(*arm, turn, guess.translations)
    answer = solve_compiled(robot, rotations, translations, start, how[1])
    if answer is None or (answer["contraction"] > CONTINUATION.largest_ratio and start is not None):
        return None
    if answer["largest_change"] > (CONTINUATION.largest_twist if guess is None else largest_twist(guess.margin)):
        return None
    begin = "tubes without torsion" if start is None else "guess"
    return from_compiled(robot, rotations, shift, answer, (begin, *how))


def nearby(family: Family, guess: Equilibrium, t: float) -> Equilibrium | None:
    """The stable equilibrium at t of a family on the branch of `guess`, a small change away, by the compiled kernel;
    None where that declines, as it does close to a fold."""
    began = time.perf_counter()
    if family.load is not None:
        return compiled(guess, family.under_load(t), TOLERANCE, began, NEWTON)
    rotations, translations = family.path.at(t)
    found = _compiled(family.path.robot, rotations, tuple(translations.tolist()), guess, (began, 0))
    return found if found is not None and found.margin > 0 and _error(found) <= TOLERANCE else None


@lru_cache(maxsize=64)
def _tied(robot: Robot) -> bool:
    """Whether tubes move together."""
    return len(robot.moving_together) < robot.n_tubes


@lru_cache(maxsize=256)
def _check_translations(robot: Robot, shift: tuple[float, ...]) -> None:
    """Raise InputError where tubes that move together are moved apart; the kernel sees the tubes only."""
    robot.assembly(np.array(shift))


@small
def _cold(problem: ReducedProblem, rotations: Array, method: Method) -> tuple[Solution, str]:
    """A stable equilibrium from tubes without torsion, else by way of home."""
    failure = ""
    try:
        untwisted = _untwisted(problem, rotations)
        solution = _resolve(problem, rotations, untwisted, method)
        if solution.margin > 0:
            return solution, "tubes without torsion"
    except SolveError as error:
        failure = f" ({error})"
    solution = _from_home(problem, rotations)
    if solution.margin <= 0 or not solution.result.converged:
        raise SolveError(f"no stable equilibrium was found: the best has margin {solution.margin:.3g}{failure}")
    if method.name != "newton":
        solution = _resolve(problem, rotations, solution.arm, method)
    return solution, "the way from home"


def _untwisted(problem: ReducedProblem, rotations: Array) -> arms.Profile:
    pieces, n = len(problem.mesh.length), problem.assembly.n_tubes
    still = np.zeros((pieces, problem.mesh.tableau.degree, n))
    extra = still if problem.assembly.eccentric else None
    return arms.Profile(np.tile(rotations, (pieces, 1)), np.zeros((pieces, n)), still, extra)


def _resolve(problem: ReducedProblem, rotations: Array, guess: arms.Profile, method: Method) -> Solution:
    """Solve from a guess by a method; raises SolveError where it does not converge."""
    if method.name == "newton":
        z = to_unknowns(problem, rotations, arms.interpolate(problem, guess, problem.arc_length))
        solve = _by_centreline if problem.assembly.eccentric else descend
        result = solve(problem, rotations, z, settings=method.newton)
    elif method.name == "energy" and problem.assembly.eccentric:
        raise InputError("method is 'energy'; tubes off the centreline have no such energy: use newton or ipopt")
    else:
        formulation = "energy" if method.name == "energy" else "equations"
        result = solve_ipopt(problem, rotations, guess, formulation, method.ipopt)
    if not result.converged:
        raise SolveError(f"{Status.NOT_CONVERGED}: {worst_equation(problem, result.state)}")
    return Solution.of(problem, rotations, result)


def _by_centreline(
    problem: ReducedProblem, rotations: Array, z: Array, *, settings: Newton = NEWTON
) -> NewtonResult[Evaluation]:
    """Newton for tubes off the centreline from where the energy of the same tubes on it leads."""
    concentric = on_centreline(problem)
    theta = evaluate(problem, rotations, z).theta
    start = descend(concentric, rotations, to_unknowns(concentric, rotations, theta), settings=settings)
    return newton(problem, rotations, to_unknowns(problem, rotations, start.state.theta), settings=settings)


def _from_home(problem: ReducedProblem, rotations: Array) -> Solution:
    """Turn all tubes together from home, descending in energy at each step; then leave any saddle."""
    concentric = on_centreline(problem)
    steps = max(1, int(np.ceil(np.abs(rotations).max(initial=0.0) / CONTINUATION.home_turn)))
    z = np.zeros(concentric.size)
    for k in range(1, steps + 1):
        alpha = rotations * k / steps
        result = descend(concentric, alpha, z)
        if result.converged and margin(concentric, result.state) <= 0:
            sides = [descend(concentric, alpha, start) for start in leave_saddle(concentric, result.state)]
            result = min(sides, key=lambda side: side.state.energy)
        z = result.state.z
    if problem.assembly.eccentric:
        theta = result.state.theta
        result = newton(problem, rotations, to_unknowns(problem, rotations, theta))
    return Solution.of(problem, rotations, result)


def _refine(
    robot: Robot, coarse: Solution, shift: tuple[float, ...], finer: Discretisation, method: Method
) -> Solution:
    """The same equilibrium on a finer mesh, started from the coarse one."""
    problem = reduced_problem(robot, shift, finer)
    theta = arms.interpolate(coarse.problem, coarse.arm, problem.arc_length)
    failure = f"{Status.NOT_CONVERGED} on a finer mesh: the solution on the coarse mesh is not one"
    solution = Solution.near(problem, coarse.rotations, theta, failure, method.newton)
    return solution if method.name == "newton" else _resolve(problem, coarse.rotations, solution.arm, method)


def one_step(robot: Robot, guess: Equilibrium, rotations: Array, translations: tuple[float, ...]) -> Equilibrium | None:
    """The equilibrium after a small motion from `guess`, by one solve: `forward_kinematics` with a guess that does not
    ask where the branch ends. None where Newton's method is not at ease, or the motion is not small."""
    began = time.perf_counter()
    quick = _compiled(robot, rotations, translations, guess, (began, 0))
    if quick is None:
        solution = _near(robot, guess, rotations, translations, DEFAULT_DISCRETISATION)
        if solution is None:
            return None
        quick = to_equilibrium(robot, solution, translations, ("newton", "guess", time.perf_counter() - began))
    if _error(quick) <= TOLERANCE:
        return quick
    return forward_kinematics(robot, rotations, translations, guess=quick)


def _near(
    robot: Robot, guess: Equilibrium, rotations: Array, shift: tuple[float, ...], discretisation: Discretisation
) -> Solution | None:
    """The solution after a small motion, from the guess itself, without solving for it once more; None where Newton's
    method is not at ease, or the motion is not small."""
    problem = reduced_problem(robot, shift, discretisation)
    turn = rotations - guess.rotations
    length = max(problem.assembly.total_length, shortest_arm(robot))
    if not small_motion(turn, shift - guess.translations, length):
        return None
    theta = sample_rotation(guess, problem.arc_length) + turn
    result = newton(problem, rotations, to_unknowns(problem, rotations, theta), iterations=8)
    # Newton that goes far from the guess may have jumped past a fold: steps along the way would tell.
    far = abs((result.state.theta - theta).ravel()[problem.flat]).max(initial=0.0) > largest_twist(guess.margin)
    if not result.converged or result.contraction > CONTINUATION.largest_ratio or far:
        return None
    return Solution.of(problem, rotations, result)


@small
def follow_branch(
    robot: Robot, guess: Equilibrium, rotations: Array, shift: tuple[float, ...], discretisation: Discretisation
) -> Solution:
    """Follow the branch of `guess`, stable or not, along the straight path of joint values; raises SolveError where it
    ends on the way."""
    near = _near(robot, guess, rotations, shift, discretisation)
    if near is not None:
        return near
    own = np.concatenate([guess.rotations, guess.translations])
    path = JointPath(robot, own, np.concatenate([rotations, shift]), discretisation)
    start = plain_point(robot, polish(guess, discretisation), tuple(guess.translations.tolist()))
    last = reach(Family(path), start, stable=False, shortest=CONTINUATION.sharpest_step)
    return solution_of(arrived(last, guess))


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
    if rotation_at is None:
        return forward_kinematics(robot, rotations, translations, load=load)
    shift = tuple(translations.tolist())
    if load is not None and curvature_at is not None:
        return _under_load(robot, (rotations, shift), load, (rotation_at, curvature_at))
    problem = reduced_problem(robot, shift, DEFAULT_DISCRETISATION)
    theta = rotation_at(problem.arc_length).T.reshape(-1, robot.n_tubes)
    solution = Solution.near(problem, rotations, theta, FOLD)
    near = to_equilibrium(robot, solution, shift, ("newton", "a program", 0.0))
    return forward_kinematics(robot, rotations, translations, guess=near)


def _under_load(
    robot: Robot, joints: tuple[Array, tuple[float, ...]], load: Load, along: tuple[Along, Along]
) -> Equilibrium:
    """From rotations and curvatures along the arm, under a load."""
    check_load(robot, load, joints[1])
    began, member = time.perf_counter(), Loaded.of(robot, *joints, load)
    theta, curvature = (each(member.problem.torsion.arc_length).T for each in along)
    point: LoadedPoint = Point.near(member, unknowns(member.problem, joints[0], theta, curvature), FOLD)
    return to_tolerance(point, 1e-8, ("a program", began))
